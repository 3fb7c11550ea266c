"""One link of a running node: its signals of the tick, and what else may come of a peer.

A peer does its part in time, is silent, has fallen behind, is lost, or comes back on a new link. A joint hears all of
that and says which (:class:`Heard`); what is done about it is the node's own business (:class:`Listener`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.bundle import Peer
from manyhands.nodes.linear_map import Floats
from manyhands.protocol.clock import Clock, Duration, Instant
from manyhands.protocol.codec import LAYOUTS, SignalWriter, decode, encode
from manyhands.protocol.gate import Bounds, Gate
from manyhands.protocol.handshake import LinkHandshake
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_STRAY_FRAMES
from manyhands.protocol.messages import Absent, LinkHello, Refusal, Rung, SignalMessage
from manyhands.protocol.signal_head import type_of
from manyhands.protocol.transport import Link

Indices = NDArray[np.int64]


class Heard(Enum):
    """What came of listening to a peer."""

    SIGNAL = "the signal of the tick, put in its place"
    NOTHING = "nothing of use in the time allowed"
    TURNED = "the listener wants no more of this tick"
    MET = "the peer is back: hands were shaken on the new link"


class Listener(Protocol):
    """What a node makes of a frame that is not the signal of the tick."""

    def astray(self, joint: Joint, told: int, awaited: int) -> bool:
        """A proper signal of tick ``told`` came while ``awaited`` was waited for; whether to stop waiting for it."""
        ...

    def aside(self, joint: Joint, message: Rung | Absent) -> bool:
        """A word besides the signals; whether to stop waiting."""
        ...

    def flooded(self, text: str) -> None:
        """A peer sends more stray frames than any honest one: the node has to end, and why."""
        ...


class Joint:
    """One link of a node.

    Attributes:
        own: the hello that this end says.
        peer: who is at the other end.
        link: the connection; None while the peer is lost.
        gate: admits the peer's signals.
        indices: where the link's ports are among the node's own; a slice where they follow each other.
        handshake: the one that goes on with a peer that comes back; None otherwise.
        hello: what a peer said who came back.
        new: whether nothing has been admitted yet of a peer who came back: it may be at another tick.
        tick: that of the latest signal; -1 before the first.
        told: the tick of the signal that was last astray.
        zero: whether all values of that signal were zero.
        stray: its frame.
    """

    def __init__(
        self,
        own: LinkHello,
        peer: Peer,
        link: Link | None,
        admits: type[SignalMessage],
        indices: slice | Indices,
        clock: Clock,
        bounds: Bounds | None = None,
    ) -> None:
        """Join the node to a peer that has shaken hands on ``link``.

        Args:
            own: the hello that this end says.
            peer: who is at the other end.
            link: the connection.
            admits: the signal that comes from there.
            indices: where its values belong.
            clock: by which a wait knows how long it has lasted, and a gate what has passed; a realtime one.
            bounds: what its values keep within.
        """
        self.own, self.peer, self.link, self.indices = own, peer, link, indices
        self.handshake: LinkHandshake | None = None
        self.hello: LinkHello | None = None
        self.new = False
        self.tick, self.told, self.zero, self.stray = -1, 0, False, b""
        self._admits, self._bounds, self._clock = admits, bounds, clock
        self.gate = Gate(admits, len(peer.ports), bounds, clock)
        self._part = indices if isinstance(indices, slice) else None
        self._at = () if isinstance(indices, slice) else tuple(indices.tolist())
        self._writer: SignalWriter | None = None  # it sends one kind of signal, which is known when it does
        self._last: bytes = b""
        self._junk_tick, self._junk = -1, 0  # frames that were no signal at all, while this tick's was awaited

    @property
    def reachable(self) -> bool:
        """Whether there is a link to the peer, or the beginning of one."""
        return self.link is not None

    @property
    def here(self) -> bool:
        """Whether signals can be exchanged with the peer."""
        return self._open is not None

    @property
    def _open(self) -> Link | None:
        """The link, where hands have been shaken on it."""
        return self.link if self.handshake is None else None

    def share(self, values: Floats) -> Floats:
        """This link's part of the node's ``values``."""
        return [values[at] for at in self._at] if self._part is None else values[self._part]

    def put(self, values: Floats, share: Sequence[float]) -> None:
        """Put this link's ``share`` into the node's ``values``."""
        if self._part is not None:
            values[self._part] = share
            return
        for at, value in zip(self._at, share, strict=True):
            values[at] = value

    def send(self, kind: type[SignalMessage], tick: int, stamp: int, values: Floats) -> bool:
        """Send this link's share of the node's ``values``; False when the peer's queue is full or gone."""
        link = self.link
        if link is None or self.handshake is not None:
            return False
        writer = self._writer
        if writer is None or writer.kind is not kind:
            writer = self._writer = SignalWriter(kind, len(self.peer.ports))
        part = self._part
        share = self.share(values) if part is None else values[part]
        self._last = frame = writer.frame(tick, stamp, share)
        return link.send(frame)

    def send_again(self) -> None:
        """Send the last signal once more: it, or the answer to it, may have been lost with a connection."""
        link = self._open
        if link is not None and self._last:
            link.send(self._last)

    def send_zero(self, kind: type[SignalMessage], tick: int) -> None:
        """Tell the peer, by a force of zero, that ``tick`` is over: it goes on with the one after it."""
        link = self._open
        if link is not None and tick >= 0:
            link.send(encode(kind(tick, 0, np.zeros(len(self.peer.ports)))))

    def say(self, message: Rung | Absent) -> None:
        """Send a word besides the signals."""
        link = self._open
        if link is not None:
            link.send(encode(message))

    def hear(self, values: Floats, tick: int, patience: Duration, listener: Listener) -> Heard:
        """Listen for the peer's signal of ``tick``, at most ``patience``, and put it into the node's ``values``."""
        link = self.link
        if link is None:
            return Heard.NOTHING
        frame = link.recv(patience)
        if frame is None:
            return Heard.NOTHING
        if self.handshake is None:
            admitted = self.gate.admitted(frame, tick)
            if admitted is not None:
                part = self._part
                if part is None:
                    self.put(values, admitted)
                else:
                    values[part] = admitted
                self.tick = tick
                return Heard.SIGNAL
        return self._hear_on(frame, values, tick, patience, listener)

    def take(self, frame: bytes, values: Floats, tick: int) -> bool:
        """Put a signal that came early into the node's ``values``, now that it is its turn; whether it is admitted."""
        admitted = self.gate.admitted(frame, tick)
        if admitted is None:
            return False
        self.put(values, admitted)
        self.tick = tick
        return True

    def settle(self, tick: int) -> None:
        """The force of ``tick`` is applied; nothing is left to do for a peer in a process of its own."""

    def lose(self) -> None:
        """The peer is gone: close the link to it."""
        if self.link is not None:
            self.link.close()
        self.link, self.handshake = None, None

    def greet(self, link: Link, handshake: LinkHandshake) -> None:
        """Begin to shake hands with the peer, who comes back on ``link``; :meth:`hear` goes on with it."""
        self.lose()
        self.link, self.handshake = link, handshake
        for message in handshake.start():
            link.send(encode(message))

    def _hear_on(self, frame: bytes, values: Floats, tick: int, patience: Duration, listener: Listener) -> Heard:
        """Look at a frame that was not the signal of the tick, and listen on for the rest of the time."""
        due = Instant(self._clock.now() + patience)
        strays = 0
        if self._junk_tick != tick:
            self._junk_tick, self._junk = tick, 0
        while True:
            signal = None if self.handshake is not None else self.gate.astray(frame)
            heard = self._take(frame, signal, tick, listener)
            if heard is not None:
                return heard
            strays += 1
            self._junk += signal is None  # who is only behind says the same again and again
            if max(strays, self._junk) > MAX_STRAY_FRAMES:
                listener.flooded(self._flood(tick))
                return Heard.NOTHING
            link = self.link
            left = Duration(max(0, due - self._clock.now())) if patience else patience
            if link is None or (patience and not left):
                return Heard.NOTHING
            following = link.recv(left)
            if following is None:
                return Heard.NOTHING
            frame = following
            if self.handshake is None:
                admitted = self.gate.admitted(frame, tick)
                if admitted is not None:
                    self.put(values, admitted)
                    self.tick, self._junk_tick = tick, -1
                    return Heard.SIGNAL

    def _take(self, frame: bytes, signal: tuple[int, bool] | None, tick: int, listener: Listener) -> Heard | None:
        if self.handshake is not None:
            return self._shake(frame, self.handshake)
        if signal is not None and signal[0] != tick:
            (self.told, self.zero), self.stray = signal, frame
            return Heard.TURNED if listener.astray(self, signal[0], tick) else None
        if signal is None and len(frame) <= _LONGEST_WORD and type_of(frame) in _WORDS:
            message = decode(frame, MAX_CONTROL_BYTES)
            if isinstance(message, Rung | Absent):
                self.gate.dropped["wrong_kind"] -= 1  # it was counted as a stray, and is none
                return Heard.TURNED if listener.aside(self, message) else None
        return None

    def _shake(self, frame: bytes, handshake: LinkHandshake) -> Heard | None:
        link = self.link
        if link is None:
            return Heard.NOTHING
        for message in handshake.receive(decode(frame, MAX_CONTROL_BYTES)):
            if not link.send(encode(message)) and not isinstance(message, Refusal):
                self.lose()  # gone again; the supervisor will tell
                return Heard.NOTHING
        if not handshake.finished:
            return None
        if handshake.peer is None:  # refused: as good as absent, and told at the other end
            self.lose()
            return Heard.NOTHING
        self.handshake, self.hello, self.new = None, handshake.peer, True
        before, self.gate = self.gate, Gate(self._admits, len(self.peer.ports), self._bounds, self._clock)
        self.gate.dropped.update(before.dropped)
        self._last, self.tick = b"", -1
        return Heard.MET

    def _flood(self, tick: int) -> str:
        kinds = ", ".join(f"{reason} {count}" for reason, count in self.gate.dropped.items() if count)
        return (
            f"{self.own.name}: {self.peer.name} sent {MAX_STRAY_FRAMES + 1} stray frames while its signal of tick "
            f"{tick} was awaited (in all: {kinds}); expected at most {MAX_STRAY_FRAMES}; see what runs as "
            f"{self.peer.name}"
        )


