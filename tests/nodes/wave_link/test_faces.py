"""The faces of a wave link: how a life begins, silence, successors, and messages that no honest face sends."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from manyhands.nodes.wave_link import Sums, UserFace, WorldFace
from manyhands.nodes.wave_link.faces import LONGEST_SKIP, RAMP

T = 1e-3
B = np.array([[20.0]])
D_V = np.array([[1e-4]])
WALL = 3000.0


def ends(**options: Any) -> tuple[UserFace, WorldFace]:
    return UserFace(B, D_V, T, T, 3.0, **options), WorldFace(B, T, T, 3.0, **options)


class Pair:
    """Both faces, a wall of 3000 N/m at the world's tool, and a line that can be cut in either direction."""

    def __init__(self, **options: Any) -> None:
        self.user, self.world = ends(**options)
        self.up = self.down = True
        self.x = 0.0
        self.f_c: list[float] = []
        self.x_c: list[float] = []
        self.x_e: list[float] = []

    def tick(self, x: float, wall: float = WALL) -> None:
        self.tick_world(wall)
        self.tick_user(x)

    def tick_world(self, wall: float = WALL) -> None:
        if self.up:
            self.world.hear(*self.user.message())
        p = self.world.tool()[0]
        D = float(self.world.D_V[0, 0])
        f = -wall * p / (1.0 + wall * D)
        self.world.step([f])
        self.x_e.append(p + D * f)

    def tick_user(self, x: float) -> None:
        self.x = x
        if self.down and self.world.aligned:
            self.user.hear(*self.world.message())
        f_c = self.user.step([x])[0]
        self.f_c.append(f_c)
        self.x_c.append(x + float(D_V[0, 0]) * f_c)

    def press(self, to: float, ticks: int) -> Pair:
        """Move to ``to``, m, within 200 ticks."""
        start = self.x
        for k in range(ticks):
            self.tick(start + (to - start) * min(1.0, k / 200.0))
        return self


def steps(forces: list[float]) -> float:
    """The greatest change of the force within 10 ticks, N."""
    f = np.array(forces)
    return float(np.abs(f[10:] - f[:-10]).max())


def test_the_worlds_face_takes_its_place_from_the_first_message() -> None:
    user, world = ends()
    for _ in range(5):
        assert user.step([0.3]) == [0.0]
    assert not world.aligned
    world.tool()
    assert not world.aligned
    world.hear(*user.message())
    assert world.tool() == pytest.approx([0.3])
    assert world.aligned
    world.step([0.0])
    user.hear(*world.message())
    assert user.step([0.3]) == pytest.approx([0.0])
    assert user.aligned


def test_a_free_face_has_no_force_and_no_energy_whatever_the_motion() -> None:
    user, _ = ends(E_0=1e-3)
    for k in range(100):
        assert user.step([math.sin(k)]) == [0.0]
    assert user.tank.level == 1e-3
    assert user.ledger == 0.0


def test_the_force_comes_by_a_ramp() -> None:
    """The world has a stiff wall in place when the user is 3 mm inside it: no step, and 2b/R in the end."""
    pair = Pair(E_0=0.05)
    pair.down = False
    pair.press(3e-3, 300)
    assert set(pair.f_c) == {0.0}
    pair.down = True
    pair.press(3e-3, 4000)
    assert steps(pair.f_c) < 0.5
    R = T + pair.user.latency + pair.world.latency
    assert pair.f_c[-1] == pytest.approx(-2.0 * B[0, 0] / R * (pair.x_c[-1] - pair.x_e[-1]), rel=0.02)


def test_a_silent_line_leaves_a_face_that_holds_the_tool_and_ships_nothing() -> None:
    pair = Pair(E_0=0.05).press(3e-3, 1000)
    assert steps(pair.f_c[300:]) < 0.2
    pair.up = pair.down = False
    held, at = pair.f_c[-1], pair.x_c[-1]
    for _ in range(50):
        pair.tick(3e-3)
    assert pair.user.holding
    assert pair.world.holding
    shipped = pair.user.tank.shipped, pair.world.tank.shipped
    for _ in range(2000):
        pair.tick(3e-3)
    assert (pair.user.tank.shipped, pair.world.tank.shipped) == shipped
    assert pair.f_c[-1] == pytest.approx(held, rel=0.02)
    assert pair.x_c[-1] == pytest.approx(at, abs=2e-5)
    assert pair.user.tank.clipped == pair.world.tank.clipped == 0
    assert pair.user.silent > 2000


