"""One tick of a scene: its energy under hostile hands, its forces, its balances, and the network that it contains."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count, islice
from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.contacts import Surface
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.scene import Body, ContactScene, Obstacle, SceneLink, ToolSphere
from manyhands.launch.look.display import scene_line, world_lines
from manyhands.nodes.environment.core import EnvironmentCore
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.scene import SceneLaw
from manyhands.protocol.messages import Figures

from ...support.cases import cases
from ...support.reaction import react
from ...support.scenes import OBSTACLES, Stored, random_compliance, random_scene

T = 1e-3
ROUNDING = 1e-12  # of the work that has passed
HAND = ToolSphere("hand", (0, 1, 2), (0, 1, 2), (0.0, 0.0, 0.05), 0.01)
FLOOR = Obstacle("floor", "wall", ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
PORTS = ("hand.x", "hand.y", "hand.z")
D_V = np.eye(3) / 900.0
Gains: TypeAlias = Iterator[tuple[float, float]]


def core_of(
    scene: ContactScene, D: np.ndarray = D_V, enforce: bool = False, law: SceneLaw | None = None
) -> EnforcedCore:
    m = len(scene.ports)
    return EnforcedCore(
        law or SceneLaw(scene, T), D, np.zeros((m, m)), T, enforce, ramp=20, stored=scene.energy_at_start
    )


def hostile(f: np.ndarray, rng: np.random.Generator, p: np.ndarray) -> np.ndarray:
    """The next free positions: where the scene pushes with f, the hands follow, and take what they can get."""
    greed = rng.choice([0.0, 1e-4, 1e-3])
    return np.clip(p + rng.normal(0.0, 3e-4, len(p)) + greed * np.sign(f), -0.12, 0.12)


@settings(max_examples=cases(12, 500))
@given(
    seed=st.integers(0, 2**32 - 1),
    tools=st.integers(1, 4),
    bodies=st.integers(0, 4),
    axes=st.integers(1, 3),
    clutched=st.booleans(),
    tank=st.sampled_from([None, 0.0, 1e-3, 1.0]),
)
def test_a_scene_gives_out_no_more_than_it_stores(
    seed: int, tools: int, bodies: int, axes: int, clutched: bool, tank: float | None
) -> None:
    """Without a controller, at any stiffness, for any D_V, while the block freezes, ramps and comes back.

    With a tank a driven body moves through the room; what is left in the tank is stored, and never negative.
    """
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, tools, bodies, axes)
    if tank is not None:
        motion = ("0.05*sin(12*t)", {"times": [0.0, 0.03, 0.06], "values": [0.0, 0.06, -0.04]}, "0.02*t")
        paddle = Body("paddle", 0.0, (0.0, 0.0, 0.08), 0.03, motion=motion)
        scene = replace(scene, bodies=(*scene.bodies, paddle), tank=tank)
    m = len(scene.ports)
    law, stored, work = SceneLaw(scene, T), Stored(scene), 0.0
    core, p, f = core_of(scene, random_compliance(rng, m), law=law), np.zeros(m), np.zeros(m)
    assert core.ledger is not None
    for k in range(120):
        if clutched and k in (30, 60, 80):
            (core.clutches.freeze, core.clutches.engage, core.clutches.disengage)[(30, 60, 80).index(k)](0)
        p = hostile(f, rng, p)
        before, x_e = core.ledger.total, np.array(core.tools)
        f = react(core, p)
        core.settle()
        assert np.isfinite(f).all()
        work += abs(core.ledger.total - before) + float(np.abs(f) @ np.abs(np.array(core.tools) - x_e))
        if law.unfinished:
            return  # the controller is for these; a different test counts them
        assert law.tank >= 0.0
        assert core.ledger.total >= stored.at(core) + law.tank - ROUNDING * (work + scene.energy_at_start) - 1e-12
        assert core.ledger.total >= -ROUNDING * work


def off_by(law: SceneLaw) -> float:
    """What the tick's forces may give out of nothing, J: each times the length by which its law may be off.

    The iteration ends where no law is off by more than 1e-12 m, or a force by less than that over its own compliance.
    The forces that are sent are projected once more, which moves the others' gaps: by the first term. The second is the
    rounding of positions and forces.
    """
    if len(law._near) == 0:
        return 0.0
    force, coupled = np.abs(law._found), np.abs(law._G @ law._WG)
    size = np.abs(law._z).max() + coupled @ force + law._compliances * force
    np.fill_diagonal(coupled, 0.0)
    return float(force @ ((coupled / law._compliant).sum(axis=1) * 1e-12 + 8.0 * np.finfo(float).eps * size))


def gains(scene: ContactScene, D: np.ndarray, hands: Callable[[int, np.ndarray, np.ndarray], np.ndarray]) -> Gains:
    """For every finished tick: the energy that is gained, and the least that it may be, J.

    ``hands`` returns the next free positions of the tick's number, the last force and the last free positions.
    """
    m, law = len(scene.ports), SceneLaw(scene, T)
    core, stored, p, f = core_of(scene, D, law=law), Stored(scene, law), *np.zeros((2, m))
    before, energy, unfinished = np.zeros(m), stored.at(core), 0
    for k in count():
        p = hands(k, f, p)
        f = react(core, p)
        bound = off_by(law)
        core.settle()
        now, tools = stored.at(core), np.array(core.tools)
        gained, energy, before = -float(f @ (tools - before)) - (now - energy), now, tools
        if law.unfinished == unfinished:
            yield gained, -bound - 4.0 * np.finfo(float).eps * now
        unfinished = law.unfinished


def stiff(rng: np.random.Generator, always: bool = False) -> ContactScene:
    scene = random_scene(rng, int(rng.integers(1, 5)), int(rng.integers(0, 6)), int(rng.integers(1, 4)))
    if always or rng.random() < 0.5:
        return replace(scene, surface=Surface(1e6, scene.surface.damping, scene.surface.friction))
    return scene


def test_a_finished_tick_gives_out_no_more_than_its_laws_are_off_by() -> None:
    """Every tick by itself."""
    for seed in range(cases(3, 100)):
        rng = np.random.default_rng(seed)
        scene = stiff(rng)
        D = random_compliance(rng, len(scene.ports))
        ticks = gains(scene, D, lambda _, f, p, rng=rng: hostile(f, rng, p))  # type: ignore[misc]
        for gained, least in islice(ticks, 60):
            assert gained >= least, seed


def test_neither_does_one_under_200_kN_at_rest_where_nothing_is_dissipated() -> None:
    """Hands press tools half a metre into things, and tremble by 1e-13 m: the bound has something to hold there."""
    worst = 0.0
    for seed in (3, 8, 11, 12):
        rng = np.random.default_rng(seed)
        scene = stiff(rng, always=True)
        goal = rng.uniform(-0.5, 0.5, len(scene.ports))

        def pressed(k: int, _f: np.ndarray, p: np.ndarray, rng=rng, goal=goal) -> np.ndarray:  # type: ignore[no-untyped-def]
            return np.asarray(goal * min(1.0, k / 40) + 1e-13 * rng.normal(0.0, 1.0, len(p)))

        for gained, least in islice(gains(scene, 1e-6 * np.eye(len(goal)), pressed), 100):
            assert gained >= least, seed
            worst = min(worst, gained)
    assert worst < -1e-10


def test_few_ticks_are_unfinished_and_the_controller_covers_them() -> None:
    steps = unfinished = ticks = 0
    for seed in range(cases(12, 100)):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng, 4, 4)
        law = SceneLaw(scene, T)
        core, p, f = core_of(scene, random_compliance(rng, 12), enforce=True, law=law), np.zeros(12), np.zeros(12)
        assert core.ledger is not None
        for _ in range(100):
            p = hostile(f, rng, p)
            f = react(core, p)
            core.settle()
            assert core.ledger.minimum >= -1e-9
        steps, unfinished, ticks = steps + law.steps, unfinished + law.unfinished, ticks + 100
    assert unfinished <= 0.01 * ticks
    assert steps <= 6 * ticks


@settings(max_examples=cases(5, 200))
@given(seed=st.integers(0, 2**32 - 1), tools=st.integers(1, 3), bodies=st.integers(0, 3))
def test_without_contacts_a_scene_is_the_network(seed: int, tools: int, bodies: int) -> None:
    """Masses, springs and dampers between tools, masses and the ground, along x and y, by 1e-9 of every force."""
    rng = np.random.default_rng(seed)

    def place() -> tuple[float, float, float]:
        x, y, z = rng.uniform(-0.2, 0.2, 3).tolist()
        return x, y, z

    names = [f"t{i}" for i in range(tools)] + [f"m{i}" for i in range(bodies)]
    masses = dict(zip(names[tools:], rng.uniform(0.05, 2.0, bodies).tolist(), strict=True))
    links = [
        ((one, other), *rng.choice([[600.0, 0.5], [0.0, 3.0], [90.0, 0.0]]).tolist())
        for i, one in enumerate(names)
        for other in (*names[:i], GROUND)
        if i >= tools or rng.random() < 0.5
    ] + [(("t0", GROUND), 20.0, 0.1)]
    scene = ContactScene(
        tuple(f"t{i}.{axis}" for i in range(tools) for axis in "xy"),
        tools=tuple(ToolSphere(f"t{i}", (2 * i, 2 * i + 1), (0, 1), place()) for i in range(tools)),
        bodies=tuple(Body(name, mass, place()) for name, mass in masses.items()),
        links=tuple(SceneLink(*link) for link in links),
    )
    network = Network(
        scene.ports,
        tuple((f"{name}.{axis}", mass) for axis in "xy" for name, mass in masses.items()),
        tuple(
            NetworkLink(tuple(end if end == GROUND else f"{end}.{axis}" for end in ends), stiffness, damping)
            for axis in "xy"
            for ends, stiffness, damping in links
        ),
    )
    m = len(scene.ports)
    D = random_compliance(rng, m)
    ours = core_of(scene, D)
    theirs = EnvironmentCore(network.environment(T), D, np.zeros((m, m)), T, ramp=20, masses=2 * bodies)
    p = np.zeros(m)
    for k in range(250):
        for core in (ours, theirs):
            if k in (80, 120):
                (core.clutches.freeze if k == 80 else core.clutches.engage)(0)
        p = p + rng.normal(0.0, 1e-3, m)
        f, expected = react(ours, p), react(theirs, p)
        ours.settle()
        theirs.settle()
        assert f == pytest.approx(expected, rel=1e-9, abs=1e-9)
        q = np.reshape(ours.masses, (-1, 3))
        assert q[:, :2].T.ravel() == pytest.approx(theirs.masses, abs=1e-12)
        assert q[:, 2] == pytest.approx(np.zeros(bodies), abs=1e-12)


def test_two_devices_hold_one_body_by_springs() -> None:
    """What one hand does to the body the other feels; in rest their forces and the body's weight balance."""
    scene = ContactScene(
        ("a.x", "a.y", "b.x", "b.y"),
        tools=(ToolSphere("a", (0, 1), (0, 1), (-0.1, 0.0, 0.0)), ToolSphere("b", (2, 3), (0, 1), (0.1, 0.0, 0.0))),
        bodies=(Body("bar", 0.4, (0.0, 0.0, 0.0), 0.01, "capsule", (0.1, 0.0, 0.0)),),
        obstacles=(Obstacle("floor", "wall", ((0.0, -0.1, 0.0), (0.0, 1.0, 0.0))),),
        links=tuple(SceneLink((name, "bar"), 500.0, 10.0) for name in "ab"),
        surface=Surface(2000.0),
        gravity=(0.0, -9.81, 0.0),
    )
    core = core_of(scene, np.eye(4) / 900.0)
    pushed, f = np.array([0.01, 0.0, 0.0, 0.0]), np.zeros(4)
    for _ in range(3000):
        f = react(core, pushed)
        core.settle()
    assert f[:2] + f[2:] == pytest.approx([0.0, -0.4 * 9.81], abs=1e-6)
    # two couplings and two links in series between the hands
    assert f[2] == pytest.approx(0.01 / (2.0 / 900.0 + 2.0 / 500.0), rel=1e-6)


