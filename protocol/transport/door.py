"""Admission of connections by key: the listening sockets of a process, and the requests that they refuse.

**Keys.** Every listening socket has a ZAP domain of its own, to which the keys of its peers are bound. ZeroMQ sends a
request before it lets a connection exist (RFC 27, CURVE of RFC 26). No thread answers: a second Python thread would
compete with the loop for the interpreter. The process answers while it waits for its peers, and in the slack of its
loop once that runs, a bounded number at a time (:meth:`Doorkeeper.attend`). Existing connections do not wait for it.

**Floods.** A :class:`Door` is one listening socket. ZeroMQ's monitor reports its events from a thread of its own, and
the door counts them. When too many connections come, a packet filter on the socket lets the kernel drop new ones. That
costs the process nothing, and leaves existing connections alone (ZeroMQ's own ``unbind`` would end them).

**The connecting side.** A :class:`Fate` is the state of an outgoing connection, from the events of its monitor.
"""

import ctypes
import socket as sockets
import struct
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from enum import StrEnum
from functools import reduce
from operator import or_
from typing import Final

import zmq
from zmq.utils import z85

from manyhands.protocol.keys import KeyRing
from manyhands.protocol.limits import DOOR_BURST, DOOR_FAILURES, DOOR_SHUT_MS, HANDSHAKE_MS
from manyhands.protocol.transport import Trouble
from manyhands.protocol.transport.descriptors import allow_descriptors


def monitor_of(socket: "zmq.Socket[bytes]", events: int) -> "zmq.Socket[bytes]":
    """A socket that becomes readable with each of these ``events`` of ``socket``, which is neither bound nor connected.

    Its queue has no bound: ZeroMQ's own thread writes to it, and would stop all connections of the process to wait for
    room. The caller must read the events, so that they do not pile up.
    """
    address = f"inproc://monitor-{id(socket)}"
    socket.monitor(address, events)
    monitor: zmq.Socket[bytes] = socket.context.socket(zmq.PAIR)
    monitor.setsockopt(zmq.RCVHWM, 0)
    monitor.connect(address)
    return monitor


def close_monitor(socket: "zmq.Socket[bytes]", monitor: "zmq.Socket[bytes]") -> None:
    """Close a monitor, before or after ``socket`` is closed."""
    if not socket.closed:
        socket.disable_monitor()  # before the other end closes, for ZeroMQ sends it a last message
    monitor.close(linger=0)


_EVENT: Final = struct.Struct("=Hi")


def event_of(frames: list[bytes]) -> zmq.Event:
    """The event in a monitor's message: 16 bits of event and 32 of its value, then the endpoint.

    pyzmq's reader in ``zmq.utils.monitor`` imports asyncio, which would take 50 ms of every node's start.
    """
    event, _ = _EVENT.unpack(frames[0])
    return zmq.Event(event)


class Fate:
    """The state of an outgoing connection, from ZeroMQ's events in their order. Pure.

    A connection that ends within its handshake does not show the reason. A host without the expected key ends each one
    at once. A host that is too busy to admit any ends it after ``HANDSHAKE_MS``. So only many such ends in a row mean a
    wrong key.

    Attributes:
        trouble: the present failure; None while none is known.
    """

    EVENTS: Final = reduce(
        or_,
        (
            zmq.Event.HANDSHAKE_SUCCEEDED,
            zmq.Event.HANDSHAKE_FAILED_AUTH,
            zmq.Event.HANDSHAKE_FAILED_PROTOCOL,
            zmq.Event.HANDSHAKE_FAILED_NO_DETAIL,
            zmq.Event.DISCONNECTED,
            zmq.Event.CONNECT_RETRIED,
        ),
    )

    def __init__(self) -> None:
        self.trouble: Trouble | None = None
        self._established = False
        self._broken_off = 0

    def take(self, event: zmq.Event) -> None:
        """Take in one of :attr:`EVENTS`."""
        if event is zmq.Event.HANDSHAKE_SUCCEEDED:
            self.trouble, self._established, self._broken_off = None, True, 0
            return
        if event is zmq.Event.HANDSHAKE_FAILED_NO_DETAIL:
            self._broken_off += 1
        if self.trouble in _PASSING:  # the first failure is the cause: a refusal is followed by a loss as well
            self.trouble = self._meaning(event)

    def _meaning(self, event: zmq.Event) -> Trouble | None:
        match event:
            case zmq.Event.HANDSHAKE_FAILED_AUTH:
                return Trouble.NOT_ADMITTED
            case zmq.Event.HANDSHAKE_FAILED_PROTOCOL:
                return Trouble.NOT_PROVED
            case zmq.Event.HANDSHAKE_FAILED_NO_DETAIL:
                return Trouble.BROKEN_OFF if self._broken_off < BROKEN_OFF_IN_A_ROW else Trouble.NOT_PROVED
            case zmq.Event.DISCONNECTED if self._established:
                return Trouble.LOST
            case zmq.Event.CONNECT_RETRIED if self.trouble is None:
                return Trouble.NOBODY
        return self.trouble


