"""The question before any session: a device of so much damping, at this rate; what does it get?

    $ manyhands budget --osp 0.05 --rate 1000

It is answered by the budget of the least session there is, :func:`session_of`: this device, one coupling, a wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from manyhands.launch.session import Session


@dataclass(frozen=True)
class OwnDevice:
    """What a user knows of a device.

    Attributes:
        osp: what it surely damps, N·s/m.
        rate: of the loop, Hz.
        delay: from a sample to the force that answers it, beyond any that ends within the tick, s; None for any.
        jitter: by how much the age of its samples varies at most, s: two of them may be so much further apart.
        friction: its least dry friction, N.
        step: of its encoder, m.
        speed: below which it is to hold that friction damps, m/s; None for several.
        curvature: kappa of a linkage whose motors hold torques, 1/m; 0 where the force is held.
        force: the greatest force of such a linkage, N.
        fastest: its greatest speed, m/s; how far it gets while torques are held.
        turning: whether it turns: its numbers are in N·m and rad then.
    """

    osp: float
    rate: float = 1000.0
    delay: float | None = None
    jitter: float = 0.0
    friction: float = 0.0
    step: float = 0.0
    speed: float | None = None
    curvature: float = 0.0
    force: float = 0.0
    fastest: float = 0.0
    turning: bool = False


def session_of(own: OwnDevice) -> Session:
    """The least session of that device.

    Raises:
        SessionError: a number is out of its range; the message names the session's key.
    """
    device: dict[str, Any] = {"dof": 1, "osp": own.osp, "driver": "simulated", "mass": 0.1}
    if own.turning:
        device["axes"] = "rotation"
    if own.friction:
        device["friction"] = {"least": own.friction}
    if own.step:
        device["step"] = own.step
    if own.curvature:
        device |= {"held": "torque", "linkage": {"kappa": own.curvature}}
        device["limits"] = {"force": own.force, "speed": own.fastest}
    design: dict[str, Any] = {"coupling": "spring-damper"}
    if own.delay is not None:
        design["tau"] = own.delay
    if own.jitter:
        design["period_tolerance"] = own.jitter * own.rate
    return Session.from_dict(
        {
            "session": "your-device",
            "period": 1.0 / own.rate,
            "devices": {"device": device},
            "couplings": {"coupling": {"devices": ["device"]}},
            "environment": {"type": "network", "links": [{"between": ["device.0", "ground"], "stiffness": 1000}]},
            "design": design,
        }
    )
