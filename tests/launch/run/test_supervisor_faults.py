"""The supervisor's actions in a faulty session: restarts, softened couplings, silence shown, incidents."""

from __future__ import annotations

import os
import select
import signal
import socket
from collections.abc import Iterator
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from manyhands.launch.look.live import LiveTable
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import IPC
from manyhands.launch.plan.topology import topology
from manyhands.launch.run.breaches import CertifiedLadder
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.processes import Processes
from manyhands.launch.run.states import MOST_KEPT, Incidents, NodeState, SessionPhase
from manyhands.launch.run.supervisor import REFRESH, TELEMETRY_SILENCE, LastMessages, Listening, Supervisor
from manyhands.launch.session import load_session
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Figures,
    Message,
    NodeHello,
    Offer,
    Ready,
    Role,
    Shift,
    Telemetry,
)
from manyhands.protocol.transport import Link
from tests.support.memory_transport import MemoryTransport

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"


class FakeProcesses:
    """Processes whose starts are noted, and nothing more."""

    def __init__(self) -> None:
        self.pids: dict[str, int] = {}
        self.started: list[tuple[str, str]] = []
        self.killed: list[str] = []
        self.sent: list[signal.Signals] = []
        self.refusal: OSError | None = None

    def start(self, nodes: list[str], role: Role, bundles: list[Path], processor: int | None = None) -> None:
        if self.refusal is not None:
            raise self.refusal
        for node, bundle in zip(nodes, bundles, strict=True):
            self.started.append((node, bundle.name))
            self.pids[node] = len(self.started)

    def kill(self, name: str) -> None:
        self.killed.append(name)

    def send(self, which: signal.Signals) -> None:
        self.sent.append(which)


class StoppedClock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.at = 0

    def now(self) -> Instant:
        return Instant(self.at)


