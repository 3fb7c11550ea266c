"""Seats of a session: their users take them and leave them while it runs, and nobody waits for them."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.launch.plan.topology import LinkPlan, Topology
from manyhands.launch.run.conductor import Conductor
from manyhands.launch.run.recovery import RETURN_TIME, Restarts
from manyhands.launch.run.states import NodeState, ReleaseName, Send, SessionPhase
from manyhands.protocol.limits import MAX_PIECE_BYTES
from manyhands.protocol.messages import Fault, Fetch, Figures, Piece, Report, Role, Stop, Telemetry

from ...support.cases import cases
from ...support.fake_session import CERTIFICATE, FakeSession, hello_of

# cx and cy run in the processes of their devices, cz does not; dl is the host's own, in the tick
NODES = {
    **dict.fromkeys(("dx", "dy", "dz", "dl"), Role.DEVICE),
    **dict.fromkeys(("cx", "cy", "cz", "cl"), Role.COUPLING),
    "environment": Role.ENVIRONMENT,
}
CARRIERS = {"cx": "dx", "cy": "dy"}
LINKS = (
    *(LinkPlan("environment", coupling, ("p",)) for coupling in ("cx", "cy", "cz", "cl")),
    LinkPlan("cz", "dz", ("p",)),
    LinkPlan("cl", "dl", ("p",)),
)
GRAPH = Topology(NODES, dict.fromkeys(NODES, ("p",)), LINKS, CARRIERS)
SITES = {"cx": ("dx", "cx"), "cy": ("dy", "cy"), "cz": ("dz", "cz")}
SEATS = frozenset(node for site in SITES.values() for node in site)
HOME = ("dl", "cl", "environment")
LEFT = Report(50, Figures())


def hosted(restarts: int = 0, *, ticks: int = 0, together: bool = False) -> FakeSession:
    """A session whose seats nobody has taken."""
    budget = Restarts(restarts)
    conductor = Conductor(GRAPH, CERTIFICATE, "s", ticks, SEATS, restarts=budget, together=together, seats=SEATS)
    return FakeSession(GRAPH, conductor, SEATS)


def take(s: FakeSession, site: str) -> None:
    """The user of a seat starts its processes."""
    for node in SITES[site]:
        if node not in s.processes:
            s.start(node)


def leave(s: FakeSession, site: str) -> None:
    """The processes of a seat report that they end, and end."""
    for node in SITES[site]:
        if s.processes.pop(node, None) is not None:
            s.said.append((node, LEFT))


def vanish(s: FakeSession, site: str) -> None:
    """The machine of a seat loses its power, and falls silent."""
    for node in SITES[site]:
        if s.processes.pop(node, None) is not None:
            s.said = type(s.said)(one for one in s.said if one[0] != node)
            s.obey(s.conductor.silent(node, s.now))


def taken(s: FakeSession) -> set[str]:
    return {site for site, nodes in SITES.items() if s.goes_on(nodes) and s.goes_on((*nodes, "environment"))}


def test_the_session_runs_before_anybody_has_come() -> None:
    s = hosted()
    assert s.conductor.phase is SessionPhase.RUNNING
    assert s.goes_on(HOME)
    assert s.processes["environment"].absent == set(SITES)
    assert s.conductor.awaited == ()
    assert {s.conductor.states[node] for node in SEATS} == {NodeState.LOST}


@pytest.mark.parametrize("site", SITES)
def test_a_user_takes_a_seat_and_leaves_it_again_and_again(site: str) -> None:
    s = hosted()
    home = {node: s.processes[node] for node in HOME}
    s.conductor.receive("environment", Telemetry(400, Figures(), {}), 0)
    for _ in range(10):  # far more often than any budget allows
        take(s, site)
        s.settle()
        assert taken(s) == {site}
        assert [start.tick for node in SITES[site] for start in s.processes[node].starts] == [400, 400]
        leave(s, site)
        s.settle()
        assert taken(s) == set()
    assert {node: s.processes[node] for node in HOME} == home
    assert s.conductor.phase is SessionPhase.RUNNING
    assert s.conductor.faults == []
    assert s.conductor.incidents.restarts == {}
    assert s.conductor.incidents.sentences == ()
    sentences = s.conductor.visits.sentences
    assert f"at 0.0 s: {site} has joined" in sentences
    assert f"at 0.0 s: {site} left after 50 ticks" in sentences
    assert s.conductor.visits.total == 10 * 2 * len(SITES[site])


def test_a_guest_that_is_lost_or_fails_is_an_incident_and_its_return_a_visit() -> None:
    s = hosted()
    take(s, "cx")
    s.settle()
    vanish(s, "cx")
    for node in SITES["cz"]:
        s.start(node)
    s.settle()
    for node in SITES["cz"]:
        del s.processes[node]
        s.said.append((node, Fault(f"{node}: unplugged")))
    take(s, "cx")
    s.settle()
    incidents = {text.partition(": ")[2] for text in s.conductor.incidents.sentences}
    assert incidents == {
        *(f"{node} fell silent while running" for node in SITES["cx"]),
        *(f"{node} failed: {node}: unplugged" for node in SITES["cz"]),
    }
    visits = [text.partition(": ")[2] for text in s.conductor.visits.sentences]
    assert sorted(visits) == sorted(f"{node} has joined" for node in (*SITES["cx"], *SITES["cz"], *SITES["cx"]))


def test_a_seat_that_nobody_has_taken_is_shown_as_free() -> None:
    s = hosted()
    assert {node: s.conductor.shown_state(node) for node in (*SITES["cx"], *HOME)} == {
        **dict.fromkeys(SITES["cx"], "free"),
        **dict.fromkeys(HOME, "running"),
    }
    take(s, "cx")
    s.settle()
    assert {s.conductor.shown_state(node) for node in SITES["cx"]} == {"running"}
    leave(s, "cx")
    s.settle()
    assert {s.conductor.shown_state(node) for node in SITES["cx"]} == {"free"}


def test_nobody_else_hears_of_it() -> None:
    s = hosted()
    take(s, "cx")
    s.settle()
    before = s.processes["dx"], s.processes["cx"], s.processes["dl"], s.processes["cl"]
    take(s, "cy")
    s.settle()
    leave(s, "cy")
    s.settle()
    assert taken(s) == {"cx"}
    assert before == (s.processes["dx"], s.processes["cx"], s.processes["dl"], s.processes["cl"])
    assert all(process.absent == set() for process in before)


def test_a_guest_who_comes_before_the_session_runs_is_taken_at_its_next_hello() -> None:
    conductor = Conductor(GRAPH, CERTIFICATE, "s", 0, SEATS, seats=SEATS)
    early = hello_of(GRAPH, "dx", {})
    assert conductor.receive("dx", early, 0) == []
    assert conductor.ignored == 0
    s = FakeSession(GRAPH, conductor, SEATS)
    assert s.conductor.phase is SessionPhase.RUNNING
    take(s, "cx")
    s.settle()
    assert taken(s) == {"cx"}


@pytest.mark.parametrize("by_user", [True, False])
def test_a_guest_who_does_not_engage_frees_the_seat(by_user: bool) -> None:
    """That its user ended it is no incident; that it cannot join is one."""
    s = hosted()
    take(s, "cx")
    for _ in range(8):
        s.deliver()
    assert s.conductor.states["cx"] is NodeState.CONNECTED
    for node in SITES["cx"]:
        del s.processes[node]
        s.said.append((node, Fault(f"{node}: no device", by_user)))
    s.settle()
    told = [happened.sentences for happened in (s.conductor.visits, s.conductor.incidents)]
    left = tuple(f"at 0.0 s: {node} left before its first tick" for node in SITES["cx"])
    failed = tuple(f"at 0.0 s: {node} could not return: {node}: no device" for node in SITES["cx"])
    assert told == ([left, ()] if by_user else [(), failed])
    assert s.conductor.states["cx"] is s.conductor.states["dx"] is NodeState.LOST
    take(s, "cx")
    s.settle()
    assert taken(s) == {"cx"}


def test_a_guest_who_never_answers_is_sent_away_and_may_come_again() -> None:
    s = hosted()
    take(s, "cx")
    for _ in range(8):
        s.deliver()
    s.now = RETURN_TIME + 1
    sent = s.conductor.look(s.now)
    stops = [one.message for one in sent if isinstance(one, Send) and isinstance(one.message, Stop)]
    assert len(stops) == 2
    assert all(stop.again for stop in stops)
    assert {one.name for one in sent if isinstance(one, ReleaseName)} == {"dx", "cx"}
    assert s.conductor.phase is SessionPhase.RUNNING


def test_a_guest_counted_as_lost_is_asked_to_join_again() -> None:
    s = hosted()
    take(s, "cx")
    s.settle()
    old = {node: s.processes[node] for node in SITES["cx"]}
    vanish(s, "cx")
    assert s.conductor.states["cx"] is NodeState.LOST
    s.processes |= old  # the network is back
    s.said += [(node, Telemetry(9, Figures(), {})) for node in old]
    s.deliver()
    s.deliver()
    answers = [process.inbox.pop() for process in old.values()]
    assert all(isinstance(answer, Stop) and answer.again for answer in answers)


def test_the_environment_comes_back_to_the_seats_that_are_taken() -> None:
    s = hosted(restarts=1)
    take(s, "cz")
    s.settle()
    s.kill("environment")
    s.settle()
    assert s.goes_on(HOME)
    assert taken(s) == {"cz"}
    assert s.processes["environment"].absent == {"cx", "cy"}
    take(s, "cx")
    s.settle()
    assert taken(s) == {"cx", "cz"}


def test_the_host_ends_it_whoever_is_there() -> None:
    s = hosted()
    take(s, "cy")
    s.settle()
    out = s.conductor.interrupt()
    farewells = [one.node for one in out if isinstance(one, Send) and isinstance(one.message, Stop)]
    assert set(farewells) >= set(SITES["cy"])
    assert not any(one.message.again for one in out if isinstance(one, Send) and isinstance(one.message, Stop))
    leave(s, "cy")
    for node in HOME:
        s.kill(node)
    s.settle()
    assert s.conductor.phase is SessionPhase.OVER


STEPS = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(["take", "leave", "vanish"]), st.sampled_from(list(SITES))),
        st.tuples(st.just("kill"), st.sampled_from(HOME)),
        st.tuples(st.just("read"), st.sampled_from(list(NODES))),
        st.tuples(st.sampled_from(["deliver", "see end"]), st.just("")),
    ),
    max_size=80,
)


@settings(max_examples=cases(150, 600))
@given(STEPS)
def test_whoever_comes_goes_or_dies_at_any_time(script: list[tuple[str, str]]) -> None:
    s = hosted(restarts=100)
    for what, name in script:
        match what:
            case "take":
                take(s, name)
            case "leave" if s.goes_on(SITES[name]):
                leave(s, name)
            case "vanish":
                vanish(s, name)
            case "kill":
                s.kill(name)
            case "read":
                s.read(name)
            case "deliver":
                s.deliver()
            case "see end":
                s.see_end()
    s.settle()
    assert s.conductor.phase is SessionPhase.RUNNING
    assert s.conductor.faults == []
    assert s.goes_on(HOME), s.conductor.states
    for site in SITES:  # whoever was sent away, or still waits, comes again
        if not s.goes_on((*SITES[site], "environment")):
            vanish(s, site)
            take(s, site)
    s.settle()
    assert s.joined(), s.conductor.states


def test_a_hello_that_only_repeats_an_accepted_one_is_no_news() -> None:
    """A welcome that is lost on the way is sent again by the network; meanwhile the guest repeats its hello."""
    s = hosted()
    conductor = s.conductor
    hello = hello_of(GRAPH, "dx", {})
    assert conductor.receive("dx", hello, 0) != []
    assert conductor.receive("dx", hello, 0) == []
    assert conductor.ignored == 0
    other = dataclasses.replace(hello, pid=hello.pid + 1)
    conductor.receive("dx", other, 0)
    assert conductor.ignored == 1


def test_a_guest_on_its_way_in_shows_that_it_lives() -> None:
    """Who is silent on the way loses the seat, long before a node that is here is given up."""
    s = hosted()
    s.conductor.receive("dx", hello_of(GRAPH, "dx", {}), 0)
    assert s.conductor.comes_back("dx")
    assert not s.conductor.comes_back("dy")
    s.conductor.silent("dx", 0)
    assert not s.conductor.comes_back("dx")
    assert s.conductor.states["dx"] is NodeState.LOST


def test_the_guest_of_a_free_seat_fetches_its_part_piece_by_piece() -> None:
    s = hosted()
    part = bytes(range(256)) * (MAX_PIECE_BYTES // 256) + b"the rest"
    s.conductor.parts["dx"] = part
    for at, content in (
        (0, part[:MAX_PIECE_BYTES]),
        (MAX_PIECE_BYTES, b"the rest"),
        (2, part[2 : MAX_PIECE_BYTES + 2]),
    ):
        out = s.conductor.receive("dx", Fetch(at), s.now)
        assert out == [Send("dx", Piece(at, len(part), content)), ReleaseName("dx")]
    take(s, "cx")
    s.settle()
    assert taken(s) == {"cx"}
    assert s.conductor.ignored == 0


def test_nobody_else_is_sent_a_part_and_nothing_beyond_it() -> None:
    s = hosted()
    s.conductor.parts["dx"] = b"part"
    fetches = [("dx", 4), ("dy", 0), ("cx", 0), ("dl", 0), ("environment", 0), ("stranger", 0)]
    for ignored, (sender, at) in enumerate(fetches, start=1):
        out = s.conductor.receive(sender, Fetch(at), s.now)
        assert not any(isinstance(one, Send) and isinstance(one.message, Piece) for one in out), sender
        assert s.conductor.ignored == ignored


def test_a_seat_that_is_taken_has_no_part_to_send() -> None:
    s = hosted()
    s.conductor.parts["dx"] = b"part"
    take(s, "cx")
    s.settle()
    out = s.conductor.receive("dx", Fetch(0), s.now)
    assert not any(isinstance(one, Send) and isinstance(one.message, Piece) for one in out)
    assert s.conductor.ignored == 1
