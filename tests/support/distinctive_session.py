"""A session of three users with unique numbers and names, so that a search finds each one anywhere.

The numbers are those of Example 1, each changed by up to a few per cent; the last bits are random, from a fixed seed.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from .patterns import is_distinctive

NAME = "session-of-marigolds"
DEVICES = ("dx_alder41", "dy_birch52", "dz_cedar63")
COUPLINGS = {"cx_heron74": DEVICES[0], "cy_raven85": DEVICES[1], "cz_finch96": DEVICES[2]}
ENVIRONMENT = "environment"
HUB = "hub_granite17"


def session() -> dict[str, Any]:
    """The session file's content, the same at every call."""
    near = _Near(20260401)
    devices = {
        name: {
            "dof": 1,
            "osp": near(1.37),
            "driver": "simulated",
            "mass": near(0.2),
            "damping": near(1.6),
            "hand": {
                "operator": {
                    "num": [near(0.02), near(1.2), near(20.0)],
                    "den": [1, near(10.3), near(100.0)],
                },
                "mass": near(0.05),
                "damping": near(0.3),
                "stiffness": near(3.0),
                "force": f"{near(push)!r}*pulse(t, {near(0.03)!r}, {near(0.2)!r})",
                "motion": f"{near(0.001)!r}*sin({near(25.0)!r}*t)",
            },
            "limits": {"force": near(40.0), "displacement": near(0.5), "speed": near(5.0), "hand": near(50.0)},
        }
        for name, push in zip(DEVICES, (2.0, -1.5, 1.0), strict=True)
    }
    links = [
        {"between": [name, HUB], "stiffness": near(stiffness), "damping": near(damping)}
        for name, stiffness, damping in zip(DEVICES, (3800.0, 3500.0, 3300.0), (0.1, 0.2, 0.3), strict=True)
    ]
    links.append({"between": [HUB, "ground"], "stiffness": near(2600.0), "damping": near(0.5)})
    return {
        "session": NAME,
        "period": 0.001,
        "devices": devices,
        "couplings": {name: {"devices": [device]} for name, device in COUPLINGS.items()},
        "environment": {"type": "network", "masses": {HUB: near(3.0)}, "links": links},
        # given, as a designed one may have the same poles in every block
        "design": {
            "coupling": "given",
            "stiffness": [near(1000.0), near(900.0), near(800.0)],
            "damping": [near(0.27), near(0.25), near(0.23)],
        },
    }


def as_file(session: Mapping[str, Any]) -> str:
    """The text of a session file; every number reads back exactly."""
    return str(yaml.safe_dump(dict(session), sort_keys=False))


class _Near:
    """Numbers near given ones, with random last bits."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def __call__(self, value: float) -> float:
        near = value * self._random.uniform(1.0, 1.03)
        assert is_distinctive(near)
        return near


def number_lists(plain: object) -> Iterator[list[float]]:
    """The numbers in a tree of mappings and lists: numbers of one list together, every other number by itself."""
    match plain:
        case Mapping():
            for value in plain.values():
                yield from number_lists(value)
        case list() | tuple():
            numbers = [
                float(value) for value in plain if isinstance(value, float | int) and not isinstance(value, bool)
            ]
            if len(numbers) == len(plain):
                yield numbers
            else:
                for value in plain:
                    yield from number_lists(value)
        case float() | int() if not isinstance(plain, bool):
            yield [float(plain)]


def texts(plain: object) -> Iterator[str]:
    """Every text in such a tree, including the mappings' keys."""
    match plain:
        case Mapping():
            for key, value in plain.items():
                yield str(key)
                yield from texts(value)
        case list() | tuple():
            for value in plain:
                yield from texts(value)
        case str():
            yield plain
