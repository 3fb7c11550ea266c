"""The couplings around an environment: frozen, expected, active again, and changed to other rungs.

The core is real; the test provides links, line and time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.environment.core import EnvironmentCore
from manyhands.nodes.environment.late_arrivals import LateArrivals
from manyhands.nodes.environment.membership import FIRST_PAUSE, LEAD, MOST_AHEAD, STREAK, Member, Members, Membership
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.kernel.arithmetic import feedthrough_digest
from manyhands.nodes.kernel.bundle import Peer
from manyhands.nodes.kernel.timeouts import PATIENCE_TICKS, RAMP, Timeouts
from manyhands.nodes.link.join import Received
from manyhands.nodes.link.peer_link import PeerLink
from manyhands.nodes.rows.tick_events import Kind, TickEvent, events_in
from manyhands.protocol.clock import Duration, Instant, RealtimeClock
from manyhands.protocol.codec import encode
from manyhands.protocol.gate import Bounds, Gate
from manyhands.protocol.limits import MAX_STRAY_FRAMES
from manyhands.protocol.messages import PROTOCOL_VERSION, Absent, LinkHello, Reaction, Role, Rung, Shift, Tool, Welcome

from ...support.message_link import MessageLink
from ...support.reaction import react

T, STIFFNESS, DAMPING = 1e-3, 100.0, 0.1  # s, N/m, N s/m: a spring and a damper to ground at each port
NAMES = ("cx", "cy")
D_V = 1e-3  # m/N, at rung 0; divided by the rung + 1 above
RUNGS = {name: tuple(np.array([[D_V / (rung + 1)]]) for rung in (1, 2)) for name in NAMES}
NOW = Duration(0)


class BindingLine:
    """The environment's line to its supervisor, and the links that it binds anew."""

    def __init__(self) -> None:
        self.fresh: dict[str, MessageLink] = {}

    def bind_anew(self, peer: Peer) -> tuple[MessageLink, str]:
        self.fresh[peer.name] = MessageLink()
        return self.fresh[peer.name], "memory://fresh"

    def offer(self, _peer: str, _endpoint: str) -> None:
        pass


class TwoCouplings:
    """An environment of two couplings with one port each, tick by tick."""

    def __init__(self, life: Any, resumes: bool = False, tick: int = 0, independent: bool = True) -> None:
        walls, each = STIFFNESS + DAMPING / T, np.eye(2)
        E = StateSpace(np.zeros((2, 2)), each, -DAMPING / T * each, walls * each)
        self.core = EnvironmentCore(E, D_V * each, None, T, [slice(0, 1), slice(1, 2)])
        self.life, self.line, self.tick, self.p = life, BindingLine(), tick, np.zeros(2)
        self.ends = {name: MessageLink() for name in NAMES}
        own = LinkHello(PROTOCOL_VERSION, "c", "s", "environment", Role.ENVIRONMENT, ("p",))
        joins = [
            PeerLink(own, Peer(name, Role.COUPLING, ("p",), True), end, Tool, slice(i, i + 1), RealtimeClock())  # type: ignore[arg-type]
            for i, (name, end) in enumerate(self.ends.items())
        ]
        self.members = Members(joins, self.core, RUNGS, life, resumes, independent)
        self.members.know(
            {name: np.array([[D_V]]) for name in NAMES}, dict.fromkeys(NAMES, feedthrough_digest([[D_V]]))
        )
        self.cx, self.cy = self.members.all

    def hear(self, member: Member) -> Received:
        return self.members.hear(member, self.p, self.tick, NOW)

    def say(self, name: str, tick: int | None = None, value: float = 0.01) -> None:
        """Send a coupling's p(k), m, by default of this tick."""
        self.ends[name].say(Tool(self.tick if tick is None else tick, 0, np.array([value])))

    def finish(self) -> np.ndarray:
        """Solve, answer, and go on to the next tick; returns the forces."""
        f = react(self.core, self.p)
        self.members.shift()
        for member in self.members.active:
            member.join.send(Reaction, self.tick, 0, f)
        self.core.settle()
        self.tick += 1
        return f

    def together(self, ticks: int = 1, *, but: str = "") -> None:
        """Run ticks in which all couplings except ``but`` send, are received and are answered."""
        for _ in range(ticks):
            for member in self.members.all:
                if member.join.peer.name != but:
                    self.say(member.join.peer.name)
                    assert self.hear(member) is Received.SIGNAL
            self.finish()

    def forces(self, name: str) -> dict[int, float]:
        """The forces that it received, by tick."""
        return {told.tick: told.values[0] for told in self.ends[name].said if isinstance(told, Reaction)}

    def lose(self, name: str) -> None:
        self.members.obey(Absent(name), self.line, self.tick)  # type: ignore[arg-type]

    def come_back(self, name: str, feedthrough: float = D_V) -> Received:
        """A coupling's next process shakes hands."""
        end = self.ends[name] = self.line.fresh[name]
        hello = LinkHello(PROTOCOL_VERSION, "c", "s", name, Role.COUPLING, ("p",), ((feedthrough,),))
        end.say(hello, Welcome())
        return self.hear(self.members.all[NAMES.index(name)])


