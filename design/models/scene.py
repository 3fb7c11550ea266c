"""Scenes: tools and bodies in space that springs join, that touch each other and what stands still, with friction.

A tool is a point or a sphere that one device moves along one to three axes. A body is a point, a sphere, a capsule or a
box with a mass; it does not turn. Obstacles stand still: walls and rooms keep things inside a convex set, the others
keep them outside of one.

The promise of a scene is the level Phi_E = 0: from its start on it gives out no more energy than it stored there,
whatever its stiffnesses, dampings and friction are (docs/decisions/0041-scenes.md). That holds for the exact solution
of every tick. A passivity controller keeps the same level at run time, and so covers what a solver leaves. The design
uses the level alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import combinations
from typing import Any, Final

import numpy as np

from manyhands.design.models.brief import brief_repr
from manyhands.design.models.contacts import (
    AXES,
    GROUND,
    ContactPair,
    Contacts,
    Core,
    Point,
    Surface,
    core_difference,
)
from manyhands.design.models.distance_grid import MOST_DRAWN
from manyhands.design.models.statespace import Matrix

STIFFEST: Final = 1e6
"""N/m; with stiffer contacts the iteration of a tick would not end in a bounded number of steps."""

MOST_POINTS: Final = 32
"""Tools and bodies together: their number determines the time of a tick."""

MOST_OBSTACLES: Final = 32

MOST_PAIRS: Final = 1024
"""Pairs that may touch: a tick computes the gap of each."""

MOST_SAMPLES: Final = 10_000
"""Samples of a driven body's recorded motion along one axis: the certificate and the environment's bundle have them."""

MOST_DRIVE: Final = 1000.0
"""J, of the tank of the driven bodies, or of a world of proxies."""

SHAPES: Final[Mapping[str, tuple[str, ...]]] = {
    "wall": ("at", "normal"),
    "room": ("low", "high"),
    "box": ("low", "high"),
    "sphere": ("at", "radius"),
    "capsule": ("ends", "radius"),
}
"""The keys of each shape of an obstacle, besides ``shape``."""

BODY_SHAPES: Final = ("sphere", "capsule", "box")
"""The shapes of bodies, with the same keys as of obstacles, and a mass."""


class SceneError(ValueError):
    """What is stated makes no scene that could run.

    Attributes:
        body: the body that it is about; empty where it is about all together.
        found: what was found.
        expected: what would be right.
    """

    def __init__(self, body: str, found: str, expected: str) -> None:
        """The error about this body."""
        super().__init__(f"environment: {body and f'body {body}: '}found {found}; expected {expected}")
        self.body, self.found, self.expected = body, found, expected


class Falling(SceneError):
    """Gravity would move a body down without end, so that the scene could give out energy without end."""

    def __init__(self, body: str, nearly: str = "", normal: Point = (0.0, 0.0, 0.0)) -> None:
        """The error about this body.

        Args:
            body: its name.
            nearly: the wall whose normal is nearly against gravity; empty where there is none.
            normal: the direction against gravity.
        """
        found, expected = "gravity, and nothing that holds the body for good", "a wall whose normal points"
        if nearly:
            found += f": gravity has a small component along the wall {nearly}"
            x, y, z = normal
            expected = f"the wall {nearly} with the normal [{x!r}, {y!r}, {z!r}],"
        super().__init__(body, found, f"a room, {expected} exactly against gravity, or a spring to the ground")


class UnknownGap(SceneError):
    """Two things may touch whose distance is not known here: a box, and a capsule that is along no axis."""

    def __init__(self, body: str, other: str) -> None:
        """The error about a body and a different thing."""
        found = f"a box that may touch a capsule along no axis ({body!r} and {other!r})"
        super().__init__(body, found, "a capsule along x, y or z, or a contact of stiffness 0 between the two")


@dataclass(frozen=True)
class ToolSphere:
    """A point or a sphere that a device moves.

    Attributes:
        name: of the tool.
        ports: indices of the ports that move it.
        axes: 0, 1 or 2 for each port: the axis x, y or z that it moves along.
        at: where its centre is when all displacements are 0, m.
        radius: m.
    """

    name: str
    ports: tuple[int, ...]
    axes: tuple[int, ...]
    at: Point
    radius: float = 0.0

    @property
    def core(self) -> Core:
        """The centre, at the origin."""
        return _POINT


_POINT: Final = Core("segment", ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))


@dataclass(frozen=True)
class Body:
    """A point, a sphere, a capsule or a box that moves freely or as it is driven, without turning.

    Attributes:
        name: of the body.
        mass: > 0, kg; 0 of a driven body, where it has no effect.
        at: where its centre is at the start, at rest, m.
        radius: of a sphere or a capsule, m; 0 for a box.
        shape: one of :data:`BODY_SHAPES`; the sides of a box are along the axes.
        half: from the centre to an end of a capsule's axis, or to the corner of a box with the greatest coordinates, m.
        motion: of a driven body, its displacement along x, y and z, m, that is 0 at the start: each a number, a formula
            in t (s), or times and values. Empty for a body that moves freely.
    """

    name: str
    mass: float
    at: Point
    radius: float = 0.0
    shape: str = "sphere"
    half: Point = (0.0, 0.0, 0.0)
    motion: tuple[Any, ...] = ()

    @property
    def core(self) -> Core:
        """What is within its radius, with the centre at the origin."""
        x, y, z = self.half
        return Core("box" if self.shape == "box" else "segment", ((-x, -y, -z), self.half))


@dataclass(frozen=True)
class Obstacle:
    """A thing that stands still.

    Attributes:
        name: of the obstacle.
        shape: "wall" and "room" keep the spheres inside; "box", "sphere" and "capsule" keep them outside. A "mesh" is
            drawn, and nothing in a scene touches it.
        points: of a wall a point and the normal towards the inside; of a room or a box the corners with the least and
            the greatest coordinates; of a capsule the ends of its axis; of a sphere its centre; of a mesh its vertices.
            m
        radius: of a sphere or a capsule, m; 0 for the others.
        triangles: of a mesh: indices of points, which turn to the left seen from outside; empty for the others.
    """

    name: str
    shape: str
    points: tuple[Point, ...]
    radius: float = 0.0
    triangles: tuple[tuple[int, int, int], ...] = ()

    @property
    def core(self) -> Core:
        """What is within its radius, for a sphere, a capsule or a box."""
        return Core("box" if self.shape == "box" else "segment", (self.points[0], self.points[-1]))

    @property
    def faces(self) -> tuple[tuple[Point, Point], ...]:
        """A point and the normal of each plane of a wall or a room; empty for the others."""
        if self.shape == "wall":
            return ((self.points[0], self.points[1]),)
        if self.shape != "room":
            return ()
        low, high = self.points
        return tuple(
            (corner, (side * (j == 0), side * (j == 1), side * (j == 2)))
            for corner, side in ((low, 1.0), (high, -1.0))
            for j in range(3)
        )


@dataclass(frozen=True)
class SceneLink:
    """A spring and a damper between two ends, the same along all axes.

    Attributes:
        ends: two tools or bodies, or one and :data:`.GROUND`.
        stiffness: N/m.
        damping: N*s/m.
        rest: the first end's position less the second's, at which the spring has no force, m; the ground's position is
            0. None for the positions at the start.
    """

    ends: tuple[str, str]
    stiffness: float
    damping: float
    rest: Point | None = None


@dataclass(frozen=True)
class SceneHold:
    """By a button, a tool holds the body that is nearest to it: a spring and a damper join the two while it is pressed.

    Their present offset is the one at which the spring has no force.

    Attributes:
        tool: of the device that has the button.
        button: its name, after the device's.
        stiffness: N/m.
        damping: N*s/m.
        within: the greatest gap between the two at which the button takes hold, m.
    """

    tool: str
    button: str
    stiffness: float
    damping: float = 0.0
    within: float = 0.0


UNTOUCHED: Final = Surface(0.0)
"""How things touch that never do."""


@dataclass(frozen=True, eq=False)
class ContactScene:
    """A scene of tools, bodies, obstacles, springs and contacts; its level is 0.

    Attributes:
        ports: names of the m ports.
        tools: in their order; together they hold every port once.
        bodies: in their order.
        obstacles: in their order.
        links: the springs and dampers.
        surface: how any two things touch, unless ``surfaces`` states otherwise. Linked things do not touch.
        surfaces: how two named things touch.
        gravity: the acceleration of free bodies, m/s^2.
        tank: the energy that all driven bodies together may give out, J.
        holds: what buttons hold.

    Raises:
        Falling: gravity would move a body down without end.
        UnknownGap: a capsule along no axis may touch a box.
        SceneError: there are too many pairs.
        ValueError: a name is used twice or unknown, a number is out of its range, or there are too many things.
    """

    ports: tuple[str, ...]
    tools: tuple[ToolSphere, ...] = ()
    bodies: tuple[Body, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    links: tuple[SceneLink, ...] = ()
    surface: Surface = UNTOUCHED
    surfaces: tuple[tuple[tuple[str, str], Surface], ...] = ()
    gravity: Point = (0.0, 0.0, 0.0)
    tank: float = 0.0
    holds: tuple[SceneHold, ...] = ()

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        for problem in self._problems():
            raise ValueError(f"environment: {problem}")
        for body in self.bodies:
            if self.lowest_energy(body) == -math.inf:
                x, y, z = (0.0 - g for g in self.gravity)
                raise Falling(body.name, self._nearly_holding(body), (x, y, z))
        count = sum(1 for _ in self.pairs())
        if count > MOST_PAIRS:
            expected = f"at most {MOST_PAIRS}; a contact of stiffness 0 takes its pair away"
            raise SceneError("", f"{count} pairs that may touch", expected)

    def __eq__(self, other: object) -> bool:
        """Equal when every number is."""
        if not isinstance(other, ContactScene):
            return NotImplemented
        return self.ports == other.ports and self.terms() == other.terms()

    __hash__ = None  # type: ignore[assignment]  # it is compared by all its numbers

    @cached_property
    def things(self) -> tuple[ToolSphere | Body, ...]:
        """The tools and then the bodies, in the order of the points."""
        return (*self.tools, *self.bodies)

    def _problems(self) -> Iterator[str]:
        """What is wrong with the scene, most basic first."""
        movable = [thing.name for thing in self.things]
        names = [*movable, *(obstacle.name for obstacle in self.obstacles), GROUND]
        if len(set(names)) < len(names):
            yield f"found the names {names[:-1]}; expected distinct ones, none of them {GROUND!r}"
        if len(movable) > MOST_POINTS or len(self.obstacles) > MOST_OBSTACLES:
            yield (
                f"found {len(movable)} tools and bodies and {len(self.obstacles)} obstacles; expected at most "
                f"{MOST_POINTS} and {MOST_OBSTACLES}"
            )
        if sorted(port for tool in self.tools for port in tool.ports) != list(range(len(self.ports))):
            yield "expected every port at one tool"
        for tool in self.tools:
            if len(set(tool.axes)) < len(tool.axes) or len(tool.axes) != len(tool.ports) or not set(tool.axes) <= _XYZ:
                yield f"tool {tool.name}: found the axes {tool.axes} for {len(tool.ports)} ports; expected one each"
        for body in self.bodies:
            extended, flat = body.shape == "sphere" and any(body.half), body.shape == "box" and min(body.half) <= 0.0
            if body.shape not in BODY_SHAPES or extended or flat:
                yield f"body {body.name}: found the shape {body.shape!r} with the half extent {body.half}"
        for obstacle in self.obstacles:
            expected = {"wall": 2, "room": 2, "box": 2, "capsule": 2, "sphere": 1}.get(obstacle.shape)
            if obstacle.shape == "mesh":
                yield from self._problems_of_mesh(obstacle)
            elif expected != len(obstacle.points) or obstacle.triangles:
                found = f"{len(obstacle.points)} points and {len(obstacle.triangles)} triangles"
                yield f"obstacle {obstacle.name}: found the shape {obstacle.shape!r} with {found}"
            elif obstacle.shape in ("room", "box") and not all(a < b for a, b in zip(*obstacle.points, strict=True)):
                yield f"obstacle {obstacle.name}: expected the corner 'low' below 'high' along every axis"
            elif obstacle.shape == "wall" and not any(obstacle.points[1]):
                yield f"obstacle {obstacle.name}: found the normal [0, 0, 0]; expected a direction"
        for link in self.links:
            known = set(movable) | {GROUND}
            if not set(link.ends) <= known or link.ends[0] == link.ends[1]:
                yield f"link between {link.ends}: expected two different ones of {sorted(known)}"
        for ends, _ in self.surfaces:
            if not set(ends) <= set(names[:-1]) or ends[0] == ends[1] or not set(ends) & set(movable):
                yield f"contact between {ends}: expected two different things, one of them a tool or a body"
        for body in self.bodies:
            if body.motion and (body.mass, len(body.motion)) != (0.0, 3):
                yield f"body {body.name}: found a mass or {len(body.motion)} motions; expected no mass, and 3 motions"
            samples = [len(motion["times"]) for motion in body.motion if isinstance(motion, Mapping)]
            if any(count > MOST_SAMPLES for count in samples):
                yield f"body {body.name}: found a motion of {max(samples)} samples; expected at most {MOST_SAMPLES}"
        if not 0.0 <= self.tank <= MOST_DRIVE:
            yield f"found a tank of {self.tank} J; expected 0 to {MOST_DRIVE:g} J"
        tools = {tool.name for tool in self.tools}
        if unknown := [hold.tool for hold in self.holds if hold.tool not in tools]:
            yield f"found a hold of {unknown[0]!r}; expected one of the tools {sorted(tools)}"
        masses = [body.mass for body in self.bodies if not body.motion]
        if not all(0.0 < mass < math.inf for mass in masses):
            yield f"found the masses {masses}; expected finite ones > 0"
        amounts = [thing.radius for thing in self.things] + [obstacle.radius for obstacle in self.obstacles]
        amounts += [amount for link in self.links for amount in (link.stiffness, link.damping)]
        amounts += [amount for hold in self.holds for amount in (hold.stiffness, hold.damping, hold.within)]
        stated = [self.surface, *(surface for _, surface in self.surfaces)]
        amounts += [amount for surface in stated for amount in surface]
        if not all(0.0 <= amount < math.inf for amount in amounts):
            yield "expected every radius, stiffness, damping and friction finite and >= 0"
        if any(surface.stiffness > STIFFEST for surface in stated):
            yield f"expected a contact's stiffness of at most {STIFFEST:g} N/m"
        if not all(math.isfinite(x) for x in self._coordinates()):
            yield "expected finite coordinates"

    def _problems_of_mesh(self, mesh: Obstacle) -> Iterator[str]:
        corners = [corner for triangle in mesh.triangles for corner in triangle]
        triangles = sum(len(obstacle.triangles) for obstacle in self.obstacles)
        if not mesh.triangles or triangles > MOST_DRAWN or len(mesh.points) > 3 * MOST_DRAWN:
            yield f"obstacle {mesh.name}: found {triangles} triangles in all; expected 1 to {MOST_DRAWN}"
        elif not 0 <= min(corners) <= max(corners) < len(mesh.points):
            yield f"obstacle {mesh.name}: found a triangle of no point; expected indices of {len(mesh.points)} points"
        if any(self.surface_of(thing.name, mesh.name).stiffness > 0.0 for thing in self.things):
            yield f"obstacle {mesh.name}: found a contact with a mesh, which is not convex; expected a convex shape"

    def _coordinates(self) -> Iterator[float]:
        yield from self.gravity
        for thing in self.things:
            yield from thing.at
        for body in self.bodies:
            yield from body.half
        for obstacle in self.obstacles:
            for point in obstacle.points:
                yield from point
        for link in self.links:
            yield from link.rest or ()

    @cached_property
    def points(self) -> Matrix:
        """The centres of the tools and then of the bodies at the start, P x 3, m."""
        return np.array([thing.at for thing in self.things], dtype=np.float64).reshape(-1, 3)

    @property
    def bounds(self) -> tuple[Matrix, Matrix]:
        """The corners with the least and the greatest coordinates of all places that the scene names, m: centres,
        corners and ends at the start, and a point of each wall; the origin in an empty scene.
        """
        places = [(a + x, b + y, c + z) for t in self.things for a, b, c in [t.at] for x, y, z in t.core.ends]
        places += [p for o in self.obstacles for p in (o.points[:1] if o.shape == "wall" else o.points)]
        found = np.array(places or [(0.0, 0.0, 0.0)], dtype=np.float64)
        return found.min(axis=0), found.max(axis=0)

    @property
    def geometry(self) -> ContactScene:
        """The scene without springs, gravity and motions: its tools, bodies and obstacles, and how they touch.

        Two things that a spring joins have the stiffness 0 there, unless ``surfaces`` states otherwise.
        """
        bodies = tuple(replace(body, motion=(0.0, 0.0, 0.0)) if body.motion else body for body in self.bodies)
        joined = tuple((link.ends, UNTOUCHED) for link in self.links if GROUND not in link.ends)
        surfaces = (*self.surfaces, *joined)
        return ContactScene(self.ports, self.tools, bodies, self.obstacles, surface=self.surface, surfaces=surfaces)

    def ends_of(self, link: SceneLink) -> tuple[int | None, int | None]:
        """The indices of the points that a link joins; None for the ground."""
        a, b = (next((i for i, thing in enumerate(self.things) if thing.name == end), None) for end in link.ends)
        return a, b

    def rest_of(self, link: SceneLink) -> Matrix:
        """The first end's position less the second's at which the link's spring has no force, m."""
        if link.rest is not None:
            return np.array(link.rest)
        return self.span_of(link, self.points)

    def span_of(self, link: SceneLink, points: Matrix) -> Matrix:
        """The first end's position less the second's, m, where the points are at ``points``, P x 3."""
        a, b = (np.zeros(3) if i is None else points[i] for i in self.ends_of(link))
        return np.asarray(a - b)

    @cached_property
    def contacts(self) -> Contacts:
        """The pairs that may touch."""
        return Contacts(self.pairs(), len(self.points))

    @cached_property
    def graspable(self) -> Contacts:
        """The pairs of a tool with a hold and a body, whatever happens when they touch.

        Raises:
            UnknownGap: the gap of a pair is not known here.
        """
        return Contacts(self._graspable(), len(self.points))

    def _graspable(self) -> Iterator[ContactPair]:
        holders = {hold.tool for hold in self.holds}
        for i, tool in enumerate(self.tools):
            for j, body in enumerate(self.bodies if tool.name in holders else (), len(self.tools)):
                reach, known = tool.radius + body.radius, core_difference(tool.core, body.core)
                if tool.core.is_point and body.core.is_point:
                    yield ContactPair((tool.name, body.name), i, j, UNTOUCHED, reach, "spheres")
                elif known is None:
                    raise UnknownGap(tool.name, body.name)
                else:
                    yield ContactPair((tool.name, body.name), i, j, UNTOUCHED, reach, *known)

    def pairs(self) -> Iterator[ContactPair]:
        """The pairs that may touch: two things, or a thing and an obstacle; of a room one for each face.

        A driven body passes through obstacles and driven bodies, since nothing could give way.

        Raises:
            UnknownGap: a capsule along no axis may touch a box.
        """
        things = self.things
        driven = {body.name for body in self.bodies if body.motion}
        for (i, a), (j, b) in combinations(enumerate(things), 2):
            if {a.name, b.name} <= driven:
                continue
            yield from self._pair((i, a), (j, b))
        for i, a in enumerate(things):
            for obstacle in () if a.name in driven else self.obstacles:
                if not obstacle.faces:
                    yield from self._pair((i, a), (-1, obstacle))
                    continue
                surface = self.surface_of(a.name, obstacle.name)
                for face in obstacle.faces if surface.stiffness > 0.0 else ():
                    reach = a.radius + a.core.support(face[1])
                    yield ContactPair((a.name, obstacle.name), i, -1, surface, reach, "plane", face)

    def _pair(
        self, first: tuple[int, ToolSphere | Body], second: tuple[int, ToolSphere | Body | Obstacle]
    ) -> Iterator[ContactPair]:
        """The pair of two things, unless they never touch."""
        (i, a), (j, b) = first, second
        surface, reach = self.surface_of(a.name, b.name), a.radius + b.radius
        if surface.stiffness == 0.0:
            return
        if a.core.is_point and b.core.is_point and j >= 0:
            if reach > 0.0:
                yield ContactPair((a.name, b.name), i, j, surface, reach, "spheres")
            return
        known = core_difference(a.core, b.core)
        if known is None:
            raise UnknownGap(a.name, b.name)
        yield ContactPair((a.name, b.name), i, j, surface, reach, *known)

    def surface_of(self, a: str, b: str) -> Surface:
        """How two things touch; with the stiffness 0 for things that a link joins."""
        for ends, surface in self.surfaces:
            if {a, b} == set(ends):
                return surface
        return UNTOUCHED if any({a, b} == set(link.ends) for link in self.links) else self.surface

    def lowest_energy(self, body: Body) -> float:
        """A lower bound of a body's energy of height, with that of the walls and of the springs to the ground, J.

        With the weight W and a spring of stiffness k that holds it at q0, or a face that it presses on,

            -W^T q + k/2 |q - q0|^2 >= -W^T q0 - |W|^2/(2 k).

        A wall alone holds a body only if its normal is exactly against gravity. That is decided with the decimals that
        both are written with, as the proof decides it.

        Returns:
            The greatest of these bounds; minus infinity where gravity acts on the body, and none holds it.
        """
        W = body.mass * np.array(self.gravity)
        if not W.any():
            return 0.0
        found = [-math.inf]
        for link in self.links:
            if link.stiffness > 0.0 and set(link.ends) == {body.name, GROUND}:
                held = self.rest_of(link) * (1.0 if link.ends[0] == body.name else -1.0)
                found.append(-float(W @ held) - float(W @ W) / (2.0 * link.stiffness))
        for obstacle in self.obstacles:
            k = self.surface_of(body.name, obstacle.name).stiffness
            if k == 0.0 or not obstacle.faces:
                continue
            pressed = [(at, n) for at, n in obstacle.faces if _along(self.gravity, n) < 0]
            if obstacle.shape == "wall" and pressed and any(_across(self.gravity, pressed[0][1])):
                continue  # gravity has a component along the wall
            total = 0.0 if pressed else -math.inf
            for at, n in pressed:
                unit = np.array(n) / math.hypot(*n)
                force = -float(W @ unit)
                total += force * (float(unit @ np.array(at)) + body.radius + body.core.support(n)) - force * force / (
                    2.0 * k
                )
            found.append(total)
        return max(found)

    def _nearly_holding(self, body: Body) -> str:
        """The wall that would hold the body, were its normal against gravity to the last digit; empty without one."""
        size = math.hypot(*self.gravity)
        for obstacle in self.obstacles:
            if obstacle.shape == "wall" and self.surface_of(body.name, obstacle.name).stiffness > 0.0:
                n = obstacle.points[1]
                along, length = _along(self.gravity, n), size * math.hypot(*n)
                if along < 0 and math.hypot(*map(float, _across(self.gravity, n))) < _NEARLY * length:
                    return obstacle.name
        return ""

    @cached_property
    def energy_at_start(self) -> float:
        """A bound on the energy that the scene can give out from its start at rest, J, at least 0.

        It is that of height, of springs and of overlapping contacts, less the bound of :meth:`lowest_energy`, and the
        tank of its driven bodies.
        """
        springs = 0.0
        for link in self.links:
            strained = self.span_of(link, self.points) - self.rest_of(link)
            springs += 0.5 * link.stiffness * float(strained @ strained)
        height = sum(
            -body.mass * float(np.dot(self.gravity, body.at)) - self.lowest_energy(body) for body in self.bodies
        )
        return max(0.0, height + springs + self.contacts.energy(self.points)) + self.tank

    def terms(self) -> dict[str, Any]:
        """The scene as JSON values, by the keys of a certificate's ``environment``."""
        return {
            "type": "scene",
            "gravity": list(self.gravity),
            **({"tank": self.tank} if self.tank else {}),
            "tools": {
                tool.name: {
                    "ports": [self.ports[port] for port in tool.ports],
                    "axes": [AXES[axis] for axis in tool.axes],
                    "at": list(tool.at),
                    "radius": tool.radius,
                }
                for tool in self.tools
            },
            "bodies": {
                b.name: {
                    "mass": b.mass,
                    "at": list(b.at),
                    "radius": b.radius,
                    **({} if b.shape == "sphere" else {"shape": b.shape, "half": list(b.half)}),
                    **({"motion": list(b.motion)} if b.motion else {}),
                }
                for b in self.bodies
            },
            "obstacles": {
                o.name: {
                    "shape": o.shape,
                    "points": [list(point) for point in o.points],
                    "radius": o.radius,
                    **({"triangles": [list(corners) for corners in o.triangles]} if o.triangles else {}),
                }
                for o in self.obstacles
            },
            "links": [
                {
                    "between": list(link.ends),
                    "stiffness": link.stiffness,
                    "damping": link.damping,
                    "rest": self.rest_of(link).tolist(),
                }
                for link in self.links
            ],
            "contact": self.surface._asdict(),
            "contacts": [{"between": list(ends), **surface._asdict()} for ends, surface in self.surfaces],
            **({"holds": [vars(hold).copy() for hold in self.holds]} if self.holds else {}),
        }

    def geometry_terms(self) -> dict[str, Any]:
        """Tools, bodies, obstacles and how they touch, as JSON values, with the names of the ports."""
        terms = self.terms()
        return {"ports": list(self.ports), **{key: terms[key] for key in _GEOMETRY}}


