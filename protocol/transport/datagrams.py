"""Datagrams for the waves of wave links: one UDP socket in a process, whatever the number of its paths.

The environment binds one port and has a path for each linked coupling on it; a coupling has a socket of its own. A
:class:`DatagramPath` is one end of one path. It sends and receives waves and chooses what carries them, a datagram or
the ZeroMQ link. What is sealed, opened and refused, and what state a path is in, is decided in
:mod:`manyhands.protocol.path`; here are sockets and addresses.

**Addresses.** The environment answers to the address that the latest datagram came from that opened, once it is proved
(:class:`manyhands.protocol.path.Replies`). So a coupling behind a translator of addresses may change its address at any
time. ZeroMQ carries the waves as well until the new one is proved, a round trip later. The coupling sends to the host
at which it has reached the environment, in turn to all addresses of that name until one answers.

**Strangers.** A packet filter on the socket has the kernel drop every datagram that names none of the socket's
connections, which are random numbers. Such a datagram does not even wake the process. What passes is opened or refused
in bounded numbers, each is counted and none is answered.

**Size.** No datagram is longer than ``MAX_DATAGRAM_BYTES``, and none is cut up on its way (DF). Where a network carries
less than that, no datagram comes through, and the waves go over ZeroMQ.
"""

import ctypes
import secrets
import socket
import struct
from collections.abc import Collection, Sequence
from contextlib import suppress
from typing import Final

from manyhands.protocol.clock import Clock, Duration, Instant
from manyhands.protocol.codec import CONNECTION_BYTES, SECRET_BYTES, WAVE_ID, WaveWriter, type_of
from manyhands.protocol.gate import WaveGate
from manyhands.protocol.limits import MAX_DATAGRAM_BYTES
from manyhands.protocol.messages import PathKey, Wave
from manyhands.protocol.path import (
    MOST_PORTS,
    Address,
    Direction,
    NotOpened,
    PathEnd,
    PathState,
    Replies,
    connection_of,
)
from manyhands.protocol.transport import Link, TransportError
from manyhands.protocol.transport.zeromq import LOOPBACK

_READ_AT_ONCE: Final = 64
"""Datagrams read in one call, beyond four for each path: a flood must not keep the loop from its other work."""

_QUEUE_BYTES: Final = 4 * 1024 * 1024  # asked of the kernel for what waits while the process does not run


def shared_address(addresses: Sequence[str]) -> str:
    """The address of the one socket for the datagrams of several links, ``HOST:PORT``.

    It is that of the first link to another machine, so one port more is to be opened in a firewall. Where all are of
    this machine, it is that of the first.

    Args:
        addresses: where the links are bound; empty for one that no other machine reaches. ``*`` is any free port.
    """
    here = f"{LOOPBACK}:"
    bound = [address for address in addresses if address]
    return next((one for one in bound if not one.startswith(here)), bound[0] if bound else f"{here}*")