@pytest.fixture(autouse=True)
def whoever_presses(monkeypatch: pytest.MonkeyPatch) -> None:
    """The users press all the time; that is light for the clutches, except where a test says otherwise."""
    monkeypatch.setattr("manyhands.nodes.environment.membership.LIGHT", math.inf)


@pytest.fixture
def world(new_life: Callable[[], Any]) -> TwoCouplings:
    return TwoCouplings(new_life())


def test_together_everybody_is_heard_and_answered(world: TwoCouplings) -> None:
    world.together(3)
    assert world.members.all_active
    assert (world.members.frozen, world.members.absences) == (0, 0)
    forces = world.forces("cx")
    assert forces.keys() == {0, 1, 2}
    assert all(force < 0.0 for force in forces.values())


def test_who_is_given_up_is_frozen_and_not_answered(world: TwoCouplings) -> None:
    world.together()
    world.say("cx")
    world.hear(world.cx)
    assert world.cy.missing(world.tick)
    world.members.give_up(world.cy, world.tick)
    assert not world.cy.missing(world.tick)
    assert world.core.clutches.all[1].ratio == 0.0
    assert world.members.active == [world.cx]
    before = world.core.clutches.all[1].offset
    world.finish()
    assert world.forces("cy").keys() == {0}
    world.together(50, but="cy")
    assert world.core.clutches.all[1].ratio == 0.0
    np.testing.assert_array_equal(world.core.clutches.all[1].offset, before)
    assert (world.members.frozen, world.members.absences) == (1, 1)


def frozen_for(world: TwoCouplings, ticks: int) -> int:
    """The coupling cy is silent for so long; returns the tick that it is at."""
    world.together(200)
    behind = world.tick
    world.say("cx")
    world.hear(world.cx)
    world.members.give_up(world.cy, world.tick)
    world.finish()
    world.together(ticks - 1, but="cy")
    return behind


def test_a_member_behind_receives_its_due_tick_and_is_awaited_there(world: TwoCouplings) -> None:
    behind = frozen_for(world, 20)
    world.say("cy", behind)
    assert world.hear(world.cy) is Received.NOTHING
    due = world.tick + LEAD
    assert (world.cy.membership.state, world.cy.due) == (Membership.REJOINING, due)
    assert world.forces("cy")[due - 1] == 0.0
    while world.tick < due:
        assert not world.cy.missing(world.tick)  # no member waits in the meantime
        world.together(but="cy")
    assert world.cy.missing(due)


def test_it_rejoins_by_a_ramp_from_zero_force(world: TwoCouplings) -> None:
    behind = frozen_for(world, 20)
    world.say("cy", behind)
    world.hear(world.cy)
    world.together(LEAD, but="cy")
    first = world.tick
    world.together(RAMP + 1)
    assert world.members.all_active
    forces = world.forces("cy")
    assert forces[first] == 0.0
    steps = np.diff([forces[first + k] for k in range(RAMP + 1)])
    # s moves by at most pi/(2 RAMP) a tick, and f_c = s f_e with x_e moved by s as well
    assert np.max(np.abs(steps)) <= np.pi / RAMP * (STIFFNESS + DAMPING / T) * 0.01
    assert world.core.clutches.all[1].ratio == 1.0


def test_the_signal_of_its_due_tick_may_come_early(world: TwoCouplings) -> None:
    behind = frozen_for(world, 20)
    world.say("cy", behind)
    world.hear(world.cy)
    due = world.cy.due
    dropped = dict(world.cy.join.gate.dropped)
    world.say("cy", due, 0.02)
    assert world.hear(world.cy) is Received.DECLINED
    assert world.cy.join.gate.dropped == dropped  # it is no stray
    while world.tick < due:
        world.together(but="cy")
        assert world.p[1] == 0.01
    assert world.hear(world.cy) is Received.SIGNAL
    assert (world.p[1], world.cy.membership.state) == (0.02, Membership.ACTIVE)


def test_who_is_ahead_is_expected_at_its_own_tick(world: TwoCouplings) -> None:
    """It received that tick and was frozen again, or an earlier environment sent it there."""
    frozen_for(world, 20)
    due = world.tick + LEAD
    world.say("cy", due, 0.02)
    assert world.hear(world.cy) is Received.DECLINED
    assert (world.cy.membership.state, world.cy.due) == (Membership.REJOINING, due)
    assert world.cy.join.gate.dropped["future_tick"] == 0  # it is no stray
    world.say("cy", due + 1, 0.03)  # it knows better still
    world.hear(world.cy)
    while world.tick < due + 1:
        assert not world.cy.missing(world.tick)
        world.together(but="cy")
    assert world.hear(world.cy) is Received.SIGNAL
    assert (world.p[1], world.cy.membership.state) == (0.03, Membership.ACTIVE)


