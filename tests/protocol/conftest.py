"""Both ends of each transport, held as two processes would hold them; every test closes all of them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from manyhands.protocol.keys import KeyRing, new_pair
from manyhands.protocol.transport import Link, Transport
from manyhands.protocol.transport.zeromq import ZmqTransport
from tests.support.memory_transport import MemoryTransport

NODES = ("cx", "dx", "dy")
PAIRS = {name: new_pair() for name in ("supervisor", *NODES)}


def ring(name: str) -> KeyRing:
    """All keys in the hands of one."""
    return KeyRing(name, PAIRS[name], {other: pair.public for other, pair in PAIRS.items() if other != name})


@dataclass(frozen=True)
class Ends:
    """The transport of the process that binds, and of the one that connects, which is called dx."""

    binder: Transport
    connector: Transport
    scheme: str
    process: Callable[[str], Transport]
    others: list[Transport] = field(default_factory=list)

    def join(self, endpoint: str, name: str) -> Link:
        """Join a hub as a process of this name."""
        if self.binder is self.connector or name == "dx":
            return self.connector.join(endpoint, name)
        self.others.append(self.process(name))
        return self.others[-1].join(endpoint, name)

    def close_binder(self) -> None:
        """End the binding process's transport, where that is not the other's too."""
        if self.binder is not self.connector:
            self.binder.close()

    def close_connector(self) -> None:
        """End the connecting process's transport, where that is not the other's too."""
        if self.binder is not self.connector:
            self.connector.close()

    def close(self) -> None:
        """End them all."""
        for transport in (*self.others, self.connector, self.binder):
            transport.close()


@pytest.fixture(params=["memory", "ipc", "tcp", "tcp with keys", "ipc beside tcp with keys"])
def ends(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Ends]:
    process: Callable[[str], Transport]
    if request.param == "memory":
        shared = MemoryTransport()
        process = lambda _name: shared  # noqa: E731
    elif request.param == "ipc":
        process = lambda _name: ZmqTransport.ipc(tmp_path)  # noqa: E731
    elif request.param == "tcp":
        process = lambda _name: ZmqTransport.tcp()  # noqa: E731
    elif request.param == "tcp with keys":
        process = lambda name: ZmqTransport.tcp(ring(name))  # noqa: E731
    else:
        process = lambda name: ZmqTransport.tcp(ring(name), tmp_path)  # noqa: E731
    both = Ends(process("supervisor"), process("dx"), request.param, process)
    yield both
    both.close()