class Faulty:
    """A supervisor of a session that runs, its hub in memory, and the environment's line to it."""

    def __init__(self, prepared: Prepared, clock: str = "realtime") -> None:
        self.supervisor = Supervisor(prepared, clock=clock, reach=IPC, ticks=0, record=False)
        self.clock = StoppedClock()
        self.supervisor._clock = self.clock  # type: ignore[assignment]
        self.supervisor._listening = Listening(self.clock.now())
        self.conductor = self.supervisor.conductor
        self.graph = topology(prepared.session)
        self.transport = MemoryTransport()
        self.hub, endpoint = self.transport.bind_hub("control", [])
        self.environment: Link = self.transport.join(endpoint, "environment")
        self.processes = FakeProcesses()
        self.id = prepared.id
        for name in self.graph.nodes:
            self.say(name, self.hello(name, 1))
        for name in self.graph.nodes:
            self.say(name, Ready())
        assert self.conductor.phase is SessionPhase.RUNNING

    def hello(self, name: str, pid: int) -> NodeHello:
        binds = {link.connector: f"ipc:///s/{name}" for link in self.graph.links_of(name) if link.binder == name}
        return NodeHello(PROTOCOL_VERSION, self.id, "example-1", name, self.graph.nodes[name], pid, binds)

    def say(self, sender: str, message: Message) -> None:
        self.supervisor.receive(sender, encode(message), self.hub, self.processes)  # type: ignore[arg-type]

    def tell(self, tick: int, elapsed: float) -> None:
        """Every node tells its telemetry up to ``tick``, ``elapsed`` s after tick 0 by its own clock."""
        for name in self.graph.nodes:
            self.say(name, Telemetry(tick, Figures({names.ELAPSED: 1e6 * elapsed}), {}))

    def dies(self, node: str) -> None:
        told = self.conductor.exited(node, -9, self.clock.at)
        self.supervisor.carry_out(told, self.hub, self.processes)  # type: ignore[arg-type]

    def told(self) -> list[object]:
        """The messages to the environment since the last call."""
        out: list[object] = []
        while (frame := self.environment.recv(Duration(0))) is not None:
            out.append(decode(frame, MAX_CONTROL_BYTES))
        return out

    def breaches(self, device: str) -> None:
        """Three messages of a device that is too slow from the first on."""
        for message in (1, 2, 3):
            figures = {names.TAU_BREACHES: 90.0 * message, names.TAU_WORST: 300.0}
            self.say(device, Telemetry(100 * message, Figures(figures), {}))
            self.say("environment", Telemetry(100 * message, Figures(), {}))  # no wait occurred

    def progress(self) -> Progress:
        return self.supervisor.progress(self.processes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml"))


@pytest.fixture
def faulty(prepared: Prepared) -> Iterator[Faulty]:
    made = Faulty(prepared)
    yield made
    made.transport.close()


def test_a_process_restarts_from_its_bundle_without_its_predecessors_messages(faulty: Faulty) -> None:
    faulty.say("dx", Telemetry(100, Figures({"speed": 0.5}), {}))
    assert "dx" in faulty.progress().telemetry
    faulty.dies("dx")
    assert faulty.processes.started == []
    faulty.say("cx", Offer("dx", "ipc:///s/anew"))
    assert faulty.processes.started == [("dx", "dx.bundle")]
    assert "dx" not in faulty.progress().telemetry
    faulty.say("dx", faulty.hello("dx", 99))
    assert faulty.conductor.states["dx"] is NodeState.STARTING  # that was another process
    faulty.say("dx", faulty.hello("dx", faulty.processes.pids["dx"]))
    faulty.say("dx", Ready())
    assert faulty.conductor.states["dx"] is NodeState.RUNNING
    outcome = faulty.supervisor.outcome(None)
    assert outcome.code == 0
    assert [one.split("s: ")[1] for one in outcome.incidents] == [
        "dx was killed by SIGKILL while running",
        "dx is back",
    ]
    assert outcome.report["incidents"] == list(outcome.incidents)


def test_a_machine_without_processes_uses_up_the_budget_and_no_more(faulty: Faulty) -> None:
    faulty.processes.refusal = BlockingIOError(11, "Resource temporarily unavailable")
    faulty.dies("dx")
    faulty.say("cx", Offer("dx", "ipc:///s/anew"))
    assert faulty.conductor.states["dx"] is NodeState.GONE
    assert faulty.conductor.phase is SessionPhase.RUNNING
    outcome = faulty.supervisor.outcome(None)
    assert outcome.code == 1
    assert "dx could not be started (Resource temporarily unavailable)" in outcome.faults[0]


def test_a_process_that_cannot_return_is_killed(faulty: Faulty) -> None:
    faulty.dies("dx")
    faulty.say("cx", Offer("dx", "ipc:///s/anew"))
    faulty.clock.at = 10**12
    faulty.supervisor.carry_out(faulty.conductor.look(faulty.clock.at), faulty.hub, faulty.processes)  # type: ignore[arg-type]
    assert faulty.processes.killed == ["dx"]


class Test_a_node_that_waits_for_the_others_of_its_process:
    """It has no process, so none of its own can end: the supervisor reports it in place of an end."""

    @pytest.fixture
    def waiting(self) -> Iterator[Faulty]:
        """dx and cx share a process, and dx is to be started while cx waits for the environment's offer."""
        made = Faulty(prepare(load_session(SESSIONS / "example1.yaml", ["colocate=true"])))
        assert made.graph.together("dx") == ("dx", "cx")
        made.dies("cx")
        made.dies("dx")
        assert made.conductor.states["dx"] is NodeState.STARTING
        assert made.processes.started == []
        yield made
        made.transport.close()

    def test_is_no_reason_for_a_session_to_stay(self, waiting: Faulty) -> None:
        supervisor, hub, processes = waiting.supervisor, waiting.hub, waiting.processes
        supervisor.carry_out(waiting.conductor.interrupt(), hub, processes)  # type: ignore[arg-type]
        for node, state in list(waiting.conductor.states.items()):
            if state is NodeState.RUNNING:
                waiting.dies(node)
        assert waiting.conductor.phase is SessionPhase.OVER

    def test_is_given_up_when_they_never_come(self, waiting: Faulty) -> None:
        waiting.clock.at = 10**12
        told = waiting.conductor.look(waiting.clock.at)
        waiting.supervisor.carry_out(told, waiting.hub, waiting.processes)  # type: ignore[arg-type]
        assert waiting.conductor.states["dx"] is not NodeState.LEAVING  # no end of a process is to come
        waiting.say("environment", Offer("cx", "ipc:///s/anew"))
        assert waiting.processes.started == [("dx", "dx.bundle"), ("cx", "cx.bundle")]

    def test_is_reported_with_them_when_the_process_cannot_be_started(self, waiting: Faulty) -> None:
        waiting.processes.refusal = BlockingIOError(11, "Resource temporarily unavailable")
        waiting.say("environment", Offer("cx", "ipc:///s/anew"))
        assert {waiting.conductor.states[node] for node in ("dx", "cx")} == {NodeState.GONE}


class Test_a_slow_device:
    def test_has_its_couplings_softened(self, faulty: Faulty, prepared: Prepared) -> None:
        ladder: CertifiedLadder | None = prepared.ladder
        assert ladder is not None
        rung = next(r for r, tau in enumerate(ladder.taus) if tau >= 300e-6)
        faulty.told()
        faulty.breaches("dx")
        expected = ["cx"] if ladder.independent else ["cx", "cy", "cz"]
        assert faulty.told() == [Shift(coupling, rung) for coupling in expected]
        (notice,) = faulty.progress().notices
        assert f"to what is certified for {1e3 * ladder.taus[rung]:.3g} ms: {', '.join(expected)};" in notice
        faulty.breaches("dx")
        assert faulty.told() == []  # once

    def test_ends_the_session_where_that_is_wished(self, prepared: Prepared) -> None:
        session = load_session(SESSIONS / "example1.yaml", ["faults.breach=stop"])
        stopped = Faulty(Prepared(session, prepared.loop, prepared.blocks, prepared.id, prepared.parts))
        stopped.breaches("dx")
        assert stopped.conductor.phase is SessionPhase.ENDING
        assert stopped.processes.sent == [signal.SIGTERM]
        assert stopped.supervisor.outcome(None).code == 1
        stopped.transport.close()

    def test_is_not_slow_under_the_simulated_clock(self, prepared: Prepared) -> None:
        simulated = Faulty(prepared, "simulated")
        simulated.told()
        simulated.breaches("dx")
        assert simulated.told() == []
        assert simulated.progress().notices == ()
        simulated.transport.close()


class Test_silence:
    def test_is_shown_after_a_second_and_no_longer_than_it_lasts(self, faulty: Faulty) -> None:
        assert faulty.progress().silent == frozenset()
        faulty.clock.at = TELEMETRY_SILENCE
        faulty.say("dx", Telemetry(1, Figures(), {}))
        faulty.clock.at = TELEMETRY_SILENCE + 1
        assert faulty.progress().silent == set(faulty.graph.nodes) - {"dx"}
        faulty.say("cx", Telemetry(1, Figures(), {}))
        assert "cx" not in faulty.progress().silent
        assert faulty.conductor.incidents.total == 0  # nothing is done about it

    def test_is_not_shown_for_a_lost_or_just_returned_node(self, faulty: Faulty) -> None:
        faulty.say("dx", Telemetry(1, Figures(), {}))
        faulty.dies("dx")
        faulty.clock.at = 10 * TELEMETRY_SILENCE
        assert "dx" not in faulty.progress().silent
        faulty.say("cx", Offer("dx", "ipc:///s/anew"))
        faulty.say("dx", faulty.hello("dx", 1))
        faulty.say("dx", Ready())
        assert "dx" not in faulty.progress().silent


def test_the_table_shows_lost_nodes_silent_nodes_and_incidents(faulty: Faulty) -> None:
    shown = StringIO()
    console = Console(file=shown, width=220, force_terminal=True)
    table = LiveTable(console, "t", faulty.supervisor._about)
    for name in faulty.graph.nodes:
        faulty.say(name, Telemetry(100, Figures({names.RUNG: 2.0, names.FROZEN: 1.0}), {}))
    faulty.progress()
    faulty.dies("dx")
    faulty.clock.at = 2 * TELEMETRY_SILENCE
    faulty.say("dy", Telemetry(200, Figures(), {}))
    console.print(table._render(faulty.progress()))
    rows = {line.split()[0]: line for line in shown.getvalue().splitlines() if line.startswith(" ") and line.strip()}
    assert "lost" in rows["dx"]
    assert "silent" in rows["cx"]
    assert "silent" not in rows["dy"]
    assert "dx was killed by SIGKILL while running" in shown.getvalue()


def test_lines_tell_each_incident_once(faulty: Faulty) -> None:
    shown = StringIO()
    table = LiveTable(Console(file=shown, width=220), "t", faulty.supervisor._about)
    faulty.dies("dx")
    for _ in range(3):
        table(faulty.progress())
    faulty.dies("dy")
    table(faulty.progress())
    lines = [line for line in shown.getvalue().splitlines() if line.startswith("! ")]
    assert [line.split("s: ")[1].split()[0] for line in lines] == ["dx", "dy"]


def test_a_session_slower_than_its_period_reports_so_once_and_at_once(faulty: Faulty) -> None:
    shown = StringIO()
    table = LiveTable(Console(file=shown, width=220), "t", faulty.supervisor._about)
    faulty.supervisor._began = Instant(0)
    for second in range(1, 30):
        faulty.clock.at = second * 10**9
        faulty.tell(250 * second, float(second))
        table(faulty.progress())
    outcome = faulty.supervisor.outcome(None)
    [notice] = outcome.notices
    assert "0.25 of real time, 250 of 1000 ticks a second" in notice
    assert shown.getvalue().count(notice) == 1
    assert table.announced == {notice}
    [row] = [row for row in outcome.report["promises"] if row["promise"] == "pace" and row["state"] == "broken"]
    assert row["cost"] == pytest.approx({"x": 0.25, "s": 0.75 * 28})
    assert outcome.code == 0  # nobody promised a rate to the certificate


def test_a_supervisor_without_a_turn_says_nothing_of_the_sessions_pace(faulty: Faulty) -> None:
    """For three seconds it reads nothing; then it looks before the first frame is there, and in the midst of them."""
    faulty.supervisor._began = Instant(0)
    for tick in range(100, 4001, 100):
        faulty.clock.at = tick * 10**6
        faulty.tell(tick, tick / 1000)
    faulty.clock.at = 7 * 10**9
    faulty.supervisor._listening.turn(faulty.clock.now(), True)  # its transport has not delivered yet
    told = [faulty.progress()]
    for tick in range(4100, 7001, 100):
        faulty.tell(tick, tick / 1000 + 0.008)
        told.append(faulty.progress())
    assert {row.state for progress in told for row in progress.promises if row.promise == "pace"} == {"kept"}
    assert faulty.supervisor.outcome(None).notices == ()


def test_a_session_of_which_nothing_comes_while_the_supervisor_listens_has_no_pace(faulty: Faulty) -> None:
    faulty.tell(100, 0.1)
    for _ in range(10):
        faulty.clock.at += REFRESH
        faulty.supervisor._listening.turn(faulty.clock.now(), True)
    states = {row.state for row in faulty.progress().promises if row.promise == "pace"}
    assert states == {"kept", "broken"}


@pytest.mark.parametrize(
    ("turns", "unheard"),
    [
        ([(0.2, True), (0.2, True)], 0.4),
        ([(0.2, True), (5.0, True)], 0.45),  # it had no turn
        ([(0.2, False), (0.2, True)], 0.2),  # something was left to be read
        ([], 0.0),
    ],
)
def test_only_what_a_supervisor_has_listened_for_counts_as_silence(
    turns: list[tuple[float, bool]], unheard: float
) -> None:
    now = Instant(7)
    listening = Listening(now)
    for time, empty in turns:
        now = Instant(now + from_seconds(time))
        listening.turn(now, empty)
    assert listening.unheard == from_seconds(unheard)
    listening.hear()
    assert listening.unheard == 0


def test_a_dead_node_is_named_since_its_death_in_the_sessions_time(faulty: Faulty) -> None:
    for name in faulty.graph.nodes:
        faulty.say(name, Telemetry(900, Figures(), {}))
    faulty.dies("dx")
    [row] = [row for row in faulty.progress().promises if row.promise == "presence" and row.state == "broken"]
    assert (row.who, row.since, row.remark) == (("dx",), 0.9, "dx: lost")


def test_incidents_are_bounded_and_what_is_left_out_is_counted() -> None:
    incidents = Incidents()
    for number in range(MOST_KEPT + 5):
        incidents.add(f"number {number}")
    assert len(incidents.sentences) == MOST_KEPT + 1
    assert incidents.sentences[0] == "5 earlier incidents"
    assert incidents.sentences[-1] == f"number {MOST_KEPT + 4}"
    assert incidents.total == MOST_KEPT + 5


def test_attention() -> None:
    last_messages = LastMessages()
    assert last_messages.quiet(["a"], Instant(5), Duration(10)) == []  # heard of now, for the first time
    last_messages.note("b", Instant(10))
    assert last_messages.quiet(["a", "b"], Instant(16), Duration(10)) == ["a"]
    last_messages.forget("a")
    assert last_messages.quiet(["a", "b"], Instant(20), Duration(10)) == []


def test_a_killed_processs_log_goes_on_with_the_next(tmp_path: Path) -> None:
    processes = Processes(tmp_path)
    try:
        for _ in range(2):
            processes.start(["dx"], Role.DEVICE, [tmp_path / "missing.bundle"])
            assert _ends(processes) == {"dx": 2}
        assert processes.log("dx").count("missing.bundle") == 2
        processes.start(["dx"], Role.DEVICE, [tmp_path / "missing.bundle"])
        os.kill(processes.pids["dx"], signal.SIGSTOP)  # before it can find out that there is no bundle
        processes.start(["dy"], Role.DEVICE, [tmp_path / "missing.bundle"])
        processes.kill("dx")
        processes.kill("nobody")
        codes = _ends(processes)
        codes |= {} if len(codes) == 2 else _ends(processes)
        assert codes == {"dx": -9, "dy": 2}
        processes.kill("dx")  # it has ended already
    finally:
        processes.end_all()


def test_what_a_killed_process_has_bound_is_free_for_the_next(tmp_path: Path) -> None:
    """Its own sockets and nothing else: not its bundle, and not those of one whose name begins alike."""
    for name in ("cx-dx", "cx-dx.1", "cx2-dx", "environment-cx"):
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(str(tmp_path / name))
    (tmp_path / "cx-notes").touch()
    processes = Processes(tmp_path)
    try:
        processes.start(["cx"], Role.COUPLING, [tmp_path / "missing.bundle"])
        assert _ends(processes) == {"cx": 2}
    finally:
        processes.end_all()
    assert {path.name for path in tmp_path.iterdir()} == {"cx.log", "cx-notes", "cx2-dx", "environment-cx"}


def _ends(processes: Processes) -> dict[str, int]:
    """The ends of some processes, which their descriptors announce."""
    return processes.reap(set(select.select(processes.fds, [], [], 60.0)[0]))
