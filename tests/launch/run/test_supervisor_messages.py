"""Any message of nodes, observers and strangers is read, shown and reported without an error."""

from __future__ import annotations

import json
import math
import signal
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rich.console import Console

from manyhands.launch.app.design_report import print_report
from manyhands.launch.look.live import LiveTable
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import IPC, Reach
from manyhands.launch.plan.topology import Topology, topology
from manyhands.launch.run import supervisor as supervisor_module
from manyhands.launch.run.broadcast import describe
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.states import SessionPhase
from manyhands.launch.run.supervisor import Supervisor, most_ticks
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED
from manyhands.nodes.monitor.health import missed
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.codec import encode
from manyhands.protocol.limits import MAX_COUNT
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Fault,
    Fetch,
    Figures,
    Message,
    NodeHello,
    Offer,
    Probe,
    Ready,
    Report,
    Role,
    Telemetry,
)
from tests.support.memory_transport import MemoryTransport

from ...support.cases import cases

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
OBSERVERS = "observers={watch: {reads: [telemetry, dx/sample, cx/tool]}}"
KNOWN = [value for name, value in vars(names).items() if name.isupper() and isinstance(value, str)]
counts = st.integers(0, MAX_COUNT) | st.integers(0, 300)
numbers = st.floats() | st.sampled_from([math.nan, math.inf, -math.inf, -1.0, 1e300])
keys = st.sampled_from([*KNOWN, "dropped_x", "[bold]", "p50"])
figures = st.builds(
    Figures,
    st.dictionaries(keys, numbers, max_size=6),
    st.dictionaries(keys, st.dictionaries(st.sampled_from(["p50", "p99", "cx", "[bold]"]), numbers, max_size=3)),
)
traces = st.dictionaries(
    st.sampled_from([names.DISPLACEMENT, names.FORCE, names.FREE_POSITION]),
    hnp.arrays(np.float64, st.tuples(st.integers(0, 3), st.integers(0, 3)), elements=numbers),
    max_size=3,
)
said: st.SearchStrategy[Message | bytes] = st.one_of(
    st.builds(Telemetry, counts, figures, traces),
    st.builds(Report, counts, figures),
    st.builds(Fault, st.text("ab[/]\n", max_size=20)),
    st.just(Ready()),
    st.builds(Probe, counts),
    st.binary(max_size=20),
)


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml", [OBSERVERS]))


class NoProcesses:
    """Processes of a run that has none."""

    def __init__(self) -> None:
        self.sent: list[signal.Signals] = []
        self.pids: dict[str, int] = {}

    def send(self, which: signal.Signals) -> None:
        self.sent.append(which)


def hello(prepared: Prepared, graph: Topology, name: str) -> NodeHello:
    """What a node of the session says first."""
    binds = {link.connector: "ipc:///s" for link in graph.links_of(name) if link.binder == name}
    return NodeHello(PROTOCOL_VERSION, prepared.id, prepared.session.name, name, graph.nodes[name], 1, binds)


class Heard:
    """A supervisor, its hub in memory, and its session brought to its first tick."""

    def __init__(self, prepared: Prepared, run: bool, remote: frozenset[str] = frozenset(), ticks: int = 0) -> None:
        ways = replace(IPC, remote=remote)
        self.supervisor = Supervisor(prepared, clock="realtime", reach=ways, ticks=ticks, record=True)
        self.graph = topology(prepared.session)
        self.transport = MemoryTransport()
        self.hub, _ = self.transport.bind_hub("control", [])
        observer_broadcast = self.supervisor._observer_broadcast
        self.supervisor.conductor.observers = observer_broadcast.serve(self.transport, Reach("ipc"), self.graph)
        self.processes = NoProcesses()
        if run:
            for name in self.graph.nodes:
                self.say(name, hello(prepared, self.graph, name))
            for name in self.graph.nodes:
                self.say(name, Ready())
            assert self.supervisor.conductor.phase is SessionPhase.RUNNING

    def say(self, sender: str, what: Message | bytes) -> None:
        frame = what if isinstance(what, bytes) else encode(what)
        self.supervisor.receive(sender, frame, self.hub, self.processes)  # type: ignore[arg-type]

    def progress(self) -> Progress:
        """How the session is."""
        return self.supervisor.progress(self.processes)  # type: ignore[arg-type]


