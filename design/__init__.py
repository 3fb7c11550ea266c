"""Pure mathematics: models, passivity, LMIs, couplings, certificates. No sockets, no clocks.

Read ``models/`` first, then ``passivity/`` and ``levels/`` (the promise of each party). ``problem``, ``theorem3`` and
``theorem4`` find a coupling and its levels, ``synthesis`` leads from a request to a ``certificate``, and ``proof/``
proves it without any code of the others.

``__all__`` is the public API beyond the code that the commands use; section 10 of docs/design.md describes it. It has
the loop transformation, Lemmas 2 and 3 and Theorem 1 of the paper, the searches for levels, and :func:`seal` for a
certificate that a program makes itself. A name is imported when it is used, because a node must not load a solver.
"""

import importlib
from typing import Any

_HOMES = {
    "Dissipative": "passivity.continuous",
    "Network": "models.network",
    "continuous_storage_inequality": "passivity.continuous",
    "device_level": "passivity.continuous",
    "device_with_level": "passivity.continuous",
    "feedback_with_passive": "passivity.continuous",
    "greatest_input_level": "passivity.best_level",
    "greatest_output_level": "passivity.best_level",
    "lemma2_expression": "passivity.lemma2",
    "lemma2_matrix": "passivity.lemma2",
    "lemma3": "passivity.continuous",
    "loop_gain": "models.coupling",
    "mass_with_damping": "passivity.continuous",
    "passive_operator": "passivity.continuous",
    "schur_matrix": "passivity.lemma2",
    "seal": "certificate",
    "storage_by_lemma2": "passivity.lemma2",
    "structured_level": "levels.network",
    "theorem1": "passivity.continuous",
    "transformed_device": "models.coupling",
    "transformed_environment": "models.coupling",
}
"""The module of each public name."""

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """A public name, imported from its module at its first use.

    Raises:
        AttributeError: the name is neither public nor a module.
    """
    if name not in _HOMES:
        raise AttributeError(f"found the name {name!r}; expected a module of {__name__}, or one of {', '.join(_HOMES)}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
