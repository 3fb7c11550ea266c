"""Families of couplings for the minimax programs: springs and dampers, and linear couplings over fixed poles.

Both families live in the normalised loop. Its ports are scaled by S = Delta_D^{-1/2} and its time by the period T. A
coupling is V = T S v S with v of order one, and the loop gain K = kappa T Delta_D^{-1} becomes kappa I. The programs
are those of :mod:`manyhands.design.transparency.minimax`.

Over fixed poles, all other numbers of a linear coupling enter the conditions linearly, so that the family is convex,
block by block. Loop shaping is affine over it, and its optimum is global. One block v of m_i ports, in units in which
Delta_D = I and T = 1, is

    xi+ = (a kron I) xi + (b kron I) f,    v f = sum_j C_j xi_j + D f,    C_j = C_j^T, D = D^T  (m_i x m_i)

with n scalar poles: a is n x n, b is n x 1. Then v(z) = v(z)^T. The static compliance v(1) = D + sum_j g_j C_j,
g = (I - a)^{-1} b, is symmetric in spite of rounding; V_hat could not be OSP otherwise.

V_hat is Delta-OSP iff some P makes, in zeta = xi - xi_ and phi = f - f_ (an underscore: the tick before),

    next^T Pi next - zeta^T P zeta - phi^T y + y^T Delta y <= 0,
    next = (A zeta + B phi, phi),    y = C zeta + (D - kappa) phi,
    Pi = [ P  P_12; P_12^T  P_22 ] > 0,    P_12 = (A - I)^{-T} C^T/2,    P_22 = (v(1) - kappa)/2,

which is Lemma 1 of [Bianchini2010]_, where the neutral directions of V_hat determine P_12 and P_22. After a Schur
complement for y^T Delta y (Lemma 2), the inequality is linear in (P, C, D).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space, solve_discrete_lyapunov

from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.statespace import Matrix, StateSpace, frequency_response, symmetric_part
from manyhands.design.models.weights import Filter, Transparency, WeightedLoop
from manyhands.design.passivity.hinfinity import frequency_grid
from manyhands.design.solver import LinearMatrixProgram, coefficients
from manyhands.design.transparency.minimax import Family

ComplexArray = NDArray[np.complex128]

UNWEIGHTED = Transparency("loop-shaping", Filter.one(), Filter.one())


@dataclass(frozen=True, eq=False)
class NormalisedLoop:
    """The data of a transparency problem, and the maps from normalised blocks v to the weighted loop.

    Attributes:
        E: the environment, discrete and stable, displacement (m) to force (N), m x m.
        Delta_D: the level of the devices, m x m, N*s/m, symmetric positive definite, with the partition's structure.
        kappa: positive; the loop gain is K = kappa T Delta_D^{-1} (m/N), and kappa is 1/2 without delay.
        T: period, s.
        partition: the ports of each block of the coupling V.
        aim: objective and weights of the transparency problem; the default serves designs without such a problem.
        counted: what is counted of the world's links, force (N) to displacement (m), m x m. A coupling of the family
            contains it, and the aim is about the coupling without it; None if nothing is counted.
        scaling: S_i = Delta_D,i^{-1/2} of each block, m_i x m_i, symmetric, (N*s/m)^{-1/2}; computed from Delta_D.

    Raises:
        ValueError: sizes differ, E is unstable, Delta_D has not the structure or is not positive definite, or kappa or
            T is not positive.
    """

    E: StateSpace
    Delta_D: Matrix
    kappa: float
    T: float
    partition: Partition
    aim: Transparency = UNWEIGHTED
    counted: StateSpace | None = None
    scaling: tuple[Matrix, ...] = field(init=False)

    def __post_init__(self) -> None:
        m, E, Delta_D = self.partition.size, self.E, self.Delta_D
        if E.inputs != m or E.outputs != m or Delta_D.shape != (m, m):
            raise ValueError(
                f"found E of {E.outputs} x {E.inputs} and Delta_D of {Delta_D.shape[0]} x {Delta_D.shape[1]}; "
                f"expected {m} x {m}"
            )
        radius = float(np.max(np.abs(np.linalg.eigvals(E.A)), initial=0.0))
        if not radius < 1.0:
            raise ValueError(
                f"environment: found a pole of modulus {radius:.9g}; expected a stable E; a mass that no link holds "
                "moves no port and may be left out"
            )
        if not (self.T > 0.0 and self.kappa > 0.0):
            raise ValueError(f"found the period {self.T} and kappa {self.kappa}; expected both above 0")
        if not self.partition.admits(Delta_D) or np.any(Delta_D != Delta_D.T):
            raise ValueError("expected a symmetric Delta_D that joins no ports of different blocks")
        scaling = []
        for name, part in zip(self.partition.names, self.partition.restrict(Delta_D), strict=True):
            values, vectors = np.linalg.eigh(part)
            if not values[0] > 0.0:
                raise ValueError(f"coupling {name}: found a least eigenvalue {values[0]:.3g} of Delta_D; expected > 0")
            scaling.append(symmetric_part(vectors @ np.diag(values**-0.5) @ vectors.T))
        object.__setattr__(self, "scaling", tuple(scaling))

    @cached_property
    def weighted(self) -> WeightedLoop:
        """E with the weights."""
        return WeightedLoop(self.E, self.aim)

    def grid(self, V: StateSpace) -> Matrix:
        """Angles that separate the peaks of the weighted loop with a coupling V of the family (physical units)."""
        return frequency_grid(np.concatenate([self.weighted.poles(), self.weighted.poles_with(self.own(V))]))

    def own(self, V: StateSpace) -> StateSpace:
        """A coupling V of the family (physical units) without what is counted of the world's links."""
        return V if self.counted is None else V.minus(self.counted)

    def coupling(self, v: Sequence[ComplexArray], angles: Matrix) -> ComplexArray:
        """The coupling without what is counted, from the responses v of the blocks at ``angles``, angles x m x m."""
        out = np.zeros((len(angles), self.partition.size, self.partition.size), dtype=np.complex128)
        for ports, S, block in zip(self.partition.blocks, self.scaling, v, strict=True):
            out[:, np.array(ports)[:, None], np.array(ports)] = self.T * S @ block @ S
        return out if self.counted is None else out - frequency_response(self.counted, angles)

    def derivatives(self, v: Sequence[ComplexArray], slopes: Sequence[ComplexArray], angles: Matrix) -> ComplexArray:
        """The slopes of G from those of the blocks' v (angles x unknowns of the block x m_i x m_i), block by block."""
        _, L, R = self.weighted.factors(self.coupling(v, angles), angles)
        parts = []
        for ports, S, slope in zip(self.partition.blocks, self.scaling, slopes, strict=True):
            left = self.T * L[:, :, list(ports)] @ S
            right = S @ R[:, list(ports), :]
            parts.append(left[:, None] @ slope @ right[:, None])
        return np.concatenate(parts, axis=1)

    def physical(self, v: StateSpace, block: int) -> StateSpace:
        """T S v S for a block with B = b kron I: C_j and D stay symmetric, exactly."""
        S, m = self.scaling[block], v.inputs
        parts = [symmetric_part(self.T * S @ v.C[:, j : j + m] @ S) for j in range(0, v.order, m)]
        C = np.concatenate([*parts, np.zeros((m, 0))], axis=1)
        return StateSpace(v.A, v.B, C, symmetric_part(self.T * S @ v.D @ S))

    def storage(self, P: Matrix, block: int) -> Matrix:
        """T^2 (I kron S) P (I kron S): the block's P in physical units, for zeta = (xi - xi_)/T."""
        S = self.scaling[block]
        wide = np.kron(np.eye(len(P) // len(S)), S)
        return symmetric_part(self.T**2 * wide @ P @ wide)


@dataclass(frozen=True)
class PoleBasis:
    """Scalar poles of a block and their orthonormal realisation.

    The sections of one real pole or one conjugate pair are cascaded so that a a^T + b b^T = I (the Takenaka-Malmquist
    basis, [Heuberger2005]_). This is well conditioned even if poles coincide.

    Attributes:
        poles: in the z plane, |p| < 1, each complex pole followed by its conjugate.

    Raises:
        ValueError: a pole is not inside the unit circle, or a complex pole has no conjugate.
    """

    poles: tuple[complex, ...]

    def __post_init__(self) -> None:
        self.sections  # noqa: B018 - raises if the poles are no basis

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
                    raise ValueError(f"pole {pending}: found {p}; expected its conjugate next")
                out.append((1.0, -2.0 * p.real, abs(p) ** 2))
                pending = None
            elif p.imag == 0.0:
                out.append((1.0, -p.real))
            else:
                pending = p
        if pending is not None:
            raise ValueError(f"pole {pending}: found none; expected its conjugate next")
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
        """The number of unknowns in C and D; they come first."""
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
            program: the program that gets the constraints.
            index: unknown k of the block is the program's unknown index[k].
            room: least eigenvalue.
            spare: an unknown of the program that is added to ``room``; None for no addition.
        """
        for constant, linear in self._conditions:
            wide = np.zeros((program.size, *constant.shape))
            wide[index] = linear
            if spare is not None:
                wide[spare] = -np.eye(len(constant))
            program.positive(constant - room * np.eye(len(constant)), wide)

    def margins(self, x: Matrix) -> tuple[float, float]:
        """Least eigenvalues of Pi and of the Schur form; the level is proved if both are positive."""
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


ROOM = 1e-4  # of Lambda: J stays this far from zero, so that the stiffness stays as far below its limit
_ROOM_LEVEL = 1e-5  # of Lambda, in the other conditions of the class


@dataclass(frozen=True, eq=False)
class SpringDamperFamily(Family):
    """Spring-damper couplings; x holds the lower triangles of k and b, block by block.

    In physical units K = S^{-1} k S^{-1}/T and B = S^{-1} b S^{-1}.

    The class is exactly J > 0, J - B >= 0 and, for (10) at the greatest level, with a = 2 kappa share,

        [ a Lambda - Phi_E    -a J       0            ]
        [      .              J + B      sqrt(1-a) J  ]  > 0,      Lambda = Delta_D/(2 kappa),  J = Lambda - (T/2) K.
        [      .                .        Lambda       ]

    Attributes:
        loop: the normalised loop.
        Phi: Phi_E in scaled ports, m x m.
        share: G_hat is (share Delta_D)-OSP.
    """

    loop: NormalisedLoop
    Phi: Matrix
    share: float

    @cached_property
    def _units(self) -> tuple[Matrix, ...]:
        return tuple(symmetric_units(len(ports)) for ports in self.loop.partition.blocks)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return 2 * sum(len(units) for units in self._units)

    @property
    def affine(self) -> bool:
        """False: the response is not affine in k and b."""
        return False

    def grid(self, x: Matrix) -> Matrix:
        """Angles that resolve the poles of the loop and of the coupling."""
        return self.loop.grid(self.coupling(x).realisation(self.loop.T))

    def matrices(self, x: Matrix) -> list[tuple[Matrix, Matrix]]:
        """(k, b) of each block."""
        out, at = [], 0
        for units in self._units:
            count = len(units)
            k, b = x[at : at + count], x[at + count : at + 2 * count]
            out.append((np.tensordot(k, units, axes=1), np.tensordot(b, units, axes=1)))
            at += 2 * count
        return out

    def coupling(self, x: Matrix) -> SpringDamper:
        """The coupling in physical units."""
        K, B = [], []
        for (k, b), S in zip(self.matrices(x), self.loop.scaling, strict=True):
            inverse = np.linalg.inv(S)
            K.append(symmetric_part(inverse @ k @ inverse / self.loop.T))
            B.append(symmetric_part(inverse @ b @ inverse))
        partition = self.loop.partition
        return SpringDamper(partition.embed(K), partition.embed(B))

    def _blocks(self, x: Matrix, angles: Matrix) -> tuple[list[ComplexArray], ComplexArray]:
        s = (1.0 - np.exp(-1j * angles))[:, None, None]
        return [np.linalg.inv(k + b * s) for k, b in self.matrices(x)], s

    def responses(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """G at ``angles``."""
        v, _ = self._blocks(x, angles)
        return self.loop.weighted.factors(self.loop.coupling(v, angles), angles)[0]

    def derivatives(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """The slopes of G at ``angles``."""
        v, s = self._blocks(x, angles)
        slopes = []
        for v_i, units in zip(v, self._units, strict=True):
            stiff = -v_i[:, None] @ units @ v_i[:, None]
            slopes.append(np.concatenate([stiff, s[:, None] * stiff], axis=1))
        return self.loop.derivatives(v, slopes, angles)

    def conditions(self, x: Matrix) -> tuple[Matrix, ...]:
        """The left-hand sides, to be positive: k, J, J - B of each block, then (10)'s for all ports."""
        half = 0.5 / self.loop.kappa  # Lambda in scaled ports
        m, a = self.loop.partition.size, 2.0 * self.loop.kappa * self.share
        J, B, out = [], [], []
        for k, b in self.matrices(x):
            I = np.eye(len(k))
            J.append(half * I - k / 2.0)
            B.append(b)
            out += [k - ROOM * half * I, J[-1] - ROOM * half * I, J[-1] - b - _ROOM_LEVEL * half * I]
        J_all, B_all, I = self.loop.partition.embed(J), self.loop.partition.embed(B), np.eye(m)
        rows = [[a * half * I - self.Phi, -a * J_all], [-a * J_all, J_all + B_all]]
        if a < 1.0:
            side = np.sqrt(1.0 - a) * J_all
            rows = [[*rows[0], np.zeros((m, m))], [*rows[1], side], [np.zeros((m, m)), side, half * I]]
        whole = np.block(rows)
        return (*out, whole - _ROOM_LEVEL * half * np.eye(len(whole)))

    @cached_property
    def _coefficients(self) -> tuple[tuple[Matrix, Matrix], ...]:
        count = len(self.conditions(np.zeros(self.size)))

        def condition(i: int) -> tuple[Matrix, Matrix]:
            return coefficients(lambda x: self.conditions(x)[i], self.size)

        return tuple(condition(i) for i in range(count))

    def constrain(self, program: LinearMatrixProgram, x: Matrix) -> None:
        """Require the conditions of the class, exactly."""
        for constant, linear in self._coefficients:
            wide = np.zeros((program.size, *constant.shape))
            wide[: self.size] = linear
            program.positive(constant, wide)

    def stiffest(self) -> Matrix:
        """The member with the greatest trace of k; see :meth:`cheapest`."""
        unit = np.eye(self.size)
        cost = np.array([-sum(float(np.trace(k)) for k, _ in self.matrices(row)) for row in unit])
        return self.cheapest(cost, "the stiffest spring-damper coupling")

    def trust(self, x: Matrix, radius: float) -> tuple[Matrix, Matrix]:
        """Bounds with which every entry of k and b moves by at most the part ``radius`` of Lambda."""
        span = radius / (2.0 * self.loop.kappa)
        return x - span, x + span

    def restored(self, x: Matrix) -> Matrix | None:
        """The unknowns x themselves, because the program keeps the conditions with room."""
        return x


@dataclass(frozen=True, eq=False)
class FixedPoleFamily(Family):
    """Linear couplings over given poles; x holds the gains of all blocks, then their storage matrices.

    Attributes:
        loop: the normalised loop.
        blocks: the unknowns of each block.
        room: least eigenvalue asked of the blocks' conditions.
    """

    loop: NormalisedLoop
    blocks: tuple[FixedPoleBlock, ...]
    room: float

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return sum(block.size for block in self.blocks)

    @property
    def affine(self) -> bool:
        """Whether the aim is loop shaping, which is affine in the gains."""
        return self.loop.aim.objective == "loop-shaping"

    def grid(self, x: Matrix) -> Matrix:
        """Angles that resolve the poles of the loop and of the coupling."""
        return self.loop.grid(self.coupling(x))

    def coupling(self, x: Matrix) -> StateSpace:
        """V in physical units."""
        blocks = zip(self.blocks, self.parts(x), strict=True)
        return self.loop.partition.join(
            [self.loop.physical(block.realisation(part), i) for i, (block, part) in enumerate(blocks)]
        )

    @cached_property
    def _sizes(self) -> tuple[Matrix, ...]:
        """For each block, the greatest modulus of each gain's function."""
        return tuple(
            block.sizes(frequency_grid(np.array(block.basis.poles, dtype=np.complex128))) for block in self.blocks
        )

    @cached_property
    def positions(self) -> tuple[NDArray[np.intp], ...]:
        """The indices of each block's unknowns in x."""
        out, gains, rest = [], 0, sum(block.gains for block in self.blocks)
        for block in self.blocks:
            storage = block.size - block.gains
            out.append(np.concatenate([np.arange(gains, gains + block.gains), np.arange(rest, rest + storage)]))
            gains, rest = gains + block.gains, rest + storage
        return tuple(out)

    def parts(self, x: Matrix) -> list[Matrix]:
        """Each block's unknowns."""
        return [x[position] for position in self.positions]

    def joined(self, parts: Sequence[Matrix]) -> Matrix:
        """The vector of unknowns from each block's unknowns."""
        x = np.zeros(self.size)
        for position, part in zip(self.positions, parts, strict=True):
            x[position] = part
        return x

    def _slopes(self, angles: Matrix) -> list[ComplexArray]:
        return [block.derivatives(angles) for block in self.blocks]

    def _blocks(self, x: Matrix, slopes: Sequence[ComplexArray]) -> list[ComplexArray]:
        return [
            np.tensordot(slope, part[: block.gains], axes=((1,), (0,)))
            for block, part, slope in zip(self.blocks, self.parts(x), slopes, strict=True)
        ]

    def responses(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """G at ``angles``."""
        V = self.loop.coupling(self._blocks(x, self._slopes(angles)), angles)
        return self.loop.weighted.factors(V, angles)[0]

    def derivatives(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """The slopes of G at ``angles``."""
        slopes = self._slopes(angles)
        return self.loop.derivatives(self._blocks(x, slopes), slopes, angles)

    def constrain(self, program: LinearMatrixProgram, x: Matrix) -> None:
        """Require the conditions of every block, exactly."""
        for block, position in zip(self.blocks, self.positions, strict=True):
            block.constrain(program, position, self.room)

    def trust(self, x: Matrix, radius: float) -> tuple[Matrix, Matrix]:
        """Bounds with which gains move by the part ``radius`` of the block's static compliance, by function size."""
        spans = []
        for block, part, sizes in zip(self.blocks, self.parts(x), self._sizes, strict=True):
            static = np.tensordot(part[: block.gains], block.derivatives(np.zeros(1))[0].real, axes=1)
            spans.append(radius * max(float(np.max(np.abs(static))), block.kappa) / sizes)
        gains, span = self.gains(x), np.concatenate(spans)
        return gains - span, gains + span

    def restored(self, x: Matrix) -> Matrix | None:
        """The unknowns x themselves, because the program keeps the conditions with room."""
        return x

    def gains(self, x: Matrix) -> Matrix:
        """C and D of all blocks."""
        return x[: sum(block.gains for block in self.blocks)]

    def nearest(self, gains: Matrix) -> Matrix:
        """The member whose gains are nearest to ``gains``, each weighted by the size of its function.

        Raises:
            ProgramInfeasible: the family is empty.
            SolverFailure: the solver gave no usable answer.
        """
        count = len(gains)
        program = LinearMatrixProgram(self.size + 1)
        self.constrain(program, np.zeros(self.size))
        rows = np.zeros((count, self.size + 1))
        rows[:, :count] = np.diag(np.concatenate(self._sizes))
        offset = rows[:, :count] @ gains
        rows[:, -1] = 1.0
        program.nonnegative(-offset, rows)
        rows = -rows
        rows[:, -1] = 1.0
        program.nonnegative(offset, rows)
        cost = np.zeros(self.size + 1)
        cost[-1] = 1.0
        return program.solve(cost, "the nearest passive coupling")[:-1]

    def stiffest(self) -> Matrix:
        """The member with the least static compliance, trace v(1) summed over the blocks; see :meth:`cheapest`."""
        traces = [np.trace(b.derivatives(np.zeros(1))[0].real, axis1=1, axis2=2) for b in self.blocks]
        cost = np.zeros(self.size)
        cost[: sum(len(t) for t in traces)] = np.concatenate(traces)
        return self.cheapest(cost, "the stiffest linear coupling")

    def roomiest(self, most: float) -> Matrix:
        """The member with the most room in every condition, among those with v(1) <= ``most`` kappa I.

        Raises:
            ProgramInfeasible: the family has no such member.
            SolverFailure: the solver gave no usable answer.
        """
        program = LinearMatrixProgram(self.size + 1)
        for block, position in zip(self.blocks, self.positions, strict=True):
            block.constrain(program, position, self.room, spare=self.size)
            static = block.derivatives(np.zeros(1))[0].real
            linear = np.zeros((self.size + 1, block.ports, block.ports))
            linear[position[: block.gains]] = -static
            program.positive(most * block.kappa * np.eye(block.ports), linear)
        row = np.zeros((1, self.size + 1))
        row[0, -1] = 1.0
        program.nonnegative(np.zeros(1), row)
        cost = np.zeros(self.size + 1)
        cost[-1] = -1.0
        return program.solve(cost, "a linear coupling with room")[:-1]
