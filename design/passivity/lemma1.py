"""Lemma 1 of [Bianchini2010]_ as an analysis: is a given system Delta-OSP and Phi-ISP?

Sigma = (A, B, C, D) has the levels Delta and Phi (Definitions 1, 2) iff some P > 0 satisfies M(P) <= 0, the
inequality (2). The answer is one of three, and none of them is the solver's word:

- *yes*, with P, which is put back into the inequality: P > 0, the neutral equalities of
  :mod:`manyhands.design.passivity` at rounding level, and M(P) < 0 on a complement of the neutral pairs;
- *no*, because of a pair on the unit circle that draws energy out (a frequency), because the neutral equalities
  contradict each other, or because of a moment matrix Z >= 0 of (psi, w) whose state does not shrink while it
  draws energy,

      Y = [A, B] Z [A, B]^T - [I, 0] Z [I, 0]^T >= 0    and    tr(Q Z) < 0  (or = 0 with Y not 0),

  which no P > 0 allows, since 0 >= tr(Z M(P)) = tr(P Y) - tr(Q Z);
- *undecided*, a :class:`~manyhands.design.errors.SolverFailure`: too near the edge for floating point.

Continuous systems (Definition 1) are analysed as the discrete ones with the same P, :mod:`manyhands.design.cayley`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from manyhands.design.cayley import Time, frequency_of, in_discrete_time
from manyhands.design.errors import SolverFailure
from manyhands.design.level_sets import (
    generic_points,
    least_ratio,
    pairs_at,
    special_points,
    supply_form,
)
from manyhands.design.passivity import StorageFace, storage_face_of, storage_inequality
from manyhands.design.scaling import Scaled, scaled, with_storage
from manyhands.design.solver import ProgramInfeasible, affine, solve, value
from manyhands.design.statespace import Matrix, StateSpace, matrix, symmetric_part
from manyhands.design.unfelt import Parted, parted

Pairs = list[tuple[complex, NDArray[np.complex128]]]

_NEUTRAL = 1e-12  # of the supply form's norm: an exchange below that is none
_REFUTED = 1e-11  # of the same: a supply below minus this is energy drawn
_FACE = 1e-8  # relative residual of the neutral equalities
_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)  # of a sum of a few dozen products, relative to its largest term
_HARDLY_FELT = (1e-8, 1e-5)  # as far as motions are left to themselves where nothing else leads to an answer
_PASSES = 4  # solutions of the program, each in the coordinates that the one before suggests
_STORAGE_PART = 1e-2  # P >= this times the room in the dissipation: both strict where one can be
_TRUSTED_GAIN = 1e-7  # energy that a moment matrix must draw, per unit of its trace
_NOTHING = 1e-8  # the solver's own zero, per unit of trace


@dataclass(frozen=True, eq=False)
class Analysis:
    """Whether a system has the levels asked for, and why.

    Attributes:
        holds: whether it has.
        P: a storage matrix that proves it, n x n; None when it does not hold.
        margin: when it holds, the least eigenvalue of -M(P) on the complement of the neutral pairs, in states where
            P = I and ports of gain near 1 (0 where nothing is left, as in a lossless system). When it does not, the
            negative supply, in such coordinates, of the pair or moment matrix that refutes it; -inf where the
            neutral equalities contradict each other.
        reason: one sentence.
        frequency: where energy is drawn, rad a tick or rad/s; None when it is not a matter of one frequency.
    """

    holds: bool
    P: Matrix | None
    margin: float
    reason: str
    frequency: float | None = None


def analyse(
    system: StateSpace, Delta: Matrix | None = None, Phi: Matrix | None = None, time: Time = "discrete"
) -> Analysis:
    """Decide whether ``system`` is Delta-OSP and Phi-ISP, Lemma 1; see the module.

    Args:
        system: (A, B, C, D), m x m; u and y such that y^T u is a power.
        Delta: m x m symmetric output level; zero by default. In N*s/m where u is a force and y a velocity.
        Phi: m x m symmetric input level; zero by default.
        time: how ``system`` is read.

    Raises:
        ValueError: the system is not square, or a level not symmetric m x m.
        SolverFailure: too near the edge to be decided in floating point.
    """
    Delta, Phi = checked_levels(system, Delta, Phi)
    discrete, rate = in_discrete_time(system, time)
    parts = parted(discrete)
    finding = _decide(discrete, parts, Delta, Phi, time, rate)
    if finding is None or not (finding.holds or finding.frequency is not None):
        # with a storage matrix that is checked on the whole, what is felt a little may be left to itself, too
        for tolerance in _HARDLY_FELT:
            fewer = parted(discrete, tolerance)
            if fewer.felt.order < parts.felt.order:
                parts = fewer
                other = _decide(discrete, parts, Delta, Phi, time, rate)
                if other is not None and other.holds:
                    return other
    if finding is None:
        raise SolverFailure(
            "Lemma 1: too near the edge to be decided in floating point: neither a storage function nor a refutation "
            "survives its check. Ask for slightly lower levels, or state the system in better units"
        )
    return finding


def _decide(whole: StateSpace, parts: Parted, Delta: Matrix, Phi: Matrix, time: Time, rate: float) -> Analysis | None:
    """Decide it for the felt part of a discrete system, and where the answer is yes check it on the whole."""
    discrete = parts.felt
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
            break  # the coordinates of a poor P make neutral what is not
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
    """The levels as m x m matrices, zero where None.

    Raises:
        ValueError: the system is not square, or a level not symmetric m x m.
    """
    m = system.inputs
    if system.outputs != m or m == 0:
        raise ValueError(f"expected as many outputs as inputs, at least one, found {system.outputs} and {m}")
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
    """Pairs (z, x) of a discrete system that exchange nothing, x^* Q x = 0, where x^* Q x >= 0 over the circle.

    Looked for at the special points, at ``extra`` ones, and at generic ones, which find what is lossless at every
    frequency.
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
    """Put ``P`` into Lemma 1 for a discrete ``system``: the margin of :class:`Analysis`, or None when it fails.

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
    return margin if margin > _ROUNDING * len(M) * size else None


def _near(angle: float, supply: float, size: float) -> list[complex]:
    """The point of least supply, where that is nothing."""
    return [complex(np.exp(1j * angle))] if abs(supply) <= _NEUTRAL * size else []


def _strictest(units: Scaled, face: StorageFace, Q: Matrix) -> tuple[Matrix | None, Analysis | None]:
    """The P' of a face with the most room in P' > 0 and M(P') < 0; or None and, where it survives, a refutation."""
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
    except (ProgramInfeasible, SolverFailure):  # always feasible, at a negative room: the solver stumbled
        return None, None
    found = symmetric_part(value(P)) if best > 0.0 else None
    if best > _NOTHING:
        return found, None
    Z = W @ _clipped(dissipation, W.shape[1]) @ W.T
    return found, _refutation(system, face, Q, Z, _clipped(positive, n))


def dissipation_on(system: StateSpace, face: StorageFace, Q: Matrix) -> tuple[Matrix, Matrix]:
    """W^T M(P) W over a face, P = P_0 + sum_i p_i N_i: its constant, c x c, and its directions, d x c x c.

    M(P) = [A, B]^T P [A, B] - [I, 0]^T P [I, 0] - Q.
    """
    n, W = system.order, face.complement
    after, before = np.hstack([system.A, system.B]) @ W, W[:n]
    stored = np.concatenate([face.P_0[None], face.directions])
    moved = after.T @ stored @ after - before.T @ stored @ before
    return symmetric_part(moved[0] - W.T @ Q @ W), (moved[1:] + moved[1:].transpose(0, 2, 1)) / 2.0


def _clipped(constraint: cp.Constraint | None, size: int) -> Matrix:
    """A constraint's dual matrix, its negative eigenvalues (rounding) removed."""
    if constraint is None or constraint.dual_value is None:
        return np.zeros((size, size))
    values, vectors = np.linalg.eigh(symmetric_part(np.asarray(constraint.dual_value, dtype=np.float64)))
    return np.asarray(vectors * np.maximum(values, 0.0) @ vectors.T)


def _refutation(system: StateSpace, face: StorageFace, Q: Matrix, Z: Matrix, Y: Matrix) -> Analysis | None:
    """Check the moment matrix ``Z`` of the module: with it, tr(Z M(P)) > 0 for every P = P_0 + sum p_i N_i >= 0."""
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