class DatagramSocket:
    """A UDP socket and the paths on it; for one thread, and never blocking.

    Attributes:
        refused: datagrams that belonged to no path, by reason; those of a path count there.
        unsent: datagrams that the system did not take, for instance for want of a route.
    """

    def __init__(self, own: socket.socket, clock: Clock) -> None:
        """Take over a socket; see :meth:`bound` and :meth:`unbound`."""
        self._socket, self._clock = own, clock
        self._paths: dict[bytes, DatagramPath] = {}
        self.refused: dict[NotOpened, int] = {NotOpened.NO_DATAGRAM: 0, NotOpened.UNKNOWN_PATH: 0}
        self.unsent = 0
        own.setblocking(False)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _QUEUE_BYTES)
        _never_fragment(own)
        self._filter()

    @classmethod
    def bound(cls, host: str, port: int, clock: Clock) -> "DatagramSocket":
        """The environment's socket.

        Args:
            host: an address of this machine, or a name of one; empty for all, of IPv4 and IPv6.
            port: the UDP port; 0 for any.
            clock: the clock of the process.

        Raises:
            TransportError: the address cannot be bound.
        """
        try:
            if host:
                family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
                own = socket.socket(family, kind)
            else:
                own, address = _for_both_families(), ("", port)
        except OSError as error:
            raise TransportError(f"cannot use udp://{host}:{port}: {error.strerror}") from error
        try:
            own.bind(address)
        except OSError as error:
            own.close()
            raise TransportError(f"cannot bind udp://{host}:{port}: {error.strerror}") from error
        return cls(own, clock)

    @classmethod
    def unbound(cls, clock: Clock) -> "DatagramSocket":
        """A coupling's socket, on any port.

        Raises:
            TransportError: the system gives none.
        """
        try:
            return cls(_for_both_families(), clock)
        except OSError as error:
            raise TransportError(f"cannot open a UDP socket: {error.strerror}") from error

    @property
    def port(self) -> int:
        """The UDP port; 0 before a socket that is not bound has sent anything."""
        return int(self._socket.getsockname()[1])

    def fileno(self) -> int:
        """The descriptor, which is readable while there are datagrams; for a poller, beside the links' sockets."""
        return self._socket.fileno()

    def offer(self, link: Link, width: int, period: Duration | None = None) -> "DatagramPath":
        """The environment's end of a new path, whose key is for the coupling at the other end of ``link`` alone.

        Args:
            link: the encrypted link between the two, which carries the waves that no datagram carries.
            width: the number of ports of the link.
            period: T of the coupling, ns; None where its ticks take no time that a clock shows.

        Raises:
            TransportError: the link has more ports than a datagram, or the socket is closed.
        """
        connection = secrets.token_bytes(CONNECTION_BYTES)
        while connection in self._paths:
            connection = secrets.token_bytes(CONNECTION_BYTES)
        key = PathKey(connection, secrets.token_bytes(SECRET_BYTES), self.port)
        return self._path(key, Direction.TO_COUPLING, link, width, period, ())

    def take_up(
        self, key: PathKey, host: str, link: Link, width: int, period: Duration | None = None
    ) -> "DatagramPath":
        """The coupling's end of a path that the environment has offered.

        Args:
            key: the environment's, received over ``link``.
            host: the name or the address at which this process has reached the environment. A name is looked up here,
                which may take a while: not in a tick.
            link: as for :meth:`offer`.
            width: as for :meth:`offer`.
            period: T of the environment, ns; None where its ticks take no time that a clock shows.

        Raises:
            TransportError: the host is not known, or as for :meth:`offer`.
        """
        family = self._socket.family
        both = socket.AI_V4MAPPED | socket.AI_ALL if family is socket.AF_INET6 else 0
        try:
            found = socket.getaddrinfo(host, key.port, family, socket.SOCK_DGRAM, flags=both)
        except OSError as error:
            raise TransportError(f"cannot look up {host!r:.300}: {error.strerror}") from error
        addresses = tuple(dict.fromkeys(address for *_, address in found))
        return self._path(key, Direction.TO_ENVIRONMENT, link, width, period, addresses)

    def read(self) -> None:
        """Read what has come, a bounded number, and hand it to the paths; once a tick, or when there is something."""
        now = self._clock.now()
        for _ in range(_READ_AT_ONCE + 4 * len(self._paths)):
            try:
                datagram, source = self._socket.recvfrom(MAX_DATAGRAM_BYTES + 1)
            except (BlockingIOError, InterruptedError):
                return
            except OSError as error:
                if self._socket.fileno() < 0:
                    raise TransportError("cannot receive datagrams: the socket is closed") from error
                return  # the system reports a datagram that it could not deliver
            connection = connection_of(datagram)
            path = None if connection is None else self._paths.get(connection)
            if path is not None:
                path._arrived(datagram, source, now)
            else:
                self.refused[NotOpened.NO_DATAGRAM if connection is None else NotOpened.UNKNOWN_PATH] += 1

    def dropped_by_kernel(self) -> int:
        """Datagrams that did not reach the process: of strangers, or beyond what the kernel keeps for it."""
        try:
            counts = self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * (_DROPS + 1))
        except OSError:  # before Linux 4.12
            return 0
        return int(struct.unpack(f"={_DROPS + 1}I", counts)[_DROPS])

    def close(self) -> None:
        """Close the socket and all its paths. A second call does nothing."""
        self._paths.clear()
        self._socket.close()

    def _path(
        self, key: PathKey, sends: Direction, link: Link, width: int, period: Duration | None, to: Sequence[Address]
    ) -> "DatagramPath":
        if width > MOST_PORTS:
            raise TransportError(f"found a link of {width} ports; expected at most {MOST_PORTS} for datagrams")
        if self._socket.fileno() < 0:
            raise TransportError("cannot open a path: the socket is closed")
        end = PathEnd(key, sends, self._clock.now())
        path = DatagramPath(self, key, end, link, WaveGate(width, period, self._clock), WaveWriter(width), to)
        self._paths[key.connection] = path
        self._filter()
        return path

    def _send(self, datagram: bytes, address: Address) -> None:
        try:
            self._socket.sendto(datagram, address)
        except OSError as error:
            if self._socket.fileno() < 0:
                raise TransportError("cannot send a datagram: the socket is closed") from error
            self.unsent += 1

    def _forget(self, connection: bytes) -> None:
        if self._paths.pop(connection, None) is not None and self._socket.fileno() >= 0:
            self._filter()

    def _filter(self) -> None:
        """Have the kernel drop what names no path; where it does not permit that, :meth:`read` does."""
        program = filter_of(self._paths)
        code = ctypes.create_string_buffer(program, len(program))
        with suppress(OSError):
            argument = struct.pack("@HP", len(program) // _INSTRUCTION.size, ctypes.addressof(code))
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, argument)


