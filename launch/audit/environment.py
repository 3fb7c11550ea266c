"""Computes the environment of a recorded session again, from the signals of its couplings.

As long as every coupling takes part and no clutch has moved, forces, tools, masses and ledger follow from p alone. They
are computed by the environment's own core, and so to the last bit. Once a clutch was at work the environment's own
force f_e is in no row. Its work is known, though, because a clutch is lossless. With the coupling's end x_c = p + D_V
f_c and the force f_c that it received,

    f_e^T (x_e(k) - x_e(k-1)) = f_c^T (x_c(k) - x_c(k-1))

whatever the ratios were, except in the tick in which a last offset of at most LET_GO is dropped. So its increments,

    T w^T Phi_E w - sum over the couplings f_c^T (x_c(k) - x_c(k-1)),     w = (x_e(k) - x_e(k-1))/T,

are checked at every tick, to rounding. That holds for a user's own model as well, whose code need not be run for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import UncheckedTicks, gaps_of
from manyhands.launch.audit.recompute import Array, FollowedParty, Lost
from manyhands.launch.recordings.run import there
from manyhands.nodes.environment.clutch import LET_GO
from manyhands.nodes.environment.core import environment_core, row_of
from manyhands.nodes.kernel.arithmetic import Saturation
from manyhands.nodes.kernel.bundle import CouplingBundle, EnvironmentBundle
from manyhands.nodes.kernel.factory import MESH
from manyhands.nodes.rows import figures as names
from manyhands.protocol.channels import HEARD, TOLD

ROUNDING = 64.0
"""Units in the last place of the greatest product of a tick, by which another order of its sums may change it."""

_EPSILON = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Blocks:
    """The signals that the couplings recorded, in the order of the environment's ports.

    Attributes:
        bundles: each coupling's part of the session.
        ports: indices of each coupling's ports.
        p: ticks x m, m; NaN where a coupling has no row.
        f: the forces that they handed on, ticks x m, N; NaN where a coupling has no row.
        courses: what happened between each coupling's rows.
        held: by coupling in the tick, the ticks in which it was held; it need not have a row in them.
        faces: D_V = T b^-1 of the couplings with a wave link, m/N, by coupling. Their p and f are those of the world's
            end, which the environment records itself: it has no force limits, and no rungs.
    """

    bundles: Mapping[str, CouplingBundle]
    ports: Mapping[str, NDArray[np.intp]]
    p: Array
    f: Array
    courses: Mapping[str, Course]
    held: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    faces: Mapping[str, Array] = field(default_factory=dict)

    @property
    def D_V(self) -> Array:
        """The couplings' feedthrough at rung 0, m x m, m/N."""
        m = self.p.shape[1]
        out = np.zeros((m, m))
        for name, bundle in self.bundles.items():
            own = np.ix_(self.ports[name], self.ports[name])
            out[own] = self.faces.get(name, bundle.block.D)
        return out

    @property
    def limits(self) -> Mapping[str, Sequence[float]]:
        """The greatest forces that each coupling in the tick hands on, N."""
        return {name: bundle.limits.force for name, bundle in self.bundles.items() if name not in self.faces}

    @property
    def clipped(self) -> NDArray[np.bool_]:
        """The ticks in which some force is at its limit, so that the environment's own force may be a greater one."""
        out = np.zeros(len(self.f), dtype=np.bool_)
        for name, most in self.limits.items():
            out |= (np.abs(self.f[:, self.ports[name]]) >= np.array(most)).any(axis=1)
        return out

    @property
    def holding(self) -> NDArray[np.bool_]:
        """Ticks x m, true where the coupling of a port was held."""
        out = np.zeros(self.p.shape, dtype=np.bool_)
        for name, held in self.held.items():
            out[:, self.ports[name]] = held[:, None]
        return out

    def ends(self) -> tuple[Array, Array]:
        """The ends x_c = p + D_V f_c, ticks x m, m, with the D_V of the rung in force, and |p| + |D_V| |f_c|.

        NaN where the rung of a coupling is not known.
        """
        out, size = np.full_like(self.p, np.nan), np.full_like(self.p, np.nan)
        for name, bundle in self.bundles.items():
            own = self.ports[name]
            f, p = self.f[:, own], self.p[:, own]
            if name in self.faces:
                D = self.faces[name]
                out[:, own], size[:, own] = p + f @ D.T, np.abs(p) + np.abs(f) @ np.abs(D).T
                continue
            steps = [(0, 0), *self.courses[name].in_force, (len(f), 0)]
            for (begin, rung), (end, _) in pairwise(steps):
                D = bundle.rungs[rung].block.D
                out[begin:end, own] = p[begin:end] + f[begin:end] @ D.T
                size[begin:end, own] = np.abs(p[begin:end]) + np.abs(f[begin:end]) @ np.abs(D).T
            for gap in self.courses[name].unknown if len(bundle.rungs) > 1 else ():
                out[gap.begin : gap.end, own] = np.nan
        return out, size


