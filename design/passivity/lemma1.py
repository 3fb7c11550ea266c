"""Lemma 1 of [Bianchini2010]_ as an analysis: is a given system Delta-OSP and Phi-ISP?

Sigma = (A, B, C, D) has the levels Delta and Phi (Definitions 1, 2) iff some P > 0 satisfies M(P) <= 0, the
inequality (2). The analysis has one of three results, and none of them relies on the solver's status:

- *yes*, with P, which is checked in the inequality: P > 0, the neutral equalities of
  :mod:`manyhands.design.passivity.storage` hold up to rounding, and M(P) < 0 on a complement of the neutral pairs;
- *no*, because a pair on the unit circle draws energy (at a frequency), because the neutral equalities contradict each
  other, or because a moment matrix Z >= 0 of (psi, w) has a state that does not shrink while it draws energy,

      Y = [A, B] Z [A, B]^T - [I, 0] Z [I, 0]^T >= 0    and    tr(Q Z) < 0  (or = 0 with Y not 0),

  which no P > 0 allows, since 0 >= tr(Z M(P)) = tr(P Y) - tr(Q Z);
- *undecided*, a :class:`~manyhands.design.errors.SolverFailure`: the system is too near to the edge for floating point.

Continuous systems (Definition 1) are analysed as the discrete systems with the same P,
:mod:`manyhands.design.models.statespace`.

**Unreachable motions.** Some motions are neither caused by the inputs nor visible at the outputs. Two equal masses on
equal springs at one port, for example, can swing against each other. Such a motion, psi_u+ = A_u psi_u, is independent
of the rest,

    psi = T (psi_f, psi_u),    T^{-1} A T = diag(A_f, A_u),    T^{-1} B = (B_f, 0),    C T = (C_f, 0),

so that Lemma 1 separates, too. A storage matrix of the whole system exists iff the reachable part (A_f, B_f, C_f, D)
has one, at the same levels, and some P_u > 0 has A_u^T P_u A_u <= P_u. The ports do not determine the size of P_u, and
this freedom makes a program for both parts at once ill-conditioned.

The unreachable motions are found as a subspace N that is invariant and unobservable, complementary to an invariant
subspace that contains every state which the inputs can reach, the kernel of L^T. A staircase finds each of the two,
with one singular value decomposition and one rank decision for each step. N is used if L^T N is square and far from
singular, which holds for reciprocal systems such as networks. Otherwise the system is not separated.

**Coordinates.** Solvers are more reliable if storage is near I and gains are near 1. States psi' = X psi and ports
u' = S^{-1} u, y' = S y, with S diagonal, do not change the exchanged power y^T u:

    A' = X A X^{-1},  B' = X B S,  C' = S C X^{-1},  D' = S D S,
    P' = X^{-T} P X^{-1},  Delta' = S^{-1} Delta S^{-1},  Phi' = S Phi S.

X comes from P_g = W_c^{-1} # W_o, the geometric mean of the Gramians. P_g has the unit of an energy over the square of
a state, whatever the units of states and ports, and P_g = X^T X is I in the new states. When a storage matrix P is
known, its own factor is a better X (:func:`with_storage`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance, solve_discrete_lyapunov

from manyhands.design import convex as cp
from manyhands.design.errors import SolverFailure
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.statespace import (
    Matrix,
    StateSpace,
    Time,
    frequency_of,
    in_discrete_time,
    matrix,
    require_state_space,
    storage_inequality,
    symmetric_part,
)
from manyhands.design.passivity.frequency import generic_points, least_ratio, pairs_at, special_points, supply_form
from manyhands.design.passivity.storage import StorageFace, storage_face_of
from manyhands.design.solver import ProgramInfeasible, affine, solve, value

# Coordinates

_INSIDE = 0.9995  # an A of greater spectral radius is shrunk to this radius, so that the Gramians exist
_UNSEEN = 1e-9  # part of the largest eigenvalue of a Gramian below which a direction counts as unobservable


@dataclass(frozen=True, eq=False)
class Scaled:
    """A discrete system in scaled coordinates.

    Attributes:
        system: the scaled system.
        X: n x n, scaled states = X states.
        S: the diagonal of S, m entries.
    """

    system: StateSpace
    X: Matrix
    S: Matrix

    def output_level(self, Delta: Matrix) -> Matrix:
        """Delta' of a level Delta, m x m."""
        return np.asarray(Delta / np.outer(self.S, self.S))

    def input_level(self, Phi: Matrix) -> Matrix:
        """Phi' of a level Phi, m x m."""
        return np.asarray(Phi * np.outer(self.S, self.S))

    def storage(self, P: Matrix) -> Matrix:
        """P of a storage matrix P' found in scaled states."""
        return symmetric_part(self.X.T @ P @ self.X)