BROKEN_OFF_IN_A_ROW: Final = 20
"""Connections that may end within their handshake, one after the other, before this means a wrong key.

That takes three seconds with a wrong key, and more than a minute with a host that is busy.
"""

_PASSING: Final = (None, Trouble.NOBODY, Trouble.BROKEN_OFF)


class NotAdmitted(StrEnum):
    """The reasons why a connection was not admitted."""

    NO_KEY = "no_key"  # it uses no CURVE key, most likely no security mechanism at all
    NOT_PROVED = "not_proved"  # it has not the secret of the key that it shows, or expects a different key of us
    UNKNOWN_KEY = "unknown_key"  # its key is not among the keys of this process
    WRONG_KEY = "wrong_key"  # its key is known, but not admitted to this socket
    SECOND_PEER = "second_peer"  # its key is right, but the peer of this link is connected already
    UNFINISHED = "unfinished"  # it was opened, and has not finished a handshake (yet)
    SHUT = "shut"  # how often a door was shut because too many connections came


class Door:
    """One listening socket: the counts of its connections, and the packet filter that shuts it."""

    _EVENTS: Final = (
        zmq.EVENT_LISTENING
        | zmq.EVENT_ACCEPTED
        | zmq.EVENT_HANDSHAKE_SUCCEEDED
        | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
        | zmq.EVENT_HANDSHAKE_FAILED_AUTH
        | zmq.EVENT_DISCONNECTED
    )
    _CRYPTOGRAPHIC: Final = 0x11000001  # ZMQ_PROTOCOL_ERROR_ZMTP_CRYPTOGRAPHIC
    _EVENT: Final = struct.Struct("=HI")
    _EVENTS_AT_ONCE: Final = 2 * DOOR_BURST  # events counted in one look, a few us each; the rest in the next look
    _WINDOW: Final = 100_000_000  # ns, the window of DOOR_BURST
    _FAILURES_WINDOW: Final = 1_000_000_000  # ns, the window of DOOR_FAILURES
    _ROOM: Final = 4 * DOOR_BURST  # connections open at a time; each is a file descriptor of this process

    def __init__(self, socket: "zmq.Socket[bytes]", admits: int) -> None:
        self.socket, self._admits = socket, admits
        self.monitor = monitor_of(socket, self._EVENTS)
        self._listener: int | None = None
        self._open: dict[int, bool] = {}  # connections by descriptor, the newest last: whether they are established
        self._window, self._came = 0, 0  # monotonic ns, and connections opened since
        self._failures_window, self._failed = 0, 0  # the same, and handshakes that failed for their key
        self.shut_until: int | None = None  # monotonic ns
        self.accepted = self.succeeded = self.no_key = self.not_proved = self.not_admitted = self.shut = 0
        self.second = 0

    def fail(self) -> None:
        """Count a refused key; the monitor does not report a connection that ends before the answer."""
        self._failed += 1

    def look(self, now: int) -> None:
        """Count the monitor's events, a bounded number; shut the door if there were too many, or open it again."""
        if now - self._window >= self._WINDOW:
            self._window, self._came = now, 0
        if now - self._failures_window >= self._FAILURES_WINDOW:
            self._failures_window, self._failed = now, 0
        told_all = self._listen_to_monitor()
        if self.shut_until is None:
            crowd = self._came > DOOR_BURST + self._admits  # all honest peers may come at once
            crowd |= self._failed > DOOR_FAILURES  # no honest peer fails
            if (crowd or self._is_full()) and self._filter(True):
                self.shut += 1
                self.shut_until = now + DOOR_SHUT_MS * 1_000_000
        elif now >= self.shut_until and told_all and not self._is_full():  # not while unread events could pile up
            self._filter(False)
            self.shut_until = None
            self._window, self._came = now, 0
            self._failures_window, self._failed = now, 0

    def _listen_to_monitor(self) -> bool:
        """Count the monitor's events, a bounded number; returns whether no event is left."""
        for _ in range(self._EVENTS_AT_ONCE):
            try:
                data = self.monitor.recv_multipart(zmq.NOBLOCK)[0]
            except zmq.Again:
                return True
            self._count(*self._EVENT.unpack(data))
        return False

    def _is_full(self) -> bool:
        return len(self._open) > self._ROOM + self._admits

    def _count(self, event: int, value: int) -> None:
        match event:
            case zmq.EVENT_LISTENING:
                self._listener = value
            case zmq.EVENT_ACCEPTED:
                self.accepted += 1
                self._came += 1
                self._open.pop(value, None)
                self._open[value] = False
            case zmq.EVENT_HANDSHAKE_SUCCEEDED:
                self.succeeded += 1
                self._establish()
            case zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL if value == self._CRYPTOGRAPHIC:
                self.not_proved += 1
                self._failed += 1
            case zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL:
                self.no_key += 1
            case zmq.EVENT_HANDSHAKE_FAILED_AUTH:
                self.not_admitted += 1  # the answer to ZeroMQ's request has counted the reason
            case zmq.EVENT_DISCONNECTED:
                self._open.pop(value, None)

    def _establish(self) -> None:
        """Note a successful handshake; ZeroMQ does not name its connection, most likely the latest one."""
        if self._admits == 1 and any(self._open.values()):
            self.second += 1
        for descriptor, established in reversed(self._open.items()):
            if not established:
                self._open[descriptor] = True
                return

    def refused(self) -> dict[NotAdmitted, int]:
        """Connections that were not established, by reason, without those whose key was refused."""
        unfinished = self.accepted - self.succeeded - self.no_key - self.not_proved - self.not_admitted
        return {
            NotAdmitted.NO_KEY: self.no_key,
            NotAdmitted.NOT_PROVED: self.not_proved,
            NotAdmitted.SECOND_PEER: self.second,
            NotAdmitted.UNFINISHED: max(0, unfinished),
            NotAdmitted.SHUT: self.shut,
        }

    def _filter(self, drop_all: bool) -> bool:
        """Make the kernel drop every packet to the listening socket, or none; returns whether it succeeded.

        This needs no new file descriptor, for a flood of connections may have used up all of them.
        """
        if self._listener is None or self.socket.closed:  # a different file may have the descriptor by now
            return False
        program = ctypes.create_string_buffer(struct.pack("=HBBI", 0x06, 0, 0, 0))  # BPF: return 0, accept no byte
        try:
            listener = sockets.socket(fileno=self._listener)
        except OSError:
            return False
        try:
            if drop_all:
                argument = struct.pack("@HP", 1, ctypes.addressof(program))
                listener.setsockopt(sockets.SOL_SOCKET, _SO_ATTACH_FILTER, argument)
            else:
                listener.setsockopt(sockets.SOL_SOCKET, _SO_DETACH_FILTER, 0)
        except OSError:  # the kernel does not permit it: the door stays as it is
            return False
        finally:
            listener.detach()  # the descriptor belongs to ZeroMQ
        return True

    def close(self) -> None:
        """Close the monitor; the owner closes the socket itself."""
        close_monitor(self.socket, self.monitor)


