"""A search for what breaks a promise: an evolution strategy that maximises a figure over real numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

CHILDREN: Final = 8
"""Of each generation; the mean of the best :data:`PARENTS` of them is the middle of the next."""

PARENTS: Final = 3


def searched(
    figure: Callable[[NDArray[np.float64]], float], size: int, rng: np.random.Generator, generations: int
) -> float:
    """The greatest figure that was found, of vectors of ``size`` numbers that begin about 0 with the spread 1."""
    mean, step, best = rng.normal(0.0, 1.0, size), 0.6, -np.inf
    for _ in range(generations):
        children = mean + step * rng.normal(0.0, 1.0, (CHILDREN, size))
        found = [figure(genes) for genes in children]
        order = np.argsort(found)[::-1]
        mean, step = children[order[:PARENTS]].mean(axis=0), step * (1.1 if found[order[0]] > best else 0.95)
        best = max(best, found[order[0]])
    return best