@settings(max_examples=cases(6, 300))
@given(seed=st.integers(0, 2**32 - 1), bodies=st.integers(2, 5), mu=st.sampled_from([0.0, 0.5]))
def test_free_bodies_keep_their_momentum_and_gain_no_energy(seed: int, bodies: int, mu: float) -> None:
    """Bodies of every shape overlap, are pulled together by springs, and hit and rub each other."""
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, 1, bodies)
    apart = tuple((pair, Surface(0.0)) for pair, surface in scene.surfaces if surface.stiffness == 0.0)
    scene = replace(
        scene,
        tools=(replace(scene.tools[0], at=(5.0, 0.0, 0.0), radius=0.0),),
        obstacles=(),
        links=tuple(SceneLink((f"b{i}", f"b{i + 1}"), 200.0, 0.1, (0.0, 0.0, 0.0)) for i in range(0, bodies - 1, 2)),
        surface=Surface(10.0 ** rng.uniform(3.0, 5.0), 0.5, mu),
        surfaces=tuple((pair, surface) for pair, surface in apart if not set(pair) & {"stone", "block", "rail"}),
        gravity=(0.0, 0.0, 0.0),
    )
    core, stored = core_of(scene), Stored(scene)
    mass = np.array([body.mass for body in scene.bodies])
    before, energy, most = np.zeros((bodies, 3)), scene.energy_at_start, 0.0
    for _ in range(200):
        react(core, np.zeros(3))
        core.settle()
        z = np.reshape(core.masses, (bodies, 3))
        v, before = (z - before) / T, z
        most = max(most, float((mass @ np.abs(v)).max()))
        assert mass @ v == pytest.approx(np.zeros(3), abs=1e-9 * (1.0 + most))
        now = stored.at(core)
        assert now <= (scene.energy_at_start if mu else energy) * (1.0 + 1e-12) + 1e-15  # bristles store some with mu
        energy = now
    assert most > 0.01  # they did move


