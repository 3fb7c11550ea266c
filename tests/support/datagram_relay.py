"""What stands between the two ends of a datagram path: a translator of addresses, and whoever is on the wire.

Everything happens in :meth:`Relay.pump`, so a test decides when. On the loopback a datagram that was sent is there.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable
from typing import Any

Act = Callable[[bytes], Iterable[bytes]]


def passed(datagram: bytes) -> Iterable[bytes]:
    return (datagram,)


def lost(_datagram: bytes) -> Iterable[bytes]:
    return ()


class Relay:
    """Passes datagrams on between a coupling and an environment, or what it makes of them.

    Attributes:
        up: what reaches the environment of a datagram of the coupling.
        down: what reaches the coupling of one of the environment.
        seen: every datagram of the coupling and of the environment so far.
    """

    def __init__(self, port: int) -> None:
        """Stand before the environment's ``port`` of the loopback."""
        self._server = ("127.0.0.1", port)
        self._inner, self._outer = _bound(), _bound()
        self._client: Any = None
        self.up: Act = passed
        self.down: Act = passed
        self.seen: tuple[list[bytes], list[bytes]] = ([], [])

    @property
    def port(self) -> int:
        """Where the coupling finds it."""
        return int(self._inner.getsockname()[1])

    @property
    def address(self) -> tuple[str, int]:
        """Where the environment finds it."""
        host, port = self._outer.getsockname()
        return host, port

    def pump(self) -> None:
        """Pass on what has come."""
        for datagram, source in _read(self._inner):
            self._client = source
            self.seen[0].append(datagram)
            for one in self.up(datagram):
                self._outer.sendto(one, self._server)
        for datagram, _ in _read(self._outer):
            self.seen[1].append(datagram)
            for one in self.down(datagram):
                self._inner.sendto(one, self._client)

    def insert(self, datagram: bytes) -> None:
        """Send a datagram to the coupling, from where it has the environment's."""
        self._inner.sendto(datagram, self._client)

    def rebind(self) -> None:
        """Forget the address that the environment knows, as a translator does, and take a new one."""
        new = _bound()  # before the old one is closed, whose port it might have again
        self._outer.close()
        self._outer = new

    def close(self) -> None:
        self._inner.close()
        self._outer.close()


def _bound() -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.bind(("127.0.0.1", 0))
    one.setblocking(False)
    return one


def _read(one: socket.socket) -> Iterable[tuple[bytes, Any]]:
    while True:
        try:
            yield one.recvfrom(65536)
        except BlockingIOError:
            return