@pytest.mark.parametrize("cut", [("up",), ("down",), ("up", "down")])
def test_no_step_comes_with_the_end_of_a_silence_and_nothing_is_forgotten(cut: tuple[str, ...]) -> None:
    """The user moves by 2 mm meanwhile, against up to 16 N. In the end the force is the one of the place again."""
    pair = Pair(E_0=0.05).press(3e-3, 1500)
    for way in cut:
        setattr(pair, way, False)
    pair.press(5e-3, 1000)
    since = len(pair.f_c)
    for way in cut:
        setattr(pair, way, True)
    pair.press(5e-3, 5000)
    assert steps(pair.f_c[since:]) < 3.0
    same = Pair(E_0=0.05).press(5e-3, 4000)
    assert pair.f_c[-1] == pytest.approx(same.f_c[-1], rel=0.01)


@pytest.mark.parametrize("late", ["user", "world"])
@pytest.mark.parametrize(("stop", "step"), [(0, 2e-3), (40, 0.1), (400, 0.3)])
def test_a_process_that_misses_ticks_makes_no_step_of_the_force(late: str, stop: int, step: float) -> None:
    """Three ticks in 50 are missed, and once ``stop`` more; those are a silence at the other face."""
    pair = Pair(E_0=0.02).press(2e-3, 4000)
    constant, first, missed = pair.f_c[-1], len(pair.f_c), 0
    for k in range(5000):
        runs = k % 50 >= 3 and not 2000 <= k < 2000 + stop
        for face, tick in ((pair.world, pair.tick_world), (pair.user, lambda: pair.tick_user(pair.x))):
            if face is not getattr(pair, late):
                tick()
            elif runs:
                if face is pair.user and missed * T > LONGEST_SKIP:
                    pair.f_c += [0.0] * 10  # the device let go meanwhile
                    first = len(pair.f_c)
                face.skip(missed)
                missed = 0
                tick()
            else:
                missed += 1
    assert pair.user.n == pair.world.n == 9000
    assert steps(pair.f_c[first - 10 :]) < step
    # in the end the gap is that of the force over the round trip, which both ends know together
    R = pair.user.lag + pair.world.lag
    assert pair.x_c[-1] - pair.x_e[-1] == pytest.approx(-pair.f_c[-1] * R / (2.0 * B[0, 0]), rel=0.01)
    assert pair.f_c[-1] == pytest.approx(constant, rel=0.02)


def test_messages_of_another_life_are_not_heard_and_a_survivor_keeps_its_energy() -> None:
    pair = Pair(E_0=0.05).press(3e-3, 1000)
    late = pair.user.message()
    level = pair.world.tank.level
    pair.world.renew(1)
    assert pair.world.tank.level == level
    assert not pair.world.hear(*late)
    assert not pair.world.aligned
    pair.user = UserFace(B, D_V, T, T, 3.0, life=1)
    assert pair.user.tank.level == 0.0
    pair.press(3e-3, 1000)
    assert pair.world.aligned
    assert pair.f_c[-1] < -1.0


def test_a_survivor_at_the_user_lets_go_by_a_ramp() -> None:
    pair = Pair(E_0=0.05).press(3e-3, 1000)
    since = len(pair.f_c)
    pair.user.renew(1)
    pair.press(3e-3, 300)
    assert steps(pair.f_c[since - 10 :]) <= abs(pair.f_c[since - 1]) * 0.11
    assert pair.f_c[-1] == 0.0
    assert not any(pair.f_c[since + round(RAMP / T) + 2 :])