def scaled(system: StateSpace) -> Scaled:
    """A discrete ``system`` in ports and states scaled by its own gains and Gramians."""
    d = state_units(system)
    system = StateSpace(system.A * d / d[:, None], system.B / d[:, None], system.C * d, system.D)
    controllable, observable = _gramians(system)
    through = np.abs(np.diag(system.D))
    energy_in = np.sqrt(np.maximum(np.diag(system.B.T @ observable @ system.B), 0.0))
    energy_out = np.sqrt(np.maximum(np.diag(system.C @ controllable @ system.C.T), 0.0))
    gain = np.maximum(through, np.sqrt(energy_in * energy_out))
    gain = np.where(gain > 0.0, gain, max(float(np.max(np.abs(system.D), initial=0.0)), float(np.max(gain)), 1e-300))
    S = np.exp2(-np.round(np.log2(np.where(gain > 1e-290, gain, 1.0)) / 2.0))
    own = _changed(system, _factor(_mean(controllable, observable)), np.asarray(S))
    return Scaled(own.system, own.X / d, own.S)


def with_storage(system: StateSpace, P: Matrix, S: Matrix) -> Scaled:
    """A discrete ``system`` in states where its positive definite ``P`` is I, and in ports scaled by diag(``S``).

    Raises:
        numpy.linalg.LinAlgError: P is not positive definite.
    """
    return _changed(system, np.asarray(np.linalg.cholesky(symmetric_part(P)).T), S)


def _changed(system: StateSpace, X: Matrix, S: Matrix) -> Scaled:
    inverse = np.linalg.inv(X)
    return Scaled(
        StateSpace(
            X @ system.A @ inverse,
            X @ system.B * S,
            S[:, None] * system.C @ inverse,
            S[:, None] * system.D * S,
        ),
        X,
        S,
    )


def state_units(system: StateSpace) -> Matrix:
    """Powers of two d, n entries: in states psi / d the rows and columns of [A B; C 0] have similar sizes.

    Without them, the Gramian equations of a system in extreme units are too ill-conditioned to be solved.
    """
    n, m = system.order, system.inputs
    joined = np.block([[system.A, system.B], [system.C, np.zeros((system.outputs, m))]])
    _, (d, _) = matrix_balance(joined, permute=False, separate=True)
    return np.asarray(d[:n], dtype=np.float64)


def _gramians(system: StateSpace) -> tuple[Matrix, Matrix]:
    """Controllability and observability Gramians of the system; an A outside the circle is shrunk into it first."""
    n = system.order
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, 0))
    radius = float(np.max(np.abs(np.linalg.eigvals(system.A))))
    A = system.A * (_INSIDE / max(radius, _INSIDE))
    return (
        symmetric_part(solve_discrete_lyapunov(A, system.B @ system.B.T)),
        symmetric_part(solve_discrete_lyapunov(A.T, system.C.T @ system.C)),
    )