@settings(max_examples=cases(30, 60))
@given(
    st.booleans(),
    st.lists(st.tuples(st.sampled_from(["dx", "cx", "environment", "watch", "stranger"]), said), max_size=12),
)
def test_no_message_is_an_error(prepared: Prepared, run: bool, conversation: list[tuple[str, Message | bytes]]) -> None:
    heard = Heard(prepared, run)
    shown = StringIO()
    console = Console(file=shown, width=200, force_terminal=True)
    table = LiveTable(console, "t", describe(prepared, "realtime", "ipc", 0))
    for sender, what in conversation:
        heard.say(sender, what)
        table(heard.progress())
        console.print(table._render(heard.progress()))
    outcome = heard.supervisor.outcome(None)
    assert json.loads(json.dumps(outcome.report, allow_nan=False)) == outcome.report
    print_report(console, outcome.report)
    assert set(outcome.report["nodes"]) <= set(heard.graph.nodes)
    assert set(heard.progress().telemetry) <= set(heard.graph.nodes)
    heard.transport.close()


def test_a_guest_that_joins_again_is_not_taken_for_silent(prepared: Prepared, monkeypatch: pytest.MonkeyPatch) -> None:
    """What its former process sent last is older than what the others have sent meanwhile."""
    heard = Heard(prepared, run=True, remote=frozenset({"dx"}))
    clock = heard.supervisor._clock
    started = clock.now()
    monkeypatch.setattr(clock, "now", lambda: Instant(started + from_seconds(60.0)))
    heard.say("dx", Telemetry(100, Figures(), {}))
    heard.say("dx", Report(100, Figures()))
    monkeypatch.setattr(clock, "now", lambda: Instant(started + from_seconds(70.0)))
    heard.say("environment", Telemetry(50_000, Figures(), {}))
    heard.say("cx", Offer("dx", "ipc:///t"))
    heard.say("dx", hello(prepared, heard.graph, "dx"))
    heard.say("dx", Ready())
    assert heard.progress().states["dx"] == "running"
    assert "dx" not in heard.progress().silent
    assert [row.who for row in heard.progress().promises if row.promise == "presence" and "dx" in row.who] == []
    heard.transport.close()


def test_the_report_is_about_all_processes_of_a_node(prepared: Prepared) -> None:
    """One that left with a report, one that fell silent, and one that ran to the end."""
    heard = Heard(prepared, run=True, remote=frozenset({"dx"}))
    heard.say("dx", Telemetry(100, Figures({names.LATE: 1.0, names.PEAK_FORCE: 3.0, names.LEDGER: 0.5}), {}))
    heard.say("dx", Report(110, Figures({names.LATE: 2.0, names.PEAK_FORCE: 4.0, names.CLIPPED: 7.0})))
    for endpoint, last in (("ipc:///t", False), ("ipc:///u", True)):
        heard.say("cx", Offer("dx", endpoint))
        heard.say("dx", hello(prepared, heard.graph, "dx"))
        heard.say("dx", Ready())
        heard.say("dx", Telemetry(200, Figures({names.LATE: 10.0, names.PEAK_FORCE: 1.0}), {}))
        if not last:
            heard.supervisor.carry_out(
                heard.supervisor.conductor.silent("dx", heard.supervisor._clock.now()), heard.hub, heard.processes
            )
    heard.say("dx", Report(300, Figures({names.LATE: 20.0, names.PEAK_FORCE: 2.0, names.TAU_BREACHES: 5.0})))
    entry = heard.supervisor.outcome(None).report["nodes"]["dx"]
    assert {key: entry[key] for key in ("late", "peak_force", "clipped", "tau_breaches")} == {
        "late": 2 + 10 + 20, "peak_force": 4.0, "clipped": 7, "tau_breaches": 5,
    }  # fmt: skip
    heard.transport.close()