class FollowedEnvironment(FollowedParty):
    """Tools, masses, forces and ledger of the environment, from p of all couplings."""

    def __init__(
        self,
        bundle: EnvironmentBundle,
        blocks: Blocks,
        tools: Array,
        sign: tuple[int, str],
        pressed: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        """Take what was recorded.

        Args:
            bundle: the environment's part of the session.
            blocks: the couplings' recorded signals.
            tools: recorded x_e, ticks x m, m; used from ``sign`` on, to see whether a clutch has moved.
            sign: the first tick at which a clutch may have moved, and why.
            pressed: by tick, the buttons that are held down from then on, as the environment recorded.
        """
        self._pressed = pressed
        self._bundle, self._blocks, self._tools, self._sign = bundle, blocks, tools, sign
        self.ticks, m = blocks.p.shape
        self.rows = range(self.ticks)
        if bundle.model is not None and bundle.model.factory != MESH:
            why = f"the code of the model {bundle.model.factory} is not run by an audit: its forces are not checked"
            self.rows, self.gaps = (), [UncheckedTicks(0, self.ticks, why)]
        masses = len(bundle.masses)
        self.fields = {names.TOOL_POSITION: m, names.MASS_POSITION: masses, names.FORCE: m, names.LEDGER: 1}
        # the core does not read p of a block that is held
        self._p = np.where(blocks.holding & np.isnan(blocks.p), 0.0, blocks.p)
        self._complete = there(self._p)
        self._limits = [(blocks.ports[name], Saturation(most)) for name, most in blocks.limits.items()]
        parts = enumerate(blocks.ports.items())
        self._held = [(block, its.tolist(), blocks.held[name]) for block, (name, its) in parts if name in blocks.held]

    def begin(self, joins: bool) -> None:
        """The environment begins at rest, and knows of no button."""
        if self.rows:
            self._core = environment_core(self._bundle, self._blocks.D_V, tuple(self._blocks.ports.values()))

    def row(self, k: int, happened: Happening, rung: int | None) -> Mapping[str, Sequence[float]]:
        """x_e, q, the forces that the couplings hand on, and the ledger."""
        core, blocks, (begin, why) = self._core, self._blocks, self._sign
        if not self._complete[k]:
            later = self._complete[k:].any()
            raise Lost("a coupling has no row there: what follows is not checked" if later else "")
        answered: dict[int, float] = {}  # forces of blocks that are held, by port
        for block, ports, held in self._held:
            if held[k]:
                answered.update(zip(ports, core.holding_force(block, blocks.p[k, ports].tolist()), strict=True))
                core.clutches.hold(block)
        if k in self._pressed:
            core.press(self._pressed[k])
        f = core.react(self._p[k].tolist())
        core.settle()
        for port, force in answered.items():
            f[port] = force
        found = _forces(f, self._limits, len(self._tools[k]))
        tools = self._tools[k].tolist()
        if k >= begin and not (core.tools == tools and np.array_equal(found, blocks.f[k], equal_nan=True)):
            raise Lost(f"{why}, and a clutch has moved: forces and masses are not checked")
        row = dict(zip(_ROW, row_of(core), strict=True))
        return {name: numbers for name, numbers in row.items() if len(numbers)} | {names.FORCE: found}


_ROW: Final = (names.TOOL_POSITION, names.MASS_POSITION, names.ORIENTATION, names.LEDGER, HEARD, TOLD)
"""The traces of :func:`row_of`."""


def _forces(f: list[float], limits: list[tuple[NDArray[np.intp], Saturation]], m: int) -> list[float]:
    """The forces that the couplings hand on: those of the environment, clipped to the limits of those in the tick."""
    out = f[:m]
    for ports, saturation in limits:
        for port, force in zip(ports.tolist(), saturation.clip([f[port] for port in ports]), strict=True):
            out[port] = force
    return out


@dataclass(frozen=True, eq=False)
class Increments:
    """The increments of the environment's ledger, from the signals around it.

    Attributes:
        recorded: ticks x 1, J.
        recomputed: ticks x 1, J; NaN where they are not known.
        tolerance: of each, J.
        offsets: number of ticks in which a last offset may have been dropped.
        gaps: ticks in which a coupling's force is not known.
    """

    recorded: Array
    recomputed: Array
    tolerance: Array
    offsets: int
    gaps: list[UncheckedTicks]


def increments(
    Phi: Array,
    T: float,
    blocks: Blocks,
    tools: Array,
    ledger: Array,
    sign: int,
    silent: NDArray[np.bool_],
    changed: NDArray[np.bool_],
    begun: Sequence[int] = (),
    stored: float = 0.0,
    restrained: int = 0,
) -> Increments:
    """The increments of the environment's ledger, from tools and couplings alone.

    Args:
        Phi: the level that the environment promised, m x m, N*s/m.
        T: period, s.
        blocks: the couplings' recorded signals.
        tools: recorded x_e, ticks x m, m.
        ledger: recorded, ticks x 1, J.
        sign: the first tick at which a clutch may have moved.
        silent: ticks x m, true where a coupling was sent no force.
        changed: ticks x m, true where a coupling's row may not be of the process, or of the force, of the environment's
            tick: it began anew, or had gone on at that tick.
        begun: the first ticks of processes that took the place of one, which begin at rest with a ledger of their own.
        stored: the energy that the environment stores at the start, with which its ledger begins, J.
        restrained: number of ticks in which a clutch was limited by an energy budget.
    """
    ends, size = blocks.ends()
    holding = blocks.holding
    for k in np.flatnonzero(holding.any(axis=1)):  # what is held rests, whatever its row states
        ends[k, holding[k]] = ends[k - 1, holding[k]] if k else 0.0
        size[k, holding[k]] = size[k - 1, holding[k]] if k else 0.0
    resting = silent | holding
    unknown = changed & ~resting  # of a coupling that returns the environment has heard nothing before its first row
    unknown[1:] &= ~resting[:-1]
    ends[unknown] = np.nan
    rest = np.zeros((1, tools.shape[1]))
    step_e = np.diff(np.vstack([rest, tools]), axis=0)
    step_c = np.diff(np.vstack([rest, ends]), axis=0)
    f = np.where(resting, 0.0, np.where(unknown, np.nan, blocks.f))
    still = f == 0.0
    work = np.where(still, 0.0, f * np.where(still, 0.0, step_c))
    w = step_e / T
    dissipated = T * np.einsum("ki,ij,kj->k", w, Phi, w)
    totals = ledger[:, 0]
    recorded = np.diff(np.concatenate([[stored], totals]))
    recomputed = dissipated - work.sum(axis=1)
    # the force behind a limit is not recorded, and so neither is x_c(k), from which the next tick's step begins
    clipped = blocks.clipped
    clipped[1:] |= blocks.clipped[:-1]
    recomputed[clipped] = recomputed[list(begun)] = np.nan
    before = np.vstack([rest, size[:-1]])
    moved = np.where(still, 0.0, np.abs(f) * np.where(still, 0.0, size + before + np.abs(tools)))
    speeds = T * np.abs(w) + np.abs(tools)
    largest = moved.sum(axis=1) + np.einsum("ki,ij,kj->k", np.abs(w), np.abs(Phi), speeds)
    largest += np.abs(totals) + np.abs(np.concatenate([[stored], totals[:-1]]))
    tolerance = ROUNDING * _EPSILON * largest
    # a last offset is dropped once after each freeze, and after each time that a budget has limited a clutch
    allowed = restrained
    for own in blocks.ports.values():
        silent = (still & ~holding)[sign:, own].all(axis=1)
        allowed += int((silent & ~np.concatenate([[False], silent[:-1]])).sum())
    most = LET_GO * np.linalg.norm(f, axis=1)
    with np.errstate(invalid="ignore"):
        off = recorded - recomputed  # a dropped offset costs energy and never adds any
        let_go = (off < -tolerance) & (off >= -tolerance - most)
    let_go[:sign] = False
    used = np.flatnonzero(let_go)[:allowed]
    tolerance[used] += most[used]
    why = "a coupling has no row there, and no event states that it was sent no force"
    gone = np.isnan(f) & ~unknown
    gaps = gaps_of(np.asarray(gone.any(axis=1), dtype=np.bool_), why)
    after = np.asarray(unknown.any(axis=1), dtype=np.bool_)
    after[1:] |= after[:-1].copy()
    gaps += gaps_of(after, "a coupling began or went on there, and may have received another force than its row states")
    gaps += gaps_of(clipped, "a coupling's force was at its limit, or had been in the tick before")
    gaps += [UncheckedTicks(k, k + 1, "a new process of the environment began there, at rest") for k in begun]
    return Increments(recorded[:, None], recomputed[:, None], tolerance[:, None], len(used), gaps)
