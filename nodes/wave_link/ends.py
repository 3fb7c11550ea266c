"""The ends of a wave link in their nodes: joins that send waves in place of the tick's signals.

A coupling's loop sends p(k) to its peer and listens for f_v(k). With a wave link the peer is a :class:`UserEnd`: its
face answers at once, from the waves that have come, and the environment's process is not waited for. The environment's
loop listens for p(k) and sends f_v(k). There the peer is a :class:`WorldEnd`: its face gives p(k) at once. So neither
loop knows of wave links, and the waves may come late, twice or never.

**A life of the link** is one handshake. A peer that was lost and comes back shakes hands on a new connection, so no
wave of an earlier life can come. Both faces then begin a new life (:mod:`manyhands.nodes.wave_link.faces`). The process
that comes back begins with an empty tank.

**Joining.** The first wave says where the user's tool is. In real time the world's end then listens for
:data:`JOINING` seconds, with its clutch at s = 0, and measures how late waves come. The depth of its play-out follows
from that. Then its coupling is active, and the clutch raises the force by its ramp. The user's end measures for as long
from the world's first wave on.

**Datagrams.** Beyond one machine ZeroMQ's TCP delivers a wave late wherever an earlier packet was lost. So over an
encrypted tcp link the world's end offers a path of datagrams in each life
(:mod:`manyhands.protocol.transport.datagrams`), and the waves take it as long as they come through.

**Under the simulated clock** no time passes, so the ends wait for the waves of the ticks that are due: a wave leaves
and arrives in its tick, and the play-out alone delays it. So a run is the same every time. Where the session states a
network to simulate, the end that hears keeps each wave for its time under way, by a seed
(:mod:`manyhands.nodes.kernel.simulated_way`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Final

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import SIMULATED, Common, Peer, WaveEnd
from manyhands.nodes.kernel.simulated_way import WavesUnderWay
from manyhands.nodes.link.join import Join, JoinKind, Listener, OwnEnd, Received, WaveRow, positions
from manyhands.nodes.link.peer_link import hello_to
from manyhands.nodes.link.supervisor_line import NOT_AT_ALL
from manyhands.nodes.rows import figures as names
from manyhands.nodes.wave_link.faces import UserFace, WorldFace, wave_feedthrough
from manyhands.nodes.wave_link.play_out import HOLD_AFTER
from manyhands.nodes.wave_link.thinning import Turns
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.codec import LAYOUTS, WAVE_ID, WaveWriter, decode, encode, type_of
from manyhands.protocol.gate import MOST_DELAY, WaveBounds, WaveGate
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_STRAY_FRAMES
from manyhands.protocol.messages import PathKey, SignalMessage, Values, Wave
from manyhands.protocol.path import PathState
from manyhands.protocol.transport import Link, TransportError
from manyhands.protocol.transport.datagrams import DatagramPath, DatagramSocket, shared_address
from manyhands.protocol.transport.zeromq import Arrivals

JOINING: Final = 0.3
"""Time for which an end measures how late waves come before its depth is settled, s."""

WINDOW: Final = 1.0
"""The same later on, s: an end goes on to measure, for a machine or a network may become worse. A wave that comes later
than the depth allows for costs energy of the tank, and where the tank is empty, the tool creeps."""

OUTLIERS: Final = 0.01
"""The part of a window's ticks that the depth need not cover. Beyond the newest wave the play-out goes on with the last
slope, which is exact for a constant force; depth costs stiffness or felt mass all the time."""

CALM: Final = 10
"""Windows that must have needed less before the depth becomes less."""

FIRST_DEPTH: Final = 0.004
"""The depth of the play-out until it is measured, s."""

AT_ONCE: Final = 64
"""Frames that are read in one tick: a flood must not keep the loop from its other work."""

ROUNDING: Final = 1e-9
"""Added to a number of ticks before it is rounded down, for it is a quotient of two periods."""

PATH_KEY_ID: Final = LAYOUTS[PathKey][0]

Face = UserFace | WorldFace


class _End(Join):
    """What both ends share: frames to waves, lives, and the figures.

    Neither end waits for a tick of the other, and the next wave holds all before it. So nothing is sent again, rungs
    end at the site, and waves have no stamps and no bounds by the wave before.

    Attributes:
        face: the face at this end.
    """

    face: Face

    def __init__(self, common: Common, peer: Peer, link: Link | None, clock: Clock, wave: WaveEnd) -> None:
        """Join ``peer``; the subclass makes the face.

        Args:
            common: the common part of the node's bundle.
            peer: the node at the other end.
            link: the connection; None where the peer is absent.
            clock: a realtime clock.
            wave: what the bundle says of this end.
        """
        hello = hello_to(common, peer, wave_feedthrough(wave.b, wave.peer_period))
        riders = common.riders(peer.riding)
        super().__init__(hello, peer, link, positions(common.ports, peer.ports), clock, riders)
        self.waited_for = self._waits = common.clock == SIMULATED
        self._peer_period = from_seconds(wave.peer_period)
        self._period, self._born = from_seconds(common.period), 0  # when this life's first tick was, ns; 0 before it
        self._ratio = common.period / wave.peer_period
        self._sends, self._hears = turns(wave)
        self._following = 1  # the tick of the next wave that is sent
        self._honest = wave_bounds(wave, len(riders))
        self._sums = len(peer.ports)  # of a wave; what rides with it follows them
        self._gate = self._new_gate()
        self._waves = WaveWriter(peer.width)
        # ticks for which this end measures how late waves come, at first; 0 where its depth is given
        self._joining = 0 if self._waits or wave.depth is not None else math.ceil(JOINING / common.period)
        self._window = math.ceil(WINDOW / common.period)
        self._needed: deque[float] = deque(maxlen=CALM)  # the depth that each window would have needed
        self._deepest = HOLD_AFTER / wave.peer_period
        self._ticks = 0  # of the present window
        self._strays = 0
        self._frames: list[bytes] | None = None  # that were read for this end; None where it reads by itself
        self._silences, self._holding = 0, True  # a face hears nothing before its first wave
        self._way, self._from, self._own_period = wave.way, wave.peer_period, common.period
        self._under_way = self._new_way()
        self._path: DatagramPath | None = None
        self._by_datagram = may_go_by_datagram(common)
        self._zeros: Floats = [0.0] * len(peer.ports)
        self._row = WaveRow(self._zeros, [wave.tank, 0.0, 0.0], self._zeros, self._zeros)

    @property
    def dropped(self) -> Mapping[str, int]:
        """The frames that were no waves of this link, by reason; a wave that is not the newest is no event."""
        return {**self._gate.dropped, "old_tick": 0}

    @property
    def strays(self) -> int:
        """The number of frames that were no waves of this link."""
        dropped = self._gate.dropped
        return sum(dropped.values()) - dropped["old_tick"]

    @property
    def without_datagrams(self) -> bool:
        """Whether the waves, which may go by datagram, now go by ZeroMQ, for datagrams do not come through."""
        return self._by_datagram and (self._path is None or self._path.state is not PathState.UP)

    def resume(self) -> None:
        """Begin with an empty tank: this process takes the place of one that was lost, and so is its energy."""
        self.face.tank.level = 0.0

    @property
    def row(self) -> WaveRow:
        """The row of the last tick."""
        return self._row

    def lose(self) -> None:
        """Close the link to a peer that is gone, and begin a new life."""
        super().lose()
        self._begin_life()

    def figures(self) -> dict[str, float]:
        """This end's account, J, ticks of limited waves, whether it holds the tool, its part of the round trip, us."""
        face = self.face
        return {
            names.WAVE_LEDGER: face.ledger,
            names.WAVE_TANK: face.tank.level,
            names.WAVE_CLIPPED: float(face.tank.clipped),
            names.WAVE_HOLDING: float(face.holding),
            names.WAVE_SILENCES: float(self._silences),
            names.WAVE_LAG: face.lag * 1e6,
        }

    def _begin_life(self) -> None:
        self.face.renew(0)
        if self._path is not None:
            self._path.close()
            self._path = None
        before, self._gate = self._gate, self._new_gate()
        self._gate.dropped.update(before.dropped)
        self._needed.clear()
        self._under_way = self._new_way()
        if self._frames:
            self._frames.clear()
        self._ticks, self._born, self.tick, self._following = 0, 0, -1, 1

    def _new_gate(self) -> WaveGate:
        width, bounds, buttons = self.peer.width, self._honest, self._admits_buttons()
        if self._waits:
            return WaveGate(width, bounds=bounds, buttons=buttons)
        return WaveGate(width, self._peer_period, self._clock, bounds, buttons)

    def _admits_buttons(self) -> int:
        """How many buttons the other end has; those of the world are none."""
        return 0

    def _note_silence(self) -> None:
        """Count a silence when it begins."""
        holding = self.face.holding
        if holding is not self._holding:
            self._holding = holding
            self._silences += holding

    def _take_waves(self) -> bool:
        """Take in all waves that are there, of which the newest counts; returns whether a handshake has finished."""
        frames = self._frames
        for _ in range(AT_ONCE):
            if frames is not None:
                frame = frames.pop(0) if frames else None
            else:
                link = self.link
                frame = None if link is None else link.recv(NOT_AT_ALL)
            if frame is None:
                break
            if self._take_frame(frame):
                return True
        if self._path is not None and (wave := self._path.receive()) is not None:
            self.face.hear(*self._parts(wave))
        return False

    def _parts(self, wave: Wave) -> tuple[int, tuple[float, ...], float, int, int, tuple[float, ...]]:
        """A wave as a face hears it; behind the sums is what rides with it."""
        m, sums = self._sums, wave.sums
        return wave.tick, sums[:m], wave.shipped, 0, wave.buttons, sums[m:]

    def _put_with_riders(self, values: Floats, share: Floats) -> None:
        """Put numbers of the ports into ``values``, with what rode with the newest wave; nothing of a silent end."""
        riders = self.face.rides
        if riders:
            self.put(values, [*share, *riders])
        else:
            self.put_ports(values, share)

    def _await_wave(self, n: int, timeout: Duration) -> Received:
        """Wait for the wave ``n``, at most ``timeout``: SIGNAL, or RECONNECTED, or NOTHING."""
        due = Instant(self._clock.now() + timeout)
        while n and (self._gate.newest is None or self._gate.newest.tick < n):  # in a new life none may be due yet
            link = self.link
            frame = None if link is None else link.recv(Duration(max(0, due - self._clock.now())))
            if frame is None:
                return Received.NOTHING
            if self._take_frame(frame):
                return Received.RECONNECTED
        return Received.SIGNAL

    def _take_frame(self, frame: bytes) -> bool:
        if self.handshake is not None:
            return self._shake(frame, self.handshake) is Received.RECONNECTED
        if self._path is not None and self._path.take(frame):
            self._strays = 0  # the path hands on the newest wave, whatever carried it
            return False
        if type_of(frame) == PATH_KEY_ID and self._take_key(frame):
            return False
        wave = self._gate.admitted(frame)
        if wave is not None:
            self._strays = 0
            if self._under_way is None:
                self.face.hear(*self._parts(wave))
            else:
                self._under_way.send(self._parts(wave))
        elif type_of(frame) != WAVE_ID:  # a wave that is refused is no stray: no more of them are read in a tick
            self._strays += 1
        return False

    def _new_way(self) -> WavesUnderWay | None:
        """A simulated network with nothing under way; None where there is none."""
        return None if self._way is None or not self._waits else WavesUnderWay(self._way, self._from)

    def _hear_arrived(self, ticks: int) -> None:
        """Hear the waves that a simulated network brings within this end's first ``ticks``."""
        if self._under_way is not None:
            for wave in self._under_way.arrived(ticks * self._own_period):
                self.face.hear(*wave)

    def _take_key(self, frame: bytes) -> bool:
        """Take up a path that the other end offers, where this end expects an offer; returns whether it was one."""
        return False

    def _flooded(self, listener: Listener) -> bool:
        if self._strays <= MAX_STRAY_FRAMES:
            return False
        listener.flooded(self._flood(self.tick))
        return True

    def _keep_time(self) -> None:
        """Have the face skip the ticks that this process was too late for.

        The other end plays by the numbers of ticks. If they fell behind the time, it would take a process that was
        late for late waves.
        """
        now, n = self._clock.now(), self.face.n
        if not self._born:
            self._born = now - n * self._period
        missed = (now - self._born) // self._period - n
        if missed > 0:
            self.face.skip(missed)

    def _send_wave(self) -> bool:
        link = self.link
        if link is None or self.handshake is not None:
            return False
        n = self.face.n
        if n < self._following:
            return True
        self._following = self._sends.after(n)
        message = self.face.message()
        self._gate.granted = message.G
        if self._path is not None:
            return self._path.send(Wave(message.n, message.U + message.riders, message.G, message.buttons))
        return link.send(self._waves.frame(message.n, message.U + message.riders, message.G, message.buttons))

    def _measure(self) -> bool:
        """Count a tick in which waves come, and choose the depth; returns whether it is settled."""
        if not self._joining:
            return True
        window = self._window if self._needed else self._joining
        if self._ticks == 0:
            self.face.measure(int(OUTLIERS * window))
        self._ticks += 1
        if self._ticks < window:
            return bool(self._needed)
        self._ticks = 0
        self._needed.append(self.face.measured)
        # what happened once in all these windows was an outage, for which no depth is worth its mass; a silence of
        # HOLD_AFTER makes the face hold the tool anyway
        deepest = sorted(self._needed)[-2] if len(self._needed) > 1 else self._needed[-1]
        deepest = min(deepest, self._deepest)
        if len(self._needed) == 1:
            self.face.set_depth(deepest)
        elif deepest > self.face.wanted_depth or len(self._needed) in (2, CALM):
            # it grows at once, and shrinks when calm, or where an outage at the beginning alone has made it deep
            self.face.approach_depth(deepest)
        return True


