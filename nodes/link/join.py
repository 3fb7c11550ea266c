"""How a node is joined to a peer: what every join has, whatever carries the tick's signals.

A node's loop knows :class:`Join` alone. Which kind joins it to a peer follows from the bundle by one table,
:data:`manyhands.nodes.joins.KINDS`, whose rows are a :class:`JoinKind` each.
"""

# ruff: noqa: B027 -- a hook is no abstract method: most joins need nothing in it

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import Common, Peer, WaveEnd
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Clock, Duration
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.gate import Bounds
from manyhands.protocol.handshake import LinkHandshake
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_STRAY_FRAMES
from manyhands.protocol.messages import Absent, LinkHello, Refusal, Rung, SignalMessage, Values
from manyhands.protocol.transport import Link

Indices = NDArray[np.int64]


class Received(Enum):
    """The outcome of listening to a peer once."""

    SIGNAL = "the signal of the tick, put into the node's values"
    NOTHING = "nothing of use in the time allowed"
    DECLINED = "the listener no longer awaits this tick"
    RECONNECTED = "the peer is back, and has shaken hands on a new link"
    FLOODED = "more stray frames than any honest peer sends, so that the link was closed"


class Listener(Protocol):
    """How a node handles a frame that is not the signal of the tick."""

    def on_other_tick(self, join: Join, other: int, awaited: int) -> bool:
        """Handle a valid signal of tick ``other``, which came in place of ``awaited``; returns whether to stop waiting.

        Where this returns True, :meth:`Join.hear` returns ``Received.DECLINED``.
        """
        ...

    def on_notice(self, join: Join, message: Rung | Absent) -> bool:
        """Handle a message that is no signal; returns whether to stop waiting for ``Received.DECLINED``."""
        ...

    def flooded(self, text: str) -> None:
        """End the node, for the reason ``text``: a peer sends more stray frames than any honest peer does."""
        ...


class WaveRow(NamedTuple):
    """One tick of an end of a wave link, as telemetry reports it.

    Attributes:
        c: the incoming wave, W^(1/2).
        tank: the energy in the tank, what it has shipped, and what it has heard, J.
        p: the free position of the tool at a world's end, m; empty at a user's, whose block reports it.
        f: the force on it behind its clutch, N; likewise.
        begins: whether a world's end took its position from the first wave of a life in this tick.
    """

    c: Floats
    tank: Floats
    p: Floats = []  # noqa: RUF012  # never changed
    f: Floats = []  # noqa: RUF012
    begins: bool = False


