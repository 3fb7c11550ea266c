"""Properties of the in-memory transport alone: no descriptor stays open, and a second peer is an error."""

import os

import pytest

from manyhands.protocol.transport import TransportError
from tests.support.memory_transport import MemoryTransport


def test_closing_leaves_no_descriptor() -> None:
    before = os.listdir("/proc/self/fd")
    transport = MemoryTransport()
    _, endpoint = transport.bind("cx", "dx")
    _, hub_endpoint = transport.bind_hub("supervisor", ("dx", "dy"))
    transport.connect(endpoint, "supervisor")
    transport.join(hub_endpoint, "dx")
    assert len(os.listdir("/proc/self/fd")) > len(before)
    transport.close()
    assert os.listdir("/proc/self/fd") == before


def test_a_second_peer_is_an_error() -> None:
    transport = MemoryTransport()
    try:
        _, endpoint = transport.bind("cx", "dx")
        transport.connect(endpoint, "supervisor")
        with pytest.raises(TransportError, match="already; expected it once"):
            transport.connect(endpoint, "supervisor")
        with pytest.raises(TransportError, match="expected one that was bound here"):
            transport.connect("memory://cy", "supervisor")
    finally:
        transport.close()
