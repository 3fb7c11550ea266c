"""The best passivity levels of a system: the greatest Delta with which it is OSP, the greatest Phi for ISP.

Both levels are searched with Lemma 1 of [Bianchini2010]_, in which the level enters linearly,

    maximise  d (level d I)   or   trace of the level    subject to   P > 0,  M(P) <= 0.

The level may be negative: the system then lacks so much passivity. The optimum of the program lies on an edge. So the
level is lowered, as little as possible, until :func:`~manyhands.design.passivity.lemma1.analyse` finds and checks a
storage matrix. The returned level is proved. For the shape "scalar" it comes with a bound that no storage matrix can
exceed,

    d <= least (w^* y - w^* Phi w) / y^* y    (output),      d <= least (w^* y - y^* Delta y) / w^* w    (input)

over all pairs of the unit circle, exactly (:mod:`manyhands.design.passivity.frequency`).

Some directions have no positive level in any case: the output of an undamped mode (an integrator of E_hat), and the
input at a zero on the circle (the differentiator of V_hat). If the level 0 is possible in such directions, it is set
exactly, and the search continues in the other directions.

**The program.** The level is L = sum_a p_a L_a with given symmetric L_a. The aim is d = p for L = d I, and the trace of
L otherwise. The program is solved in scaled coordinates (:mod:`manyhands.design.passivity.lemma1`), and then again in
the coordinates of the storage matrix that it has found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from manyhands.design import convex as cp
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import Partition
from manyhands.design.models.statespace import Matrix, StateSpace, Time, in_discrete_time, symmetric_part
from manyhands.design.passivity.frequency import (
    generic_points,
    input_rows,
    least_ratio,
    output_rows,
    pairs_at,
    special_points,
    supply_form,
)
from manyhands.design.passivity.lemma1 import (
    Pairs,
    Scaled,
    analyse,
    checked_levels,
    dissipation_on,
    scaled,
    with_storage,
)
from manyhands.design.passivity.storage import kernel, storage_face_of
from manyhands.design.solver import ProgramInfeasible, affine, solve, value

Role = Literal["output", "input"]

_LOWERED = (1e-7, 1e-6, 1e-5, 1e-4)  # of the level's scale; the first that leaves room for a checked storage matrix
_SILENT = 1e-9  # of the largest: a smaller output or input counts as zero
_NEUTRAL = 1e-12  # of the supply form's norm
_PASSES = 3  # solutions of the program, each in the coordinates of the storage matrix before
_SETTLED = 1e-6  # relative: a pass that gains less is the last
_LEAST_STORAGE = 1e-9
_VERY_LOW = (1e4, 1e3, 1e2)  # times the natural size of a level: without a level above minus this, a system has none


@dataclass(frozen=True, eq=False)
class ProvedLevel:
    """A level with its proof.

    Attributes:
        matrix: the level, m x m: N*s/m for an output level of a system from force to velocity.
        value: what was maximised: d for the shape "scalar", the trace for the others.
        P: the storage matrix that proves it, n x n.
        bound: no greater d is possible (exact over frequency, up to its rounding); None for shapes other than "scalar".
            If a level is well below its bound, P > 0 limits it.
    """

    matrix: Matrix
    value: float
    P: Matrix
    bound: float | None

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class Search:
    """The data of one search for a level.

    Attributes:
        system: the system as given.
        time: how it is read.
        discrete: the same system in discrete time.
        role: which level is searched.
        fixed: the given level of the other role, m x m.
        basis: symmetric matrices, k x m x m, whose span is the shape of the level.
        scalar: whether d is maximised; otherwise the trace.
    """

    system: StateSpace
    time: Time
    discrete: StateSpace
    role: Role
    fixed: Matrix
    basis: Matrix
    scalar: bool

    def levels(self, level: Matrix) -> tuple[Matrix, Matrix]:
        """(Delta, Phi) with ``level`` in the searched role."""
        return (level, self.fixed) if self.role == "output" else (self.fixed, level)

    def in_units(self, units: Scaled, level: Matrix, role: Role) -> Matrix:
        """The ``level`` of this role in scaled ports, m x m."""
        return units.output_level(level) if role == "output" else units.input_level(level)

    def supply(self, units: Scaled) -> Matrix:
        """Q in scaled coordinates without the searched level."""
        fixed = self.in_units(units, self.fixed, "input" if self.role == "output" else "output")
        return supply_form(units.system, *((None, fixed) if self.role == "output" else (fixed, None)))

    def rows(self, units: Scaled) -> Matrix:
        """The signal that the searched level weights, y or u, as rows over (psi, u)."""
        return output_rows(units.system) if self.role == "output" else input_rows(units.system)


def frequency_bound(search: Search) -> float:
    """The least of (supply without the searched level) over y^* y (or w^* w): no d I above it is a level."""
    units = scaled(search.discrete)
    back = 1.0 / units.S if search.role == "output" else units.S
    return least_ratio(units.system, search.supply(units), back[:, None] * search.rows(units)).value


def idle_directions(search: Search) -> Matrix:
    """Directions, m x k, in which the searched level cannot be positive.

    They are the y (or u) of pairs that exchange nothing at the level 0. At a positive level, such a pair would supply
    energy.
    """
    units = scaled(search.discrete)
    Q, rows = search.supply(units), search.rows(units)
    back = 1.0 / units.S if search.role == "output" else units.S  # back to unscaled ports
    seen_by = back[:, None] * rows
    found = []
    for z in _points(units.system):
        X = pairs_at(units.system, z)
        values, vectors = np.linalg.eigh(X.conj().T @ Q @ X)
        quiet = X @ vectors[:, np.abs(values) <= _NEUTRAL * np.linalg.norm(Q, 2)]
        seen = seen_by @ quiet
        found += [seen.real, seen.imag]
    stacked = np.hstack(found)
    if stacked.shape[1] == 0:
        return stacked
    left, sizes, _ = np.linalg.svd(stacked, full_matrices=False)
    return np.asarray(left[:, sizes > _SILENT * np.linalg.norm(seen_by, 2)])


def _points(system: StateSpace) -> list[complex]:
    return [*special_points(system), *generic_points((system.order + system.inputs) // system.inputs + 3)]


def best_level(search: Search, bound: float | None) -> ProvedLevel | None:
    """The best level in the span of a search; None if the span has no level."""
    units = scaled(search.discrete)
    if len(search.basis) == 0:
        m = search.system.inputs
        analysis = analyse(search.system, *search.levels(np.zeros((m, m))), search.time)
        return None if analysis.P is None else ProvedLevel(np.zeros((m, m)), 0.0, analysis.P, bound)
    best: ProvedLevel | None = None
    for _ in range(_PASSES):
        try:
            optimum = _optimum(search, units)
        except (ProgramInfeasible, SolverFailure):
            break
        if optimum is None:
            break
        found = _proved(search, units, optimum[0], bound)
        settled = found is not None and best is not None and found.value - best.value <= _SETTLED * abs(best.value)
        if found is not None and (best is None or found.value > best.value):
            best = found
        if settled or (best is not None and bound is not None and bound - best.value <= _SETTLED * abs(bound)):
            return best
        try:
            units = with_storage(search.discrete, optimum[1] if best is None else best.P, units.S)
        except np.linalg.LinAlgError:
            break
    if best is None and not _hopeless(search, units):
        raise SolverFailure("neither the best level found nor slightly lower levels survive their check")
    return best


def _hopeless(search: Search, units: Scaled) -> bool:
    """Whether even a very low level is refuted, and with it every level above that."""
    _, down = _downwards(search, units)
    for low in _VERY_LOW:
        try:
            return not analyse(search.system, *search.levels(-low * down), search.time).holds
        except SolverFailure:
            continue  # floating point may not decide so low a level: try a higher one
    return False


def _downwards(search: Search, units: Scaled) -> tuple[Matrix, Matrix]:
    """The span's basis in scaled ports, and the span's level that is nearest to I there, in unscaled ports."""
    own = np.stack([search.in_units(units, L, search.role) for L in search.basis])
    nearest = np.linalg.lstsq(own.reshape(len(own), -1).T, np.eye(own.shape[1]).ravel(), rcond=None)[0]
    return own, symmetric_part(np.tensordot(nearest, search.basis, axes=1))


def _optimum(search: Search, units: Scaled) -> tuple[Matrix, Matrix] | None:
    """The program's best level and storage matrix, in unscaled ports and states; None if the span has no level."""
    system = units.system
    Q, rows = search.supply(units), search.rows(units)
    own, _ = _downwards(search, units)
    sizes = np.array([np.linalg.norm(L, 2) for L in own])
    own = own / sizes[:, None, None]
    face = storage_face_of(system, -Q, _always_neutral(system, Q, own @ rows))
    if face is None:
        return None
    stored, k = len(face.directions), len(own)
    p, q = cp.Variable(stored + k), np.zeros((k, system.order, system.order))
    P = affine(symmetric_part(face.P_0), np.concatenate([face.directions, q]), p)
    constant, directions = dissipation_on(system, face, Q)
    seen = rows @ face.complement
    constraints = []
    if seen.shape[1]:
        constraints.append(affine(constant, np.concatenate([directions, seen.T @ own @ seen]), p) << 0)
    if system.order:
        constraints.append(P >> _LEAST_STORAGE * np.eye(system.order))
    weights = np.array([1.0 if search.scalar else np.trace(L) for L in search.basis]) / sizes
    weights /= max(float(np.max(np.abs(weights))), 1e-300)
    solve(cp.Problem(cp.Maximize(weights @ p[stored:]), constraints), f"the greatest {search.role} level")
    level = np.tensordot(value(p)[stored:] / sizes, search.basis, axes=1)
    return symmetric_part(level), units.storage(symmetric_part(value(P)))


