"""The clutch between one coupling block and the environment: an ideal transformer whose ratio s may change.

With x_c = p + D_V f_c the end of the coupling and x_e the tool in the environment, at every tick k

    x_e(k) - x_e(k-1) = s(k) (x_c(k) - x_c(k-1)),      f_c(k) = s(k) f_e(k),      0 <= s <= 1,

so that f_e^T (x_e(k) - x_e(k-1)) = f_c^T (x_c(k) - x_c(k-1)): no energy is made or lost, whatever s does. s = 1 is
coupled; s = 0 is frozen, with the tool at rest and no force to the user. One ratio for all ports of a block keeps the
session's certificate (docs/decisions/0015-the-clutch.md).

**Ramps.** s = sin^2(pi j/(2 RAMP)), where j moves by at most one a tick, so that s moves by at most pi/(2 RAMP).

**The offset.** While s < 1 the tool and the coupling's end drift apart. Afterwards the tool lags (s down to SLOWEST)
whenever the end moves towards where the tool already is. Since

    o(k) = o(k-1) - (1 - s(k)) (x_c(k) - x_c(k-1)),      o = x_e - x_c,

this shortens o. The clutch chooses s by p(k) - p(k-1) alone, which the forces of the tick do not change. So no
algebraic loop closes through s, and any s is lossless. 1 - s fades as o does, over WORK_OFF of motion. The rest of the
offset, at most LET_GO, is let go in one tick in which the force on the tool pushes in that direction. The clutch then
gives up -f_e^T o >= 0, and never gains. So that such a tick comes, the lag aims at an offset of half LET_GO on that
side of zero.

**Holding** (:meth:`Clutch.hold`). A coupling whose p(k) has not come in time is held for this tick: both ends rest,

    x_e(k) = x_e(k-1),      x_c(k) = x_c(k-1),      f_c(k) = D_V^{-1} (x_c(k-1) - p(k)),

so that f_e^T (x_e(k) - x_e(k-1)) = f_c^T (x_c(k) - x_c(k-1)) = 0, which is as lossless. The user's own spring goes on
from a tool at rest, and nobody waits: f_c is found when p(k) comes (:func:`held_force`). No offset arises, and the
tick after is as if none had been between.

**A restraint** (:meth:`Clutch.restrain`) is a greatest s for a party that is beyond its energy budget
(:mod:`manyhands.nodes.environment.energy`): s falls to it at once, and rises with it no faster than the ramp.

:class:`Clutches` holds the clutches of all blocks, for both environment cores. A core solves for the forces at given
ratios. The clutches choose the ratios, let go one offset in a tick at most, and halt a party that would overdraw its
budget.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from operator import sub
from types import MappingProxyType
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.environment.energy import Energy
from manyhands.nodes.kernel.arithmetic import Floats, dot

Vector = NDArray[np.float64]
Blocks: TypeAlias = Sequence[slice | Sequence[int] | NDArray[np.intp]]
"""The ports of each coupling, in its own order."""

SLOWEST: Final = 0.8
"""The least ratio by which an offset is worked off."""

WORK_OFF: Final = 5e-3
"""Motion over which an offset shrinks by e, once it is below (1 - SLOWEST) of this; m."""

LET_GO: Final = 1e-6
"""Euclidean norm of the offset that may be given up in one tick, m: less than a hand feels or a sensor resolves."""


SINGULAR: Final = 1e12
"""Condition above which a D_V, or an algebraic loop, counts as having no unique solution."""


class ClutchPhase(Enum):
    """The phase of a clutch."""

    COUPLED = "coupled"  # s is 1, rises to 1, or is below 1 to work an offset off
    LEAVING = "leaving"  # s falls to 0
    FROZEN = "frozen"  # s = 0; the block's p is not looked at
    JOINING = "joining"  # s = 0, and the p of the next tick becomes the reference


class ClutchEvent(Enum):
    """The events that change a clutch's phase."""

    FREEZE = "freeze"
    ENGAGE = "engage"
    DISENGAGE = "disengage"
    REFERRED = "referred"  # the reference has been taken
    FALLEN = "fallen"  # the ratio has reached 0


