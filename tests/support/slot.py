"""Sessions in which a hand turns a tool: a stick in a slot, freely about its own axis and not about z; and a bar."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from manyhands.launch.plan.engine import drawing_of
from manyhands.launch.plan.prepare import unproved
from manyhands.launch.recordings.run import RecordedRun
from manyhands.launch.run.broadcast import describe
from manyhands.launch.session import Session
from manyhands.nodes.monitor.session_state import About

DEVICE = ("x", "f_v", "R", "Q", "t_v", "proposed", "account")
WORLD = ("x_e", "q", "R", "heard", "told")
"""The traces of its device and its world."""

MODEL = """<mujoco>
  <option timestep="0.0005" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <geom type="box" pos="0 0.0075 0" size="0.1 0.002 0.05"/>
    <geom type="box" pos="0 -0.0075 0" size="0.1 0.002 0.05"/>
    <body name="stick">
      <joint name="x" type="slide" axis="1 0 0" damping="0.5"/>
      <joint name="y" type="slide" axis="0 1 0" damping="0.5"/>
      <joint name="z" type="slide" axis="0 0 1" damping="0.5"/>
      <joint name="turn" type="ball" damping="0.0005"/>
      <geom type="capsule" fromto="-0.03 0 0 0.03 0 0" size="0.005" mass="0.2"/>
    </body>
  </worldbody>
</mujoco>"""

ORIENTATION: dict[str, Any] = {
    "osp": 0.001,
    "stiffness": 0.3,
    "limits": {"torque": 0.2, "speed": 30},
    "inertia": 2e-5,
    "torque": ["0.004*sin(2*pi*t)", 0, "0.03*sin(2*pi*2*t)"],
}

SENSED: dict[str, Any] = {
    "sensed": True,
    "stiffness": 0.3,
    "inertia": 2e-5,
    "damping": 0.001,
    "torque": ORIENTATION["torque"],
}
"""The orientation of a grip without motors."""


def slot(orientation: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    """The session as plain data, with these keys of its device's orientation, and others of its own."""
    pen = {
        "dof": 3,
        "osp": 1.37,
        "driver": "simulated",
        "mass": 0.2,
        "hand": {"stiffness": 100, "damping": 2, "motion": ["0.02*sin(2*pi*2*t)", 0, 0]},
        "orientation": {**ORIENTATION, **(orientation or {})},
    }
    environment = {
        "type": "engine",
        "engine": "mujoco",
        "stiffness": 500,
        "tools": {"pen": ["x", "y", "z"]},
        "avatars": {"pen": "turn"},
        "bodies": ["stick"],
        "orientations": ["stick"],
        "model": MODEL,
    }
    return {
        "session": "slot",
        "period": 0.001,
        "devices": {"pen": pen},
        "couplings": {"c": {"devices": ["pen"]}},
        "environment": environment,
        "design": {"coupling": "spring-damper"},
        **changes,
    }


def sensed(**changes: Any) -> dict[str, Any]:
    """The same with a stick that is held by a grip without motors, and that the slot cannot hold."""
    data = slot(**changes)
    data["devices"]["pen"]["orientation"] = {**SENSED}
    return data


def joined(kappa: float = 10.0, **orientation: Any) -> dict[str, Any]:
    """The same with joints that hold force and torque together, with these keys of the orientation."""
    data = slot(orientation, design={"coupling": "spring-damper", "tau": 0.0002})
    data["devices"]["pen"] |= {"held": "torque", "linkage": {"kappa": kappa, "length": 0.05}}
    data["devices"]["pen"]["limits"] = {"force": 4, "speed": 0.5}
    return data


PEN = "tests.support.turning_drivers:Pen"
"""A driver of another package, a counterpart that turns in space."""


