"""Time: instants, durations, and the two clocks a session can run on.

A point in time is another type than a length of time, so that a type checker finds a deadline passed where a
timeout was meant. Both are whole nanoseconds: a float of seconds loses them after a few months of uptime.
Loops are handed a clock and never ask the system themselves, so a test or a lockstep run can own the time.

How far another machine's monotonic clock is ahead of ours, from an exchange of time stamps.

    ours:    sent ─────────▶                 ◀───────── received
    theirs:             heard ── answered

Half the way there and half the way back are equal but for what queues and schedulers add, so the exchange with
the shortest way tells most: its error is at most half its own round trip (RFC 5905, section 8, has the same formula).
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
        ValueError: if ``value`` is not finite.
    """
    try:
        return Duration(round(value * _NS_PER_SECOND))
    except (ValueError, OverflowError):
        raise ValueError(f"found a duration of {value} s; expected a finite number of seconds") from None


class Clock(Protocol):
    """What a loop may ask of time."""

    def now(self) -> Instant:
        """The present instant."""
        ...

    def sleep_until(self, t: Instant) -> None:
        """Return when ``now() >= t``, at once if that is so already."""
        ...


class RealtimeClock:
    """CLOCK_MONOTONIC, waking as close to the asked instant as an unprivileged process can.

    On construction the calling thread's timer slack is set to 1 ns; the kernel's default of 50 µs is
    otherwise added to every wake-up. ``timer_slack_set`` says whether the kernel granted it. Timer slack
    belongs to a thread: construct the clock in the thread that paces itself with it.
    """

    def __init__(self) -> None:
        self.timer_slack_set: bool = _set_timer_slack(1)

    def now(self) -> Instant:
        """The present instant, ns of CLOCK_MONOTONIC (comparable between processes of one machine)."""
        return Instant(time.monotonic_ns())

    def sleep_until(self, t: Instant) -> None:
        """Return when ``now() >= t``, at once if that is so; a signal handler's exception gets through."""
        # since 3.11 time.sleep is clock_nanosleep on an absolute deadline; the loop covers its rounding
        while (remaining := t - time.monotonic_ns()) > 0:
            time.sleep(remaining / _NS_PER_SECOND)


class SimulatedClock:
    """Time that passes only when somebody waits for it: starts at 0 and never goes back."""

    def __init__(self) -> None:
        self._now = Instant(0)

    def now(self) -> Instant:
        """The latest instant that was waited for."""
        return self._now

    def sleep_until(self, t: Instant) -> None:
        """Make ``t`` the present, unless it has passed."""
        self._now = max(self._now, t)


def _set_timer_slack(nanoseconds: int) -> bool:
    """Ask the kernel for a timer slack of this thread; whether it was granted."""
    try:
        prctl = ctypes.CDLL(None, use_errno=True).prctl
    except AttributeError:  # not Linux
        return False
    prctl.argtypes = [ctypes.c_int, *[ctypes.c_ulong] * 4]
    prctl.restype = ctypes.c_int
    return bool(prctl(_PR_SET_TIMERSLACK, nanoseconds, 0, 0, 0) == 0)


@dataclass(frozen=True, slots=True)
class Exchange:
    """One question and its answer, monotonic ns: ``sent`` and ``received`` by our clock, the others by theirs."""

    sent: int
    heard: int
    answered: int
    received: int

    @property
    def round_trip(self) -> Duration:
        """Time on the way, both ways, ns."""
        return Duration((self.received - self.sent) - (self.answered - self.heard))

    @property
    def offset(self) -> Duration:
        """Their clock minus ours, ns."""
        return Duration(((self.heard - self.sent) + (self.answered - self.received)) // 2)


def offset_of(exchanges: Iterable[Exchange]) -> Duration:
    """Their clock minus ours, ns, by the exchange with the shortest way.

    Raises:
        ValueError: there are none.
    """
    return min(exchanges, key=lambda exchange: exchange.round_trip).offset
