"""Pure mathematics: models, passivity, LMIs, couplings, certificates. No sockets, no clocks.

``__all__`` is the public API beyond what the commands use: the transformation of the loop, the facial reduction of
Lemma 1, Lemmas 2 and 3 and Theorem 1 of the paper, the searches for levels, and :func:`seal` for a certificate that a
program makes itself. A name is imported when it is used, as a node must not load a solver.
"""

import importlib
from typing import Any

_HOMES = {
    "Dissipative": "continuous",
    "Network": "network",
    "continuous_storage_inequality": "continuous",
    "device_share_fixed": "delay",
    "device_level": "continuous",
    "device_with_level": "continuous",
    "equality_residual": "passivity",
    "feedback_with_passive": "continuous",
    "greatest_input_level": "best_level",
    "greatest_output_level": "best_level",
    "lemma2_expression": "lemma2",
    "lemma2_matrix": "lemma2",
    "lemma3": "continuous",
    "loop_gain": "transformation",
    "mass_with_damping": "continuous",
    "passive_operator": "continuous",
    "schur_matrix": "lemma2",
    "seal": "certificate",
    "storage_by_lemma2": "lemma2",
    "storage_face": "passivity",
    "structured_level": "physical",
    "theorem1": "continuous",
    "transformed_device": "transformation",
    "transformed_environment": "transformation",
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