def _always_neutral(system: StateSpace, Q: Matrix, seen: Matrix) -> Pairs:
    """Pairs that exchange nothing at any level of the span: the supply without the level and ``seen`` x both vanish."""
    pairs: Pairs = []
    scale = float(np.linalg.norm(Q, 2))
    for z in _points(system):
        X = pairs_at(system, z)
        stacked = np.vstack([X.conj().T @ Q @ X / max(scale, 1e-300), *(rows @ X for rows in seen)])
        _, sizes, right = np.linalg.svd(stacked)
        pairs += [(z, np.asarray(X @ v.conj())) for v in right[int(np.sum(sizes > _NEUTRAL)) :]]
    return pairs


def _proved(search: Search, units: Scaled, level: Matrix, bound: float | None) -> ProvedLevel | None:
    """A level slightly below ``level`` with a checked storage matrix; None if none is found."""
    _, down = _downwards(search, units)
    size = max(1.0, float(np.linalg.norm(search.in_units(units, level, search.role), 2)))
    for part in _LOWERED:
        lowered = symmetric_part(level - part * size * down)
        try:
            analysis = analyse(search.system, *search.levels(lowered), search.time)
        except SolverFailure:
            continue  # too near to the edge for floating point: try a lower level
        if analysis.P is not None:
            figure = float(lowered[0, 0]) if search.scalar else float(np.trace(lowered))
            return ProvedLevel(lowered, figure, analysis.P, bound)
    return None


