"""One listening socket: who came, what became of them, and the filter that shuts it before a crowd.

ZeroMQ's monitor tells what happens at a socket, from a thread of its own. A packet filter on the listening socket lets
the kernel drop whoever knocks, which costs the process nothing and leaves the connections that exist alone (ZeroMQ's
own ``unbind`` would end them).
"""

import ctypes
import socket as sockets
import struct
from enum import StrEnum
from typing import Final

import zmq

from manyhands.protocol.limits import DOOR_BURST, DOOR_FAILURES, DOOR_SHUT_MS
from manyhands.protocol.transport.monitor import close_monitor, monitor_of


class Refused(StrEnum):
    """Why a connection was not admitted."""

    NO_KEY = "no_key"  # another security mechanism, none at all most likely
    NOT_PROVED = "not_proved"  # does not hold the secret of the key it shows, or took us for somebody else
    UNKNOWN_KEY = "unknown_key"  # the key of nobody this process has to do with
    WRONG_KEY = "wrong_key"  # known, but this socket is for somebody else
    SECOND_PEER = "second_peer"  # the right key, on a link whose peer is there already
    UNFINISHED = "unfinished"  # opened, and no handshake came of it (or none yet)
    SHUT = "shut"  # times that a door was shut because too many crowded before it


class Door:
    """One listening socket: what its monitor tells, and the filter that shuts it."""

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
    _EVENTS_AT_ONCE: Final = 2 * DOOR_BURST  # counted at one look, a few us each; the rest at the next
    _WINDOW: Final = 100_000_000  # ns, in which DOOR_BURST counts
    _FAILURES_WINDOW: Final = 1_000_000_000  # ns, in which DOOR_FAILURES counts
    _ROOM: Final = 4 * DOOR_BURST  # connections open at a time, which are file descriptors of this process

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
        """Somebody was not admitted; who leaves before the answer is never told of by the monitor."""
        self._failed += 1

    def look(self, now: int) -> None:
        """Count what happened, as much as a look allows for; shut the door if that was too much, or open it again."""
        if now - self._window >= self._WINDOW:
            self._window, self._came = now, 0
        if now - self._failures_window >= self._FAILURES_WINDOW:
            self._failures_window, self._failed = now, 0
        told_all = self._listen_to_monitor()
        if self.shut_until is None:
            crowd = self._came > DOOR_BURST + self._admits  # all who belong here may come at once
            crowd |= self._failed > DOOR_FAILURES  # none of whom fails
            if (crowd or self._is_full()) and self._filter(True):
                self.shut += 1
                self.shut_until = now + DOOR_SHUT_MS * 1_000_000
        elif now >= self.shut_until and told_all and not self._is_full():  # else what was not read would pile up
            self._filter(False)
            self.shut_until = None
            self._window, self._came = now, 0
            self._failures_window, self._failed = now, 0

    def _listen_to_monitor(self) -> bool:
        """Whether that was all it has to tell."""
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
                self.not_admitted += 1  # why, the answer to ZeroMQ's question has counted
            case zmq.EVENT_DISCONNECTED:
                self._open.pop(value, None)

    def _establish(self) -> None:
        """A handshake succeeded: whose, ZeroMQ does not say; most likely that of who came last."""
        if self._admits == 1 and any(self._open.values()):
            self.second += 1
        for descriptor, established in reversed(self._open.items()):
            if not established:
                self._open[descriptor] = True
                return

    def refused(self) -> dict[Refused, int]:
        """Connections that did not come about, by reason; those refused by key are counted elsewhere."""
        unfinished = self.accepted - self.succeeded - self.no_key - self.not_proved - self.not_admitted
        return {
            Refused.NO_KEY: self.no_key,
            Refused.NOT_PROVED: self.not_proved,
            Refused.SECOND_PEER: self.second,
            Refused.UNFINISHED: max(0, unfinished),
            Refused.SHUT: self.shut,
        }

    def _filter(self, drop_all: bool) -> bool:
        """Have the kernel drop every packet to the listening socket, or none; whether it does as asked.

        No descriptor is needed for it: a crowd may have used them all up.
        """
        if self._listener is None or self.socket.closed:  # its number may be another's by now
            return False
        program = ctypes.create_string_buffer(struct.pack("=HBBI", 0x06, 0, 0, 0))  # BPF: return 0, that is nothing
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
        except OSError:  # not permitted here: the door stays as it is
            return False
        finally:
            listener.detach()  # it is ZeroMQ's
        return True

    def close(self) -> None:
        """Stop watching; the socket itself is its owner's to close."""
        close_monitor(self.socket, self.monitor)


_SO_ATTACH_FILTER: Final = 26  # asm-generic/socket.h
_SO_DETACH_FILTER: Final = 27
