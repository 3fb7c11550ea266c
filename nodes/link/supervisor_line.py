"""A node's line to the supervisor: its messages before the first tick, telemetry, events of peers, and its last report.

Before the first tick the node waits for each answer. In its loop it only reads what has come
(:meth:`ControlLine.listen`), and sends telemetry without waiting (:meth:`ControlLine.publish`). Its last message, a
report or a fault, is sent until the supervisor confirms it with a Stop.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

from manyhands.nodes.kernel.bundle import SIMULATED, Common, Peer
from manyhands.nodes.kernel.lifetime import Life, Sight, Stopped
from manyhands.nodes.kernel.log import Log
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Clock, Duration, Exchange, Instant, RealtimeClock, from_seconds, offset_of
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Connect,
    Echo,
    Fault,
    Message,
    NodeHello,
    Offer,
    Probe,
    Ready,
    Refusal,
    Report,
    Return,
    Shift,
    Start,
    Stop,
    Telemetry,
    Welcome,
    presentable,
)
from manyhands.protocol.transport import Link, Transport, TransportError, Trouble

NOT_AT_ALL = Duration(0)
PATIENCE = from_seconds(0.2)  # one wait for an answer, after which the node checks its life and the connection
_LAST_WORD_WAITS = 50  # waits for the confirmation of the last message, for a busy supervisor has much to read first
_JOINING_WAITS = 300  # waits for a supervisor that is not there yet: a minute
REPEAT_WAITS = 5  # waits before a guest sends its hello again, and any node its last message
MOST_START = 2**62  # ns, and ticks: more than a hundred years, to which periods can still be added
LONGEST_AHEAD = Duration(_JOINING_WAITS * PATIENCE)
"""ns from a start's message to its tick 0, at most: as long as a guest waits for a supervisor that is not there yet."""
_PROBES = 32  # exchanges for the clock's offset
_PROBE_TICKS = 5  # between two probes of a guest that measures its way to the supervisor
_ALIVE_EVERY = from_seconds(1.0)  # between two signs of life of a guest
_WORDS_AT_ONCE = 8  # messages read in one look, so that a look has a bounded time
_WORDS_KEPT = 64  # messages that wait for their turn; a supervisor sends a few at a fault

Word = Absent | Return | Shift
"""The supervisor's messages to a node in its loop, besides Stop."""

_M = TypeVar("_M", bound=Message)


class Refused(Exception):
    """The supervisor refused this node; the message is the supervisor's."""


class TelemetryLost(ValueError):
    """The supervisor reads too slowly for a session that may not lose telemetry."""