Shape = Literal["scalar", "diagonal", "matrix"] | Partition
"""d I; a diagonal; any symmetric matrix; one with the block structure of a partition."""


def greatest_output_level(
    system: StateSpace, shape: Shape = "scalar", Phi: Matrix | None = None, time: Time = "discrete"
) -> ProvedLevel:
    """The greatest Delta with which ``system`` is Delta-OSP (and Phi-ISP): greatest d, or greatest trace.

    Args:
        system: (A, B, C, D), m x m.
        shape: which Delta are allowed; d is maximised for "scalar", the trace for the others.
        Phi: m x m input level that has to hold at the same time; zero by default.
        time: how ``system`` is read.

    Raises:
        Infeasible: no level of this shape exists.
        ValueError: an argument has the wrong shape, or the output is zero in some direction, where any level holds.
        SolverFailure: the solver gave no usable answer.

    Example:
        >>> from manyhands import passivity
        >>> lag = passivity.StateSpace([[0.5]], [[0.5]], [[1.0]], [[1.0]])
        >>> print(f"{passivity.greatest_output_level(lag).value:.4f}")
        0.5000
    """
    return _greatest(system, shape, "output", Phi, time)


def greatest_input_level(
    system: StateSpace, shape: Shape = "scalar", Delta: Matrix | None = None, time: Time = "discrete"
) -> ProvedLevel:
    """The greatest Phi with which ``system`` is Phi-ISP (and Delta-OSP): greatest d, or greatest trace.

    Args:
        system: (A, B, C, D), m x m.
        shape: which Phi are allowed; d is maximised for "scalar", the trace for the others.
        Delta: m x m output level that has to hold at the same time; zero by default.
        time: how ``system`` is read.

    Raises:
        Infeasible: no level of this shape exists, as for an unstable system.
        ValueError: an argument has the wrong shape.
        SolverFailure: the solver gave no usable answer.

    Example:
        >>> from manyhands import passivity
        >>> lag = passivity.StateSpace([[0.5]], [[0.5]], [[1.0]], [[1.0]])
        >>> print(f"{passivity.greatest_input_level(lag).value:.4f}")
        0.6667
    """
    return _greatest(system, shape, "input", Delta, time)


