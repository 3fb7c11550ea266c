"""The supervisor's decisions without a process: every event in, every instruction out."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from manyhands.launch.plan.topology import Topology, topology
from manyhands.launch.run.conductor import Conductor
from manyhands.launch.run.recovery import Restarts
from manyhands.launch.run.states import Kill, NodeState, ReleaseName, Send, SessionPhase, Terminate
from manyhands.launch.session import load_session
from manyhands.protocol.codec import ForeignHello, Malformed
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Connect,
    Echo,
    Fault,
    Figures,
    NodeHello,
    Offer,
    Probe,
    Ready,
    Refusal,
    RefusalCode,
    Report,
    Role,
    Start,
    Stop,
    Telemetry,
    Welcome,
)

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
GRAPH: Topology = topology(load_session(SESSIONS / "example1.yaml"))
REPORT = Report(5, Figures())


def hello(sender: str, **changes: object) -> NodeHello:
    binds = {link.connector: f"ipc://{sender}-{link.connector}" for link in GRAPH.links if link.binder == sender}
    fields = {"version": PROTOCOL_VERSION, "certificate": "c", "session": "example-1", "name": sender,
              "role": GRAPH.nodes[sender], "pid": 1, "endpoints": binds}  # fmt: skip
    return NodeHello(**{**fields, **changes})  # type: ignore[arg-type]


def conductor(*remote: str, ticks: int = 5, restarts: int = 0, together: bool = False) -> Conductor:
    observers = {"watch": "ipc:///s/watch", "scope": "ipc:///s/scope"}
    budget = Restarts(restarts)
    return Conductor(GRAPH, "c", "example-1", ticks, frozenset(remote), observers, budget, together)


def running(*remote: str, ticks: int = 5, restarts: int = 0, together: bool = False) -> Conductor:
    c = conductor(*remote, ticks=ticks, restarts=restarts, together=together)
    for name in GRAPH.nodes:
        c.receive(name, hello(name), 0)
    for name in GRAPH.nodes:
        c.receive(name, Ready(), 0)
    assert c.phase is SessionPhase.RUNNING
    return c


def test_a_good_run_from_hello_to_the_last_exit() -> None:
    c = conductor()
    names = list(GRAPH.nodes)
    for name in names[:-1]:
        assert c.receive(name, hello(name), 0) == [Send(name, Welcome())]
    last = c.receive(names[-1], hello(names[-1]), 0)
    connects = {i.node: i.message for i in last if isinstance(i, Send) and isinstance(i.message, Connect)}
    assert connects["dx"] == Connect({"cx": "ipc://cx-dx"})
    assert connects["cx"] == Connect({"environment": "ipc://environment-cx"})
    assert connects["environment"] == Connect({})
    for name in names[:-1]:
        assert c.receive(name, Ready(), 1000) == []
    starts = c.receive(names[-1], Ready(), 1000)
    assert {i.node for i in starts if isinstance(i, Send)} == set(names)
    first = starts[0]
    assert isinstance(first, Send)
    assert isinstance(first.message, Start)
    assert first.message.epoch > 1000
    assert first.message.ticks == 5
    for name in names:
        assert c.receive(name, Telemetry(1, Figures(), {}), 0) == []
        assert c.receive(name, REPORT, 0) == [Send(name, Stop("reported"))]
        assert c.exited(name, 0, 0) == []
    assert c.phase is SessionPhase.OVER
    assert c.faults == []
    assert set(c.reports) == set(names)


@pytest.mark.parametrize("state", ["starting", "running"])
@pytest.mark.parametrize(("code", "words"), [(-9, "was killed by SIGKILL"), (1, "ended with exit code 1")])
def test_a_node_that_dies_ends_the_session(state: str, code: int, words: str) -> None:
    c = running() if state == "running" else conductor()
    assert c.exited("cy", code, 0) == [Terminate()]
    assert c.phase is SessionPhase.ENDING
    assert c.faults == [f"cy {words} while {state}"]
    for name in GRAPH.nodes:
        if name != "cy":
            assert c.exited(name, -15, 0) == []  # asked to end: no fault of theirs
    assert c.phase is SessionPhase.OVER
    assert len(c.faults) == 1


def test_an_early_end_without_report_is_a_fault_despite_exit_0() -> None:
    c = running()
    assert c.exited("dx", 0, 0) == [Terminate()]
    assert "ended with exit code 0 while running" in c.faults[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": 1}, f"found protocol version 1; expected {PROTOCOL_VERSION}"),
        ({"certificate": "other"}, "found the certificate other; expected c"),
        ({"session": "else"}, "found the session else"),
        ({"role": Role.DEVICE}, "found the role device; expected coupling"),
        ({"name": "cz"}, "supervisor refused cx: found the name cz from cx; expected its own"),
        ({"name": "dx", "role": Role.DEVICE}, "supervisor refused cx: found the name dx from cx; expected its own"),
        ({"endpoints": {}}, "found endpoints for none; expected them for dx"),
        ({"endpoints": {"dx": "ipc://a", "dy": "ipc://b"}}, "found endpoints for dx, dy; expected them for dx"),
        ({"endpoints": {"dy": "ipc://b"}}, "found endpoints for dy; expected them for dx"),
    ],
)
def test_a_foreign_node_is_refused_with_the_reason(changes: dict[str, object], words: str) -> None:
    c = conductor()
    out = c.receive("cx", hello("cx", **changes), 0)
    first = out[0]
    assert isinstance(first, Send)
    assert isinstance(first.message, Refusal)
    assert out[1:] == [Terminate()]
    assert any(words in fault for fault in c.faults)


def test_a_node_of_another_protocol_is_refused() -> None:
    c = conductor()
    assert Terminate() in c.receive("cx", ForeignHello(7), 0)
    assert f"found protocol version 7; expected {PROTOCOL_VERSION}" in c.faults[0]


def test_what_is_out_of_turn_is_counted_and_changes_nothing() -> None:
    c = running()
    before = dict(c.states)
    for sender, message in (
        ("dx", Ready()),
        ("dx", hello("dx")),
        ("dx", Malformed("junk")),
        ("stranger", REPORT),
        ("dx", Start(0, 1)),
    ):
        assert c.receive(sender, message, 0) == []
    assert c.states == before
    assert c.ignored == 5


def test_a_strangers_hello_is_refused_and_the_session_goes_on() -> None:
    c = conductor()
    (out,) = c.receive("stranger", hello("dx", name="stranger"), 0)
    assert isinstance(out, Send)
    assert isinstance(out.message, Refusal)
    assert c.faults == []
    assert c.phase is SessionPhase.STARTING


def test_ctrl_c_asks_all_to_end_and_a_second_one_kills() -> None:
    c = running()
    assert c.interrupt() == [Terminate()]
    assert c.interrupt() == [Kill()]  # asked twice
    for name in GRAPH.nodes:
        assert c.receive(name, REPORT, 0) == [Send(name, Stop("reported"))]
        c.exited(name, 0, 0)
    assert c.phase is SessionPhase.OVER
    assert c.faults == []


def test_a_slow_start_names_missing_nodes_and_stubborn_processes_are_killed() -> None:
    c = conductor()
    c.receive("dx", hello("dx"), 0)
    assert c.too_late() == [Terminate()]
    assert "dx (connecting)" in c.faults[0]
    assert "environment (starting)" in c.faults[0]
    assert c.too_late() == [Kill()]
    assert c.incidents.sentences == (f"did not end when the session did, and was killed: {', '.join(GRAPH.nodes)}",)
    assert running().too_late() == []


def test_a_fault_and_the_exit_after_it_count_once() -> None:
    c = running()
    assert c.receive("cx", Fault("cx: no more"), 0) == [Send("cx", Stop("received")), Terminate()]
    assert c.states["cx"] is NodeState.FAULTED
    assert c.exited("cx", 4, 0) == []
    assert c.faults == ["cx: no more"]


@pytest.mark.parametrize("of", ["dz", "dx"], ids=["of ours", "elsewhere"])
def test_a_last_word_that_is_repeated_is_answered_again_and_counts_once(of: str) -> None:
    c = running("dx")
    for name in GRAPH.nodes:
        c.receive(name, REPORT, 0)
    assert c.receive(of, REPORT, 0) == [Send(of, Stop("received"))]
    assert (c.ignored, c.faults, c.reports[of]) == (0, [], REPORT)


@pytest.mark.parametrize(("restarts", "together"), [(3, True), (0, False)])
def test_a_device_that_fails_ends_a_session_that_stays_together_or_restarts_nobody(
    restarts: int, together: bool
) -> None:
    c = running(restarts=restarts, together=together)
    assert c.receive("dx", Fault("dx: unplugged"), 0) == [Send("dx", Stop("received")), Terminate()]
    assert c.faults == ["dx: unplugged"]


def test_the_clock_is_answered_from_the_welcome_to_the_report() -> None:
    c = conductor("dx")
    assert c.receive("dx", Probe(7), 100) == []  # a stranger as yet
    for name in GRAPH.nodes:
        c.receive(name, hello(name), 0)
    assert c.receive("dx", Probe(7), 100) == [Send("dx", Echo(7, 100, 100))]
    assert c.receive("dx", Probe(8), 200) == [Send("dx", Echo(8, 200, 200))]
    c.receive("dx", Ready(), 0)
    assert c.receive("dx", Probe(9), 300) == [Send("dx", Echo(9, 300, 300))]
    assert c.ignored == 1
    c = running("dx")
    assert c.receive("dx", Probe(9), 300) == [Send("dx", Echo(9, 300, 300))]
    c.receive("dx", REPORT, 0)
    assert c.receive("dx", Probe(9), 300) == []
    assert c.ignored == 1


def test_a_coupling_that_runs_is_told_the_round_trip_of_its_wave_link() -> None:
    """A guest has a hand in that figure, and may claim any; it is told its own alone."""
    c = conductor("cx", "dx")
    c.note_round_trip("cx", 0.04)
    for name in GRAPH.nodes:
        c.receive(name, hello(name), 0)
    assert c.receive("cx", Probe(7), 100) == [Send("cx", Echo(7, 100, 100, None))]
    for name in GRAPH.nodes:
        c.receive(name, Ready(), 0)
    assert c.receive("cx", Probe(8), 200) == [Send("cx", Echo(8, 200, 200, 0.04))]
    assert c.receive("dx", Probe(8), 200) == [Send("dx", Echo(8, 200, 200, None))]
    for R in (math.nan, -0.04, 0.0, 60.5, math.inf):
        c.note_round_trip("cx", 0.04)
        c.note_round_trip("cx", R)
        (told,) = c.receive("cx", Probe(9), 300)
        assert told == Send("cx", Echo(9, 300, 300, None))


@pytest.mark.parametrize("ticks", [5, 0])
def test_a_node_that_leaves_early_ends_the_session(ticks: int) -> None:
    """The others would wait for its next signal for ever."""
    c = running(ticks=ticks)
    report = Report(4, Figures())
    assert c.receive("dx", report, 0) == [Send("dx", Stop("reported")), Terminate()]
    assert c.phase is SessionPhase.ENDING
    assert c.faults == ["dx left after 4 ticks, before the session was over"]
    for name in GRAPH.nodes:
        assert c.exited(name, 0, 0) == []
    assert c.phase is SessionPhase.OVER
    assert len(c.faults) == 1
    assert c.reports == {"dx": report}


def test_what_a_guest_reports_of_itself_ends_nobody_elses_session() -> None:
    """Its last word starts no clock that runs out for the others; that of the environment, or of a local node, does."""
    c = running("dx", restarts=1)
    c.receive("dx", Report(2**63 - 1, Figures()), 0)
    assert (c.finished, c.too_late(), c.phase, c.faults) == ((), [], SessionPhase.RUNNING, [])
    c.receive("dy", Report(5, Figures()), 0)
    assert c.finished == ("dy",)


@pytest.mark.parametrize("ticks", [5, 0])
def test_others_go_on_when_a_guest_leaves_and_it_may_return(ticks: int) -> None:
    c = running("dx", ticks=ticks, restarts=1)
    report = Report(4, Figures())
    assert c.receive("dx", report, 0) == [Send("dx", Stop("reported")), ReleaseName("dx"), Send("cx", Absent("dx"))]
    assert (c.phase, c.states["dx"], c.faults) == (SessionPhase.RUNNING, NodeState.LOST, [])
    assert c.incidents.sentences == ("at 0.0 s: dx left after 4 ticks",)
    assert (c.left, c.reports) == ({"dx": report}, {})  # the session does not wait for the others, too
    c.receive("cx", Offer("dx", "ipc://cx-dx.1"), 0)
    assert c.receive("dx", hello("dx"), 0) == [Send("dx", Welcome()), Send("dx", Connect({"cx": "ipc://cx-dx.1"}))]
    c.receive("dx", Ready(), 0)
    assert c.states["dx"] is NodeState.RUNNING
    c.receive("dx", report, 0)  # a second time is once too often
    assert c.states["dx"] is NodeState.GONE
    assert c.phase is SessionPhase.RUNNING
    assert len(c.faults) == 1


@pytest.mark.parametrize(("restarts", "together"), [(0, False), (3, True)])
def test_a_leaving_guest_ends_sessions_that_stay_together_or_restart_nobody(restarts: int, together: bool) -> None:
    c = running("dx", restarts=restarts, together=together)
    c.receive("dx", Report(4, Figures()), 0)
    assert c.phase is SessionPhase.ENDING
    assert c.faults == ["dx left after 4 ticks, before the session was over"]


def test_a_guest_that_ends_while_others_are_awaited_may_join_again() -> None:
    c = conductor("dx", "dy")
    c.receive("dx", hello("dx"), 0)
    assert c.awaited == ("dy",)
    assert c.receive("dx", Fault("dx: its user ended it"), 0) == [Send("dx", Stop("received")), ReleaseName("dx")]
    assert (c.phase, c.faults, c.awaited) == (SessionPhase.STARTING, [], ("dx", "dy"))
    assert c.incidents.sentences == ("dx: its user ended it; the session waits for dx again",)
    for name in GRAPH.nodes:
        c.receive(name, hello(name), 0)
    assert set(c.states.values()) == {NodeState.CONNECTED}


@pytest.mark.parametrize("together", [True, False])
def test_a_guest_interrupted_in_its_handshakes_ends_the_session(together: bool) -> None:
    c = conductor("dx", together=together)
    for name in ["dx"] if together else GRAPH.nodes:
        c.receive(name, hello(name), 0)
    c.receive("dx", Fault("dx: its user ended it"), 0)
    assert c.phase is SessionPhase.ENDING
    assert c.faults == ["dx: its user ended it"]


def test_leaving_early_while_the_session_ends_is_no_fault() -> None:
    c = running(ticks=0)
    c.interrupt()
    for name in GRAPH.nodes:
        assert c.receive(name, Report(3, Figures()), 0) == [Send(name, Stop("reported"))]
    assert c.faults == []


def refused(instructions: list[object]) -> RefusalCode | None:
    first = instructions[0]
    assert isinstance(first, Send)
    return RefusalCode(first.message.code) if isinstance(first.message, Refusal) else None


class Test_nodes_that_are_started_elsewhere:
    def test_a_guest_is_awaited_until_its_hello(self) -> None:
        c = conductor("dx", "dz")
        assert c.awaited == ("dx", "dz")
        c.receive("dx", hello("dx"), 0)
        assert c.awaited == ("dz",)

    def test_its_last_word_is_all_that_is_seen_of_its_end(self) -> None:
        c = running("dx")
        for name in GRAPH.nodes:
            c.receive(name, REPORT, 0)
            if name != "dx":
                assert c.phase is SessionPhase.RUNNING
                c.exited(name, 0, 0)
        assert c.states["dx"] is NodeState.ENDED
        assert c.phase is SessionPhase.OVER
        assert c.faults == []

    def test_its_fault_is_its_own_and_it_may_come_back(self) -> None:
        c = running("dx", restarts=1)
        assert c.receive("dx", Fault("dx: broken"), 0) == [
            Send("dx", Stop("received")),
            ReleaseName("dx"),
            Send("cx", Absent("dx")),
        ]
        assert (c.phase, c.states["dx"], c.faults) == (SessionPhase.RUNNING, NodeState.LOST, [])
        assert c.incidents.sentences == ("at 0.0 s: dx failed: dx: broken",)

    def test_its_fault_ends_a_session_that_is_to_stay_together(self) -> None:
        c = running("dx", restarts=3, together=True)
        c.receive("dx", Fault("dx: broken"), 0)
        assert (c.phase, c.faults) == (SessionPhase.ENDING, ["dx: broken"])

    def test_its_fault_ends_the_session_that_restarts_nobody(self) -> None:
        c = running("dx")
        assert c.receive("dx", Fault("dx: broken"), 0) == [
            Send("dx", Stop("received")),
            Terminate(),
            Send("dx", Stop("the session ends")),
        ]
        assert c.states["dx"] is NodeState.ENDED
        assert c.faults == ["dx: broken"]

    def test_its_silence_ends_the_session_once(self) -> None:
        c = running("dx")
        out = c.silent("dx", 0)
        assert out == [Terminate(), Send("dx", Stop("the session ends"))]
        assert c.faults == ["dx fell silent while running"]
        assert c.silent("dx", 0) == []
        for name in GRAPH.nodes:
            if name != "dx":
                c.exited(name, 0, 0)
        assert c.phase is SessionPhase.OVER
        assert len(c.faults) == 1

    def test_one_that_went_silent_may_not_come_back(self) -> None:
        c = running("dx")
        c.silent("dx", 0)
        for message in (Telemetry(1, Figures(), {}), REPORT, hello("dx"), Ready()):
            assert c.receive("dx", message, 0) == []
        assert c.states["dx"] is NodeState.ENDED
        assert c.reports == {}

    def test_guests_receive_the_end_as_a_message(self) -> None:
        c = running("dx", "cy")
        assert c.interrupt() == [
            Terminate(),
            Send("dx", Stop("the session ends")),
            Send("cy", Stop("the session ends")),
        ]

    def test_guests_that_never_came_are_not_awaited_at_the_end(self) -> None:
        c = conductor("dx")
        for name in GRAPH.nodes:
            if name != "dx":
                c.receive(name, hello(name), 0)
        c.interrupt()
        for name in GRAPH.nodes:
            if name != "dx":
                assert c.phase is SessionPhase.ENDING
                c.exited(name, 0, 0)
        assert c.phase is SessionPhase.OVER

    def test_nodes_that_do_not_end_in_time_are_given_up(self) -> None:
        c = running("dx")
        c.interrupt()
        for name in GRAPH.nodes:
            if name != "dx":
                c.exited(name, 0, 0)
        assert c.phase is SessionPhase.ENDING
        assert c.too_late() == [Kill()]
        assert c.phase is SessionPhase.OVER
        assert c.faults == []

    def test_all_of_them_may_be_elsewhere(self) -> None:
        c = running(*GRAPH.nodes)
        for name in GRAPH.nodes:
            c.receive(name, REPORT, 0)
        assert c.phase is SessionPhase.OVER
        never = conductor(*GRAPH.nodes)
        never.interrupt()
        assert never.phase is SessionPhase.OVER

    @pytest.mark.parametrize("changes", [{"certificate": "other"}, {"session": "else"}, {"version": 1}])
    def test_one_that_does_not_belong_is_refused_and_ends_the_session(self, changes: dict[str, object]) -> None:
        c = conductor("dx")
        out = c.receive("dx", hello("dx", **changes), 0)
        assert refused(list(out)) is not None
        assert Terminate() in out
        assert len(c.faults) == 1
        assert c.awaited == ()


def observer(sender: str, **changes: object) -> NodeHello:
    return NodeHello(**{**vars_of(hello("dx")), "name": sender, "role": Role.OBSERVER, **changes})  # type: ignore[arg-type]


def vars_of(message: NodeHello) -> dict[str, object]:
    return {name: getattr(message, name) for name in message.__dataclass_fields__}


class Test_observers:
    @pytest.mark.parametrize("c", [conductor(), running(), running("dx")], ids=["starting", "running", "with a guest"])
    def test_an_observer_receives_its_endpoint_each_time_and_changes_nothing(self, c: Conductor) -> None:
        before = dict(c.states), c.phase
        for _ in range(3):
            assert c.receive("watch", observer("watch"), 0) == [
                Send("watch", Welcome()),
                Send("watch", Connect({"supervisor": "ipc:///s/watch"})),
                ReleaseName("watch"),
            ]
        assert c.receive("scope", observer("scope"), 0)[1] == Send("scope", Connect({"supervisor": "ipc:///s/scope"}))
        assert (dict(c.states), c.phase) == before
        assert (c.faults, c.ignored) == ([], 0)

    def test_endpoints_known_only_later_are_sent_as_well(self) -> None:
        """The supervisor binds them after it has made its conductor."""
        c = Conductor(GRAPH, "c", "example-1", 5)
        c.observers = {"watch": "ipc:///late"}
        assert c.receive("watch", observer("watch"), 0)[1] == Send("watch", Connect({"supervisor": "ipc:///late"}))

    @pytest.mark.parametrize(
        ("changes", "code"),
        [
            ({"version": 1}, RefusalCode.VERSION),
            ({"certificate": "other"}, RefusalCode.CERTIFICATE),
            ({"session": "else"}, RefusalCode.SESSION),
            ({"role": Role.DEVICE}, RefusalCode.ROLE),
            ({"name": "scope"}, RefusalCode.NAME),
            ({"name": "dx", "role": Role.DEVICE}, RefusalCode.NAME),
            ({"endpoints": {"dx": "tcp://192.0.2.1:1"}}, RefusalCode.ENDPOINTS),
        ],
    )
    def test_a_foreign_observer_is_refused_and_the_session_goes_on(
        self, changes: dict[str, object], code: RefusalCode
    ) -> None:
        c = running()
        out = c.receive("watch", observer("watch", **changes), 0)
        assert refused(list(out)) is code
        assert out[1:] == [ReleaseName("watch")]
        assert (c.phase, c.faults, c.ignored) == (SessionPhase.RUNNING, [], 1)

    def test_any_other_message_is_counted_and_ignored(self) -> None:
        c = running()
        c.receive("watch", observer("watch"), 0)
        before = dict(c.states)
        said = (
            Ready(),
            REPORT,
            Fault("I end you"),
            Telemetry(1, Figures(), {}),
            Probe(1),
            Stop("now"),
            Malformed("junk"),
        )
        for message in said:
            assert c.receive("watch", message, 0) == []
        assert c.ignored == len(said)
        assert (dict(c.states), c.phase, c.faults, c.reports) == (before, SessionPhase.RUNNING, [], {})

    def test_a_name_that_is_no_observers_is_refused_as_a_stranger(self) -> None:
        c = running()
        (out,) = c.receive("peeper", observer("peeper"), 0)
        assert isinstance(out, Send)
        assert isinstance(out.message, Refusal)
        assert c.ignored == 1
