"""The arithmetic of a tick: products with small matrices, small systems of equations, clipped forces, a matrix digest.

**Products** (:func:`linear_map`, :func:`dot`) are sums of plain floats where these are faster than numpy. A loop wakes
once a millisecond, and other processes have used its caches meanwhile. A product then costs the time to fetch its code,
not the arithmetic. A call into numpy costs some 10 us with cold caches, however small the matrix. A sum of products in
Python costs a tenth of that for a device with one port. Beyond :data:`NARROW` entries numpy is faster. The choice
depends on the matrix alone, so that a run and its simulation have the same numbers.

**Clipping** (:class:`Saturation`) limits a force port by port: at the coupling, and again at the device, last before
its actuator. The certificate does not cover a clipped force, so both places count the ticks and report them.

**The digest** (:func:`feedthrough_digest`) lets the environment recognise the D_V of its certificate without having it.
The launcher puts the digest of every block's D_V into the environment's bundle, and a coupling sends its D_V in the
handshake. So the environment refuses a coupling whose block has a different D_V.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = list[float]
"""The components of a vector."""

Rows: TypeAlias = Sequence[Floats]
"""A matrix that changes from tick to tick, by rows."""

LinearMap: TypeAlias = Callable[[Floats], Floats]

NARROW: Final = 100
"""Entries of a matrix up to which its products are sums in Python: 3 ports and 5 states of an environment have 88."""

FEW: Final = 4
"""Unknowns up to which equations are solved in Python: with five numpy is faster, with eight four times faster."""


def linear_map(matrix: NDArray[np.float64]) -> LinearMap:
    """The map v -> M v, for a constant matrix M."""
    if matrix.size > NARROW:
        whole = np.array(matrix, order="C")

        def wide(v: Floats) -> Floats:
            image: Floats = (whole @ np.array(v)).tolist()
            return image

        return wide
    rows: list[Floats] = matrix.tolist()
    if matrix.shape == (1, 1):
        factor = rows[0][0]

        def scaled(v: Floats) -> Floats:
            return [0.0 + factor * v[0]]  # as dot adds it, which makes no -0.0

        return scaled

    def narrow(v: Floats) -> Floats:
        return [dot(row, v) for row in rows]

    return narrow


def dot(a: Floats, b: Floats) -> float:
    """a^T b, added from the first product to the last.

    Python's own sum is no such sum: from version 3.12 on it carries the rounding along.
    """
    product = 0.0
    for i in range(len(a)):
        product += a[i] * b[i]
    return product


def minus(a: Floats, b: Floats) -> Floats:
    """The difference a - b."""
    return [a[i] - b[i] for i in range(len(a))]


def plus(a: Floats, b: Floats) -> Floats:
    """The sum a + b."""
    return [a[i] + b[i] for i in range(len(a))]


def solve(A: Rows | NDArray[np.float64], b: Floats, least: float) -> Floats | None:
    """A^{-1} b of a square matrix A; None where A is nearly singular.

    Args:
        A: n x n; rows up to :data:`FEW` unknowns, an array beyond.
        b: n numbers.
        least: a pivot must be greater than this; beyond :data:`FEW` unknowns 1/||A^{-1}||_1 takes its place.
    """
    n = len(b)
    if n > FEW:
        try:
            inverse = np.linalg.inv(np.array(A))
        except np.linalg.LinAlgError:
            return None
        image: Floats = (inverse @ np.array(b)).tolist()
        return image if least * float(np.linalg.norm(inverse, 1)) < 1.0 else None
    # Gauss-Jordan elimination; the pivot is the greatest entry of its column
    work = [[*row, at] for row, at in zip(A, b, strict=True)]
    for k in range(n):
        pivot = max(range(k, n), key=lambda i: abs(work[i][k])) if k < n - 1 else k
        lead = work[pivot][k]
        if not abs(lead) > least:
            return None
        work[k], work[pivot] = work[pivot], work[k]
        scaled = work[k] = [entry / lead for entry in work[k]]
        for i in range(n):
            factor = work[i][k]
            if i != k and factor != 0.0:
                work[i] = [entry - factor * by for entry, by in zip(work[i], scaled, strict=True)]
    return [row[n] for row in work]


class Saturation:
    """The limits of the forces at several ports.

    Attributes:
        ticks: the number of ticks whose force was clipped.
    """

    __slots__ = ("_limits", "ticks")

    def __init__(self, limits: Sequence[float]) -> None:
        """``limits`` has the greatest absolute force of each port, N."""
        self._limits = tuple(limits)
        self.ticks = 0

    def clip(self, f: Floats) -> Floats:
        """``f`` (N) itself where it is within the limits, otherwise a clipped copy, in which NaN becomes 0."""
        for i in range(len(f)):
            if not -self._limits[i] <= f[i] <= self._limits[i]:
                break
        else:
            return f
        self.ticks += 1
        return [
            0.0 if math.isnan(force) else max(-limit, min(limit, force))
            for force, limit in zip(f, self._limits, strict=True)
        ]


def feedthrough_digest(D_V: ArrayLike) -> str:
    """SHA-256 of D_V (m/N) as little-endian float64, row by row; 64 hexadecimal digits."""
    return hashlib.sha256(np.ascontiguousarray(D_V, dtype="<f8").tobytes()).hexdigest()