class DatagramPath:
    """One end of the path of a wave link, in one life of the link.

    The loop of either process calls :meth:`receive` in each of its ticks, and :meth:`send` where it has a wave to send.
    It hands every frame that comes over the ZeroMQ link to :meth:`take`, which returns whether the frame was a wave.

    Attributes:
        key: of this life. The environment sends it to the coupling over their link.
        gate: admits the waves, whatever carries them, and counts the others.
        end: seals and opens the datagrams, and counts those that it refuses.
        undelivered: waves that the ZeroMQ link was to carry and did not take.
    """

    def __init__(
        self,
        datagrams: DatagramSocket,
        key: PathKey,
        end: PathEnd,
        link: Link,
        gate: WaveGate,
        writer: WaveWriter,
        addresses: Sequence[Address],
    ) -> None:
        """As :meth:`DatagramSocket.offer` and :meth:`DatagramSocket.take_up` make it."""
        self.key, self.end, self.gate = key, end, gate
        self.undelivered = 0
        self._datagrams, self._link, self._writer = datagrams, link, writer
        self._candidates = addresses  # none at the environment, which learns the address
        self._to = addresses[0] if addresses else None  # a coupling's, among these
        self._replies = None if addresses else Replies()
        self._probed = 0
        self._new: Wave | None = None

    @property
    def state(self) -> PathState:
        """The state of the path."""
        return self.end.state(self._datagrams._clock.now())

    @property
    def address(self) -> Address | None:
        """Where its datagrams go, as far as they may; None while the environment has learnt none."""
        return self._to if self._replies is None else self._replies.address

    def fileno(self) -> int:
        """The descriptor of the socket; see :meth:`DatagramSocket.fileno`."""
        return self._datagrams.fileno()

    def send(self, wave: Wave) -> bool:
        """Send a wave, and return at once; False if the ZeroMQ link was to carry it and did not take it.

        Raises:
            ValueError: the wave's tick is not above that of the wave before, or the protocol does not allow a field.
            TransportError: the socket or the link is closed.
        """
        frame = self._writer.frame(wave.tick, wave.sums, wave.shipped, wave.buttons)
        now = self._datagrams._clock.now()
        replies = self._replies
        token = self.end.token if replies is None else replies.token
        datagram, over_link = self.end.outgoing(wave.tick, frame, now, token)
        if replies is not None:
            over_link = over_link or not replies.certain
        if datagram is not None:
            to = self._to if replies is None else replies.departs(len(datagram))
            if to is not None:
                self._datagrams._send(datagram, to)
            if over_link and self._candidates and self.end.state(now) is PathState.DOWN:
                self._probed += 1
                self._to = self._candidates[self._probed % len(self._candidates)]
        if over_link and not self._link.send(frame):
            self.undelivered += 1
            return False
        return True

    def receive(self) -> Wave | None:
        """The newest wave, if it is newer than at the last call; None otherwise. Never blocks.

        At a coupling this reads the socket. At the environment, whose paths share one, the loop calls
        :meth:`DatagramSocket.read` before.
        """
        if self._candidates:
            self._datagrams.read()
            repeated = self.end.repeated(self._datagrams._clock.now())
            if repeated is not None and self._to is not None:
                self._datagrams._send(repeated, self._to)
        wave, self._new = self._new, None
        return wave

    def take(self, frame: bytes) -> bool:
        """Take a frame that came over the ZeroMQ link; returns whether it was a wave, be it admitted or not."""
        if type_of(frame) != WAVE_ID:
            return False
        self._new = self.gate.admitted(frame) or self._new
        return True

    def close(self) -> None:
        """End the path, so that nothing opens any more; the socket stays open. A second call does nothing."""
        self._datagrams._forget(self.key.connection)

    def _arrived(self, datagram: bytes, source: Address, now: Instant) -> None:
        frame = self.end.opens(datagram, now)
        if frame is None:
            return
        if self._replies is not None:
            self._replies.arrived(source, len(datagram), self.end.token)
        elif source in self._candidates:
            self._to = source
        self._new = self.gate.admitted(frame) or self._new


