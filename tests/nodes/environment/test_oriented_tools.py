"""Tools that hands turn: avatars of MuJoCo, and the world's part of the law with an engine that means no good."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from manyhands.design.levels.contract import DeviceShare
from manyhands.nodes.device.orientation import NO_TORQUE, DeviceOrientation, SensedOrientation, TurnedBody
from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.environment.mujoco import MujocoEngine
from manyhands.nodes.environment.oriented_tools import OrientedTools
from manyhands.nodes.kernel.bundle import DeviceRung, OrientationPart, OrientedTool, SensedPart, TurnedHand
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.nodes.kernel.orientation import (
    NO_RIDER,
    RIDER,
    UPRIGHT,
    Quaternion,
    angle,
    difference,
    product,
    torque,
    turned_by,
)
from manyhands.protocol.clock import Instant

T = 1e-3
K = 0.4
PART = OrientationPart(K * T / 2.0, K, 0.2, 60.0, TurnedHand(1e-5, 1e-3, (0.01, 0.0, 0.0)))
SLIDES = "".join(
    f'<joint name="{axis}" type="slide" axis="{along}" damping="1"/>'
    for axis, along in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True)
)
BALL = '<joint name="turn" type="ball" damping="0.0005"/>'
STICK = '<geom type="box" size="0.03 0.005 0.005" mass="0.2"/>'


def text(joints: str = SLIDES + BALL, shape: str = STICK, more: str = "", at: str = "", above: str = "") -> str:
    return (
        f'<mujoco><option timestep="0.0005" integrator="implicitfast" gravity="0 0 0"/><worldbody>{more}'
        f"<body>{above}<body {at}>{joints}{shape}</body></body></worldbody></mujoco>"
    )


def engine(model: str, avatars: tuple[str, ...] = ("turn",), k: float = K) -> MujocoEngine:
    pytest.importorskip("mujoco")
    tools = {"model": model, "tools": ["x", "y", "z"], "bodies": [], "stiffness": [200.0] * 3}
    return MujocoEngine(("p.x", "p.y", "p.z"), T, tools | {"avatars": [*avatars], "avatar_stiffness": [k]})


def world(of: Any, hands: tuple[str, ...] = ("p",)) -> tuple[OrientedTools, AskedModel]:
    asked = AskedModel("engine", of, ("p.x", "p.y", "p.z"))
    tools = [OrientedTool(hand, K, PART.torque, PART.power(T)) for hand in hands]
    return OrientedTools(tools, asked), asked


def hand(torque: tuple[Any, Any, Any] = (0.01, 0.0, 0.0)) -> DeviceOrientation:
    part = OrientationPart(PART.osp, K, PART.torque, PART.speed, TurnedHand(1e-5, 1e-3, torque))
    return DeviceOrientation(part, T, DeviceRung(0.0, 0.0, DeviceShare()))


def run(of: Any, by: DeviceOrientation, ticks: int) -> OrientedTools:
    tools, asked = world(of)
    zero = np.zeros(3)
    for k in range(ticks):
        by.sample(k, Instant(0))
        tools.hear(by.rides, k)
        asked.proxies(zero, zero, k)
        by.exert(tools.answer(), Instant(0))
        assert asked.failure is None
        assert tools.bank.balance >= 0.0
        assert by.spring.account >= by.spring.deposited - by.spring.granted - 1e-15
    return tools


@pytest.mark.parametrize("at", ["", 'euler="40 -30 70"'])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_avatar_is_turned_about_the_worlds_axes_from_where_it_began(at: str, axis: int) -> None:
    of = engine(text(shape='<geom size="0.02" mass="0.05"/>', at=at), k=0.001)
    torque = np.zeros(3)
    torque[axis] = 1e-4
    for _ in range(400):
        of.turn(torque)
        of.step(np.zeros(3), np.zeros(3))
    turned = Quaternion(*of.avatars())
    assert angle(turned, UPRIGHT) > 0.05
    assert turned[1 + axis] == pytest.approx(math.sin(0.5 * angle(turned, UPRIGHT)), abs=1e-6)


def test_a_tool_in_free_space_follows_its_hand() -> None:
    by = hand((0.002, 0.0, "0.004*sin(6*t)"))
    tools = run(engine(text()), by, 600)
    assert angle(by.R, UPRIGHT) > 0.3
    assert angle(by.R, Quaternion(*tools.told[:4])) < 0.1


def test_a_tool_in_a_slot_holds_its_hand() -> None:
    """Two rails beside a round stick: its hand cannot turn it about z, and can about the stick's own axis."""
    rails = "".join(f'<geom type="box" pos="0 {y} 0" size="0.05 0.002 0.05"/>' for y in (-0.0075, 0.0075))
    model = text(more=rails, shape='<geom type="capsule" fromto="-0.03 0 0 0.03 0 0" size="0.005" mass="0.2"/>')
    by = hand((0.0, 0.0, 0.05))
    run(engine(model), by, 600)
    assert by.torque[2] == pytest.approx(-0.05, rel=0.05)
    assert angle(by.R, UPRIGHT) < 0.25
    by = hand((0.005, 0.0, 0.0))
    run(engine(model), by, 400)
    assert angle(by.R, UPRIGHT) > 0.3


