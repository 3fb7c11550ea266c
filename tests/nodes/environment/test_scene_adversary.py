"""Curved obstacles against an adversary that is searched: the tangent plane keeps the level 0, plain contact does not.

A tick with the *plain* contact is backward Euler as well, x = r + D F(x), with F = k max(0, -d(x)) n(x) of the true gap
d and its gradient n at the tick's end. Its potential k/2 max(0, -d)^2 is not convex where the obstacle is round: the
force at the end of a tick that goes round it has turned away from the motion. So a hand gets energy out of it
(docs/decisions/0041-scenes.md).

The adversary is an evolution strategy over the paths of all tools and over the ratios of their clutches. It maximises
the *deficit*: how far the ledger falls below what the contact stores, as part of the work that has passed.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray

from manyhands.design.models.contacts import Surface
from manyhands.design.models.scene import ContactScene, Obstacle, ToolSphere
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.scene import SceneLaw

from ...support.cases import cases
from ...support.evolution import searched
from ...support.reaction import react

T = 1e-3
TICKS: Final = 100  # of a path
RAMP: Final = 12  # ticks of a clutch's ramp: short, for more ratios in a path
STONE: Final = ((0.0, 0.0, 0.0),)
BAR: Final = ((-0.01, 0.0, 0.0), (0.015, 0.0, 0.0))
OBSTACLES: Final = {
    "sphere": Obstacle("thing", "sphere", STONE, 0.02),
    "capsule": Obstacle("thing", "capsule", BAR, 0.02),
}
LEAST: Final = 1e-5  # J of work from which on it counts
FIELDS: Final = 12  # numbers of a path for each tool
Vector = NDArray[np.float64]


class PlainLaw:
    """The plain contact of each tool with one obstacle, solved at the tick's end; tools do not touch each other."""

    failure: str | None = None
    held: tuple[int, ...] = ()
    masses: list[float] = []  # noqa: RUF012 -- the interface's name

    def __init__(self, scene: ContactScene, k: float) -> None:
        self._scene, self._k = scene, k
        self._home = scene.points.ravel()

    def propose(self, r: Vector, compliance: Vector, x_e: Vector) -> Vector:
        """For D = c I the solution is on the line from r along the gradient, on which the gap grows as the motion."""
        force = np.zeros(len(r))
        for i in range(len(r) // 3):
            own = slice(3 * i, 3 * i + 3)
            c = float(compliance[own, own][0, 0])
            at = (self._home[own] + r[own])[None, :]
            gap, gradient = self._scene.contacts.gaps(np.repeat(at, len(self._home) // 3, axis=0))
            force[own] = self._k * max(0.0, -float(gap[i])) / (1.0 + c * self._k) * gradient[i]
        return force

    def advance(self, x_e: Vector, f: Vector) -> None:
        """Nothing is kept from tick to tick."""


def scene_of(shape: str, tools: int, stiffness: float) -> ContactScene:
    """One obstacle, and tools that touch it from the start, and not each other."""
    names = [f"t{i}" for i in range(tools)]
    places = [(0.0, 0.025, 0.0), (0.0, -0.025, 0.0), (0.0, 0.0, 0.025)][:tools]
    return ContactScene(
        tuple(f"{name}.{axis}" for name in names for axis in "xyz"),
        tools=tuple(
            ToolSphere(name, (3 * i, 3 * i + 1, 3 * i + 2), (0, 1, 2), at, 0.005)
            for i, (name, at) in enumerate(zip(names, places, strict=True))
        ),
        obstacles=(OBSTACLES[shape],),
        surface=Surface(stiffness),
        surfaces=tuple(((a, b), Surface(0.0)) for a in names for b in names if a < b),
    )


def path(genes: Vector, scene: ContactScene) -> tuple[Vector, Vector]:
    """Free tool positions p, m, a row for each tick, and events of the clutches by tick and tool: 0 for none.

    Each tool goes round the obstacle's middle in a plane of its own: a press, an angle that runs and swings, and a
    press that swings with it or against it.
    """
    count = len(scene.tools)
    genes = genes.reshape(count, FIELDS)
    k = np.arange(TICKS)[:, None]
    p, events = np.zeros((TICKS, 3 * count)), np.zeros((TICKS, count), dtype=int)
    for i in range(count):
        press, run, swing, swift, phase, breath, quick, shift, a, b, freeze, back = genes[i]
        start = scene.points[i]
        across = np.cross(start, [np.cos(a), np.sin(a), 0.3 * b])
        across /= max(float(np.linalg.norm(across)), 1e-9)
        along = start / np.linalg.norm(start)
        angle = 0.02 * run * k + 0.5 * swing * (np.sin(swift * k + phase) - np.sin(phase))
        swung = 1.0 + 0.5 * np.sin(quick * k + shift) * np.tanh(breath)
        height = 0.025 - 0.012 * abs(np.tanh(press)) * np.minimum(1.0, k / 10.0) * swung
        p[:, 3 * i : 3 * i + 3] = height * (np.cos(angle) * along + np.sin(angle) * across) - start
        if freeze > 0.5:
            events[int(10 + 60 * abs(np.sin(freeze))), i] = 1 + int(3 * abs(np.sin(7.0 * back))) % 3
            events[int(30 + 60 * abs(np.sin(back))), i] = 3
    return p, events


def deficit(law: SceneLaw | PlainLaw, scene: ContactScene, stored: bool, c: float, genes: Vector) -> float:
    """The greatest deficit along a path, as part of the work; c is the couplings' compliance, m/N.

    It is below 0 while nothing is put out, so that the search has a way to go there, too.
    """
    m = len(scene.ports)
    blocks = [list(tool.ports) for tool in scene.tools]
    core = EnforcedCore(law, c * np.eye(m), np.zeros((m, m)), T, False, blocks, RAMP, stored=scene.energy_at_start)
    assert core.ledger is not None
    positions, events = path(genes, scene)
    worst, work = -np.inf, 0.0
    before = np.zeros(m)
    clutches = core.clutches
    for p, event in zip(positions, events, strict=True):
        for i in np.flatnonzero(event):
            (clutches.freeze, clutches.disengage, clutches.engage)[event[i] - 1](int(i))
        f = react(core, p)
        core.settle()
        at = np.array(core.tools)
        work += float(np.abs(f) @ np.abs(at - before))
        before = at
        kept = scene.contacts.energy(scene.points + at.reshape(-1, 3)) if stored else 0.0
        if work > LEAST:
            worst = max(worst, (kept - core.ledger.total) / work)
    return worst


def greatest_deficit(plain: bool, shape: str, tools: int, seed: int, generations: int) -> float:
    """The greatest deficit that an evolution strategy finds."""
    rng = np.random.default_rng(seed)
    stiffness, c = 10.0 ** rng.uniform(3.0, 5.5), 1.0 / rng.uniform(300.0, 3000.0)
    scene = scene_of(shape, tools, stiffness)

    def found(genes: Vector) -> float:
        law = PlainLaw(scene, stiffness) if plain else SceneLaw(scene, T)
        return deficit(law, scene, not plain, c, genes)

    return searched(found, tools * FIELDS, rng, generations)


@pytest.mark.wide
@pytest.mark.parametrize("shape", OBSTACLES)
@pytest.mark.parametrize("tools", [1, 2, 3])
def test_no_adversary_gets_energy_out_of_a_curved_obstacle(shape: str, tools: int) -> None:
    """140,000 ticks in `make test-long`: the ledger never falls below what the contact stores."""
    for seed in range(cases(1, 6)):
        assert greatest_deficit(False, shape, tools, seed, cases(2, 5)) <= 1e-12


@pytest.mark.parametrize("shape", OBSTACLES)
def test_the_same_adversary_gets_energy_out_of_a_plain_contact(shape: str) -> None:
    """Against 0, not against what is stored: this energy has come from nowhere."""
    assert greatest_deficit(True, shape, 1, 0, 6) > 0.01