_SO_ATTACH_FILTER: Final = 26  # asm-generic/socket.h
_SO_DETACH_FILTER: Final = 27


_VERSION: Final = b"1.0"
_LEAST_FRAMES: Final = 6  # version, request id, domain, address, identity, mechanism; then the credentials


def judge(
    request: Sequence[bytes], admits: Mapping[bytes, Mapping[bytes, str]], known: Collection[bytes]
) -> tuple[list[bytes], NotAdmitted | None]:
    """The answer to a ZAP request.

    Args:
        request: the frames of ZeroMQ's request.
        admits: by domain, the public keys (32 bytes) that may connect, and their names.
        known: every public key that this process knows.

    Returns:
        The frames of the reply, with the name as user id if the connection is admitted; and the reason of a refusal,
        or None.
    """
    if len(request) != _LEAST_FRAMES + 1 or request[0] != _VERSION or request[5] != b"CURVE":
        number = request[1] if len(request) > 1 else b""
        return [_VERSION, number, b"400", b"no CURVE key", b"", b""], NotAdmitted.NO_KEY
    _, number, domain, _, _, _, key = request
    name = admits.get(domain, {}).get(key)
    if name is not None:
        return [_VERSION, number, b"200", b"OK", name.encode("ascii"), b""], None
    return [_VERSION, number, b"400", b"not admitted", b"", b""], (
        NotAdmitted.WRONG_KEY if key in known else NotAdmitted.UNKNOWN_KEY
    )