def _greatest(system: StateSpace, shape: Shape, role: Role, other: Matrix | None, time: Time) -> ProvedLevel:
    Delta, Phi = checked_levels(system, *((None, other) if role == "output" else (other, None)))
    m = system.inputs
    if isinstance(shape, Partition) and shape.size != m:
        raise ValueError(f"found a partition of {shape.size} ports; expected {m}")
    discrete, _ = in_discrete_time(system, time)
    seen = np.linalg.svd(np.hstack([discrete.C, discrete.D]), compute_uv=False)
    if role == "output" and (seen[0] == 0.0 or (shape != "scalar" and seen[-1] <= _SILENT * seen[0])):
        raise ValueError("the output is zero in some direction: every level holds there")
    basis, fixed = _span(shape, m), Phi if role == "output" else Delta
    search = Search(system, time, discrete, role, fixed, basis, shape == "scalar")
    bound = frequency_bound(search) if search.scalar else None
    idle = idle_directions(search)
    found = best_level(replace(search, basis=_silent_on(basis, idle)), bound) if idle.shape[1] else None
    found = best_level(search, bound) if found is None else found
    if found is None:
        raise Infeasible(f"the system has no {role} level of this shape: no positive storage function at any")
    return found


def _span(shape: Shape, m: int) -> Matrix:
    """Symmetric matrices that span the levels of ``shape``, k x m x m."""
    if shape == "scalar":
        return np.eye(m)[None]
    if shape == "diagonal":
        blocks: tuple[tuple[int, ...], ...] = tuple((i,) for i in range(m))
    else:
        blocks = shape.blocks if isinstance(shape, Partition) else (tuple(range(m)),)
    out = []
    for block in blocks:
        for a, i in enumerate(block):
            for j in block[a:]:
                unit = np.zeros((m, m))
                unit[i, j] = unit[j, i] = 1.0
                out.append(unit)
    return np.stack(out)


def _silent_on(basis: Matrix, directions: Matrix) -> Matrix:
    """The levels of a span that are zero on ``directions`` (m x k)."""
    equations = np.stack([(L @ directions).ravel() for L in basis], axis=1)
    return np.asarray(np.tensordot(kernel(equations).T, basis, axes=1))
