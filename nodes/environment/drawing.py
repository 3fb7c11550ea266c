"""What a physics engine has to say of its world so that it can be drawn: solids, in frames that move.

An engine that offers ``drawing()`` returns a :class:`WorldDrawing` of its start. A session shows it, and moves its
frames by what its nodes report anyway: the displacements of the tools, and the positions of the reported bodies, with
the orientations of those that are to be seen to turn.
Nothing of it is computed with. Whatever moves in a way that is not reported is not drawn, and is named instead: a
picture of a thing in a place where it is not would be worse than none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.contacts import Point
from manyhands.design.models.distance_grid import MOST_DRAWN
from manyhands.protocol.plain import Added

SHAPES: Final = ("box", "sphere", "capsule", "cylinder", "ellipsoid", "plane", "mesh")
"""The shapes of solids. The axis of a capsule or a cylinder is its own z, and so is the normal of a plane."""

MOST_SHAPES: Final = 2_000

Turn = tuple[float, float, float, float]
"""A rotation as a unit quaternion: its real part, and then its imaginary parts."""


@dataclass(frozen=True)
class Shape:
    """A solid in a frame.

    Attributes:
        frame: the name of a frame of the drawing; empty for what stands still.
        shape: one of :data:`SHAPES`.
        size: half of its extent along its own x, y and z, m: of a capsule or cylinder its radius twice, and half of the
            length of its axis; of a plane 0 along x or y where it has no end. Not used for a mesh.
        at: where its origin is in the frame, m.
        turn: how it is turned in the frame.
        points: of a mesh, m, from its origin; empty for the others.
        triangles: of a mesh: indices of points, which turn to the left seen from outside; empty for the others.
    """

    frame: str
    shape: str
    size: Point
    at: Point
    turn: Turn
    points: tuple[Point, ...] = ()
    triangles: tuple[tuple[int, int, int], ...] = ()


@dataclass(frozen=True)
class Frame:
    """What moves as one.

    Attributes:
        at: where it is at the start, m.
        turn: how it is turned at the start.
        ports: the ports of tools that move it, from the world outwards, each along its own direction or about it; empty
            for a body. Each moves what is further out with it.
        directions: of these ports at the start: unit vectors.
        reported: whether the position of its origin is reported under its name, as that of a body.
        turns: whether it may turn, which is not reported.
        axes: by port of those that turn it, a point of the axis at the start, m.
        oriented: whether its orientation is reported besides its position.
        pivot: of what a hand turns, a point about which it does, at the start, m; None where no hand does. The axes
            of its ports then translate it alone.
    """

    at: Point
    turn: Turn
    ports: tuple[str, ...] = ()
    directions: tuple[Point, ...] = ()
    reported: bool = False
    turns: bool = False
    axes: Added[Mapping[str, Point]] = field(default_factory=dict)
    oriented: Added[bool] = False
    pivot: Added[Point | None] = None


@dataclass(frozen=True)
class WorldDrawing:
    """A world in one frame of reference, m.

    Attributes:
        up: the axis that is drawn upwards, "y" or "z".
        frames: by name.
        shapes: the solids.
        hidden: bodies that are not drawn, since where they are is not reported.
        large: meshes that are not drawn, since they have more than :data:`.MOST_DRAWN` triangles.

    Raises:
        ValueError: a shape is of an unknown kind or frame, a number is not finite, or there are too many shapes.
    """

    up: str
    frames: Mapping[str, Frame]
    shapes: tuple[Shape, ...]
    hidden: Added[tuple[str, ...]] = ()
    large: Added[tuple[str, ...]] = ()

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Two corners between which the origins of frames, and of what stands still, are at the start, m."""
        standing = [shape.at for shape in self.shapes if not shape.frame]
        places = np.array([frame.at for frame in self.frames.values()] + standing or [(0.0, 0.0, 0.0)])
        return places.min(axis=0), places.max(axis=0)

    def __post_init__(self) -> None:
        if self.up not in ("y", "z"):
            raise ValueError(f"drawing.up: found {self.up!r}; expected y or z")
        if len(self.shapes) > MOST_SHAPES:
            raise ValueError(f"drawing.shapes: found {len(self.shapes)}; expected at most {MOST_SHAPES}")
        if sum(len(shape.triangles) for shape in self.shapes) > MOST_DRAWN:
            raise ValueError(f"drawing.shapes: found more than {MOST_DRAWN} triangles; expected at most as many")
        for place, shape in enumerate(self.shapes):
            corners = [corner for triangle in shape.triangles for corner in triangle]
            if shape.shape not in SHAPES or (shape.frame and shape.frame not in self.frames):
                raise ValueError(
                    f"drawing.shapes[{place}]: found a {shape.shape!r} in the frame {shape.frame!r}; expected one of "
                    f"{', '.join(SHAPES)} in one of {', '.join(self.frames)}"
                )
            if corners and not 0 <= min(corners) <= max(corners) < len(shape.points):
                raise ValueError(f"drawing.shapes[{place}]: found a triangle of no point")
            if not all(map(math.isfinite, (*shape.size, *shape.at, *shape.turn, *sum(shape.points, ())))):
                raise ValueError(f"drawing.shapes[{place}]: found a number that is not finite")
        for name, frame in self.frames.items():
            if len(frame.ports) != len(frame.directions):
                raise ValueError(f"drawing.frames.{name}: expected a direction for each port")
            if frame.pivot is not None and (frame.axes or not frame.ports):
                raise ValueError(f"drawing.frames.{name}: found a pivot; expected ports that translate it alone")
            if not frame.axes.keys() <= {*frame.ports}:
                raise ValueError(f"drawing.frames.{name}: found an axis of no port of it; expected those of its ports")
            points = (*frame.directions, *frame.axes.values(), frame.pivot or ())
            if not all(map(math.isfinite, (*frame.at, *frame.turn, *sum(points, ())))):
                raise ValueError(f"drawing.frames.{name}: found a number that is not finite")
