"""The messages that show a scene in three dimensions: Foxglove's ``SceneUpdate`` and ``FrameTransforms``, as JSON.

A 3-D panel draws the entities of a ``SceneUpdate``. Each tool and each body is an entity in a frame of its own, and
``FrameTransforms`` say where these frames are ([Foxglove2026]_). So the shapes are sent once a second, and the
positions :data:`UPDATES_PER_SECOND` times a second. A position is that of the session file plus the displacement that
the environment reports, in the frame with the session's name.

The same messages are made for a recording and for a live connection, from the ticks alone.
"""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.contacts import Point, coordinates
from manyhands.design.models.scene import ContactScene, Obstacle
from manyhands.nodes.environment.drawing import Turn
from manyhands.protocol.channels import MASS_POSITION, TOOL_POSITION
from manyhands.protocol.messages import Values

SCENE: Final = "scene"
"""The topic of the shapes, at the environment: ``foxglove.SceneUpdate``."""

TRANSFORMS: Final = "transforms"
"""The topic of the positions, at the environment: ``foxglove.FrameTransforms``."""

POSE: Final = "pose"
"""The topic of how a hand has turned its device, at the device: ``foxglove.PoseInFrame``."""

UPDATES_PER_SECOND: Final = 20
"""The most positions of a thing in a second of the session's time."""

_SCENE_EVERY: Final = 20  # positions: once a second, for viewers that connect later

DRAWN_RADIUS: Final = 0.003
"""The radius of the sphere that stands for a point, m."""

_THICKNESS: Final = 0.002  # of a drawn wall, m
_LEAST_SIDE: Final = 0.2  # of a drawn wall, m


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": [*properties]}


def _list(items: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_TEXT: Final = {"type": "string"}
_NUMBER: Final = {"type": "number"}
_SECONDS: Final = {"type": "integer"}
_NANOSECONDS: Final = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
_TIME: Final = {"title": "time", **_object(sec={**_SECONDS, "minimum": 0}, nsec=_NANOSECONDS)}
_DURATION: Final = {"title": "duration", **_object(sec=_SECONDS, nsec=_NANOSECONDS)}
_VECTOR: Final = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION: Final = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE: Final = _object(position=_VECTOR, orientation=_QUATERNION)
_COLOUR: Final = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_SOLID: Final = _object(pose=_POSE, size=_VECTOR, color=_COLOUR)
_CYLINDER: Final = _object(pose=_POSE, size=_VECTOR, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOUR)
_TRIANGLES: Final = _object(
    pose=_POSE, points=_list(_VECTOR), color=_COLOUR, colors=_list(_COLOUR), indices=_list({"type": "integer"})
)
_EMPTY: Final = _list({"type": "object", "properties": {}})  # of kinds that no scene has

_ENTITY: Final = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked={"type": "boolean"},
    metadata=_list(_object(key=_TEXT, value=_TEXT)),
    arrows=_EMPTY,
    cubes=_list(_SOLID),
    spheres=_list(_SOLID),
    cylinders=_list(_CYLINDER),
    lines=_EMPTY,
    triangles=_list(_TRIANGLES),
    texts=_EMPTY,
    models=_EMPTY,
)
_TRANSFORM: Final = _object(
    timestamp=_TIME, parent_frame_id=_TEXT, child_frame_id=_TEXT, translation=_VECTOR, rotation=_QUATERNION
)


def _schema(name: str, **properties: Any) -> tuple[str, str]:
    return name, json.dumps({"title": name, **_object(**properties)})


SCENE_SCHEMAS: Final[Mapping[str, tuple[str, str]]] = {
    SCENE: _schema("foxglove.SceneUpdate", deletions=_EMPTY, entities=_list(_ENTITY)),
    TRANSFORMS: _schema("foxglove.FrameTransforms", transforms=_list(_TRANSFORM)),
}
"""Name and text of the JSON schema of each topic: Foxglove's names, keys and types, of what a scene has."""

POSE_SCHEMA: Final = _schema("foxglove.PoseInFrame", timestamp=_TIME, frame_id=_TEXT, pose=_POSE)
"""The same of the topic :data:`POSE`."""