class Join(ABC):
    """How a node is joined to one peer.

    Attributes:
        own: the hello that this end sends.
        peer: the peer at the other end.
        link: the connection; None while the peer is lost, and within a process.
        indices: where the join's ports are among the node's own; a slice where they follow each other. The node's
            values may hold more than its ports': what rides with a signal (:mod:`manyhands.nodes.kernel.orientation`).
        handshake: the unfinished handshake with a peer that comes back; None otherwise.
        hello: the hello of the peer's latest handshake; None before the first.
        new: whether the peer came back and no signal of it has been admitted since: it may be at another tick.
        tick: the tick of the latest signal; -1 before the first.
        other_tick: the tick of the last signal that was not of the tick awaited.
        other_zero: whether all values of that signal were zero.
        other_frame: the frame of that signal.
        waited_for: whether a tick waits for the peer's signal; otherwise this end answers whenever it is asked.
    """

    def __init__(
        self,
        own: LinkHello,
        peer: Peer,
        link: Link | None,
        indices: slice | Indices,
        clock: Clock,
        riders: Sequence[int] = (),
    ) -> None:
        """Join the node to a peer.

        Args:
            own: the hello that this end sends.
            peer: the peer at the other end.
            link: the connection; None for a peer that is absent, or in the same process.
            indices: where the values of the peer's ports belong among the node's own.
            clock: a realtime clock, which measures the waits and the time between the signals.
            riders: where what rides with the peer's signals belongs among the node's values.
        """
        self.own, self.peer, self.link, self.indices = own, peer, link, indices
        self.handshake: LinkHandshake | None = None
        self.hello: LinkHello | None = None
        self.new = False
        self.tick, self.other_tick, self.other_zero, self.other_frame = -1, 0, False, b""
        self.waited_for = True
        self._clock = clock
        places = _with_riders(indices, riders)
        self._part = places if isinstance(places, slice) else None
        self._at = () if isinstance(places, slice) else tuple(places.tolist())
        self._nothing_rides = [0.0] * len(riders)
        self._first_button, buttons = peer.buttons
        self._buttons = (1 << buttons) - 1

    @property
    def reachable(self) -> bool:
        """Whether there is a link to the peer, with its handshake finished or not."""
        return self.link is not None

    @property
    def here(self) -> bool:
        """Whether signals can be exchanged with the peer."""
        return self._open is not None

    @property
    def _open(self) -> Link | None:
        """The link, once its handshake is finished; None before."""
        return self.link if self.handshake is None else None

    @property
    @abstractmethod
    def dropped(self) -> Mapping[str, int]:
        """The frames that were not admitted, by reason."""

    @property
    def strays(self) -> int:
        """The number of frames that were not admitted."""
        return sum(self.dropped.values())

    def recount(self, reason: str, by: int) -> None:
        """Add ``by`` to the frames dropped for ``reason``: one was counted that is none, or none that is one."""

    @property
    def stamp(self) -> int:
        """The stamp of the latest signal, ns; 0 where signals have none, and before the first."""
        return 0

    @property
    def pressed(self) -> int:
        """The buttons behind the peer that are held down, among the node's own; 0 before its first signal."""
        return 0

    def resume(self) -> None:
        """Begin in a session that runs already, where the join has something to begin with."""

    def forget(self) -> None:
        """Take the next signal as the first one, whose step has no bound, where steps have bounds."""

    def figures(self) -> Mapping[str, float]:
        """Figures of the join itself, for telemetry and report; most have none."""
        return {}

    def share(self, values: Floats) -> Floats:
        """This link's part of the node's ``values``."""
        return [values[at] for at in self._at] if self._part is None else values[self._part]

    def share_of_ports(self, values: Floats) -> Floats:
        """The same without what rides with a signal."""
        share = self.share(values)
        return share[: len(share) - len(self._nothing_rides)] if self._nothing_rides else share

    def put_ports(self, values: Floats, share: Floats) -> None:
        """Put numbers of this link's ports alone into the node's ``values``: nothing rides with them."""
        self.put(values, share + self._nothing_rides)

    def put(self, values: Floats, share: Sequence[float]) -> None:
        """Put this link's ``share`` into the node's ``values``."""
        if self._part is not None:
            values[self._part] = share
            return
        for at, value in zip(self._at, share, strict=True):
            values[at] = value

    def share_of_buttons(self, pressed: int) -> int:
        """Those of the node's buttons that are held down whose state this link carries."""
        return pressed >> self._first_button & self._buttons

    @abstractmethod
    def send(self, kind: type[SignalMessage], tick: int, stamp: int, values: Floats, pressed: int = 0) -> bool:
        """Send this join's share of the node's ``values``.

        Args:
            kind: the type of the signal.
            tick: k.
            stamp: when the device took the sample that the signal follows from, ns.
            values: those of all ports of the node.
            pressed: the node's buttons that are held down; of no use to a peer nearer to the hand.

        Returns:
            Whether they are on their way; False where the peer is lost, or its queue is full.
        """

    def send_again(self) -> None:
        """Send the last signal once more, where it may have been lost and nothing later holds it."""

    def send_zero(self, kind: type[SignalMessage], tick: int) -> None:
        """Send a zero force of ``tick`` to a peer that waits for that tick: it is over, and the next one comes."""

    def notify(self, message: Rung | Absent) -> None:
        """Send a message that is no signal, where the peer follows such messages."""

    @abstractmethod
    def hear(self, values: Floats, tick: int, timeout: Duration, listener: Listener) -> Received:
        """Listen for the peer's signal of ``tick``, at most ``timeout``, and put it into the node's ``values``."""

    def take(self, frame: bytes, values: Floats, tick: int) -> bool:
        """Put a signal that came early into the node's ``values`` in its own tick; returns whether it was admitted.

        It never is where no signal can come early.
        """
        return False

    def take_other(self, values: Floats, counted: str) -> bool:
        """Put the signal of :attr:`other_tick` into the node's ``values``; returns whether it was admitted.

        Args:
            values: the node's.
            counted: the reason for which it was counted as a stray frame, which it is not.
        """
        return self.take(self.other_frame, values, self.other_tick)

    def settle(self, tick: int) -> None:
        """Finish ``tick``, once its force is applied; a peer in a process of its own needs nothing more."""

    def finished(self, tick: int) -> WaveRow | None:
        """Finish ``tick``, and return the :attr:`row`."""
        self.settle(tick)
        return self.row

    @property
    def row(self) -> WaveRow | None:
        """What telemetry reports of the end of a wave link in the last tick; None for every other link."""
        return None

    def listen(self) -> None:
        """Have a peer whose ticks run in this node's loop follow its supervisor's messages; others do so themselves."""

    def publish_rest(self) -> None:
        """Have such a peer send its telemetry up to now: its loop is over, or goes on at a later tick."""

    def lose(self) -> None:
        """Close the link to a peer that is gone."""
        if self.link is not None:
            self.link.close()
        self.link, self.handshake = None, None

    def refuse(self, refusal: Refusal) -> None:
        """Tell a peer that has shaken hands why it stays absent, and close the link."""
        if (link := self._open) is not None:
            link.send(encode(refusal))
        self.lose()

    def greet(self, link: Link, handshake: LinkHandshake) -> None:
        """Begin the handshake with a peer that comes back on ``link``; :meth:`hear` continues it."""
        self.lose()
        self.link, self.handshake = link, handshake
        for message in handshake.start():
            link.send(encode(message))

    def _shake(self, frame: bytes, handshake: LinkHandshake) -> Received | None:
        link = self.link
        if link is None:
            return Received.NOTHING
        for message in handshake.receive(decode(frame, MAX_CONTROL_BYTES)):
            if not link.send(encode(message)) and not isinstance(message, Refusal):
                self.lose()  # the peer is gone again; the supervisor will report it
                return Received.NOTHING
        if not handshake.finished:
            return None
        if handshake.peer is None:  # refused: the peer counts as absent, and the other end has received the reason
            self.lose()
            return Received.NOTHING
        self.handshake, self.hello, self.new = None, handshake.peer, True
        self._begin_life()
        return Received.RECONNECTED

    @abstractmethod
    def _begin_life(self) -> None:
        """Begin anew with a peer that has shaken hands, or that is lost."""

    def _flood(self, tick: int, most: int = MAX_STRAY_FRAMES) -> str:
        kinds = ", ".join(f"{reason} {count}" for reason, count in self.dropped.items() if count)
        return (
            f"{self.own.name}: {self.peer.name} sent {most + 1} stray frames while its signal of tick {tick} was "
            f"awaited (in all: {kinds}); expected at most {most}. See what runs as {self.peer.name}"
        )