NEXT: Final[Mapping[tuple[ClutchPhase, ClutchEvent], ClutchPhase]] = MappingProxyType(
    {
        (ClutchPhase.COUPLED, ClutchEvent.FREEZE): ClutchPhase.FROZEN,
        (ClutchPhase.COUPLED, ClutchEvent.ENGAGE): ClutchPhase.COUPLED,
        (ClutchPhase.COUPLED, ClutchEvent.DISENGAGE): ClutchPhase.LEAVING,
        (ClutchPhase.LEAVING, ClutchEvent.FREEZE): ClutchPhase.FROZEN,
        (ClutchPhase.LEAVING, ClutchEvent.ENGAGE): ClutchPhase.COUPLED,
        (ClutchPhase.LEAVING, ClutchEvent.DISENGAGE): ClutchPhase.LEAVING,
        (ClutchPhase.LEAVING, ClutchEvent.FALLEN): ClutchPhase.FROZEN,
        (ClutchPhase.FROZEN, ClutchEvent.FREEZE): ClutchPhase.FROZEN,
        (ClutchPhase.FROZEN, ClutchEvent.ENGAGE): ClutchPhase.JOINING,
        (ClutchPhase.FROZEN, ClutchEvent.DISENGAGE): ClutchPhase.FROZEN,
        (ClutchPhase.JOINING, ClutchEvent.FREEZE): ClutchPhase.FROZEN,
        (ClutchPhase.JOINING, ClutchEvent.ENGAGE): ClutchPhase.JOINING,
        (ClutchPhase.JOINING, ClutchEvent.DISENGAGE): ClutchPhase.FROZEN,
        (ClutchPhase.JOINING, ClutchEvent.REFERRED): ClutchPhase.COUPLED,
    }
)
"""Every transition; the pairs without an entry cannot occur."""


