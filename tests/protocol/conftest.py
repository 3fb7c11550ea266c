"""Both ends of each transport, as two processes would hold them; everything is closed when a test ends."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from manyhands.protocol.transport import Transport
from manyhands.protocol.transport.memory import MemoryTransport
from manyhands.protocol.transport.zeromq import ZmqTransport


@dataclass(frozen=True)
class Ends:
    """The transport of the process that binds, and of the one that connects."""

    binder: Transport
    connector: Transport
    scheme: str

    def close_binder(self) -> None:
        """End the binding process's transport, where that is not the other's too."""
        if self.binder is not self.connector:
            self.binder.close()

    def close_connector(self) -> None:
        """End the connecting process's transport, where that is not the other's too."""
        if self.binder is not self.connector:
            self.connector.close()


@pytest.fixture(params=["memory", "ipc", "tcp"])
def ends(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Ends]:
    if request.param == "memory":
        shared = MemoryTransport()
        both = Ends(shared, shared, "memory")
    elif request.param == "ipc":
        both = Ends(ZmqTransport.ipc(tmp_path), ZmqTransport.ipc(tmp_path), "ipc")
    else:
        both = Ends(ZmqTransport.tcp(), ZmqTransport.tcp(), "tcp")
    yield both
    both.connector.close()
    both.binder.close()