def test_a_signal_from_before_its_due_tick_was_known_activates_nobody(world: TwoCouplings) -> None:
    """It is on its way to that tick, and would be waited for in between."""
    behind = frozen_for(world, 20)
    world.say("cy", behind)
    world.hear(world.cy)
    due = world.cy.due
    world.say("cy")
    assert world.hear(world.cy) is Received.NOTHING
    assert (world.cy.membership.state, world.cy.due) == (Membership.REJOINING, due)
    while world.tick < due:
        assert not world.cy.missing(world.tick)
        world.together(but="cy")
    world.together()
    assert world.members.all_active


def test_with_nobody_active_the_session_continues_at_the_furthest_tick(world: TwoCouplings) -> None:
    frozen_for(world, 20)
    world.ends["cx"].say(Absent("dx"))
    world.hear(world.cx)
    assert world.members.soonest(world.tick) == world.tick
    world.say("cy", world.tick + 50)
    world.hear(world.cy)
    assert world.members.soonest(world.tick) == world.tick + 50


@pytest.mark.parametrize("ahead", [MOST_AHEAD + 1, 2**40])
def test_a_signal_of_a_tick_far_ahead_is_a_stray(world: TwoCouplings, ahead: int) -> None:
    frozen_for(world, 20)
    world.say("cy", world.tick + ahead)
    assert world.hear(world.cy) is Received.NOTHING
    assert (world.cy.early, world.cy.membership.state) == (None, Membership.FROZEN)
    assert world.cy.join.gate.dropped["future_tick"] == 1


def test_an_active_members_signal_of_a_later_tick_is_a_stray(world: TwoCouplings) -> None:
    world.together(3)
    world.say("cy", world.tick + 1)
    assert world.hear(world.cy) is Received.NOTHING
    assert (world.cy.early, world.cy.membership.state) == (None, Membership.ACTIVE)
    assert world.cy.join.gate.dropped["future_tick"] == 1


def test_a_coupling_without_its_device_is_answered_at_its_early_tick(world: TwoCouplings) -> None:
    """Without the answer it would wait in silence, and peers that wait for its device's return would wait for it."""
    frozen_for(world, 20)
    ahead = world.tick + LEAD
    world.say("cy", ahead)
    world.hear(world.cy)
    world.ends["cy"].say(Absent("dy"))
    assert world.hear(world.cy) is Received.DECLINED
    assert (world.cy.early, world.cy.membership.state) == (None, Membership.FROZEN)
    assert world.forces("cy")[ahead] == 0.0


def test_what_came_early_from_one_that_was_lost_since_is_forgotten(world: TwoCouplings) -> None:
    behind = frozen_for(world, 20)
    world.say("cy", behind)
    world.hear(world.cy)
    world.say("cy", world.cy.due)
    world.hear(world.cy)
    world.lose("cy")
    for _ in range(LEAD + 2):
        assert world.hear(world.cy) is Received.NOTHING
        world.together(but="cy")
    assert world.cy.membership.state is Membership.GONE
    assert world.core.clutches.all[1].ratio == 0.0


def test_a_member_absent_when_due_gets_a_pause(world: TwoCouplings) -> None:
    behind = frozen_for(world, 20)
    world.say("cy", behind)
    world.hear(world.cy)
    world.together(LEAD, but="cy")
    world.say("cx")
    world.hear(world.cx)
    world.members.give_up(world.cy, world.tick)
    world.finish()
    said = len(world.ends["cy"].said)
    for _ in range(FIRST_PAUSE - 1):
        world.say("cy", behind)
        world.hear(world.cy)
        assert world.cy.membership.state is Membership.FROZEN
        world.together(but="cy")
    assert len(world.ends["cy"].said) == said
    world.say("cy", behind)
    world.hear(world.cy)
    assert world.cy.membership.state is Membership.REJOINING


def test_a_signal_that_was_answered_is_answered_again_as_before(world: TwoCouplings) -> None:
    world.together(3)
    said = world.ends["cy"].said
    last = said[-1]
    world.say("cy", world.tick - 1)
    assert world.hear(world.cy) is Received.NOTHING
    assert said[-1] == last
    assert len(said) == 4
    world.say("cy", world.tick - 2)  # no peer asks so late
    world.hear(world.cy)
    assert len(said) == 4
    assert world.members.all_active


def test_a_coupling_that_has_lost_a_device_is_frozen_at_once(world: TwoCouplings) -> None:
    world.together(200)
    world.ends["cy"].say(Absent("dy"))
    assert world.hear(world.cy) is Received.DECLINED
    assert world.cy.membership.state is Membership.FROZEN
    assert not world.cy.missing(world.tick)
    world.say("cy")  # its device is back already
    assert world.hear(world.cy) is Received.SIGNAL
    assert world.cy.membership.state is Membership.ACTIVE


@pytest.mark.parametrize("left", range(1, LEAD + 1))
def test_near_the_end_one_is_invited_to_the_last_tick(world: TwoCouplings, left: int) -> None:
    """Not beyond it: an active block may wait for a device of several blocks, and the device for this block's force."""
    behind = frozen_for(world, 20)
    world.members.last = world.tick + left
    world.say("cy", behind)
    world.hear(world.cy)
    assert (world.cy.membership.state, world.cy.due) == (Membership.REJOINING, world.members.last - 1)
    told = world.ends["cy"].said[-1]
    assert isinstance(told, Reaction)
    assert (told.tick, told.values.tolist()) == (world.members.last - 2, [0.0])


