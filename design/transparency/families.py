"""Linear couplings over fixed poles: every choice of the remaining numbers enters the conditions linearly.

One block of V, m_i ports, in units in which Delta_D = I and T = 1 (v below; V = T S v S with S = Delta_D^{-1/2}):

    xi+ = (a kron I) xi + (b kron I) f,    v f = sum_j C_j xi_j + D f,    C_j = C_j^T, D = D^T  (m_i x m_i)

with n scalar poles: a is n x n, b is n x 1. Then v(z) = v(z)^T, and the static compliance
v(1) = D + sum_j g_j C_j, g = (I - a)^{-1} b, is symmetric whatever rounding does, without which V_hat is not OSP.

V_hat is Delta-OSP iff some P makes, in zeta = xi - xi_ and phi = f - f_ (an underscore: the tick before),

    next^T Pi next - zeta^T P zeta - phi^T y + y^T Delta y <= 0,
    next = (A zeta + B phi, phi),    y = C zeta + (D - kappa) phi,
    Pi = [ P  P_12; P_12^T  P_22 ] > 0,    P_12 = (A - I)^{-T} C^T/2,    P_22 = (v(1) - kappa)/2,

which is Lemma 1 of [Bianchini2010]_ with P_12 and P_22 settled by the neutral directions of V_hat. All of it is
linear in (P, C, D) once y^T Delta y is taken out by a Schur complement (Lemma 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space, solve_discrete_lyapunov

from manyhands.design.conic import LinearMatrixProgram, coefficients
from manyhands.design.statespace import Matrix, StateSpace, symmetric_part

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class PoleBasis:
    """Scalar poles of a block and their orthonormal realisation.

    The sections of one real pole or one conjugate pair are cascaded so that a a^T + b b^T = I (the Takenaka-Malmquist
    basis, [Heuberger2005]_): well conditioned also where poles coincide.

    Attributes:
        poles: in the z plane, |p| < 1, each complex one followed by its conjugate.

    Raises:
        ValueError: a pole outside the unit circle, or a complex one without its conjugate.
    """

    poles: tuple[complex, ...]

    def __post_init__(self) -> None:
        self.sections  # noqa: B018 - refuses what is not a basis

    @property
    def order(self) -> int:
        """Number n of scalar poles."""
        return len(self.poles)

    @cached_property
    def sections(self) -> tuple[tuple[float, ...], ...]:
        """Denominators of the sections, monic, descending powers of z: degree 1 or 2."""
        out: list[tuple[float, ...]] = []
        pending: complex | None = None
        for p in self.poles:
            if not abs(p) < 1.0:
                raise ValueError(f"pole {p}: expected one inside the unit circle")
            if pending is not None:
                if abs(p - pending.conjugate()) > 1e-12:
                    raise ValueError(f"pole {pending}: expected its conjugate next, found {p}")
                out.append((1.0, -2.0 * p.real, abs(p) ** 2))
                pending = None
            elif p.imag == 0.0:
                out.append((1.0, -p.real))
            else:
                pending = p
        if pending is not None:
            raise ValueError(f"pole {pending}: expected its conjugate next, found none")
        return tuple(out)

    @cached_property
    def realisation(self) -> tuple[Matrix, Matrix]:
        """(a, b), n x n and n x 1, with a a^T + b b^T = I."""
        a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
        for den in self.sections:
            n = len(den) - 1
            a_j = np.eye(n, k=-1)
            a_j[0] = -np.array(den[1:])
            b_j = np.eye(n, 1)
            root = np.linalg.cholesky(symmetric_part(solve_discrete_lyapunov(a_j, b_j @ b_j.T, method="bilinear")))
            a_j, b_j = np.linalg.solve(root, a_j @ root), np.linalg.solve(root, b_j)
            last = null_space(np.hstack([a_j, b_j])).T  # completes an all-pass section
            c_j, d_j = last[:, :n], last[:, n:]
            a = np.block([[a, np.zeros((len(a), n))], [b_j @ c, a_j]])
            b = np.vstack([b, b_j @ d])
            c, d = np.hstack([d_j @ c, c_j]), d_j @ d
        return a, b

    @cached_property
    def static_gains(self) -> Matrix:
        """The entries of g = (I - a)^{-1} b."""
        a, b = self.realisation
        return np.asarray(np.linalg.solve(np.eye(self.order) - a, b)[:, 0])

    def functions(self, angles: Matrix) -> ComplexArray:
        """(e^{j theta} I - a)^{-1} b for ``angles`` theta, angles x n."""
        a, b = self.realisation
        z = np.exp(1j * angles)[:, None, None]
        return np.asarray(np.linalg.solve(z * np.eye(self.order) - a, b.astype(np.complex128)[None])[:, :, 0])


@dataclass(frozen=True, eq=False)
class FixedPoleBlock:
    """The unknowns (C_1, ..., C_n, D, P) of one block as one vector, in units where Delta_D = I and T = 1.

    Attributes:
        basis: the poles.
        ports: m_i.
        kappa: the loop's K in these units, kappa I.
        level: Delta, m_i x m_i, positive definite: V_hat is to be Delta-OSP.
    """

    basis: PoleBasis
    ports: int
    kappa: float
    level: Matrix

    @cached_property
    def _triangle(self) -> Matrix:
        """Symmetric unit matrices, m_i (m_i + 1)/2 of them."""
        return symmetric_units(self.ports)

    @property
    def gains(self) -> int:
        """How many of the unknowns belong to C and D; they come first."""
        return (self.basis.order + 1) * len(self._triangle)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        states = self.basis.order * self.ports
        return self.gains + states * (states + 1) // 2

    def unpack(self, x: Matrix) -> tuple[Matrix, Matrix, Matrix]:
        """C (m_i x n m_i), D and P (n m_i x n m_i) from the vector of unknowns."""
        parts = np.tensordot(x[: self.gains].reshape(self.basis.order + 1, -1), self._triangle, axes=1)
        states = self.basis.order * self.ports
        P = np.zeros((states, states))
        rows, columns = np.tril_indices(states)
        P[rows, columns] = P[columns, rows] = x[self.gains :]
        return np.concatenate([*parts[:-1], np.zeros((self.ports, 0))], axis=1), parts[-1], P

    def pack(self, C: Matrix, D: Matrix, P: Matrix) -> Matrix:
        """The inverse of :meth:`unpack`."""
        m, n = self.ports, self.basis.order
        rows, columns = np.tril_indices(m)
        parts = [*(C[:, j * m : (j + 1) * m] for j in range(n)), D]
        return np.concatenate([*(part[rows, columns] for part in parts), P[np.tril_indices(n * m)]])

    def derivatives(self, angles: Matrix) -> ComplexArray:
        """The responses of the block per unit of each gain, angles x gains x m_i x m_i; v is their sum."""
        functions = np.concatenate([self.basis.functions(angles), np.ones((len(angles), 1))], axis=1)
        out = functions[:, :, None, None, None] * self._triangle[None, None]
        return np.asarray(out.reshape(len(angles), self.gains, self.ports, self.ports))

    def realisation(self, x: Matrix) -> StateSpace:
        """The block v as a system."""
        C, D, _ = self.unpack(x)
        A, B = self._states()
        return StateSpace(A, B, C, D)

    def sizes(self, angles: Matrix) -> Matrix:
        """The greatest modulus over ``angles`` of each gain's function, gains entries."""
        heights = np.concatenate([np.max(np.abs(self.basis.functions(angles)), axis=0), np.ones(1)])
        return np.repeat(heights, len(self._triangle))

    def constrain(
        self, program: LinearMatrixProgram, index: NDArray[np.intp], room: float, spare: int | None = None
    ) -> None:
        """Require Pi >= room and the Schur form of the OSP inequality >= room.

        Args:
            program: where to.
            index: unknown k of the block is the program's index[k].
            room: least eigenvalue.
            spare: an unknown of the program that is to be added to ``room``.
        """
        for constant, linear in self._conditions:
            wide = np.zeros((program.size, *constant.shape))
            wide[index] = linear
            if spare is not None:
                wide[spare] = -np.eye(len(constant))
            program.positive(constant - room * np.eye(len(constant)), wide)

    def margins(self, x: Matrix) -> tuple[float, float]:
        """Least eigenvalues of Pi and of the Schur form: both positive prove the level."""
        return float(np.linalg.eigvalsh(self._storage(x))[0]), float(np.linalg.eigvalsh(self._supply(x))[0])

    @cached_property
    def _conditions(self) -> tuple[tuple[Matrix, Matrix], ...]:
        return tuple(coefficients(affine, self.size) for affine in (self._storage, self._supply))

    def _states(self) -> tuple[Matrix, Matrix]:
        a, b = self.basis.realisation
        I = np.eye(self.ports)
        return np.asarray(np.kron(a, I)), np.asarray(np.kron(b, I))

    def _storage(self, x: Matrix) -> Matrix:
        """Pi."""
        C, D, P = self.unpack(x)
        a, _ = self.basis.realisation
        P_12 = np.linalg.solve(np.kron(a - np.eye(self.basis.order), np.eye(self.ports)).T, C.T / 2.0)
        g = np.kron(self.basis.static_gains[:, None], np.eye(self.ports))
        P_22 = (D + C @ g - self.kappa * np.eye(self.ports)) / 2.0
        return np.block([[P, P_12], [P_12.T, symmetric_part(P_22)]])

    def _supply(self, x: Matrix) -> Matrix:
        """[phi^T y + zeta^T P zeta - next^T Pi next, y^T root; root^T y, I] with Delta = root root^T."""
        C, D, P = self.unpack(x)
        A, B = self._states()
        n, m = A.shape[0], self.ports
        Pi = self._storage(x)
        ahead = np.block([[A, B], [np.zeros((m, n)), np.eye(m)]])
        y = np.hstack([C, D - self.kappa * np.eye(m)])
        M = -ahead.T @ Pi @ ahead
        M[:n, :n] += P
        M[n:] += y / 2.0
        M[:, n:] += y.T / 2.0
        side = y.T @ np.linalg.cholesky(self.level)
        return np.block([[M, side], [side.T, np.eye(m)]])


def symmetric_units(m: int) -> Matrix:
    """A basis of the symmetric m x m matrices, m(m+1)/2 x m x m, in the order of the lower triangle by rows."""
    rows, columns = np.tril_indices(m)
    out = np.zeros((len(rows), m, m))
    out[np.arange(len(rows)), rows, columns] = 1.0
    out[np.arange(len(rows)), columns, rows] = 1.0
    return out