def _for_both_families() -> socket.socket:
    """A UDP socket for IPv6 and IPv4, or for IPv4 alone where the system has no IPv6."""
    try:
        own = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)
    except OSError:
        return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    own.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
    return own


def _never_fragment(own: socket.socket) -> None:
    """Set DF, and believe no report on a path's MTU, for such a report is not authentic."""
    own.setsockopt(socket.IPPROTO_IP, _IP_MTU_DISCOVER, _PMTUDISC_PROBE)
    if own.family is socket.AF_INET6:
        own.setsockopt(socket.IPPROTO_IPV6, _IPV6_MTU_DISCOVER, _PMTUDISC_PROBE)


def filter_of(connections: Collection[bytes]) -> bytes:
    """The classic BPF program that accepts the UDP packets that name one of ``connections``, and no other.

    A socket filter sees a packet from its UDP header on, which has 8 bytes; a load beyond the packet's end drops it.
    """
    program = []
    for connection in list(connections)[:_MOST_FILTERED]:
        high, low = struct.unpack(">II", connection)
        program += [
            (_LOAD, 0, 0, _CONNECTION_AT),
            (_JUMP_IF_EQUAL, 0, 3, high),
            (_LOAD, 0, 0, _CONNECTION_AT + 4),
            (_JUMP_IF_EQUAL, 0, 1, low),
            (_RETURN, 0, 0, 0xFFFF),
        ]
    everything = 0xFFFF if len(connections) > _MOST_FILTERED else 0  # too many: the process looks for itself
    return b"".join(_INSTRUCTION.pack(*one) for one in [*program, (_RETURN, 0, 0, everything)])


_INSTRUCTION: Final = struct.Struct("=HBBI")  # struct sock_filter: code, jump if true, jump if false, operand
_LOAD: Final = 0x20  # BPF_LD | BPF_W | BPF_ABS
_JUMP_IF_EQUAL: Final = 0x15  # BPF_JMP | BPF_JEQ | BPF_K
_RETURN: Final = 0x06  # BPF_RET | BPF_K
_CONNECTION_AT: Final = 8 + 1
_MOST_FILTERED: Final = 800  # of 5 instructions each; the kernel takes 4096

_SO_ATTACH_FILTER: Final = 26  # asm-generic/socket.h
_SO_MEMINFO: Final = 55
_DROPS: Final = 8  # SK_MEMINFO_DROPS, linux/sock_diag.h
_IP_MTU_DISCOVER: Final = 10  # linux/in.h
_IPV6_MTU_DISCOVER: Final = 23  # linux/in6.h
_PMTUDISC_PROBE: Final = 3