class UserEnd(_End):
    """A coupling's end of its wave link: to the block it is the environment, which answers at once."""

    def __init__(self, common: Common, peer: Peer, link: Link | None, clock: Clock, wave: WaveEnd, D_V: Values) -> None:
        """Begin a life; ``D_V`` is the block's feedthrough, m x m, m/N, and the rest is as for both ends."""
        super().__init__(common, peer, link, clock, wave)
        self.face = self._face = user_face(common, wave, D_V)
        self._f = self._zeros
        self._datagrams: DatagramSocket | None = None

    def send(self, kind: type[SignalMessage], tick: int, stamp: int, values: Floats, pressed: int = 0) -> bool:
        """Answer p(k) from the waves that have come; the world's wave leaves once the force is on its way."""
        if not self._waits:
            self._take_waves()
            self._keep_time()
        share, m = self.share(values), self._sums
        self._f = self._face.step(share[:m])
        self._face.riders = tuple(share[m:])
        self._face.buttons = self.share_of_buttons(pressed)
        self._row = WaveRow(self._face.wave, self._face.tank.row())
        self._note_silence()
        if self._waits:  # the world waits for the wave before it answers with one
            self._send_wave()
        return True

    def settle(self, tick: int) -> None:
        """Send the world the wave of ``tick``, once the force is applied or on its way to the device."""
        if not self._waits:
            self._send_wave()
            if self._face.aligned:
                self._measure()

    def hear(self, values: Floats, tick: int, timeout: Duration, listener: Listener) -> Received:
        """Put f_v(k), which the face has given, into the node's ``values``.

        Under the simulated clock this waits for the wave that the world sends in the tick.
        """
        if self._flooded(listener):
            return Received.NOTHING
        if self._waits:
            n = math.floor(self._face.n * self._ratio + ROUNDING)
            received = self._await_wave(self._hears.latest(n), timeout)
            if received is not Received.SIGNAL:
                return received
            self._hear_arrived(self._face.n)
        self._put_with_riders(values, self._f)
        self.tick = tick
        return Received.SIGNAL

    def _take_key(self, frame: bytes) -> bool:
        link = self.link
        if link is None or not self._by_datagram or self._path is not None:
            return False
        key = decode(frame, MAX_CONTROL_BYTES)
        if not isinstance(key, PathKey):
            return False
        try:
            if self._datagrams is None:
                self._datagrams = DatagramSocket.unbound(self._clock)
            self._path = self._datagrams.take_up(key, link.host, link, self.peer.width, self._peer_period)
        except TransportError:  # no datagrams from here: the waves stay with ZeroMQ
            return True
        self._path.gate = self._gate
        return True


