"""The nodes' loops over the in-memory transport, in threads, without processes: same numbers as the simulation."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.bundles import Run, cut
from manyhands.launch.preparation import Prepared, prepare
from manyhands.launch.recording import Collector
from manyhands.launch.session import load_session
from manyhands.launch.simulation import Simulation
from manyhands.launch.topology import topology
from manyhands.nodes.bundle import CouplingBundle, DeviceBundle, EnvironmentBundle
from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.device.simulated import simulated_driver
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Force, Start, Telemetry
from manyhands.protocol.transport import Link
from manyhands.protocol.transport.memory import MemoryTransport

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
TICKS = 350  # telemetry comes every 100: the last is a part


class Running:
    """A life that goes on."""

    stopping = False

    def check(self) -> None:
        """Nothing to look after."""


class Kept:
    """A line to the supervisor that keeps what it is told."""

    def __init__(self) -> None:
        self.telemetry: list[Telemetry] = []
        self.dropped = 0

    def publish(self, telemetry: Telemetry) -> None:
        traces = {name: trace.copy() for name, trace in telemetry.traces.items()}
        self.telemetry.append(Telemetry(telemetry.tick, telemetry.figures, traces))


Node = DeviceNode | CouplingNode | EnvironmentNode


def nodes_of(prepared: Prepared) -> dict[str, Node]:
    run = Run("simulated", "memory", Path(), "", traces=True)
    out: dict[str, Node] = {}
    for name, bundle in cut(prepared, run).items():
        match bundle:
            case DeviceBundle():
                out[name] = DeviceNode(bundle, simulated_driver(bundle))
            case CouplingBundle():
                out[name] = CouplingNode(bundle)
            case EnvironmentBundle():
                out[name] = EnvironmentNode(bundle)
    return out


@pytest.mark.parametrize("file", ["example1.yaml", "example1-centralised.yaml", "example1-operator.yaml"])
def test_loops_give_the_simulations_numbers(file: str) -> None:
    prepared = prepare(load_session(SESSIONS / file))
    graph = topology(prepared.session)
    transport = MemoryTransport()
    links: dict[str, dict[str, Link]] = {name: {} for name in graph.nodes}
    for plan in graph.links:
        links[plan.binder][plan.connector], endpoint = transport.bind(f"{plan.binder}-{plan.connector}")
        links[plan.connector][plan.binder] = transport.connect(endpoint)
    nodes = nodes_of(prepared)
    kept = {name: Kept() for name in nodes}

    def run(name: str) -> None:
        nodes[name].establish(links[name])
        nodes[name].loop(Start(0, TICKS), Running(), kept[name])  # type: ignore[arg-type]

    with ThreadPoolExecutor(len(nodes)) as pool:
        for done in [pool.submit(run, name) for name in nodes]:
            done.result()
    transport.close()

    devices = {name: graph.ports[name] for name in prepared.session.devices}
    collector = Collector(devices)
    for name in devices:
        for telemetry in kept[name].telemetry:
            collector.add(name, telemetry.tick, telemetry.traces["x"], telemetry.traces["f_v"])
    recording = collector.recording("s", "c", prepared.session.period)
    expected = Simulation(prepared).run(TICKS)
    np.testing.assert_array_equal(recording.x, expected.x)
    np.testing.assert_array_equal(recording.f_v, expected.f_v)
    for name, node in nodes.items():
        report = node.report()
        assert report.ticks == TICKS, name
        assert report.figures["ledger_min"] >= 0.0, name
        assert all(n == 0 for key, n in report.counts.items() if key.startswith("dropped")), name


def test_junk_on_a_link_is_counted_and_changes_nothing() -> None:
    """A frame of rubbish, an old force and a future one, put before the first tick's force."""
    prepared = prepare(load_session(SESSIONS / "example1.yaml"))
    bundle = cut(prepared, Run("simulated", "memory", Path(), "", traces=True))["dx"]
    assert isinstance(bundle, DeviceBundle)
    transport = MemoryTransport()
    coupling_end, endpoint = transport.bind("cx-dx")
    device_end = transport.connect(endpoint)
    node = DeviceNode(bundle, simulated_driver(bundle))

    from manyhands.nodes.bundle import Common, Peer
    from manyhands.nodes.exchange import establish
    from manyhands.protocol.clock import RealtimeClock
    from manyhands.protocol.messages import Role, Sample

    own = bundle.common
    common = Common(**{**{f: getattr(own, f) for f in own.__dataclass_fields__}, "name": "cx", "role": Role.COUPLING,
                       "peers": (Peer("dx", Role.DEVICE, ("dx",), True),)})  # fmt: skip
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(establish, common, {"dx": coupling_end}, {"dx": Sample}, RealtimeClock())
        node.establish({"cx": device_end})
        other.result()
    zero, one = np.zeros(1), np.ones(1)
    for frame in (b"\xc1junk", encode(Force(1, 0, one)), encode(Sample(0, 0, one)), encode(Force(0, 0, np.ones(2)))):
        assert coupling_end.send(frame)
    for tick in range(3):
        assert coupling_end.send(encode(Force(tick, 0, zero)))
        assert coupling_end.send(encode(Force(tick, 0, one)))  # a replay
    node.loop(Start(0, 3), Running(), Kept())  # type: ignore[arg-type]
    transport.close()
    counts = node.report().counts
    assert counts["dropped_malformed"] == 1
    assert counts["dropped_future_tick"] == 1
    assert counts["dropped_wrong_kind"] == 1
    assert counts["dropped_wrong_width"] == 1
    assert counts["dropped_old_tick"] == 2  # the third tick's replay is never read
    assert node.report().figures["peak_speed"] == 0.0