def every_of(tick_ns: float) -> int:
    """Of so many ticks, of this period in ns, one has a position: :data:`UPDATES_PER_SECOND` at most."""
    return max(1, math.ceil(round(1e9 / UPDATES_PER_SECOND / tick_ns, 9)))


class SceneMessage(NamedTuple):
    """One message.

    Attributes:
        topic: :data:`SCENE`, :data:`TRANSFORMS` or :data:`POSE`.
        tick: the node's.
        time: of the tick, ns since 1970.
        data: its JSON.
    """

    topic: str
    tick: int
    time: int
    data: bytes


Pose = tuple[Point, Turn]
"""A place, m, and how a thing is turned there, a unit quaternion whose real part is first."""


class SpaceMessages(ABC):
    """Makes the messages of what is in a session's space from the telemetry of its environment.

    Attributes:
        node: the environment's name.
        topics: those of its messages.
    """

    topics: Final = (SCENE, TRANSFORMS)

    def __init__(self, session: str, node: str, tick_ns: float, shapes: Sequence[Mapping[str, Any]]) -> None:
        """Keep the shapes.

        Args:
            session: the session's name, which is that of the frame that stands still.
            node: the environment's name.
            tick_ns: its period, ns.
            shapes: the entities, without their time, in the frame of the session or in frames of their own.

        Raises:
            ValueError: a shape is too large for finite numbers.
        """
        self.node, self._frame, self._tick_ns, self._shapes = node, session, tick_ns, shapes
        self._every = every_of(tick_ns)
        self._update(0)  # fails where a shape has no finite size

    @abstractmethod
    def poses(self, traces: Mapping[str, Values]) -> Sequence[Mapping[str, Pose]] | None:
        """Where each thing is, by name, tick by tick; None where the traces do not say it.

        Args:
            traces: of the environment's telemetry.
        """

    def of(
        self, tick: int, traces: Mapping[str, Values], start: int, topics: Collection[str] = (SCENE, TRANSFORMS)
    ) -> Iterator[SceneMessage]:
        """The messages of one piece of telemetry, in the order of their ticks.

        Args:
            tick: the one after the last row.
            traces: of the environment, with as many columns as the session has.
            start: the time of tick 0, ns since 1970.
            topics: those whose messages are wanted.
        """
        rows = max((len(trace) for trace in traces.values()), default=0)
        kept = range((rows - tick) % self._every, rows, self._every)
        poses = self.poses({name: trace[kept.start :: self._every] for name, trace in traces.items()})
        if poses is None:
            return
        for row, now in zip(kept, poses, strict=True):
            k = tick - rows + row
            time = start + round(k * self._tick_ns)
            if SCENE in topics and k % (self._every * _SCENE_EVERY) == 0:
                yield SceneMessage(SCENE, k, time, self._update(time))
            if TRANSFORMS in topics:
                yield SceneMessage(TRANSFORMS, k, time, self._transforms(time, now))

    def _update(self, time: int) -> bytes:
        entities = [{"timestamp": stamp(time), **shape} for shape in self._shapes]
        return json.dumps({"deletions": [], "entities": entities}, allow_nan=False).encode()

    def _transforms(self, time: int, poses: Mapping[str, Pose]) -> bytes:
        """The frames of all things whose pose is finite."""
        at_time = stamp(time)
        transforms = [
            {
                "timestamp": at_time,
                "parent_frame_id": self._frame,
                "child_frame_id": f"{self._frame}/{name}",
                "translation": vector(at),
                "rotation": quaternion(turn),
            }
            for name, (at, turn) in poses.items()
            if all(map(math.isfinite, (*at, *turn)))
        ]
        return json.dumps({"transforms": transforms}, allow_nan=False).encode()