def test_a_swing_loses_what_backward_euler_must_lose() -> None:
    """Of a mass on a spring each tick leaves 1/(1 + (omega T)^2) of the energy, to rounding; and so for a contact."""
    swing = ContactScene(
        PORTS,
        tools=(HAND,),
        bodies=(Body("bob", 0.2, (1.0, 0.0, 0.0)),),
        links=(SceneLink(("bob", GROUND), 800.0, 0.0, (0.9, 0.05, 0.0)),),
    )
    core, stored = core_of(swing), Stored(swing)
    for k in range(1, 400):
        react(core, np.zeros(3))
        core.settle()
        left = swing.energy_at_start / (1.0 + 800.0 / 0.2 * T * T) ** k
        assert stored.at(core) == pytest.approx(left, rel=1e-9)
    sunk = ContactScene(
        PORTS, tools=(HAND,), bodies=(Body("ball", 0.2, (1.0, 0.0, 0.015), 0.02),), obstacles=(FLOOR,),
        surface=Surface(2000.0),
    )  # fmt: skip
    core, stored, x, v, bounced = core_of(sunk), Stored(sunk), 0.005, 0.0, 0
    for _ in range(40):
        react(core, np.zeros(3))
        core.settle()
        depth = (x - T * v) / (1.0 + T * T * 2000.0 / 0.2)  # implicit; without contact where it is not positive
        v, bounced = (v + T * 2000.0 / 0.2 * depth, bounced) if depth > 0.0 else (v, bounced + 1)
        x -= T * v
        assert stored.at(core) == pytest.approx(0.1 * v * v + 1000.0 * max(x, 0.0) ** 2, rel=1e-9)
    assert bounced > 10


