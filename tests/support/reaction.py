"""An environment's tick with arrays, for computations in tests."""

from __future__ import annotations

import numpy as np

from manyhands.nodes.environment.core import Core


def react(core: Core, p: np.ndarray) -> np.ndarray:
    """f_c(k), N, for p(k), m."""
    return np.array(core.react(p.tolist()))
