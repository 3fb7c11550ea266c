"""Semidefinite programs given as numbers, F_0 + sum_i x_i F_i >= 0, handed to Clarabel without a modelling layer.

The minimax programs of transparency are solved dozens of times in a search, each with other coefficients; building them
through expressions would take ten times as long as solving them. Answers are checked like those of
:mod:`manyhands.design.solver`: a status is turned into an error of our own, and the caller recomputes what it needs.
"""

from __future__ import annotations

from collections.abc import Callable

import clarabel
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from manyhands.design.errors import SolverFailure
from manyhands.design.solver import ProgramInfeasible
from manyhands.design.statespace import Matrix


class LinearMatrixProgram:
    """Minimise c^T x subject to linear inequalities and linear matrix inequalities.

    Args:
        size: number of unknowns x.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._scalar: list[tuple[Matrix, Matrix]] = []
        self._norms: list[tuple[Matrix, Matrix]] = []
        self._cones: list[tuple[int, Matrix, sp.csc_matrix]] = []

    def nonnegative(self, constant: Matrix, linear: Matrix) -> None:
        """Require constant + linear x >= 0, entry by entry: k and k x size."""
        self._scalar.append((constant, linear))

    def positive(self, constant: Matrix, linear: Matrix) -> None:
        """Require constant + sum_i x_i linear[i] >= 0 as symmetric matrices: k x k and size x k x k."""
        k = len(constant)
        if k == 1:
            self.nonnegative(constant[0], linear[:, 0, :].T)
            return
        columns, rows = np.tril_indices(k)  # the upper triangle, column by column
        weight = np.where(rows == columns, 1.0, np.sqrt(2.0))
        self._cones.append((k, constant[rows, columns] * weight, sp.csc_matrix((linear[:, rows, columns] * weight).T)))

    def second_order(self, constant: Matrix, linear: Matrix) -> None:
        """Require the first entry of constant + linear x >= the Euclidean norm of the others: k and k x size."""
        self._norms.append((constant, linear))

    def hermitian(self, constant: NDArray[np.complex128], linear: NDArray[np.complex128]) -> None:
        """As :meth:`positive`, for Hermitian matrices: [Re, -Im; Im, Re] is real and has the same eigenvalues."""
        if len(constant) == 1:
            self.nonnegative(constant[0].real, linear[:, 0, :].real.T)
            return
        self.positive(_embedded(constant), _embedded(linear))

    def solve(self, cost: Matrix, what: str) -> Matrix:
        """The minimiser x.

        Args:
            cost: c.
            what: for messages.

        Raises:
            ProgramInfeasible: no x satisfies the constraints.
            SolverFailure: the solver gave no usable answer.
        """
        blocks, right, cones = [], [], []
        if self._scalar:
            blocks.append(sp.csc_matrix(np.vstack([linear for _, linear in self._scalar])))
            right.append(np.concatenate([constant for constant, _ in self._scalar]))
            cones.append(clarabel.NonnegativeConeT(len(right[0])))
        if self._norms:
            blocks.append(sp.csc_matrix(np.vstack([linear for _, linear in self._norms])))
            right.append(np.concatenate([constant for constant, _ in self._norms]))
            cones += [clarabel.SecondOrderConeT(len(constant)) for constant, _ in self._norms]
        for k, constant, linear in self._cones:
            blocks.append(linear)
            right.append(constant)
            cones.append(clarabel.PSDTriangleConeT(k))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1  # the cones are small; two cores may be all there is
        solver = clarabel.DefaultSolver(
            sp.csc_matrix((self.size, self.size)),
            np.asarray(cost, dtype=np.float64),
            -sp.vstack(blocks, format="csc"),
            np.concatenate(right),
            cones,
            settings,
        )
        solution = solver.solve()
        status = str(solution.status)
        if "PrimalInfeasible" in status:
            raise ProgramInfeasible(what)
        x = np.array(solution.x, dtype=np.float64)
        if status not in ("Solved", "AlmostSolved") or not np.all(np.isfinite(x)):
            raise SolverFailure(f"{what}: Clarabel ended with status {status!r}")
        return x


def coefficients(affine: Callable[[Matrix], Matrix], size: int) -> tuple[Matrix, Matrix]:
    """F_0 and the F_i of an affine matrix function of x in R^size, by evaluating it at 0 and the unit vectors."""
    constant = affine(np.zeros(size))
    linear = np.zeros((size, *constant.shape))
    for i, unit in enumerate(np.eye(size)):
        linear[i] = affine(unit) - constant
    return constant, linear


def _embedded(hermitian: NDArray[np.complex128]) -> Matrix:
    re, im = hermitian.real, hermitian.imag
    return np.asarray(np.concatenate([np.concatenate([re, -im], -1), np.concatenate([im, re], -1)], -2))
