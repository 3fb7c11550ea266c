"""Read and write access follows from the structure alone and equals the blocks of V and the sockets."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from manyhands.design.models.statespace import StateSpace
from manyhands.launch.plan.access import Capability, capability_violations, observed
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import Session, load_session
from manyhands.nodes.kernel.bundle import SIMULATED, Bundle, CouplingBundle
from manyhands.nodes.link.peer_link import bind_links
from manyhands.protocol.channels import CHANNELS, Rate
from manyhands.protocol.messages import Role

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
SIGNALS = {channel.name: channel for channel in CHANNELS.values() if channel.rate is Rate.EVERY_TICK}

Grant = tuple[str, str, str, str]
"""A process, a port, "read" or "write", and a signal."""

Pattern = NDArray[np.bool_]


# -- what the blocks of V need -------------------------------------------------------------------------------------


def needed_by(V: StateSpace, orders: Mapping[str, int], ports: tuple[str, ...]) -> set[Grant]:
    """What each process must read and write, from the nonzero entries of the whole V and nothing else.

    The states of V are stacked by block; ``orders`` has the number of each. A process reads f_v of the ports
    whose force reaches its states and hands it on to their devices; it moves the tools that its states reach, each from
    the displacement x of that port. A direct entry of D_V belongs to the process that its tool or its force does.
    """
    A, B, C, D = (np.asarray(M) != 0.0 for M in (V.A, V.B, V.C, V.D))
    reached = np.eye(len(A), dtype=np.bool_)
    for _ in range(len(A)):
        reached = reached | (A @ reached)
    force_in, tool_out = reached @ B, C @ reached
    found: set[Grant] = set()
    first = 0
    for name, order in orders.items():
        states = slice(first, first + order)
        first += order
        into: Pattern = force_in[states].any(axis=0)
        out: Pattern = tool_out[:, states].any(axis=1)
        into, out = into | D[out].any(axis=0), out | D[:, into].any(axis=1)
        found |= {
            (name, ports[p], *what) for p in np.nonzero(into)[0] for what in (("read", "reaction"), ("write", "force"))
        }
        found |= {
            (name, ports[p], *what) for p in np.nonzero(out)[0] for what in (("read", "sample"), ("write", "tool"))
        }
    return found


# -- what the table and the sockets allow --------------------------------------------------------------------------


def granted(table: tuple[Capability, ...]) -> set[Grant]:
    return {(row.node, port, row.action, row.channel) for row in table if row.channel in SIGNALS for port in row.ports}


class BindingNotes:
    """Stands in for a transport, and notes each binding with its peer."""

    def __init__(self) -> None:
        self.bound: list[str] = []

    def bind(self, name: str, *_peer: object, **_options: object) -> tuple[None, str]:
        self.bound.append(name)
        return None, f"memory://{name}"


def carried(bundles: Mapping[str, Bundle]) -> set[Grant]:
    """What can pass over the sockets that the processes bind, each connected to by exactly one other process."""
    found: set[Grant] = set()
    commons = {name: bundle.common for name, bundle in bundles.items()}
    for name, common in commons.items():
        transport: Any = BindingNotes()
        links, endpoints = bind_links(common, transport)
        assert len(set(transport.bound)) == len(transport.bound) == len(endpoints)
        for other in links:
            (mine,) = [peer for peer in common.peers if peer.name == other]
            (theirs,) = [peer for peer in commons[other].peers if peer.name == name]
            assert (mine.binds, theirs.binds) == (True, False)
            assert mine.ports == theirs.ports  # the order is that of the values in a signal
            for sender, receiver in ((common, commons[other]), (commons[other], common)):
                for channel in SIGNALS.values():
                    if sender.role in channel.senders and receiver.role in channel.receivers:
                        found |= {(sender.name, port, "write", channel.name) for port in mine.ports}
                        found |= {(receiver.name, port, "read", channel.name) for port in mine.ports}
    connecting = [(name, peer.name) for name, common in commons.items() for peer in common.peers if not peer.binds]
    binding = [(peer.name, name) for name, common in commons.items() for peer in common.peers if peer.binds]
    assert sorted(connecting) == sorted(binding)  # every connection has its own bound endpoint
    return found


def of_couplings(session: Session, grants: set[Grant]) -> set[Grant]:
    return {grant for grant in grants if grant[0] in session.couplings}


def bundles_of(prepared: Prepared) -> dict[str, Bundle]:
    return cut(prepared, RunPlan(SIMULATED, Path(), ""))


def whole(prepared: Prepared) -> tuple[StateSpace, dict[str, int]]:
    partition = prepared.loop.partition
    orders = dict(zip(partition.names, (block.order for block in prepared.blocks), strict=True))
    return partition.join(prepared.blocks), orders


@st.composite
def dense_blocks(draw: st.DrawFn, session: Session) -> Prepared:
    """A random dense block for every coupling, as a design would hand it out."""
    numbers = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    blocks = []
    for ports in session.blocks:
        n, m = draw(st.integers(1, 3)), len(ports)
        blocks.append(StateSpace(*(numbers.uniform(0.1, 1.0, shape) for shape in ((n, n), (n, m), (m, n), (m, m)))))
    return Prepared(session, haptic_loop(session), tuple(blocks), "uncertified-drawn")


@settings(max_examples=80)
@given(data=st.data())
def test_blocks_sockets_and_capabilities_are_one(
    drawn_sessions: st.SearchStrategy[Session], data: st.DataObject
) -> None:
    session = data.draw(drawn_sessions)
    prepared = data.draw(dense_blocks(session))
    bundles, table = bundles_of(prepared), Plan(session).access
    V, orders = whole(prepared)
    assert needed_by(V, orders, session.ports) == of_couplings(session, granted(table))
    assert carried(bundles) == granted(table)
    for name, block in zip(session.couplings, prepared.blocks, strict=True):
        bundle = bundles[name]
        assert isinstance(bundle, CouplingBundle)
        assert bundle.block is block  # what is handed to a process is what V was assembled from
        assert bundle.common.ports == session.blocks_by_name[name]
    assert not capability_violations(session, Plan(session).access, session.blocks_by_name)


LINEAR = "design={coupling: linear, order: 2, poles: [{frequency: 52.0, damping: 0.053}]}"


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("example1", []),
        ("example1-centralised", []),
        ("example1-operator", []),
        ("example1", ["couplings={one: {ports: [dz, dx]}, two: {devices: [dy]}}"]),
        ("example1", ["couplings={one: {ports: [dz, dx]}, two: {devices: [dy]}}", LINEAR]),
    ],
)
def test_what_the_design_finds_needs_what_its_processes_may(name: str, overrides: list[str]) -> None:
    session = load_session(SESSIONS / f"{name}.yaml", overrides)
    prepared = prepare(session)
    assert prepared.certificate is not None
    V, orders = whole(prepared)
    assert needed_by(V, orders, session.ports) == of_couplings(session, granted(Plan(session).access))
    assert carried(bundles_of(prepared)) == granted(Plan(session).access)


@settings(max_examples=60)
@given(data=st.data())
def test_one_entry_of_V_across_blocks_needs_what_nobody_may(
    drawn_sessions: st.SearchStrategy[Session], data: st.DataObject
) -> None:
    """So that the comparison above can fail: in B, in C, in D, and between states, which no single matrix shows."""
    session = data.draw(drawn_sessions)
    assume(len(session.couplings) > 1)
    prepared = data.draw(dense_blocks(session))
    V, orders = whole(prepared)
    ends = np.cumsum([0, *orders.values()])
    states = [range(a, b) for a, b in pairwise(ends)]
    blocks = prepared.loop.partition.blocks
    i, j = data.draw(st.permutations(range(len(blocks))))[:2]
    name = data.draw(st.sampled_from("ABCD"))
    M = getattr(V, name).copy()
    row, column = (states if name in "AB" else blocks)[i][0], (states if name in "AC" else blocks)[j][0]
    assert M[row, column] == 0.0
    M[row, column] = 1e-9
    needed = needed_by(StateSpace(*(M if n == name else getattr(V, n) for n in "ABCD")), orders, session.ports)
    assert needed > of_couplings(session, granted(Plan(session).access))


# -- the table itself ----------------------------------------------------------------------------------------------


def session_of(**changes: object) -> Session:
    """One hand on two axes and one on one; the blocks follow the axes and not the hands."""
    device = {"osp": 1.0, "driver": "simulated", "mass": 0.2}
    return Session.model_validate(
        {
            "session": "crossed",
            "period": 0.001,
            "devices": {"d": {"dof": 2, "axes": ["x", "y"], **device}, "e": {"dof": 1, **device}},
            "couplings": {"a": {"ports": ["e", "d.x"]}, "b": {"ports": ["d.y"]}},
            "environment": {
                "type": "network",
                "links": [{"between": [port, "ground"], "stiffness": 100} for port in ("d.x", "d.y", "e")],
            },
            "design": {"coupling": "spring-damper"},
            "observers": {"watch": {"reads": ["telemetry"]}, "scope": {"reads": ["b/tool", "d/force", "d/sample"]}},
            **changes,
        }
    )


def test_the_table_of_a_session_row_by_row() -> None:
    everyone = ("d/telemetry", "e/telemetry", "a/telemetry", "b/telemetry", "environment/telemetry")
    scope = ("d/sample", "d/force", "b/tool")
    device, coupling, environment = Role.DEVICE, Role.COUPLING, Role.ENVIRONMENT
    expected: list[tuple[Any, ...]] = [
        ("d", device, "write", "sample", "a", ("d.x",)),
        ("d", device, "write", "sample", "b", ("d.y",)),
        ("d", device, "read", "force", "a", ("d.x",)),
        ("d", device, "read", "force", "b", ("d.y",)),
        ("d", device, "write", "telemetry", "supervisor", ("d.x", "d.y")),
        ("e", device, "write", "sample", "a", ("e",)),
        ("e", device, "read", "force", "a", ("e",)),
        ("e", device, "write", "telemetry", "supervisor", ("e",)),
        ("a", coupling, "read", "sample", "d", ("d.x",)),
        ("a", coupling, "read", "sample", "e", ("e",)),
        ("a", coupling, "write", "tool", "environment", ("e", "d.x")),
        ("a", coupling, "read", "reaction", "environment", ("e", "d.x")),
        ("a", coupling, "write", "force", "d", ("d.x",)),
        ("a", coupling, "write", "force", "e", ("e",)),
        ("a", coupling, "write", "telemetry", "supervisor", ("e", "d.x")),
        ("b", coupling, "read", "sample", "d", ("d.y",)),
        ("b", coupling, "write", "tool", "environment", ("d.y",)),
        ("b", coupling, "read", "reaction", "environment", ("d.y",)),
        ("b", coupling, "write", "force", "d", ("d.y",)),
        ("b", coupling, "write", "telemetry", "supervisor", ("d.y",)),
        ("environment", environment, "read", "tool", "a", ("e", "d.x")),
        ("environment", environment, "read", "tool", "b", ("d.y",)),
        ("environment", environment, "write", "reaction", "a", ("e", "d.x")),
        ("environment", environment, "write", "reaction", "b", ("d.y",)),
        ("environment", environment, "write", "telemetry", "supervisor", ("d.x", "d.y", "e")),
        ("supervisor", Role.SUPERVISOR, "read", "telemetry", "d", ("d.x", "d.y")),
        ("supervisor", Role.SUPERVISOR, "read", "telemetry", "e", ("e",)),
        ("supervisor", Role.SUPERVISOR, "read", "telemetry", "a", ("e", "d.x")),
        ("supervisor", Role.SUPERVISOR, "read", "telemetry", "b", ("d.y",)),
        ("supervisor", Role.SUPERVISOR, "read", "telemetry", "environment", ("d.x", "d.y", "e")),
        ("supervisor", Role.SUPERVISOR, "write", "observation", "watch", ("d.x", "d.y", "e"), everyone),
        ("supervisor", Role.SUPERVISOR, "write", "observation", "scope", ("d.x", "d.y"), scope),
        ("watch", Role.OBSERVER, "read", "observation", "supervisor", ("d.x", "d.y", "e"), everyone),
        ("scope", Role.OBSERVER, "read", "observation", "supervisor", ("d.x", "d.y"), scope),
    ]
    assert list(Plan(session_of()).access) == [Capability(*row) for row in expected]


@settings(max_examples=60)
@given(data=st.data())
def test_nobody_may_more_than_its_role_and_its_ports(
    drawn_sessions: st.SearchStrategy[Session], data: st.DataObject
) -> None:
    session = data.draw(drawn_sessions)
    table = Plan(session).access
    keys = [(row.node, row.channel, row.peer) for row in table]
    assert len(set(keys)) == len(keys)
    # each right has its counterpart at the other end, for the same ports
    mirror = {"read": "write", "write": "read"}
    rows = {(row.node, row.action, row.channel, row.peer): (row.ports, row.content) for row in table}
    for (node, action, channel, peer), about in rows.items():
        assert rows[peer, mirror[action], channel, node] == about
    for row in table:
        channel = CHANNELS[row.channel]
        assert row.role in (channel.senders if row.action == "write" else channel.receivers)
        match row.role:
            case Role.DEVICE:
                assert set(row.ports) <= set(session.ports_of(row.node))
                assert row.peer == "supervisor" or row.peer in session.couplings
            case Role.COUPLING:
                assert set(row.ports) <= set(session.blocks_by_name[row.node])
            case Role.ENVIRONMENT:
                assert row.channel in ("tool", "reaction", "telemetry")  # never x
            case Role.OBSERVER:
                assert (row.action, row.peer) == ("read", "supervisor")  # and so it writes nothing


@settings(max_examples=60)
@given(data=st.data())
def test_an_observer_receives_its_requested_topics_and_nothing_else(
    drawn_sessions: st.SearchStrategy[Session], data: st.DataObject
) -> None:
    session = data.draw(drawn_sessions)
    for name, observer in session.observers.items():
        told = {f"{node}/{channel}" for node, channels in observed(session, name).items() for channel in channels}
        asked = {entry for entry in observer.reads if entry != "telemetry"}
        if "telemetry" in observer.reads:
            asked |= {f"{node}/telemetry" for node in session.roles}
        assert told == asked


def test_peers_share_a_channel() -> None:
    session = session_of()
    assert Plan(session).peers == {
        "d": {"a", "b", "supervisor"},
        "e": {"a", "supervisor"},
        "a": {"d", "e", "environment", "supervisor"},
        "b": {"d", "environment", "supervisor"},
        "environment": {"a", "b", "supervisor"},
        "supervisor": {"d", "e", "a", "b", "environment", "watch", "scope"},
        "watch": {"supervisor"},
        "scope": {"supervisor"},
    }
    with pytest.raises(ValueError, match=r"found the observer 'wtch'; expected one of watch, scope \(did you mean"):
        observed(session, "wtch")
