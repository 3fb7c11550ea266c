"""The gate between a link and a core: it admits the one signal that a tick waits for, and counts all other frames.

A loop reads frames until its gate admits one or its time is over. No frame of a peer can raise an exception, and none
is lost in silence: every frame is either admitted, or counted under the reason why not. The gate refuses a frame by as
few of its bytes as possible, for a peer may send many.
"""

import math
import struct
import sys
from dataclasses import dataclass
from typing import Final

from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.codec import (
    ARRAY_OF_4,
    ARRAY_OF_5,
    BIN16,
    BUTTONS_TAIL,
    FLOAT64,
    LAYOUTS,
    LONGEST,
    UINT32,
    UINT64,
    USUAL,
    WAVE_ID,
    WAVE_TAIL,
    RawWave,
    all_finite,
    read_head,
    read_wave,
    type_of,
)
from manyhands.protocol.limits import MAX_COUNT
from manyhands.protocol.messages import SignalMessage, Wave

DROP_REASONS: Final = (
    "malformed",  # it begins as no message, breaks off, or is longer than any signal of this link
    "wrong_kind",  # it begins as a message, but not as the signal of this channel; the rest is not read
    "wrong_width",  # it has not one value for each port of the link
    "old_tick",  # it is of a tick before the one awaited: it came too late, or twice
    "future_tick",  # it is of a tick after the one awaited
    "not_finite",  # it is of the tick awaited, but a value is infinite or not a number
    # it is of the tick awaited, but a value, or its change since the last tick, is beyond its bound, or a button is
    # held down that the peer has not
    "out_of_range",
)
"""The reasons why a frame is not admitted; where several apply, the first counts."""

ROUNDING: Final = 1e-9
"""The relative tolerance of bounds for rounding: of the magnitude, and of step and magnitude together for a step."""

MOST_PERIODS: Final = 6
"""The most periods that a step may take, and by which a peer's steps may be ahead of the receiver's clock.

A device waits no longer for its force, so an honest signal is late by no more.
"""

DRIFT: Final = 1e-3
"""The relative rate by which a peer's clock may be faster than the receiver's."""

MOST_DELAY: Final = from_seconds(10.0)
"""How much longer the first wave of a life may have been on its way than a later one, ns."""

_ULPS: Final = 4.0 * sys.float_info.epsilon  # of two sums, by which their difference may be off

_HEAD: Final = struct.Struct(">3sQBQ3s")  # as USUAL, its constant bytes in groups
_TYPES: Final = {number for number, _ in LAYOUTS.values()}
_LONGEST_TAIL: Final = 9  # bytes, of the buttons: an integer of 64 bits with its tag
_NO_WAVE: Final = RawWave(0, b"", 0.0)