def _mean(controllable: Matrix, observable: Matrix) -> Matrix:
    """W_c^{-1} # W_o = W_c^{-1/2} (W_c^{1/2} W_o W_c^{1/2})^{1/2} W_c^{-1/2}, with a floor for small eigenvalues."""
    if controllable.size == 0:
        return controllable
    # one unit for each state first, so that the floor does not depend on units
    d = np.where(np.diag(controllable) > 0.0, np.diag(controllable), 1.0) ** -0.5
    root = _root(controllable * np.outer(d, d))
    middle = _root(root @ (observable / np.outer(d, d)) @ root)
    inverse = np.linalg.inv(root)
    return symmetric_part(inverse @ middle @ inverse) * np.outer(d, d)


def _root(M: Matrix) -> Matrix:
    """The square root of a positive semidefinite matrix, its eigenvalues raised to the floor :data:`_UNSEEN`."""
    values, vectors = np.linalg.eigh(symmetric_part(M))
    floor = _UNSEEN * max(float(values[-1]), 0.0) if values[-1] > 0.0 else 1.0
    return np.asarray(vectors * np.sqrt(np.maximum(values, floor)) @ vectors.T)


def _factor(P: Matrix) -> Matrix:
    """X with X^T X = P."""
    return np.asarray(np.linalg.cholesky(P).T) if P.size else P


# Unreachable motions

_RADIUS_ROUNDING = 1e-11  # a spectral radius this near to 1 counts as on the circle; a port's row this small as zero
UNREACHABLE = 1e-11
"""Relative to A's norm: a smaller coupling to the ports is rounding."""

_APART = 1e-4  # least cosine between N and L; the condition of T stays below its inverse
_INDEPENDENT = 1e-6  # the same for the eigenvectors of a motion whose storage is built mode by mode


@dataclass(frozen=True, eq=False)
class Separated:
    """A discrete system and its unreachable motions.

    Attributes:
        reachable: (A_f, B_f, C_f, D).
        T_inverse: n x n, (psi_f, psi_u) = T_inverse psi.
        P_u: storage matrix of the unreachable motions, A_u^T P_u A_u <= P_u, P_u > 0.
    """

    reachable: StateSpace
    T_inverse: Matrix
    P_u: Matrix

    def storage(self, P_f: Matrix) -> Matrix:
        """The whole system's storage matrix, n x n, from a storage matrix ``P_f`` of the reachable part."""
        reachable, unreachable = self.T_inverse[: len(P_f)], self.T_inverse[len(P_f) :]
        return symmetric_part(reachable.T @ P_f @ reachable + unreachable.T @ self.P_u @ unreachable)


def separated(system: StateSpace, tolerance: float = UNREACHABLE) -> Separated:
    """Separate the unreachable motions of a discrete ``system``, if they have a storage matrix of their own.

    If the system has no such motions, or they have no storage matrix, ``reachable`` is the system itself.

    Args:
        system: (A, B, C, D).
        tolerance: relative to A's norm in balanced units; smaller steps of the staircase count as zero. Above
            :data:`UNREACHABLE`, weakly coupled motions count as unreachable too. A storage matrix found this way may
            still serve the whole system, and the inequality decides that. A refutation of the reachable part does not
            hold for the whole.
    """
    whole = Separated(system, np.eye(system.order), np.zeros((0, 0)))
    if system.order == 0:
        return whole
    d = state_units(system)
    A, B, C = system.A * d / d[:, None], system.B / d[:, None], system.C * d
    N, L = _unobservable(A, C, tolerance), _unobservable(A.T, B.T, tolerance)
    if N.shape != L.shape or N.shape[1] == 0:
        return whole
    if float(np.linalg.svd(L.T @ N, compute_uv=False)[-1]) < _APART:
        return whole
    M = _orthogonal_to(L)
    back = np.linalg.inv(np.hstack([M, N]))
    P_u = storage_of_motion(back[M.shape[1] :] @ A @ N)
    if P_u is None:
        return whole
    reached = back[: M.shape[1]]
    return Separated(StateSpace(reached @ A @ M, reached @ B, C @ M, system.D), back / d, P_u)


