"""What others do to render a wall, for :mod:`tests.deterministic.touch`; written anew from their documentation.

None has a coupling between device and world: the force follows from the measured position alone.

- :class:`Penalty`: a spring from the tool to the surface of each thing that it is in. So CHAI3D's surface effect does
  [CHAI3D2024]_; its examples take 0.7 or 0.8 of the stiffness that it states for the device.
- :class:`GodObject`: a spring to the nearest free position, in one step and without a test. The force of CHAI3D's
  finger proxy is this [CHAI3D2024]_, [Ruspini1997]_.
- :class:`MocapWeld`: MuJoCo's motion-capture body at the measured position, a free body that touches the world, and a
  weld between the two [MuJoCo2026]_. The hand receives the weld's force.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from manyhands.extras import explained
from tests.deterministic.touch import AVATAR, RADIUS, STONES, SURFACE, Floats, mujoco_model, nearest


class Penalty:
    """A spring in each thing."""

    def __init__(self, world: str, stiffness: float) -> None:
        """``stiffness``, N/m, of each."""
        self._world, self._K = world, stiffness

    def step(self, x: Floats) -> Floats:
        """The sum of the springs' forces, N."""
        if self._world == "wall":
            return [0.0, self._K * max(0.0, SURFACE - x[1])]
        force = np.zeros(2)
        for stone in STONES:
            away = np.subtract(x, stone)
            distance = float(np.hypot(*away))
            if 0.0 < distance < RADIUS:
                force += self._K * (RADIUS - distance) / distance * away
        found: Floats = force.tolist()
        return found


class GodObject:
    """A spring to the nearest free position."""

    def __init__(self, world: str, stiffness: float) -> None:
        """``stiffness``, N/m."""
        self._world, self._K = world, stiffness

    def step(self, x: Floats) -> Floats:
        """The spring's force, N."""
        return [self._K * (to - at) for to, at in zip(nearest(self._world, x), x, strict=True)]


STATED: Final = 2400.0
"""N/m; the stiffness of a penalty as documented: 0.8 of the 3000 N/m that CHAI3D states for a Novint Falcon."""

WELD: Final = 0.02
"""s; the time constant of a constraint where a model states none [MuJoCo2026]_."""

IMPEDANCE: Final = (0.9, 0.95)
"""Its impedance without and with a deflection, likewise: d, the part of the constraint's force against its own mass."""


class MocapWeld:
    """A motion-capture body and a weld."""

    def __init__(self, world: str, time_constant: float = WELD, impedance: tuple[float, float] = IMPEDANCE) -> None:
        """Weld with this time constant, s, of which MuJoCo's smallest is two steps, and this impedance."""
        with explained():
            import mujoco
        mocap = '<body name="hand" mocap="true"/>'
        least, most = impedance
        softness = f'solref="{time_constant} 1" solimp="{least} {most} 0.001"'
        weld = f'<equality><weld body1="hand" body2="pen" {softness}/></equality>'
        self._mujoco: Any = mujoco
        xml = mujoco_model(world, mocap + AVATAR).replace("<!-- more -->", weld)
        self._model: Any = mujoco.MjModel.from_xml_string(xml)
        self._data: Any = mujoco.MjData(self._model)
        self._rows = mujoco.mjtConstraint.mjCNSTR_EQUALITY

    def step(self, x: Floats) -> Floats:
        """The weld's force on the hand, N."""
        data, model = self._data, self._model
        data.mocap_pos[0, :2] = x
        self._mujoco.mj_step(model, data)
        rows = np.flatnonzero(data.efc_type == self._rows)
        jacobian = data.efc_J.reshape(-1, model.nv)
        force: Floats = (-(jacobian[rows].T @ data.efc_force[rows])).tolist()
        return force
