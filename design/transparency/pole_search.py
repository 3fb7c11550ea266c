"""Linear couplings of given order: a search for the poles around the convex program over fixed poles.

The order grows by two at a time. Each stage

1. tries resonances from a list as the new pair of every block, with the convex program of
   :mod:`manyhands.design.transparency.families` (for loop shaping its value is the best that these poles allow),
2. lets all poles of all blocks move from the best few of these candidates, by sequential convex programs
   (:mod:`manyhands.design.transparency.free_poles`); each start is perturbed slightly and differently at each port,
3. solves the convex program again over the poles found, and keeps the best coupling.

A stage starts from the result of the stage before, so more poles are never worse. The search is local: its result is a
good coupling, not the best possible. The certificate does not depend on how the coupling was found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.models.statespace import Matrix
from manyhands.design.passivity.hinfinity import frequency_grid
from manyhands.design.solver import ProgramInfeasible
from manyhands.design.transparency.design import ROOM, LinearDesign, Progress, fixed_pole_family, minimised, recovered
from manyhands.design.transparency.families import FixedPoleFamily, NormalisedLoop, PoleBasis
from manyhands.design.transparency.free_poles import FreePoleFamily, PoleShape, fitted, section
from manyhands.design.transparency.minimax import Minimum, minimise_peak

MOST_ORDER = 16  # poles per port
_FREQUENCIES = 9
_DAMPINGS = (0.08, 0.4)
_TRIAL_STEPS = 4  # programs that rank a candidate
_SEARCH_STEPS = 40
_STALL = 1e-3  # relative gain over a few steps; with less, the search of the poles has converged
_PERTURBATION = 0.1  # of the logarithms: enough to separate ports that are nearly alike
_SMALLEST_POLE = 1e-3  # modulus: faster poles are delays, and their frequency is no candidate


def design_linear(
    loop: NormalisedLoop,
    orders: tuple[int, ...],
    least_levels: tuple[Matrix, ...],
    progress: Progress | None = None,
    starts: int = 2,
    seed: int = 0,
    room: float = ROOM,
) -> LinearDesign:
    """Search for a transparent linear coupling with n_i poles per port in block i.

    Args:
        loop: the normalised loop, with the aim.
        orders: greatest n_i of each block, up to :data:`MOST_ORDER`; the block has n_i m_i states.
        least_levels: Delta_V,i that each block must have, m_i x m_i, positive definite, N*s/m.
        progress: called with a line of text at every stage and whenever the level falls.
        starts: how many candidates of each stage are followed.
        seed: of the perturbations; the same seed gives the same coupling.
        room: least eigenvalue kept in the conditions, in ports where Delta_D = I.

    Returns:
        The best coupling found; its order is lower if more poles gained nothing. After Ctrl-C it is the best so far,
        marked ``interrupted``.

    Raises:
        Infeasible: no coupling has these levels.
        SolverFailure: the solver gave no usable answer.
        ValueError: not one order within the bounds and one positive definite level for each block.
        KeyboardInterrupt: Ctrl-C arrived before any coupling was found.
    """
    if len(orders) != len(loop.partition.blocks) or not all(0 <= n <= MOST_ORDER for n in orders):
        raise ValueError(f"orders: found {orders}; expected {len(loop.partition.blocks)} between 0 and {MOST_ORDER}")
    search = _Search(loop, least_levels, room, np.random.default_rng(seed), starts, progress)
    interrupted = False
    try:
        search.run(orders)
    except KeyboardInterrupt:
        if search.best is None:
            raise
        interrupted = True
    except ProgramInfeasible as error:
        raise Infeasible(
            "no linear coupling has the least levels asked for; (10) needs "
            "Delta_V > Phi_E + Phi_E (Delta_G - Phi_E)^{-1} Phi_E"
        ) from error
    if search.best is None:
        raise SolverFailure("pole search: no program gave a usable answer")
    family, found = search.best
    return recovered(family, replace(found, interrupted=interrupted), tuple(search.history))


class _Search:
    """State of one search: the best coupling so far, and the logarithms of its pole coefficients, block by block."""

    def __init__(
        self,
        loop: NormalisedLoop,
        levels: tuple[Matrix, ...],
        room: float,
        rng: np.random.Generator,
        starts: int,
        progress: Progress | None,
    ) -> None:
        self.loop = loop
        self.levels = levels
        self.room = room
        self.rng = rng
        self.starts = starts
        self.progress = progress
        self.best: tuple[FixedPoleFamily, Minimum] | None = None
        self.logs: tuple[Matrix, ...] = tuple(np.zeros(0) for _ in loop.partition.blocks)
        self.history: list[float] = []

    def run(self, orders: tuple[int, ...]) -> None:
        """Raise the order from static springs to ``orders``."""
        self._report("static springs")
        self._consider(self.logs, *self._solved(self.logs, None))
        while any(len(logs) < n for logs, n in zip(self.logs, orders, strict=True)):
            self._stage(orders)

    def _stage(self, orders: tuple[int, ...]) -> None:
        """Add a pair (or a last single pole) to every block that is not full yet."""
        before = self.logs
        ranked: list[tuple[float, int, tuple[Matrix, ...]]] = []
        candidates = self._candidates()
        for i, (frequency, damping) in enumerate(candidates):
            grown = tuple(_grown(logs, n, frequency, damping) for logs, n in zip(before, orders, strict=True))
            order = max(len(logs) for logs in grown)
            self._report(f"order {order}: candidate {i + 1} of {len(candidates)}")
            try:
                family, found = self._solved(grown, _TRIAL_STEPS)
            except (SolverFailure, ProgramInfeasible):
                continue  # this candidate is numerically out of reach
            ranked.append((found.level, i, grown))
            self._consider(grown, family, found)
        ranked.sort(key=lambda entry: entry[:2])
        if not ranked:
            raise SolverFailure("pole search: no candidate for a new pair of poles could be solved")
        if all(len(a) == len(b) for a, b in zip(self.logs, before, strict=True)):
            self.logs = ranked[0][2]  # no candidate improves on fewer poles: continue from the best candidate
        for i, (_, _, grown) in enumerate(ranked[: self.starts]):
            self._report(f"order {max(len(logs) for logs in grown)}: moving the poles, start {i + 1} of {self.starts}")
            self._follow(grown)

    def _follow(self, start: tuple[Matrix, ...]) -> None:
        """Let the poles move from ``start``, then solve the convex program over the poles found."""
        spread = tuple(logs + _PERTURBATION * self.rng.standard_normal(len(logs)) for logs in start)
        shapes = tuple(
            PoleShape(len(logs) // 2, len(logs) % 2 == 1, len(ports))
            for logs, ports in zip(spread, self.loop.partition.blocks, strict=True)
        )
        try:
            family, found = self._solved(spread, _TRIAL_STEPS)
            free = FreePoleFamily(self.loop, shapes, tuple(block.level for block in family.blocks))
            x = free.restored(_converted(family, found.x, shapes, spread))
            if x is None:
                return
            moved = minimise_peak(free, x, "pole search", most_steps=_SEARCH_STEPS, stall=_STALL)
            logs = tuple(part[: shape.poles] for shape, part in zip(shapes, free.parts(moved.x), strict=True))
            self._consider(logs, *self._solved(logs, None))
        except (SolverFailure, ProgramInfeasible):
            return  # this start failed; the other starts and the best coupling so far remain
        if moved.interrupted:
            raise KeyboardInterrupt

    def _solved(self, logs: tuple[Matrix, ...], most_steps: int | None) -> tuple[FixedPoleFamily, Minimum]:
        """Solve the convex program over the poles; the closed loop starts from the best coupling so far."""
        bases = tuple(
            PoleShape(len(part) // 2, len(part) % 2 == 1, len(ports)).basis(part)
            for part, ports in zip(logs, self.loop.partition.blocks, strict=True)
        )
        family = fixed_pole_family(self.loop, bases, self.levels, self.room)
        start = None
        if self.best is not None and not family.affine:
            start = _projected(family, self.best[0], self.best[1].x)
        found = minimised(family, start, most_steps=most_steps or 60)
        if found.interrupted:
            self._consider(logs, family, found)
            raise KeyboardInterrupt
        return family, found

    def _consider(self, logs: tuple[Matrix, ...], family: FixedPoleFamily, found: Minimum) -> None:
        """Keep the coupling if it satisfies its conditions and is better than the best so far."""
        if self.best is not None and found.level >= self.best[1].level:
            return
        try:
            level = recovered(family, found, ()).gamma  # the conditions and the norm are computed again
        except (SolverFailure, ValueError):
            return  # the conditions fail, or the coupling is not stable: it is not kept
        if level is None or (self.best is not None and level >= self.best[1].level):
            return
        self.best, self.logs = (family, replace(found, level=level)), logs
        self.history.append(level)
        self._report(f"order {max(len(part) for part in logs)}: gamma = {level:.5g}")

    def _candidates(self) -> list[tuple[float, float]]:
        """Frequencies (rad a sample) and damping ratios worth trying: around the poles of E and of the weights."""
        poles = self.loop.weighted.poles()
        corners = np.abs(np.log(poles[(np.abs(poles) > _SMALLEST_POLE) & (np.abs(poles - 1.0) > 1e-9)]))
        low, high = (float(np.min(corners)), float(np.max(corners))) if corners.size else (0.01, 0.1)
        frequencies = np.geomspace(0.4 * low, min(2.5 * high, 1.5), _FREQUENCIES)
        return [(float(f), damping) for f in frequencies for damping in _DAMPINGS]

    def _report(self, text: str) -> None:
        if self.progress is not None:
            self.progress(text)


def _grown(logs: Matrix, order: int, frequency: float, damping: float) -> Matrix:
    """Pole coefficients with one more pair, or the last single pole, unless the order is reached."""
    missing = order - len(logs)
    if missing >= 2:
        return np.concatenate([logs, section(frequency, damping)])
    return np.concatenate([logs, [np.log(2.0 * np.tan(frequency / 2.0))]]) if missing == 1 else logs


def _responses(family: FixedPoleFamily, x: Matrix, angles: Matrix) -> list[NDArray[np.complex128]]:
    """The responses of the blocks, angles x m_i x m_i each."""
    return [
        np.tensordot(block.derivatives(angles), part[: block.gains], axes=((1,), (0,)))
        for block, part in zip(family.blocks, family.parts(x), strict=True)
    ]


def _angles(bases: Sequence[PoleBasis]) -> Matrix:
    """Enough angles to distinguish the functions over the poles of all bases."""
    return frequency_grid(np.concatenate([np.array(basis.poles, dtype=np.complex128) for basis in bases]))


def _converted(family: FixedPoleFamily, x: Matrix, shapes: tuple[PoleShape, ...], logs: tuple[Matrix, ...]) -> Matrix:
    """The same coupling in the unknowns of :class:`FreePoleFamily`."""
    angles = _angles([block.basis for block in family.blocks])
    parts = zip(shapes, logs, _responses(family, x, angles), strict=True)
    return np.concatenate([fitted(shape, log, v, angles) for shape, log, v in parts])


def _projected(family: FixedPoleFamily, old: FixedPoleFamily, x: Matrix) -> Matrix:
    """The gains over the poles of ``family`` whose coupling is nearest to the coupling x over the poles of ``old``."""
    angles = _angles([block.basis for block in (*family.blocks, *old.blocks)])
    gains = []
    for block, v in zip(family.blocks, _responses(old, x, angles), strict=True):
        f = np.concatenate([block.basis.functions(angles), np.ones((len(angles), 1))], axis=1)
        rows, columns = np.tril_indices(block.ports)
        right = v[:, rows, columns]
        found = np.linalg.lstsq(np.concatenate([f.real, f.imag]), np.concatenate([right.real, right.imag]), rcond=1e-12)
        gains.append(found[0].ravel())
    return np.concatenate(gains)