def storage_of_motion(A: Matrix) -> Matrix | None:
    """Some P > 0 with A^T P A <= P, n x n, with as much room as possible; None if no P is found.

    If A has independent eigenvectors V, P = (V V^*)^{-1}: every mode loses its own 1 - |z|^2. Otherwise, if A lies
    inside the circle, P solves A^T P A - r^2 P = -I, with r^2 half-way between the square of A's spectral radius and 1.
    """
    values, vectors = np.linalg.eig(A)
    radius = float(np.max(np.abs(values), initial=0.0))
    if radius > 1.0 + _RADIUS_ROUNDING:
        return None
    if float(np.linalg.svd(vectors, compute_uv=False)[-1]) > _INDEPENDENT:
        inverse = np.linalg.inv(vectors)
        return symmetric_part((inverse.conj().T @ inverse).real)
    if radius >= 1.0 - _RADIUS_ROUNDING:
        return None
    r = np.sqrt((1.0 + radius**2) / 2.0)
    return symmetric_part(solve_discrete_lyapunov((A / r).T, np.eye(len(A))))


def _unobservable(A: Matrix, C: Matrix, tolerance: float) -> Matrix:
    """An orthonormal basis, n x d, of the greatest A-invariant subspace in the kernel of C."""
    sizes = np.linalg.norm(C, axis=1)
    # each port is scaled by its own row
    rows = C[sizes > _RADIUS_ROUNDING * max(float(np.max(sizes, initial=0.0)), 1e-300)]
    N = _kernel(rows / np.linalg.norm(rows, axis=1)[:, None], tolerance)
    least = tolerance * max(float(np.linalg.norm(A, 2)), 1e-300)
    while N.shape[1]:
        moved = A @ N
        leaving = moved - N @ (N.T @ moved)
        stay = _kernel(leaving, least)
        if stay.shape[1] == N.shape[1]:
            break
        N = np.linalg.qr(N @ stay)[0] if stay.shape[1] else N[:, :0]
    return N


def _orthogonal_to(L: Matrix) -> Matrix:
    """An orthonormal basis of the kernel of L^T, n x (n - d), for L of d orthonormal columns."""
    return np.asarray(np.linalg.svd(L, full_matrices=True)[0][:, L.shape[1] :])


def _kernel(M: Matrix, tolerance: float) -> Matrix:
    """An orthonormal basis of the directions that M shortens to less than ``tolerance`` of their length."""
    if M.shape[0] == 0:
        return np.eye(M.shape[1])
    _, values, right = np.linalg.svd(M, full_matrices=True)
    return np.asarray(right[int(np.sum(values > tolerance)) :].T)


# The analysis

Pairs = list[tuple[complex, NDArray[np.complex128]]]

_NEUTRAL = 1e-12  # of the supply form's norm: a smaller exchange counts as zero
_REFUTED = 1e-11  # of the supply form's norm: with a supply below minus this, a pair draws energy
_FACE = 1e-8  # relative residual of the neutral equalities
_SUM_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)  # of a sum of a few dozen products, relative to its largest term
_WEAKLY_COUPLED = (1e-8, 1e-5)  # tolerances of :func:`separated` to be tried if the analysis is undecided
_PASSES = 4  # solutions of the program, each in the coordinates of the storage matrix before
_STORAGE_PART = 1e-2  # P >= this times the room in the dissipation, so that P > 0 is strict too
_TRUSTED_GAIN = 1e-7  # energy that a moment matrix must draw, per unit of its trace
_NOTHING = 1e-8  # the solver's own zero, per unit of trace


