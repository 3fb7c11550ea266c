"""Two ends of a datagram path and somebody who has everything but their key: what was sealed opens once, in rising
order and at its own end, nothing else does, and the state of the path is what can be known from that.

The frames that open go on to a gate of waves, together with frames that the rogue brings over the link.
"""

from __future__ import annotations

from typing import Final

from draws import Draws
from forger import Forger

from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.gate import DROP_REASONS, WaveGate
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_COUNT
from manyhands.protocol.messages import Message, PathKey, Ready, Wave
from manyhands.protocol.path import (
    KEEP_ALIVE,
    PROBE,
    SILENCE,
    Direction,
    NotOpened,
    PathEnd,
    PathState,
    connection_of,
)

MOST_STEPS: Final = 64
KEY: Final = PathKey(b"8 bytes!", b"a key that the rogue has not got", 7400)
OTHER: Final = PathKey(b"8 bytes!", b"a key of the rogue's own, or old", 7400)

STEPS: Final = ("send", "deliver", "deliver changed", "deliver bytes", "seal", "quiet", "frame")
TIMES: Final = (0, 1, 10**6, PROBE - 1, PROBE, SILENCE - 1, SILENCE, KEEP_ALIVE)
TICKS: Final = (0, 1, 2, 2**32, MAX_COUNT - MOST_STEPS * 3)


def check(data: bytes) -> None:
    """Play the traffic that ``data`` decides; raise if a path or its gate breaks one of its promises."""
    play(Draws(data))


def play(draws: Draws) -> None:
    """The same for decisions from anywhere."""
    now = Instant(0)
    ends = {direction: _End(direction, now) for direction in Direction}
    tick = draws.choice(TICKS)
    rogue = {direction: PathEnd(OTHER, direction, now) for direction in Direction}
    for _ in range(MOST_STEPS):
        if not draws.more:
            break
        now = Instant(now + draws.choice(TIMES))
        to = draws.choice(tuple(Direction))
        end, peer = ends[to], ends[Direction(1 - to)]
        match draws.choice(STEPS):
            case "send":
                tick += draws.integer(1, 3)
                end.send(tick, draws, now)
            case "deliver":
                end.arrive(_one(draws, ends), now, peer)
            case "deliver changed":
                end.arrive(_changed(draws, _one(draws, ends)), now, peer)
            case "deliver bytes":
                head = bytes([draws.integer(0, 2)]) + KEY.connection + draws.integer(0, 2**64 - 1).to_bytes(8, "big")
                end.arrive(head[: draws.integer(0, len(head))] + draws.blob(80), now, peer)
            case "seal":
                tick += 1
                sealed = rogue[peer.sends].outgoing(tick, encode(Wave(tick, (1.0,), 0.0)), now).datagram
                end.arrive(sealed or b"", now, peer)
            case "quiet":
                end.repeat(now)
            case _:
                end.take(Forger(draws, _in_place(tick)).frame())
        for one in ends.values():
            one.require_known(now)


