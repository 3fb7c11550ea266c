"""A person who turns a device by a pointer: smoothly, no faster than its limits, and loose when nobody does."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import unproved
from manyhands.launch.session import Session
from manyhands.nodes.device.orientation import TurnedBody
from manyhands.nodes.device.pointer import PATIENCE, Pointer
from manyhands.nodes.device.wrist import ACCELERATION, SPEED, TurnFollower, Wrist, vector_to
from manyhands.nodes.kernel.bundle import TurnedHand
from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, angle, turned_by
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.messages import Grasp, Release

from ...support.slot import slot

T = 1e-3
HAND = TurnedHand(2e-5, 1e-3, (0.0, 0.0, 0.0))

axes = st.sampled_from([(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8)])


def about(axis: tuple[float, ...], far: float) -> Quaternion:
    return turned_by(UPRIGHT, [far * part for part in axis])


@pytest.mark.long
@given(axes, st.floats(-3.1, 3.1), st.sampled_from([1e-4, 1e-3, 0.01]), st.floats(0.1, 100.0))
def test_a_turn_to_a_goal_does_not_overshoot_and_is_as_fast_as_allowed(
    axis: tuple[float, ...], far: float, period: float, speed: float
) -> None:
    follower, goal = TurnFollower(speed, period), about(axis, far)
    turned, fastest = [0.0], 0.0
    for _ in range(round(4.0 / period) if period > 1e-4 else 4000):
        rate = follower.step(goal)
        assert np.cross(rate, axis) == pytest.approx(0.0, abs=1e-6 * (1.0 + speed))  # along the shortest turn
        fastest = max(fastest, math.hypot(*rate))
        turned.append(angle(follower.at, UPRIGHT))
    assert np.diff(turned).min() > -1e-9
    assert max(turned) < abs(far) + 1e-9
    assert fastest <= speed * (1.0 + 1e-9)
    if period > 1e-4 and speed > abs(far):
        assert angle(follower.at, goal) < 1e-6


@given(st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 0.1), min_size=1, max_size=60))
def test_goals_that_jump_turn_it_within_its_bounds(goals: list[tuple[float, ...]]) -> None:
    follower, before = TurnFollower(5.0, T), np.zeros(3)
    for goal in goals:
        unit = Quaternion(*(part / math.hypot(*goal) for part in goal))
        for _ in range(3):
            at = follower.at
            rate = np.array(follower.step(unit))
            assert np.linalg.norm(rate) <= 5.0 * (1.0 + 1e-9)
            assert np.linalg.norm(rate - before) <= ACCELERATION * T * (1.0 + 1e-9)
            assert angle(follower.at, at) == pytest.approx(np.linalg.norm(rate) * T, abs=1e-9)
            before = rate


def test_the_vector_of_a_turn_is_the_shortest() -> None:
    at = about((0.6, 0.0, 0.8), 1.0)
    for far in (-3.0, -1e-9, 0.0, 0.4, 3.0):
        goal = turned_by(at, (0.0, far, 0.0))
        for either in (goal, Quaternion(*(-part for part in goal))):
            assert vector_to(at, either) == pytest.approx((0.0, far, 0.0), rel=1e-6, abs=1e-15)
    assert vector_to(at, turned_by(at, (4.0, 0.0, 0.0))) == pytest.approx((4.0 - 2.0 * math.pi, 0.0, 0.0))


class Turned:
    """A body in a person's wrist, and the goal that a test sets."""

    def __init__(self, inertia: float = 2e-5, most: float = 0.2, speed: float = 30.0) -> None:
        self.goal: Quaternion | None = None
        self.wrist = Wrist(lambda: self.goal, inertia, most, speed, T)
        self.body = TurnedBody(TurnedHand(inertia, 1e-3, (0.0, 0.0, 0.0)), T, self.wrist)
        self.ticks, self.fastest = 0, 0.0

    def go(self, ticks: int) -> Quaternion:
        for _ in range(ticks):
            before = self.body.R
            self.ticks += 1
            self.body.to(Instant(self.ticks * from_seconds(T)))
            self.fastest = max(self.fastest, angle(before, self.body.R) / T)
        return self.body.R


@pytest.mark.parametrize(("inertia", "most"), [(2e-5, 0.2), (1e-3, 0.2), (1e-7, 5.0)])
def test_the_device_follows_and_stays_where_the_person_wants_it(inertia: float, most: float) -> None:
    """The lightest body in the strongest wrist too, whose torque is held for a period."""
    turned = Turned(inertia, most)
    assert turned.go(10) == UPRIGHT
    turned.goal = about((0.6, 0.0, 0.8), 2.0)
    assert angle(turned.go(1500), turned.goal) < 1e-3
    assert turned.fastest < 1.3 * SPEED