@pytest.mark.parametrize("running", [True, False], ids=["running", "joining"])
def test_a_successor_that_knocks_keeps_no_dead_guest_alive(
    running: bool, prepared: Prepared, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A guest that was killed is joined again at once, under its own key: what that asks is no sign of the dead one."""
    heard = Heard(prepared, run=True, remote=frozenset({"dx"}))
    supervisor, clock, again = heard.supervisor, heard.supervisor._clock, hello(prepared, heard.graph, "dx")
    if not running:
        heard.say("dx", Report(100, Figures()))
        heard.say("cx", Offer("dx", "ipc:///t"))
        heard.say("dx", again)
        assert supervisor.conductor.comes_back("dx")
    died = clock.now()
    for second in range(30):
        monkeypatch.setattr(clock, "now", lambda at=second: Instant(died + from_seconds(float(at))))
        if supervisor._silent():
            break
        heard.say("dx", Fetch(0))
        heard.say("dx", replace(again, pid=2))
    assert supervisor._silent() == ["dx"]
    assert second == (3 if running else 23)
    heard.transport.close()


def test_a_guest_that_reports_impossible_ticks_has_left_after_those_that_were_seen(prepared: Prepared) -> None:
    """`[33, 2**63 - 1, {}, {}, {}]` on a guest's own line ended a timed session for everybody."""
    heard = Heard(prepared, run=True, remote=frozenset({"dx"}), ticks=60_000)
    heard.say("dx", Telemetry(100, Figures(), {}))
    heard.say("dx", Report(MAX_COUNT, Figures({names.LEDGER_MARGIN: -1.0})))
    conductor = heard.supervisor.conductor
    assert (conductor.phase, conductor.faults, conductor.finished) == (SessionPhase.RUNNING, [], ())
    assert [text.partition(": ")[2] for text in conductor.incidents.sentences] == ["dx left after 100 ticks"]
    assert conductor.left["dx"].ticks == 100
    assert [row.promise for row in missed(heard.progress().promises)] == ["presence"]  # and not what it says of energy
    heard.transport.close()


def test_what_is_kept_of_strangers_does_not_grow(prepared: Prepared) -> None:
    """Without keys anybody may invent names, and go on inventing."""
    heard = Heard(prepared, run=True)

    def kept() -> dict[str, int]:
        inside: dict[str, Any] = {**vars(heard.supervisor), **vars(heard.supervisor.conductor)}
        return {name: len(value) for name, value in inside.items() if hasattr(value, "__len__")}

    before = kept()
    hello = NodeHello(PROTOCOL_VERSION, prepared.id, "example-1", "dx", Role.DEVICE, 1, {})
    for number in range(200):
        for what in (hello, Telemetry(1, Figures({"speed": 0.5}), {}), Report(1, Figures()), Fault("f"), b"junk"):
            heard.say(f"stranger{number}", what)
    assert kept() == before
    assert heard.supervisor.conductor.ignored == 1000
    assert heard.processes.sent == []
    heard.transport.close()


@pytest.mark.parametrize("sender", ["dx", "cx"])
def test_telemetry_out_of_turn_is_not_taken(prepared: Prepared, sender: str) -> None:
    """Before its session runs, and after its last word."""
    early = Heard(prepared, run=False)
    early.say(sender, Telemetry(1, Figures({"speed": 0.5}), {}))
    assert early.progress().telemetry == {}
    assert early.supervisor.conductor.ignored == 1
    late = Heard(prepared, run=True)
    late.say(sender, Telemetry(1, Figures({"speed": 0.5}), {}))
    late.say(sender, Report(1, Figures()))
    late.say(sender, Telemetry(2, Figures({"speed": 0.75}), {}))
    assert late.progress().telemetry[sender].tick == 1
    for heard in (early, late):
        heard.transport.close()


@pytest.mark.parametrize(
    ("elapsed", "clock", "ticks", "most"),
    [
        (0.0, REALTIME, 0, 1000),  # a second's worth is allowed from the first moment on
        (10.0, REALTIME, 0, 11100),
        (10.0, REALTIME, 5000, 5000),
        (10.0, REALTIME, 20000, 11100),
        (0.0, SIMULATED, 0, 100_000),
        (1.0, SIMULATED, 0, 200_000),
        (1.0, SIMULATED, 300, 300),
    ],
)
def test_the_most_ticks_that_can_have_run(elapsed: float, clock: str, ticks: int, most: int) -> None:
    assert most_ticks(from_seconds(elapsed), 0.001, clock, ticks) == pytest.approx(most, abs=1)


def test_an_impossible_tick_is_refused_counted_and_moves_nothing(prepared: Prepared) -> None:
    """One frame from one guest with a valid key; its tick is a hundred years of the session's time."""
    heard = Heard(prepared, run=True)
    rows = {names.DISPLACEMENT: np.ones((10, 1)), names.FORCE: np.ones((10, 1))}
    for device in ("dx", "dy", "dz"):
        heard.say(device, Telemetry(10, Figures({"speed": 0.5}), rows))
    for tick in (10**11, 500_000):
        for node in ("dy", "environment"):
            heard.say(node, Telemetry(tick, Figures({"speed": 0.75}), rows if node == "dy" else {}))
    heard.say("dy", Report(10**11, Figures()))
    supervisor = heard.supervisor
    supervisor._tally(heard.hub, heard.transport)  # type: ignore[arg-type]
    assert heard.progress().refused["telemetry_that_does_not_fit"] == 5
    assert heard.progress().telemetry["dy"].tick == 10
    outcome = supervisor.outcome(None)
    assert outcome.recording is not None
    assert outcome.recording.x.shape == (10, 3)
    assert outcome.lost == {}
    assert outcome.report["duration"] <= 1.1
    heard.transport.close()


def test_a_guest_without_telemetry_loses_its_rows_alone_as_reported(prepared: Prepared) -> None:
    heard = Heard(prepared, run=True)
    rows = {names.DISPLACEMENT: np.ones((10, 1)), names.FORCE: np.ones((10, 1))}
    for device in ("dx", "dz"):
        heard.say(device, Telemetry(10, Figures({"speed": 0.5}), rows))
    outcome = heard.supervisor.outcome(None)
    assert outcome.recording is not None
    np.testing.assert_array_equal(outcome.recording.x, [[1.0, np.nan, 1.0]] * 10)
    assert outcome.lost == outcome.recording.missing == {"dy": 10}
    heard.transport.close()


def test_nobody_is_away_where_all_stand_still_or_are_done(prepared: Prepared, monkeypatch: pytest.MonkeyPatch) -> None:
    """Silence by the wall clock: a slow simulation, or a node that ends slowly, is as silent as one who is away."""
    monkeypatch.setattr(supervisor_module, "TELEMETRY_SILENCE", Duration(-1))  # every node is silent at once
    heard = Heard(prepared, run=True)
    nodes = {*heard.graph.nodes}
    assert heard.progress().silent == nodes
    for node in nodes - {"dx", "cx"}:
        heard.say(node, Telemetry(400, Figures(), {}))
    assert heard.progress().silent == nodes
    assert [row for row in missed(heard.progress().promises) if row.promise == "presence"] == []
    for node in nodes - {"dx"}:
        heard.say(node, Telemetry(600, Figures(), {}))
    [away] = [row for row in missed(heard.progress().promises) if row.promise == "presence"]
    assert (away.who, away.state, away.until) == (("dx",), "broken", None)
    heard.say("dx", Telemetry(600, Figures(), {}))
    [back] = [row for row in missed(heard.progress().promises) if row.promise == "presence"]
    assert back.until == 0.6
    heard.transport.close()