class SceneMessages(SpaceMessages):
    """Makes the messages of one session's scene."""

    def __init__(
        self,
        scene: ContactScene,
        session: str,
        node: str,
        ports: tuple[str, ...],
        masses: tuple[str, ...],
        tick_ns: float,
    ) -> None:
        """Find the columns of the scene's coordinates.

        Args:
            scene: its geometry is enough.
            session: the session's name, which is that of the scene's frame.
            node: the environment's name.
            ports: the columns of its tool positions.
            masses: the columns of its masses' positions.
            tick_ns: its period, ns.

        Raises:
            ValueError: a port or a body of the scene has no column, or a shape is too large for finite numbers.
        """
        self._scene = scene
        moved = [
            (point, axis, scene.ports[port])
            for point, tool in enumerate(scene.tools)
            for port, axis in zip(tool.ports, tool.axes, strict=True)
        ]
        free = [
            (point, axis, name)
            for point, body in enumerate(scene.bodies, len(scene.tools))
            for axis, name in enumerate(coordinates(body.name))
        ]
        self._moved, self._free = _columns(moved, ports), _columns(free, masses)
        super().__init__(session, node, tick_ns, [*self._moving(session), *self._standing(session)])

    def _moving(self, session: str) -> Iterator[dict[str, Any]]:
        """The entities of tools and bodies, without their time."""
        tools = len(self._scene.tools)
        for point, thing in enumerate(self._scene.things):
            colour = TOOL_COLOUR if point < tools else BODY_COLOUR
            core = thing.core
            radius = thing.radius if thing.radius or core.kind == "box" else DRAWN_RADIUS
            drawn = _box(core.ends, colour) if core.kind == "box" else _capsule(core.ends, radius, colour)
            yield entity(thing.name, f"{session}/{thing.name}", **drawn)

    def _standing(self, session: str) -> Iterator[dict[str, Any]]:
        """The entities of obstacles, without their time."""
        low, high = self._scene.bounds
        for obstacle in self._scene.obstacles:
            yield entity(obstacle.name, session, **_primitives(obstacle, low, high))

    def positions(self, traces: Mapping[str, Values]) -> NDArray[np.float64] | None:
        """Where tools and then bodies are, ticks x P x 3, m; None where the traces do not say it.

        Args:
            traces: of the environment's telemetry, x_e and, with bodies, q.
        """
        x_e, q = traces.get(TOOL_POSITION), traces.get(MASS_POSITION)
        if x_e is None or (self._scene.bodies and q is None):
            return None
        points = np.repeat(self._scene.points[None], len(x_e), axis=0)
        for (rows, axes, columns), values in ((self._moved, x_e), (self._free, q)):
            if values is not None and len(columns):
                points[:, rows, axes] += values[:, columns]
        return points

    def poses(self, traces: Mapping[str, Values]) -> Sequence[Mapping[str, Pose]] | None:
        """Where tools and then bodies are, which never turn."""
        points = self.positions(traces)
        if points is None:
            return None
        names = [thing.name for thing in self._scene.things]
        return [
            {name: ((x, y, z), _NO_TURN) for name, (x, y, z) in zip(names, now, strict=True)} for now in points.tolist()
        ]


_Columns = tuple[list[int], list[int], list[int]]


def _columns(coordinates: list[tuple[int, int, str]], names: tuple[str, ...]) -> _Columns:
    """Point, axis and column of each coordinate."""
    return (
        [point for point, _, _ in coordinates],
        [axis for _, axis, _ in coordinates],
        [names.index(name) for _, _, name in coordinates],
    )


_NO_TURN: Final = (1.0, 0.0, 0.0, 0.0)
_UPRIGHT: Final = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
TOOL_COLOUR: Final = {"r": 0.12, "g": 0.47, "b": 0.71, "a": 1.0}
BODY_COLOUR: Final = {"r": 0.84, "g": 0.3, "b": 0.16, "a": 1.0}
OBSTACLE_COLOUR: Final = {"r": 0.6, "g": 0.6, "b": 0.6, "a": 0.8}
_ENCLOSING_COLOUR: Final = {"r": 0.6, "g": 0.6, "b": 0.6, "a": 0.2}  # of walls and rooms, behind which things are


def stamp(time: int) -> dict[str, int]:
    """A time, ns since 1970, as Foxglove has it."""
    seconds, nanoseconds = divmod(time, 10**9)
    return {"sec": seconds, "nsec": nanoseconds}


