"""A running session loses nodes and gets them back: after any death at any time all join again in the end."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.launch.plan.topology import LinkPlan, Topology
from manyhands.launch.run.conductor import EPOCH_DELAY_NS, Conductor
from manyhands.launch.run.recovery import LINK_TRANSITIONS, RETURN_TIME, LinkEvent, LinkState, Restarts
from manyhands.launch.run.states import NodeState, ReleaseName, Send, SessionPhase, StartProcess, Terminate
from manyhands.protocol.clock import from_seconds
from manyhands.protocol.messages import (
    Absent,
    Connect,
    Fault,
    Figures,
    Offer,
    Ready,
    Refusal,
    Report,
    Return,
    Role,
    Shift,
    Start,
    Stop,
    Telemetry,
    Welcome,
)

from ...support.cases import cases
from ...support.fake_session import CERTIFICATE, FakeSession, hello_of

# dx and dy each have a coupling; dz is split between two
NODES = {
    **dict.fromkeys(("dx", "dy", "dz"), Role.DEVICE),
    **dict.fromkeys(("cx", "cy", "cu", "cv"), Role.COUPLING),
    "environment": Role.ENVIRONMENT,
}
LINKS = tuple(
    LinkPlan(binder, connector, ("p",))
    for binder, connector in [
        *[("environment", coupling) for coupling in ("cx", "cy", "cu", "cv")],
        *[("cx", "dx"), ("cy", "dy"), ("cu", "dz"), ("cv", "dz")],
    ]
)
GRAPH = Topology(NODES, dict.fromkeys(NODES, ("p",)), LINKS)
TICKS = 1000
DONE = Report(TICKS, Figures())
WINDOW = from_seconds(60.0)


def conductor(restarts: int = 3, *remote: str, ticks: int = TICKS) -> Conductor:
    return Conductor(GRAPH, CERTIFICATE, "s", ticks, frozenset(remote), restarts=Restarts(restarts, WINDOW))


def session(restarts: int = 3, *remote: str, ticks: int = TICKS) -> FakeSession:
    """One that runs."""
    made = FakeSession(GRAPH, conductor(restarts, *remote, ticks=ticks))
    assert made.conductor.phase is SessionPhase.RUNNING
    assert made.joined()
    return made


steps = st.lists(
    st.one_of(
        st.tuples(st.just("kill"), st.sampled_from(list(NODES))),
        st.tuples(st.just("read"), st.sampled_from(list(NODES))),
        st.tuples(st.sampled_from(["deliver", "see end"]), st.just("")),
    ),
    max_size=60,
)


class Test_whoever_dies:
    @pytest.mark.parametrize("victim", NODES)
    def test_one(self, victim: str) -> None:
        s = session()
        before = {node: process for node, process in s.processes.items() if node != victim}
        s.kill(victim)
        s.settle()
        assert s.joined()
        assert s.conductor.faults == []
        assert s.conductor.ignored == 0
        assert s.conductor.incidents.sentences == (
            f"at 0.0 s: {victim} was killed by SIGKILL while running",
            f"at 0.0 s: {victim} is back",
        )
        assert s.conductor.incidents.restarts == {victim: 1}
        for node, process in before.items():  # the others stay, and hear of those alone that they are linked to
            assert s.processes[node] is process
            assert process.absent <= {victim}
            linked = any({node, victim} == {link.binder, link.connector} for link in LINKS)
            assert bool(process.absent) == linked

    @pytest.mark.parametrize("first", NODES)
    @pytest.mark.parametrize("second", NODES)
    def test_two_at_once(self, first: str, second: str) -> None:
        s = session()
        s.kill(first)
        s.kill(second)
        s.settle()
        assert s.joined()
        assert s.killed == []

    def test_all_at_once(self) -> None:
        s = session()
        for node in NODES:
            s.kill(node)
        s.settle()
        assert s.joined()
        assert s.conductor.faults == []

    @settings(max_examples=cases(100, 400))
    @given(steps)
    def test_at_any_time_in_any_order(self, script: list[tuple[str, str]]) -> None:
        s = session(restarts=100)
        for what, node in script:
            match what:
                case "kill":
                    s.kill(node)
                case "read":
                    s.read(node)
                case "deliver":
                    s.deliver()
                case "see end":
                    s.see_end()
        s.settle()
        assert s.joined(), s.conductor.states
        assert s.conductor.faults == []
        assert s.conductor.phase is SessionPhase.RUNNING
        assert all(len(process.starts) == 1 for process in s.processes.values())

    def test_returning_nodes_go_on_at_the_sessions_tick(self) -> None:
        s = session()
        s.conductor.receive("environment", Telemetry(400, Figures(), {}), 0)
        s.conductor.receive("dx", Telemetry(900, Figures(), {}), 0)  # the ticks are the environment's
        (original,) = s.processes["dx"].starts
        assert original.tick == 0
        s.kill("dy")
        s.settle()
        assert s.processes["dy"].starts == [Start(original.epoch, TICKS, 400)]

    def test_soon_after_the_beginning_it_is_the_beginning_no_more(self) -> None:
        s = session()
        s.kill("dy")
        s.settle()
        assert s.processes["dy"].starts[0].tick == 1


class Test_the_order:
    """The binding end of a link is there before the connecting end starts or receives the endpoint."""

    def test_of_one_death(self) -> None:
        c = session().conductor
        told = c.exited("cx", -9, 0)
        assert told == [Send("environment", Absent("cx")), Send("dx", Absent("cx"))]
        told = c.receive("environment", Offer("cx", "ipc:///anew"), 0)
        assert told == [ReleaseName("cx"), StartProcess("cx")]
        told = c.receive("cx", hello_of(GRAPH, "cx", {"dx": "ipc:///cx-dx.anew"}), 0)
        assert told == [
            Send("cx", Welcome()),
            Send("cx", Connect({"environment": "ipc:///anew"})),
            Send("dx", Return("cx", "ipc:///cx-dx.anew")),
        ]
        (first, *rest) = c.receive("cx", Ready(), 0)
        assert first == Send("cx", Start(EPOCH_DELAY_NS, TICKS, 1))
        assert rest == []

    def test_of_a_coupling_and_its_device(self) -> None:
        c = session().conductor
        c.exited("dx", -9, 0)
        c.exited("cx", -9, 0)
        assert c.receive("environment", Offer("cx", "ipc:///anew"), 0) == [ReleaseName("cx"), StartProcess("cx")]
        told = c.receive("cx", hello_of(GRAPH, "cx", {"dx": "ipc:///cx-dx.anew"}), 0)
        assert told == [
            Send("cx", Welcome()),
            Send("cx", Absent("dx")),
            Send("cx", Connect({"environment": "ipc:///anew"})),
        ]
        assert StartProcess("dx") not in c.receive("cx", Offer("dx", "ipc:///for-dx"), 0)
        assert StartProcess("dx") in c.receive("cx", Ready(), 0)
        told = c.receive("dx", hello_of(GRAPH, "dx", {}), 0)
        assert told == [Send("dx", Welcome()), Send("dx", Connect({"cx": "ipc:///for-dx"}))]

    def test_a_rejoining_node_restarts_free_when_its_peer_dies(self) -> None:
        s = session(restarts=1)
        s.kill("cx")
        s.see_end()
        s.read("environment")
        s.deliver()  # the offer: cx is started
        s.deliver()  # its hello: it receives the endpoints of the environment and of dx
        assert s.conductor.states["cx"] is NodeState.CONNECTED
        s.kill("dx")
        s.see_end()
        assert s.killed == ["cx"]
        assert s.conductor.states["cx"] is NodeState.LEAVING
        s.settle()
        assert s.joined()
        assert s.conductor.faults == []


class Test_offers:
    """Only the node asked may make an offer: no other can start or misdirect a node."""

    @pytest.mark.parametrize(
        ("sender", "peer"),
        [("environment", "cx"), ("cx", "dx"), ("dx", "cx"), ("environment", "dx"), ("cx", "nobody"), ("cx", "cx")],
    )
    def test_unasked_are_counted_and_change_nothing(self, sender: str, peer: str) -> None:
        c = session().conductor
        before = dict(c.states)
        assert c.receive(sender, Offer(peer, "ipc:///elsewhere"), 0) == []
        assert (c.states, c.ignored) == (before, 1)

    def test_only_the_binding_peer_may_offer_once_while_it_is_due(self) -> None:
        c = session().conductor
        c.exited("cx", -9, 0)
        for sender in ("dx", "dy", "cy", "stranger"):
            assert c.receive(sender, Offer("cx", "ipc:///elsewhere"), 0) == []
        assert StartProcess("cx") in c.receive("environment", Offer("cx", "ipc:///anew"), 0)
        assert c.receive("environment", Offer("cx", "ipc:///elsewhere"), 0) == []
        assert c.ignored == 5
        told = c.receive("cx", hello_of(GRAPH, "cx", {"dx": "ipc:///x"}), 0)
        assert Send("cx", Connect({"environment": "ipc:///anew"})) in told

    def test_messages_of_a_dead_process_do_not_block_its_name(self) -> None:
        c = session().conductor
        c.exited("cx", -9, 0)
        assert c.receive("cx", Telemetry(7, Figures(), {}), 0) == [ReleaseName("cx")]
        # a local one is not there
        assert c.receive("cx", hello_of(GRAPH, "cx", {"dx": "ipc:///x"}), 0) == [ReleaseName("cx")]
        assert c.states["cx"] is NodeState.LOST
        assert c.ignored == 2

    def test_a_process_that_ends_without_a_word_is_quoted_by_its_log(self) -> None:
        """Its last line need not be the reason, and is not called so."""
        c = session().conductor
        c.exited("dx", 1, 0, "OverflowError: cannot convert float infinity to integer")
        c.exited("cx", 1, 0, "OverflowError: cannot convert float infinity to integer")
        assert c.incidents.sentences == (
            "at 0.0 s: dx ended with exit code 1 while running; the last line of its log: OverflowError: cannot "
            "convert float infinity to integer",
            "at 0.0 s: cx ended with exit code 1 while running",
        )

    def test_a_coupling_in_its_devices_process_is_not_said_to_have_failed(self) -> None:
        apart = tuple(link for link in LINKS if link.connector != "dx")
        graph = replace(GRAPH, links=apart, carriers={"cx": "dx"})
        c = FakeSession(graph, Conductor(graph, CERTIFICATE, "s", TICKS, restarts=Restarts(100, WINDOW))).conductor
        c.exited("dx", 1, 0)
        c.exited("cx", 1, 0)
        assert c.incidents.sentences == (
            "at 0.0 s: dx ended with exit code 1 while running",
            "at 0.0 s: cx ended with dx, in whose process it ran, while running",
        )

    def test_a_process_that_cannot_start_says_what_its_device_lacks(self) -> None:
        c = session().conductor
        c.exited("dx", 1, 0)
        c.receive("cx", Offer("dx", "ipc:///anew"), 0)
        c.exited("dx", 2, 0, "cannot open /dev/ttyACM0: there is no such port; plug the device in")
        assert c.incidents.sentences == (
            "at 0.0 s: dx ended with exit code 1 while running",
            "at 0.0 s: dx ended with exit code 2 while starting: cannot open /dev/ttyACM0: there is no such port; "
            "plug the device in",
        )

    def test_starts_in_vain_wait_for_twice_as_long_each_time(self) -> None:
        c = session(restarts=100).conductor
        c.exited("dx", -9, 0)
        assert StartProcess("dx") in c.receive("cx", Offer("dx", "ipc:///anew"), 0)
        now, waited = 0, []
        for _ in range(6):
            assert StartProcess("dx") not in c.exited("dx", 2, now, "plug the device in")
            began = now
            while StartProcess("dx") not in c.look(now):
                now += from_seconds(0.25)
            waited.append((now - began) / 1e9)
        assert waited == [1.0, 2.0, 4.0, 8.0, 10.0, 10.0]
        assert StartProcess("dx") in c.exited("dx", -9, now)  # a process that was killed did not start in vain

    def test_nodes_of_one_process_wait_for_a_start_in_vain_together_and_the_session_can_end_meanwhile(self) -> None:
        """One that began to wait alone had no process, and so no end: the session went on ending for ever."""
        apart = tuple(link for link in LINKS if link.connector != "dx")
        graph = replace(GRAPH, links=apart, carriers={"cx": "dx"})
        c = FakeSession(graph, Conductor(graph, CERTIFICATE, "s", TICKS, restarts=Restarts(100, WINDOW))).conductor
        assert c.phase is SessionPhase.RUNNING
        started = [*c.exited("dx", -9, 0), *c.exited("cx", -9, 0)]
        started += c.receive("environment", Offer("cx", "ipc:///anew"), 0)
        assert {StartProcess("dx"), StartProcess("cx")} <= {one for one in started if isinstance(one, StartProcess)}
        deeds = [*c.exited("dx", 2, 0, "plug the device in"), *c.exited("cx", 2, 0)]
        assert not any(isinstance(one, StartProcess) for one in deeds)
        assert {c.states["dx"], c.states["cx"]} == {NodeState.LOST}
        c.interrupt()
        for node, state in list(c.states.items()):
            if state is not NodeState.ENDED:
                c.exited(node, 0, 0)
        assert c.phase is SessionPhase.OVER

    def test_a_hello_of_a_former_process_is_not_the_next_ones(self) -> None:
        c = session().conductor
        c.exited("dx", -9, 0)
        c.receive("cx", Offer("dx", "ipc:///anew"), 0)
        c.started("dx", 77)
        assert c.receive("dx", hello_of(GRAPH, "dx", {}, 76), 0) == [ReleaseName("dx")]
        assert c.states["dx"] is NodeState.STARTING
        assert Send("dx", Welcome()) in c.receive("dx", hello_of(GRAPH, "dx", {}, 77), 0)


class Test_the_restarts:
    def test_without_one_the_first_death_ends_the_session(self) -> None:
        c = session(restarts=0).conductor
        assert c.exited("dx", -9, 0) == [Terminate()]
        assert c.faults == ["dx was killed by SIGKILL while running"]

    def test_a_user_without_restarts_left_stays_frozen_and_others_go_on(self) -> None:
        s = session(restarts=2)
        for _ in range(3):
            s.kill("dx")
            s.settle()
        assert s.conductor.states["dx"] is NodeState.GONE
        assert s.conductor.phase is SessionPhase.RUNNING
        (fault,) = s.conductor.faults
        assert fault.startswith("dx was killed by SIGKILL while running; it stays away: its 2 restarts are used up")
        incidents = s.conductor.incidents.sentences
        assert any("dx: it stays away: its 2 restarts are used up" in one for one in incidents)
        for victim in ("cx", "environment"):  # its peers come back without it
            s.kill(victim)
            s.settle()
            assert s.conductor.states[victim] is NodeState.RUNNING
        assert s.processes["cx"].absent >= {"dx"}
        s.kill("environment")
        s.settle()
        others = {node: state for node, state in s.conductor.states.items() if node != "dx"}
        assert set(others.values()) == {NodeState.RUNNING}
        assert len(s.conductor.faults) == 1

    def test_a_long_run_is_a_clean_slate(self) -> None:
        s = session(restarts=1)
        for _ in range(4):
            s.now += WINDOW
            s.kill("dx")
            s.settle()
        assert s.joined()
        s.now += WINDOW - 1
        s.kill("dx")
        s.settle()
        assert s.conductor.states["dx"] is NodeState.GONE

    def test_deaths_while_rejoining_count_despite_a_long_run_before(self) -> None:
        s = session(restarts=2)
        s.now = 10 * WINDOW
        for _ in range(3):
            s.kill("cx")
            s.see_end()
            s.read("environment")
            s.deliver()
        assert s.conductor.states["cx"] is NodeState.GONE

    @pytest.mark.parametrize(
        "victims", [("environment",), ("dx", "dy", "dz"), ("cx", "cy", "dz"), ("cu", "cv", "dx", "cy")]
    )
    def test_when_nobody_is_left_to_go_on_with_the_session_ends(self, victims: tuple[str, ...]) -> None:
        s = session(restarts=1)
        for victim in victims:
            assert s.conductor.phase is SessionPhase.RUNNING
            for _ in range(2):
                s.kill(victim)
                s.settle()
        assert s.terminated
        assert s.conductor.phase is SessionPhase.OVER
        assert len(s.conductor.faults) == len(victims)

    def test_no_process_to_be_had_is_a_death(self) -> None:
        s = session(restarts=1)
        s.kill("dx")
        s.settle()
        c = s.conductor
        c.exited("dx", -9, 0)
        assert c.states["dx"] is NodeState.GONE
        c.exited("dy", -9, 0)
        c.receive("cy", Offer("dy", "ipc:///anew"), 0)
        assert c.not_started("dy", "Resource temporarily unavailable", 0) == []
        assert "dy could not be started (Resource temporarily unavailable)" in c.faults[1]


class Test_returns_that_fail:
    def test_a_fault_while_rejoining_is_a_death_and_ends_no_session(self) -> None:
        s = session()
        s.kill("cx")
        s.see_end()
        s.read("environment")
        s.deliver()
        assert s.conductor.receive("cx", Fault("cx: no answer of dx"), 0) == [Send("cx", Stop("received"))]
        assert s.conductor.states["cx"] is NodeState.LEAVING
        s.said.clear()  # this was its only message
        s.kill("cx")
        s.settle()
        assert s.joined()
        assert any("cx could not return: cx: no answer of dx" in one for one in s.conductor.incidents.sentences)

    def test_a_fault_of_one_that_runs_ends_the_session(self) -> None:
        c = session().conductor
        assert c.receive("cx", Fault("cx: flooded"), 0) == [Send("cx", Stop("received")), Terminate()]
        assert c.faults == ["cx: flooded"]

    def test_a_fault_of_a_device_ends_a_session_without_restarts(self) -> None:
        c = session(restarts=0).conductor
        assert c.receive("dx", Fault("dx: unplugged"), 0) == [Send("dx", Stop("received")), Terminate()]
        assert c.faults == ["dx: unplugged"]

    def test_a_device_that_failed_comes_back_a_limited_number_of_times(self) -> None:
        """Its hardware may be plugged in again; a driver that fails all the time is given up."""
        s = session(restarts=2)
        for state in (NodeState.RUNNING, NodeState.RUNNING, NodeState.GONE):
            s.said.append(("dx", Fault("dx: unplugged")))
            s.deliver()
            assert s.conductor.states["dx"] is NodeState.LEAVING
            s.kill("dx")
            s.settle()
            assert s.conductor.states["dx"] is state
        assert all("dx failed: dx: unplugged" in one for one in s.conductor.incidents.sentences[:1])
        assert s.conductor.phase is SessionPhase.RUNNING

    def test_a_hello_that_is_refused(self) -> None:
        s = session(restarts=1)
        s.kill("dx")
        s.see_end()
        s.read("cx")
        s.deliver()
        c = s.conductor
        c.started("dx", 7)
        (told,) = c.receive("dx", hello_of(GRAPH, "dx", {"dy": "ipc:///d"}, 7), 0)
        assert isinstance(told, Send)
        assert isinstance(told.message, Refusal)
        assert c.states["dx"] is NodeState.LEAVING
        c.exited("dx", 4, 0)
        assert c.states["dx"] is NodeState.GONE  # that was its second death
        assert c.phase is SessionPhase.RUNNING

    @pytest.mark.parametrize("reads", [0, 1])
    def test_one_that_takes_too_long(self, reads: int) -> None:
        """Too long for its hello, or for its handshakes."""
        s = session()
        s.kill("dx")
        s.see_end()
        s.read("cx")
        for _ in range(1 + reads):
            s.deliver()
        c = s.conductor
        assert c.look(RETURN_TIME) == []
        s.said.clear()
        s.obey(c.look(RETURN_TIME + 1))
        assert s.killed == ["dx"]
        assert c.look(RETURN_TIME + 1) == []
        s.settle()
        assert s.joined()

    def test_who_waits_for_others_may_take_as_long_as_they_do(self) -> None:
        s = session()
        s.kill("cx")
        s.see_end()
        s.now = 100 * RETURN_TIME
        assert s.conductor.look(s.now) == []
        s.settle()  # the environment was stopped all that time
        assert s.joined()


class Test_the_end:
    def done(self, s: FakeSession, *nodes: str) -> None:
        for node in nodes:
            s.conductor.receive(node, DONE, 0)
            s.processes.pop(node, None)
            s.conductor.exited(node, 0, 0)

    def test_a_lost_node_is_not_waited_for(self) -> None:
        s = session()
        s.kill("dx")
        s.see_end()  # and cx has not made its offer
        self.done(s, *(node for node in reversed(NODES) if node != "dx"))
        assert s.conductor.phase is SessionPhase.OVER
        assert s.conductor.faults == []
        assert s.conductor.incidents.total == 1

    def test_nor_is_one_on_its_way_back(self) -> None:
        s = session()
        s.kill("dx")
        s.see_end()
        s.read("cx")
        s.deliver()
        s.obey(s.conductor.receive("environment", DONE, 0))
        assert s.killed == ["dx"]
        while s.see_end():
            pass
        assert s.conductor.states["dx"] is NodeState.ENDED
        s.conductor.exited("environment", 0, 0)
        self.done(s, *(node for node in NODES if node not in ("dx", "environment")))
        assert s.conductor.phase is SessionPhase.OVER
        assert s.conductor.faults == []

    def test_who_dies_after_the_environment_was_done_is_not_started_anew(self) -> None:
        s = session()
        self.done(s, "environment")
        assert s.conductor.exited("dx", -9, 0) == [Send("cx", Absent("dx"))]
        assert s.conductor.states["dx"] is NodeState.ENDED
        assert s.conductor.faults == []
        assert s.conductor.incidents.total == 1

    def test_one_that_comes_back_ends_with_the_session(self) -> None:
        s = session()
        s.kill("dx")
        s.settle()
        self.done(s, *reversed(NODES))
        assert s.conductor.phase is SessionPhase.OVER
        assert s.conductor.faults == []
        assert set(s.conductor.reports) == set(NODES)

    def test_who_is_not_done_long_after_the_environment_is_left_behind(self) -> None:
        s = session()
        self.done(s, *(node for node in reversed(NODES) if node != "dx"))
        assert s.conductor.too_late() == [Terminate()]
        assert s.conductor.incidents.sentences == ("dx had not finished when the session was over",)
        assert s.conductor.exited("dx", -9, 0) == []
        assert (s.conductor.phase, s.conductor.faults) == (SessionPhase.OVER, [])

    def test_a_node_done_long_before_the_environment_ends_the_session(self) -> None:
        s = session()
        self.done(s, "dx")
        assert s.conductor.too_late() == [Terminate()]
        assert s.conductor.faults[0].startswith("dx had done every tick long before dy, dz, cx")

    def test_ctrl_c_while_one_is_lost_and_one_is_starting(self) -> None:
        s = session()
        s.kill("dx")
        s.kill("cy")
        s.see_end()
        s.see_end()
        s.read("cx")
        s.deliver()
        assert (s.conductor.states["dx"], s.conductor.states["cy"]) == (NodeState.STARTING, NodeState.LOST)
        assert s.conductor.interrupt() == [Terminate()]
        for node in list(s.processes):
            s.kill(node)
        while s.see_end():
            pass
        assert (s.conductor.phase, s.conductor.faults) == (SessionPhase.OVER, [])

    def test_ctrl_c_while_one_is_gone_for_good(self) -> None:
        s = session(restarts=1)
        for _ in range(2):
            s.kill("dx")
            s.settle()
        assert s.conductor.interrupt() == [Terminate()]
        for node in list(s.processes):
            s.kill(node)
        while s.see_end():
            pass
        assert s.conductor.phase is SessionPhase.OVER


class Test_nodes_that_are_started_elsewhere:
    def test_one_that_falls_silent_is_lost_and_may_join_again(self) -> None:
        c = session(3, "dx").conductor
        assert c.silent("dx", 0) == [ReleaseName("dx"), Send("cx", Absent("dx"))]
        assert c.states["dx"] is NodeState.LOST
        assert c.silent("dx", 0) == []
        assert c.receive("cx", Offer("dx", "tcp://anew"), 0) == []  # the supervisor does not start it
        told = c.receive("dx", hello_of(GRAPH, "dx", {}), 0)
        assert told == [Send("dx", Welcome()), Send("dx", Connect({"cx": "tcp://anew"}))]
        assert c.receive("dx", Ready(), 0) == [Send("dx", Start(EPOCH_DELAY_NS, TICKS, 1))]
        assert c.faults == []

    def test_it_may_be_back_before_there_is_a_place_for_it(self) -> None:
        c = session(3, "dx").conductor
        c.silent("dx", 0)
        assert c.receive("dx", hello_of(GRAPH, "dx", {}), 0) == [Send("dx", Welcome())]
        assert c.receive("cx", Offer("dx", "tcp://anew"), 0) == [Send("dx", Connect({"cx": "tcp://anew"}))]

    def test_a_living_lost_guest_is_asked_to_join_again(self) -> None:
        c = session(3, "dx").conductor
        c.silent("dx", 0)
        told = c.receive("dx", Telemetry(9, Figures(), {}), 0)
        assert told == [Send("dx", Stop("the session counted this node as lost; join again")), ReleaseName("dx")]
        assert c.ignored == 1

    def test_others_do_not_wait_for_it_to_come_back(self) -> None:
        """Its user may have gone home."""
        s = session(3, "cx")
        s.processes.pop("cx")
        s.obey(s.conductor.silent("cx", 0))
        s.kill("dx")
        s.kill("environment")
        s.settle()
        assert s.conductor.states["dx"] is NodeState.RUNNING
        assert s.conductor.states["environment"] is NodeState.RUNNING
        s.start("cx")  # and then its user starts it again
        s.settle()
        assert s.joined()

    def test_two_nodes_that_rejoin_side_by_side_meet_in_the_end(self) -> None:
        """Each has received the other's absence."""
        c = session(3, "cx").conductor
        c.silent("cx", 0)
        c.exited("dx", -9, 0)
        assert c.receive("dx", hello_of(GRAPH, "dx", {}), 0)[1:] == [Send("dx", Absent("cx")), Send("dx", Connect({}))]
        c.receive("environment", Offer("cx", "tcp://anew"), 0)
        assert Send("cx", Absent("dx")) in c.receive("cx", hello_of(GRAPH, "cx", {"dx": "tcp://cx-dx"}), 0)
        assert c.receive("cx", Offer("dx", "tcp://cx-dx.anew"), 0) == []
        c.receive("dx", Ready(), 0)
        assert Send("dx", Return("cx", "tcp://cx-dx.anew")) in c.receive("cx", Ready(), 0)

    def test_its_deaths_are_counted_too(self) -> None:
        c = session(1, "dx").conductor
        c.silent("dx", 0)
        c.receive("cx", Offer("dx", "tcp://anew"), 0)
        c.receive("dx", hello_of(GRAPH, "dx", {}), 0)
        c.receive("dx", Ready(), 0)
        c.silent("dx", 0)
        assert c.states["dx"] is NodeState.GONE
        assert len(c.faults) == 1
        told = c.receive("dx", hello_of(GRAPH, "dx", {}), 0)
        assert told == [Send("dx", Stop("the session counted this node as lost; join again")), ReleaseName("dx")]

    def test_the_wrong_bundle_is_refused_and_the_right_one_may_follow(self) -> None:
        c = session(3, "dx").conductor
        c.silent("dx", 0)
        first, last = c.receive("dx", hello_of(GRAPH, "dx", {"dy": "tcp://d"}), 0)
        assert isinstance(first, Send)
        assert isinstance(first.message, Refusal)
        assert last == ReleaseName("dx")
        assert c.receive("dx", hello_of(GRAPH, "dx", {}), 0) == [Send("dx", Welcome())]
        assert c.faults == []


