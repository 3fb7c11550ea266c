"""What a MuJoCo model looks like: its geoms, by the frames in which they move (:mod:`.drawing`).

Bodies without a joint between them move as one. Such a group is moved by the joints of tools between it and the world,
perhaps with a ball joint by which a hand turns it, or it is reported as a body, or it does not move at all; every other
group is left out and named.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.contacts import Point
from manyhands.design.models.distance_grid import MOST_DRAWN
from manyhands.nodes.environment.drawing import SHAPES, Frame, Shape, Turn, WorldDrawing

_WORLD: Final = 0  # the id of the body that does not move

_LAST_VISIBLE_GROUP: Final = 2
"""MuJoCo's own viewer hides the geoms of later groups, where models keep what only collides."""

_PARALLEL: Final = 1.0 - 1e-6
_ON_AXIS: Final = 1e-6  # m

Vector = NDArray[np.float64]


def drawing_of(
    mujoco: Any,
    model: Any,
    data: Any,
    tools: Mapping[int, str],
    bodies: Mapping[int, str],
    oriented: Collection[str] = (),
    avatars: Collection[int] = (),
) -> WorldDrawing:
    """The drawing of a model at its start.

    Args:
        mujoco: the module.
        model: a compiled model.
        data: its state at the start.
        tools: the port of each joint that is an axis of a tool, by the joint's id.
        bodies: the name of each reported body, by its id.
        oriented: the names of those whose orientations are reported, too.
        avatars: the ids of the ball joints by which hands turn tools.
    """
    return _Drawn(mujoco, model, data, tools, bodies, oriented, avatars).drawing()


