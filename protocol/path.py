"""One end of a datagram path between a coupling and the environment: sealed datagrams, and the state of the path. Pure.

Beyond a LAN, ZeroMQ's TCP delivers a wave late wherever an earlier packet was lost, though a wave needs no earlier one.
So the two ends of a wave link also exchange datagrams, each of which holds one wave:

    heard, 1 byte | connection, 8 bytes | n, 8 bytes | token, 8 bytes | the wave's frame, sealed

The seal is ChaCha20-Poly1305 [Nir2018]_ with the key that the two ends share for one life of their link (a
:class:`~manyhands.protocol.messages.PathKey`). Its nonce is the direction (4 bytes) and n, its additional data are the
first 25 bytes. So no datagram opens at another path, in the other direction, or in another life.

**Replay.** Of a wave link only the newest wave counts. So the window is that number alone: a datagram whose n is not
above that of the latest one that has opened is refused, before any cryptography.

**Addresses.** The sender of a datagram chooses the address that it seems to come from. So the environment answers an
address with no more bytes than came from it until the address is proved, as QUIC validates a path [Iyengar2021]_: its
datagrams to that address have a random token, and one that comes from there has the same. :class:`Replies` keeps this.

**State.** Datagrams may come through one way and not the other way. Each datagram states whether its sender has heard
one in the last :data:`SILENCE`; from that, either end knows the state of the path as in BFD [Katz2010]_. While the path
is not UP, the waves go over the ZeroMQ link that the two ends have anyway. A receiver takes the newest wave, whichever
way it came, so a change of state is no event for the link.
"""

import secrets
import struct
from collections.abc import Callable, Mapping
from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.codec import BUTTONS_TAIL, CONNECTION_BYTES, WAVE_HEAD, WAVE_TAIL
from manyhands.protocol.limits import MAX_COUNT, MAX_DATAGRAM_BYTES
from manyhands.protocol.messages import PathKey

SILENCE: Final = from_seconds(0.5)
"""After so long without a datagram of the peer, none comes through any more, ns."""

PROBE: Final = from_seconds(0.1)
"""The time from one datagram to the next while the path is not UP, ns."""

KEEP_ALIVE: Final = from_seconds(15.0)
"""After so long without a datagram of its own, a coupling repeats its latest one, ns.

A network address translator forgets an address that is silent, some after 30 s (RFC 4787 asks for two minutes).
"""

TOKEN_BYTES: Final = 8
"""Length of a token, bytes, as that of QUIC's challenges [Iyengar2021]_."""

NO_TOKEN: Final = bytes(TOKEN_BYTES)
"""What a coupling sends before it has heard the environment, and proves nothing."""

_HEADER: Final = struct.Struct(f">B{CONNECTION_BYTES}sQ{TOKEN_BYTES}s")
_NONCE: Final = struct.Struct(">IQ")
_TAG_BYTES: Final = 16

OVERHEAD: Final = _HEADER.size + _TAG_BYTES
"""What a datagram adds to the frame in it, bytes."""

MOST_PORTS: Final = (MAX_DATAGRAM_BYTES - OVERHEAD - WAVE_HEAD.size - WAVE_TAIL.size - BUTTONS_TAIL.size) // 8
"""The most ports of a link whose waves fit into datagrams."""


class NotOpened(StrEnum):
    """The reasons for which a datagram is not opened; where several apply, the first counts."""

    NO_DATAGRAM = "no_datagram"  # it has not the form of one
    UNKNOWN_PATH = "unknown_path"  # it names a connection that there is not, or is no longer
    REPLAYED = "replayed"  # its n is not above that of the latest that was opened: a copy, or overtaken on its way
    FORGED = "forged"  # it was not sealed with the path's key, in this direction and as it arrived


class PathState(StrEnum):
    """What one end knows of a path."""

    DOWN = "down"  # nothing comes through
    INIT = "init"  # the peer's datagrams come through, and it does not hear ours
    UP = "up"  # both ways


class PathEvent(StrEnum):
    """What one end learns of a path."""

    UNHEARD = "a datagram of a peer that has heard none of ours"
    HEARD = "a datagram of a peer that has heard ours"
    SILENCE = "none for so long"