def quaternion(turn: Turn) -> dict[str, float]:
    """A rotation as Foxglove has it."""
    return dict(zip("wxyz", turn, strict=True))


def vector(values: Collection[float]) -> dict[str, float]:
    """A vector, likewise."""
    return dict(zip("xyz", map(float, values), strict=True))


def pose_shown(at: Collection[float], turn: Turn) -> dict[str, Any]:
    """A pose, likewise."""
    return {"position": vector(at), "orientation": quaternion(turn)}


def entity(name: str, frame: str, **primitives: Any) -> dict[str, Any]:
    """An entity that stays until it is replaced and moves with its frame."""
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        **{kind: [] for kind in kinds},
        **primitives,
    }


def _solid(
    at: Collection[float],
    size: Collection[float],
    colour: Mapping[str, float],
    orientation: Mapping[str, float] = _UPRIGHT,
) -> dict[str, Any]:
    return {
        "pose": {"position": vector(at), "orientation": orientation},
        "size": vector(size),
        "color": colour,
    }


def _turned(direction: NDArray[np.float64]) -> dict[str, float]:
    """The rotation that turns the z axis to a unit vector, as a quaternion."""
    x, y, z = direction.tolist()
    if 1.0 + z < 1e-12:
        return {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}
    length = math.sqrt(2.0 * (1.0 + z))
    return {"x": -y / length, "y": x / length, "z": 0.0, "w": (1.0 + z) / length}


def _primitives(obstacle: Obstacle, low: NDArray[np.float64], high: NDArray[np.float64]) -> dict[str, Any]:
    """The primitives of an obstacle in a scene with the corners ``low`` and ``high``, m."""
    match obstacle.shape:
        case "wall":
            at, normal = obstacle.points
            return {"cubes": [_wall(at, np.array(normal), low, high)]}
        case "room" | "box":
            colour = _ENCLOSING_COLOUR if obstacle.shape == "room" else OBSTACLE_COLOUR
            return _box(obstacle.points, colour)
        case "mesh":
            surface = {
                "pose": {"position": vector((0.0, 0.0, 0.0)), "orientation": _UPRIGHT},
                "points": [vector(point) for point in obstacle.points],
                "color": {**OBSTACLE_COLOUR, "a": 1.0},
                "colors": [],
                "indices": [corner for triangle in obstacle.triangles for corner in triangle],
            }
            return {"triangles": [surface]}
        case _:
            return _capsule(obstacle.core.ends, obstacle.radius, OBSTACLE_COLOUR)


def _box(corners: tuple[Point, ...], colour: Mapping[str, float]) -> dict[str, Any]:
    """The primitives of a box with these corners, m."""
    points = np.array(corners, dtype=np.float64)
    return {"cubes": [_solid(points.mean(axis=0), points[1] - points[0], colour)]}


def _capsule(ends: tuple[Point, Point], radius: float, colour: Mapping[str, float]) -> dict[str, Any]:
    """The primitives of a capsule, or of a sphere where both ends are one point, m."""
    points = np.array(ends, dtype=np.float64)
    axis = points[1] - points[0]
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return {"spheres": [_solid(points[0], (2.0 * radius,) * 3, colour)]}
    size = (2.0 * radius, 2.0 * radius, length)
    cylinder = _solid(points.mean(axis=0), size, colour, _turned(axis / length))
    return {
        "spheres": [_solid(point, (2.0 * radius,) * 3, colour) for point in points],
        "cylinders": [{**cylinder, "bottom_scale": 1.0, "top_scale": 1.0}],
    }


def _wall(at: Point, normal: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> Any:
    """A thin square in place of the half-space behind a wall, beside the middle of the scene."""
    n = normal / np.linalg.norm(normal)
    middle = (low + high) / 2.0
    foot = middle - float(n @ (middle - np.array(at))) * n
    side = _LEAST_SIDE + 2.0 * float(np.linalg.norm(high - low))
    return _solid(foot - 0.5 * _THICKNESS * n, (side, side, _THICKNESS), _ENCLOSING_COLOUR, _turned(n))