def test_it_turns_no_faster_than_half_of_its_limit() -> None:
    turned = Turned(speed=4.0)
    turned.goal = about((1.0, 0.0, 0.0), 3.0)
    turned.go(3000)
    assert 1.8 < turned.fastest < 2.4  # and the body turns a little beyond its hand


def test_a_wrist_that_is_loose_turns_nothing_and_one_that_closes_begins_where_the_device_is() -> None:
    turned = Turned()
    turned.goal = about((1.0, 0.0, 0.0), 1.0)
    turned.go(1500)
    turned.goal = None
    there = turned.go(500)
    turned.body.apply((0.0, 0.01, 0.0), Instant(turned.ticks * from_seconds(T)))
    assert angle(turned.go(1000), there) > 1.0  # nobody holds it
    turned.body.apply((0.0, 0.0, 0.0), Instant(turned.ticks * from_seconds(T)))
    rested = turned.go(1000)
    turned.goal = rested
    turned.fastest = 0.0
    turned.go(200)
    assert turned.fastest < 1e-6


def test_a_pointer_turns_a_device_that_has_an_orientation_alone() -> None:
    def said(*numbers: float) -> Grasp:
        return Grasp(np.array(numbers))

    for turns, grasps, refused in ((True, 3.0, 4.0), (False, 1.0, 6.0)):
        pointer = Pointer(2, lambda position: [*position], T, turns)
        found = []
        for numbers in (
            (0.1, 0.2, 0.6, 0.0, 0.8, 0.0),
            (0.1, 0.2, 0.6, 0.0, 0.9, 0.0),
            (0.1, 0.2, 0.6, 0.0, 0.8),
            (0.1, 0.6, 0.0, 0.8, 0.0),
            (0.1, 0.2, 0.0, math.nan, 1.0, 0.0),
            (0.1, 0.2, 0.0, 0.0, -1.0, 0.0),
        ):
            pointer.tick(said(*numbers))
            found.append(pointer.turn)
        assert found == ([(0.6, 0.0, 0.8, 0.0)] * 5 + [(0.0, 0.0, -1.0, 0.0)] if turns else [None] * 6)
        pointer.tick(said(0.1, 0.2))
        assert (pointer.goal, pointer.turn) == ([0.1, 0.2], None)
        assert pointer.figures(0)[names.GRASPS] == grasps
        assert pointer.figures(0)[names.GRASPS_REFUSED] == refused


def test_a_pointer_that_lets_go_or_falls_silent_turns_nothing() -> None:
    for silent in (False, True):
        pointer = Pointer(1, lambda position: [*position], T, turns=True)
        pointer.tick(Grasp(np.array([0.0, 1.0, 0.0, 0.0, 0.0])))
        assert pointer.turn == UPRIGHT
        if silent:
            for _ in range(round(PATIENCE / T)):
                pointer.tick(None)
        else:
            pointer.tick(Release())
        assert pointer.turn is None


def test_a_person_turns_a_stick_in_a_slot_and_feels_that_it_does_not_turn_across() -> None:
    """Freely about its own axis; across, the walls hold it, and the device's account keeps to its bound."""
    data = slot(design={"coupling": "given", "stiffness": 900, "damping": 0.2})
    pen = data["devices"]["pen"] | {"driver": "browser", "hand": {"stiffness": 100, "damping": 5}}
    pen["orientation"] = {key: value for key, value in pen["orientation"].items() if key != "torque"}
    simulation = Simulation(unproved(Session.from_dict({**data, "devices": {"pen": pen}})))
    device = simulation.devices["pen"]
    inlet = Fed()
    device.driver._hand._source._inlet = inlet  # type: ignore[attr-defined]
    own = device.orientation
    assert own is not None
    found = []
    simulation.run(2 * TICKS, progress=lambda _ticks: found.append((own.R, own.spring.proxy, own.torque)))
    along, across = (about(axis, 0.6) for axis in (X, Z))
    (R, Q, t), (R2, Q2, t2) = found
    assert np.linalg.norm(t) < 0.003  # N·m
    assert angle(R, along) < 0.02
    assert angle(Q, along) < 0.02
    assert t2[2] < -0.02
    assert angle(R2, Q2) > 0.1
    assert angle(R2, across) > 0.1
    assert own.let_go == 0
    assert own.margin >= -1e-12


TICKS = 1000  # between two calls of a run's progress
X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


class Fed:
    """An inlet by which a page turns a device about x, and then about z; it is asked once a tick."""

    malformed = 0
    asked = 0

    def latest(self) -> Grasp:
        self.asked += 1
        return Grasp(np.array([0.0, 0.0, 0.0, *about(X if self.asked <= TICKS else Z, 0.6)]))

    def close(self) -> None:
        """Nothing is open."""
