"""Which core an environment's bundle asks for: E as it is proved, or a model or E under a controller."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.bundle import EnvironmentBundle
from manyhands.nodes.environment.black_box import BlackBox, EnforcedCore, ForceLaw, LinearLaw
from manyhands.nodes.environment.clutch import Blocks
from manyhands.nodes.environment.core import EnvironmentCore
from manyhands.nodes.environment.model import AskedModel, make_model

Vector = NDArray[np.float64]

Core: TypeAlias = EnvironmentCore | EnforcedCore
"""What reacts to the tools of all users."""


def environment_core(bundle: EnvironmentBundle, D_V: Vector, blocks: Blocks | None = None) -> Core:
    """The core of an environment, at rest; a model that the bundle names is imported and made here.

    Args:
        bundle: the environment's part of the session.
        D_V: the couplings' feedthrough, m x m, m/N, as told at the handshake.
        blocks: the ports of each coupling; None for one block of all ports.

    Raises:
        ModelError: the model cannot be made.
        ValueError: as the cores themselves.
    """
    common, E = bundle.common, bundle.E
    law: ForceLaw
    if bundle.model is not None:
        model = make_model(bundle.model, common.ports, common.period)
        law = BlackBox(AskedModel(bundle.model.factory, model, common.ports))
    elif E is None:
        raise ValueError("found an environment without matrices and without a model; expected one of the two")
    elif bundle.enforce:
        law = LinearLaw(E, len(bundle.masses))
    else:
        return EnvironmentCore(
            E,
            D_V,
            bundle.Phi_E,
            common.period,
            blocks,
            masses=len(bundle.masses),
            budgets=bundle.budgets,
            storage=bundle.storage,
        )
    return EnforcedCore(law, D_V, bundle.Phi_E, common.period, bundle.enforce, blocks, budgets=bundle.budgets)