_NEARLY: Final = 1e-3  # rad: a wall that is turned by less was meant to be against gravity


def _exactly(vector: Point) -> tuple[Fraction, Fraction, Fraction]:
    """The decimals that the numbers are written with."""
    x, y, z = (Fraction(repr(float(value))) for value in vector)
    return x, y, z


def _along(a: Point, b: Point) -> Fraction:
    return sum((p * q for p, q in zip(_exactly(a), _exactly(b), strict=True)), Fraction(0))


def _across(a: Point, b: Point) -> tuple[Fraction, Fraction, Fraction]:
    """The cross product."""
    (p, q, r), (x, y, z) = _exactly(a), _exactly(b)
    return q * z - r * y, r * x - p * z, p * y - q * x


_XYZ: Final = {0, 1, 2}
_GEOMETRY: Final = ("tools", "bodies", "obstacles", "contact", "contacts")


def _point(data: Sequence[Any]) -> Point:
    x, y, z = (float(value) for value in data)
    return x, y, z


def _corners(data: Sequence[Any]) -> tuple[int, int, int]:
    i, j, k = (int(index) for index in data)
    return i, j, k


def _motion(data: Any) -> Any:
    """A motion along one axis, in the types that :attr:`Body.motion` has."""
    if isinstance(data, str):
        return data
    if isinstance(data, Mapping):
        return {key: [float(value) for value in data[key]] for key in ("times", "values")}
    return float(data)


