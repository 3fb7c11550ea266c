"""Who may connect to a process: its keys at work on its sockets, and what became of those who tried.

Every listening socket has a ZAP domain of its own, to which the keys of those it is meant for are bound; ZeroMQ asks
before it lets a connection exist (RFC 27, CURVE of RFC 26). There is no thread for the answers: a second Python thread
would compete with the loop for the interpreter. They are given while the process waits for its peers, and once the
loop runs in its slack, a bounded number at a time (:meth:`Doorkeeper.attend`); nobody who is already connected waits
for them.
"""

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

import zmq
from zmq.utils import z85

from manyhands.protocol.keys import KeyRing
from manyhands.protocol.limits import HANDSHAKE_MS
from manyhands.protocol.transport.descriptors import allow_descriptors
from manyhands.protocol.transport.door import Door, Refused

_VERSION: Final = b"1.0"
_LEAST_FRAMES: Final = 6  # version, request id, domain, address, identity, mechanism; then the credentials


def judge(
    request: Sequence[bytes], admits: Mapping[bytes, Mapping[bytes, str]], known: Collection[bytes]
) -> tuple[list[bytes], Refused | None]:
    """The answer to a ZAP request, and why it was refused, if it was.

    Args:
        request: the frames that ZeroMQ asks with.
        admits: by domain, the public keys (32 bytes) that may connect, and their names.
        known: every public key that this process knows.

    Returns:
        The reply's frames, with the name as user id if the connection may exist.
    """
    if len(request) != _LEAST_FRAMES + 1 or request[0] != _VERSION or request[5] != b"CURVE":
        number = request[1] if len(request) > 1 else b""
        return [_VERSION, number, b"400", b"no CURVE key", b"", b""], Refused.NO_KEY
    _, number, domain, _, _, _, key = request
    name = admits.get(domain, {}).get(key)
    if name is not None:
        return [_VERSION, number, b"200", b"OK", name.encode("ascii"), b""], None
    return [_VERSION, number, b"400", b"not admitted", b"", b""], (
        Refused.WRONG_KEY if key in known else Refused.UNKNOWN_KEY
    )


class Doorkeeper:
    """Guards the sockets of one context with one process's keys.

    Attributes:
        settled: whether the process has its peers, and answers only when it calls :meth:`attend`.
    """

    _ANSWERS: Final = 32  # at one look
    _LOOK_MS: Final = 100  # between two looks while a door is shut

    def __init__(
        self, context: "zmq.Context[zmq.Socket[bytes]]", ring: KeyRing, now: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """To be made before any socket of ``context`` is bound; ``now``: monotonic ns."""
        self._ring, self._now = ring, now
        allow_descriptors()  # once they are used up, ZeroMQ's thread only spins
        self._keys = {z85.decode(public.encode("ascii")): name for name, public in ring.peers.items()}
        self._admits: dict[bytes, Mapping[bytes, str]] = {}
        self._doors: list[Door] = []
        self._by_domain: dict[bytes, Door] = {}
        self._refused = dict.fromkeys(Refused, 0)
        self._desk = context.socket(zmq.REP)
        self._desk.bind("inproc://zeromq.zap.01")
        self.settled = False

    def guard(self, socket: "zmq.Socket[bytes]", domain: str, admits: Collection[str]) -> None:
        """Make ``socket``, which is to be bound, one that only the holders of some keys can connect to.

        Args:
            socket: not yet bound.
            domain: a name of its own.
            admits: names of those who may connect; a single one once at a time.

        Raises:
            KeyError: the ring has no key of one of them.
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
        """Guard a socket no longer that is about to be closed for good; what was counted at it stays counted."""
        for domain, door in tuple(self._by_domain.items()):
            if door.socket is socket:
                door.look(self._now())
                for kind, count in door.refused().items():
                    self._refused[kind] += count
                door.close()
                self._doors.remove(door)
                del self._by_domain[domain], self._admits[domain]

    def introduce(self, socket: "zmq.Socket[bytes]", peer: str) -> None:
        """Make ``socket``, which is to be connected, prove our key and ask for ``peer``'s.

        Raises:
            KeyError: the ring has no key of ``peer``.
        """
        socket.setsockopt(zmq.CURVE_SERVERKEY, self._ring.peers[peer].encode("ascii"))
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self._ring.pair.public.encode("ascii"))
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._ring.pair.secret.encode("ascii"))

    @property
    def knocking(self) -> "list[zmq.Socket[bytes]]":
        """Sockets that become readable when there is something to attend to."""
        return [self._desk, *(door.monitor for door in self._doors)]

    @property
    def shut(self) -> bool:
        """Whether a door is shut, and waits for :meth:`attend` to open it again."""
        return any(door.shut_until is not None for door in self._doors)

    def at_most(self, wait_ms: int) -> int:
        """As much of a wait (ms, -1 for ever) as may pass before the next :meth:`attend`."""
        if not self.shut:
            return wait_ms
        return self._LOOK_MS if wait_ms < 0 else min(wait_ms, self._LOOK_MS)

    def attend(self) -> None:
        """Answer those who ask to be let in and count what became of others, a bounded number of both."""
        if self._desk.closed:  # and so is every door
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
        """Connections not admitted so far, by :class:`Refused`; reasons that never occurred are absent."""
        if not self._desk.closed:
            self._look()  # one that has come about since the last look is not unfinished any more
        total = dict(self._refused)
        for door in self._doors:
            for kind, count in door.refused().items():
                total[kind] += count
        return {kind.value: count for kind, count in total.items() if count > 0}

    def close(self) -> None:
        """Stop watching; to be called while the guarded sockets are still open, or after they were closed."""
        for door in self._doors:
            door.close()
        self._desk.close(linger=0)
