"""Pure mathematics: models, passivity, LMIs, couplings, certificates. No sockets, no clocks.

Read ``models/`` first, then ``passivity/`` and ``levels/`` (what each party promises); ``problem``, ``theorem3`` and
``theorem4`` find a coupling, ``synthesis`` leads from a wish to a ``certificate``, and ``proof/`` proves it, apart from
all.

``__all__`` is the public API beyond what the commands use: the transformation of the loop, the facial reduction of
Lemma 1, Lemmas 2 and 3 and Theorem 1 of the paper, the searches for levels, and :func:`seal` for a certificate that a
program makes itself. A name is imported when it is used, as a node must not load a solver.
"""

import importlib
from typing import Any

_HOMES = {
    "Dissipative": "passivity.continuous",
    "Network": "models.network",
    "continuous_storage_inequality": "passivity.continuous",
    "device_share_fixed": "levels.device",
    "device_level": "passivity.continuous",
    "device_with_level": "passivity.continuous",
    "equality_residual": "passivity.storage",
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
    "storage_face": "passivity.storage",
    "structured_level": "levels.network",
    "theorem1": "passivity.continuous",
    "transformed_device": "models.coupling",
    "transformed_environment": "models.coupling",
}
"""The module of each public name."""

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """A public name, imported from its module now.

    Raises:
        AttributeError: there is no such name.
    """
    if name not in _HOMES:
        raise AttributeError(f"found the name {name!r}; expected a module of {__name__}, or one of {', '.join(_HOMES)}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