@dataclass(frozen=True, eq=False)
class Analysis:
    """Whether a system has the given levels, and why.

    Attributes:
        holds: whether the system has the levels.
        P: a storage matrix that proves it, n x n; None if it does not hold.
        margin: if it holds, the least eigenvalue of -M(P) on the complement of the neutral pairs, in states where
            P = I and ports of gain near 1 (0 if the complement is empty, as in a lossless system). If it does not hold,
            the negative supply, in such coordinates, of the pair or moment matrix that refutes it; -inf if the neutral
            equalities contradict each other.
        reason: one sentence.
        frequency: where the system supplies energy, rad a tick or rad/s; None if the refutation has no single
            frequency.
    """

    holds: bool
    P: Matrix | None
    margin: float
    reason: str
    frequency: float | None = None

    __repr__ = brief_repr


def analyse(
    system: StateSpace, Delta: Matrix | None = None, Phi: Matrix | None = None, time: Time = "discrete"
) -> Analysis:
    """Decide whether ``system`` is Delta-OSP and Phi-ISP by Lemma 1; see the module's head.

    Args:
        system: (A, B, C, D), m x m; u and y such that y^T u is a power.
        Delta: m x m symmetric output level; zero by default. In N*s/m where u is a force and y a velocity.
        Phi: m x m symmetric input level; zero by default.
        time: how ``system`` is read.

    Raises:
        ValueError: the system is not square, or a level is not symmetric m x m.
        SolverFailure: the system is too near to the edge for a decision in floating point.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> lag = passivity.StateSpace([[0.5]], [[0.5]], [[1.0]], [[1.0]])
        >>> passivity.analyse(lag).holds, passivity.analyse(lag, Delta=np.array([[1.0]])).holds
        (True, False)
    """
    Delta, Phi = checked_levels(system, Delta, Phi)
    discrete, rate = in_discrete_time(system, time)
    parts = separated(discrete)
    finding = _decide(discrete, parts, Delta, Phi, time, rate)
    if finding is None or not (finding.holds or finding.frequency is not None):
        # The storage matrix is checked on the whole system, so that weakly coupled motions may be separated as well.
        for tolerance in _WEAKLY_COUPLED:
            fewer = separated(discrete, tolerance)
            if fewer.reachable.order < parts.reachable.order:
                parts = fewer
                other = _decide(discrete, parts, Delta, Phi, time, rate)
                if other is not None and other.holds:
                    return other
    if finding is None:
        raise SolverFailure(
            "Lemma 1: the system is too near the edge to be decided in floating point: neither a storage function nor "
            "a refutation survives its check. Ask for slightly lower levels, or state the system in better units"
        )
    return finding


def _decide(
    whole: StateSpace, parts: Separated, Delta: Matrix, Phi: Matrix, time: Time, rate: float
) -> Analysis | None:
    """Analyse the reachable part of a discrete system, and check a positive result on the whole; None: undecided."""
    discrete = parts.reachable
    units = scaled(discrete)
    Q = supply_form(units.system, units.output_level(Delta), units.input_level(Phi))
    size = float(np.linalg.norm(Q, 2))
    if size == 0.0 and discrete.order == 0:
        return Analysis(True, parts.storage(np.zeros((0, 0))), 0.0, "nothing is exchanged at these levels")
    least = least_ratio(units.system, Q, np.eye(len(Q)))
    if least.value < -_REFUTED * size:
        frequency = frequency_of(least.angle, time, rate)
        unit = "rad/s" if time == "continuous" else "rad a tick"
        return Analysis(
            False,
            None,
            least.value,
            f"energy is drawn at {frequency:.4g} {unit}, whatever the storage function",
            frequency,
        )
    refused: Analysis | None = None
    for attempt in range(_PASSES):
        pairs = neutral_pairs_at(units.system, Q, _near(least.angle, least.value, size))
        face = storage_face_of(units.system, -Q, pairs)
        if face is None and attempt:
            break  # in the coordinates of a poor P, pairs that are not neutral look neutral
        if face is None:
            return Analysis(False, None, -np.inf, "the steady states and lossless motions admit no storage function")
        P, refused = _strictest(units, face, Q)
        if P is None:
            break
        try:
            candidate = units.storage(P)
            stored = parts.storage(candidate)
            margin = verified_margin(whole, stored, Delta, Phi)
            if margin is not None:
                return Analysis(True, stored, margin, "a storage function was found and checked")
            units = with_storage(discrete, candidate, units.S)
        except np.linalg.LinAlgError:
            break
        Q = supply_form(units.system, units.output_level(Delta), units.input_level(Phi))
        size = float(np.linalg.norm(Q, 2))
    return refused