TRANSITIONS: Final[Mapping[tuple[PathState, PathEvent], PathState]] = MappingProxyType(
    {
        (PathState.DOWN, PathEvent.UNHEARD): PathState.INIT,
        (PathState.DOWN, PathEvent.HEARD): PathState.UP,
        (PathState.DOWN, PathEvent.SILENCE): PathState.DOWN,
        (PathState.INIT, PathEvent.UNHEARD): PathState.INIT,
        (PathState.INIT, PathEvent.HEARD): PathState.UP,
        (PathState.INIT, PathEvent.SILENCE): PathState.DOWN,
        (PathState.UP, PathEvent.UNHEARD): PathState.INIT,
        (PathState.UP, PathEvent.HEARD): PathState.UP,
        (PathState.UP, PathEvent.SILENCE): PathState.DOWN,
    }
)
"""The state of a path after an event, by the state before."""


class Carriers(NamedTuple):
    """What carries the waves in a state.

    Attributes:
        link: whether the ZeroMQ link does.
        datagrams: whether every wave goes as a datagram; otherwise one in each :data:`PROBE` does.
    """

    link: bool
    datagrams: bool


CARRIERS: Final[Mapping[PathState, Carriers]] = MappingProxyType(
    {
        PathState.DOWN: Carriers(link=True, datagrams=False),
        PathState.INIT: Carriers(link=True, datagrams=False),
        PathState.UP: Carriers(link=False, datagrams=True),
    }
)
"""What carries the waves, by the state of the path."""


class Direction(IntEnum):
    """The direction of a datagram."""

    TO_ENVIRONMENT = 0
    TO_COUPLING = 1


class Outgoing(NamedTuple):
    """How one wave leaves.

    Attributes:
        datagram: to be sent; None where none is due.
        link: whether the wave's frame is to be sent over the ZeroMQ link.
    """

    datagram: bytes | None
    link: bool


def connection_of(datagram: bytes) -> bytes | None:
    """The connection that a datagram names; None where its length, its first byte or its n is none of a datagram."""
    if not OVERHEAD < len(datagram) <= MAX_DATAGRAM_BYTES or datagram[0] > 1 or datagram[1 + CONNECTION_BYTES] > 0x7F:
        return None
    return datagram[1 : 1 + CONNECTION_BYTES]


Address = tuple[Any, ...]
"""Of the system's calls: host and port, and for IPv6 flow and scope."""


class Replies:
    """Where the environment's end sends, and how much: to the newest address, which has to be proved.

    An address is proved by a datagram that opens, comes from it, and has the token that was sent there and nowhere
    else. Until then it gets no more bytes than came from it [Iyengar2021]_, and the waves go over ZeroMQ as well.
    A datagram from the proved address ends the doubt: a copy that somebody sent from elsewhere moves nothing.

    Attributes:
        proved: the latest address that was proved; None before.
        token: for the next datagram, of the address that it would go to.
    """

    __slots__ = ("_credit", "_proved_token", "_random", "_tried", "proved", "token")

    def __init__(self, random: Callable[[int], bytes] = secrets.token_bytes) -> None:
        """Know no address yet; ``random`` makes tokens."""
        self._random = random
        self.proved: Address | None = None
        self.token = self._proved_token = NO_TOKEN
        self._tried: Address | None = None  # from which the latest datagram came, where it is not the proved one
        self._credit = 0  # bytes that came from there, less those that went there

    @property
    def certain(self) -> bool:
        """Whether the newest address is the proved one."""
        return self.proved is not None and self._tried is None

    @property
    def address(self) -> Address | None:
        """The newest address, proved or not; None before the first datagram."""
        return self.proved if self._tried is None else self._tried

    def arrived(self, source: Address, length: int, token: bytes) -> None:
        """A datagram of this many bytes has opened, which came from ``source`` with this token."""
        if source == self.proved:
            self._tried, self.token = None, self._proved_token
            return
        if source != self._tried:
            self._tried, self._credit = source, 0
            self.token = self._random(TOKEN_BYTES)
        self._credit += length
        if token == self.token:
            self.proved, self._tried, self._proved_token = source, None, token

    def departs(self, length: int) -> Address | None:
        """Where a datagram of this many bytes may go now; None where it may not. It counts as sent."""
        if self._tried is None:
            return self.proved
        if self._credit < length:
            return None
        self._credit -= length
        return self._tried


