"""What buttons hold in a scene: the spring begins without force, and whatever is pressed no energy comes out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.contacts import Surface
from manyhands.design.models.scene import Body, ContactScene, SceneHold, ToolSphere, scene_of
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.scene import SceneLaw

from ...support.cases import cases
from ...support.reaction import react
from ...support.scenes import Stored, random_compliance, random_scene

T = 1e-3
ROUNDING = 1e-12
BUTTONS = ("t0.a", "t0.b", "t1.a")


def pair(within: float = 0.0, gap: float = 0.0, stiffness: float = 500.0) -> ContactScene:
    """A tool beside a ball, in weightlessness."""
    return ContactScene(
        ("t0.x", "t0.y", "t0.z"),
        tools=(ToolSphere("t0", (0, 1, 2), (0, 1, 2), (0.0, 0.0, 0.0), 0.01),),
        bodies=(Body("far", 0.1, (0.2, 0.0, 0.0), 0.02), Body("ball", 0.1, (0.03 + gap, 0.0, 0.0), 0.02)),
        surface=Surface(2000.0),
        holds=(SceneHold("t0", "t0.a", stiffness, 1.0, within),),
    )


def core_of(scene: ContactScene, D: np.ndarray, controlled: bool = True) -> tuple[EnforcedCore, SceneLaw]:
    """The scene, with a controller or without."""
    m, law = len(scene.ports), SceneLaw(scene, T, BUTTONS)
    blocks = [np.arange(3 * i, 3 * i + 3) for i in range(m // 3)]
    zero = np.zeros((m, m))
    return EnforcedCore(law, D, zero, T, controlled, blocks, ramp=20, stored=scene.energy_at_start), law


def holding_energy(law: SceneLaw) -> float:
    """What the springs of what is held store, J."""
    z, total = law._z.reshape(-1, 3), 0.0
    for (hold, tool), body, offset in zip(law._holds, law.held_bodies, law._offsets, strict=True):
        if body is not None:
            strained = z[tool] - z[body] - offset
            total += 0.5 * hold.stiffness * float(strained @ strained)
    return total


def test_a_press_exerts_no_force_and_a_motion_then_takes_the_body_along() -> None:
    core, law = core_of(pair(within=0.01, gap=0.005), np.eye(3) / 1000.0)
    for k in range(50):
        core.press(int(k >= 10))
        f = react(core, np.zeros(3))
        core.settle()
        assert not f.any(), k  # at rest with the offset that they have
    assert law.held_bodies == [2]
    assert law.figures["holding"] == 1.0
    for k in range(600):
        react(core, np.array([0.0, 1e-4 * min(k, 300), 0.0]))
        core.settle()
    assert abs(core.masses[4] - 0.03) < 2e-3, "the ball follows by 3 cm"
    assert core.masses[:3] == [0.0, 0.0, 0.0]
    core.press(0)
    assert law.held_bodies == [None]
    before = core.masses[4]
    for _ in range(300):
        assert not react(core, np.array([0.0, 0.03, 0.0]))[1]
        core.settle()
    assert abs(core.masses[4] - before) < 0.02


def test_only_what_is_near_enough_when_the_button_is_pressed_is_held() -> None:
    core, law = core_of(pair(within=0.004, gap=0.005), np.eye(3) / 1000.0)
    core.press(1)
    assert law.held_bodies == [None]
    for _ in range(20):
        react(core, np.array([0.002, 0.0, 0.0]))
        core.settle()
    core.press(1)
    assert law.held_bodies == [None], "the button was pressed too early"
    core.press(0)
    core.press(1)
    assert law.held_bodies == [2]


def test_letting_go_loses_what_the_spring_stores() -> None:
    core, law = core_of(pair(gap=-1e-9), np.eye(3) / 1000.0)
    core.press(1)
    for k in range(100):
        react(core, np.array([0.0, 0.0, 1e-3 * k]))
        core.settle()
    stored = holding_energy(law)
    assert stored > 1e-4
    core.press(0)
    assert holding_energy(law) == 0.0
    out = 0.0
    for _ in range(2000):
        before = np.array(core.tools)
        f = react(core, np.array([0.0, 0.0, 0.1]))
        core.settle()
        out += float(f @ (np.array(core.tools) - before))
    assert out < 1e-9, "no hand gets any of it"


def test_the_terms_of_a_scene_with_holds_are_read_back() -> None:
    scene = pair(within=0.01)
    assert scene_of(scene.terms(), scene.ports) == scene
    assert "holds" not in ContactScene(scene.ports, scene.tools).terms()


@settings(max_examples=cases(30, 300))
@given(seed=st.integers(0, 2**32 - 1), tools=st.integers(1, 3), bodies=st.integers(1, 4), clutched=st.booleans())
def test_no_hostile_pressing_gets_energy_out(seed: int, tools: int, bodies: int, clutched: bool) -> None:
    """400 ticks each, without a controller: the ledger stays at or above all that is stored, springs of holds included.

    Hands shake, follow what pushes them, and press where it suits them.
    """
    rng = np.random.default_rng(seed)
    plain = random_scene(rng, tools, bodies)
    buttons = [f"t{i}.{name}" for i in range(tools) for name in "ab"]
    holds = tuple(
        SceneHold(
            button.partition(".")[0], button, 10.0 ** rng.uniform(1.0, 5.0), rng.uniform(0.0, 5.0),
            rng.choice([0.0, 0.01, 0.1]),
        )
        for button in buttons
    )  # fmt: skip
    scene = replace(plain, holds=holds)
    m, law = len(scene.ports), SceneLaw(scene, T, buttons)
    core = EnforcedCore(
        law, random_compliance(rng, m), np.zeros((m, m)), T, False, ramp=20, stored=scene.energy_at_start
    )
    stored, work, pressed, p, f = Stored(scene), 0.0, 0, np.zeros(m), np.zeros(m)
    assert core.ledger is not None
    for k in range(400):
        if rng.random() < 0.1:
            pressed ^= int(rng.integers(1, 1 << len(buttons)))
        if clutched and k in (100, 200, 240):
            (core.clutches.freeze, core.clutches.engage, core.clutches.disengage)[(100, 200, 240).index(k)](0)
        greed = rng.choice([0.0, 1e-4, 1e-3])
        p = np.clip(p + rng.normal(0.0, 3e-4, m) + greed * np.sign(f), -0.12, 0.12)
        core.press(pressed)
        before, x_e = core.ledger.total, np.array(core.tools)
        f = react(core, p)
        core.settle()
        assert np.isfinite(f).all()
        work += abs(core.ledger.total - before) + float(np.abs(f) @ np.abs(np.array(core.tools) - x_e))
        if law.unfinished:
            return  # the controller is for these
        least = stored.at(core) + holding_energy(law)
        assert core.ledger.total >= least - ROUNDING * (work + scene.energy_at_start) - 1e-12
        assert core.ledger.total >= -ROUNDING * work


@pytest.mark.parametrize("wrong", [{"stiffness": -1.0}, {"within": float("nan")}, {"tool": "t9"}])
def test_a_hold_that_makes_no_sense_is_refused(wrong: dict[str, object]) -> None:
    stated = {"tool": "t0", "button": "t0.a", "stiffness": 1.0, **wrong}
    with pytest.raises(ValueError, match="environment"):
        ContactScene(pair().ports, pair().tools, holds=(SceneHold(**stated),))  # type: ignore[arg-type]