class Test_rungs:
    def test_the_environment_receives_the_shift(self) -> None:
        c = session().conductor
        assert c.shift("cx", 2) == [Send("environment", Shift("cx", 2))]
        assert c.rungs == {"cx": 2}

    @pytest.mark.parametrize(
        ("victim", "told"), [("environment", {"cx", "cu"}), ("cx", {"cx"}), ("dz", {"cu"}), ("dy", set())]
    )
    def test_a_shift_is_sent_again_to_a_returning_node(self, victim: str, told: set[str]) -> None:
        s = session()
        s.obey(s.conductor.shift("cx", 2))
        s.obey(s.conductor.shift("cu", 1))
        s.settle()
        s.processes["environment"].shifts.clear()
        s.kill(victim)
        s.settle()
        assert {one.node for one in s.processes["environment"].shifts} == told

    def test_not_before_and_not_after(self) -> None:
        assert conductor().shift("cx", 1) == []
        c = session().conductor
        c.interrupt()
        assert c.shift("cx", 1) == []
        assert c.stop("too slow") == []


def test_a_policy_may_end_the_session() -> None:
    c = session().conductor
    assert c.stop("dx: too slow") == [Terminate()]
    assert c.faults == ["dx: too slow"]


def test_a_link_is_offered_and_joined_again_by_one_way_alone() -> None:
    """An endpoint is sent once, and only after it exists."""
    into = {target: {event for (_, event), one in LINK_TRANSITIONS.items() if one is target} for target in LinkState}
    assert into[LinkState.JOINED] == {LinkEvent.SENT}
    assert {state for (state, event) in LINK_TRANSITIONS if event is LinkEvent.SENT} == {LinkState.OFFERED}
    assert {state for (state, event) in LINK_TRANSITIONS if event is LinkEvent.PLACE} == {LinkState.CUT}
