"""The messages that show an engine's world in three dimensions: its solids, in frames that its nodes report.

They are of the types of those of a scene (:mod:`manyhands.nodes.recorder.scene_messages`), at the same rates. The
world is what its engine has said of its start (:class:`manyhands.nodes.environment.drawing.WorldDrawing`). A frame is
moved by the axes of tools, which translate it or turn it about a line; or its position is reported, and perhaps its
orientation. A tool that a hand turns is turned as the environment has told that hand last.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.contacts import Point, coordinates
from manyhands.nodes.environment.drawing import Frame, Shape, Turn, WorldDrawing
from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, difference, product, unit
from manyhands.nodes.recorder.scene_messages import (
    BODY_COLOUR,
    OBSTACLE_COLOUR,
    TOOL_COLOUR,
    Pose,
    SpaceMessages,
    entity,
    quaternion,
    vector,
)
from manyhands.protocol.channels import (
    MASS_POSITION,
    ORIENTATION,
    PROPOSED_NAMES,
    QUATERNION_NAMES,
    TOLD,
    TOOL_POSITION,
)
from manyhands.protocol.messages import Values

ENDLESS: Final = 0.5
"""Half the side of what is drawn of a plane without an end, m."""

_THICKNESS: Final = 0.001  # half of that of a drawn plane, m

Vector = NDArray[np.float64]


def turned(turn: Turn, point: Sequence[float]) -> Point:
    """A point, turned about the origin."""
    R = Quaternion(*turn)
    _, x, y, z = difference(product(R, Quaternion(0.0, *point)), R)
    return x, y, z


def pose_of(frame: Frame, values: Sequence[float], by: Quaternion = UPRIGHT) -> Pose:
    """Where a frame is whose ports have these displacements, m or rad: each joint moves what is further out.

    Args:
        frame: of the drawing.
        values: of its ports, in their order.
        by: the rotation of its hand about its pivot, in the world's axes; nothing of a frame without one.
    """
    at, turn = frame.at, frame.turn
    if frame.pivot is not None:
        at = _plus(frame.pivot, turned(by, [a - b for a, b in zip(at, frame.pivot, strict=True)]))
        turn = product(by, Quaternion(*turn))
    for port, direction, value in reversed([*zip(frame.ports, frame.directions, values, strict=True)]):
        if (about := frame.axes.get(port)) is None:
            at = _plus(at, [value * part for part in direction])
            continue
        half = 0.5 * value
        spin = Quaternion(math.cos(half), *(math.sin(half) * part for part in direction))
        at = _plus(about, turned(spin, [a - b for a, b in zip(at, about, strict=True)]))
        turn = product(spin, Quaternion(*turn))
    return at, turn


def _plus(a: Sequence[float], b: Sequence[float]) -> Point:
    x, y, z = (one + other for one, other in zip(a, b, strict=True))
    return x, y, z


class EngineMessages(SpaceMessages):
    """Makes the messages of one session's engine from the telemetry of its environment."""

    def __init__(
        self,
        drawing: WorldDrawing,
        session: str,
        node: str,
        ports: tuple[str, ...],
        masses: tuple[str, ...],
        oriented: tuple[str, ...],
        tick_ns: float,
        hands: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
    ) -> None:
        """Find the columns of what moves.

        Args:
            drawing: the world.
            session: the session's name, which is that of the world's frame.
            node: the environment's name.
            ports: the columns of its tool positions.
            masses: the columns of its bodies' positions.
            oriented: the bodies whose orientations it reports.
            tick_ns: its period, ns.
            hands: the ports of each device whose orientation is a port, in the session's order.

        Raises:
            ValueError: a port or a body of the drawing has no column, a frame with a pivot has no hand, or a shape is
                too large for finite numbers.
        """
        self._drawing = drawing
        parts = [f"{body}.{part}" for body in oriented for part in QUATERNION_NAMES]
        self._moved = {
            name: [masses.index(one) for one in coordinates(name)]
            if frame.reported
            else [ports.index(port) for port in frame.ports]
            for name, frame in drawing.frames.items()
        }
        self._turned = {
            name: [parts.index(f"{name}.{part}") for part in QUATERNION_NAMES]
            for name, frame in drawing.frames.items()
            if frame.oriented
        }
        of_hands = [{*own} for own in hands.values()]
        self._told = {
            name: len(PROPOSED_NAMES) * of_hands.index({*frame.ports})
            for name, frame in drawing.frames.items()
            if frame.pivot is not None
        }
        self._by = dict.fromkeys(self._told, UPRIGHT)  # as it was told last
        shapes: dict[str, list[Shape]] = {}
        for shape in drawing.shapes:
            shapes.setdefault(shape.frame, []).append(shape)
        entities = [
            entity(name or "world", f"{session}/{name}" if name else session, **self._primitives(name, own))
            for name, own in shapes.items()
        ]
        super().__init__(session, node, tick_ns, entities)

    def _primitives(self, name: str, shapes: Sequence[Shape]) -> dict[str, Any]:
        colour = OBSTACLE_COLOUR if not name else TOOL_COLOUR if self._drawing.frames[name].ports else BODY_COLOUR
        out: dict[str, list[Any]] = {"cubes": [], "spheres": [], "cylinders": [], "triangles": []}
        for shape in shapes:
            for kind, solid in _solids(shape, colour):
                out[kind].append(solid)
        return out

    def poses(self, traces: Mapping[str, Values]) -> list[dict[str, Pose]] | None:
        """Where each frame is, tick by tick; None where the traces do not say it."""
        x_e, q, R, told = (traces.get(name) for name in (TOOL_POSITION, MASS_POSITION, ORIENTATION, TOLD))
        heard = any(frame.reported for frame in self._drawing.frames.values())
        if x_e is None or (heard and q is None) or (self._turned and R is None) or (self._told and told is None):
            return None
        out = []
        for row in range(len(x_e)):
            if told is not None:
                for name, first in self._told.items():
                    self._by[name] = unit(told[row, first : first + 4].tolist()) or self._by[name]
            out.append({name: self._pose(name, frame, row, x_e, q, R) for name, frame in self._drawing.frames.items()})
        return out

    def _pose(self, name: str, frame: Frame, row: int, x_e: Values, q: Values | None, R: Values | None) -> Pose:
        places = self._moved[name]
        if not frame.reported or q is None:
            return pose_of(frame, x_e[row, places].tolist(), self._by.get(name, UPRIGHT))
        x, y, z = q[row, places].tolist()
        if not frame.oriented or R is None:
            return (x, y, z), frame.turn
        parts = R[row, self._turned[name]].tolist()
        return (x, y, z), (parts[0], parts[1], parts[2], parts[3])


