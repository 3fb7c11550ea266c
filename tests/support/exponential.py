"""The error of matrix exponentials, against ball arithmetic of 300 bits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx
from numpy.typing import NDArray
from scipy.linalg import expm

from manyhands.design.models.device import exponential_less_identity


class Errors(NamedTuple):
    """The largest error of an entry of exp(X), as a part of the largest entry: ours, and SciPy's."""

    ours: float
    scipys: float


def errors(X: NDArray[np.float64]) -> Errors:
    """The errors for a square matrix X."""
    n, before, ctx.prec = len(X), ctx.prec, 300
    try:
        exact = arb_mat(n, n, [arb(float(entry)) for entry in X.flat]).exp()
        pairs = [(i, j) for i in range(n) for j in range(n)]
        largest = max(float(abs(exact[i, j]).upper()) for i, j in pairs)

        def error(found: NDArray[np.float64]) -> float:
            return max(float(abs(arb(float(found[i, j])) - exact[i, j]).upper()) for i, j in pairs) / largest

        return Errors(error(np.eye(n) + exponential_less_identity(X)), error(expm(X)))
    finally:
        ctx.prec = before