class Clutch:
    """The clutch of one block between ticks: it chooses s, and the core solves for the forces.

    A tick is :meth:`advance`, perhaps :meth:`let_go` and :meth:`keep`, and :meth:`conclude`. A clutch that is
    ``settled`` (s = 1 and no offset) needs none of them, for x_e = x_c.

    Attributes:
        ports: indices of the block's ports.
        phase: coupled, leaving, frozen or joining.
        ratio: s of the last tick; 0 from the moment it is frozen.
        settled: whether s = 1 and x_e = x_c.
        held: whether both ends rest in the next tick.
        fresh: whether it is no longer settled, and :meth:`seize` has not set the tool's position yet.
        reference: r = x_e(k-1) - s x_c(k-1) + s p(k), m, so that x_e(k) = r + s D_V f_c(k).
        ready: whether the offset of this tick may be let go.
        rests: whether s was 0 in the last two ticks. Then the step of the force is 0 as well, and so is everything in a
            device's storage that depends on the block's rung: the block may change to any other rung
            (docs/decisions/0016-the-ladder.md).
    """

    __slots__ = (
        "_at",
        "_last",
        "_most",
        "_p",
        "_ramp",
        "_x_c",
        "_x_e",
        "fresh",
        "held",
        "phase",
        "ports",
        "ratio",
        "ready",
        "reference",
        "rests",
        "settled",
    )

    def __init__(self, ports: Sequence[int], ramp: int) -> None:
        """Coupled and settled, with all positions at 0.

        Args:
            ports: indices of the block's ports.
            ramp: ticks from s = 0 to s = 1.
        """
        self.ports, self._ramp = list(ports), ramp
        self.phase, self.ratio, self.settled = ClutchPhase.COUPLED, 1.0, True
        self._at = self._most = float(ramp)  # j and its greatest permitted value, ticks
        self._p: Floats = [0.0] * len(ports)
        self._x_c = self._x_e = self.reference = self._p
        self.fresh = self.held = self.ready = self.rests = False
        self._last = 1.0  # s of the tick before

    @property
    def offset(self) -> Floats:
        """x_e - x_c, m: 0 where the clutch is settled; where it is frozen, that of its last tick with s > 0."""
        return [0.0] * len(self.ports) if self.settled else _difference(self._x_e, self._x_c)

    def end(self, x_e: Floats) -> Floats | None:
        """x_c(k-1), m, where ``x_e``, m, are the tools of the tick before; None where the block has no end yet."""
        if self.phase in (ClutchPhase.FROZEN, ClutchPhase.JOINING):
            return None
        return ports_of(x_e, self) if self.settled or self.fresh else self._x_c

    def hold(self) -> bool:
        """Hold both ends in the next tick; returns whether the clutch ceases to be settled.

        A frozen clutch does so anyway. One that is joining takes no reference in it.
        """
        if self.phase is ClutchPhase.FROZEN:
            return False
        self.held = True
        return self._unsettle()

    def seize(self, x_e: Floats) -> None:
        """Take the tool's position x_e(k-1), m, which is x_c(k-1) as well: the clutch was settled so far."""
        self._p = self._x_c = self._x_e = self.reference = x_e
        self._last, self.fresh = 1.0, False

    def handle(self, event: ClutchEvent) -> bool:
        """Change the phase by :data:`NEXT`; returns whether the clutch ceases to be settled, for s may leave 1."""
        self.phase = NEXT[self.phase, event]
        if self.phase is ClutchPhase.FROZEN:
            self._at = self.ratio = 0.0
            self.reference, self.ready, self.held = self._x_e, False, False
        return self.phase is not ClutchPhase.COUPLED and self._unsettle()

    def restrain(self, ratio: float) -> bool:
        """Limit s to ``ratio`` from the next tick on; returns whether the clutch ceases to be settled by that."""
        self._most = self._ramp * (1.0 if ratio >= 1.0 else 2.0 / math.pi * math.asin(math.sqrt(ratio)))
        return ratio < 1.0 and self._unsettle()

    def _unsettle(self) -> bool:
        """Cease to be settled; returns whether the clutch was."""
        if not self.settled:
            return False
        self.settled, self.fresh = False, True
        return True

    def advance(self, p: Floats, f_e: Floats) -> None:
        """Choose s(k).

        Args:
            p: the block's p(k), m; ignored while frozen.
            f_e: the force at the tool of the tick before, N.
        """
        self.ready = False
        if self.phase is ClutchPhase.FROZEN:
            self.reference = self._x_e
            return
        if self.held:
            self.ratio, self.reference = 0.0, self._x_e
            return
        if self.phase is ClutchPhase.JOINING:
            self._p = p  # with no force x_c(k) is p(k)
            self.reference = self._x_e
            self.handle(ClutchEvent.REFERRED)
            return
        leaving, x_e, x_c, ramp, most = self.phase is ClutchPhase.LEAVING, self._x_e, self._x_c, self._ramp, self._most
        offset, before = _difference(x_e, x_c), self._at
        goal = 0.0 if leaving else self._goal(offset, _difference(p, self._p), f_e)
        self._p = p
        by = goal - before
        at = before + (by if -1.0 <= by <= 1.0 else math.copysign(1.0, by))
        if at > most:
            at = most
        if at != before or self.ratio == 0.0:  # it may have been held in the tick before
            self._at, self.ratio = at, math.sin(0.5 * math.pi * at / ramp) ** 2
        ratio = self.ratio
        self.reference = [e + ratio * (to - c) for e, to, c in zip(x_e, p, x_c, strict=True)]
        if leaving:
            if at == 0.0:
                self.handle(ClutchEvent.FALLEN)
        elif at >= ramp - 1.0 and most >= ramp:
            self.ready = dot(offset, offset) <= LET_GO**2 and dot(offset, f_e) <= 0.0

    def halt(self) -> None:
        """Set s(k) = 0 after :meth:`advance`: the tool rests in this tick, and s rises again from 0."""
        self._at = self.ratio = 0.0
        self.reference, self.ready = self._x_e, False

    def supply(self, f_e: Floats, deflection: Floats) -> float:
        """The energy that the tool would put into the environment in this tick, J, for f_e(k), N, and D_V f_c(k), m."""
        ends = zip(f_e, self._x_e, self.reference, deflection, strict=True)
        return sum(force * (last - at - self.ratio * by) for force, last, at, by in ends)

    def _goal(self, offset: Floats, moved: Floats, f_e: Floats) -> float:
        """The goal of j: the ramp's end, or less where a lag behind p's motion ``moved`` (m) shortens the offset."""
        path = math.hypot(*moved)
        if not path > 0.0:
            return float(self._ramp)
        force = math.hypot(*f_e)
        towards = dot(offset, moved) + (dot(f_e, moved) * (0.5 * LET_GO / force) if force > 0.0 else 0.0)
        if not towards > 0.0:
            return float(self._ramp)
        lag = min(1.0 - SLOWEST, towards / (path * WORK_OFF))
        return self._ramp * 2.0 / math.pi * math.asin(math.sqrt(1.0 - lag))

    def let_go(self) -> None:
        """Try s = 1 and x_e = x_c in this tick; s is at most one step of the ramp away from 1."""
        self._at, self.ratio, self.reference = float(self._ramp), 1.0, self._p

    def gains(self, f_e: Floats) -> bool:
        """Whether the clutch would make energy if it let the offset go under f_e(k), N."""
        return dot(self.offset, f_e) > 0.0

    def keep(self) -> None:
        """Take back :meth:`let_go`: s = 1 with the offset."""
        self.reference = [e + (to - c) for e, to, c in zip(self._x_e, self._p, self._x_c, strict=True)]
        self.ready = False

    def conclude(self, deflection: Floats) -> Floats:
        """Close the tick.

        Args:
            deflection: D_V f_c(k), m.

        Returns:
            x_e(k), m: exactly x_e(k-1) while s = 0, exactly x_c(k) once the offset is let go.
        """
        ratio = self.ratio
        self._x_e = [at + ratio * by for at, by in zip(self.reference, deflection, strict=True)]
        if self.held:  # its force is not 0, as it is behind a clutch that is open
            self.held = self.rests = False
            self._last = 1.0
            return self._x_e
        if self.phase is not ClutchPhase.FROZEN:
            self._x_c = [at + by for at, by in zip(self._p, deflection, strict=True)]
        self.rests, self._last = ratio == self._last == 0.0, ratio
        if self.ready and ratio == 1.0:
            self.settled = True
        return self._x_e


