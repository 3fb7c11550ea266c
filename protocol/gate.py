"""Between a link and a core: admits the one signal that a tick is waiting for, and counts the rest.

A loop reads frames until its gate admits one or its time is up. Nothing that a peer sends can raise through it, and
nothing is lost in silence: every frame is either admitted or counted under the reason why not.
"""

from typing import Final

from manyhands.protocol.codec import Flaw, Malformed, decode
from manyhands.protocol.limits import MAX_FRAME_BYTES
from manyhands.protocol.messages import SignalMessage, Values

DROP_REASONS: Final = (
    "malformed",  # not a message of the protocol, or longer than a signal may be
    "wrong_kind",  # a message, but not the signal of this channel (or of another protocol version)
    "wrong_width",  # not one value for each port of the link
    "not_finite",  # a value is infinite or not a number
    "old_tick",  # of a tick before the one awaited: came too late, or twice
    "future_tick",  # of a tick after the one awaited
)


class Gate:
    """Admits the signals of one channel on one link.

    Attributes:
        dropped: frames not admitted, by reason; the keys are :data:`DROP_REASONS`, always all of them.
        stamp: the stamp of the signal admitted last, ns; 0 before the first.
    """

    __slots__ = ("_kind", "_width", "dropped", "stamp")

    def __init__(self, kind: type[SignalMessage], width: int) -> None:
        self._kind = kind
        self._width = width
        self.dropped: dict[str, int] = dict.fromkeys(DROP_REASONS, 0)
        self.stamp: int = 0

    def admit(self, frame: bytes, tick: int) -> Values | None:
        """The values of the signal in ``frame`` if it is that of ``tick``; otherwise None, and it is counted.

        Returns:
            One value for each port of the link, float64, finite, read only.
        """
        message = decode(frame, MAX_FRAME_BYTES)
        if isinstance(message, self._kind):
            if message.values.size != self._width:
                reason = "wrong_width"
            elif message.tick == tick:
                self.stamp = message.stamp
                return message.values
            else:
                reason = "old_tick" if message.tick < tick else "future_tick"
        elif isinstance(message, Malformed):
            reason = "not_finite" if message.flaw is Flaw.NOT_FINITE else "malformed"
        else:
            reason = "wrong_kind"
        self.dropped[reason] += 1
        return None