class Liar:
    """An engine whose avatars are wherever it pleases."""

    def __init__(self, rng: np.random.Generator, tools: int) -> None:
        self.rng, self.tools = rng, tools

    def turn(self, torques: Any) -> None:
        assert np.all(np.abs(torques) <= K * (1.0 + 1e-9))

    def step(self, x: Any, f: Any) -> Any:
        return x

    def avatars(self) -> list[float]:
        found: list[float] = []
        for _ in range(self.tools):
            found += turned_by(UPRIGHT, self.rng.standard_normal(3).tolist())
        return found


@pytest.mark.parametrize("seed", range(6))
def test_whatever_an_engine_proposes_and_whoever_starts_anew_nothing_is_granted_twice(seed: int) -> None:
    """Two hands with losses, where hands and worlds start anew: over all lives together nothing is gained."""
    rng = np.random.default_rng(seed)
    names = ("a", "b")
    tools, _ = world(Liar(rng, 2), names)
    times = (np.arange(400) * T).tolist()

    def anew(life: float, k: int) -> DeviceOrientation:
        values = [{"times": times, "values": (0.1 * rng.standard_normal(400)).tolist()} for _ in range(3)]
        found = hand((values[0], values[1], values[2]))
        found.life = life
        return found

    hands, lives, gone, lost = [anew(1.0, 0), anew(1.0, 0)], 1.0, 0.0, 0
    begun = [0, 0]
    for k in range(350):
        up: list[float] = []
        for i, by in enumerate(hands):
            by.sample(k - begun[i], Instant(0))
            up += by.rides if rng.random() < 0.8 else NO_RIDER
        tools.hear(up, k)
        down = tools.answer()
        for i, by in enumerate(hands):
            came = down[RIDER * i : RIDER * (i + 1)] if rng.random() < 0.8 else NO_RIDER
            by.exert(came, Instant(0))
        if rng.random() < 0.03:
            i = int(rng.integers(2))
            lives, lost = lives + 1.0, lost + 1
            gone += hands[i].spring.account
            hands[i], begun[i] = anew(lives, k), k + 1
        if rng.random() < 0.02:
            tools, _ = world(Liar(rng, 2), names)
        assert gone + sum(by.spring.account for by in hands) >= -1e-12
    assert lost > 2
    assert sum(by.spring.held for by in hands) > 0


def with_a_grip(of: Any, feel: int) -> tuple[OrientedTools, list[DeviceOrientation], SensedOrientation]:
    """The tools of a sensed hand and of so many that feel a torque, in an engine ``of`` them."""
    asked = AskedModel("engine", of, ("p.x", "p.y", "p.z"))
    felt = [OrientedTool(f"p{i}", K, PART.torque, PART.power(T)) for i in range(feel)]
    tools = OrientedTools([OrientedTool("grip", K, None, None), *felt], asked)
    return (
        tools,
        [hand() for _ in range(feel)],
        SensedOrientation(TurnedBody(TurnedHand(1e-5, 1e-3, (0.01, 0.0, 0.0)), T), T),
    )