class Inner(Protocol):
    """A node whose ticks run in the loop of another node of its process. It stays a node, with a bundle of its own."""

    @property
    def as_peer(self) -> Peer:
        """What that other node would be told of it, were they joined by a link."""
        ...

    def join_from(self, own: OwnEnd) -> Join:
        """Join it to the node whose loop runs its ticks, and whose end is ``own``."""
        ...


@dataclass(frozen=True, eq=False)
class OwnEnd:
    """What a node brings to its joins, of whatever kind they are.

    Attributes:
        common: the common part of its bundle.
        clock: a realtime clock: processes start, and wait for each other, in real time, whatever the session's clock.
        bounds: the bounds of a peer's signals, by its name; the signals of other peers are not bounded.
        feedthrough: D_V of a coupling, m/N, which the environment alone is sent; None at other nodes.
        waves: what the bundle says of this end of each wave link, by the peer's name.
        inside: the nodes whose ticks run in this node's loop.
    """

    common: Common
    clock: Clock
    bounds: Mapping[str, Bounds] = field(default_factory=dict)
    feedthrough: Values | None = None
    waves: Mapping[str, WaveEnd] = field(default_factory=dict)
    inside: Sequence[Inner] = ()


class JoinKind(ABC):
    """The joins of one kind at one node: it makes them, and reads and closes what they share."""

    def __init__(self, own: OwnEnd) -> None:
        """Make the joins of the node whose end is ``own``."""
        self.own = own

    @abstractmethod
    def serves(self, peer: Peer) -> bool:
        """Whether the node is joined to ``peer`` in this way."""

    @abstractmethod
    def join(self, peer: Peer, link: Link | None) -> Join:
        """Join the node to ``peer``; ``link`` is None where the peer is absent, or needs none."""

    def read(self) -> None:
        """Read what has come for all joins of this kind, before a tick hears them."""

    def close(self) -> None:
        """Close what the joins share; each closes its own link."""