def test_a_flood_ends_the_environment(world: TwoCouplings) -> None:
    world.ends["cy"].coming.extend([b"\xc1"] * (MAX_STRAY_FRAMES + 1))
    assert world.hear(world.cy) is Received.NOTHING
    assert world.life.failure.startswith("environment: cy sent 513 stray frames")


def test_a_member_that_waited_in_vain_rejoins_by_a_ramp(world: TwoCouplings) -> None:
    world.together(3)
    world.members.let_in_again(world.tick)
    first = world.tick
    assert TickEvent(Kind.RAISED, first, 1) in events_in(world.members.events.take(0, first))
    world.together(2)
    assert world.forces("cx")[first] == world.forces("cy")[first] == 0.0
    assert world.members.all_active
    assert 0.0 < world.core.clutches.all[0].ratio < 0.01


class Test_a_coupling_that_was_lost:
    def test_is_welcomed_receives_the_tick_and_rejoins(self, world: TwoCouplings) -> None:
        world.together(200)
        world.lose("cy")
        assert world.cy.membership.state is Membership.GONE
        world.together(5, but="cy")
        assert world.come_back("cy") is Received.RECONNECTED
        assert world.cy.membership.state is Membership.FROZEN
        assert world.forces("cy") == {world.tick - 1: 0.0}
        world.together()
        assert world.members.all_active
        assert world.forces("cy")[world.tick - 1] == 0.0
        assert world.members.absences == 1

    def test_is_not_let_in_with_another_feedthrough(self, world: TwoCouplings) -> None:
        world.together(200)
        world.lose("cy")
        world.come_back("cy", 2 * D_V)
        assert (world.cy.membership.state, world.cy.join.reachable) == (Membership.GONE, False)
        world.together(3, but="cy")
        assert world.core.clutches.all[1].ratio == 0.0

    def test_is_at_the_first_rung_and_shifted_again_before_it_rejoins(self, world: TwoCouplings) -> None:
        world.together(200)
        world.members.obey(Shift("cy", 2), world.line, world.tick)  # type: ignore[arg-type]
        world.together(2 * RAMP)
        assert world.cy.rung == 2
        world.lose("cy")
        world.together(3, but="cy")
        world.come_back("cy")
        assert (world.cy.rung, world.cy.wanted) == (0, 2)
        world.together()
        said = [told for told in world.ends["cy"].said if isinstance(told, Rung | Reaction)]
        assert [type(told) for told in said] == [Reaction, Rung, Reaction]
        assert (said[1], said[2].values) == (Rung(2), [0.0])  # type: ignore[union-attr]
        assert world.core._D_V[1, 1] == RUNGS["cy"][1][0, 0]
        world.together(RAMP + 1)
        assert world.core.clutches.all[1].ratio == 1.0