class Clutches:
    """The clutches between all blocks and one environment.

    Between ticks blocks are frozen, engaged and disengaged by their index. A tick in which any block is not settled
    is :meth:`choose` and :meth:`conclude`; in between the core calls :meth:`Clutch.conclude` of these blocks.

    Attributes:
        all: the clutches by block.
        unsettled: the clutches that are not settled, in the order in which they ceased to be. It is always the same
            list, for a core checks in every tick whether it is empty.
    """

    def __init__(self, blocks: Sequence[Sequence[int]], ramp: int, energy: Energy) -> None:
        """All coupled and settled, with all positions at 0.

        Args:
            blocks: the ports of each block.
            ramp: ticks from s = 0 to s = 1.
            energy: the energy budgets, which limit the ratios; one party for each block.

        Raises:
            ValueError: the ramp has no tick.
        """
        if ramp < 1:
            raise ValueError(f"found a ramp of {ramp} ticks; expected 1 or more")
        self.all = tuple(Clutch(ports, ramp) for ports in blocks)
        self.unsettled: list[Clutch] = []
        self._energy = energy
        self._going: Clutch | None = None  # the clutch whose offset may be let go in this tick

    def freeze(self, block: int) -> None:
        """Set s = 0 from the next tick on: the block's tool rests, and the block receives no force."""
        self.handle(self.all[block], ClutchEvent.FREEZE)

    def engage(self, block: int) -> None:
        """Take the block's next p as its reference, with s = 0, and then raise s to 1 over the ticks of a ramp.

        For a block that is leaving, s rises again from its present value; for a coupled block nothing changes.
        """
        self.handle(self.all[block], ClutchEvent.ENGAGE)

    def presses(self, block: int) -> bool:
        """Whether the block's user may lean on its tool: its clutch neither leaves nor is open."""
        return self.all[block].phase is ClutchPhase.COUPLED

    def disengage(self, block: int) -> None:
        """Lower s to 0 from its present value; then the block is frozen."""
        self.handle(self.all[block], ClutchEvent.DISENGAGE)

    def handle(self, clutch: Clutch, event: ClutchEvent) -> None:
        """Apply ``event`` to one of the clutches, and keep :attr:`unsettled`."""
        if clutch.handle(event):
            self.unsettled.append(clutch)

    def hold(self, block: int) -> None:
        """Hold the block's tool, and the end of its coupling, in the next tick."""
        clutch = self.all[block]
        if clutch.hold():
            self.unsettled.append(clutch)

    def exchanged(self, block: int, D_V: Vector, whole: Vector) -> Vector:
        """The couplings' feedthrough after one block has a different one; its force must be 0.

        Args:
            block: the block's index.
            D_V: the feedthrough of the block from now on, m_i x m_i, m/N.
            whole: the present feedthrough of all blocks, m x m, m/N; it is not changed.

        Raises:
            ValueError: the block is not frozen, or the shape is wrong.
        """
        clutch = self.all[block]
        if clutch.phase not in (ClutchPhase.FROZEN, ClutchPhase.JOINING):
            raise ValueError(
                f"found block {block} at the ratio {clutch.ratio:.3g}; expected it frozen: disengage first"
            )
        size = len(clutch.ports)
        if np.shape(D_V) != (size, size):
            raise ValueError(f"found a feedthrough of shape {np.shape(D_V)}; expected {size} x {size}")
        whole = whole.copy()
        whole[np.ix_(clutch.ports, clutch.ports)] = D_V
        return whole

    def restrain(self) -> None:
        """Limit every party's ratio by its budget, from the next tick on."""
        for party, clutch in enumerate(self.all):
            if clutch.restrain(self._energy.ratio(party)):
                self.unsettled.append(clutch)

    def seize(self, x_e: Floats) -> None:
        """Give the clutches that have just ceased to be settled the tools' positions x_e(k-1), m."""
        for clutch in self.unsettled:
            if clutch.fresh:
                clutch.seize(ports_of(x_e, clutch))

    def choose(
        self,
        p: Floats,
        f_e: Floats,
        x_e: Floats,
        solve: Callable[[], Floats],
        supply: Callable[[Clutch, Floats], float],
    ) -> Floats:
        """Choose the ratios of a tick, and find the forces at them.

        At most one offset is let go in a tick, so that the sign of its own energy decides.

        Args:
            p: the couplings' free tool positions p(k), m.
            f_e: the forces of the tick before, N.
            x_e: the tools' positions of the tick before, m.
            solve: returns f_e(k) at the present ratios and references, N.
            supply: returns the energy that a clutch's tool would put into the environment in this tick, J, under the
                forces found last.

        Returns:
            f_e(k), N.
        """
        self.seize(x_e)
        for clutch in self.unsettled:
            clutch.advance(ports_of(p, clutch), ports_of(f_e, clutch))
        going = self._going = next((clutch for clutch in self.unsettled if clutch.ready), None)
        for clutch in self.unsettled:
            clutch.ready = clutch is going
        if going is not None:
            going.let_go()
        f = solve()
        # solve freezes blocks where the loop has no unique solution; a frozen block is not ready any more
        if going is not None and going.ready and going.gains(ports_of(f, going)):
            going.keep()
            f = solve()
        while self._energy.restrained and self._halts_one(f, supply):
            f = solve()
        return f

    def conclude(self) -> bool:
        """End the tick after every clutch has concluded it; returns whether one of them is settled from now on."""
        going = self._going
        if going is None or not going.settled:
            return False
        self.unsettled.remove(going)
        return True

    def _halts_one(self, f: Floats, supply: Callable[[Clutch, Floats], float]) -> bool:
        """Halt a party that would put more energy into the environment than its room; returns whether there is one."""
        for party, clutch in enumerate(self.all):
            if self._energy.ratio(party) == 1.0 or clutch.ratio == 0.0:
                continue
            if supply(clutch, ports_of(f, clutch)) > self._energy.room(party):
                clutch.halt()
                return True
        return False


