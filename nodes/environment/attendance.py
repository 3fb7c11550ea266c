"""Which couplings the environment waits for: a seat for each, and what moves it.

A seat whose coupling is silent is frozen: the tool stays where it is, its user feels no force, and the others go on
(docs/decisions/0015-the-clutch.md). A frozen coupling that shows itself is expected, that is waited for once more;
with its signal of the present tick it is seated, and let in by a ramp. One that shows itself and then does not come
costs the others some waiting each time, so it is expected again only after a pause that doubles.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Final


class Seat(StrEnum):
    """Where a coupling stands."""

    SEATED = "seated"
    EXPECTED = "expected"
    FROZEN = "frozen"
    GONE = "gone"


class Event(StrEnum):
    """What is heard of a coupling."""

    SIGNAL = "its signal of the tick"
    BEHIND = "a signal of an earlier tick"
    AHEAD = "a signal of a later tick"
    SILENT = "nothing, though others are there"
    PAUSES = "that it has lost a device"
    LOST = "that its process is gone"
    MET = "that it is back"


TRANSITIONS: Final[Mapping[tuple[Seat, Event], Seat]] = {
    (Seat.SEATED, Event.SIGNAL): Seat.SEATED,
    (Seat.SEATED, Event.BEHIND): Seat.SEATED,  # it is told once more what it has missed
    (Seat.SEATED, Event.SILENT): Seat.FROZEN,
    (Seat.SEATED, Event.PAUSES): Seat.FROZEN,
    (Seat.SEATED, Event.LOST): Seat.GONE,
    (Seat.EXPECTED, Event.SIGNAL): Seat.SEATED,
    (Seat.EXPECTED, Event.BEHIND): Seat.EXPECTED,
    (Seat.EXPECTED, Event.AHEAD): Seat.EXPECTED,
    (Seat.EXPECTED, Event.SILENT): Seat.FROZEN,
    (Seat.EXPECTED, Event.PAUSES): Seat.FROZEN,
    (Seat.EXPECTED, Event.LOST): Seat.GONE,
    (Seat.FROZEN, Event.SIGNAL): Seat.SEATED,
    (Seat.FROZEN, Event.BEHIND): Seat.EXPECTED,
    (Seat.FROZEN, Event.AHEAD): Seat.EXPECTED,  # at that tick; it was told to go on there, by this process or the last
    (Seat.FROZEN, Event.SILENT): Seat.FROZEN,
    (Seat.FROZEN, Event.PAUSES): Seat.FROZEN,
    (Seat.FROZEN, Event.LOST): Seat.GONE,
    (Seat.GONE, Event.LOST): Seat.GONE,
    (Seat.GONE, Event.PAUSES): Seat.GONE,
    (Seat.GONE, Event.MET): Seat.FROZEN,
}
"""All that can happen to a seat. What is not here cannot be heard of a coupling that stands so, and changes nothing."""

FIRST_PAUSE: Final = 8  # ticks
LONGEST_PAUSE: Final = 256
FORGIVEN: Final = 100
"""Ticks in its seat after which a coupling's earlier absences are forgotten: as many as the ramp has."""


class Attendance:
    """The seat of one coupling.

    Attributes:
        seat: where it stands.
        absences: times that it was frozen or lost.
    """

    __slots__ = ("_misses", "_since", "_until", "absences", "seat")

    def __init__(self, seat: Seat = Seat.SEATED) -> None:
        self.seat = seat
        self.absences = 0
        self._misses = 0  # in a row, or nearly
        self._since = 0  # tick at which it was seated last
        self._until = 0  # it is not expected before this tick

    def on(self, event: Event, tick: int) -> bool:
        """Something is heard of it at ``tick``; whether its seat changed."""
        before = self.seat
        after = TRANSITIONS.get((before, event), before)
        if before is Seat.FROZEN and event is Event.BEHIND and tick < self._until:
            return False
        self.seat = after
        if after is before:
            return False
        if after is Seat.SEATED:
            self._since = tick
        elif before is Seat.SEATED:
            self.absences += 1
            self._misses = 0 if tick - self._since >= FORGIVEN else self._misses + 1
        elif event is Event.SILENT:
            self._misses += 1
        if event is Event.SILENT and self._misses:  # the first time is everybody's
            self._until = tick + min(FIRST_PAUSE << min(self._misses - 1, 16), LONGEST_PAUSE)
        return True

    def pardon(self) -> None:
        """It need not wait to be expected again: there is nobody whom it could keep waiting."""
        self._until = 0
