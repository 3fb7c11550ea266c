"""The supervisor's decisions, without a process: every event in, every instruction out."""

from __future__ import annotations

from pathlib import Path

import pytest

from manyhands.launch.conductor import Conductor, Kill, NodeState, Phase, Send, Terminate
from manyhands.launch.session import load_session
from manyhands.launch.topology import Topology, topology
from manyhands.protocol.codec import ForeignHello, Malformed
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Connect,
    Fault,
    NodeHello,
    Ready,
    Refusal,
    Report,
    Role,
    Start,
    Stop,
    Telemetry,
    Welcome,
)

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
GRAPH: Topology = topology(load_session(SESSIONS / "example1.yaml"))
REPORT = Report(5, {}, {}, {})


def hello(sender: str, **changes: object) -> NodeHello:
    binds = {link.connector: f"ipc://{sender}-{link.connector}" for link in GRAPH.links if link.binder == sender}
    fields = {"version": PROTOCOL_VERSION, "certificate": "c", "session": "example-1", "name": sender,
              "role": GRAPH.nodes[sender], "pid": 1, "endpoints": binds}  # fmt: skip
    return NodeHello(**{**fields, **changes})  # type: ignore[arg-type]


def conductor() -> Conductor:
    return Conductor(GRAPH, "c", "example-1", 5)


def running() -> Conductor:
    c = conductor()
    for name in GRAPH.nodes:
        c.hear(name, hello(name), 0)
    for name in GRAPH.nodes:
        c.hear(name, Ready(), 0)
    assert c.phase is Phase.RUNNING
    return c


def test_a_good_run_from_hello_to_the_last_exit() -> None:
    c = conductor()
    names = list(GRAPH.nodes)
    for name in names[:-1]:
        assert c.hear(name, hello(name), 0) == [Send(name, Welcome())]
    last = c.hear(names[-1], hello(names[-1]), 0)
    connects = {i.node: i.message for i in last if isinstance(i, Send) and isinstance(i.message, Connect)}
    assert connects["dx"] == Connect({"cx": "ipc://cx-dx"})
    assert connects["cx"] == Connect({"environment": "ipc://environment-cx"})
    assert connects["environment"] == Connect({})
    for name in names[:-1]:
        assert c.hear(name, Ready(), 1000) == []
    starts = c.hear(names[-1], Ready(), 1000)
    assert {i.node for i in starts if isinstance(i, Send)} == set(names)
    first = starts[0]
    assert isinstance(first, Send)
    assert isinstance(first.message, Start)
    assert first.message.epoch > 1000
    assert first.message.ticks == 5
    for name in names:
        assert c.hear(name, Telemetry(1, {}, {}), 0) == []
        assert c.hear(name, REPORT, 0) == [Send(name, Stop("reported"))]
        assert c.exited(name, 0) == []
    assert c.phase is Phase.OVER
    assert c.faults == []
    assert set(c.reports) == set(names)


@pytest.mark.parametrize("state", ["starting", "running"])
@pytest.mark.parametrize(("code", "words"), [(-9, "was killed by SIGKILL"), (1, "ended with exit code 1")])
def test_a_node_that_dies_ends_the_session(state: str, code: int, words: str) -> None:
    c = running() if state == "running" else conductor()
    assert c.exited("cy", code) == [Terminate()]
    assert c.phase is Phase.ENDING
    assert c.faults == [f"cy {words} while {state}"]
    for name in GRAPH.nodes:
        if name != "cy":
            assert c.exited(name, -15) == []  # asked to end: no fault of theirs
    assert c.phase is Phase.OVER
    assert len(c.faults) == 1


def test_a_node_that_ends_early_without_a_report_is_a_fault_even_with_exit_code_0() -> None:
    c = running()
    assert c.exited("dx", 0) == [Terminate()]
    assert "ended with exit code 0 while running" in c.faults[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": 2}, "found protocol version 2; expected 1"),
        ({"certificate": "other"}, "found the certificate other; expected c"),
        ({"session": "else"}, "found the session else"),
        ({"role": Role.DEVICE}, "found the role device; expected coupling"),
        ({"name": "cz"}, "cx calls itself cz"),
    ],
)
def test_a_node_that_does_not_belong_is_refused_and_told(changes: dict[str, object], words: str) -> None:
    c = conductor()
    out = c.hear("cx", hello("cx", **changes), 0)
    first = out[0]
    assert isinstance(first, Send)
    assert isinstance(first.message, Refusal)
    assert out[1:] == [Terminate()]
    assert any(words in fault for fault in c.faults)


def test_a_node_of_another_protocol_is_refused() -> None:
    c = conductor()
    assert Terminate() in c.hear("cx", ForeignHello(7), 0)
    assert "found protocol version 7; expected 1" in c.faults[0]


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
        assert c.hear(sender, message, 0) == []
    assert c.states == before
    assert c.ignored == 5


def test_a_strangers_hello_is_refused_and_the_session_goes_on() -> None:
    c = conductor()
    (out,) = c.hear("stranger", hello("dx", name="stranger"), 0)
    assert isinstance(out, Send)
    assert isinstance(out.message, Refusal)
    assert c.faults == []
    assert c.phase is Phase.STARTING


def test_ctrl_c_asks_all_to_end_and_a_second_one_kills() -> None:
    c = running()
    assert c.interrupt() == [Terminate()]
    assert c.interrupt() == [Kill()]  # asked twice
    for name in GRAPH.nodes:
        assert c.hear(name, REPORT, 0) == [Send(name, Stop("reported"))]
        c.exited(name, 0)
    assert c.phase is Phase.OVER
    assert c.faults == []


def test_a_start_up_that_takes_too_long_says_who_is_missing_and_a_stubborn_process_is_killed() -> None:
    c = conductor()
    c.hear("dx", hello("dx"), 0)
    assert c.too_late() == [Terminate()]
    assert "dx (connecting)" in c.faults[0]
    assert "environment (starting)" in c.faults[0]
    assert c.too_late() == [Kill()]
    assert running().too_late() == []


def test_a_fault_is_heard_once_and_its_exit_is_no_second_one() -> None:
    c = running()
    assert c.hear("cx", Fault("cx: no more"), 0) == [Send("cx", Stop("heard")), Terminate()]
    assert c.states["cx"] is NodeState.FAULTED
    assert c.exited("cx", 4) == []
    assert c.faults == ["cx: no more"]