def test_crates_and_rods_stand_on_each_other() -> None:
    """Each lies as deep in the next as its load presses it, and a hand lifts nothing that it does not hold."""
    masses = (0.5, 0.3, 0.2)
    scene = ContactScene(
        PORTS,
        tools=(HAND,),
        bodies=(
            Body("crate", masses[0], (0.3, 0.0, 0.1), 0.0, "box", (0.05, 0.1, 0.1)),
            Body("plank", masses[1], (0.27, 0.02, 0.22), 0.0, "box", (0.2, 0.05, 0.02)),
            Body("rod", masses[2], (0.3, 0.0, 0.25), 0.01, "capsule", (0.0, -0.1, 0.0)),
            Body("slanted", 0.1, (-0.3, 0.0, 0.06), 0.01, "capsule", (0.05, 0.1, -0.05)),
        ),
        obstacles=(FLOOR,),
        surface=Surface(5e3, 20.0, 0.5),
        surfaces=tuple(((name, "slanted"), Surface(0.0)) for name in ("crate", "plank")),
        gravity=(0.0, 0.0, -9.81),
    )
    core = core_of(scene)
    for _ in range(1500):
        react(core, np.zeros(3))
        core.settle()
    sunk = np.cumsum([9.81 * sum(masses[i:]) / 5e3 for i in range(3)])
    found = np.reshape(core.masses, (4, 3))
    assert found[:3, 2] == pytest.approx(-sunk, abs=1e-6)
    assert found[3, 2] == pytest.approx(-9.81 * 0.1 / 5e3, abs=1e-6)
    assert np.abs(found[:, :2]).max() < 1e-6