def await_all(
    joints: Sequence[Joint],
    last: Joint,
    values: Floats,
    tick: int,
    listener: Listener,
    react: Callable[[Joint, Heard, int], int],
    pause: Callable[[int], Duration | None],
) -> int | None:
    """Wait until every peer has sent its signal of one tick; listen in turn to those that have not.

    Args:
        joints: the links.
        last: the one that was listened to last; the first round begins behind it.
        values: the node's values, where the signals are put.
        tick: the tick that is awaited.
        listener: what the node makes of frames that are not the signal.
        react: does what the node does about what it heard of a peer while it waited for a tick; returns the tick that
            is awaited from then on.
        pause: called before every round with the tick that is awaited; returns how long to listen to each peer at
            most, ns, or None to wait no longer.

    Returns:
        The tick that everybody has sent a signal of; None where the node waits no longer.
    """
    behind = joints.index(last) + 1
    order = (*joints[behind:], *joints[:behind])
    while any(joint.tick != tick for joint in order):
        left = pause(tick)
        if left is None:
            return None
        for joint in order:
            if joint.tick != tick:
                tick = react(joint, joint.hear(values, tick, left, listener), tick)
    return tick


_WORDS = {LAYOUTS[kind][0] for kind in (Rung, Absent)}
_LONGEST_WORD = 128  # bytes


def joint_of(joints: Sequence[Joint], peer: str) -> Joint | None:
    """The joint with ``peer``; None if there is no such peer."""
    return next((joint for joint in joints if joint.peer.name == peer), None)
