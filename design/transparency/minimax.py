"""The least peak of a family of frequency responses, by exchange and sequential convex programs.

    minimise over x in X    max over theta of sigma_max(G(theta; x)),        X given by linear matrix inequalities.

Only frequencies where the response peaks matter. A convex program bounds the response there,

    minimise t    subject to  [ t I   G_i; G_i^*   t I ] >= 0,    G_i = G(theta_i; x_0) + sum_k dG/dx_k (x_k - x_0k),

with a working set of theta_i, to which the peaks of each answer are added (exchange). If G is affine in x, t is a lower
bound on the best value in X, and the true peak is an upper bound; they meet at the global optimum. Otherwise a trust
region keeps x where the linearisation holds, and the true peak falls until it stops at a local optimum.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from manyhands.design.errors import SolverFailure
from manyhands.design.models.statespace import Matrix
from manyhands.design.passivity.hinfinity import refined_peaks
from manyhands.design.solver import LinearMatrixProgram, ProgramInfeasible

ComplexArray = NDArray[np.complex128]

GAP = 1e-4  # relative: between the level and the lower bound (affine), or the gain that a step can still promise
_MOST_STEPS = 60
PATIENCE = 6  # steps over which the gain is compared with ``stall``
_LEAST_RADIUS = 1e-6
_FIRST_PEAKS = 12  # the first program bounds the highest peaks; others are added when they matter
_PEAKS_KEPT = 0.6  # of the level: peaks above this part of it are bounded
_KEPT = 0.95  # the same for frequencies of the step before that are not peaks any more
_MOST_PEAKS = 24
_ALONE = 0.5  # singular values below this part of the greatest are left to the trust region
_APART = 0.01  # relative distance of frequencies that are bounded separately while the poles still move


class Family(ABC):
    """A family of responses G(theta; x) with the set X of the admissible x."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of unknowns x."""

    @property
    @abstractmethod
    def affine(self) -> bool:
        """Whether G is affine in x."""

    @abstractmethod
    def grid(self, x: Matrix) -> Matrix:
        """Sorted angles in [0, pi] between which G(theta; x) has at most one peak."""

    @abstractmethod
    def responses(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """G, angles x p x q."""

    @abstractmethod
    def derivatives(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """dG/dx_k, angles x unknowns x p x q, for the first unknowns; G depends on no others."""

    @abstractmethod
    def constrain(self, program: LinearMatrixProgram, x: Matrix) -> None:
        """Require x' in X, or in X linearised at x; the unknowns come first in the program."""

    @abstractmethod
    def trust(self, x: Matrix, radius: float) -> tuple[Matrix, Matrix]:
        """Lower and upper bounds for the first unknowns within this trust radius; the others are free."""

    @abstractmethod
    def restored(self, x: Matrix) -> Matrix | None:
        """A member of X near x; None if none is found."""

    def cheapest(self, cost: Matrix, what: str) -> Matrix:
        """The member of a convex X with the least cost^T x.

        Args:
            cost: one entry for each unknown.
            what: for messages.

        Raises:
            ProgramInfeasible: X is empty.
            SolverFailure: the solver gave no usable answer.
        """
        program = LinearMatrixProgram(self.size)
        self.constrain(program, np.zeros(self.size))
        return program.solve(cost, what)


@dataclass(frozen=True, eq=False)
class Minimum:
    """The result of the iteration.

    Attributes:
        x: the best member found.
        level: the true peak of x, by :func:`peaks`.
        bound: for affine families a lower bound on every member's peak, else 0.
        steps: programs solved.
        interrupted: whether Ctrl-C ended the iteration before it had converged.
    """

    x: Matrix
    level: float
    bound: float
    steps: int
    interrupted: bool = False


def heights(family: Family, x: Matrix, angles: Matrix) -> Matrix:
    """sigma_max(G(theta; x)) at ``angles``."""
    return np.asarray(np.linalg.norm(family.responses(x, angles), 2, axis=(1, 2)), dtype=np.float64)


def peaks(family: Family, x: Matrix) -> tuple[Matrix, Matrix]:
    """Angles and heights of the peaks of sigma_max, highest first."""
    return refined_peaks(lambda angles: heights(family, x, angles), family.grid(x))


def minimise_peak(
    family: Family,
    x: Matrix,
    what: str,
    progress: Callable[[float], None] | None = None,
    radius: float = 0.3,
    most_steps: int = _MOST_STEPS,
    stall: float = 0.0,
) -> Minimum:
    """Minimise the peak from x; for an affine family x only sets the scale and need not be in X.

    Args:
        family: the responses and X.
        x: start, a member of X unless the family is affine.
        what: for messages.
        progress: called with the level after each step that lowers it.
        radius: first trust radius.
        most_steps: cap on the programs.
        stall: stop when :data:`PATIENCE` steps together have gained less than this, relative to the level.

    Raises:
        ProgramInfeasible: X is empty (affine families).
        SolverFailure: the solver gave no usable answer before any member was found.
    """
    reached: list[Minimum] = []
    try:
        for minimum in _iterates(family, x, what, radius, most_steps):
            lower = not reached or minimum.level < reached[-1].level
            reached.append(minimum)
            if progress is not None and lower and np.isfinite(minimum.level):
                progress(minimum.level)
            if len(reached) > PATIENCE and reached[-1 - PATIENCE].level - minimum.level < stall * minimum.level:
                break
    except KeyboardInterrupt:
        if not reached or not np.isfinite(reached[-1].level):
            raise
        return replace(reached[-1], interrupted=True)
    return reached[-1]


def _iterates(family: Family, x: Matrix, what: str, radius: float, most_steps: int) -> Iterator[Minimum]:
    """The best so far: first the start (its level is inf if it need not be a member), then after each program.

    Each program promises a level, and the true peak of its answer shows how far the linearisation holds. If the true
    gain is a fair part of the promised gain, the next program starts from the answer; otherwise the trust region
    shrinks. Peaks that the program did not bound join the working set.
    """
    angles, values = peaks(family, x)
    working = angles[:_FIRST_PEAKS]
    best, level, bound = (x, np.inf, 0.0) if family.affine else (x, float(values[0]), 0.0)
    scale = max(float(values[0]), 1e-300)
    yield Minimum(best, level, bound, 0)
    for step in range(1, most_steps + 1):
        try:
            trial, promised = _program(family, x, working, scale, radius, what)
        except (SolverFailure, ProgramInfeasible):
            if family.affine and not np.isfinite(level):
                raise
            if family.affine or radius <= _LEAST_RADIUS:
                return
            radius *= 0.25
            continue
        if family.affine:
            bound = max(bound, promised)
        restored = family.restored(trial)
        if restored is None:
            radius *= 0.4
            continue
        angles, values = peaks(family, restored)
        found = float(values[0])
        gained, hoped = level - found, level - promised
        if found < level:
            best, level = restored, found
        yield Minimum(best, level, bound, step)
        if family.affine:
            if level <= bound * (1.0 + GAP):
                break
            added = _added(working, angles, values, promised)
            if added.size == 0:
                break  # only the solver's accuracy is missing
            x, working, scale = restored, np.concatenate([working, added]), found
            continue
        if gained > 0.05 * hoped > 0.0:
            slack = heights(family, restored, working)
            working = _merged(angles[values >= _PEAKS_KEPT * level][:_MOST_PEAKS], working[slack >= _KEPT * level])
            x, scale = restored, level
            if gained > 0.7 * hoped:
                radius *= 2.0
            if gained <= GAP * level and hoped <= 10.0 * GAP * level:
                break
        else:
            added = _added(working, angles, values, promised)
            radius *= 0.7 if added.size and hoped > GAP * level else 0.3
            working = _merged(added[:_MOST_PEAKS], working)
        if hoped <= 0.1 * GAP * level or radius < _LEAST_RADIUS:
            break


def _added(working: Matrix, angles: Matrix, values: Matrix, promised: float) -> Matrix:
    """The peaks above the promised level that are not yet in the working set."""
    high = angles[values > promised * (1.0 + 0.1 * GAP)]
    distance = np.abs(high[:, None] - working[None, :]) if working.size else np.full((len(high), 1), np.inf)
    return np.asarray(high[np.min(distance, axis=1) > 1e-7 * np.maximum(high, 1e-3)])


def _merged(first: Matrix, others: Matrix) -> Matrix:
    """``first`` and those of ``others`` that are not near an angle already taken; peaks move slightly in every step."""
    kept = list(first)
    for angle in others:
        if all(abs(angle - other) > _APART * max(other, 1e-6) for other in kept):
            kept.append(angle)
    return np.array(kept)


def _program(
    family: Family, x: Matrix, working: Matrix, scale: float, radius: float, what: str
) -> tuple[Matrix, float]:
    """Solve one linearised program over (x', t): the minimiser and the level that it promises."""
    n = family.size
    G = family.responses(x, working) / scale
    slopes = family.derivatives(x, working) / scale
    moving = slopes.shape[1]
    constant = G - np.tensordot(slopes, x[:moving], axes=((1,), (0,)))
    p, q = G.shape[1:]
    program = LinearMatrixProgram(n + 1)
    family.constrain(program, x)
    for G_now, G_0, G_k in zip(G, constant, slopes, strict=True):
        u, values, v = np.linalg.svd(G_now)
        if not family.affine and np.sum(values > _ALONE * values[0]) == 1:
            _hold_down(program, np.conj(u[:, 0]) @ G_0, np.conj(u[:, 0]) @ G_k)
            _hold_down(program, G_0 @ np.conj(v[0]), G_k @ np.conj(v[0]))
            continue
        linear = np.zeros((n + 1, p + q, p + q), dtype=np.complex128)
        linear[:moving, :p, p:] = G_k
        linear[:moving, p:, :p] = np.conj(np.swapaxes(G_k, 1, 2))
        linear[n] = np.eye(p + q)
        program.hermitian(
            np.block([[np.zeros((p, p)), G_0], [np.conj(G_0.T), np.zeros((q, q))]]).astype(np.complex128), linear
        )
    if not family.affine:
        low, high = family.trust(x, radius)
        bounded = np.zeros((len(low), n + 1))
        bounded[:, : len(low)] = np.eye(len(low))
        program.nonnegative(-low, bounded)
        program.nonnegative(high, -bounded)
    cost = np.zeros(n + 1)
    cost[n] = 1.0
    solution = program.solve(cost, what)
    return solution[:n], float(solution[n]) * scale


def _hold_down(program: LinearMatrixProgram, constant: ComplexArray, linear: ComplexArray) -> None:
    """Require that the norm of a complex vector, affine in the first unknowns, is at most t, the last unknown."""
    k = len(constant)
    rows = np.zeros((2 * k + 1, program.size))
    rows[0, -1] = 1.0
    rows[1:, : len(linear)] = np.concatenate([linear.real.T, linear.imag.T])
    program.second_order(np.concatenate([np.zeros(1), constant.real, constant.imag]), rows)
