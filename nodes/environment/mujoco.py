"""MuJoCo as an engine: a model in MuJoCo's XML, in which each axis of a tool is a joint of an avatar: a slide joint
where the axis translates, a hinge joint where it turns. A tool that a hand turns in space has a ball joint besides.

The springs of the session stand between tools and avatars (:mod:`manyhands.nodes.environment.proxy`): they pull a tool
towards its avatar, and the avatar is pushed with the opposite force. So an avatar is a free body with a mass of its
own, and no motion is forced upon it. MuJoCo's own way, a motion-capture body with a weld, moves a body without regard
to what the motion costs.

The engine has no state but MuJoCo's, and gives the same numbers again for the same motion. It needs the extra
``mujoco``. A model that MuJoCo warns about, as for numbers that grow without bound, ends the session.

A model may come from a stranger, so it is compiled elsewhere (:mod:`manyhands.nodes.environment.mujoco_compiler`).
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.axis import AxisKind, Units, kinds_of
from manyhands.nodes.environment.drawing import WorldDrawing
from manyhands.nodes.environment.mjcf import ModelRefused, steps_of
from manyhands.nodes.environment.mujoco_compiler import compiled
from manyhands.nodes.environment.mujoco_drawing import drawing_of
from manyhands.nodes.environment.mujoco_library import import_mujoco
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.nodes.kernel.orientation import Quaternion, difference, product

Vector = NDArray[np.float64]

LIGHTEST = 4.0
"""The inertia of an avatar is at least this times K T^2: less, and its spring, whose force is held for T, throws it
about.

