"""Scenes: tools and bodies in space that springs join, that touch each other and what stands still, with friction.

A tool is a point or a sphere that one device moves along one to three axes. A body is a point or a sphere with a mass.
Obstacles stand still: walls and rooms keep the spheres inside a convex set, the others keep them outside of one.

The promise of a scene is the level Phi_E = 0: from its start on it gives out no more energy than it stored there,
whatever its stiffnesses, dampings and friction are (docs/decisions/0041-scenes.md). That holds for the exact solution
of every tick. A passivity controller keeps the same level at run time, and so covers what a solver leaves. The design
uses the level alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any, Final, TypeAlias

import numpy as np

from manyhands.design.models.brief import brief_repr
from manyhands.design.models.contacts import GROUND, ContactPair, Contacts, Surface
from manyhands.design.models.statespace import Matrix

Point: TypeAlias = tuple[float, float, float]
"""A position or a vector in the scene, along x, y and z."""

STIFFEST: Final = 1e6
"""N/m; with stiffer contacts the iteration of a tick would not end in a bounded number of steps."""

MOST_POINTS: Final = 32
"""Tools and bodies together: their number determines the time of a tick."""

MOST_OBSTACLES: Final = 32

SHAPES: Final[Mapping[str, tuple[str, ...]]] = {
    "wall": ("at", "normal"),
    "room": ("low", "high"),
    "box": ("low", "high"),
    "sphere": ("at", "radius"),
    "capsule": ("ends", "radius"),
}
"""The keys of each shape of an obstacle, besides ``shape``."""


class Falling(ValueError):
    """Gravity would move a body down without end, so that the scene could give out energy without end.

    Attributes:
        body: its name.
    """

    FOUND: Final = "gravity, and nothing that holds the body for good"
    EXPECTED: Final = "a room, a wall whose normal points against gravity, or a spring to the ground"

    def __init__(self, body: str) -> None:
        """The error about this body."""
        super().__init__(f"environment: body {body}: found {self.FOUND}; expected {self.EXPECTED}")
        self.body = body


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


@dataclass(frozen=True)
class Body:
    """A point mass or a sphere that moves freely, without turning.

    Attributes:
        name: of the body.
        mass: > 0, kg.
        at: where its centre is at the start, at rest, m.
        radius: m.
    """

    name: str
    mass: float
    at: Point
    radius: float = 0.0


@dataclass(frozen=True)
class Obstacle:
    """A thing that stands still.

    Attributes:
        name: of the obstacle.
        shape: "wall" and "room" keep the spheres inside; "box", "sphere" and "capsule" keep them outside.
        points: of a wall a point and the normal towards the inside; of a room or a box the corners with the least and
            the greatest coordinates; of a capsule the ends of its axis; of a sphere its centre. m
        radius: of a sphere or a capsule, m; 0 for the others.
    """

    name: str
    shape: str
    points: tuple[Point, ...]
    radius: float = 0.0

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

    Raises:
        Falling: gravity would move a body down without end.
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

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        for problem in self._problems():
            raise ValueError(f"environment: {problem}")
        for body in self.bodies:
            if self.lowest_energy(body) == -math.inf:
                raise Falling(body.name)

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
            yield f"expected distinct names, none of them {GROUND!r}, found {names[:-1]}"
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
        for obstacle in self.obstacles:
            expected = {"wall": 2, "room": 2, "box": 2, "capsule": 2, "sphere": 1}.get(obstacle.shape)
            if expected != len(obstacle.points):
                yield f"obstacle {obstacle.name}: found the shape {obstacle.shape!r} with {len(obstacle.points)} points"
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
        masses = [body.mass for body in self.bodies]
        if not all(0.0 < mass < math.inf for mass in masses):
            yield f"found the masses {masses}; expected finite ones > 0"
        amounts = [thing.radius for thing in self.things] + [obstacle.radius for obstacle in self.obstacles]
        amounts += [amount for link in self.links for amount in (link.stiffness, link.damping)]
        stated = [self.surface, *(surface for _, surface in self.surfaces)]
        amounts += [amount for surface in stated for amount in surface]
        if not all(0.0 <= amount < math.inf for amount in amounts):
            yield "expected every radius, stiffness, damping and friction finite and >= 0"
        if any(surface.stiffness > STIFFEST for surface in stated):
            yield f"expected a contact's stiffness of at most {STIFFEST:g} N/m"
        if not all(math.isfinite(x) for x in self._coordinates()):
            yield "expected finite coordinates"

    def _coordinates(self) -> Iterator[float]:
        yield from self.gravity
        for thing in self.things:
            yield from thing.at
        for obstacle in self.obstacles:
            for point in obstacle.points:
                yield from point
        for link in self.links:
            yield from link.rest or ()

    @cached_property
    def points(self) -> Matrix:
        """The centres of the tools and then of the bodies at the start, P x 3, m."""
        return np.array([thing.at for thing in self.things], dtype=np.float64).reshape(-1, 3)

    @staticmethod
    def coordinates_of(body: Body) -> tuple[str, ...]:
        """The names of a body's coordinates x, y and z among the masses of a session."""
        return tuple(f"{body.name}.{axis}" for axis in "xyz")

    @property
    def bounds(self) -> tuple[Matrix, Matrix]:
        """The corners with the least and the greatest coordinates of all places that the scene names, m: centres at the
        start, corners, ends, and a point of each wall; the origin in an empty scene.
        """
        places = [thing.at for thing in self.things]
        places += [p for o in self.obstacles for p in (o.points[:1] if o.shape == "wall" else o.points)]
        found = np.array(places or [(0.0, 0.0, 0.0)], dtype=np.float64)
        return found.min(axis=0), found.max(axis=0)

    @property
    def geometry(self) -> ContactScene:
        """The scene without springs and gravity: its tools, bodies and obstacles, and how they touch.

        Two things that a spring joins have the stiffness 0 there, unless ``surfaces`` states otherwise.
        """
        joined = tuple((link.ends, UNTOUCHED) for link in self.links if GROUND not in link.ends)
        surfaces = (*self.surfaces, *joined)
        return ContactScene(
            self.ports, self.tools, self.bodies, self.obstacles, surface=self.surface, surfaces=surfaces
        )

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

    def pairs(self) -> Iterator[ContactPair]:
        """The pairs that may touch: two spheres, or a sphere and an obstacle; of a room one for each face."""
        things = self.things
        for (i, a), (j, b) in combinations(enumerate(things), 2):
            surface = self.surface_of(a.name, b.name)
            if surface.stiffness > 0.0 and a.radius + b.radius > 0.0:
                yield ContactPair((a.name, b.name), i, j, surface, a.radius + b.radius, "spheres")
        for i, a in enumerate(things):
            for obstacle in self.obstacles:
                names = (a.name, obstacle.name)
                surface = self.surface_of(*names)
                if surface.stiffness == 0.0:
                    continue
                if obstacle.shape in ("wall", "room"):
                    for face in obstacle.faces:
                        yield ContactPair(names, i, -1, surface, a.radius, "plane", face)
                elif obstacle.shape == "box":
                    yield ContactPair(names, i, -1, surface, a.radius, "box", obstacle.points)
                else:
                    ends = (obstacle.points[0], obstacle.points[-1])
                    yield ContactPair(names, i, -1, surface, a.radius + obstacle.radius, "capsule", ends)

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
            pressed = [(at, n) for at, n in obstacle.faces if float(W @ np.array(n)) < 0.0]
            if obstacle.shape == "wall" and pressed and np.cross(W, pressed[0][1]).any():
                continue  # gravity has a component along the wall
            total = 0.0 if pressed else -math.inf
            for at, n in pressed:
                unit = np.array(n) / math.hypot(*n)
                force = -float(W @ unit)
                total += force * (float(unit @ np.array(at)) + body.radius) - force * force / (2.0 * k)
            found.append(total)
        return max(found)

    @cached_property
    def energy_at_start(self) -> float:
        """A bound on the energy that the scene can give out from its start at rest, J, at least 0.

        It is that of height, of springs and of overlapping contacts, less the bound of :meth:`lowest_energy`.
        """
        springs = 0.0
        for link in self.links:
            strained = self.span_of(link, self.points) - self.rest_of(link)
            springs += 0.5 * link.stiffness * float(strained @ strained)
        height = sum(
            -body.mass * float(np.dot(self.gravity, body.at)) - self.lowest_energy(body) for body in self.bodies
        )
        return max(0.0, height + springs + self.contacts.energy(self.points))

    def terms(self) -> dict[str, Any]:
        """The scene as JSON values, by the keys of a certificate's ``environment``."""
        return {
            "type": "scene",
            "gravity": list(self.gravity),
            "tools": {
                tool.name: {
                    "ports": [self.ports[port] for port in tool.ports],
                    "axes": ["xyz"[axis] for axis in tool.axes],
                    "at": list(tool.at),
                    "radius": tool.radius,
                }
                for tool in self.tools
            },
            "bodies": {b.name: {"mass": b.mass, "at": list(b.at), "radius": b.radius} for b in self.bodies},
            "obstacles": {
                o.name: {"shape": o.shape, "points": [list(point) for point in o.points], "radius": o.radius}
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
        }

    def geometry_terms(self) -> dict[str, Any]:
        """Tools, bodies, obstacles and how they touch, as JSON values, with the names of the ports."""
        terms = self.terms()
        return {"ports": list(self.ports), **{key: terms[key] for key in _GEOMETRY}}


_XYZ: Final = {0, 1, 2}
_GEOMETRY: Final = ("tools", "bodies", "obstacles", "contact", "contacts")


def _point(data: Sequence[Any]) -> Point:
    x, y, z = (float(value) for value in data)
    return x, y, z


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
                tuple("xyz".index(axis) for axis in tool["axes"]),
                _point(tool["at"]),
                float(tool["radius"]),
            )
            for name, tool in data["tools"].items()
        ),
        bodies=tuple(
            Body(str(name), float(body["mass"]), _point(body["at"]), float(body["radius"]))
            for name, body in data["bodies"].items()
        ),
        obstacles=tuple(
            Obstacle(str(name), str(thing["shape"]), tuple(map(_point, thing["points"])), float(thing["radius"]))
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
    )


def geometry_of(data: Mapping[str, Any]) -> ContactScene:
    """The geometry that :meth:`ContactScene.geometry_terms` wrote.

    Raises:
        KeyError, TypeError, ValueError, OverflowError, AttributeError: a key is missing, or its value makes no scene.
    """
    return scene_of({**ContactScene(()).terms(), **{key: data[key] for key in _GEOMETRY}}, tuple(data["ports"]))