def _surface(data: Mapping[str, Any]) -> Surface:
    return Surface(float(data["stiffness"]), float(data["damping"]), float(data["friction"]))


def scene_of(data: Mapping[str, Any], ports: tuple[str, ...]) -> ContactScene:
    """The scene that :meth:`ContactScene.terms` wrote.

    Raises:
        KeyError, TypeError, ValueError: a key is missing, or its value makes no scene.
    """
    return ContactScene(
        ports,
        tools=tuple(
            ToolSphere(
                str(name),
                tuple(ports.index(port) for port in tool["ports"]),
                tuple(AXES.index(axis) for axis in tool["axes"]),
                _point(tool["at"]),
                float(tool["radius"]),
            )
            for name, tool in data["tools"].items()
        ),
        bodies=tuple(
            Body(
                str(name),
                float(body["mass"]),
                _point(body["at"]),
                float(body["radius"]),
                str(body.get("shape", "sphere")),
                _point(body.get("half", (0.0, 0.0, 0.0))),
                tuple(map(_motion, body.get("motion", ()))),
            )
            for name, body in data["bodies"].items()
        ),
        obstacles=tuple(
            Obstacle(
                str(name),
                str(thing["shape"]),
                tuple(map(_point, thing["points"])),
                float(thing["radius"]),
                tuple(map(_corners, thing.get("triangles", ()))),
            )
            for name, thing in data["obstacles"].items()
        ),
        links=tuple(
            SceneLink((str(a), str(b)), float(link["stiffness"]), float(link["damping"]), _point(link["rest"]))
            for link in data["links"]
            for a, b in [link["between"]]
        ),
        surface=_surface(data["contact"]),
        surfaces=tuple(((str(a), str(b)), _surface(c)) for c in data["contacts"] for a, b in [c["between"]]),
        gravity=_point(data["gravity"]),
        tank=float(data.get("tank", 0.0)),
        holds=tuple(
            SceneHold(str(h["tool"]), str(h["button"]), *(float(h[key]) for key in ("stiffness", "damping", "within")))
            for h in data.get("holds", ())
        ),
    )


def geometry_of(data: Mapping[str, Any]) -> ContactScene:
    """The geometry that :meth:`ContactScene.geometry_terms` wrote.

    Raises:
        KeyError, TypeError, ValueError, OverflowError, AttributeError: a key is missing, or its value makes no scene.
    """
    return scene_of({**ContactScene(()).terms(), **{key: data[key] for key in _GEOMETRY}}, tuple(data["ports"]))