A mass on a spring with a force held for T is unstable from K T^2/m = 4 on; this leaves a factor of 16.
"""


class MujocoEngine:
    """An :class:`manyhands.nodes.environment.model.Engine` that steps a MuJoCo model.

    Attributes:
        advice: a sentence on each part of the model that works, and not well.
    """

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        """Read the model, and stand at its start.

        Args:
            ports: of the session.
            period: T, s; MuJoCo takes whole steps of at most the model's own timestep in it.
            parameters: ``model``, the XML; ``tools``, the joint of each port; ``bodies``, the names of the bodies whose
                positions are reported; ``stiffness``, the largest K at each port, N/m or N·m/rad. By default there are
                none of the others: ``avatars``, the ball joint of each tool that a hand turns; ``avatar_stiffness``, k
                of its spring, N·m/rad; ``turning``, the ports that turn; ``orientations``, those of the bodies whose
                orientations are reported, too; ``assets``, the files that the model names, by name, in base64.

        Raises:
            FactoryError: the model is refused; a joint, a body or an avatar's mass is not as expected; or MuJoCo is not
                installed, or not as expected.
        """
        try:
            mujoco = import_mujoco()
        except ImportError as error:
            raise FactoryError(str(error)) from error
        self._mujoco: Any = mujoco
        self._warnings: list[str] = []
        # without it MuJoCo writes a file into the current folder
        mujoco.set_mju_user_warning(self._warnings.append)
        assets = {name: base64.b64decode(file) for name, file in parameters.get("assets", {}).items()}
        try:
            self._model: Any = compiled(parameters["model"], assets, period)
        except ModelRefused as error:
            raise FactoryError(f"environment.model: {error}") from error
        model = self._model
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._steps = steps_of(float(model.opt.timestep), period)
        model.opt.timestep = period / self._steps
        joints = [self._id("JOINT", name) for name in parameters["tools"]]
        kinds = kinds_of(ports, parameters.get("turning", ()))
        self._require_types(joints, parameters["tools"], ports, kinds)
        self._names, self._oriented = [*parameters["bodies"]], [*parameters.get("orientations", ())]
        self._bodies = [self._id("BODY", name) for name in self._names]
        self._turned = [self._id("BODY", name) for name in self._oriented]
        self._tools = dict(zip(joints, ports, strict=True))
        self._places = np.array([model.jnt_qposadr[joint] for joint in joints])
        self._dofs = np.array([model.jnt_dofadr[joint] for joint in joints])
        self._data: Any = mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._start = self._data.qpos[self._places].copy()
        self._require_inertias(parameters["tools"], kinds, parameters["stiffness"], period)
        self._avatars = [self._id("JOINT", name) for name in parameters.get("avatars", ())]
        self.advice: list[str] = []
        for joint, k in zip(self._avatars, parameters.get("avatar_stiffness", ()), strict=True):
            self._require_avatar(joint, k, period)
            self.advice += self._advise(joint, k, period)
        self._avatar_bodies = [int(model.jnt_bodyid[joint]) for joint in self._avatars]
        self._upright = [Quaternion(*self._data.xquat[body].tolist()) for body in self._avatar_bodies]

    def _id(self, kind: str, name: str) -> int:
        found: int = self._mujoco.mj_name2id(self._model, getattr(self._mujoco.mjtObj, f"mjOBJ_{kind}"), name)
        if found < 0:
            raise FactoryError(f"found no {kind.lower()} {name!r} in the model; expected the names of the session")
        return found

    def _require_types(
        self, joints: Sequence[int], names: Sequence[str], ports: Sequence[str], kinds: Sequence[AxisKind]
    ) -> None:
        types = self._mujoco.mjtJoint
        words = {types.mjJNT_SLIDE: "slide", types.mjJNT_HINGE: "hinge", types.mjJNT_BALL: "ball"}
        expected = {AxisKind.TRANSLATION: "slide", AxisKind.ROTATION: "hinge"}
        for joint, name, port, kind in zip(joints, names, ports, kinds, strict=True):
            found = words.get(int(self._model.jnt_type[joint]), "free")
            if found != expected[kind]:
                raise FactoryError(
                    f"found a {found} joint {name!r} for the port {port!r}, whose axis is a {kind}; "
                    f"expected a {expected[kind]} joint"
                )
            if joints.count(joint) > 1:
                raise FactoryError(f"found the joint {name!r} for two axes; expected a joint of its own for each axis")

    def _require_inertias(
        self, names: Sequence[str], kinds: Sequence[AxisKind], stiffness: Sequence[float], period: float
    ) -> None:
        # 1/m at each joint: the diagonal of the inverse of the mass matrix
        inverse = np.zeros((1, self._model.nv))
        for name, kind, dof, K in zip(names, kinds, self._dofs, stiffness, strict=True):
            unit = np.zeros((1, self._model.nv))
            unit[0, dof] = 1.0
            self._mujoco.mj_solveM(self._model, self._data, inverse, unit)
            inertia, least, units = 1.0 / inverse[0, dof], LIGHTEST * K * period**2, Units.of([kind])
            if not inertia >= least:
                kg = units("kg")
                raise FactoryError(
                    f"found an avatar of {inertia:.3g} {kg} at the joint {name!r}; expected at least {least:.3g} {kg} "
                    f"for a stiffness of {K:g} {units('N/m')}"
                )

    def _require_avatar(self, joint: int, k: float, period: float) -> None:
        """Require a ball joint that nothing turns but itself, and an avatar that is heavy enough for its spring."""
        model, types = self._model, self._mujoco.mjtJoint
        name = self._mujoco.mj_id2name(model, self._mujoco.mjtObj.mjOBJ_JOINT, joint)
        if model.jnt_type[joint] != types.mjJNT_BALL:
            raise FactoryError(f"found a joint {name!r} of another type for an orientation; expected a ball joint")
        own = body = int(model.jnt_bodyid[joint])
        while body:
            first, number = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            others = [at for at in range(first, first + number) if at != joint]
            if any(model.jnt_type[at] != types.mjJNT_SLIDE or (body == own and at > joint) for at in others):
                raise FactoryError(
                    f"found a joint beside or above the ball joint {name!r} that is no slide joint before it; expected "
                    "slide joints alone, so that nothing else turns the avatar"
                )
            body = int(model.body_parentid[body])
        first = int(model.jnt_dofadr[joint])
        units, inverse = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        units[range(3), range(first, first + 3)] = 1.0
        self._mujoco.mj_solveM(model, self._data, inverse, units)
        inertia = 1.0 / float(np.linalg.eigvalsh(inverse[:, first : first + 3])[-1])
        least = LIGHTEST * k * period**2
        if not inertia >= least:
            raise FactoryError(
                f"found an avatar of {inertia:.3g} kg·m² about its lightest axis at the ball joint {name!r}; expected "
                f"at least {least:.3g} kg·m² for a stiffness of {k:g} N·m/rad"
            )

    def _advise(self, joint: int, k: float, period: float) -> list[str]:
        """Advise a greater damping of a ball joint at which the avatar swings up by itself.

        A torque that is held for T is T/2 old on average, and so takes k T/2 of the joint's damping. MuJoCo's
        semi-implicit steps of dt give back half a step's worth of it; those of Runge and Kutta do not. Just above that
        a swing lasts, and with k T it is gone soon.
        """
        model, mujoco = self._model, self._mujoco
        found = float(model.dof_damping[model.jnt_dofadr[joint]])
        explicit = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        age = period if explicit else period - float(model.opt.timestep)
        if found >= 0.5 * k * age * (1.0 - 1e-9):  # both are products of rounded decimals
            return []
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        return [
            f"found a damping of {found:.3g} N·m·s/rad at the ball joint {name!r}, by which its tool swings up by "
            f"itself beside a hand that holds still; expected {k * period:.3g} N·m·s/rad (k T) or more"
        ]

    def turn(self, torques: Vector) -> None:
        """Turn the avatars by these torques over the next step, N·m, three numbers in the world's axes for each."""
        self._data.xfrc_applied[self._avatar_bodies, 3:] = np.reshape(torques, (-1, 3))

    def avatars(self) -> list[float]:
        """For each avatar the unit quaternion by which it is turned from where it began, in the world's axes."""
        found: list[float] = []
        for joint, start in zip(self._avatars, self._upright, strict=True):
            at = int(self._model.jnt_qposadr[joint])
            own = Quaternion(*self._data.qpos[at : at + 4].tolist())
            found += difference(product(start, own), start)
        return found

    def step(self, x: Vector, f: Vector) -> Vector:
        """The avatars' positions after one period, m or rad, from where each began; pushed by -f, N or N·m."""
        data = self._data
        data.qfrc_applied[self._dofs] = -f
        self._mujoco.mj_step(self._model, data, self._steps)
        if self._warnings:
            raise RuntimeError(f"MuJoCo warns: {self._warnings[0]}")
        return np.asarray(data.qpos[self._places] - self._start, dtype=np.float64)

    def drawing(self) -> WorldDrawing:
        """What the model looks like where it stands, to be asked for before the first step."""
        bodies = dict(zip(self._bodies, self._names, strict=True))
        return drawing_of(self._mujoco, self._model, self._data, self._tools, bodies, self._oriented, self._avatars)

    def positions(self) -> list[float]:
        """x, y and z of each reported body, m, at the beginning of MuJoCo's latest step."""
        found: list[float] = self._data.xpos[self._bodies].ravel().tolist()
        return found

    def orientations(self) -> list[float]:
        """The unit quaternion of each body whose orientation is reported, at that instant, too."""
        found: list[float] = self._data.xquat[self._turned].ravel().tolist()
        return found