def await_all(
    joins: Sequence[Join],
    last: Join,
    values: Floats,
    tick: int,
    listener: Listener,
    react: Callable[[Join, Received, int], int],
    pause: Callable[[int], Duration | None],
) -> int | None:
    """Wait until every peer has sent its signal of one tick; listen in turn to the peers that have not.

    The awaited tick may change during the wait: ``react`` moves a node to the tick of a peer that is further on. Peers
    whose signal of the earlier tick is there already are then awaited again, so the loop compares with the tick anew.

    Args:
        joins: the links.
        last: the link that was listened to last; the first round begins with the link after it.
        values: the node's values, where the signals are put.
        tick: the tick that is awaited.
        listener: handles the frames that are not the signal.
        react: called with a link, the outcome of listening to it and the awaited tick; returns the tick that is awaited
            from then on.
        pause: called before every round with the tick that is awaited; returns how long to listen to each peer at
            most, ns, or None to wait no longer.

    Returns:
        The tick of which every peer has sent its signal; None where the node waits no longer.
    """
    behind = joins.index(last) + 1
    order = (*joins[behind:], *joins[:behind])
    while any(join.tick != tick for join in order):
        left = pause(tick)
        if left is None:
            return None
        for join in order:
            if join.tick != tick:
                tick = react(join, join.hear(values, tick, left, listener), tick)
    return tick


def join_of(joins: Sequence[Join], peer: str) -> Join | None:
    """The join with ``peer``; None if there is no such peer."""
    return next((join for join in joins if join.peer.name == peer), None)


def positions(own: tuple[str, ...], carried: tuple[str, ...]) -> slice | Indices:
    """Where the ``carried`` ports are among ``own``: a slice where they follow each other, for it costs a tick less."""
    return _places([own.index(port) for port in carried])


def _with_riders(indices: slice | Indices, riders: Sequence[int]) -> slice | Indices:
    if not riders:
        return indices
    ports = range(indices.start, indices.stop) if isinstance(indices, slice) else indices.tolist()
    return _places([*ports, *riders])


def _places(at: list[int]) -> slice | Indices:
    if at == list(range(at[0], at[0] + len(at))):
        return slice(at[0], at[0] + len(at))
    return np.array(at)


def stray_frames(joins: Iterable[Join]) -> dict[str, float]:
    """The number of frames that the gates did not admit, as a figure of telemetry."""
    return {names.NOT_ADMITTED: float(sum(join.strays for join in joins))}


def dropped_frames(joins: Iterable[Join]) -> dict[str, float]:
    """The numbers of frames that the gates did not admit, by reason, over all links."""
    out: dict[str, float] = {}
    for join in joins:
        for reason, count in join.dropped.items():
            out[reason] = out.get(reason, 0.0) + count
    return out
