"""Tools on the axes, edges, corners and faces of every pair of shapes, in hands that are searched.

A gap has many gradients where a centre is on an axis, an edge, a corner or a face of what it touches, and only some of
them are those of a plane below the gap (docs/decisions/0041-scenes.md). Hands that move along such a place find the
wrong ones. ``make scenes`` searches 100,000 steps:

    python -m tests.deterministic.edges --steps 100000 --seed 1

Each pair of shapes begins there: a tool, or a body that a tool holds by a spring, on a wall, a room, an obstacle, a
free body or another user's tool. The hand moves along the place, to and fro across it by 1e-17 m to 10 mm, and yields
to the force or pushes against it, with one to three axes. An evolution strategy looks for the greatest *loss*: the
energy that the law alone, without its controller, gives out of nothing in ticks whose iteration has ended. Beside it a
core with the controller is asked the same. There the controller may do nothing in these ticks.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count, product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.contacts import Point, Surface
from manyhands.design.models.scene import Body, ContactScene, Obstacle, SceneLink, ToolSphere, UnknownGap
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.scene import SceneLaw
from tests.support.evolution import searched
from tests.support.reaction import react
from tests.support.scenes import Stored

Vector = NDArray[np.float64]

T: Final = 1e-3
TICKS: Final = 100  # of a path
GENERATIONS: Final = 2
GENES: Final = 11  # numbers of a path
LOSS: Final = 1e-12
"""Part of the work that a law may give out of nothing in finished ticks."""

LEAST: Final = 1e-9  # J; a point that rests in a room has less than this from rounding alone

ORIGIN: Final[Point] = (0.0, 0.0, 0.0)
MOVERS: Final = {
    "point": ToolSphere("hand", (0, 1, 2), (0, 1, 2), ORIGIN),
    "sphere": ToolSphere("hand", (0, 1, 2), (0, 1, 2), ORIGIN, 0.01),
    "ball": Body("held", 0.1, ORIGIN, 0.01),
    "rod": Body("held", 0.1, ORIGIN, 0.01, "capsule", (0.03, 0.0, 0.0)),
    "slanted rod": Body("held", 0.1, ORIGIN, 0.01, "capsule", (0.02, 0.03, -0.01)),
    "crate": Body("held", 0.1, ORIGIN, 0.0, "box", (0.02, 0.03, 0.01)),
}
"""What a hand moves: a tool, or a body that a spring joins with its tool."""

OTHERS: Final = {
    "wall": Obstacle("other", "wall", (ORIGIN, (0.0, 0.0, 1.0))),
    "oblique wall": Obstacle("other", "wall", (ORIGIN, (0.3, -0.2, 0.7))),
    "room": Obstacle("other", "room", ((-0.05, -0.06, -0.07), (0.05, 0.06, 0.07))),
    "block": Obstacle("other", "box", ((-0.03, -0.02, -0.04), (0.03, 0.02, 0.05))),
    "stone": Obstacle("other", "sphere", (ORIGIN,), 0.02),
    "bar": Obstacle("other", "capsule", ((-0.04, 0.0, 0.0), (0.06, 0.0, 0.0)), 0.02),
    "slanted bar": Obstacle("other", "capsule", ((-0.04, 0.02, 0.01), (0.06, -0.03, 0.02)), 0.02),
    "parallel bar": Obstacle("other", "capsule", ((-0.04, -0.06, 0.02), (0.04, 0.06, -0.02)), 0.02),
    "tool": ToolSphere("other", (3, 4, 5), (0, 1, 2), ORIGIN, 0.02),
    **{f"free {name}": replace(thing, name="other") for name, thing in MOVERS.items() if isinstance(thing, Body)},
}


@dataclass(frozen=True)
class Case:
    """A hand at one place of a pair of shapes.

    Attributes:
        scene: it begins with the hand's tool at the place.
        along: unit vectors along the edge, the axis or the face, and across it.
        compliance: of every coupling, m/N.
    """

    scene: ContactScene
    along: tuple[Vector, Vector]
    compliance: float


def pairs() -> list[tuple[str, str]]:
    """The names of all pairs of shapes whose gap is known."""
    return [pair for pair in product(MOVERS, OTHERS) if _scene(*pair, np.random.default_rng(0), 3, ORIGIN) is not None]


def _scene(mover: str, other: str, rng: np.random.Generator, axes: int, at: Point) -> ContactScene | None:
    """The two things, the first one at ``at``; None where their gap is not known."""
    thing, second = MOVERS[mover], OTHERS[other]
    moved = tuple(sorted(rng.permutation(3)[:axes].tolist()))
    hand = replace(MOVERS["point"], ports=tuple(range(axes)), axes=moved, at=at)
    tools, bodies, links, stiffness = [hand], [], [], 10.0 ** rng.uniform(2.5, 6.0)
    if isinstance(thing, ToolSphere):
        tools = [replace(hand, radius=thing.radius)]
    else:
        bodies.append(replace(thing, at=at))
        links.append(SceneLink(("hand", "held"), 10.0 ** rng.uniform(2.5, 4.0), 0.5))
    if isinstance(second, ToolSphere):
        tools.append(replace(second, ports=tuple(range(axes, axes + 3))))
    elif isinstance(second, Body):
        bodies.append(second)
    try:
        return ContactScene(
            tuple(f"{tool.name}.{'xyz'[axis]}" for tool in tools for axis in tool.axes),
            tools=tuple(tools),
            bodies=tuple(bodies),
            obstacles=(second,) if isinstance(second, Obstacle) else (),
            links=tuple(links),
            surface=Surface(stiffness, rng.choice([0.0, 2.0]), rng.choice([0.0, 0.5])),
        )
    except UnknownGap:
        return None


def case_of(mover: str, other: str, rng: np.random.Generator) -> Case:
    """A place of the pair at random, with a hand of one to three axes."""
    axes = int(rng.integers(1, 4))
    seed = int(rng.integers(2**32))
    scene = _scene(mover, other, np.random.default_rng(seed), axes, ORIGIN)
    if scene is None:
        raise ValueError(f"the gap of {mover} and {other} is not known")
    name = "hand" if isinstance(MOVERS[mover], ToolSphere) else "held"
    (pair, *_) = [pair for pair in scene.contacts.pairs if set(pair.names) == {name, "other"}]
    sign = 1.0 if pair.names[0] == name else -1.0
    shape, weights = np.array(pair.shape), rng.choice([-1.0, 0.0, 1.0, rng.uniform(-1.0, 1.0)], 3)
    sides = [np.eye(3)[int(rng.integers(3))]]
    match pair.kind:
        case "spheres":
            place = np.zeros(3)
        case "plane":
            room = OTHERS[other]
            place = shape[0] + pair.reach * shape[1] / np.linalg.norm(shape[1])
            if isinstance(room, Obstacle) and room.shape == "room":
                low, high = np.array(room.points)
                place = (low + high) / 2.0 + weights * (high - low) / 2.0
            sides = [np.cross(shape[1], side) for side in np.eye(3)]
        case "box":
            place = shape.mean(axis=0) + weights * (shape[1] - shape[0]) / 2.0
            sides = [*np.eye(3)]
        case _:
            a = (shape[1] - shape[0]) / 2.0
            sides = [a, *shape[2:]] if a.any() else sides
            place = shape[:2].mean(axis=0) + sum(w * side for w, side in zip(weights, [a, *shape[2:]], strict=False))
    side = sides[int(rng.integers(len(sides)))]
    along = side / np.linalg.norm(side) if side.any() else np.eye(3)[0]
    across = np.cross(along, rng.normal(size=3))
    x, y, z = (sign * place).tolist()
    placed = _scene(mover, other, np.random.default_rng(seed), axes, (x, y, z))
    assert placed is not None
    return Case(placed, (along, across / np.linalg.norm(across)), 1.0 / rng.uniform(300.0, 3000.0))


@dataclass
class Course:
    """What was seen along a path.

    Attributes:
        loss: the energy that came from nothing in finished ticks, J.
        work: what has passed at the tools, and what was stored at the start, J.
        unfinished: ticks whose iteration did not end; nothing of them is in the loss.
        acted: finished ticks in which the controller acted, before the first unfinished one.
        steps: ticks.
    """

    loss: float = 0.0
    work: float = 0.0
    unfinished: int = 0
    acted: int = 0
    steps: int = 0

    @property
    def part(self) -> float:
        """The loss as part of the work, or of :data:`LEAST` where that is more."""
        return self.loss / max(self.work, LEAST)


def course_of(case: Case, genes: Vector) -> Course:
    """Follow a path with the law alone, and with the controller beside it."""
    scene, m = case.scene, len(case.scene.ports)
    blocks, begin = [], 0
    for tool in scene.tools:
        blocks.append(list(range(begin, begin + len(tool.ports))))
        begin += len(tool.ports)
    laws = [SceneLaw(scene, T) for _ in range(2)]
    core, kept = (
        EnforcedCore(law, case.compliance * np.eye(m), np.zeros((m, m)), T, enforce, blocks,
                     stored=scene.energy_at_start)
        for law, enforce in zip(laws, (False, True), strict=True)
    )  # fmt: skip
    stored = Stored(scene, laws[0])
    course, f, before = Course(work=scene.energy_at_start), np.zeros(m), np.zeros(m)
    energy, pushed = stored.at(core), np.zeros(m)
    hand = list(scene.tools[0].axes)
    size, swift, phase, small, quick, shift, greed, noise, press, slow, yield_ = genes
    rng = np.random.default_rng(abs(int(1e6 * noise)))
    along, across = case.along
    for k in range(TICKS):
        t = k / TICKS
        way = 0.03 * np.tanh(size) * (np.sin(5.0 * swift * t + phase) - np.sin(phase)) * along
        way = way + 10.0 ** (-9.5 + 7.5 * np.tanh(small)) * np.sin(9.0 * quick * t + shift) * across
        way = way + 0.01 * max(0.0, np.tanh(press)) * np.sin(3.0 * slow * t) * across
        way = way + 10.0 ** (-11.0 + 6.0 * np.tanh(noise)) * rng.normal(size=3)
        if yield_ > 0.5:  # the hand gives way to the force, or pushes against it
            pushed = np.clip(pushed + 1e-4 * np.tanh(greed) * np.sign(f), -0.03, 0.03)
        p = pushed.copy()
        p[: len(hand)] += way[hand]
        f = react(core, p)
        core.settle()
        react(kept, p)
        kept.settle()
        tools = np.array(core.tools)
        course.work += float(np.abs(f) @ np.abs(tools - before))
        now = stored.at(core)
        gained = -float(f @ (tools - before)) - (now - energy)
        energy, before = now, tools
        course.steps += 1
        if laws[0].unfinished > course.unfinished:
            course.unfinished = laws[0].unfinished
            continue
        course.loss += max(0.0, -gained)
        if course.unfinished == 0 and kept.controller is not None:
            course.acted = kept.controller.ticks
    return course


@dataclass
class Outcome:
    """What a search found at a place of a pair.

    Attributes:
        pair: the names of the two shapes.
        seed: of the search.
        worst: the course with the greatest loss as part of its work, or in which the controller acted.
        steps: ticks of all courses.
        unfinished: of these.
    """

    pair: tuple[str, str]
    seed: int
    worst: Course
    steps: int = 0
    unfinished: int = 0

    @property
    def broken(self) -> bool:
        """Whether the law gave out more than rounding, or the controller acted in a finished tick."""
        return self.worst.part > LOSS or self.worst.acted > 0


def outcome_of(pair: tuple[str, str], seed: int, generations: int = GENERATIONS) -> Outcome:
    """Search the paths from one place of a pair of shapes."""
    rng = np.random.default_rng((seed, pairs().index(pair)))
    case, outcome = case_of(*pair, rng), Outcome(pair, seed, Course())

    def part(genes: Vector) -> float:
        course = course_of(case, genes)
        outcome.steps += course.steps
        outcome.unfinished += course.unfinished
        outcome.worst = max(outcome.worst, course, key=lambda found: (found.acted > 0, found.part))
        return course.part

    searched(part, GENES, rng, generations)
    return outcome


def campaign(steps: int, seed: int) -> Iterator[Outcome]:
    """Search all pairs, and again from other places, until there were so many steps."""
    done = 0
    for number in count(seed):
        for pair in pairs():
            outcome = outcome_of(pair, number)
            done += outcome.steps
            yield outcome
        if done >= steps:
            return


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign; returns 1 if a law gave out energy, or if a controller acted in a finished tick."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000, help="steps to search at least (100,000)")
    parser.add_argument("--seed", type=int, default=1, help="of the first places (1)")
    asked = parser.parse_args(arguments)
    outcomes: list[Outcome] = []
    for outcome in campaign(asked.steps, asked.seed):
        outcomes.append(outcome)
        if outcome.broken:
            worst = outcome.worst
            print(  # noqa: T201 -- what a campaign is for
                f"seed {outcome.seed}, {' on '.join(outcome.pair)}: lost {worst.loss:.3g} J of {worst.work:.3g} J, the "
                f"controller acted in {worst.acted} finished ticks",
                flush=True,
            )
    print(  # noqa: T201
        f"{sum(o.steps for o in outcomes)} steps in {len(outcomes)} places of {len({o.pair for o in outcomes})} pairs, "
        f"{sum(o.unfinished for o in outcomes)} ticks unfinished. Greatest loss in finished ticks: "
        f"{max(o.worst.part for o in outcomes):.3g} of the work. Places where a promise was not kept: "
        f"{sum(o.broken for o in outcomes)}."
    )
    return 1 if any(o.broken for o in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
