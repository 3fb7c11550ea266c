"""Couplings in their device's process give the same numbers to the last bit, with two messages less in each tick."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.topology import topology
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.block import Block
from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.coupling.within import Within
from manyhands.nodes.device.__main__ import together
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.kernel import bundle as bundle_files
from manyhands.nodes.kernel.bundle import BundleError, CouplingBundle, DeviceBundle
from manyhands.nodes.link.join import OwnEnd
from manyhands.nodes.link.peer_link import PeerLink, hello_to
from manyhands.protocol.clock import Duration, RealtimeClock
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Figures, Reaction, Report, Sample, Start, Tool
from tests.support.memory_transport import MemoryTransport

from ...support.threaded_session import ThreadedSession

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
TICKS = 350  # telemetry comes every 100: the last is a part


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml", ["colocate=true"]))


@pytest.mark.parametrize("file", ["example1.yaml", "example1-operator.yaml"])  # one coupling a device, and three
def test_the_numbers_are_the_simulations(file: str, new_life: Callable[[], Any]) -> None:
    prepared = prepare(load_session(SESSIONS / file, ["colocate=true"]))
    with ThreadedSession(prepared, new_life, ticks=TICKS) as stage:
        reports = stage.reports()
    simulation = Simulation(prepared)
    expected = simulation.run(TICKS)
    devices = list(prepared.session.devices)
    for trace, numbers in (("x", expected.x), ("f_v", expected.f_v)):
        told = np.hstack([stage.lines[device].trace(trace) for device in devices])
        np.testing.assert_array_equal(told, numbers)
    for name, report in reports.items():
        assert report.ticks == TICKS, name
        assert report.figures["ledger_min"] >= 0.0, name
    for name, core in simulation.couplings.items():
        assert core.ledger is not None
        assert reports[name].figures["ledger"] == core.ledger.total
        assert stage.lines[name].told[-1].tick == TICKS


def test_a_process_has_a_line_for_each_of_its_nodes(prepared: Prepared, new_life: Callable[[], Any]) -> None:
    """No link leads from one to the other, and a coupling sends its telemetry as if it were alone."""
    with ThreadedSession(prepared, new_life, ticks=TICKS) as stage:
        assert {plan.connector for plan in stage.graph.links} == {"cx", "cy", "cz"}
        stage.reports()
    for coupling, device in stage.graph.carriers.items():
        assert [told.tick for told in stage.lines[coupling].told] == [told.tick for told in stage.lines[device].told]
        assert stage.lines[coupling].told[0].traces.keys() == {"p", "f_v", "ledger"}
        np.testing.assert_array_equal(stage.lines[coupling].trace("f_v"), stage.lines[device].trace("f_v"))


def test_a_ticks_signal_is_sent_again_and_not_computed_anew(prepared: Prepared) -> None:
    """The environment may have reckoned with the first already; and a block is asked for one p(k) a tick."""
    bundles = cut(prepared, RunPlan("simulated", None, ""))
    device, coupling = bundles["dx"], bundles["cx"]
    assert isinstance(device, DeviceBundle)
    assert isinstance(coupling, CouplingBundle)
    transport = MemoryTransport()
    world, endpoint = transport.bind("environment-cx", "cx")
    (peer,) = coupling.common.peers
    link = transport.connect(endpoint, "environment")
    own = hello_to(coupling.common, peer, coupling.block.D)
    block = Block(coupling, PeerLink(own, peer, link, Reaction, slice(0, 1), RealtimeClock()))
    within = Within(OwnEnd(device.common, RealtimeClock()), CouplingNode(coupling).as_peer, block)
    for tick, x in ((3, 0.5), (3, 0.75), (4, 0.75)):
        within.send(Sample, tick, 7, np.array([x]))
    within.send_again()
    said = [decode(world.recv(Duration(0)) or b"", MAX_CONTROL_BYTES) for _ in range(4)]
    transport.close()
    assert said == [Tool(3, 7, [0.5]), Tool(3, 7, [0.5]), Tool(4, 7, [0.75]), Tool(4, 7, [0.75])]


def test_the_bundles_of_a_process_make_its_nodes(prepared: Prepared, tmp_path: Path) -> None:
    bundles = cut(prepared, RunPlan("simulated", None, ""))
    device = bundles["dx"]
    assert isinstance(device, DeviceBundle)
    bundle_files.save(bundles["cx"], tmp_path / "cx.bundle")
    (own, leader), (carried, follower) = together(device, driver_of(device), [tmp_path / "cx.bundle"])
    assert (own, carried.common.name) == (device, "cx")
    assert isinstance(leader, DeviceNode)
    assert isinstance(follower, CouplingNode)
    assert list(leader._inside) == [follower]
    with pytest.raises(BundleError, match=r"cy\.bundle"):
        together(device, driver_of(device), [tmp_path / "cy.bundle"])


def test_a_coupling_that_has_not_begun_has_nothing_to_tell(
    prepared: Prepared, new_life: Callable[[], Any], new_line: Callable[[], Any]
) -> None:
    bundles = cut(prepared, RunPlan("simulated", None, ""))
    coupling, device = bundles["cx"], bundles["dx"]
    assert isinstance(coupling, CouplingBundle)
    node, own = CouplingNode(coupling), OwnEnd(device.common, RealtimeClock())
    assert node.report() == Report(0, Figures())
    with pytest.raises(ValueError, match="before its handshake"):
        node.loop(Start(0, 1), new_life(), new_line())
    with pytest.raises(ValueError, match="before its handshake"):
        node.join_from(own)
    (peer,) = coupling.common.peers
    link = PeerLink(hello_to(coupling.common, peer, None), peer, None, Reaction, slice(0, 1), RealtimeClock())
    within = Within(own, node.as_peer, Block(coupling, link))
    within.listen()
    within.publish_rest()


def test_topology_has_no_link_and_one_process_for_both() -> None:
    plain, together = (
        topology(load_session(SESSIONS / "example1-operator.yaml", [f"colocate={flag}"])) for flag in ("false", "true")
    )
    assert together.nodes == plain.nodes
    assert together.ports == plain.ports
    assert together.carriers == dict.fromkeys(("cx", "cy", "cz"), "d")
    assert plain.carriers == {}
    assert set(plain.links) - set(together.links) == {plan for plan in plain.links if plan.connector == "d"}
    assert set(together.links) < set(plain.links)


def test_a_device_has_its_coupling_listen_and_end_its_rows(
    prepared: Prepared, monkeypatch: pytest.MonkeyPatch, new_line: Callable[[], Any]
) -> None:
    bundles = cut(prepared, RunPlan("simulated", None, ""))
    device, coupling = bundles["dx"], bundles["cx"]
    assert isinstance(device, DeviceBundle)
    assert isinstance(coupling, CouplingBundle)
    inner = CouplingNode(coupling)
    inner.establish({})
    node, noted = DeviceNode(device, driver_of(device), inside=[inner]), list[str]()
    node.establish({})
    monkeypatch.setattr(Within, "listen", lambda _: noted.append("listens"))
    monkeypatch.setattr(Within, "publish_rest", lambda _: noted.append("publishes"))
    node._listen(new_line())
    node._jump(new_line())
    assert noted == ["listens", "publishes"]