def told(orientation: dict[str, Any] | None = None, driver: str = PEN, **parameters: Any) -> dict[str, Any]:
    """The same with a stick of which a driver tells the orientation, which feels a torque unless it is said to."""
    data = slot()
    felt = {"osp": 0.001, "stiffness": 0.3, "limits": {"torque": 0.2, "speed": 30}}
    data["devices"]["pen"] = {
        "dof": 3,
        "osp": 1.37,
        "driver": driver,
        "parameters": {"push": 0.5, "wrist": 0.004, **parameters},
        "limits": {"force": 8, "displacement": 0.2, "speed": 2},
        "mass": 0.2,
        "orientation": felt if orientation is None else orientation,
    }
    return data


def session(**changes: Any) -> Session:
    """The session, with these keys of its own."""
    return Session.from_dict(slot(**changes))


def slot_by(link: dict[str, Any] | None, **changes: Any) -> Session:
    """The session with this wave link at its coupling, and other keys of its own."""
    own = {} if link is None else {"wave_link": link}
    return session(couplings={"c": {"devices": ["pen"], **own}}, **changes)


def values(run: RecordedRun, node: str, trace: str) -> np.ndarray:
    """A trace of a node."""
    (found,) = (one.values for (of, _), one in run.traces.items() if of == node and one.topic.trace == trace)
    return np.array(found)


def as_told(R: tuple[float, ...], Q: tuple[float, ...], torque: tuple[float, ...]) -> dict[str, list[float]]:
    """Columns of traces that a page is told, where the device and its tool are turned so, and the torque is this."""
    return {"R": [*R], "Q": [*Q], "t_v": [*torque], "proposed": [*Q, 0.0], "account": [0.0] * 6,
            "heard": [*R, 0.0, 1.0], "told": [*Q, 0.0]}  # fmt: skip


def described(pivot: str = "0 0 0") -> About:
    """The session as a page is told of it, without a body: its stick is turned about ``pivot``, m."""
    given = slot(design={"coupling": "given", "stiffness": 900, "damping": 0.2})
    ball = 'name="turn" type="ball"'
    assert MODEL.count(ball) == 1
    model = MODEL.replace(ball, f'{ball} pos="{pivot}"')
    world = {key: value for key, value in given["environment"].items() if key not in ("bodies", "orientations")}
    made = Session.from_dict({**given, "environment": {**world, "model": model}})
    return replace(describe(unproved(made), "simulated", "ipc", 0), drawing=drawing_of(made))


BAR = """<mujoco>
  <option timestep="0.0005" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <geom type="box" pos="0 0.018 0" size="0.045 0.003 0.02"/>
    <geom type="box" pos="0 -0.018 0" size="0.045 0.003 0.02"/>
    <body name="bar">
      <joint name="x" type="slide" axis="1 0 0" damping="0.5"/>
      <joint name="y" type="slide" axis="0 1 0" damping="0.5"/>
      <joint name="z" type="slide" axis="0 0 1" damping="0.5"/>
      <joint name="turn" type="ball" damping="0.001"/>
      <geom type="box" size="0.03 0.01 0.01" mass="0.3"/>
    </body>
  </worldbody>
</mujoco>"""


def rail() -> dict[str, Any]:
    """A bar between two rails, which a person at a page moves and turns: about z by some ten degrees alone.

    Its numbers are those of a period of 10 ms, which a machine keeps whose processor draws the page. In its own time no
    late tick makes the device let go.
    """
    pen = {
        "dof": 3,
        "osp": 1.37,
        "driver": "browser",
        "time": "own",
        "mass": 0.2,
        "hand": {"stiffness": 100, "damping": 5},
        "limits": {"displacement": 0.05},
        "orientation": {
            "osp": 0.001,
            "stiffness": 0.04,
            "limits": {"torque": 0.05, "speed": 6},
            "inertia": 1e-4,
        },
    }
    environment = {
        "type": "engine",
        "engine": "mujoco",
        "stiffness": 50,
        "tools": {"hand": ["x", "y", "z"]},
        "avatars": {"hand": "turn"},
        "model": BAR,
    }
    return {
        "session": "rail",
        "period": 0.01,
        "devices": {"hand": pen},
        "couplings": {"c": {"devices": ["hand"]}},
        "environment": environment,
        "design": {"coupling": "spring-damper", "tau": 0.004},
    }
