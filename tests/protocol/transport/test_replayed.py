"""A recording of a keyed connection is useless to an attacker: at once, and after a restart."""

from __future__ import annotations

import selectors
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest

from manyhands.protocol.clock import Duration
from manyhands.protocol.keys import KeyRing, new_pair
from manyhands.protocol.transport.zeromq import ZmqTransport

SUPERVISOR, DX = new_pair(), new_pair()
MS = 1_000_000
SAID = [b"push", b"pull", b"let go"]


class Tap:
    """A relay between one client and its server that keeps what the client sends, piece by piece.

    Attributes:
        address: where the client connects to.
        pieces: what it has sent.
    """

    def __init__(self, server: int) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listening.getsockname()[1]}"
        self.pieces: list[bytes] = []
        self._server = server
        self._over, self._end = socket.socketpair()
        self._thread = threading.Thread(target=self._relay, name="tap")
        self._thread.start()

    def again(self) -> None:
        """Send the server the client's last piece once more, on the client's own connection."""
        self._over.send(b"a")
        assert self._over.recv(1) == b"a"

    def close(self) -> None:
        self._over.close()
        self._thread.join()
        self._end.close()
        self._listening.close()

    def _relay(self) -> None:
        client, _ = self._listening.accept()
        with (
            client,
            socket.create_connection(("127.0.0.1", self._server)) as server,
            selectors.DefaultSelector() as who,
        ):
            for one in (client, server, self._end):
                who.register(one, selectors.EVENT_READ)
            while True:
                for key, _ in who.select():
                    try:
                        data = key.fileobj.recv(65536)  # type: ignore[union-attr]  # sockets, all of them
                    except ConnectionError:
                        data = b""
                    if key.fileobj is self._end:
                        if not data:
                            return
                        server.sendall(self.pieces[-1])
                        self._end.send(data)
                    elif not data:  # either has gone, and so has the other
                        who.unregister(key.fileobj)
                        for one in (client, server):
                            with suppress(OSError):
                                one.shutdown(socket.SHUT_RDWR)
                    elif key.fileobj is client:
                        self.pieces.append(data)
                        server.sendall(data)
                    else:
                        client.sendall(data)


def supervisor(stack: ExitStack) -> ZmqTransport:
    made = ZmqTransport.tcp(KeyRing("supervisor", SUPERVISOR, {"dx": DX.public}))
    stack.callback(made.close)
    return made


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as made:
        yield made


def port_of(endpoint: str) -> int:
    return int(endpoint.rpartition(":")[2])


def test_recorded_bytes_open_no_connection_and_repeated_ones_end_theirs(stack: ExitStack) -> None:
    first, restarted = supervisor(stack), supervisor(stack)  # the same keys: a supervisor that was started again
    hub, endpoint = first.bind_hub("control", ["dx"])
    again, restarted_at = restarted.bind_hub("control", ["dx"])
    tap = Tap(port_of(endpoint))
    stack.callback(tap.close)
    node = ZmqTransport.tcp(KeyRing("dx", DX, {"supervisor": SUPERVISOR.public}))
    stack.callback(node.close)
    line = node.join(f"tcp://{tap.address}", "dx")
    for frame in SAID:
        assert line.send(frame)
        while (heard := hub.recv()) is None:
            hub.wait(Duration(5 * MS))
        assert heard == ("dx", frame)

    for transport, listening, place in ((first, hub, endpoint), (restarted, again, restarted_at)):
        with socket.create_connection(("127.0.0.1", port_of(place))) as thief:
            for piece in tap.pieces:
                try:
                    thief.sendall(piece)
                except ConnectionError:  # the door is shut in its face
                    break
            while not transport.refused().keys() & {"no_key", "not_proved"}:  # its cookie is of another connection
                listening.wait(Duration(5 * MS))
        assert listening.recv() is None
        assert sum(transport.refused().values()) == 1

    assert line.trouble() is None
    tap.again()
    while line.trouble() is None:
        hub.wait(Duration(5 * MS))  # the connection ends, for its nonces never come twice
    assert hub.recv() is None