class Deposits(list[float]):
    """What a sensed hand says of itself, with deposits that nobody made."""

    def __init__(self, of: SensedOrientation, rng: np.random.Generator, k: int) -> None:
        super().__init__(of.rides)
        self[4] = float(rng.choice([0.0, 1e-3 * k, 1e9]))


@pytest.mark.parametrize("honest", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_a_hand_that_feels_nothing_gives_no_other_hand_energy(seed: int, honest: bool) -> None:
    """Whatever it does and says, an engine that means no good has no more for other hands than these have given."""
    rng = np.random.default_rng(seed)
    tools, felt, grip = with_a_grip(Liar(rng, 3), 2)
    for k in range(250):
        grip.sample(k, Instant(0))
        grip.R = turned_by(grip.R, (rng.standard_normal(3) * (0.5 if rng.random() < 0.2 else 0.01)).tolist())
        up = grip.rides if honest else [*Deposits(grip, rng, k)]
        for by in felt:
            by.sample(k, Instant(0))
            up = up + (by.rides if rng.random() < 0.8 else [*NO_RIDER])
        tools.hear(up, k)
        down = tools.answer()
        assert grip.exert(down[:RIDER], Instant(0)) == NO_TORQUE
        for i, by in enumerate(felt, start=1):
            by.exert(down[RIDER * i : RIDER * (i + 1)], Instant(0))
            assert by.spring.account >= by.spring.deposited - by.spring.granted - 1e-15
        assert tools.bank.balance >= 0.0
        assert sum(by.spring.account for by in felt) >= -1e-12
        assert down[RIDER - 2] == 0.0
    assert sum(by.spring.held for by in felt) > 0
    assert tools.heard[:4] == list(grip.R)


def test_a_hand_that_feels_nothing_leads_its_tool() -> None:
    tools, _, grip = with_a_grip(engine(text()), 0)
    zero = np.zeros(3)
    for k in range(400):
        grip.sample(k, Instant(0))
        tools.hear(grip.rides, k)
        tools._asked.proxies(zero, zero, k)
        tools.answer()
    assert angle(grip.R, UPRIGHT) > 0.3
    assert angle(grip.R, Quaternion(*tools.told[:4])) < 0.1
    assert grip.row() == (grip.R,)
    assert tools.heard[4] == 0.0  # a spring of its own would have deposited what nobody gave


def test_a_tool_has_a_torque_with_a_power_or_neither() -> None:
    for most, power in ((None, 1.0), (0.1, None), (0.1, 0.0), (math.nan, 1.0)):
        with pytest.raises(ValueError, match="expected"):
            OrientedTool("p", K, most, power)
    for k in (0.0, math.inf):
        with pytest.raises(ValueError, match="stiffness"):
            SensedPart(k, PART.source)


class Swing:
    """An engine whose first avatar yields to its hand, and whose second turns to and fro by itself."""

    def __init__(self) -> None:
        self.k = 0

    def turn(self, torques: Any) -> None:
        self.k += 1

    def step(self, x: Any, f: Any) -> Any:
        return x

    def avatars(self) -> list[float]:
        places = (0.001 * self.k, 0.2 * math.sin(0.02 * self.k))
        return [number for x in places for number in turned_by(UPRIGHT, (x, 0.0, 0.0))]


def test_a_hand_that_missed_answers_is_led_on_where_another_has_given_enough() -> None:
    """Its copy is wrong for a while; held for good, it would feel a tool that is not there."""
    rng = np.random.default_rng(3)
    tools, asked = world(Swing(), ("a", "b"))
    hands = [hand((0.05, 0.0, 0.0)), hand((0.0, 0.0, 0.0))]
    behind = []
    for k in range(1200):
        up: list[float] = []
        for by in hands:
            by.sample(k, Instant(0))
            up += by.rides if rng.random() < 0.9 else NO_RIDER
        tools.hear(up, k)
        assert asked.failure is None
        down = tools.answer()
        for i, by in enumerate(hands):
            came = down[RIDER * i : RIDER * (i + 1)] if rng.random() < 0.9 else NO_RIDER
            by.exert(came, Instant(0))
            if i == 1 and any(came) and k > 300:
                behind.append(angle(by.spring.proxy, Quaternion(*came[:4])))
    assert tools.bank.balance >= 0.0
    assert np.quantile(behind, 0.99) < 1e-3


def test_nothing_is_proposed_to_a_hand_that_is_not_there_or_says_no_life() -> None:
    tools, _ = world(Liar(np.random.default_rng(0), 1))
    for riders in (NO_RIDER, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0, 0.0, 1.0), (1.0, 0, 0, 0, 0, 1.5)):
        tools.hear(riders, 0)
        assert not any(tools.answer())
        assert not any(tools.heard)
    tools.hear((1.0, 0.0, 0.0, 0.0, 0.0, 5.0), 0)
    assert tools.answer()[RIDER - 1] == 5.0
    assert tools.heard == [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    tools.hear((1.0, 0.0, 0.0, 0.0, 0.0, 4.0), 1)
    assert tools.heard[-1] == 2.0


@pytest.mark.parametrize("found", [[math.nan] * 4, [1.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], "four", None])
def test_an_engine_whose_avatars_have_no_orientation_ends_the_session(found: Any) -> None:
    of = Liar(np.random.default_rng(0), 1)
    of.avatars = lambda: found  # type: ignore[method-assign]
    tools, asked = world(of)
    tools.hear((*UPRIGHT, 0.0, 1.0), 0)
    tools.answer()
    assert asked.failure is not None
    assert "engine" in asked.failure


@pytest.mark.parametrize(
    ("model", "why"),
    [
        (text(SLIDES + '<joint name="turn" type="hinge"/>'), "expected a ball joint"),
        (text(BALL + SLIDES), "expected slide joints alone"),
        (text(above='<joint type="hinge"/>' + STICK), "expected slide joints alone"),
        (text(shape='<geom size="0.001" mass="0.05"/>'), "expected at least 1.6e-06 kg"),
        (text(SLIDES), "found no joint 'turn'"),
    ],
)
def test_an_avatar_that_cannot_be_turned_is_refused(model: str, why: str) -> None:
    with pytest.raises(FactoryError, match=why):
        engine(model)


def swing(of: MujocoEngine, k: float, ticks: int = 6000) -> float:
    """By how much the avatar's swing grows beside a hand that holds still, from its first 50 ticks to its last ones."""
    of._data.qvel[3:] = (0.1, 0.2, 0.05)
    angles = []
    for _ in range(ticks):
        A = Quaternion(*of.avatars())
        of.turn(-np.array(torque(k, UPRIGHT, A)))
        of.step(np.zeros(3), np.zeros(3))
        angles.append(angle(A, UPRIGHT))
    return max(angles[-ticks // 10 :]) / max(angles[:50])


@pytest.mark.parametrize("k", [K, 0.50077])
@pytest.mark.parametrize("integrator", ["implicitfast", "RK4"])
def test_a_ball_joint_at_which_a_tool_swings_up_is_named_with_a_damping_at_which_it_does_not(
    k: float, integrator: str
) -> None:
    def with_damping(damping: str) -> MujocoEngine:
        model = text(SLIDES + BALL.replace("0.0005", damping)).replace("implicitfast", integrator)
        return engine(model, k=k)

    of = with_damping("0.00005")
    (said,) = of.advice
    form = r"found a damping of 5e-05 N·m·s/rad at the ball joint 'turn', .*; expected (\S+) N·m·s/rad \(k T\) or more"
    found = re.fullmatch(form, said)
    assert found is not None
    assert swing(of, k, 600) > 5.0
    helped = with_damping(found[1])
    assert helped.advice == []
    assert swing(helped, k) < 0.9


def test_nothing_is_advised_where_a_step_as_long_as_the_period_swings_no_tool_up() -> None:
    of = engine(text(SLIDES + BALL.replace("0.0005", "0")).replace('timestep="0.0005"', 'timestep="0.001"'))
    assert of.advice == []
    assert swing(of, K) < 1.01


def test_a_turn_after_another_is_their_product() -> None:
    a, b = turned_by(UPRIGHT, (0.3, 0.1, 0.0)), turned_by(UPRIGHT, (0.0, -0.2, 0.4))
    assert product(a, UPRIGHT) == pytest.approx(a)
    assert turned_by(b, (0.3, 0.1, 0.0)) == pytest.approx(product(a, b))
    assert difference(product(a, b), b) == pytest.approx(a)
