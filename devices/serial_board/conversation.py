"""The host's end of a conversation with a board, without the port: bytes and instants in, messages out.

**The board's clock.** A state says when it was measured, at t on the board's clock, and comes u > 0 later. So at the
host's instant n the board's clock shows at least t + (n - arrival). Of all states the greatest such value is the best,
for it has the least u. A force that is to end at an instant of the host is sent with that estimate of the board's
instant: it ends early by u, and never late, however long the frame is on its way. Both clocks count crystals, which
differ by some 50 millionths: the estimate forgets a state after :data:`MEMORY`, in which that is 0.1 ms.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

from manyhands.devices.serial_board.frames import About, Reader, State
from manyhands.protocol.clock import Instant, from_seconds

MEMORY: Final = from_seconds(2.0)
_WRAP: Final = 1 << 32


@dataclass(frozen=True)
class Arrived:
    """A state, and when it came.

    Attributes:
        state: as the board sent it.
        at: when it was read, ns.
        measured: when it was measured, us of the board's clock since its first state, without a wrap.
    """

    state: State
    at: Instant
    measured: int


class Conversation:
    """What a host knows of its board.

    Attributes:
        about: the board's answer to the hello; None before it.
        newest: the newest state; None before the first.
        missing: states that never came, by their numbers.
    """

    def __init__(self, nonce: int) -> None:
        """Nothing was heard yet; the answer to this host's hello has its ``nonce``."""
        self._nonce = nonce
        self.about: About | None = None
        self.newest: Arrived | None = None
        self.missing = 0
        self._reader = Reader()
        self._ahead: deque[tuple[Instant, int]] = deque()  # of the last states: arrival, and board's ns ahead of ours

    @property
    def broken(self) -> int:
        """The number of frames that were none, or of no message."""
        return self._reader.broken

    def take(self, data: bytes, at: Instant) -> list[State]:
        """Take what was read at ``at``, ns; returns the new states."""
        states = []
        for message in self._reader.take(data):
            if isinstance(message, About):
                if message.nonce == self._nonce:
                    self.about, self._reader.axes = message, message.axes
            elif self.about is not None:
                self._note(message, at)
                states.append(message)
        return states

    def _note(self, state: State, at: Instant) -> None:
        last = self.newest
        measured = state.at if last is None else last.measured + (state.at - last.state.at) % _WRAP
        if last is not None:
            self.missing += (state.number - last.state.number - 1) % (1 << 16)
        self.newest = Arrived(state, at, measured)
        ahead = 1000 * measured - at
        while self._ahead and self._ahead[-1][1] <= ahead:  # it will never be the greatest again
            self._ahead.pop()
        while self._ahead and self._ahead[0][0] < at - MEMORY:
            self._ahead.popleft()
        self._ahead.append((at, ahead))

    def board_time(self, at: Instant) -> int:
        """What the board's clock shows at ``at`` at the least, us, modulo 2^32; only after a first state."""
        return (at + self._ahead[0][1]) // 1000 % _WRAP

    def age(self, at: Instant) -> float:
        """How old the newest displacement is at ``at``, s, beside the way of the fastest state; only after one."""
        assert self.newest is not None  # noqa: S101 -- the caller has waited for it
        return 1e-9 * (at + self._ahead[0][1] - 1000 * self.newest.measured)