def _solids(shape: Shape, colour: Mapping[str, float]) -> list[tuple[str, dict[str, Any]]]:
    """A shape as Foxglove's primitives, each with its kind."""
    a, b, c = shape.size

    def solid(at: Sequence[float], size: Sequence[float]) -> dict[str, Any]:
        pose = {"position": vector(_plus(shape.at, turned(shape.turn, at))), "orientation": quaternion(shape.turn)}
        return {"pose": pose, "size": vector([2.0 * one for one in size]), "color": dict(colour)}

    middle = (0.0, 0.0, 0.0)
    match shape.shape:
        case "box":
            return [("cubes", solid(middle, (a, b, c)))]
        case "plane":
            return [("cubes", solid((0.0, 0.0, -_THICKNESS), (a or ENDLESS, b or ENDLESS, _THICKNESS)))]
        case "sphere" | "ellipsoid":
            return [("spheres", solid(middle, (a, b, c)))]
        case "cylinder" | "capsule":
            ends = [("spheres", solid((0.0, 0.0, end), (a, a, a))) for end in (-c, c)]
            round_ = [("cylinders", {**solid(middle, (a, b, c)), "bottom_scale": 1.0, "top_scale": 1.0})]
            return round_ + (ends if shape.shape == "capsule" else [])
        case _:
            surface = {
                "pose": {"position": vector(shape.at), "orientation": quaternion(shape.turn)},
                "points": [vector(point) for point in shape.points],
                "color": dict(colour),
                "colors": [],
                "indices": [corner for triangle in shape.triangles for corner in triangle],
            }
            return [("triangles", surface)]