def test_a_change_of_depth_is_no_step_and_is_felt_as_its_latency() -> None:
    pair = Pair(E_0=0.05).press(3e-3, 1500)
    since = len(pair.f_c)
    pair.user.set_depth(6.0)
    pair.world.set_depth(1.0)
    pair.press(3e-3, 3000)
    assert steps(pair.f_c[since - 10 :]) < 0.3
    R = T + pair.user.latency + pair.world.latency
    assert pair.f_c[-1] == pytest.approx(-2.0 * B[0, 0] / R * (pair.x_c[-1] - pair.x_e[-1]), rel=0.01)


@pytest.mark.parametrize(
    "message",
    [
        Sums(10, (math.nan,), 1.0),
        Sums(10, (math.inf,), 1.0),
        Sums(10, (1e13,), 1.0),
        Sums(10, (0.0, 0.0), 1.0),
        Sums(10, (), 1.0),
        Sums(10, (0.0,), 0.4),
        Sums(10, (0.0,), math.nan),
        Sums(10, (0.0,), math.inf),
    ],
)
def test_a_message_that_no_honest_face_sends_changes_nothing_and_is_counted(message: Sums) -> None:
    for face in ends():
        assert face.hear(5, [0.0], 0.5)
        assert not face.hear(*message)
        assert face.refused == 1
        assert face.tank.level == 0.5
        assert face.hear(6, [0.0], 0.5)


@pytest.mark.parametrize("message", [Sums(5, (1.0,), 9.0), Sums(4, (1.0,), 9.0), Sums(9, (1.0,), 9.0, life=1)])
def test_old_messages_duplicates_and_other_lives_are_no_events(message: Sums) -> None:
    for face in ends():
        face.hear(5, [0.0], 0.5)
        assert not face.hear(*message)
        assert face.refused == 0
        assert face.tank.level == 0.5


def test_theta_is_harvested_where_it_is_asked_for_alone() -> None:
    theta = np.array([[0.5]])
    world = WorldFace(B, T, T, 1.0, theta=theta)
    world.tool()
    world.step([2.0])
    moved = 2.0 * T / B[0, 0]
    assert world.ledger == pytest.approx(2.0 * moved + 0.5 * moved**2 / T)
    other = WorldFace(B, T, T, 1.0, theta=theta)
    other.tool()
    other.step([2.0], harvests=False)
    assert other.ledger == pytest.approx(2.0 * moved)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"b": np.array([[0.0]])}, "positive definite"),
        ({"b": np.array([[1.0, 0.5], [0.0, 1.0]])}, "symmetric"),
        ({"T": 0.0}, "expected a positive one"),
        ({"peer_T": math.inf}, "expected a positive one"),
        ({"depth": -1.0}, "expected 0 or more"),
        ({"E_0": -1.0}, "expected 0 or more"),
        ({"theta": np.array([[-1.0]])}, "positive semidefinite"),
        ({"theta": np.eye(2)}, "positive semidefinite"),
    ],
)
def test_a_face_of_impossible_data_is_refused(options: dict[str, Any], expected: str) -> None:
    given = {"b": B, "T": T, "peer_T": T, "depth": 3.0} | options
    with pytest.raises(ValueError, match=expected):
        WorldFace(**given)


def test_a_feedthrough_of_a_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected \(1, 1\)"):
        UserFace(B, np.eye(2), T, T, 3.0)


@pytest.mark.parametrize("stale", [0, 1])
def test_a_hand_that_moves_while_the_process_is_stopped_gets_no_blow(stale: int) -> None:
    """The way of five seconds was taken for the motion of one tick, also where an old sample came first."""
    pair = Pair(E_0=0.02).press(2e-3, 2000)
    for _ in range(5000):
        pair.tick_world()
    first = len(pair.f_c)
    pair.user.skip(5000)
    for k in range(3000):
        pair.tick(2e-3 if k < stale else -1e-3 if k < 2000 else 2e-3)
    felt = np.abs(np.array(pair.f_c[first : first + 2000]))
    assert felt[0] == 0.0
    assert steps(pair.f_c[first : first + 2000]) < 0.3
    assert pair.f_c[-1] < -1.0, "the wall is felt again"