class _End:
    """One end, and what is to be known of it, kept a second time."""

    def __init__(self, sends: Direction, now: Instant) -> None:
        self.sends = sends
        self.path = PathEnd(KEY, sends, now)
        self.gate = WaveGate(1)
        self.sealed: dict[bytes, tuple[int, bytes, bool]] = {}  # datagram: tick, frame, what it says
        self.arrivals = self.frames = self.admitted = 0
        self.newest = -1
        self.heard: tuple[Instant, bool] | None = None  # when the latest opened, and what it said
        self.sent_at: Instant | None = None

    def state(self, now: Instant) -> PathState:
        if self.heard is None or now - self.heard[0] >= SILENCE:
            return PathState.DOWN
        return PathState.UP if self.heard[1] else PathState.INIT

    def require_known(self, now: Instant) -> None:
        assert self.path.state(now) is self.state(now), f"found {self.path.state(now)}; expected {self.state(now)}"
        assert self.path.opened + sum(self.path.refused.values()) == self.arrivals
        assert self.admitted + sum(self.gate.dropped.values()) == self.frames

    def send(self, tick: int, draws: Draws, now: Instant) -> None:
        frame = encode(Wave(tick, (draws.integer(0, 255) / 16,), 0.25 * draws.integer(0, 255)))
        state = self.state(now)
        datagram, link = self.path.outgoing(tick, frame, now)
        assert link == (state is not PathState.UP), "a wave is carried by one of the two where the path is up"
        due = self.sent_at is None or now - self.sent_at >= PROBE
        allowed = self.sends is Direction.TO_ENVIRONMENT or state is not PathState.DOWN
        assert (datagram is not None) == (state is PathState.UP or (due and allowed))
        if datagram is not None:
            assert tick not in {sealed for sealed, _, _ in self.sealed.values()}, "a nonce is used twice"
            self.sealed[datagram] = (tick, frame, state is not PathState.DOWN)
            self.sent_at = now

    def repeat(self, now: Instant) -> None:
        datagram = self.path.repeated(now)
        if datagram is not None:
            assert datagram in self.sealed, "a repeated datagram is another one"
            assert self.sends is Direction.TO_ENVIRONMENT
            self.sent_at = now

    def arrive(self, datagram: bytes, now: Instant, peer: _End) -> None:
        tick, frame, said = peer.sealed.get(datagram, (-1, b"", False))
        before = dict(self.path.refused)
        self.arrivals += 1
        found = self.path.opens(datagram, now)
        if tick > self.newest:
            assert found == frame, f"found {found!r} in what was sealed of {frame!r}"
            self.newest, self.heard = tick, (now, said)
            self.take(found or b"")
            return
        assert found is None, f"opened {datagram.hex()}"
        risen = [reason for reason in NotOpened if self.path.refused[reason] != before[reason]]
        assert len(risen) == 1, f"counted under {risen}"
        assert (risen[0] is NotOpened.NO_DATAGRAM) == (connection_of(datagram) is None)
        assert tick < 0 or risen[0] is NotOpened.REPLAYED, f"a copy is counted under {risen[0]}"

    def take(self, frame: bytes) -> None:
        newest = self.gate.newest
        message = decode(frame, MAX_CONTROL_BYTES)
        fits = isinstance(message, Wave) and len(message.sums) == 1
        if isinstance(message, Wave) and fits:
            fits = message.tick > (-1 if newest is None else newest.tick)
            fits = fits and message.shipped >= (0.0 if newest is None else newest.shipped)
        before = dict(self.gate.dropped)
        self.frames += 1
        found = self.gate.admitted(frame)
        self.admitted += found is not None
        assert (found is not None) == fits, f"found {found} in {frame.hex()} after {newest}"
        assert found is None or found == message == self.gate.newest
        if found is None:
            assert [self.gate.dropped[reason] - before[reason] for reason in DROP_REASONS].count(1) == 1
            assert self.gate.newest is newest


def _one(draws: Draws, ends: dict[Direction, _End]) -> bytes:
    """Any datagram that either end has sent so far."""
    sent = [datagram for end in ends.values() for datagram in end.sealed]
    return sent[draws.integer(0, len(sent) - 1)] if sent else b""


def _changed(draws: Draws, datagram: bytes) -> bytes:
    place = draws.integer(0, len(datagram))
    return datagram[:place] + draws.blob(20) + datagram[place + draws.integer(0, 20) :]


def _in_place(tick: int) -> dict[str, Message]:
    return {
        "newer": Wave(min(tick + 1, MAX_COUNT), (0.5,), 64.0),
        "older": Wave(max(tick - 3, 0), (0.5,), 64.0),
        "wide": Wave(tick, (0.5, 0.5), 64.0),
        "poor": Wave(min(tick + 1, MAX_COUNT), (0.5,), -1.0),
        "key": KEY,
        "ready": Ready(),
    }