@dataclass(frozen=True, slots=True)
class Bounds:
    """The bounds of an honest peer's values, by port of the link and in the values' unit; ``inf`` for no bound.

    Attributes:
        magnitude: the greatest absolute value.
        step: the greatest absolute change from one tick to the next; None for no bound.
        period: T, ns, where ticks take the time that a clock shows; None where each tick is exactly one period. A late
            tick is longer: with a period, the bound of a step is multiplied by the number of periods between the two
            stamps, up to :data:`MOST_PERIODS`. A peer could claim any stamps, so all steps together are compared with
            the receiver's clock: over any time t that passes there, for each port,

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
        dropped: frames not admitted, by reason; the keys are always all of :data:`DROP_REASONS`.
        stamp: the stamp of the latest signal admitted, ns; 0 before the first.
        buttons: those that are held down by that signal, bit by bit; 0 before the first.
    """

    __slots__ = (
        "_balance",
        "_before",
        "_beyond",
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
        "_with_buttons",
        "buttons",
        "dropped",
        "stamp",
    )

    def __init__(
        self,
        kind: type[SignalMessage],
        width: int,
        bounds: Bounds | None = None,
        clock: Clock | None = None,
        buttons: int = 0,
    ) -> None:
        """Wait for the signals of one end of a link.

        Args:
            kind: the type of the signals.
            width: the number of values of a signal.
            bounds: the bounds of the values; None where they need only be finite.
            clock: the receiver's clock, which bounds with a period need.
            buttons: how many buttons the peer has.

        Raises:
            ValueError: ``bounds`` have a different width, or a period without a clock.
        """
        if bounds is not None and len(bounds.magnitude) != width:
            raise ValueError(f"found bounds of {len(bounds.magnitude)} values; expected {width}")
        if bounds is not None and bounds.period is not None and clock is None:
            raise ValueError("found bounds with a period and no clock; expected the receiver's clock")
        self._number, _ = LAYOUTS[kind]
        self._floats = struct.Struct(f"<{width}d")
        self._length = USUAL.size + self._floats.size
        self._longest = LONGEST + self._floats.size + _LONGEST_TAIL
        self._start = bytes((ARRAY_OF_4, self._number, UINT64))
        self._with_buttons, self._beyond = bytes((ARRAY_OF_5, self._number, UINT64)), 1 << buttons
        self._end = struct.pack(">BH", BIN16, self._floats.size)
        self._bounded = bounds is not None
        magnitude = (math.inf,) * width if bounds is None else bounds.magnitude
        step = (math.inf,) * width if bounds is None or bounds.step is None else bounds.step
        # at most a finite number, so that an infinite value is never within the bound
        self._magnitude = tuple(min(m * (1.0 + ROUNDING), sys.float_info.max) for m in magnitude)
        self._step = tuple(
            s * (1.0 + ROUNDING) + (ROUNDING * m if math.isfinite(m) else 0.0)
            for s, m in zip(step, magnitude, strict=True)
        )
        # at a port without a bound, or with the bound 0, a step takes no time
        self._periods_a_step = tuple(min(1.0 / s, sys.float_info.max) if s > 0.0 else 0.0 for s in self._step)
        self._before: tuple[float, ...] | None = None  # the values admitted last
        self._period = None if bounds is None else bounds.period
        self._clock = clock if self._period else None
        self._rate = (1.0 + DRIFT) / self._period if self._period else 0.0  # periods per ns
        self._balance = float(MOST_PERIODS)  # periods by which the peer's steps may still get ahead
        self._seen = Instant(0)  # when the latest signal was admitted
        self.dropped: dict[str, int] = dict.fromkeys(DROP_REASONS, 0)
        self.stamp: int = 0
        self.buttons: int = 0

    def forget(self) -> None:
        """Take the next signal as the first one, whose step has no bound, after a time in which no bound holds."""
        self._before = None

    def admitted(self, frame: bytes, tick: int) -> tuple[float, ...] | None:
        """The values of the signal of ``tick`` in ``frame``; None for any other frame, which is counted.

        Returns:
            One finite value for each port of the link, within the bounds.
        """
        usual, buttons = False, 0
        if len(frame) == self._length:
            start, found, tag, stamp, end = _HEAD.unpack_from(frame)
            usual = start == self._start and end == self._end and tag == UINT64
        elif self._beyond > 1 and len(frame) == self._length + BUTTONS_TAIL.size:
            start, found, tag, stamp, end = _HEAD.unpack_from(frame)
            kind, buttons = BUTTONS_TAIL.unpack_from(frame, self._length)
            usual = start == self._with_buttons and end == self._end and tag == UINT64 and kind == UINT32
            usual = usual and buttons > 0
        if usual and found <= MAX_COUNT and stamp <= MAX_COUNT:
            size = USUAL.size
        else:
            reason, found, stamp, size, buttons = self._other(frame)
            if reason is not None:
                self.dropped[reason] += 1
                return None
        if found != tick:
            self.dropped["old_tick" if found < tick else "future_tick"] += 1
            return None
        if buttons >= self._beyond:
            self.dropped["out_of_range"] += 1
            return None
        values: tuple[float, ...] = self._floats.unpack_from(frame, size)
        if self._bounded:
            before = self._before or values  # the first signal has no step
            taken = 0.0  # periods that the greatest of the steps needs within its bound
            for i in range(len(values)):
                value, most, step = values[i], self._magnitude[i], self._step[i]
                moved = abs(value - before[i])
                if not (-most <= value <= most and (moved <= step or moved <= step * self._periods(stamp))):
                    self.dropped["out_of_range" if all_finite(values) else "not_finite"] += 1
                    return None
                needed = moved * self._periods_a_step[i]
                if needed > taken:
                    taken = needed
            if self._clock is not None and not self._affords(taken, self._clock.now()):
                self.dropped["out_of_range"] += 1
                return None
            self._before = values
        elif not all_finite(values):
            self.dropped["not_finite"] += 1
            return None
        self.stamp, self.buttons = stamp, buttons
        return values

    def _affords(self, taken: float, now: Instant) -> bool:
        """Whether the time that has passed here allows a step of so many periods; if so, the step is charged."""
        left = self._balance + (now - self._seen) * self._rate - taken
        if left < 0.0:
            return False
        self._balance, self._seen = min(left, float(MOST_PERIODS)), now
        return True

    def _periods(self, stamp: int) -> int:
        """The periods since the latest signal admitted, by the stamps, which the peer claims."""
        if self._period is None:
            return 1
        return min(max(round((stamp - self.stamp) / self._period), 1), MOST_PERIODS)

    def of_other_tick(self, frame: bytes) -> tuple[int, bool] | None:
        """The tick of a signal that was not admitted, and whether all its values are zero; None for any other frame.

        By these a node notices that it is behind, or that its peer is. This method counts nothing.
        """
        if type_of(frame) != self._number or len(frame) > self._longest:
            return None
        head = read_head(frame)
        if head is None or head.length != self._floats.size:
            return None
        values = self._floats.unpack_from(frame, head.size)
        return (head.tick, not any(values)) if all_finite(values) else None

    def _other(self, frame: bytes) -> tuple[str | None, int, int, int, int]:
        """Read a frame that is not in the usual layout.

        Returns:
            The reason to refuse it or None, tick, stamp, size of the head, and the buttons.
        """
        if len(frame) > self._longest:
            return "malformed", 0, 0, 0, 0
        number = type_of(frame)
        if number != self._number:
            return "wrong_kind" if number in _TYPES else "malformed", 0, 0, 0, 0
        head = read_head(frame)
        if head is None:
            return "malformed", 0, 0, 0, 0
        reason = None if head.length == self._floats.size else "wrong_width"
        return reason, head.tick, head.stamp, head.size, head.buttons


