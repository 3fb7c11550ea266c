"""A goal that moves at a speed that a person's deflection of a device without motors sets (:class:`RateGoal`, pure).

A SpaceMouse and a gamepad spring back to rest, so a deflection is no position but a speed. With the deflection d of an
axis, -1 to 1, its dead zone z, the speed v at full deflection and the period T, the goal makes each tick the step

    g' = within(g + T v sgn(d) max(|d| - z, 0)/(1 - z)),

and v is no greater than the speed of the follower that smooths the goal
(:class:`manyhands.nodes.device.pointer.Follower`), so that the goal does not run far ahead of it. ``within`` is the
follower's reach, at which the goal stays.

**A hand closes only from rest**: on the device as it is, at the first deflection after all axes were in the dead zone.
So a stick that drifts from the start, or is held while a process starts anew, moves nothing: the kernel tells its state
first. A SpaceMouse tells none, and counts as at rest until it does. A button opens the hand, unless the session has a
use for it. Otherwise it stays closed: who lets the cap go holds still.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from manyhands.nodes.device.pointer import Follower
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.buttons import picked
from manyhands.nodes.kernel.orientation import Quaternion
from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Figures


class Deflected(Protocol):
    """What :class:`manyhands.nodes.device.motion_sources.source.MotionSource` has for a goal."""

    deflection: list[float]
    reports: int
    refused: int
    buttons: int
    pressed: int

    def look(self) -> bool:
        """Take in what has come, without waiting; returns whether a button was pressed."""
        ...

    def close(self) -> None:
        """Close its file. A second call does nothing."""
        ...


class RateGoal:
    """A :class:`manyhands.nodes.device.pointer.GoalSource` that integrates a deflection."""

    def __init__(
        self,
        source: Deflected,
        axes: Sequence[tuple[int, float]],
        speed: float,
        dead_zone: float,
        follower: Follower,
        T: float,
        buttons: Sequence[int] = (),
    ) -> None:
        """Hold nothing.

        Args:
            source: the device, which is closed with the goal.
            axes: by axis of the goal, the number of the source's axis and its sign.
            speed: of the goal at full deflection, m/s.
            dead_zone: the part of the full deflection up to which nothing moves, below 1.
            follower: smooths the goal; it has the reach, and the greatest speed.
            T: period, s.
            buttons: by button of the session, its number at the source.
        """
        self._buttons = tuple(buttons)
        self._used = sum(1 << number for number in buttons)
        self._source, self._follower, self._dead = source, follower, dead_zone
        steps = [T * min(speed, most) / (1.0 - dead_zone) for most in follower.speed]
        self._axes = [(axis, sign, step) for (axis, sign), step in zip(axes, steps, strict=True)]
        self._goal: Floats | None = None
        self._rested = self._lost = False
        self._clipped = 0

    def tick(self) -> Floats | None:
        """Read the device, and move the goal by one tick.

        Raises:
            ValueError: the device has gone. It is raised once; then nobody holds, for the node still has to release.
        """
        if self._lost:
            return None
        try:
            pressed = self._source.look()
        except ValueError:
            self._goal, self._lost = None, True
            raise
        if pressed and (not self._used or self._source.pressed & ~self._used):
            self._goal, self._rested = None, False
        deflection, dead = self._source.deflection, self._dead
        ways: Floats = []
        for axis, sign, step in self._axes:
            d = deflection[axis]
            beyond = abs(d) - dead
            ways.append(0.0 if beyond <= 0.0 else sign * step * (beyond if d > 0.0 else -beyond))
        moves = any(ways)
        if self._goal is None:
            if moves and self._rested:
                self._goal = ways  # of any place until the hand says where it has closed
            self._rested = self._rested or not moves
        elif moves:
            wanted = [at + way for at, way in zip(self._goal, ways, strict=True)]
            self._goal = self._follower.within(wanted)
            self._clipped += self._goal != wanted
        return self._goal

    def wanted_turn(self) -> Quaternion | None:
        """None: what a person deflects moves the device, and does not turn it."""
        return None

    def buttons(self) -> int:
        """Which of the session's buttons are held down, bit by bit; none of a device that has gone."""
        return 0 if self._lost else picked(self._source.buttons, self._buttons)

    def begin(self, position: Floats) -> Floats:
        """The goal begins where the device is, or at the nearest point of the reach."""
        self._goal = self._follower.within(position)
        return self._goal

    def figures(self) -> Figures:
        """Whether the device is held, and counts: reports, ticks in which the goal was beyond its reach, refusals."""
        return Figures(
            {
                names.GRASPED: 0.0 if self._goal is None else 1.0,
                names.GRASPS: float(self._source.reports),
                names.GRASPS_CLIPPED: float(self._clipped),
                names.GRASPS_REFUSED: float(self._source.refused),
            }
        )

    def close(self) -> None:
        """Close the device's file. A second call does nothing."""
        self._source.close()