def checked_levels(system: StateSpace, Delta: Matrix | None, Phi: Matrix | None) -> tuple[Matrix, Matrix]:
    """The levels as m x m matrices; None becomes zero.

    Raises:
        ValueError: the system is not square, or a level is not symmetric m x m.
    """
    require_state_space(system)
    m = system.inputs
    if system.outputs != m or m == 0:
        raise ValueError(f"found {system.outputs} outputs and {m} inputs; expected as many of both, at least one")
    out = []
    for name, level in (("Delta", Delta), ("Phi", Phi)):
        try:
            found = matrix(np.zeros((m, m)) if level is None else level, m, m)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        if np.any(np.abs(found - found.T) > 1e-12 * np.max(np.abs(found), initial=0.0)):
            raise ValueError(f"{name}: expected a symmetric matrix")
        out.append(symmetric_part(found))
    return out[0], out[1]


def neutral_pairs_at(system: StateSpace, Q: Matrix, extra: list[complex]) -> Pairs:
    """Pairs (z, x) of a discrete system that exchange nothing, x^* Q x = 0, given that x^* Q x >= 0 over the circle.

    The search looks at the special points, at the ``extra`` points, and at generic points. The generic points find
    pairs that are lossless at every frequency.
    """
    tolerance = _NEUTRAL * float(np.linalg.norm(Q, 2))
    pairs: Pairs = []
    generic = generic_points((system.order + system.inputs) // max(system.inputs, 1) + 3)
    for z in [*special_points(system), *extra, *generic]:
        X = pairs_at(system, z)
        values, vectors = np.linalg.eigh(X.conj().T @ Q @ X)
        pairs += [(z, np.asarray(X @ v)) for v in vectors[:, np.abs(values) <= tolerance].T]
    return pairs


def verified_margin(system: StateSpace, P: Matrix, Delta: Matrix, Phi: Matrix) -> float | None:
    """Check ``P`` in Lemma 1 for a discrete ``system``: the margin of :class:`Analysis`, or None if a condition fails.

    Everything is evaluated in states where P = I, so that nothing depends on the units of the realisation.
    """
    n = system.order
    if n and not np.all(np.isfinite(P)):
        return None
    try:
        units = with_storage(system, P, scaled(system).S)
    except np.linalg.LinAlgError:
        return None
    own, Delta, Phi = units.system, units.output_level(Delta), units.input_level(Phi)
    Q = supply_form(own, Delta, Phi)
    size = max(1.0 if n else 0.0, float(np.linalg.norm(Q, 2)))
    M = storage_inequality(own, np.eye(n), Delta, Phi)
    least = least_ratio(own, Q, np.eye(n + own.inputs))
    pairs = neutral_pairs_at(own, Q, _near(least.angle, least.value, float(np.linalg.norm(Q, 2))))
    face = storage_face_of(own, -Q, pairs)
    if face is None:
        return None
    W = face.complement
    if pairs:
        stacked = np.stack([x for _, x in pairs], axis=1)
        if float(np.max(np.abs(M @ stacked))) > _FACE * size:
            return None
    if W.shape[1] == 0:
        return 0.0
    margin = float(np.linalg.eigvalsh(symmetric_part(-W.T @ M @ W))[0])
    return margin if margin > _SUM_ROUNDING * len(M) * size else None


def _near(angle: float, supply: float, size: float) -> list[complex]:
    """The point of least supply, if its supply counts as zero; otherwise no point."""
    return [complex(np.exp(1j * angle))] if abs(supply) <= _NEUTRAL * size else []


def _strictest(units: Scaled, face: StorageFace, Q: Matrix) -> tuple[Matrix | None, Analysis | None]:
    """The P' of a face with the most room in P' > 0 and M(P') < 0; or None, with a checked refutation if possible."""
    system, n = units.system, units.system.order
    W = face.complement
    room, p = cp.Variable(), cp.Variable(max(len(face.directions), 1))
    P = affine(symmetric_part(face.P_0), face.directions, p)
    constraints = [room <= 1.0]
    dissipation = None
    if W.shape[1]:
        M = affine(*dissipation_on(system, face, Q), p)
        dissipation = M << -room * np.eye(W.shape[1])
    positive = P >> _STORAGE_PART * room * np.eye(n) if n else None
    constraints += [c for c in (dissipation, positive) if c is not None]
    try:
        best = solve(cp.Problem(cp.Maximize(room), constraints), "Lemma 1")
    except (ProgramInfeasible, SolverFailure):  # the program is feasible with a negative room, so the solver failed
        return None, None
    found = symmetric_part(value(P)) if best > 0.0 else None
    if best > _NOTHING:
        return found, None
    Z = W @ _clipped(dissipation, W.shape[1]) @ W.T
    return found, _refutation(system, face, Q, Z, _clipped(positive, n))


def dissipation_on(system: StateSpace, face: StorageFace, Q: Matrix) -> tuple[Matrix, Matrix]:
    """W^T M(P) W over a face, P = P_0 + sum_i p_i N_i: the constant part, c x c, and the directions, d x c x c.

    M(P) = [A, B]^T P [A, B] - [I, 0]^T P [I, 0] - Q.
    """
    n, W = system.order, face.complement
    after, before = np.hstack([system.A, system.B]) @ W, W[:n]
    stored = np.concatenate([face.P_0[None], face.directions])
    moved = after.T @ stored @ after - before.T @ stored @ before
    return symmetric_part(moved[0] - W.T @ Q @ W), (moved[1:] + moved[1:].transpose(0, 2, 1)) / 2.0


def _clipped(constraint: cp.Constraint | None, size: int) -> Matrix:
    """A constraint's dual matrix with its negative eigenvalues, which are rounding, removed."""
    if constraint is None or constraint.dual_value is None:
        return np.zeros((size, size))
    values, vectors = np.linalg.eigh(symmetric_part(np.asarray(constraint.dual_value, dtype=np.float64)))
    return np.asarray(vectors * np.maximum(values, 0.0) @ vectors.T)


def _refutation(system: StateSpace, face: StorageFace, Q: Matrix, Z: Matrix, Y: Matrix) -> Analysis | None:
    """Check the moment matrix ``Z`` of the module's head: tr(Z M(P)) > 0 for every P = P_0 + sum p_i N_i >= 0."""
    n = system.order
    G = np.hstack([system.A, system.B])
    growth = symmetric_part(G @ Z @ G.T - Z[:n, :n])
    left_over = growth - Y
    total = float(np.trace(Z) + np.trace(Y))
    if total <= 0.0:
        return None
    drawn = float(np.sum(face.P_0 * left_over) - np.sum(Q * Z)) / total
    off = float(np.linalg.norm(np.tensordot(face.directions, left_over, axes=2))) / total
    if abs(drawn) < _NOTHING and off < _NOTHING and np.trace(Y) > 0.1 * total:
        return Analysis(False, None, 0.0, "every storage function vanishes in some state, so that none is positive")
    if drawn < _TRUSTED_GAIN or off > 1e-3 * drawn:
        return None
    return Analysis(
        False, None, -drawn, "energy can be drawn by a motion that grows: no positive definite storage function exists"
    )