class WorldEnd(_End):
    """The environment's end of a wave link: to the environment it is a coupling, which is always there in time."""

    def __init__(
        self,
        common: Common,
        peer: Peer,
        link: Link | None,
        clock: Clock,
        wave: WaveEnd,
        datagrams: DatagramSocket | None = None,
    ) -> None:
        """Begin a life; ``datagrams`` is the socket that all ends of the process share, None for none."""
        super().__init__(common, peer, link, clock, wave)
        self._datagrams = datagrams if self._by_datagram else None
        self.face = self._face = world_face(common, wave)
        self._answered = True  # whether the face has the force of its last tick
        self._asked = -1  # the tick in which the face moved last
        self._began = False  # whether a life of the link begins in the present tick

    def hear(self, values: Floats, tick: int, timeout: Duration, listener: Listener) -> Received:
        """Put p(k), which the face gives, into the node's ``values``; NOTHING before the first wave and while joining.

        A second call in a tick does nothing more.
        """
        if self._strays > MAX_STRAY_FRAMES:  # nobody waits for this user, so nobody else is to end for it
            self._strays = 0
            self.lose()
            return Received.FLOODED
        if self._asked == tick:
            return Received.NOTHING
        if self._waits:
            n = math.floor(self._face.n * self._ratio + ROUNDING) + 1
            received = self._await_wave(self._hears.latest(n), timeout)
            if received is not Received.SIGNAL:
                return received
            self._hear_arrived(self._face.n + 1)
        else:
            self._offer_path()
            if self._take_waves():
                return Received.RECONNECTED
        self._asked = tick
        self.settle(tick)
        if self._gate.newest is None:
            return Received.NOTHING
        if not self._waits:
            self._keep_time()
        self._began = not self._face.aligned
        p = self._face.tool()
        self._answered = False
        if not self._measure():
            return Received.NOTHING
        self._put_with_riders(values, p)
        self.tick = tick
        return Received.SIGNAL

    def read_by_others(self) -> None:
        """Read no frames of the link from now on: :meth:`arrived` brings them."""
        self._frames = []

    def arrived(self, frame: bytes) -> None:
        """Keep a frame that has come over the link, for the next tick."""
        if self._frames is not None:
            self._frames.append(frame)

    @property
    def pressed(self) -> int:
        """The user's buttons that are held down by the newest wave; none of a user who is silent."""
        return self._face.pressed << self._first_button

    def _admits_buttons(self) -> int:
        return self.peer.buttons[1]

    def send(self, kind: type[SignalMessage], tick: int, stamp: int, values: Floats, pressed: int = 0) -> bool:
        """Give the face f_e(k) behind the clutch, and send the user a wave."""
        share, m = self.share(values), self._sums
        self._take_force(share[:m])
        self._face.riders = tuple(share[m:])
        return self._send_wave()

    def settle(self, tick: int) -> None:
        """Finish the face's tick: on a coupling that is not active no force acts, for its clutch is open."""
        if not self._answered:
            self._take_force(self._zeros)

    def _take_force(self, f: Floats) -> None:
        face = self._face
        face.step(f)
        self._answered = True
        self._row = WaveRow(face.wave, face.tank.row(), *face.signals, self._began)
        self._note_silence()
        self._began = False

    def _begin_life(self) -> None:
        super()._begin_life()
        self._answered = True
        self._row = WaveRow(self._zeros, self.face.tank.row(), self._face.x, self._zeros)

    def _offer_path(self) -> None:
        """Offer the coupling a path for its datagrams, once in a life."""
        link = self.link
        if self._datagrams is None or self._path is not None or link is None or not self.here:
            return
        try:
            path = self._datagrams.offer(link, self.peer.width, self._peer_period)
        except TransportError:  # too many ports for a datagram: the waves stay with ZeroMQ
            self._datagrams = None
            return
        path.gate = self._gate
        self._path = path
        link.send(encode(path.key))


