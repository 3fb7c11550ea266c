"""What a fake device has to offer to the campaign of faults (tests/system/device_faults.py).

A :class:`FarSide` is the fake behind its wire, as the campaign sees it:

- ``order``: gives it orders, a line each; what a fault orders is in its row (tests/system/device_rows.py);
- ``mark``: has it note a number in its record, at the instant of the call, before the orders that are given with it;
- ``force``: what its motors exert at this instant;
- ``record``: what it has noted since it was made (:class:`Record`), by the realtime clock of this machine
  (CLOCK_MONOTONIC, ns), which is the far side's own: no message of the session's sets it.

A fake with ``order`` and ``asked`` as tests/fakes/board.py becomes one by a few lines in its row: it writes down when
the force on its motors changes, and what it was asked to exert and until when.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

Force = tuple[float, ...]


@dataclass(frozen=True)
class Given:
    """A force as it came over the wire.

    Attributes:
        at: when, ns.
        until: when it ends by what the wire says, ns.
        f: the force that the device makes of it: within its limits, and in its precision, N.
    """

    at: int
    until: int
    f: Force


@dataclass(frozen=True)
class Record:
    """What a fake has noted.

    Attributes:
        motors: when the force on the motors has changed, ns, and to what, N.
        given: the forces that it received; None where it does not tell.
        marks: when each mark was set, ns.
        busy: when the fake itself had no turn, from and to, ns: its machine was busy, and a real device is not.
        stalls: when it took nothing from the wire, by order, and until it had caught up, ns; for a wire that does not
            say when a force ends.
    """

    motors: Sequence[tuple[int, Force]]
    given: Sequence[Given] | None
    marks: Mapping[int, int]
    busy: Sequence[tuple[int, int]]
    stalls: Sequence[tuple[int, int]] = ()

    def stalled(self, begin: int, end: int) -> bool:
        """Whether a time meets one of ``stalls``."""
        return any(since <= end and begin <= until for since, until in self.stalls)

    def to_zero(self, mark: int) -> tuple[int, int] | None:
        """How long after a mark the motors exerted no force, ns, and for how much of that the fake had no turn.

        None where they went on.
        """
        at = self.marks[mark]
        acting = [f for begin, f in self.motors if begin <= at][-1:]
        ended = at if not acting or not any(acting[0]) else None
        if ended is None:
            ended = next((begin for begin, f in self.motors if begin > at and not any(f)), None)
        if ended is None:
            return None
        return ended - at, self.without_turn(at, ended)

    def without_turn(self, since: float, until: float) -> int:
        """For how much of the time between two instants the fake had no turn, ns."""
        return int(sum(max(0, min(end, until) - max(begin, since)) for begin, end in self.stretches()))

    def stretches(self) -> list[tuple[int, int]]:
        """``busy``, without what these times have in common."""
        out: list[tuple[int, int]] = []
        for begin, end in sorted(self.busy):
            if out and begin <= out[-1][1]:
                out[-1] = out[-1][0], max(end, out[-1][1])
            else:
                out.append((begin, end))
        return out

    def exerted(self) -> list[tuple[int, int, Force]]:
        """Each force that was not zero, with its beginning and its end, ns; the last one has none, and is left out."""
        return [(at, end, f) for (at, f), (end, _) in zip(self.motors, self.motors[1:], strict=False) if any(f)]


class FarSide(Protocol):
    """A fake behind its wire.

    Attributes:
        parameters: what the session's driver is given to find it.
    """

    parameters: Mapping[str, object]

    def order(self, *lines: str) -> None:
        """Give orders, one after the other."""
        ...

    def mark(self, number: int, *lines: str) -> None:
        """Note a number, and give orders."""
        ...

    def force(self) -> Sequence[float]:
        """What the motors exert now, N."""
        ...

    def record(self) -> Record:
        """What was noted so far."""
        ...
