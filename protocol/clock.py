"""Time: instants, durations, the two clocks of a session, and the offset of a different machine's clock.

Instants and durations have different types, so that a type checker finds a deadline in the place of a timeout. Both are
whole nanoseconds: a float of seconds loses single nanoseconds after a few months of uptime. Loops receive a clock and
never ask the system themselves, so a test or a simulation can control the time.

The offset is how far a different machine's monotonic clock is ahead of ours, from an exchange of time stamps:

    ours:    sent ─────────▶                 ◀───────── received
    theirs:             heard ── answered

The ways there and back take equally long, apart from delays in queues and schedulers. So the exchange with the shortest
round trip is the best: its error is at most half of that round trip (RFC 5905, section 8, has the same formula).
"""

import ctypes
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NewType, Protocol

Instant = NewType("Instant", int)
"""A point in time, ns since an origin that the clock defines (CLOCK_MONOTONIC's for the realtime clock)."""

Duration = NewType("Duration", int)
"""A length of time, ns."""

_NS_PER_SECOND: Final = 1_000_000_000
_PR_SET_TIMERSLACK: Final = 29  # linux/prctl.h


def seconds(duration: Duration) -> float:
    """The duration in seconds."""
    return duration / _NS_PER_SECOND


def from_seconds(value: float) -> Duration:
    """The duration nearest to ``value`` seconds.

    Raises:
        ValueError: ``value`` is not finite.
    """
    try:
        return Duration(round(value * _NS_PER_SECOND))
    except (ValueError, OverflowError):
        raise ValueError(f"found a duration of {value} s; expected a finite number of seconds") from None


class Clock(Protocol):
    """The interface of a clock."""

    def now(self) -> Instant:
        """The present instant."""
        ...

    def sleep_until(self, t: Instant) -> None:
        """Return as soon as ``now() >= t``."""
        ...


class RealtimeClock:
    """CLOCK_MONOTONIC; it wakes as close to the given instant as an unprivileged process can.

    The constructor sets the calling thread's timer slack to 1 ns; otherwise the kernel's default of 50 µs is added to
    every wake-up. Timer slack belongs to a thread: construct the clock in the thread that paces itself with it.

    Attributes:
        timer_slack_set: whether the kernel granted the timer slack.
    """

    def __init__(self) -> None:
        self.timer_slack_set: bool = _set_timer_slack(1)

    def now(self) -> Instant:
        """The present instant, ns of CLOCK_MONOTONIC (comparable between processes of one machine)."""
        return Instant(time.monotonic_ns())

    def sleep_until(self, t: Instant) -> None:
        """Return as soon as ``now() >= t``; an exception of a signal handler is raised through this call."""
        # since Python 3.11 time.sleep is clock_nanosleep on an absolute deadline; the loop covers its rounding
        while (remaining := t - time.monotonic_ns()) > 0:
            time.sleep(remaining / _NS_PER_SECOND)


class SimulatedClock:
    """A clock that starts at 0, advances only by :meth:`sleep_until`, and never goes back."""

    def __init__(self) -> None:
        self._now = Instant(0)

    def now(self) -> Instant:
        """The latest instant that was slept until."""
        return self._now

    def sleep_until(self, t: Instant) -> None:
        """Make ``t`` the present, unless it has passed."""
        self._now = max(self._now, t)


def _set_timer_slack(nanoseconds: int) -> bool:
    """Ask the kernel for a timer slack of this thread; returns whether it was granted."""
    try:
        prctl = ctypes.CDLL(None, use_errno=True).prctl
    except AttributeError:  # not Linux
        return False
    prctl.argtypes = [ctypes.c_int, *[ctypes.c_ulong] * 4]
    prctl.restype = ctypes.c_int
    return bool(prctl(_PR_SET_TIMERSLACK, nanoseconds, 0, 0, 0) == 0)


@dataclass(frozen=True, slots=True)
class Exchange:
    """A probe and its answer, monotonic ns: ``sent`` and ``received`` by our clock, the others by the other clock."""

    sent: int
    heard: int
    answered: int
    received: int

    @property
    def round_trip(self) -> Duration:
        """The time on both ways, ns."""
        return Duration((self.received - self.sent) - (self.answered - self.heard))

    @property
    def offset(self) -> Duration:
        """The other clock minus ours, ns."""
        return Duration(((self.heard - self.sent) + (self.answered - self.received)) // 2)


def offset_of(exchanges: Iterable[Exchange]) -> Duration:
    """The other clock minus ours, ns, by the exchange with the shortest round trip.

    Raises:
        ValueError: there are no exchanges.
    """
    return min(exchanges, key=lambda exchange: exchange.round_trip).offset
