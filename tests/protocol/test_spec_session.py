"""SPEC.md describes a session: the side that listens, the side that connects, answers, counts, and trust."""

import dataclasses
import importlib
import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import HUB_NAME, IPC
from manyhands.launch.plan.topology import Topology, roster, topology
from manyhands.launch.run import conductor
from manyhands.launch.run.broadcast import TRACE_OF, ObserverBroadcast
from manyhands.launch.run.recovery import LINK_TRANSITIONS
from manyhands.launch.run.states import NodeState
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.block import Block
from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.environment.membership import TRANSITIONS as MEMBERSHIPS
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.kernel.arithmetic import feedthrough_digest
from manyhands.nodes.kernel.bundle import Common, CouplingBundle, DeviceBundle, EnvironmentBundle, ObserverBundle
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.kernel.log import Log
from manyhands.nodes.link import process
from manyhands.nodes.link.peer_link import PeerLink, bind_links, hello_to
from manyhands.nodes.link.process import HostedNode, Node
from manyhands.nodes.link.supervisor_line import ControlLine
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import RealtimeClock, from_seconds
from manyhands.protocol.gate import DROP_REASONS
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Fault,
    Fetch,
    Figures,
    Message,
    NodeHello,
    Probe,
    Reaction,
    Ready,
    Report,
    Role,
    Telemetry,
)
from manyhands.protocol.path import NotOpened
from manyhands.protocol.transport import Link
from manyhands.protocol.transport.door import NotAdmitted
from manyhands.protocol.transport.zeromq import HUB_DROPS, ZmqHub, ZmqTransport
from tests.support.memory_transport import MemoryTransport

from ..support.spec_text import OF_FIGURES, SPEC, figure_rows, listed, table

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
SAID: dict[type[Message], Message] = {
    Fetch: Fetch(0),
    NodeHello: NodeHello(PROTOCOL_VERSION, "id", "s", "dx", Role.DEVICE, 1, {}),
    Probe: Probe(1),
    Ready: Ready(),
    Telemetry: Telemetry(1, Figures(), {}),
    Report: Report(1, Figures()),
    Fault: Fault("boom"),
}


def test_the_digest_of_a_feedthrough() -> None:
    assert f"(of 0.5 m/N at one port: `{feedthrough_digest([[0.5]])}`)" in SPEC


def test_the_supervisors_view_of_a_node() -> None:
    """What a node that stands somewhere is answered, and where it stands then, by doing it."""
    nodes = {"dx": Role.DEVICE, "dy": Role.DEVICE}  # the other one keeps the session from going on
    rows = []
    for state, kind in conductor.TRANSITIONS:
        session = conductor.Conductor(Topology(nodes, dict.fromkeys(nodes, ()), ()), "id", "s", 0)
        session.states["dx"], session.parts["dx"] = state, b"part"
        told = session.receive("dx", SAID[kind], 0)
        answers = [type(i.message).__name__ for i in told if isinstance(i, conductor.Send) and i.node == "dx"]
        rows.append([state.value, kind.__name__, session.states["dx"].value, ", ".join(answers) or "nothing"])
        assert session.ignored == 0
    assert table("| a node that is | sends | is then | is answered with |") == rows


def test_what_an_observer_is_shown() -> None:
    assert {row[0]: row[1] for row in table("| signal | is the trace |")} == TRACE_OF


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    """A session with an observer; what its coupling is, or whether it is certified, is of no account here."""
    observers = "observers={watch: {reads: [telemetry]}}"
    return prepare(load_session(SESSIONS / "example1-uncoupled.yaml", [observers]), uncertified=True)