class ControlLine:
    """The link to the supervisor's hub. With each telemetry it also admits peers and writes the log.

    Attributes:
        log: the node's log, written when telemetry is sent.
        absent: peers that are absent at the start; the loop receives them as messages as well.
        stop: the supervisor's Stop; None before that.
        echo: the supervisor's latest answer to a sign of life of a guest in its loop; None before that.
        dropped: telemetry messages that could not be queued.
        malformed: frames of the supervisor that could not be understood, or were not expected.
    """

    def __init__(self, transport: Transport, common: Common, log: Log | None = None, host: str = "") -> None:
        """Join the hub.

        Args:
            transport: the node's sockets.
            common: the common part of its bundle.
            log: the node's log; None for no log.
            host: where this node reaches the supervisor's machine, on which all of its peers are; empty where the
                endpoints of the peers are used as they come. A guest may know that machine by a different address than
                the machine itself, and connects to no other.

        Raises:
            TransportError: the hub's endpoint is none of this transport.
        """
        self._transport, self._common = transport, common
        self.log = log or Log(None, common.session, common.name, RealtimeClock())
        self._link: Link = transport.join(common.control, common.name)
        self._lossless = common.clock == SIMULATED
        self._due = Instant(0)
        self._shown = Instant(-1)  # when the latest sign of life was sent
        self._words: deque[Word] = deque(maxlen=_WORDS_KEPT)
        self._host = host
        self.stop: Stop | None = None
        self.echo: Echo | None = None
        self._introduction: Message | None = None
        self._welcomed = False
        self.absent: set[str] = set()
        self._generation = 0
        self.dropped = 0
        self.malformed = 0

    def hello(self, endpoints: Mapping[str, str], pid: int) -> None:
        """Send the supervisor the node's name, process id and, by peer, the endpoints that it has bound."""
        c = self._common
        hello = NodeHello(PROTOCOL_VERSION, c.certificate, c.session, c.name, c.role, pid, dict(endpoints))
        self._send(hello)
        # the hub may still hold a guest's old connection and refuse the new one, so a guest repeats its hello
        if not c.directory:
            self._introduction = hello

    def peers_endpoints(self, life: Life) -> Mapping[str, str]:
        """Wait for the supervisor's welcome and the endpoints of the peers; returns these by peer.

        Raises:
            Refused: the supervisor does not accept this node, or cannot be reached.
            Stopped: the node should end.
        """
        self._await(Welcome, life)
        self._introduction, self._welcomed = None, True
        endpoints = self._await(Connect, life).endpoints
        return {peer: self._reached(endpoint) for peer, endpoint in endpoints.items()}

    def ready(self, by_itself: tuple[str, ...] = ()) -> None:
        """Report that every link is established, and what a device does by itself, a sentence each."""
        self._send(Ready(by_itself))

    def start(self, life: Life) -> Start:
        """Wait for the start: first tick, number of ticks, epoch; raises as :meth:`peers_endpoints`.

        Raises:
            Refused: no session can have begun, or gone, so far: its instants would not fit the messages any more.
        """
        start = self._await(Start, life)
        for what, found in (("epoch", start.epoch), ("tick", start.tick), ("number of ticks", start.ticks)):
            if not 0 <= found <= MOST_START:
                raise Refused(f"found a start with the {what} {found}; expected at most {MOST_START}")
        return start

    @staticmethod
    def require_near(start: Start, now: Instant) -> None:
        """Refuse a start that is too far ahead, for this node would wait for it and say nothing.

        Args:
            start: with its epoch on this node's clock.
            now: the present instant of that clock.

        Raises:
            Refused: its tick 0 is more than :data:`LONGEST_AHEAD` away.
        """
        if (ahead := start.epoch - now) > LONGEST_AHEAD:
            raise Refused(f"found a start in {ahead / 1e9:.4g} s; expected at most {LONGEST_AHEAD / 1e9:g} s")

    def publish(self, telemetry: Telemetry) -> None:
        """Send telemetry, as :meth:`post` does; raises what that raises."""
        self.post(self.frame(telemetry))

    def frame(self, telemetry: Telemetry) -> bytes:
        """The frame of a telemetry, to which the connections that were not admitted are added."""
        if refused := sum(self._transport.refused().values()):
            total = telemetry.figures.get(names.NOT_ADMITTED, 0.0) + refused
            telemetry = replace(telemetry, figures=telemetry.figures.with_numbers({names.NOT_ADMITTED: total}))
        return encode(telemetry)

    def post(self, frame: bytes) -> None:
        """Send a telemetry's frame; where the supervisor reads too slowly, drop and count it, for the loop's sake.

        The transport decides here as well on connections that ask to be admitted, and the log is written. Under the
        simulated clock no telemetry may be dropped, for there a recording must be complete.

        Raises:
            TelemetryLost: the telemetry cannot be queued, under the simulated clock.
        """
        if not self._link.send(frame):
            if self._lossless:
                raise TelemetryLost("the supervisor reads telemetry too slowly; record less, or not at all")
            self.dropped += 1
        self._transport.attend()
        self.log.flush()

    def refused(self) -> Mapping[str, int]:
        """Connections that this process did not admit, by reason."""
        return self._transport.refused()

    def clock_offset(self, clock: Clock, life: Life) -> Duration:
        """How far the supervisor's clock is ahead of ``clock``, ns; raises as :meth:`peers_endpoints`."""
        exchanges: list[Exchange] = []
        while len(exchanges) < _PROBES:
            sent = clock.now()
            self._send(Probe(sent))
            while (echo := self._await(Echo, life)).sent != sent:
                self.malformed += echo.sent != self._shown  # the answer to no probe of this node
            exchanges.append(Exchange(sent, echo.heard, echo.answered, clock.now()))
        return offset_of(exchanges)

    def round_trips(self, clock: Clock, life: Life, ticks: int, period: Duration) -> list[Duration]:
        """How long frames take to the supervisor and back, ns each, as a loop sees it that wakes once in a period.

        What counts is when a frame is due to leave, and when it is read. So a machine that wakes late is seen as well.

        Args:
            clock: a realtime clock.
            life: whether the node should still run.
            ticks: how often the loop wakes; every fifth time it sends a probe.
            period: between two of these, ns.

        Raises:
            Stopped: the node should end.
        """
        found: list[Duration] = []
        start = clock.now()
        for tick in range(ticks):
            due = Instant(start + tick * period)
            clock.sleep_until(due)
            if tick % _PROBE_TICKS == 0:
                self._send(Probe(due))
            life.check()
            if life.stopping:
                raise Stopped
            while (frame := self._link.recv(NOT_AT_ALL)) is not None:
                self._take_echo(frame, start, clock.now(), found)
        return found

    def _take_echo(self, frame: bytes, start: Instant, now: Instant, found: list[Duration]) -> None:
        match decode(frame, MAX_CONTROL_BYTES):
            case Echo(sent) if sent <= now:
                if sent >= start:  # an answer to an earlier measurement shows how long that took, and not this one
                    found.append(Duration(now - sent))
            case Stop() as stop:
                self.stop = stop
                raise Stopped
            case Absent() as absent:
                self.absent.add(absent.peer)
                self._words.append(absent)
            case _:
                self.malformed += 1

    def connection(self) -> Sight:
        """Whether the supervisor can still be reached, for a guest that is not in its loop."""
        return Sight.GONE if self._link.trouble() is Trouble.LOST else Sight.PRESENT

    def joining(self, now: Instant) -> Sight:
        """As :meth:`connection`, for a guest that the supervisor has welcomed and that waits for something else.

        The guest sends a Probe once a second: so the supervisor sees that it lives, however long it has to wait.
        """
        if self._welcomed:
            self._show_life(now)
        return self.connection()

    def sight(self, now: Instant) -> Sight:
        """As :meth:`joining`, for a guest in its loop, where a Stop may come at any time.

        Other messages wait for :meth:`listen`.
        """
        self._show_life(now)
        self._read(NOT_AT_ALL)
        return Sight.ENDING if self.stop is not None else self.connection()

    def _show_life(self, now: Instant) -> None:
        if now >= self._due:
            self._due, self._shown = Instant(now + _ALIVE_EVERY), now
            self._send(Probe(now))

    def listen(self, timeout: Duration = NOT_AT_ALL) -> Word | None:
        """The supervisor's next message to a node in its loop, or None; waits at most ``timeout``, by default 0."""
        if not self._words:
            self._read(timeout)
        return self._words.popleft() if self._words else None

    def bind_anew(self, peer: Peer) -> tuple[Link, str]:
        """Bind a new link for a lost peer, whose old link is closed; returns the link and its endpoint.

        Where the peer's port is not free again so soon, the link gets any free port of that address.

        Raises:
            TransportError: no link can be bound.
        """
        self._generation += 1
        name = f"{self._common.name}-{peer.name}.{self._generation}"
        try:
            return self._transport.bind(name, peer.name, peer.address)
        except TransportError:
            if not peer.address:
                raise
            host = peer.address.rpartition(":")[0]
            return self._transport.bind(f"{name}.any", peer.name, f"{host}:*")

    def connect(self, endpoint: str, peer: Peer) -> Link:
        """Connect to a peer that was lost and has bound ``endpoint``.

        Raises:
            TransportError: the endpoint is none of this transport.
        """
        return self._transport.connect(self._reached(endpoint), peer.name)

    def _reached(self, endpoint: str) -> str:
        scheme, _, place = endpoint.partition("://")
        return f"{scheme}://{self._host}:{place.rpartition(':')[2]}" if self._host else endpoint

    def offer(self, peer: str, endpoint: str) -> None:
        """Report to the supervisor that the link for ``peer`` is bound anew at ``endpoint``."""
        self._send(Offer(peer, endpoint))

    def _read(self, timeout: Duration) -> None:
        for _ in range(_WORDS_AT_ONCE):
            frame = self._link.recv(timeout)
            if frame is None:
                return
            message = decode(frame, MAX_CONTROL_BYTES)
            if isinstance(message, Word):
                self._words.append(message)
            elif isinstance(message, Stop):
                self.stop = message
            elif isinstance(message, Echo):
                self.echo = message
            else:
                self.malformed += 1
            timeout = NOT_AT_ALL

    def report(self, report: Report, life: Life) -> None:
        """Send the node's report, and wait for a bounded time until the supervisor confirms it."""
        self._last_word(report, life)

    def fault(self, text: str, life: Life, by_user: bool = False) -> None:
        """Report why this node ends, and wait for a bounded time until the supervisor confirms it.

        ``by_user`` is whether its user has ended it.
        """
        self._last_word(Fault(presentable(text), by_user), life)

    def _last_word(self, message: Message, life: Life) -> None:
        """Send ``message`` and wait, for a bounded time, for the supervisor's Stop.

        Without the wait the supervisor might see the exit before the message, which looks like a crash. The message is
        repeated, for a connection that breaks and comes again loses what was on its way.
        """
        frame, broken = encode(message), 0
        unsent = True
        for waits in range(_LAST_WORD_WAITS):
            if unsent or waits % REPEAT_WAITS == 0:
                unsent = not self._link.send(frame)  # telemetry may still fill the queue
            answer = self._link.recv(PATIENCE)
            life.check()
            if answer is None:
                broken = 0 if self._link.trouble() is None else broken + 1
                if life.orphaned or broken == REPEAT_WAITS:  # no supervisor is left to confirm it
                    return
            elif isinstance(decode(answer, MAX_CONTROL_BYTES), Stop):
                return

    def _send(self, message: Message) -> None:
        self._link.send(encode(message))  # if the supervisor is gone the message is lost, and life.check finds out

    def _await(self, kind: type[_M], life: Life) -> _M:
        waits = 0
        while True:
            frame = self._link.recv(PATIENCE)
            if frame is None:
                life.check()
                if life.stopping:
                    raise Stopped
                waits += 1
                require_hub(self._link, self._common.name, self._common.control, waits < _JOINING_WAITS)
                if self._introduction is not None and waits % REPEAT_WAITS == 0 and self._link.trouble() is None:
                    self._send(self._introduction)
                continue
            message = decode(frame, MAX_CONTROL_BYTES)
            if isinstance(message, kind):
                return message
            if isinstance(message, Refusal):
                raise Refused(message.text)
            if isinstance(message, Stop):
                self.stop = message
                raise Stopped
            if isinstance(message, Absent):
                self.absent.add(message.peer)
                self._words.append(message)
                continue
            self.malformed += not (isinstance(message, Echo) and message.sent == self._shown)


def require_hub(link: Link, name: str, control: str, waiting: bool) -> None:
    """Give up: at once where the supervisor refuses this node, and where none answers, once waiting is over.

    Args:
        link: to the supervisor's hub.
        name: of this node.
        control: the hub's endpoint.
        waiting: whether a supervisor that is not there is still waited for.

    Raises:
        Refused: there is no use in waiting.
    """
    trouble = link.trouble()
    if trouble is None or trouble is Trouble.LOST:
        return
    if trouble in (Trouble.NOBODY, Trouble.BROKEN_OFF) and waiting:  # it may be busy starting
        return
    raise Refused(
        f"{name}: cannot join the supervisor at {control}: {trouble}; see that the session runs there, and that "
        "what you were given, bundle and key or invitation, is of its present keys"
    )
