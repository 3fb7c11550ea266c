"""A session to observe without processes: its description, and frames as its broadcast sends them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from manyhands.nodes.monitor.health_model import HealthModel
from manyhands.nodes.monitor.session_state import About, CertificateAbout, LinkAbout, NodeAbout, SpringAbout
from manyhands.nodes.monitor.tracks import Floats
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Condition, Figures, Observation, Role

ABOUT = About(
    session="pair",
    id="c" * 64,
    pid=os.getpid(),
    clock="realtime",
    transport="ipc",
    period=0.001,
    ticks=0,
    started=1.7e9,
    nodes={
        "left": NodeAbout(Role.DEVICE, ("left",), wall=True),
        "right": NodeAbout(Role.DEVICE, ("right.x", "right.y"), wall=True),
        "vl": NodeAbout(Role.COUPLING, ("left",)),
        "vr": NodeAbout(Role.COUPLING, ("right.x", "right.y")),
        "environment": NodeAbout(Role.ENVIRONMENT, ("left", "right.x", "right.y")),
    },
    links=(
        LinkAbout(("left", "vl"), ("left",)),
        LinkAbout(("right", "vr"), ("right.x", "right.y")),
        LinkAbout(("vl", "environment"), ("left",)),
        LinkAbout(("vr", "environment"), ("right.x", "right.y")),
    ),
    masses={"ball": 0.5},
    springs=(SpringAbout(("left", "ball"), 100.0, 0.1), SpringAbout(("right.x", "ball"), 100.0, 0.1)),
    grips=("right",),
    reach={"left": 0.1, "right.x": 0.1, "right.y": 0.05},
    certificate=CertificateAbout(0.0003, {"(10)": 0.5}, None, {"left": 1.0, "right": 1.0}, (0.0005,), (), 0.005, True),
    environment="network",
    force={"left": 10.0, "right.x": 6.0, "right.y": 8.0},
)
"""Two users and a ball; the right device can be held."""

UNCERTIFIED = replace(ABOUT, certificate=None)


def observed(
    node: str, tick: int, traces: Mapping[str, Floats], told: Figures | None = None, **numbers: float
) -> bytes:
    """A frame of a node's telemetry: of the figures that are ``told``, with these numbers."""
    return encode(Observation(node, tick, (told or Figures()).with_numbers(numbers), traces))


def judged(*frames: bytes, about: About = ABOUT) -> bytes:
    """The frame of the condition that a supervisor shows after these frames, with what they say of the promises."""
    model, shown = HealthModel(about.terms), Condition("running", 1.0, dict.fromkeys(about.nodes, "running"))
    for frame in frames:
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Observation):
            model.take(message.node, message.tick, message.figures)
        elif isinstance(message, Condition):
            shown = message
    model.look(shown.states, shown.silent)
    model.conclude()  # the environment has no frame of its own here, so nobody else is found to have moved anyone
    return encode(replace(shown, promises=model.rows()))


def moving(tick: int, rows: int = 100) -> bytes:
    """A frame of the left device, whose displacement is a thousandth of the tick's number, m."""
    x = np.arange(tick - rows, tick, dtype=np.float64)[:, None] / 1e3
    return observed("left", tick, {"x": x, "f_v": -x, "ledger": x, "tau_us": x}, tau_worst_us=100.0)


def conditioned(phase: str = "running", **told: tuple[str, ...]) -> bytes:
    """A frame of the session's condition: all nodes run except those in ``lost``."""
    lost = told.pop("lost", ())
    states = {name: "lost" if name in lost else "running" for name in ABOUT.nodes}
    return encode(Condition(phase, 1.0, states, **told))