@dataclass(frozen=True, slots=True)
class WaveBounds:
    """What an honest face sends at most, by port of the link.

    Attributes:
        step: the greatest |U_i(n) - U_i(n-1)|, T times the greatest wave, W^(1/2)*s.
        first: the greatest |U_i| of a life's first wave, W^(1/2)*s.
        lent: E_0, J.
        gain: the greatest energy of a tick's wave, J.
        delay: the ticks by which the first wave admitted may be later than the first that was sent.
    """

    step: tuple[float, ...]
    first: tuple[float, ...]
    lent: float
    gain: float
    delay: float


class WaveGate:
    """Admits the waves of one end of a wave link in one life of the link: the newest only, whatever carried it.

    Ticks rise, and the energy shipped never falls. Ticks also keep to the receiver's clock. With n₀ the tick of the
    first wave admitted, t the time since then and T the sender's period,

        n <= n₀ + (1 + DRIFT) t / T + MOST_DELAY / T.

    With bounds, an honest face moreover has sent, since the wave admitted before, at n', and with H what the receiver
    has shipped to it in this life,

        |U_i - U_i'| <= (n - n') step_i,      G <= lent + H + (n - n₀ + delay) gain.

    A wave that is lost is none that is missing, so no wave is awaited, and every later one is admitted.

    Attributes:
        dropped: frames not admitted, by reason; the keys are always all of :data:`DROP_REASONS`. A wave whose energy
            falls, or that is beyond its bounds, is ``out_of_range``.
        newest: the latest wave admitted; None before the first.
        granted: H, J; the receiver sets it with each wave that it sends.
    """

    __slots__ = (
        "_beyond",
        "_bounds",
        "_clock",
        "_first",
        "_floats",
        "_layout",
        "_longest",
        "_period",
        "_since",
        "_start",
        "dropped",
        "granted",
        "newest",
    )

    def __init__(
        self,
        width: int,
        period: Duration | None = None,
        clock: Clock | None = None,
        bounds: WaveBounds | None = None,
        buttons: int = 0,
    ) -> None:
        """Admit waves of ``width`` sums.

        Args:
            width: the number of ports of the link.
            period: T of the sender, ns; None where its ticks take no time that a clock shows.
            clock: the receiver's clock, which a period needs.
            bounds: of the waves; None where they need only be finite.
            buttons: how many buttons the peer has.

        Raises:
            ValueError: there is a period without a clock, or the bounds have a different width.
        """
        if bounds is not None and not len(bounds.step) == len(bounds.first) == width:
            raise ValueError(f"found bounds of {len(bounds.step)} and {len(bounds.first)} sums; expected {width}")
        if period is not None and clock is None:
            raise ValueError("found a period and no clock; expected the receiver's clock")
        size = 8 * width
        self._floats = struct.Struct(f"<{width}d")
        self._layout = struct.Struct(f">3sQ3s{size}s{WAVE_TAIL.format[1:]}")
        self._longest = LONGEST + size + WAVE_TAIL.size + _LONGEST_TAIL
        self._beyond = 1 << buttons
        self._start = (bytes((ARRAY_OF_4, WAVE_ID, UINT64)), struct.pack(">BH", BIN16, size), FLOAT64)
        self._period, self._clock, self._bounds = period, clock, bounds
        self._first, self._since = 0, Instant(0)
        self.granted = 0.0
        self.dropped: dict[str, int] = dict.fromkeys(DROP_REASONS, 0)
        self.newest: Wave | None = None

    def admitted(self, frame: bytes) -> Wave | None:
        """The wave in ``frame``, which is newer than all before; None for any other frame, which is counted."""
        if len(frame) == self._layout.size:
            start, tick, length, sums, tag, shipped = self._layout.unpack(frame)
            usual = (start, length, tag) == self._start and tick <= MAX_COUNT
        else:
            usual = False
        buttons = 0
        if not usual:
            reason, (tick, sums, shipped, buttons) = self._other(frame)
            if reason is not None:
                self.dropped[reason] += 1
                return None
        return self._take(tick, self._floats.unpack(sums), shipped, buttons)

    def _take(self, tick: int, sums: tuple[float, ...], shipped: float, buttons: int) -> Wave | None:
        newest = self.newest
        if newest is not None and tick <= newest.tick:
            self.dropped["old_tick"] += 1
            return None
        clock, period = self._clock, self._period
        if clock is not None and period is not None:
            now = clock.now()
            if newest is None:
                self._since = now
            elif (tick - self._first) * period > (1.0 + DRIFT) * (now - self._since) + MOST_DELAY:
                self.dropped["future_tick"] += 1
                return None
        if not (math.isfinite(shipped) and all(map(math.isfinite, sums))):
            self.dropped["not_finite"] += 1
            return None
        fell = shipped < (0.0 if newest is None else newest.shipped)
        beyond = fell or buttons >= self._beyond
        if beyond or (self._bounds is not None and not self._possible(self._bounds, newest, tick, sums, shipped)):
            self.dropped["out_of_range"] += 1
            return None
        if newest is None:
            self._first = tick
        self.newest = Wave(tick, sums, shipped, buttons)
        return self.newest

    def _possible(
        self, bounds: WaveBounds, newest: Wave | None, tick: int, sums: tuple[float, ...], shipped: float
    ) -> bool:
        """Whether an honest face can have sent this wave after ``newest``."""
        ticks = 0.0 if newest is None else float(tick - newest.tick)
        since = 0.0 if newest is None else float(tick - self._first)
        if shipped > (bounds.lent + self.granted + (since + bounds.delay) * bounds.gain) * (1.0 + ROUNDING):
            return False
        for i in range(len(sums)):
            at, most = (0.0, bounds.first[i]) if newest is None else (newest.sums[i], ticks * bounds.step[i])
            if abs(sums[i] - at) > most * (1.0 + ROUNDING) + _ULPS * (abs(sums[i]) + abs(at)):
                return False
        return True

    def _other(self, frame: bytes) -> tuple[str | None, RawWave]:
        """Read a frame that is not in the usual layout: the reason to refuse it or None, and the wave."""
        if len(frame) > self._longest:
            return "malformed", _NO_WAVE
        number = type_of(frame)
        if number != WAVE_ID:
            return "wrong_kind" if number in _TYPES else "malformed", _NO_WAVE
        wave = read_wave(frame)
        if wave is None:
            return "malformed", _NO_WAVE
        return None if len(wave.sums) == self._floats.size else "wrong_width", wave
