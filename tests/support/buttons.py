"""A session whose buttons hold a ball: two users, of whom the first takes it to the second."""

from __future__ import annotations

import copy
from typing import Any

from manyhands.launch.recordings.run import FiguresByTick
from manyhands.nodes.rows.tick_events import Kind, events_in


def _device(pressed: list[list[float]], *motion: str | int) -> dict[str, Any]:
    return {
        "dof": 3,
        "axes": ["x", "y", "z"],
        "osp": 1.37,
        "driver": "simulated",
        "mass": 0.2,
        "buttons": {"grip": pressed, "menu": []},
        "limits": {"force": 12, "displacement": 0.25, "speed": 2},
        "hand": {"stiffness": 300, "damping": 5, "motion": list(motion)},
    }


HANDOVER: dict[str, Any] = {
    "session": "handover",
    "period": 0.001,
    "devices": {
        "anna": _device([[0.05, 0.3]], 0, "0.1*max(0, min(t-0.06, 0.2))", 0),
        "ben": _device([[0.2, 0.38]], 0, "0.1*max(0, min(t-0.06, 0.2))", 0),
    },
    "couplings": {"to_anna": {"devices": ["anna"]}, "to_ben": {"devices": ["ben"]}},
    "environment": {
        "type": "scene",
        "gravity": [0, -9.81, 0],
        "tools": {"anna": {"at": [-0.05, 0.04, 0], "radius": 0.01}, "ben": {"at": [0.05, 0.04, 0], "radius": 0.01}},
        "bodies": {"red": {"mass": 0.05, "at": [0, 0.039, 0], "radius": 0.04}},
        "obstacles": {"room": {"shape": "room", "low": [-0.2, 0, -0.2], "high": [0.2, 0.3, 0.2]}},
        "contact": {"stiffness": 3000, "damping": 2},
        "holds": [
            {"tool": "anna", "button": "grip", "stiffness": 500, "damping": 2, "within": 0.01},
            {"tool": "ben", "button": "grip", "stiffness": 500, "damping": 2, "within": 0.01},
        ],
    },
    "design": {"coupling": "given", "stiffness": 900, "damping": 0.2},
}
"""0.4 s of it: anna's grip holds the ball from tick 50 to 299, ben's from 200 to 379."""


def handover(**changes: object) -> dict[str, Any]:
    """The session with some values changed, by the way to each with ``__`` between keys."""
    data = copy.deepcopy(HANDOVER)
    for where, value in changes.items():
        *way, last = where.split("__")
        part: Any = data
        for step in way:
            part = part[int(step) if step.isdigit() else step]
        part[last] = value
    return data


def held_down(figures: FiguresByTick, ticks: int) -> dict[str, list[range]]:
    """By button, the ticks in which it was held down, by the events of a node; a new process begins with none."""
    found: dict[str, list[range]] = {}
    since: dict[str, int] = {}
    begun, presses = set[int](), dict[int, list[tuple[str, bool]]]()
    for event in (event for _, values in figures for event in events_in(values)):
        if event.kind is Kind.BEGAN:
            begun.add(event.tick)
        elif event.kind is Kind.PRESSED:
            presses.setdefault(event.tick, []).append((event.peer, bool(event.value)))
    for tick in sorted(presses.keys() | begun):
        released = [*since] if tick in begun else []
        for button, down in presses.get(tick, ()):
            if down:
                since.setdefault(button, tick)
            else:
                released.append(button)
        for button in released:
            if since.get(button, tick) < tick:
                found.setdefault(button, []).append(range(since.pop(button), tick))
    for button, begin in since.items():
        found.setdefault(button, []).append(range(begin, max(begin + 1, ticks)))
    return found
