"""A node's line to the supervisor: the conversation before the first tick, telemetry, and the last word."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import SIMULATED, Common, Peer
from manyhands.nodes.lifetime import Life, Sight, Stopped
from manyhands.nodes.log import Log
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
_PATIENCE = from_seconds(0.2)
_LAST_WORD_WAITS = 10
_JOINING_WAITS = 300  # a minute for a supervisor that is not there yet
_REPEAT_WAITS = 5
_PROBES = 32
_ALIVE_EVERY = from_seconds(1.0)
_WORDS_AT_ONCE = 8
_WORDS_KEPT = 64  # not yet obeyed; a supervisor says a few at a fault

Word = Absent | Return | Shift
"""What a supervisor may say to a node that runs, besides Stop."""

_M = TypeVar("_M", bound=Message)


class Refused(Exception):
    """The supervisor refused this node; the text is the supervisor's."""


class TelemetryLost(ValueError):
    """The supervisor does not read fast enough and the session may not lose telemetry."""


class ControlLine:
    """The link to the supervisor's hub, and what else there is to do ten times a second.

    Attributes:
        log: the node's log, written when telemetry is sent.
        absent: peers that are not there at the start; they are among the words of the loop, too.
        dropped: telemetry messages that could not be queued.
        malformed: frames from the supervisor that made no sense.
    """

    def __init__(self, transport: Transport, common: Common, log: Log | None = None) -> None:
        """Join the hub; without a ``log`` nothing is kept.

        Raises:
            TransportError: its endpoint is none.
        """
        self._transport, self._common = transport, common
        self.log = log or Log(None, common.session, common.name, RealtimeClock())
        self._link: Link = transport.join(common.control, common.name)
        self._lossless = common.clock == SIMULATED
        self._due = Instant(0)
        self._words: deque[Word] = deque(maxlen=_WORDS_KEPT)
        self._asked_to_stop = False
        self._introduction: Message | None = None
        self.absent: set[str] = set()
        self._generation = 0
        self.dropped = 0
        self.malformed = 0

    def hello(self, endpoints: Mapping[str, str], pid: int) -> None:
        """Introduce this node and what it has bound."""
        c = self._common
        hello = NodeHello(PROTOCOL_VERSION, c.certificate, c.session, c.name, c.role, pid, dict(endpoints))
        self._send(hello)
        if not c.directory:  # a guest's connection may take the place of one that is not yet known to be lost
            self._introduction = hello

    def peers_endpoints(self, life: Life) -> Mapping[str, str]:
        """Wait to be welcomed and told where the peers are.

        Raises:
            Refused: the supervisor does not accept this node.
            Stopped: the node should end.
        """
        self._await(Welcome, life)
        self._introduction = None
        return self._await(Connect, life).endpoints

    def ready(self) -> None:
        """Say that every link is established."""
        self._send(Ready())

    def start(self, life: Life) -> Start:
        """Wait for the first tick's instant; raises like :meth:`peers_endpoints`."""
        return self._await(Start, life)

    def publish(self, telemetry: Telemetry) -> None:
        """Send telemetry, or drop and count it when nobody keeps up: it must not disturb the loop.

        Whoever wants to be let in is attended to as well. A simulated clock has all the time in the world; there a
        recording must be whole.

        Raises:
            TelemetryLost: it would have been dropped from a recording under the simulated clock.
        """
        if refused := sum(self._transport.refused().values()):
            total = telemetry.figures.get(names.NOT_ADMITTED, 0.0) + refused
            telemetry = replace(telemetry, figures={**telemetry.figures, names.NOT_ADMITTED: total})
        if not self._link.send(encode(telemetry)):
            if self._lossless:
                raise TelemetryLost("the supervisor reads telemetry too slowly; record less, or not at all")
            self.dropped += 1
        self._transport.attend()
        self.log.flush()

    def refused(self) -> Mapping[str, int]:
        """Connections that this process did not admit, by reason."""
        return self._transport.refused()

    def clock_offset(self, clock: Clock, life: Life) -> Duration:
        """How far the supervisor's clock is ahead of ``clock``; raises like :meth:`peers_endpoints`."""
        exchanges: list[Exchange] = []
        while len(exchanges) < _PROBES:
            sent = clock.now()
            self._send(Probe(sent))
            while (echo := self._await(Echo, life)).sent != sent:
                self.malformed += 1  # the answer to nothing
            exchanges.append(Exchange(sent, echo.heard, echo.answered, clock.now()))
        return offset_of(exchanges)

    def connection(self) -> Sight:
        """Whether the supervisor can still be reached, for a node on another machine that is not in its loop."""
        return Sight.GONE if self._link.trouble() is Trouble.LOST else Sight.PRESENT

    def sight(self, now: Instant) -> Sight:
        """The same within the loop, where a Stop may come at any time; what else is said waits for :meth:`listen`.

        A Probe now and then tells the supervisor that this node is there, however long its ticks take.
        """
        if now >= self._due:
            self._due = Instant(now + _ALIVE_EVERY)
            self._send(Probe(now))
        self._read(NOT_AT_ALL)
        return Sight.ENDING if self._asked_to_stop else self.connection()

    def listen(self, timeout: Duration = NOT_AT_ALL) -> Word | None:
        """What the supervisor says to a node in its loop; at most ``timeout`` is waited, by default not at all."""
        if not self._words:
            self._read(timeout)
        return self._words.popleft() if self._words else None

    def bind_anew(self, peer: Peer) -> tuple[Link, str]:
        """A new link for a peer that was lost, and its endpoint; the old one is closed.

        Where its own port is not free again so soon, any port of that address.

        Raises:
            TransportError: none can be bound.
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
        """A link to a peer that was lost and has bound ``endpoint``; raises TransportError."""
        return self._transport.connect(endpoint, peer.name)

    def offer(self, peer: str, endpoint: str) -> None:
        """Tell where the link for ``peer`` is bound anew."""
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
                self._asked_to_stop = True
            elif not isinstance(message, Echo):
                self.malformed += 1
            timeout = NOT_AT_ALL

    def report(self, report: Report, life: Life) -> None:
        """Send the node's last word, and stay until it was heard."""
        self._last_word(report, life)

    def fault(self, text: str, life: Life) -> None:
        """Say why this node ends, and stay until it was heard."""
        self._last_word(Fault(presentable(text)), life)

    def _last_word(self, message: Message, life: Life) -> None:
        """Send ``message`` and wait, for a bounded time, for the supervisor's Stop.

        A process whose exit is seen before its last word would look like one that crashed.
        """
        frame, queued = encode(message), False
        for _ in range(_LAST_WORD_WAITS):
            queued = queued or self._link.send(frame)  # behind telemetry that fills the queue, it has to wait
            answer = self._link.recv(_PATIENCE)
            life.check()
            if answer is None:
                if life.orphaned or self._link.trouble() is not None:  # nobody hears it
                    return
            elif isinstance(decode(answer, MAX_CONTROL_BYTES), Stop):
                return

    def _send(self, message: Message) -> None:
        self._link.send(encode(message))  # a supervisor that is gone hears nothing, and life.check finds out

    def _await(self, kind: type[_M], life: Life) -> _M:
        waits = 0
        while True:
            frame = self._link.recv(_PATIENCE)
            if frame is None:
                life.check()
                if life.stopping:
                    raise Stopped
                waits += 1
                self._require_connection(waits)
                if self._introduction is not None and waits % _REPEAT_WAITS == 0 and self._link.trouble() is None:
                    self._send(self._introduction)
                continue
            message = decode(frame, MAX_CONTROL_BYTES)
            if isinstance(message, kind):
                return message
            if isinstance(message, Refusal):
                raise Refused(message.text)
            if isinstance(message, Stop):
                raise Stopped
            if isinstance(message, Absent):
                self.absent.add(message.peer)
                self._words.append(message)
                continue
            self.malformed += 1

    def _require_connection(self, waits: int) -> None:
        """Give up on a supervisor that will not have this node, at once, or that is not there, after a while."""
        trouble = self._link.trouble()
        if trouble is None or trouble is Trouble.LOST:
            return
        if trouble in (Trouble.NOBODY, Trouble.BROKEN_OFF) and waits < _JOINING_WAITS:  # it may be busy starting
            return
        raise Refused(
            f"{self._common.name}: cannot join the supervisor at {self._common.control}: {trouble}; see that the "
            "session runs there, and that bundle and key are of its present keys"
        )
