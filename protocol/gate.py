"""Between a link and a core: admits the one signal that a tick is waiting for, and counts the rest.

A loop reads frames until its gate admits one or its time is up. Nothing that a peer sends can raise through it, and
nothing is lost in silence: every frame is either admitted or counted under the reason why not. What is refused is
refused by as little of the frame as will do, for a peer may send many.
"""

import math
import struct
import sys
from dataclasses import dataclass
from typing import Final

from manyhands.protocol.clock import Clock, Duration, Instant
from manyhands.protocol.codec import ARRAY_OF_4, BIN16, LAYOUTS, LONGEST, UINT64, USUAL, read_head, type_of
from manyhands.protocol.limits import MAX_COUNT
from manyhands.protocol.messages import SignalMessage

DROP_REASONS: Final = (
    "malformed",  # no message's type at the start, a signal that breaks off, or longer than this link's can be
    "wrong_kind",  # begins as a message, but not as the signal of this channel; no more of it is looked at
    "wrong_width",  # not one value for each port of the link
    "old_tick",  # of a tick before the one awaited: came too late, or twice
    "future_tick",  # of a tick after the one awaited
    "not_finite",  # of the tick awaited, but a value is infinite or not a number
    "out_of_range",  # of the tick awaited, but a value, or its change since the last tick, is beyond its bound
)
"""Why a frame is not admitted; where several apply, the first."""

ROUNDING: Final = 1e-9
"""What bounds yield to rounding, relative: to the magnitude, and to step and magnitude together for a step."""

MOST_PERIODS: Final = 6
"""Periods that a step may take at most, and that a peer's steps may be ahead of the receiver's clock.

A device waits no longer for its force, so that an honest signal is late by no more.
"""

DRIFT: Final = 1e-3
"""By how much a peer's clock may be faster than the receiver's, relative."""

_HEAD: Final = struct.Struct(">3sQBQ3s")  # as USUAL, its constant bytes in groups
_TYPES: Final = {number for number, _ in LAYOUTS.values()}


@dataclass(frozen=True, slots=True)
class Bounds:
    """What an honest peer's values keep within, by port of the link and in the values' unit; ``inf`` for no bound.

    Attributes:
        magnitude: greatest absolute value.
        step: greatest absolute change from one tick to the next; None for no bound.
        period: T, ns, where ticks last as long as they do by a clock; None where each is exactly one period. A tick
            that was late is longer: with a period, a step may be as many times as great as periods have passed between
            the two stamps, up to :data:`MOST_PERIODS`. What stamps claim is the peer's word, so all steps together are
            held against the receiver's clock: over any time t that passes there, for each port,

                sum |step| <= bound ((1 + DRIFT) t / T + MOST_PERIODS).

    Raises:
        ValueError: an entry is negative or not a number, or the two differ in length.
    """

    magnitude: tuple[float, ...]
    step: tuple[float, ...] | None = None
    period: Duration | None = None

    def __post_init__(self) -> None:
        step = self.magnitude if self.step is None else self.step
        if len(step) != len(self.magnitude):
            raise ValueError(f"found {len(step)} steps for {len(self.magnitude)} magnitudes; expected one each")
        for bound in (*self.magnitude, *step):
            if not bound >= 0.0:
                raise ValueError(f"found the bound {bound}; expected 0 or more")


