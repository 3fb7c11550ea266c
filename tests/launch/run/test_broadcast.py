"""An observer receives the part of each node's telemetry that its session lists, bit for bit, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.plan.reach import IPC
from manyhands.launch.plan.topology import topology
from manyhands.launch.run.broadcast import ObserverBroadcast, visible
from manyhands.launch.session import Session, load_session
from manyhands.protocol.clock import Duration
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Figures, Observation, Telemetry
from tests.support.memory_transport import MemoryTransport

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
X, F, P = (np.arange(4.0).reshape(4, 1) + offset for offset in (0.0, 10.0, 20.0))
OF_DEVICE = Telemetry(7, Figures({"speed": 0.5, "late": 1.0}), {"x": X, "f_v": F})
OF_COUPLING = Telemetry(8, Figures({"ledger": 0.1}), {"p": P, "f_v": F})


def session(observers: str) -> Session:
    return load_session(SESSIONS / "example1.yaml", [f"observers={observers}"])


@pytest.mark.parametrize(
    ("telemetry", "channels", "figures", "traces"),
    [
        (OF_DEVICE, ("telemetry",), OF_DEVICE.figures, {}),
        (OF_DEVICE, ("sample",), Figures(), {"x": X}),
        (OF_DEVICE, ("force",), Figures(), {"f_v": F}),
        (OF_DEVICE, ("sample", "force", "telemetry"), OF_DEVICE.figures, {"x": X, "f_v": F}),
        (OF_COUPLING, ("tool",), Figures(), {"p": P}),
        (OF_COUPLING, ("reaction",), Figures(), {"f_v": F}),
    ],
)
def test_only_what_may_be_read_is_visible(
    telemetry: Telemetry, channels: tuple[str, ...], figures: Figures, traces: dict[str, np.ndarray]
) -> None:
    assert visible("n", telemetry, channels) == Observation("n", telemetry.tick, figures, traces)


def test_nothing_is_sent_where_nothing_may_be_read() -> None:
    assert visible("dx", OF_DEVICE, ()) is None
    assert visible("dx", Telemetry(1, Figures({"speed": 0.5}), {}), ("sample",)) is None


def test_each_observer_gets_its_own_topics_and_strangers_get_nothing() -> None:
    told = session("{watch: {reads: [telemetry]}, scope: {reads: [dx/sample]}, other: {reads: [dy/telemetry]}}")
    observer_broadcast, transport = ObserverBroadcast(told), MemoryTransport()
    endpoints = observer_broadcast.serve(transport, IPC, topology(told))
    links = {name: transport.connect_outlet(endpoint, "supervisor") for name, endpoint in endpoints.items()}
    observer_broadcast.send("dx", OF_DEVICE)
    heard = {name: link.recv(Duration(0)) for name, link in links.items()}
    transport.close()
    assert heard.pop("other") is None
    assert {name: decode(frame or b"", MAX_CONTROL_BYTES) for name, frame in heard.items()} == {
        "watch": Observation("dx", 7, OF_DEVICE.figures, {}),
        "scope": Observation("dx", 7, Figures(), {"x": X}),
    }


def test_nobody_waits_for_an_observer_that_is_not_there() -> None:
    told = session("{watch: {reads: [telemetry]}}")
    observer_broadcast, transport = ObserverBroadcast(told), MemoryTransport()
    observer_broadcast.serve(transport, IPC, topology(told))
    for _ in range(3):
        observer_broadcast.send("dx", OF_DEVICE)
    transport.close()
    assert observer_broadcast.missed == 3


def test_telemetry_that_fills_a_frame_is_missed_and_ends_nothing() -> None:
    """An observation is longer by its node's name: a node could otherwise send what the supervisor cannot pass on."""
    told = session("{watch: {reads: [telemetry, dx/sample]}}")
    rows = (MAX_CONTROL_BYTES - 40) // 8
    longest = Telemetry(1, Figures(), {"x": np.zeros((rows, 1))})
    while True:
        try:
            frame = encode(
                Telemetry(1, Figures({"s" * (MAX_CONTROL_BYTES - len(encode(longest)) - 10): 0.0}), longest.traces)
            )
        except ValueError:
            longest = Telemetry(1, Figures(), {"x": longest.traces["x"][:-1]})
            continue
        break
    full = decode(frame, MAX_CONTROL_BYTES)
    assert isinstance(full, Telemetry)
    with pytest.raises(ValueError, match="found a frame of"):
        encode(Observation("dx", full.tick, full.figures, full.traces))
    observer_broadcast, transport = ObserverBroadcast(told), MemoryTransport()
    endpoints = observer_broadcast.serve(transport, IPC, topology(told))
    link = transport.connect_outlet(endpoints["watch"], "supervisor")
    observer_broadcast.send("dx", full)
    assert link.recv(Duration(0)) is None
    assert observer_broadcast.missed == 1
    observer_broadcast.send("dx", OF_DEVICE)
    assert link.recv(Duration(0)) is not None
    transport.close()