class Test_a_change_of_rung:
    @pytest.mark.parametrize("independent", [True, False])
    def test_waits_until_its_user_presses_no_longer(
        self, new_life: Callable[[], Any], monkeypatch: pytest.MonkeyPatch, independent: bool
    ) -> None:
        monkeypatch.setattr("manyhands.nodes.environment.membership.LIGHT", 0.2)
        world = TwoCouplings(new_life(), independent=independent)
        world.together(200)
        for name in NAMES:
            world.members.obey(Shift(name, 1), world.line, world.tick)  # type: ignore[arg-type]
        before = world.forces("cy")[world.tick - 1]
        assert abs(before) > 0.2
        world.together(3 * RAMP)
        assert world.forces("cy")[world.tick - 1] == pytest.approx(before, rel=1e-3)
        assert (world.cx.rung, world.cy.rung) == (0, 0)
        for _ in range(3 * RAMP):  # cx lets go: where all change in one tick, it waits for cy
            world.say("cx", value=0.0)
            world.say("cy")
            for member in world.members.all:
                world.hear(member)
            world.finish()
        assert (world.cx.rung, world.cy.rung) == (int(independent), 0)
        assert world.core.clutches.all[0].ratio == 1.0
        for _ in range(3 * RAMP):
            for member in world.members.all:
                world.say(member.join.peer.name, value=0.0)
                world.hear(member)
            world.finish()
        assert (world.cx.rung, world.cy.rung) == (1, 1)
        assert [clutch.ratio for clutch in world.core.clutches.all] == [1.0, 1.0]

    def test_is_sent_at_zero_force_and_before_it(self, world: TwoCouplings) -> None:
        world.together(200)
        world.members.obey(Shift("cy", 1), world.line, world.tick)  # type: ignore[arg-type]
        world.ends["cy"].said.clear()
        while world.cy.rung == 0:
            world.together()
            assert world.tick < 200 + 2 * RAMP
        said = world.ends["cy"].said
        assert said[-2] == Rung(1)
        assert isinstance(said[-1], Reaction)
        assert said[-1].values == [0.0]
        assert not any(isinstance(told, Rung) for told in said[:-2])
        forces = [told.values[0] for told in said if isinstance(told, Reaction)]
        assert np.all(np.diff(forces) >= 0.0)  # it only fades
        assert world.core._D_V[1, 1] == RUNGS["cy"][0][0, 0]
        world.together(RAMP + 1)
        assert world.core.clutches.all[1].ratio == 1.0
        assert not any(isinstance(told, Rung) for told in world.ends["cx"].said)

    def test_comes_with_the_second_tick_without_force(self, world: TwoCouplings) -> None:
        """The first one's step of the force is of the rung before, and its delay is not the new one's to promise."""
        world.together(200)
        world.members.obey(Shift("cy", 1), world.line, world.tick)  # type: ignore[arg-type]
        while world.cy.rung == 0:
            world.together()
        said = world.ends["cy"].said
        assert said[-2] == Rung(1)
        without = [told.values[0] == 0.0 for told in said if isinstance(told, Reaction)]
        assert without[-3:] == [False, True, True]

    def test_that_is_taken_back_leaves_nobody_frozen(self, world: TwoCouplings) -> None:
        world.together(200)
        for word in (Shift("cy", 1), Shift("cy", 0)):
            world.members.obey(word, world.line, world.tick)  # type: ignore[arg-type]
            world.together(RAMP // 2)
        assert (world.cy.rung, world.core.clutches.all[1].ratio) == (0, 1.0)

    @pytest.mark.parametrize("between", [0, RAMP // 2, 2 * RAMP])
    def test_where_no_mixture_is_certified_comes_for_all_in_one_tick(
        self, new_life: Callable[[], Any], between: int
    ) -> None:
        world = TwoCouplings(new_life(), independent=False)
        world.together(200)
        world.members.obey(Shift("cx", 1), world.line, world.tick)  # type: ignore[arg-type]
        world.together(between)
        assert world.cx.rung == 0
        world.members.obey(Shift("cy", 1), world.line, world.tick)  # type: ignore[arg-type]
        while world.cy.rung == 0:
            assert world.cx.rung == 0
            world.together()
        assert world.cx.rung == 1
        world.together(RAMP + 1)
        assert [world.core.clutches.all[block].ratio for block in (0, 1)] == [1.0, 1.0]

    def test_without_certified_mixture_waits_for_no_frozen_member(self, new_life: Callable[[], Any]) -> None:
        world = TwoCouplings(new_life(), independent=False)
        frozen_for(world, 20)
        for name in NAMES:
            world.members.obey(Shift(name, 1), world.line, world.tick)  # type: ignore[arg-type]
        world.together(RAMP + 2, but="cy")
        assert (world.cx.rung, world.cy.rung) == (1, 0)
        world.together()
        assert (world.cy.rung, world.core.clutches.all[1].ratio) == (1, 0.0)

    @pytest.mark.parametrize("word", [Shift("cy", 3), Shift("cz", 1)])
    def test_beyond_the_ladder_or_of_a_stranger_is_none(self, world: TwoCouplings, word: Shift) -> None:
        world.members.obey(word, world.line, world.tick)  # type: ignore[arg-type]
        world.together(3)
        assert (world.cy.rung, world.cy.wanted, world.core.clutches.all[1].ratio) == (0, 0, 1.0)

    def test_of_a_frozen_coupling_waits_until_it_is_active(self, world: TwoCouplings) -> None:
        frozen_for(world, 20)
        world.members.obey(Shift("cy", 1), world.line, world.tick)  # type: ignore[arg-type]
        world.together(but="cy")
        assert world.cy.rung == 0
        world.together()
        assert world.cy.rung == 1
        assert world.ends["cy"].said[-2] == Rung(1)


class Test_an_environment_that_comes_back:
    @pytest.fixture
    def back(self, new_life: Callable[[], Any]) -> TwoCouplings:
        return TwoCouplings(new_life(), resumes=True, tick=400)

    def test_awaits_everybody_with_nobody_let_in(self, back: TwoCouplings) -> None:
        assert [member.missing(400) for member in back.members.all] == [True, True]
        assert back.members.active == []
        assert all(back.core.clutches.all[block].ratio == 0.0 for block in (0, 1))

    def test_takes_the_greatest_tick_and_sends_it_to_others(self, back: TwoCouplings) -> None:
        back.say("cx", 430)
        assert back.hear(back.cx) is Received.DECLINED
        assert back.members.ahead == 430
        back.tick = 430
        back.members.catch_up(430)
        back.say("cy", 429)
        assert back.hear(back.cy) is Received.NOTHING
        assert back.forces("cy") == {429: 0.0}  # it is awaited at 430
        assert back.cy.missing(430)
        back.say("cx", 430)
        assert back.hear(back.cx) is Received.SIGNAL
        assert back.cx.membership.state is Membership.ACTIVE

    def test_ignores_nonsense(self, back: TwoCouplings) -> None:
        back.say("cx", 2**62)
        assert back.hear(back.cx) is Received.NOTHING
        assert back.members.ahead == 0

    def test_leads_again_once_a_tick_is_done(self, back: TwoCouplings) -> None:
        back.members.resumed()
        back.say("cx", 430)
        assert back.hear(back.cx) is Received.DECLINED
        assert (back.members.ahead, back.cx.due) == (0, 430)

    def test_answers_members_ahead_of_it_but_behind_others(self, back: TwoCouplings) -> None:
        back.say("cx", 429)
        assert back.hear(back.cx) is Received.DECLINED
        back.tick = 430  # as reported by cy
        assert back.hear(back.cx) is Received.NOTHING
        assert back.forces("cx") == {429: 0.0}
        assert back.cx.missing(430)


sayings = st.sampled_from(["now", "before", "long ago", "next", "due", "rung", "absent", "junk", "wrong kind"])
words = st.one_of(
    st.sampled_from([Absent(name) for name in (*NAMES, "dx")]),
    st.builds(Shift, st.sampled_from(NAMES), st.integers(0, 3)),
)
events = st.one_of(
    st.tuples(st.just("say"), st.sampled_from(NAMES), sayings),
    st.tuples(st.just("word"), words, st.none()),
    st.tuples(st.sampled_from(["give up", "come back"]), st.sampled_from(NAMES), st.none()),
    st.tuples(st.just("let go"), st.none(), st.none()),
    st.tuples(st.just("ticks"), st.integers(1, RAMP + 5), st.sampled_from([*NAMES, ""])),
)


@settings(max_examples=80)
@given(happening=st.lists(events, max_size=40))
@example(happening=[("word", Shift("cx", 1), None), ("give up", "cx", None), ("ticks", 10, "cy")])
@example(
    happening=[
        ("word", Shift("cy", 1), None),
        ("ticks", RAMP + 5, ""),
        ("word", Shift("cy", 0), None),
        ("ticks", 3, "cy"),
    ]
)
def test_whatever_happens(happening: list[tuple[Any, Any, Any]], new_life: Callable[[], Any]) -> None:
    """Active members are answered, others are frozen, and rungs change only at zero force."""
    world = TwoCouplings(new_life())
    rungs = dict.fromkeys(NAMES, 0)
    absences = 0
    for what, one, other in happening:
        if what == "say":
            tick = world.tick
            member = world.members.all[NAMES.index(one)]
            frame = {
                "now": encode(Tool(tick, 0, np.array([0.01]))),
                "before": encode(Tool(max(0, tick - 1), 0, np.array([0.01]))),
                "long ago": encode(Tool(max(0, tick - 30), 0, np.array([0.01]))),
                "next": encode(Tool(tick + 1, 0, np.array([0.01]))),
                "due": encode(Tool(member.due, 0, np.array([0.01]))),
                "rung": encode(Rung(1)),
                "absent": encode(Absent("dx")),
                "junk": b"\xc1",
                "wrong kind": encode(Reaction(tick, 0, np.array([0.01]))),
            }[other]
            world.ends[one].coming.append(frame)
            world.hear(member)
        elif what == "word":
            world.members.obey(one, world.line, world.tick)
        elif what == "give up":
            world.members.give_up(world.members.all[NAMES.index(one)], world.tick)
        elif what == "come back":
            if world.members.all[NAMES.index(one)].join.handshake is not None:
                world.come_back(one)
        elif what == "let go":
            world.members.let_in_again(world.tick)
        else:
            for _ in range(one):
                for member in world.members.all:
                    if member.join.peer.name != other and member.join.here:
                        world.say(member.join.peer.name)
                        world.hear(member)
                    if member.missing(world.tick):
                        world.members.give_up(member, world.tick)
                before = {name: len(world.ends[name].said) for name in NAMES}
                world.finish()
                for member in world.members.all:
                    name = member.join.peer.name
                    told = world.ends[name].said[before[name] :]
                    assert (member in world.members.active) == any(isinstance(one, Reaction) for one in told)
                    if member.rung != rungs[name]:
                        assert told[0] == Rung(member.rung)
                        assert told[1].values == [0.0]  # type: ignore[union-attr]
                        rungs[name] = member.rung
                    else:
                        assert not any(isinstance(one, Rung) for one in told)
        for member in world.members.all:
            active = member.membership.state is Membership.ACTIVE
            assert active == (member in world.members.active)
            assert active or world.core.clutches.all[member.index].ratio == 0.0
            rungs[member.join.peer.name] = member.rung
        assert world.members.all_active == (world.members.frozen == 0)
        assert world.members.absences >= absences
        absences = world.members.absences
        assert all(count >= 0 for member in world.members.all for count in member.join.gate.dropped.values())
    assert world.life.failure == ""


class Ticking:
    """Time that passes by a millisecond with every look at it."""

    def __init__(self) -> None:
        self.looks = 0

    def now(self) -> Instant:
        self.looks += 1
        assert self.looks < 1000, "it waits for ever"
        return Instant(self.looks * 10**6)


def late(world: TwoCouplings, ticks: int = 1) -> int:
    """The signal of cy does not come in time for so many ticks, in which cy is held; returns the first of them."""
    behind = world.tick
    for _ in range(ticks):
        world.say("cx")
        world.hear(world.cx)
        world.members.overdue(world.cy, world.tick)
        assert not world.cy.missing(world.tick)
        world.members.hold(world.tick, lambda _index, _tick: False)
        world.finish()
    return behind


def ends(world: TwoCouplings) -> tuple[float, float]:
    """The end of cy and its tool, m."""
    clutch = world.core.clutches.all[1]
    end = clutch.end(world.core.tools)
    assert end is not None
    return end[0], world.core.tools[1]


def test_who_is_late_is_held_and_answered_at_once_by_its_spring_from_a_tool_at_rest(world: TwoCouplings) -> None:
    world.together(200)
    end, tool = ends(world)
    assert end == tool
    behind = late(world, STREAK - 1)
    assert ends(world) == (end, tool)
    world.say("cy", behind, 0.013)
    assert world.hear(world.cy) is Received.NOTHING
    last = world.tick - 1
    assert world.forces("cy")[last] == pytest.approx((end - 0.013) / D_V, rel=1e-12)
    assert last not in {behind, *world.forces("cy").keys() - {last}}
    assert world.cy.missing(world.tick)  # it goes on after the tick of the answer
    world.together()
    assert world.members.all_active
    assert (world.members.absences, world.cy.held, world.cy.frozen_late) == (0, STREAK - 1, 0)
    assert world.members.events.take(0, world.tick)[f"held:cy@{behind}"] == STREAK - 1.0


def test_who_is_a_little_late_in_every_tick_moves_its_tool_now_and_then_and_nobody_waits(world: TwoCouplings) -> None:
    world.together(200)
    moved = 0
    for tick in range(40):
        behind, (end, _) = late(world), ends(world)
        world.say("cy", behind, 0.01 + 1e-5 * tick)
        if world.hear(world.cy) is Received.SIGNAL:  # it counts for the tick that is awaited
            assert world.cy.join.tick == world.tick
            world.say("cx")
            world.hear(world.cx)
            world.finish()
            moved += ends(world)[0] != end
        else:
            assert ends(world)[0] == end
    assert moved == 40 // STREAK
    assert (world.members.absences, world.cy.frozen_late) == (0, 0)


def test_after_a_hold_no_ramp_and_no_offset_are_left(world: TwoCouplings) -> None:
    """A second session, in which cy is not late, has the same forces from then on: its motion is the same."""
    other = TwoCouplings(world.life)
    for one in (world, other):
        one.together(200)
    late(world)
    world.say("cy", world.tick - 1)
    world.hear(world.cy)
    other.together()
    for one in (world, other):
        one.together(300)
    assert world.core.clutches.unsettled == []
    np.testing.assert_allclose(world.forces("cy")[world.tick - 1], other.forces("cy")[other.tick - 1], rtol=1e-9)


def test_a_held_member_goes_on_a_tick_later_where_its_device_would_sample_too_late(world: TwoCouplings) -> None:
    world.together(10)
    behind = late(world)
    world.members.over = lambda: True
    world.say("cy", behind)
    world.hear(world.cy)
    assert world.tick in world.forces("cy")
    assert not world.cy.missing(world.tick)
    assert world.cy.missing(world.tick + 1)


def test_where_all_others_are_gone_a_held_member_is_waited_for_at_the_tick_that_it_was_told(
    world: TwoCouplings,
) -> None:
    world.together(10)
    behind = late(world)
    world.members.over = lambda: True
    world.say("cy", behind)
    world.hear(world.cy)
    world.say("cy", world.tick + 1)  # it goes on after the answer, which was of this tick
    world.lose("cx")
    assert waiting(world) == world.tick + 1
    assert world.cy.membership.state is Membership.ACTIVE


def test_a_signal_that_came_early_and_is_late_now_counts_for_the_tick_that_is_awaited(world: TwoCouplings) -> None:
    world.together(10)
    behind = late(world, STREAK)
    world.say("cy", behind + STREAK + 1)  # beyond what it was told
    world.hear(world.cy)
    late(world, 3)
    assert world.hear(world.cy) is Received.SIGNAL
    assert (world.cy.membership.state, world.cy.join.tick) == (Membership.ACTIVE, world.tick)


def test_a_lost_answer_to_a_held_member_is_sent_again(world: TwoCouplings) -> None:
    world.together(10)
    late(world)
    last = world.ends["cy"].said[-1]
    world.say("cy", world.tick - 2)  # it has not received the force of the tick before it was held
    world.hear(world.cy)
    assert world.ends["cy"].said[-1] == last
    world.say("cy", world.tick - 1)
    world.hear(world.cy)
    answer = world.ends["cy"].said[-1]
    assert answer != last
    late(world)
    for _ in range(3):
        world.say("cy", world.tick - 2)
        world.hear(world.cy)
    assert world.ends["cy"].said[-3:] == [answer] * 3
    world.say("cy", world.tick - 5)  # an honest coupling's ticks rise
    world.hear(world.cy)
    assert len([told for told in world.ends["cy"].said if told == answer]) == 4


def test_who_stays_silent_is_frozen_at_last_and_returns_by_the_ramp(world: TwoCouplings) -> None:
    world.together(200)
    late(world, PATIENCE_TICKS)
    assert world.cy.membership.state is Membership.HELD
    late(world)
    assert (world.cy.membership.state, world.cy.frozen_late) == (Membership.FROZEN, 1)
    assert world.core.clutches.all[1].ratio == 0.0


def test_whose_block_has_no_force_that_could_hold_its_end_is_frozen_at_once(world: TwoCouplings) -> None:
    world.together(20)
    world.core._D_V = np.diag([D_V, 0.0])
    late(world)
    assert world.cy.membership.state is Membership.FROZEN


def test_a_change_of_rung_goes_on_after_a_hold(world: TwoCouplings) -> None:
    world.together(200)
    world.members.obey(Shift("cy", 1), world.line, world.tick)  # type: ignore[arg-type]
    for _ in range(300):
        if world.tick % 7 == 0:
            late(world)
            world.say("cy", world.tick - 1)
            world.hear(world.cy)
        world.together()
    assert (world.cy.rung, world.core.clutches.all[1].ratio) == (1, 1.0)


class Silence:
    """A line to a silent supervisor."""

    def listen(self, _timeouts: Duration = NOW) -> None:
        return None


def waiting(world: TwoCouplings) -> int:
    """The tick that an environment which waits in real time goes on at; by a clock that every look puts forward."""
    node = EnvironmentNode.__new__(EnvironmentNode)
    clock = node._clock = Ticking()  # type: ignore[assignment]
    node._late = LateArrivals(len(world.members.all), Duration(10**6), Duration(10**6))
    node._due, node._now, node._passed, node._await_links = Instant(0), clock.now(), (), None
    node._p = world.p  # type: ignore[assignment]
    node._period, node._timeouts = Duration(10**6), Timeouts(*(Duration(n * 10**6) for n in (3, 5, 3, 3, 2, 100)))
    world.life.look = lambda _now: None
    tick = node._wait(world.members, world.tick, world.life, Silence())  # type: ignore[arg-type]
    assert clock.looks < 1200
    assert tick is not None
    return tick


def test_members_ahead_wait_only_for_a_bounded_time_for_silent_ones(world: TwoCouplings) -> None:
    frozen_for(world, 20)
    world.say("cy", world.tick + 2)
    assert waiting(world) == world.tick + 2
    assert (world.cx.membership.state, world.cy.membership.state) == (Membership.HELD, Membership.ACTIVE)


class Coming(MessageLink):
    """What comes of a coupling every other time that it is listened to, by how often it was."""

    def __init__(self, of: Callable[[int, list[Any]], Tool | None]) -> None:
        super().__init__()
        self._of, self.times = of, 0

    def recv(self, _timeout: Duration | None) -> bytes | None:
        self.times += 1
        said = self._of(self.times, self.said) if self.times % 2 else None
        return None if said is None else encode(said)


def tool(tick: int, value: float = 0.01) -> Tool:
    return Tool(tick, 0, np.array([value]))


def test_who_was_given_up_need_not_pause_while_nobody_comes(world: TwoCouplings) -> None:
    behind = frozen_for(world, 20)
    for _ in range(2):  # it shows up and does not come: it is not expected for some ticks then
        world.say("cy", behind)
        world.hear(world.cy)
        world.together(LEAD, but="cy")
        world.members.give_up(world.cy, world.tick)
    due = world.tick + LEAD

    def say(_times: int, heard: list[Any]) -> Tool:
        return tool(due if heard and heard[-1] == Reaction(due - 1, 0, [0.0]) else behind)

    world.cy.join.link = Coming(say)
    assert waiting(world) == due
    assert world.cy.membership.state is Membership.ACTIVE


@pytest.mark.parametrize(("silent", "active"), [(2, False), (220, True)])
def test_only_after_long_a_signal_may_be_far_from_the_last(world: TwoCouplings, silent: int, active: bool) -> None:
    """Their devices have let go by then, and have moved on unheard."""
    for member in world.members.all:
        member.join.gate = Gate(Tool, 1, Bounds((1.0,), (0.001,)))
    world.together(3)
    world.cx.join.link = Coming(lambda times, _: tool(world.tick, 0.5) if times > silent else None)
    world.cy.join.link = Coming(lambda times, _: tool(world.tick) if times > silent else None)
    assert waiting(world) == world.tick
    assert (world.cx.membership.state is Membership.ACTIVE) == active
    assert world.cy.membership.state is Membership.ACTIVE


def test_at_the_end_frozen_members_are_answered_for_a_bounded_time(world: TwoCouplings) -> None:
    behind = frozen_for(world, 20)
    world.lose("cx")  # its link is gone
    end = world.members.last = world.tick
    node = EnvironmentNode.__new__(EnvironmentNode)
    clock = node._clock = Ticking()  # type: ignore[assignment]
    said = world.ends["cy"].said
    said.clear()
    for _ in range(3):
        world.say("cy", behind)
    node._p = world.p  # type: ignore[assignment]
    node._say_goodbye(world.members, end)
    assert said
    assert all(told == Reaction(end - 1, 0, [0.0]) for told in said)
    assert clock.looks <= 60
    assert not any(isinstance(told, Reaction) for told in world.line.fresh["cx"].said)
