"""A cable between two processes: TCP connections go through it, and it can be cut and mended."""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import threading
from typing import Final

_HOST: Final = "127.0.0.1"
_CHUNK: Final = 65536


class Cable:
    """Forwards the connections to one endpoint, in a thread of its own.

    Attributes:
        endpoint: where to connect to instead.
        carried: connections that were carried so far.
    """

    def __init__(self, endpoint: str) -> None:
        """Forward connections to ``endpoint``, ``tcp://HOST:PORT``."""
        host, _, port = endpoint.removeprefix("tcp://").rpartition(":")
        self._target = (host, int(port))
        self._port = 0  # any, at first
        self._listener = self._listen()
        self._port = self._listener.getsockname()[1]
        self.endpoint, self.carried = f"tcp://{_HOST}:{self._port}", 0
        self._whole = True
        self._wake, self._bell = os.pipe()
        self._selector = selectors.DefaultSelector()
        self._other: dict[socket.socket, socket.socket] = {}
        self._thread = threading.Thread(target=self._run, name="cable")
        self._thread.start()

    def cut(self) -> None:
        """From now on no byte passes, and no process can connect."""
        self._ring(b"c")

    def mend(self) -> None:
        """From now on connections are possible again, at the same endpoint."""
        self._ring(b"m")

    def remove(self) -> None:
        """Take the cable away."""
        self._ring(b"r")
        self._thread.join()
        os.close(self._wake)
        os.close(self._bell)

    def _ring(self, what: bytes) -> None:
        os.write(self._bell, what)

    def _listen(self) -> socket.socket:
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((_HOST, self._port))
        listener.listen()
        return listener

    def _run(self) -> None:
        self._selector.register(self._wake, selectors.EVENT_READ)
        self._selector.register(self._listener, selectors.EVENT_READ)
        while True:
            for key, _ in self._selector.select():
                if key.fd == self._wake:
                    if self._obey(os.read(self._wake, 1)):
                        return
                    break  # what else was ready may be closed
                if key.fileobj is self._listener:
                    self._accept()
                elif isinstance(key.fileobj, socket.socket) and key.fileobj in self._other:
                    self._forward(key.fileobj)

    def _obey(self, what: bytes) -> bool:
        if what == b"m":
            self._listener = self._listen()
            self._selector.register(self._listener, selectors.EVENT_READ)
            self._whole = True
            return False
        for end in list(self._other):
            self._drop(end)
        if self._whole:
            self._selector.unregister(self._listener)
            self._listener.close()
            self._whole = False
        if what == b"r":
            self._selector.close()
        return what == b"r"

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        try:
            far = socket.create_connection(self._target)
        except OSError:  # no listener is there; the connecting side sees it
            near.close()
            return
        self.carried += 1
        for one, other in ((near, far), (far, near)):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._other[one] = other
            self._selector.register(one, selectors.EVENT_READ)

    def _forward(self, end: socket.socket) -> None:
        data = b""
        with contextlib.suppress(OSError):  # the connection is over, in whichever way
            data = end.recv(_CHUNK)
            self._other[end].sendall(data)
        if not data:
            self._drop(end)

    def _drop(self, end: socket.socket) -> None:
        other = self._other.pop(end, None)
        if other is None:
            return
        self._other.pop(other, None)
        for one in (end, other):
            self._selector.unregister(one)
            one.close()
