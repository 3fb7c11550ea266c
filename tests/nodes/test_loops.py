"""The nodes' loops in threads over the in-memory transport give the same numbers as the simulation."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.topology import topology
from manyhands.launch.recordings.recording import Collector
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.kernel.bundle import CouplingBundle, DeviceBundle, EnvironmentBundle
from manyhands.protocol.messages import Start
from manyhands.protocol.transport import Link
from tests.support.memory_transport import MemoryTransport

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
TICKS = 350  # telemetry comes every 100: the last is a part
LIMITS = {"dx": 1.25, "dz": 0.5}  # N; both bite now and then
SATURATING = tuple(f"devices.{device}.limits={{force: {limit}}}" for device, limit in LIMITS.items())

ONE_LINK = ("couplings.cx.wave_link={b: 20, depth: 2}",)
ALL_LINKED = tuple(f"couplings.{name}.wave_link={{b: 20}}" for name in ("cx", "cy", "cz"))
THINNED = tuple(f"couplings.{name}.wave_link={{b: 20, interval: 0.004}}" for name in ("cx", "cy", "cz"))

Node = DeviceNode | CouplingNode | EnvironmentNode
Loops = Callable[[Prepared], tuple[dict[str, Node], dict[str, Any]]]


def nodes_of(prepared: Prepared) -> dict[str, Node]:
    out: dict[str, Node] = {}
    for name, bundle in cut(prepared, RunPlan("simulated", None, "")).items():
        match bundle:
            case DeviceBundle():
                out[name] = DeviceNode(bundle, driver_of(bundle))
            case CouplingBundle():
                out[name] = CouplingNode(bundle)
            case EnvironmentBundle():
                out[name] = EnvironmentNode(bundle)
    return out


@pytest.fixture
def run_loops(new_life: Callable[[], Any], new_line: Callable[[], Any]) -> Loops:
    """Runs all nodes of a session from handshake to last tick; returns them and each one's messages."""

    def run(prepared: Prepared) -> tuple[dict[str, Node], dict[str, Any]]:
        graph = topology(prepared.session)
        transport = MemoryTransport()
        links: dict[str, dict[str, Link]] = {name: {} for name in graph.nodes}
        for plan in graph.links:
            link, endpoint = transport.bind(f"{plan.binder}-{plan.connector}", plan.connector)
            links[plan.binder][plan.connector] = link
            links[plan.connector][plan.binder] = transport.connect(endpoint, plan.binder)
        nodes = nodes_of(prepared)
        lines = {name: new_line() for name in nodes}

        def run_one(name: str) -> None:
            nodes[name].establish(links[name])
            nodes[name].loop(Start(0, TICKS), new_life(), lines[name])

        with ThreadPoolExecutor(len(nodes)) as pool:
            for done in [pool.submit(run_one, name) for name in nodes]:
                done.result()
        transport.close()
        return nodes, lines

    return run


@pytest.mark.parametrize("overrides", [(), SATURATING], ids=["within limits", "saturating"])
@pytest.mark.parametrize("file", ["example1.yaml", "example1-centralised.yaml", "example1-operator.yaml"])
def test_loops_give_the_simulations_numbers(file: str, overrides: tuple[str, ...], run_loops: Loops) -> None:
    if file == "example1-operator.yaml" and overrides:
        overrides = ("devices.d.limits={force: [1.25, 100, 0.5]}",)
    prepared = prepare(load_session(SESSIONS / file, overrides))
    nodes, lines = run_loops(prepared)
    graph = topology(prepared.session)
    devices = {name: graph.ports[name] for name in prepared.session.devices}
    collector = Collector(devices)
    for name in devices:
        for telemetry in lines[name].telemetry:
            collector.add(name, telemetry.tick, telemetry.traces["x"], telemetry.traces["f_v"])
    recording = collector.recording("s", "c", prepared.session.period)
    simulation = Simulation(prepared)
    expected = simulation.run(TICKS)
    np.testing.assert_array_equal(recording.x, expected.x)
    np.testing.assert_array_equal(recording.f_v, expected.f_v)
    for name, node in nodes.items():
        report, told = node.report(), lines[name].telemetry[-1]
        assert report.ticks == TICKS, name
        assert not any(report.figures.table("dropped").values()), name
        if name in simulation.couplings:
            assert report.figures["saturated"] == told.figures["saturated"] == simulation.couplings[name].core.saturated
        if name in devices:
            assert report.figures["clipped"] == told.figures["clipped"] == 0  # its couplings have done it already
        if not overrides:
            assert report.figures["ledger_min"] >= 0.0, name
    saturated = sum(coupling.core.saturated for coupling in simulation.couplings.values())
    assert (saturated > 0) == bool(overrides)
    if overrides:
        for port, limit in zip((0, 2), LIMITS.values(), strict=True):
            assert np.max(np.abs(recording.f_v[:, port])) == limit
            assert np.any(np.abs(recording.f_v[:, port]) < limit)


@pytest.mark.parametrize(
    "overrides", [ONE_LINK, ALL_LINKED, THINNED], ids=["one wave link", "all linked", "a wave in 4 ticks"]
)
def test_loops_with_wave_links_give_the_simulations_numbers(overrides: tuple[str, ...], run_loops: Loops) -> None:
    prepared = prepare(load_session(SESSIONS / "example1.yaml", overrides))
    nodes, lines = run_loops(prepared)
    simulation = Simulation(prepared)
    expected = simulation.run(TICKS)
    for i, name in enumerate(prepared.session.devices):
        np.testing.assert_array_equal(lines[name].trace("x")[:, 0], expected.x[:, i])
        np.testing.assert_array_equal(lines[name].trace("f_v")[:, 0], expected.f_v[:, i])
    assert np.max(np.abs(expected.f_v)) > 0.5
    for name, link in simulation.links.items():
        user, world = link.user, link.world
        assert user.ledger + world.ledger >= -2.0 * 0.005
        assert nodes[name].report().figures["wave_ledger"] == user.ledger
        assert nodes["environment"].report().figures.table("wave_ledger_of")[name] == world.ledger
    in_tick = Simulation(prepare(load_session(SESSIONS / "example1.yaml"))).run(TICKS)
    assert np.max(np.abs(in_tick.x - expected.x)) > 1e-5  # the delay is felt


@pytest.mark.parametrize("overrides", [(), SATURATING], ids=["within limits", "saturating"])
def test_a_couplings_traces_are_its_signals_and_passed_forces(overrides: tuple[str, ...], run_loops: Loops) -> None:
    """f_v is its device's, and p = x + C_V xi, with xi following the force that is applied."""
    prepared = prepare(load_session(SESSIONS / "example1.yaml", overrides))
    _, lines = run_loops(prepared)
    pairs = (("dx", "cx"), ("dy", "cy"), ("dz", "cz"))
    for (device, coupling), block in zip(pairs, prepared.blocks, strict=True):
        x, f, p = lines[device].trace("x"), lines[device].trace("f_v"), lines[coupling].trace("p")
        np.testing.assert_array_equal(lines[coupling].trace("f_v"), f)
        offset = dataclasses.replace(block, D=np.zeros_like(block.D)).simulate(f)
        np.testing.assert_allclose(p, x + offset, rtol=1e-12, atol=1e-15)
        assert np.max(np.abs(p - x)) > 0.0