class Gate:
    """Admits the signals of one channel on one link.

    Attributes:
        dropped: frames not admitted, by reason; the keys are :data:`DROP_REASONS`, always all of them.
        stamp: the stamp of the signal admitted last, ns; 0 before the first.
    """

    __slots__ = (
        "_balance",
        "_before",
        "_bounded",
        "_clock",
        "_end",
        "_floats",
        "_length",
        "_longest",
        "_magnitude",
        "_number",
        "_period",
        "_periods_a_step",
        "_rate",
        "_seen",
        "_start",
        "_step",
        "dropped",
        "stamp",
    )

    def __init__(
        self, kind: type[SignalMessage], width: int, bounds: Bounds | None = None, clock: Clock | None = None
    ) -> None:
        """Wait for signals of ``kind`` with ``width`` values, ``bounds`` one for each of them.

        Args:
            kind: of signals.
            width: values of a signal.
            bounds: what they keep within; None for finite values.
            clock: the receiver's, needed for bounds with a period.

        Raises:
            ValueError: ``bounds`` are for another width, or have a period where there is no clock.
        """
        if bounds is not None and len(bounds.magnitude) != width:
            raise ValueError(f"found bounds of {len(bounds.magnitude)} values; expected {width}")
        if bounds is not None and bounds.period is not None and clock is None:
            raise ValueError("found bounds with a period and no clock; expected the receiver's clock")
        self._number, _ = LAYOUTS[kind]
        self._floats = struct.Struct(f"<{width}d")
        self._length = USUAL.size + self._floats.size
        self._longest = LONGEST + self._floats.size
        self._start = bytes((ARRAY_OF_4, self._number, UINT64))
        self._end = struct.pack(">BH", BIN16, self._floats.size)
        self._bounded = bounds is not None
        magnitude = (math.inf,) * width if bounds is None else bounds.magnitude
        step = (math.inf,) * width if bounds is None or bounds.step is None else bounds.step
        # a finite number at most, so that an infinite value is never within
        self._magnitude = tuple(min(m * (1.0 + ROUNDING), sys.float_info.max) for m in magnitude)
        self._step = tuple(
            s * (1.0 + ROUNDING) + (ROUNDING * m if math.isfinite(m) else 0.0)
            for s, m in zip(step, magnitude, strict=True)
        )
        # of a port without a bound, or with 0, no step takes any time
        self._periods_a_step = tuple(min(1.0 / s, sys.float_info.max) if s > 0.0 else 0.0 for s in self._step)
        self._before: tuple[float, ...] | None = None  # the values admitted last
        self._period = None if bounds is None else bounds.period
        self._clock = clock if self._period else None
        self._rate = (1.0 + DRIFT) / self._period if self._period else 0.0  # periods a ns
        self._balance = float(MOST_PERIODS)  # periods of steps that the peer may yet be ahead
        self._seen = Instant(0)  # when the last signal was admitted
        self.dropped: dict[str, int] = dict.fromkeys(DROP_REASONS, 0)
        self.stamp: int = 0

    def forget(self) -> None:
        """Take the next signal as the first: so much time has passed that its step says nothing."""
        self._before = None

    def admitted(self, frame: bytes, tick: int) -> tuple[float, ...] | None:
        """The values of the signal in ``frame`` if it is that of ``tick``; otherwise None, and it is counted.

        Returns:
            One value for each port of the link, finite, within the bounds.
        """
        usual = False
        if len(frame) == self._length:
            start, found, tag, stamp, end = _HEAD.unpack_from(frame)
            usual = start == self._start and end == self._end and tag == UINT64
        if usual and found <= MAX_COUNT and stamp <= MAX_COUNT:
            size = USUAL.size
        else:
            reason, found, stamp, size = self._other(frame)
            if reason is not None:
                self.dropped[reason] += 1
                return None
        if found != tick:
            self.dropped["old_tick" if found < tick else "future_tick"] += 1
            return None
        values = self._floats.unpack_from(frame, size)
        if self._bounded:
            before = self._before or values  # the first has nothing to be compared with
            taken = 0.0  # periods that the greatest of the steps takes within its bound
            for value, last, most, step, periods in zip(
                values, before, self._magnitude, self._step, self._periods_a_step, strict=True
            ):
                moved = abs(value - last)
                if not (-most <= value <= most and (moved <= step or moved <= step * self._periods(stamp))):
                    self.dropped["out_of_range" if all(map(math.isfinite, values)) else "not_finite"] += 1
                    return None
                if moved * periods > taken:
                    taken = moved * periods
            if self._clock is not None and not self._affords(taken, self._clock.now()):
                self.dropped["out_of_range"] += 1
                return None
            self._before = values
        elif not all(map(math.isfinite, values)):  # for a few ports six times as fast as numpy's isfinite().all()
            self.dropped["not_finite"] += 1
            return None
        self.stamp = stamp
        return values

    def _affords(self, taken: float, now: Instant) -> bool:
        """Whether a step of so many periods keeps within the time that has passed here; it is charged if it does."""
        left = self._balance + (now - self._seen) * self._rate - taken
        if left < 0.0:
            return False
        self._balance, self._seen = min(left, float(MOST_PERIODS)), now
        return True

    def _periods(self, stamp: int) -> int:
        """How many periods have passed since the signal admitted last, by the stamps: what the peer claims."""
        if self._period is None:
            return 1
        return min(max(round((stamp - self.stamp) / self._period), 1), MOST_PERIODS)

    def of_other_tick(self, frame: bytes) -> tuple[int, bool] | None:
        """Of a frame not admitted: its tick, and whether all its values are zero; None if it is no such signal.

        For who has lost the thread, and for who has to tell a peer that has; nothing is counted here.
        """
        if type_of(frame) != self._number or len(frame) > self._longest:
            return None
        head = read_head(frame)
        if head is None or len(frame) != head.size + self._floats.size:
            return None
        values = self._floats.unpack_from(frame, head.size)
        return (head.tick, not any(values)) if all(map(math.isfinite, values)) else None

    def _other(self, frame: bytes) -> tuple[str | None, int, int, int]:
        """Why a frame in another layout than the usual is not the signal of this link; or tick, stamp, size of head."""
        if len(frame) > self._longest:
            return "malformed", 0, 0, 0
        number = type_of(frame)
        if number != self._number:
            return "wrong_kind" if number in _TYPES else "malformed", 0, 0, 0
        head = read_head(frame)
        if head is None:
            return "malformed", 0, 0, 0
        tick, stamp, size = head
        return None if len(frame) == size + self._floats.size else "wrong_width", tick, stamp, size