class Doorkeeper:
    """Guards the sockets of one context with the keys of one process.

    Attributes:
        settled: whether the process has its peers, and answers only in :meth:`attend`.
    """

    _ANSWERS: Final = 32  # requests answered in one look
    _LOOK_MS: Final = 100  # between two looks while a door is shut

    def __init__(
        self, context: "zmq.Context[zmq.Socket[bytes]]", ring: KeyRing, now: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """Guard the sockets of a context.

        Args:
            context: the context, of which no socket is bound yet.
            ring: the keys of this process.
            now: returns the present time, monotonic ns.
        """
        self._ring, self._now = ring, now
        allow_descriptors()  # without a free descriptor ZeroMQ's thread would spin
        self._keys = {z85.decode(public.encode("ascii")): name for name, public in ring.peers.items()}
        self._admits: dict[bytes, Mapping[bytes, str]] = {}
        self._doors: list[Door] = []
        self._by_domain: dict[bytes, Door] = {}
        self._refused = dict.fromkeys(NotAdmitted, 0)
        self._desk = context.socket(zmq.REP)
        self._desk.bind("inproc://zeromq.zap.01")
        self.settled = False

    def guard(self, socket: "zmq.Socket[bytes]", domain: str, admits: Collection[str]) -> None:
        """Admit only the keys of some peers to ``socket``.

        Args:
            socket: a socket that is not bound yet.
            domain: a ZAP domain that no other socket has.
            admits: the names of the peers; a single peer has one connection at a time.

        Raises:
            KeyError: the ring has no key of one of the peers.
        """
        wanted = {self._ring.peers[name] for name in admits}
        self._admits[domain.encode("ascii")] = {
            key: name for key, name in self._keys.items() if self._ring.peers[name] in wanted
        }
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._ring.pair.secret.encode("ascii"))
        socket.setsockopt_string(zmq.ZAP_DOMAIN, domain)
        socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        door = self._by_domain[domain.encode("ascii")] = Door(socket, len(admits))
        self._doors.append(door)

    def dismiss(self, socket: "zmq.Socket[bytes]") -> None:
        """Stop guarding a socket that is about to be closed for good; its counts are kept."""
        for domain, door in tuple(self._by_domain.items()):
            if door.socket is socket:
                door.look(self._now())
                for kind, count in door.refused().items():
                    self._refused[kind] += count
                door.close()
                self._doors.remove(door)
                del self._by_domain[domain], self._admits[domain]

    def introduce(self, socket: "zmq.Socket[bytes]", peer: str) -> None:
        """Make ``socket``, which is about to connect, prove the key of this process and require the key of ``peer``.

        Raises:
            KeyError: the ring has no key of ``peer``.
        """
        socket.setsockopt(zmq.CURVE_SERVERKEY, self._ring.peers[peer].encode("ascii"))
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self._ring.pair.public.encode("ascii"))
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._ring.pair.secret.encode("ascii"))

    @property
    def knocking(self) -> "list[zmq.Socket[bytes]]":
        """The sockets that become readable when there is work for :meth:`attend`."""
        return [self._desk, *(door.monitor for door in self._doors)]

    @property
    def shut(self) -> bool:
        """Whether a door is shut, and waits for :meth:`attend` to open it again."""
        return any(door.shut_until is not None for door in self._doors)

    def at_most(self, wait_ms: int) -> int:
        """The part of a wait (ms, -1 for no end) that may pass before the next :meth:`attend`."""
        if not self.shut:
            return wait_ms
        return self._LOOK_MS if wait_ms < 0 else min(wait_ms, self._LOOK_MS)

    def attend(self) -> None:
        """Answer connection requests and count events, a bounded number of both."""
        if self._desk.closed:  # every door is closed as well
            return
        for _ in range(self._ANSWERS):
            try:
                request = self._desk.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                break
            reply, refused = judge(request, self._admits, self._keys)
            if refused is not None:
                self._refused[refused] += 1
                if (door := self._by_domain.get(request[2] if len(request) > 2 else b"")) is not None:
                    door.fail()
            self._desk.send_multipart(reply)
        self._look()

    def _look(self) -> None:
        now = self._now()
        for door in self._doors:
            door.look(now)

    def refused(self) -> dict[str, int]:
        """Connections not admitted so far, by :class:`NotAdmitted`; reasons that never occurred are absent."""
        if not self._desk.closed:
            self._look()  # a connection established since the last look must not count as unfinished
        total = dict(self._refused)
        for door in self._doors:
            for kind, count in door.refused().items():
                total[kind] += count
        return {kind.value: count for kind, count in total.items() if count > 0}

    def close(self) -> None:
        """Close all doors, while the guarded sockets are still open or after they were closed."""
        for door in self._doors:
            door.close()
        self._desk.close(linger=0)