class Recorder(MemoryTransport):
    """Remembers the admitted peers of each bound endpoint, by its name, which is the ZAP domain."""

    def __init__(self) -> None:
        super().__init__()
        self.bound: dict[str, str] = {}

    def bind(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        self.bound[name] = peer
        return super().bind(name, peer, address)

    def bind_outlet(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        self.bound[name] = peer
        return super().bind_outlet(name, peer, address)


def test_the_listening_and_the_connecting_side(prepared: Prepared) -> None:
    session = prepared.session
    roles = roster(session)
    placeholders = {
        name: role.upper() for name, role in roles.items() if role in (Role.DEVICE, Role.COUPLING, Role.OBSERVER)
    }
    rows: set[tuple[str, str, str]] = set()
    for name, bundle in cut(prepared, RunPlan("simulated", None, "")).items():
        transport = Recorder()
        bind_links(bundle.common, transport)
        rows |= {(roles[name], roles[peer], _general(domain, placeholders)) for domain, peer in transport.bound.items()}
        transport.close()
    transport = Recorder()
    ObserverBroadcast(session).serve(transport, IPC, topology(session))
    rows |= {(Role.SUPERVISOR, roles[peer], _general(domain, placeholders)) for domain, peer in transport.bound.items()}
    transport.close()
    members = ", ".join(role for role in Role if role not in (Role.SUPERVISOR, Role.HAND))
    rows.add((Role.SUPERVISOR, members, HUB_NAME))
    assert {tuple(row) for row in table("| listens | connects | ZAP domain |")} == rows


def _general(domain: str, placeholders: Mapping[str, str]) -> str:
    return "-".join(placeholders.get(part, part) for part in domain.split("-"))


def test_what_is_counted_at_the_hub(prepared: Prepared, tmp_path: Path) -> None:
    """By a supervisor that has met one of each."""
    supervisor = Supervisor(prepared, clock="simulated", reach=IPC, ticks=1, record=False)
    transport = ZmqTransport.ipc(tmp_path)
    hub, _ = transport.bind_hub(HUB_NAME, ())
    assert isinstance(hub, ZmqHub)
    hub.dropped.update(dict.fromkeys(HUB_DROPS, 1))
    supervisor.conductor.ignored = supervisor._collector.refused = 1
    supervisor._tally(hub, transport)
    transport.close()
    assert [row[0] for row in table("| count at the hub | is |")] == list(supervisor._refused)


class LastMessageLine:
    """A node's line to the supervisor; only the last message matters."""

    def __init__(self) -> None:
        self.dropped, self.log, self.word = 0, Log(None, "s", "n", RealtimeClock()), Report(0, Figures())

    def refused(self) -> Mapping[str, int]:
        return {}

    def report(self, report: Report, _life: object) -> None:
        self.word = report


def test_every_figure_is_listed() -> None:
    assert "\n".join([OF_FIGURES, "|---|---|---|---|", *figure_rows(), ""]) in SPEC, "run: make figures"


def test_a_node_states_what_is_declared(prepared: Prepared) -> None:
    stated = dict[str, set[str]]()
    for bundle in cut(prepared, RunPlan("simulated", None, "")).values():
        node: Node
        match bundle:
            case DeviceBundle():
                node = DeviceNode(bundle, driver_of(bundle))
            case CouplingBundle():
                node = CouplingNode(bundle)
                node._block = Block(bundle, _unlinked(bundle.common))
            case EnvironmentBundle():
                node = EnvironmentNode(bundle)
            case _:
                continue
        line = LastMessageLine()
        member = HostedNode(bundle.common, node, MemoryTransport(), line)  # type: ignore[arg-type]
        process._report(member, {}, Life.__new__(Life))
        numbers, tables = line.word.figures, line.word.figures.tables
        assert all(names.FIGURES[name].key is None for name in numbers), numbers
        assert all(names.FIGURES[name].key is not None for name in tables), tables
        stated[bundle.common.role] = {*numbers, *tables}
        assert {"refused", "dropped"} <= tables.keys()
        assert {*tables["dropped"]} <= {*DROP_REASONS, "telemetry", "log"}
    assert {"late", "late_cause", "tau_us", "let_go"} <= stated[Role.DEVICE]
    assert "saturated" in stated[Role.COUPLING]
    assert {"frozen_ticks", "absences"} <= stated[Role.ENVIRONMENT]


def _unlinked(common: Common) -> PeerLink:
    (peer,) = (peer for peer in common.peers if peer.role is Role.ENVIRONMENT)
    return PeerLink(hello_to(common, peer, None), peer, None, Reaction, slice(None), RealtimeClock())


def test_where_a_node_may_stand() -> None:
    assert [row[0] for row in table("| a node is | when |")] == list(NodeState)


def test_what_becomes_of_a_link() -> None:
    expected = [[state, event, following] for (state, event), following in LINK_TRANSITIONS.items()]
    assert table("| a link that is | hears of | is then |") == expected


def test_what_becomes_of_a_member() -> None:
    expected = [[state, event, following] for (state, event), following in MEMBERSHIPS.items()]
    assert table("| a member that is | hears | is then |") == expected


def test_the_domain_of_a_link_that_is_bound_anew(prepared: Prepared) -> None:
    """`COUPLING-DEVICE.1`, and then `.2`, each for that device alone."""
    (bundle,) = (b for b in cut(prepared, RunPlan("simulated", None, "")).values() if b.common.name == "cx")
    transport = Recorder()
    _, hub = transport.bind_hub(HUB_NAME, ("cx",))
    line = ControlLine(transport, dataclasses.replace(bundle.common, control=hub))
    (device,) = (peer for peer in bundle.common.peers if peer.binds)
    for _ in range(2):
        line.bind_anew(device)
    transport.close()
    assert transport.bound == {"cx-dx.1": "dx", "cx-dx.2": "dx"}
    assert "`COUPLING-DEVICE.1`" in SPEC


def test_numbers_that_others_may_choose_otherwise() -> None:
    rows = table("| number | value | where | is |")
    assert len(rows) >= 16
    for name, value, where, _ in rows:
        module = importlib.import_module("manyhands." + where.removesuffix(".py").replace("/", "."))
        constant, _, clock = name.partition(" ")
        found = getattr(module, constant)
        number, _, unit = value.partition(" ")
        stated = from_seconds(float(number)) if unit == "s" else float(number)
        assert (found[clock.strip("()")] if clock else found) == stated, name


def test_who_is_trusted_with_what(prepared: Prepared) -> None:
    """Reading and writing by the capability table, bundles by their types."""
    session = prepared.session
    capabilities = Plan(session).access
    bundles = {Role.DEVICE: DeviceBundle, Role.COUPLING: CouplingBundle, Role.ENVIRONMENT: EnvironmentBundle}
    bundles |= {Role.OBSERVER: ObserverBundle}
    rows = table("| role | reads | writes | its bundle holds |")
    assert [row[0] for row in rows] == list(Role)
    for role, *told in rows:
        for action, cell in zip(("read", "write"), told, strict=False):
            allowed = {c.channel for c in capabilities if c.role == role and c.action == action}
            assert listed(cell) == allowed, f"{role} {action}"
        if role in bundles:
            fields = {field.name for field in dataclasses.fields(bundles[Role(role)])} - {"common"}
            assert listed(told[2]) == fields, role


def test_every_attack_is_counted_by_a_count_that_there_is() -> None:
    attacks = table("| attacker | can at most | cannot | is counted as |")
    named = {name for row in attacks for name in re.findall(r"\w+", row[3])}
    assert named == {
        *NotAdmitted,
        *DROP_REASONS,
        *HUB_DROPS,
        *NotOpened,
        "out_of_turn",
        "telemetry_that_does_not_fit",
    } | {
        names.CLIPPED,
        names.SATURATED,
    }