class PathEnd:
    """One end of a path in one life of its link.

    Attributes:
        token: of the latest datagram that was opened.
        refused: datagrams that were not opened, by reason; the keys are all of :class:`NotOpened`.
        opened: datagrams that were opened.
        changes: changes of the state so far.
    """

    __slots__ = (
        "_aead", "_connection", "_heard_at", "_newest", "_probes", "_receives", "_sealed", "_sealed_tick", "_sends",
        "_sent_at", "_state", "changes", "opened", "refused", "token",
    )  # fmt: skip

    def __init__(self, key: PathKey, sends: Direction, now: Instant) -> None:
        """Begin with a path that is DOWN.

        Args:
            key: of this life, used for no other.
            sends: the direction of this end's datagrams. The coupling's end probes; the environment's answers.
            now: the present.
        """
        self._aead = ChaCha20Poly1305(key.secret)
        self._connection = key.connection
        self._sends, self._receives = sends, Direction(1 - sends)
        self._probes = sends is Direction.TO_ENVIRONMENT
        self._state = PathState.DOWN
        self._newest = self._sealed_tick = -1
        self._sealed: bytes | None = None  # the latest datagram
        self._sent_at: Instant = Instant(now - max(PROBE, KEEP_ALIVE))  # a first probe is due at once
        self._heard_at = now
        self.token = NO_TOKEN
        self.refused: dict[NotOpened, int] = dict.fromkeys(NotOpened, 0)
        self.opened = self.changes = 0

    def state(self, now: Instant) -> PathState:
        """The state of the path, with the silence until ``now``."""
        if now - self._heard_at >= SILENCE:
            self._learn(PathEvent.SILENCE)
        return self._state

    def outgoing(self, tick: int, frame: bytes, now: Instant, token: bytes = NO_TOKEN) -> Outgoing:
        """How the wave of ``tick`` in ``frame`` leaves, with a token in its datagram.

        Raises:
            ValueError: the tick is not above that of the wave before, so that a nonce would be used twice; or the frame
                is too long for a datagram.
        """
        if not self._sealed_tick < tick <= MAX_COUNT:
            raise ValueError(f"found the tick {tick}; expected {self._sealed_tick + 1} to {MAX_COUNT}")
        if len(frame) > MAX_DATAGRAM_BYTES - OVERHEAD:
            raise ValueError(f"found a frame of {len(frame)} bytes; expected at most {MAX_DATAGRAM_BYTES - OVERHEAD}")
        state = self.state(now)
        link, every = CARRIERS[state]
        # an environment does not send to an address from which nothing comes any more
        if not every and (now - self._sent_at < PROBE or (state is PathState.DOWN and not self._probes)):
            return Outgoing(None, link)
        header = _HEADER.pack(state is not PathState.DOWN, self._connection, tick, token)
        datagram = header + self._aead.encrypt(_NONCE.pack(self._sends, tick), frame, header)
        self._sealed_tick, self._sealed, self._sent_at = tick, datagram, now
        return Outgoing(datagram, link)

    def repeated(self, now: Instant) -> bytes | None:
        """The latest datagram again, where it is due to keep the path's address alive; None otherwise.

        The peer refuses it as a copy, which it is to the byte: no nonce is used for two texts.
        """
        if not self._probes or self._sealed is None or now - self._sent_at < KEEP_ALIVE:
            return None
        self._sent_at = now
        return self._sealed

    def opens(self, datagram: bytes, now: Instant) -> bytes | None:
        """The frame in a datagram of the peer; None for any other datagram, which is counted."""
        if connection_of(datagram) is None:
            self.refused[NotOpened.NO_DATAGRAM] += 1
            return None
        heard, connection, tick, token = _HEADER.unpack_from(datagram)
        if connection != self._connection:
            self.refused[NotOpened.UNKNOWN_PATH] += 1
            return None
        if tick <= self._newest:
            self.refused[NotOpened.REPLAYED] += 1
            return None
        try:
            frame = self._aead.decrypt(
                _NONCE.pack(self._receives, tick), datagram[_HEADER.size :], datagram[: _HEADER.size]
            )
        except InvalidTag:
            self.refused[NotOpened.FORGED] += 1
            return None
        self._newest, self._heard_at, self.token = tick, now, token
        self.opened += 1
        self._learn(PathEvent.HEARD if heard else PathEvent.UNHEARD)
        return frame

    def _learn(self, event: PathEvent) -> None:
        state = TRANSITIONS[self._state, event]
        self.changes += state is not self._state
        self._state = state