class _Drawn:
    def __init__(
        self,
        mujoco: Any,
        model: Any,
        data: Any,
        tools: Mapping[int, str],
        bodies: Mapping[int, str],
        oriented: Collection[str],
        avatars: Collection[int],
    ) -> None:
        self._mujoco, self._model, self._data = mujoco, model, data
        self._tools, self._bodies, self._oriented = tools, bodies, frozenset(oriented)
        self._avatars = frozenset(avatars)
        self._shapes = {int(getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")): shape for shape in SHAPES}
        self._left, self._large = MOST_DRAWN, list[str]()

    def drawing(self) -> WorldDrawing:
        frames, names, hidden = dict[str, Frame](), dict[int, tuple[str, int]](), list[str]()
        groups: dict[int, list[int]] = {}
        for geom in range(self._model.ngeom):
            if self._model.geom_group[geom] <= _LAST_VISIBLE_GROUP and self._shape_of(geom):
                groups.setdefault(int(self._model.body_weldid[self._model.geom_bodyid[geom]]), []).append(geom)
        reported = {int(self._model.body_weldid[body]): body for body in self._bodies}
        for group in {**groups, **dict.fromkeys(self._groups_of_tools())}:
            joints = [*self._joints(group)]
            if not joints:
                continue  # it stands still
            body = reported.get(group, group)
            ports = {self._tools[joint]: joint for joint in reversed(joints) if joint in self._tools}
            name = self._bodies.get(body) or self._name("BODY", body)
            if joints[0] in self._avatars and len(ports) == len(joints) - 1:
                names[group] = name, group
                frames[name] = self._turned(group, ports, joints[0])
                continue
            if group not in reported and len(ports) < len(joints):
                hidden.append(name)
                groups.pop(group, None)
                continue
            names[group] = name, body
            known = group in reported
            frames[name] = Frame(
                *self._pose(self._data.xpos[body], self._data.xmat[body]),
                () if known else tuple(ports),
                () if known else tuple(_point(self._data.xaxis[joint]) for joint in ports.values()),
                known,
                known and name not in self._oriented and any(self._turns(j, groups.get(group, [])) for j in joints),
                {}
                if known
                else {port: _point(self._data.xanchor[j]) for port, j in ports.items() if self._is_hinge(j)},
                name in self._oriented,
            )
        shapes = [
            shape
            for group, geoms in groups.items()
            for geom in geoms
            for shape in self._shape(geom, *names.get(group, ("", _WORLD)))
        ]
        return WorldDrawing("z", frames, tuple(shapes), tuple(hidden), tuple(self._large))

    def _turned(self, body: int, ports: Mapping[str, int], ball: int) -> Frame:
        """The frame of a tool that its hand turns, whether it is reported as a body besides or not."""
        pose = self._pose(self._data.xpos[body], self._data.xmat[body])
        directions = tuple(_point(self._data.xaxis[joint]) for joint in ports.values())
        return Frame(*pose, tuple(ports), directions, pivot=_point(self._data.xanchor[ball]))

    def _shape_of(self, geom: int) -> str:
        """The shape of a geom; empty for a kind that is not drawn, as a height field."""
        return self._shapes.get(int(self._model.geom_type[geom]), "")

    def _groups_of_tools(self) -> Iterator[int]:
        for joint in self._tools:
            yield int(self._model.body_weldid[self._model.jnt_bodyid[joint]])

    def _name(self, kind: str, number: int) -> str:
        found = self._mujoco.mj_id2name(self._model, getattr(self._mujoco.mjtObj, f"mjOBJ_{kind}"), number)
        return found or f"{kind.lower()} {number}"

    def _joints(self, body: int) -> Iterator[int]:
        """The joints between a body and the world, the nearest first."""
        while body != _WORLD:
            first, count = int(self._model.body_jntadr[body]), int(self._model.body_jntnum[body])
            yield from reversed(range(first, first + count))
            body = int(self._model.body_parentid[body])

    def _is_hinge(self, joint: int) -> bool:
        return bool(self._model.jnt_type[joint] == self._mujoco.mjtJoint.mjJNT_HINGE)

    def _turns(self, joint: int, geoms: list[int]) -> bool:
        """Whether a joint turns these geoms so that it can be seen: not about an axis about which all are round."""
        if self._model.jnt_type[joint] == self._mujoco.mjtJoint.mjJNT_SLIDE:
            return False
        if not self._is_hinge(joint):
            return bool(geoms)
        axis, anchor = self._data.xaxis[joint], self._data.xanchor[joint]
        return not all(self._is_round(geom, axis, anchor) for geom in geoms)

    def _is_round(self, geom: int, axis: Vector, anchor: Vector) -> bool:
        shape, (a, b, _) = self._shape_of(geom), self._model.geom_size[geom]
        away = self._data.geom_xpos[geom] - anchor
        own = self._data.geom_xmat[geom].reshape(3, 3)[:, 2]
        round_about_own = shape in ("capsule", "cylinder") or (shape == "ellipsoid" and a == b)
        along = round_about_own and abs(float(own @ axis)) > _PARALLEL
        return bool(np.linalg.norm(away - (away @ axis) * axis) < _ON_AXIS) and (shape == "sphere" or along)

    def _pose(self, at: Vector, matrix: Vector) -> tuple[Point, Turn]:
        turn = np.zeros(4)
        self._mujoco.mju_mat2Quat(turn, np.ascontiguousarray(matrix).ravel())
        w, x, y, z = turn.tolist()
        return _point(at), (w, x, y, z)

    def _shape(self, geom: int, frame: str, body: int) -> Iterator[Shape]:
        """A geom in its frame, whose origin and axes are those of ``body`` at the start."""
        model, data = self._model, self._data
        origin, axes = (np.zeros(3), np.eye(3)) if not frame else (data.xpos[body], data.xmat[body].reshape(3, 3))
        pose = self._pose(axes.T @ (data.geom_xpos[geom] - origin), axes.T @ data.geom_xmat[geom].reshape(3, 3))
        shape, (a, b, c) = self._shape_of(geom), model.geom_size[geom].tolist()
        size = {"sphere": (a, a, a), "capsule": (a, a, b), "cylinder": (a, a, b)}.get(shape, (a, b, c))
        if shape != "mesh":
            yield Shape(frame, shape, size, *pose)
            return
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        if faces > self._left or count > 3 * MOST_DRAWN:
            self._large.append(self._name("MESH", mesh))
            return
        self._left -= faces
        points = tuple(map(_point, model.mesh_vert[first : first + count]))
        triangles = tuple((i, j, k) for i, j, k in model.mesh_face[face : face + faces].tolist())
        yield Shape(frame, shape, size, *pose, points, triangles)


def _point(values: Vector) -> Point:
    x, y, z = values.tolist()
    return x, y, z
