"""Products with the small matrices of a tick, as plain floats where those are faster.

A loop wakes once a millisecond and finds its caches taken by others: what a product costs then is the code that has to
be fetched, not the arithmetic. A call into numpy costs some 10 us cold however small the matrix, a sum of products in
Python a tenth of that for a device's one port. Beyond :data:`NARROW` entries numpy is the faster one.

The choice depends on the matrix alone, so that a run and its simulation have the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import mul
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = list[float]
"""The components of a vector."""

LinearMap: TypeAlias = Callable[[Floats], Floats]

NARROW: Final = 100
"""Entries of a matrix up to which its products are sums in Python: 3 ports and 5 states of an environment are 88."""


def linear_map(matrix: NDArray[np.float64]) -> LinearMap:
    """The map v -> M v."""
    if matrix.size > NARROW:
        whole = np.array(matrix, order="C")

        def wide(v: Floats) -> Floats:
            product: Floats = (whole @ np.array(v)).tolist()
            return product

        return wide
    rows = tuple(map(tuple, matrix.tolist()))

    def narrow(v: Floats) -> Floats:
        return [sum(map(mul, row, v)) for row in rows]

    return narrow


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """a^T b."""
    product: float = sum(map(mul, a, b))
    return product