def held_force(clutch: Clutch, x_e: Floats, D_V: Vector, p: Floats) -> Floats:
    """f_c(k) of a block that is held, N: D_V^{-1} (x_c(k-1) - p(k)).

    A block without an end yet has no force.

    Args:
        clutch: the block's clutch.
        x_e: the tools' positions of the tick before, m, all ports.
        D_V: the couplings' feedthrough, m x m, m/N.
        p: the block's free tool position, m.
    """
    end = clutch.end(x_e)
    if end is None:
        return [0.0] * len(clutch.ports)
    found: Floats = np.linalg.solve(_own(clutch, D_V), np.array(_difference(end, p))).tolist()
    return found


def holdable(clutch: Clutch, D_V: Vector) -> bool:
    """Whether D_V of the block is regular, so that a force can hold its end; under a certificate it is.

    There its symmetric part is positive definite (docs/decisions/0015-the-clutch.md).
    """
    return bool(np.linalg.cond(_own(clutch, D_V)) < SINGULAR)


def _own(clutch: Clutch, D_V: Vector) -> Vector:
    return D_V[np.ix_(clutch.ports, clutch.ports)]


def ports_of(values: Floats, clutch: Clutch) -> Floats:
    """The entries of ``values`` at the ports of ``clutch``."""
    return [values[port] for port in clutch.ports]


def ports_of_blocks(blocks: Blocks | None, m: int) -> list[list[int]]:
    """The port indices of each block among m ports; for None one block of all ports.

    Raises:
        ValueError: the blocks do not hold every port exactly once, or a block is empty.
    """
    given = [slice(None)] if blocks is None else blocks
    parts = [list(range(m))[part] if isinstance(part, slice) else list(map(int, part)) for part in given]
    if sorted(port for part in parts for port in part) != list(range(m)) or not all(parts):
        raise ValueError(f"found the blocks {parts}; expected each of {m} ports in one")
    return parts


def require_within(D_V: Vector, parts: Sequence[Sequence[int]]) -> None:
    """Refuse a feedthrough D_V (m x m, m/N) that joins ports of two blocks.

    Raises:
        ValueError: it does.
    """
    inside = np.zeros(np.shape(D_V), dtype=np.bool_)
    for part in parts:
        inside[np.ix_(part, part)] = True
    if np.any(np.asarray(D_V)[~inside]):
        raise ValueError("found a feedthrough D_V between ports of two blocks; expected one within each block")


def _difference(a: Floats, b: Floats) -> Floats:
    return list(map(sub, a, b))
