"""Which couplings the environment waits for: a seat for each, and what moves it.

A seat whose coupling is silent is frozen: the tool stays where it is, its user feels no force, and the others go on
(docs/decisions/0015-the-clutch.md). So is a coupling that comes late again and again
(:mod:`manyhands.nodes.environment.late_arrivals`). A frozen coupling that shows itself is expected, that is waited for
once more; with its signal of the present tick it is seated, and let in by a ramp. One that shows itself and then does
not come, or comes late again, costs the others some waiting each time. So it is expected again only after a pause that
doubles, and whatever it says in the pause changes nothing.
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
    LATE = "its signal, after all others again and again"
    PAUSES = "that it has lost a device"
    LOST = "that its process is gone"
    MET = "that it is back"


TRANSITIONS: Final[Mapping[tuple[Seat, Event], Seat]] = {
    (Seat.SEATED, Event.SIGNAL): Seat.SEATED,
    (Seat.SEATED, Event.BEHIND): Seat.SEATED,  # it is told once more what it has missed
    (Seat.SEATED, Event.SILENT): Seat.FROZEN,
    (Seat.SEATED, Event.LATE): Seat.FROZEN,
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

_SHOWS_ITSELF: Final = (Event.SIGNAL, Event.BEHIND, Event.AHEAD)

FIRST_PAUSE: Final = 8  # ticks
LONGEST_PAUSE: Final = 256
FORGIVEN: Final = 100
"""Ticks in its seat after which a coupling's earlier absences are forgotten: as many as the ramp has."""


class Attendance:
    """The seat of one coupling.

    Attributes:
        seat: where it stands.
        absences: times that it was frozen or lost.
        since: tick at which it was seated last.
    """

    __slots__ = ("_misses", "_until", "absences", "seat", "since")

    def __init__(self, seat: Seat = Seat.SEATED) -> None:
        self.seat = seat
        self.absences = 0
        self._misses = 0  # in a row, or nearly
        self.since = 0
        self._until = 0  # it is not expected before this tick

    def on(self, event: Event, tick: int) -> bool:
        """Something is heard of it at ``tick``; whether its seat changed."""
        before = self.seat
        after = TRANSITIONS.get((before, event), before)
        if self.pauses(tick) and event in _SHOWS_ITSELF:
            return False
        self.seat = after
        if after is before:
            return False
        if after is Seat.SEATED:
            self.since = tick
        elif before is Seat.SEATED:
            self.absences += 1
            self._misses = 0 if tick - self.since >= FORGIVEN else self._misses + 1
            if event is Event.LATE:  # many late ticks, and not the first
                self._misses = max(1, self._misses)
        elif event is Event.SILENT:
            self._misses += 1
        if event in (Event.SILENT, Event.LATE) and self._misses:  # the first silence is everybody's
            self._until = tick + min(FIRST_PAUSE << min(self._misses - 1, 16), LONGEST_PAUSE)
        return True

    def pauses(self, tick: int) -> bool:
        """Whether it is frozen, and not expected yet at ``tick`` whatever it says."""
        return self.seat is Seat.FROZEN and tick < self._until

    def pardon(self) -> None:
        """It need not wait to be expected again: there is nobody whom it could keep waiting."""
        self._until = 0
