"""Frames that do not belong on a link, as a peer with a real key could send beside or instead of honest ones.

Each is sent before the honest signal of a tick, while the other side waits for that signal.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from manyhands.protocol.codec import ARRAY_OF_4, BIN16, LAYOUTS, UINT64, USUAL, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_COUNT
from manyhands.protocol.messages import Fault, Force, Reaction, Sample, SignalMessage, Stop, Tool

JUMP: Final = 0.01
"""m in one tick: within every bound of magnitude of the test's session, and beyond every bound of step."""

NEXT_KIND: Final[Mapping[type[SignalMessage], type[SignalMessage]]] = {
    Sample: Force,
    Force: Sample,
    Tool: Reaction,
    Reaction: Tool,
}
"""The signal that goes the other way."""


@dataclass(frozen=True)
class Honest:
    """The honest signal about to leave, and the one before."""

    kind: type[SignalMessage]
    tick: int
    stamp: int
    values: tuple[float, ...]
    frame: bytes
    before: bytes
    first: bytes

    def altered(
        self, *, kind: type[SignalMessage] | None = None, tick: int | None = None, values: tuple[float, ...] = ()
    ) -> bytes:
        """The same signal with something else in it, which the codec may refuse to write."""
        return signal(kind or self.kind, self.tick if tick is None else tick, self.stamp, values or self.values)


def signal(kind: type[SignalMessage], tick: int, stamp: int, values: tuple[float, ...]) -> bytes:
    """A signal's frame, even if the codec would refuse it."""
    data = struct.pack(f"<{len(values)}d", *values)
    return USUAL.pack(ARRAY_OF_4, LAYOUTS[kind][0], UINT64, tick, UINT64, stamp, BIN16, len(data)) + data


@dataclass(frozen=True)
class Stray:
    """A frame that is not admitted; ``reason`` names its count.

    ``bounded``: where the receiver bounds what it admits; elsewhere such a signal is a signal like others.
    """

    reason: str
    frame: Callable[[Honest], bytes]
    bounded: bool = False


def _all(value: float) -> Callable[[Honest], bytes]:
    return lambda honest: honest.altered(values=(value,) * len(honest.values))


STRAYS: Final[Mapping[str, Stray]] = {
    "nothing at all": Stray("malformed", lambda honest: b""),
    "bytes that are no message": Stray("malformed", lambda honest: b"\xc1" * 40),
    "text": Stray("malformed", lambda honest: b"GET / HTTP/1.1\r\n\r\n"),
    "a signal that breaks off": Stray("malformed", lambda honest: honest.frame[:-1]),
    "a signal with a tail": Stray("malformed", lambda honest: honest.frame + b"\x00"),
    "a signal twice in a frame": Stray("malformed", lambda honest: 2 * honest.frame),
    "the longest frame there is": Stray("malformed", lambda honest: bytes(MAX_CONTROL_BYTES)),
    "a tick beyond counting": Stray("malformed", lambda honest: honest.altered(tick=MAX_COUNT + 1)),
    "a stop": Stray("wrong_kind", lambda honest: encode(Stop("the session ends"))),
    "a fault": Stray("wrong_kind", lambda honest: encode(Fault("it is all over"))),
    "the signal of the other direction": Stray(
        "wrong_kind", lambda honest: honest.altered(kind=NEXT_KIND[honest.kind])
    ),
    "a value too many": Stray("wrong_width", lambda honest: honest.altered(values=(*honest.values, 0.0))),
    "the last signal once more": Stray("old_tick", lambda honest: honest.before),
    "the first signal once more": Stray("old_tick", lambda honest: honest.first),
    "other values for the last tick": Stray("old_tick", lambda honest: honest.altered(tick=honest.tick - 1)),
    "the next tick": Stray("future_tick", lambda honest: honest.altered(tick=honest.tick + 1)),
    "the last tick of all": Stray("future_tick", lambda honest: honest.altered(tick=MAX_COUNT)),
    "not a number": Stray("not_finite", _all(math.nan)),
    "infinite": Stray("not_finite", _all(math.inf)),
    "minus infinite": Stray("not_finite", _all(-math.inf)),
    "an absurd magnitude": Stray("out_of_range", _all(1e300), bounded=True),
    "a jump": Stray(
        "out_of_range",
        lambda honest: honest.altered(values=tuple(value + JUMP for value in honest.values)),
        bounded=True,
    ),
}
"""What each is."""