class WaveLinks(JoinKind):
    """The wave links of a node: a coupling has one at most, and the environment one for each user who is far away.

    The environment's share one socket for datagrams. Where they are all that a world has, in real time, its clock alone
    paces its ticks; then this reads the links together, for one after the other takes longer than a tick leaves.
    """

    def __init__(self, own: OwnEnd) -> None:
        """Open the environment's socket for datagrams, where it needs one."""
        super().__init__(own)
        at_world = bool(own.waves) and own.feedthrough is None
        alone = len(own.waves) == len(own.common.peers) and own.common.clock != SIMULATED
        self._datagrams = datagram_socket(own) if at_world else None
        self._arrivals = Arrivals() if at_world and alone else None
        self._ends: list[WorldEnd] = []

    def serves(self, peer: Peer) -> bool:
        """The peers for which the bundle has an end of a wave link."""
        return peer.name in self.own.waves

    def join(self, peer: Peer, link: Link | None) -> Join:
        """The user's end where the node has a block with a feedthrough, and the world's otherwise."""
        own, wave = self.own, self.own.waves[peer.name]
        if own.feedthrough is not None:
            return UserEnd(own.common, peer, link, own.clock, wave, own.feedthrough)
        end = WorldEnd(own.common, peer, link, own.clock, wave, self._datagrams)
        if self._arrivals is not None:
            end.read_by_others()
        self._ends.append(end)
        return end

    def read(self) -> None:
        """Read the datagrams of all ends, and give each end the frames that have come over its link."""
        if self._datagrams is not None:
            self._datagrams.read()
        if self._arrivals is not None:
            ends = self._ends
            for i, frame in self._arrivals.take([end.link for end in ends], AT_ONCE):
                ends[i].arrived(frame)

    def close(self) -> None:
        """Close the socket for datagrams."""
        if self._datagrams is not None:
            self._datagrams.close()