@pytest.mark.parametrize(
    ("axes", "bar"),
    [((0,), (0.06, 0.0, 0.0)), ((0, 1, 2), (0.06, 0.0, 0.0)), ((0, 1, 2), (0.05, -0.03, 0.02))],
    ids=["one axis", "three axes", "slanted"],
)
def test_a_peg_on_the_axis_of_a_capsule_costs_what_it_gives(axes: tuple[int, ...], bar: tuple[float, ...]) -> None:
    """It is pushed to and fro along the axis, where every direction across is a gradient and no other one is."""
    half = np.array(bar)
    m = len(axes)
    scene = ContactScene(
        tuple(f"peg.{axis}" for axis in axes),
        tools=(ToolSphere("peg", tuple(range(m)), axes, (0.0, 0.0, 0.0), 0.005),),
        obstacles=(Obstacle("bar", "capsule", (tuple((-half).tolist()), tuple(half.tolist())), 0.01),),
        surface=Surface(3000.0, 1.0),
    )
    alone, kept = (core_of(scene, np.eye(m) / 900.0, enforce) for enforce in (False, True))
    stored, work, before = Stored(scene), 0.0, np.zeros(m)
    for k in range(1500):
        p = 0.8 * np.sin(0.01 * k) * half[list(axes)] if k < 1000 else np.zeros(m)
        f = react(alone, p)
        np.testing.assert_array_equal(react(kept, p), f)
        alone.settle()
        kept.settle()
        tools = np.array(alone.tools)
        work += float(np.abs(f) @ np.abs(tools - before))
        before = tools
        assert alone.ledger is not None
        assert alone.ledger.total >= stored.at(alone) - ROUNDING * (work + scene.energy_at_start)
    assert kept.controller is not None
    assert kept.controller.ticks == 0
    along = half[list(axes)] / np.linalg.norm(half)
    assert abs(f @ along) < 1e-9  # and nothing holds it back


def driven(tank: float, motion: str, ticks: int) -> tuple[SceneLaw, np.ndarray, float]:
    """A piston that moves along x against a hand, the places of the piston, and what the hand has received."""
    piston = Body("piston", 0.0, (-0.05, 0.0, 0.05), 0.0, "box", (0.03, 0.02, 0.02), (motion, 0.0, 0.0))
    light = Body("light", 1e-3, (-0.05, 0.0, 0.3), 0.0)  # the spring makes much more of its motion than of a driven one
    scene = ContactScene(
        PORTS,
        tools=(HAND,),
        bodies=(piston, light),
        links=(SceneLink(("light", "piston"), 1e5, 0.0),) if tank else (),
        surface=Surface(2e4, 1.0, 0.3),
        tank=tank,
    )
    law = SceneLaw(scene, T)
    core, places, received = core_of(scene, law=law), [], 0.0
    for _ in range(ticks):
        f, before = react(core, np.zeros(3)), np.array(core.tools)
        core.settle()
        received += float(f @ (np.array(core.tools) - before))
        places.append(core.masses[0])
        assert core.ledger is not None
        assert core.ledger.total >= 0.0
    return law, np.array(places), received


def test_a_driven_body_moves_as_stated_and_pays_for_its_work() -> None:
    law, places, received = driven(1.0, "0.03*sin(5*t)", 300)
    assert places == pytest.approx(0.03 * np.sin(5 * T * np.arange(300)), abs=1e-15)
    assert law.paused == 0
    stored = law._contacts.energy(law._z.reshape(-1, 3))
    assert received > 0.01
    assert 1.0 - law.tank >= received + stored - 1e-12


