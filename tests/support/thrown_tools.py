"""Models of MuJoCo in which two tools are thrown at a body in a room: it turns by contact, whatever it hangs on.

The tools translate along x, y and z, and with ``turns`` have a ball joint as well and are no balls themselves. The
names of their joints are ``a_x`` ... ``b_z``, ``a_turn`` and ``b_turn``, that of the body is ``thing``.
"""

from __future__ import annotations

from typing import Final

STARTS: Final = {"a": -0.06, "b": 0.06}
"""m, along x."""

ROOM: Final = "".join(
    f'<geom type="plane" size="1 1 1" pos="{0.1 * x} {0.1 * y} {0.1 * z}" zaxis="{-x} {-y} {-z}"/>'
    for x, y, z in [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
)
"""Six walls, 100 mm from the middle."""

BODIES: Final = {
    "free": '<body name="thing"><freejoint/>{shape}</body>',
    "ball": '<body name="thing"><joint type="ball" damping="0.0001"/>{shape}</body>',
    "hinge on free": '<body name="thing"><freejoint/>{shape}<body pos="0 0 0.03"><joint type="hinge" axis="1 0 0"/>'
    '<geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.006" mass="0.03"/></body></body>',
}
SHAPES: Final = {
    "box": '<geom type="box" size="0.03 0.02 0.01" mass="0.1"/>',
    "dumb-bell": '<geom size="0.015" pos="-0.03 0 0" mass="0.06"/><geom size="0.015" pos="0.03 0 0" mass="0.06"/>'
    '<geom type="cylinder" size="0.006 0.03" euler="0 90 0" mass="0.02"/>',
}
CARES: Final = {
    "careful": ('timestep="0.0005" integrator="implicitfast" cone="elliptic" gravity="0 0 0"', 'solref="0.004 1"'),
    "careless": ('timestep="0.001" integrator="Euler" iterations="3" gravity="0 0 -9.81"', 'solref="-2e5 0"'),
}
"""Options of an engine, and of its contacts: a careless one loads its tools, and its contacts give out energy."""

_BALL: Final = '<geom size="0.01" mass="0.05"/>'
_STICK: Final = (
    '<geom type="box" size="0.025 0.008 0.008" mass="0.08"/><geom size="0.012" pos="0.02 0 0.01" mass="0.02"/>'
)


def model(body: str, shape: str, care: str, turns: bool = False) -> str:
    """The text of a model.

    Args:
        body: what the thing hangs on, a key of :data:`BODIES`.
        shape: its shape, a key of :data:`SHAPES`.
        care: a key of :data:`CARES`.
        turns: whether the tools turn.
    """
    option, contact = CARES[care]
    tools = "".join(_tool(name, x, turns) for name, x in STARTS.items())
    return f"""<mujoco><option {option}/><default><geom {contact} friction="0.6 0.005 0.0001"/></default>
<worldbody>{ROOM}{tools}{BODIES[body].format(shape=SHAPES[shape])}</worldbody></mujoco>"""


def _tool(name: str, x: float, turns: bool) -> str:
    slides = "".join(
        f'<joint name="{name}_{axis}" type="slide" axis="{along}" damping="0.2"/>'
        for axis, along in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True)
    )
    turn = f'<joint name="{name}_turn" type="ball" damping="0.0005"/>' if turns else ""
    return f'<body pos="{x} 0 0">{slides}{turn}{_STICK if turns else _BALL}</body>'