def may_go_by_datagram(common: Common) -> bool:
    """Whether the waves of a node may leave ZeroMQ: with keys, over tcp, and with a clock that does not wait."""
    return common.transport == "tcp" and bool(common.public) and common.clock != SIMULATED


def datagram_socket(own: OwnEnd) -> DatagramSocket | None:
    """The environment's socket for the datagrams of all its wave links, which its couplings may reach from elsewhere.

    None where no wave may go by datagram: without keys, within one machine's ipc, and under the simulated clock.
    """
    common = own.common
    if not may_go_by_datagram(common):
        return None
    host, _, port = shared_address([peer.address for peer in common.peers if peer.name in own.waves]).rpartition(":")
    try:
        return DatagramSocket.bound(host.strip("[]"), int(port) if port.isdecimal() else 0, own.clock)
    except TransportError:  # the port is taken, or UDP is forbidden: the waves stay with ZeroMQ
        return None


def user_face(common: Common, wave: WaveEnd, D_V: Values) -> UserFace:
    """The face of a coupling's end at the start of a session; ``D_V`` is the block's feedthrough, m x m, m/N."""
    depth = _first_depth(common, wave)
    E_0, theta, bounds = wave.tank, wave.theta, wave.bounds
    return UserFace(wave.b, D_V, common.period, wave.peer_period, depth, E_0=E_0, theta=theta, bounds=bounds)