def test_a_driven_body_pauses_where_its_tank_is_empty_and_goes_on_without_a_load() -> None:
    law, places, received = driven(0.02, "0.04*sin(5*t)", 600)
    free, _, _ = driven(0.0, "-0.04*sin(5*t)", 600)
    assert law.paused > 100
    assert received <= 0.02
    assert 0.0 <= law.tank < 1e-3
    assert 0.01 < places[-1] < 0.04
    assert np.abs(np.diff(places)).max() <= 0.04 * 5 * T
    assert scene_line(law.figures) == f"driven bodies paused in {law.paused} ticks, {law.tank:.3g} J in the tank"
    assert scene_line({**free.figures, "unfinished": 3.0}) == "contacts not solved to the end in 3 ticks"
    assert free.figures == {"unfinished": 0.0, "paused": 0.0, "drive_tank": 0.0}
    assert world_lines(Figures(free.figures)) == []
    assert free.paused == 0
    assert free.tank == 0.0


def test_a_motion_without_a_value_ends_the_session() -> None:
    law, places, _ = driven(1.0, "0.001*sqrt(1-(100*t)**2)-0.001", 20)
    assert law.failure is not None
    assert law.failure.startswith("a driven body failed: ")
    assert np.isfinite(places).all()


def pressed(mu: float, push: np.ndarray, stiffness: float = 5e4, ticks: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """The forces on a tool that is pressed down, and then pushed along the floor."""
    scene = ContactScene(
        PORTS,
        tools=(ToolSphere("hand", (0, 1, 2), (0, 1, 2), (0.0, 0.0, 0.01), 0.01),),
        obstacles=(FLOOR,),
        surface=Surface(stiffness, 1.0, mu),
    )
    core = core_of(scene)
    forces, tools = [], []
    for k in range(ticks):
        p = np.array([0.0, 0.0, -0.005]) + push * max(0.0, min(1.0, (k - 100) / 200.0))
        forces.append(react(core, p))
        core.settle()
        tools.append(core.tools)
    return np.array(forces), np.array(tools)


def test_friction_sticks_below_its_bound_and_slips_at_it() -> None:
    held, still = pressed(0.5, np.array([1.5e-3, 1e-3, 0.0]))
    normal = held[-1, 2]
    assert normal == pytest.approx(0.005 / (1 / 900 + 1 / 5e4), rel=1e-3)
    assert np.hypot(*held[-1, :2]) < 0.5 * normal
    assert np.ptp(still[350:], axis=0) == pytest.approx(np.zeros(3), abs=1e-12)  # no creep
    slid, moved = pressed(0.5, np.array([6e-3, 4e-3, 0.0]))
    assert np.hypot(*slid[-1, :2]) == pytest.approx(0.5 * normal, rel=1e-6)
    assert slid[-1, :2] @ [6e-3, 4e-3] == pytest.approx(-0.5 * normal * np.hypot(6e-3, 4e-3), rel=1e-6)
    assert moved[-1, 0] > 2e-3


def test_the_force_stays_in_the_cone_of_the_tick_before() -> None:
    forces, _ = pressed(0.7, np.array([2e-2, -1e-2, 4e-3]))
    assert (forces[:, 2] >= 0.0).all()
    assert (np.hypot(forces[1:, 0], forces[1:, 1]) <= 0.7 * forces[:-1, 2] + 1e-9).all()


def test_a_stiff_wall_holds_a_hand_still() -> None:
    """A wall of 50 kN/m under a coupling of 900 N/m: the force settles, and never changes its sign."""
    forces, tools = pressed(0.0, np.zeros(3))
    assert (forces[:, 2] >= 0.0).all()
    assert np.ptp(forces[50:, 2]) < 1e-9
    assert tools[-1, 2] == pytest.approx(-forces[-1, 2] / 5e4, rel=1e-9)


def test_nothing_passes_through_a_wall_in_one_tick() -> None:
    """A body far from a wall, thrown by a hand that jumps: pairs that were far away take part in that tick."""
    scene = ContactScene(
        PORTS,
        tools=(HAND,),
        bodies=(Body("ball", 0.01, (0.0, 0.0, 0.2), 0.01),),
        obstacles=(FLOOR,),
        links=(SceneLink(("hand", "ball"), 5e4, 0.0),),
        surface=Surface(1e6),
    )
    core = core_of(scene)
    react(core, np.zeros(3))
    core.settle()
    react(core, np.array([0.0, 0.0, -0.5]))
    core.settle()
    assert 0.05 + core.tools[2] > 0.01 - 1e-3
    assert 0.2 + core.masses[2] > 0.01 - 1e-3


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
def test_forces_beyond_all_measure_reach_nobody() -> None:
    """A position that overflows ends the session with a reason, and the forces are zero from then on."""
    core = core_of(ContactScene(PORTS, tools=(HAND,), obstacles=(FLOOR,), surface=Surface(2000.0, 0.0, 0.5)))
    for _ in range(3):
        react(core, np.array([0.0, 0.0, -0.05]))
        core.settle()
    assert core.failure is None
    for p in (np.array([1e200, 0.0, -1e200]), np.zeros(3)):
        assert react(core, p).tolist() == [0.0, 0.0, 0.0]
        core.settle()
        assert core.failure is not None
        assert core.failure.startswith("the scene failed: ")


def test_a_curved_obstacle_needs_its_tangent_plane() -> None:
    """Round and round a stone, pressed on by 4 mm: the scene pays out nothing, however the hand moves."""
    scene = ContactScene(
        PORTS,
        tools=(HAND,),
        obstacles=(Obstacle("stone", "sphere", ((0.0, 0.0, 0.0),), 0.03),),
        surface=Surface(2000.0),
    )
    core = core_of(scene)
    assert core.ledger is not None
    work = 0.0
    for k in range(2000):
        angle = 0.02 * min(k, 400) + 0.3 * np.sin(0.31 * k) * (k > 400)
        f = react(core, np.array([0.036 * np.sin(angle), 0.0, 0.036 * np.cos(angle) - 0.05]))
        before = core.tools
        core.settle()
        work += float(np.abs(f) @ np.abs(np.subtract(core.tools, before)))
        assert core.ledger.total >= -ROUNDING * work
    assert work > 0.01


def test_friction_acts_across_the_gradient_alone() -> None:
    """A hand sticks to a stone and turns about it: along the gradient acts the spring of the contact alone."""
    stone = Obstacle("stone", "sphere", ((0.0, 0.0, 0.0),), 0.03)
    scene = ContactScene(PORTS, tools=(HAND,), obstacles=(stone,), surface=Surface(2000.0, 0.0, 3.0))
    core, x_e, turned, before = core_of(scene), np.zeros(3), 0.0, np.zeros(3)
    for k in range(600):
        gap, (n,) = scene.contacts.gaps(scene.points + x_e)
        angle = 0.3 * min(1.0, k / 400) + 0.2 * np.sin(0.02 * k)
        f = react(core, np.array([0.035 * np.sin(angle), 0.0, 0.035 * np.cos(angle) - 0.05]))
        core.settle()
        moved, x_e = np.array(core.tools) - x_e, np.array(core.tools)
        pressed = 2000.0 * max(0.0, -float(gap[0] + n @ moved))
        assert f @ n == pytest.approx(pressed, abs=1e-8)
        turned, before = max(turned, float(np.linalg.norm(n - before)) if k else 0.0), n
    assert pressed > 1.0
    assert np.linalg.norm(f - (f @ n) * n) > 0.1
    assert turned > 1e-5


@pytest.mark.parametrize("seed", range(3))
def test_two_runs_are_the_same_to_the_last_bit(seed: int) -> None:
    def run() -> list[list[float]]:
        rng = np.random.default_rng(seed)
        core = core_of(random_scene(rng, 2, 3), random_compliance(rng, 6))
        return [(core.react(list(p)), core.settle(), core.masses)[0] for p in rng.normal(0.0, 1e-3, (50, 6)).cumsum(0)]

    assert run() == run()


def test_the_shapes_of_random_scenes_are_all_there_are() -> None:
    assert {obstacle.shape for obstacle in OBSTACLES} == {"wall", "room", "box", "sphere", "capsule"}
