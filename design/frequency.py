"""The Hermitian part of E_hat on the unit circle: evaluated fast, and tested for its sign at all frequencies at once.

    H(w) = He(E_hat(e^jwT)) = He(Rest(e^jwT)) - T/2 E1                    (:mod:`manyhands.design.split`)

Evaluation puts A into complex Schur form once, after which a frequency costs one triangular solve. The test finds where
H + Phi is singular by the imaginary eigenvalues of a Hamiltonian matrix [Boyd1989]_, as :mod:`manyhands.design.cayley`
explains.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import schur, solve_triangular

from manyhands.design.cayley import axis_image, crossing_angles
from manyhands.design.errors import SolverFailure
from manyhands.design.split import Split
from manyhands.design.statespace import Matrix, symmetric_part

Angles = NDArray[np.float64]

_SMALL = 64  # states up to which a general solver is no slower, and a triangular one may stall in threads it starts
_GRID = 48  # angles from _LOWEST to pi, in a geometric series; poles are added
_LOWEST = 1e-5  # rad a tick: 0.01 rad/s at 1 kHz
_APART = 0.01  # poles whose angles differ by less, relatively, share a place in the grid
_NEAR_AXIS = 1e-4  # |Re s| / |s| below which an eigenvalue is taken for imaginary; one too many costs one evaluation
_ROUNDING = 1e-13  # the same, of the Hamiltonian's norm


class Dissipation:
    """H(w) as a function of the angle w T in [0, pi].

    Args:
        split: E_hat, m ports, order n of Rest.
        T: period, s.

    Raises:
        SolverFailure: Rest has a mode that does not decay; no strict inequality holds there.
    """

    def __init__(self, split: Split, T: float) -> None:
        self.split, self.T = split, T
        rest = split.rest
        self._constant = symmetric_part(rest.D) - T / 2.0 * split.stiffness
        if rest.order:
            triangle, basis = schur(rest.A, output="complex")
        else:
            triangle, basis = np.zeros((0, 0)), np.zeros((0, 0))
        self._triangle = np.asarray(triangle, dtype=np.complex128)
        self._B = basis.conj().T @ rest.B
        self._C = rest.C @ basis
        self.poles = np.diag(self._triangle)
        radius = float(np.max(np.abs(self.poles), initial=0.0))
        if not radius < 1.0:
            raise SolverFailure(
                f"the environment has a mode that does not decay (a pole of modulus {radius:.9g}, such as a mass that "
                "nothing holds), so that no matrix proves it strictly passive"
            )

    def __call__(self, angle: float) -> NDArray[np.complex128]:
        """H, m x m Hermitian, N*s/m, at e^{j angle}."""
        if not len(self.poles):
            return np.asarray(self._constant, dtype=np.complex128)
        shifted = -self._triangle
        shifted[np.diag_indices_from(shifted)] += np.exp(1j * angle)
        if len(shifted) <= _SMALL:
            states = np.linalg.solve(shifted, self._B)
        else:
            states = solve_triangular(shifted, self._B, check_finite=False)
        gain = self._C @ states
        return np.asarray((gain + gain.conj().T) / 2.0 + self._constant)

    def angles(self) -> Angles:
        """Angles at which to look first: 0, pi, a geometric series, and where poles are."""
        poles = np.abs(np.angle(self.poles))
        poles = np.sort(poles[(poles > _LOWEST) & (np.abs(self.poles) > 0.5)])  # others leave no mark of their own
        kept: list[float] = []
        for angle in poles:
            if not kept or angle > kept[-1] * (1.0 + _APART):
                kept.append(float(angle))
        return np.unique(np.concatenate([[0.0], np.geomspace(_LOWEST, np.pi, _GRID), kept]))


def crossings(dissipation: Dissipation, Phi: Matrix) -> Angles:
    """All angles in [0, pi] at which H + Phi may be singular, in ascending order.

    With (A, B, C, D) the image of Rest on the imaginary axis and R = He(D) + Phi - T/2 E1 (H + Phi at z = -1),
    they belong to the imaginary eigenvalues s = j tan(wT/2) of

        [ A - B R^{-1} C / 2         -B R^{-1} B^T            ]
        [ C^T R^{-1} C / 4       -A^T + C^T R^{-1} B^T / 2    ].

    Args:
        dissipation: H.
        Phi: m x m symmetric, N*s/m.

    Returns:
        Every crossing up to rounding, and possibly some that are none.
    """
    if dissipation.split.rest.order == 0:
        return np.zeros(0)
    image = axis_image(dissipation.split.rest)
    A, B, C = image.A, image.B, image.C
    R = symmetric_part(image.D) + Phi - dissipation.T / 2.0 * dissipation.split.stiffness
    RC, RB = np.linalg.solve(R, C), np.linalg.solve(R, B.T)
    hamiltonian = np.block([[A - B @ RC / 2.0, -B @ RB], [C.T @ RC / 4.0, C.T @ RB / 2.0 - A.T]])
    return crossing_angles(hamiltonian, _NEAR_AXIS, _ROUNDING * float(np.linalg.norm(hamiltonian)))