def world_face(common: Common, wave: WaveEnd) -> WorldFace:
    """The face of an environment's end at the start of a session."""
    depth = _first_depth(common, wave)
    E_0, theta, bounds = wave.tank, wave.theta, wave.bounds
    return WorldFace(wave.b, common.period, wave.peer_period, depth, E_0=E_0, theta=theta, bounds=bounds)


def wave_bounds(wave: WaveEnd, riders: int = 0) -> WaveBounds | None:
    """What the other end's face sends at most; None where the site has no bounds.

    The ``riders`` numbers behind the sums need only be finite: whoever uses them judges them.
    """
    bounds, T = wave.bounds, wave.peer_period
    if bounds is None:
        return None
    any_ = (math.inf,) * riders
    step, first = tuple(T * one for one in bounds.wave) + any_, (*bounds.first_sum(wave.b), *any_)
    return WaveBounds(step, first, wave.tank, T * bounds.power, MOST_DELAY / from_seconds(T))


def turns(wave: WaveEnd) -> tuple[Turns, Turns]:
    """When an end sends its waves, and when the other end does."""
    return Turns(wave.every, wave.turn), Turns(wave.peer_every, wave.turn)


def _first_depth(common: Common, wave: WaveEnd) -> float:
    """The depth of the play-out until it is measured, ticks of the other end."""
    if wave.depth is not None:
        return wave.depth
    least = turns(wave)[1].depth
    if common.clock != SIMULATED:
        return FIRST_DEPTH / wave.peer_period + least
    if wave.way is None:
        return least
    # what measuring would find: the jitter, and a wave that stands in for a lost one
    return math.ceil(wave.way.jitter / wave.peer_period) + least * (2 if wave.way.loss else 1)
