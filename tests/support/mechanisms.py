"""A device whose arm of two links holds torques, its part of a session, and a hand that knows the arm."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from manyhands.design.levels.contract import DeviceShare
from manyhands.design.models.statespace import StateSpace
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.bundle import OWN, DeviceBundle, DeviceRung, Limits, SimulatedHand

from .held_arm import Arm

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
T = 1e-3
HOME = (0.3, 2.5843)  # of condition number 2.4; it bends by 18.8/m
CHAIN = {
    "kind": "chain", "turns": ["z", "z"], "links": [[0.12, 0, 0], [0.14, 0, 0]],
    "low": [HOME[0] - 0.3, HOME[1] - 0.3], "high": [HOME[0] + 0.3, HOME[1] + 0.3],
}  # fmt: skip
IN_SPACE = {
    "kind": "chain", "turns": ["z", "y", "y"], "links": [[0, 0, 0.1], [0.13, 0, 0], [0.13, 0, 0]],
    "low": [-0.5, -0.8, 0.7], "high": [0.5, -0.2, 1.6],
}  # fmt: skip
FIVE_BAR = {
    "kind": "five-bar", "apart": 0.05, "upper": 0.1, "rod": 0.13, "low": [-0.03, 0.12], "high": [0.03, 0.17]
}  # fmt: skip
DELTA = {
    "kind": "delta", "base": 0.07, "platform": 0.03, "upper": 0.07, "rod": 0.14,
    "low": [-0.03, -0.03, 0.12], "high": [0.03, 0.03, 0.16],
}  # fmt: skip
ALL_LINKAGES: dict[str, Mapping[str, Any]] = {
    "chain": CHAIN,
    "in space": IN_SPACE,
    "five-bar": FIVE_BAR,
    "delta": DELTA,
}


def worst() -> tuple[list[float], list[float]]:
    """The direction in which the arm bends most, and the force of 12 N that grows on each way along it."""
    arm, q = Arm(HOME), np.array(HOME)
    ways = [np.array([math.cos(way), math.sin(way)]) for way in np.linspace(0.0, math.pi, 181)]
    way = max(ways, key=lambda along: float(np.linalg.norm(arm.bending(q, along))))
    bending = arm.bending(q, way)
    return way.tolist(), (-12.0 * bending / np.linalg.norm(bending)).tolist()


def swinging(linkage: Mapping[str, Any] | None, speed: float = 0.95) -> SimulatedHand:
    """A hand that nothing withstands swings a device almost without mass, a tick each way, in the worst direction."""
    way, _ = worst()
    motion = tuple(f"{0.5 * speed * T * part!r} * (1 - cos({1.0 / T!r} * pi * t))" for part in way)
    nothing = StateSpace.static(np.zeros((2, 2)))
    return SimulatedHand((1e-6,) * 2, (0.1,) * 2, nothing, (200.0,) * 2, (1e6,) * 2, (0.0,) * 2, motion, linkage)


def mechanism_bundle() -> DeviceBundle:
    """A device with two axes and 0.1 N*s/m, promised without a delay."""
    prepared = prepare(load_session(SESSIONS / "example1.yaml"))
    of = cut(prepared, RunPlan("realtime", None, ""))["dx"]
    assert isinstance(of, DeviceBundle)
    two, rung = dataclasses.replace(of.common, ports=("d.x", "d.y")), DeviceRung(0.0, 0.0, DeviceShare(0.5, 1.0, 0.0))
    limits = Limits((12.0,) * 2, (0.1,) * 2, (1.0,) * 2)
    return DeviceBundle(two, 0.1 * np.eye(2), (rung,), swinging(None), limits, OWN)
