"""A MuJoCo model before MuJoCo sees it: which files it may name, and how much it may ask for.

A model may come from a stranger, and MuJoCo trusts it: an ``include`` or an asset opens any path, ``replicate`` makes
a million bodies of one line, and a tiny ``timestep`` makes a tick last for ever [MuJoCo2026]_. So its text is read here
first, with nothing but Python's XML parser. What it says is held against the bounds of this module; the model that
MuJoCo makes of it is held against them again (:mod:`manyhands.nodes.environment.mujoco_compiler`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from typing import Any, Final
from xml.etree import ElementTree

MOST_STEPS: Final = 100
"""Steps of the engine in one tick: 10 us each at 1 kHz."""

MOST_PARTS: Final = 10_000
"""Elements of the text, each counted as often as ``replicate``, ``composite`` and ``flexcomp`` repeat it."""

MOST_GEOMS: Final = 2_000
"""Shapes, counted likewise. Each pair of them may touch."""

MOST_DEPTH: Final = 100
"""Elements within each other."""

FILES: Final = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")
"""Attributes that name a file."""

FOLDERS: Final = ("assetdir", "meshdir", "texturedir")
"""Attributes that name a folder."""

OTHER_TEXTS: Final = {
    "include": "the included text in its place",
    "model": "one model in one text",
    "attach": "one model in one text",
    "extension": "a model without plugins",
    "plugin": "a model without plugins",
}
"""Elements that bring another text or other code into the model, and what is expected in their place."""

OPTIONS: Final = dict.fromkeys(
    ("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations", "sdf_iterations", "sdf_initpoints"), 1000
)
"""The greatest value of each ``option`` that multiplies the work of a step."""

SIZES: Final = {
    "hfield": {"nrow": 1024, "ncol": 1024},
    "texture": {"width": 2048, "height": 2048 * 6},  # a cube has six squares below each other
    "camera": {"resolution": 2048},
    "option": OPTIONS,
    "size": {
        **dict.fromkeys(("njmax", "nconmax", "nuserdata"), 100_000),
        **dict.fromkeys(("nuser_body", "nuser_jnt", "nuser_geom", "nuser_site", "nuser_cam"), 100),
        **dict.fromkeys(("nuser_tendon", "nuser_actuator", "nuser_sensor"), 100),
        "nkey": 1000,
        "nstack": 1 << 23,
    },
}
"""By element and attribute, the greatest whole number."""

MOST_ARENA: Final = 1 << 26
"""Bytes that ``size memory`` may reserve for contacts and constraints."""

_REPEATING: Final = ("replicate", "composite", "flexcomp")
_FLEXCOMP_COUNT: Final = "10 10 10"  # where it states none
_NO_MARKUP: Final = re.compile(r"<!(?!--|\[CDATA\[)")
_WHOLE: Final = re.compile(r"[+-]?[0-9]{1,15}")
_UNITS: Final = {unit: 1024**power for power, unit in enumerate(("", "K", "M", "G", "T", "P", "E"))}
_MEMORY: Final = re.compile(rf"([+-]?[0-9]{{1,15}})([{''.join(_UNITS)}]?)", re.IGNORECASE)


class ModelRefused(ValueError):
    """A model asks for what it may not have; the message says what was found and what would be right."""


def require_bounded(text: str, assets: Collection[str], period: float) -> None:
    """Refuse a text that names files other than its assets, or that asks for more than the bounds of this module.

    Args:
        text: MuJoCo's XML, whose root is ``mujoco``.
        assets: the names of the files that it may name.
        period: T, s.

    Raises:
        ModelRefused: what is wrong first, in the order of the text.
    """
    if _NO_MARKUP.search(text):
        raise ModelRefused("found a document type or entities in the model; expected elements alone")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 -- without a document type there are no entities to expand
    except (ElementTree.ParseError, ValueError) as error:
        raise ModelRefused(f"found a model that is not XML: {error}; expected MuJoCo's XML") from error
    if root.tag != "mujoco":
        raise ModelRefused(f"found <{root.tag:.40}> around the model; expected <mujoco>")
    parts = geoms = 0
    for element, depth, times in _walked(root):
        parts += times
        geoms += times if element.tag in ("geom", "composite") else 0
        if depth > MOST_DEPTH:
            raise ModelRefused(f"found elements {depth} deep; expected at most {MOST_DEPTH}")
        if parts > MOST_PARTS:
            raise ModelRefused(f"found more than {MOST_PARTS} parts, with repetitions; expected at most as many")
        if geoms > MOST_GEOMS:
            raise ModelRefused(f"found more than {MOST_GEOMS} geoms, with repetitions; expected at most as many")
        if element.tag in OTHER_TEXTS:
            raise ModelRefused(f"found <{element.tag}>; expected {OTHER_TEXTS[element.tag]}")
        _require_names(element, assets)
        _require_sizes(element)
        if element.tag == "option" and "timestep" in element.keys():  # noqa: SIM118 -- an element is no mapping
            steps_of(_number(element, "timestep"), period)


def steps_of(timestep: float, period: float) -> int:
    """The whole steps of at most ``timestep`` (s) in a period (s).

    Raises:
        ModelRefused: the timestep is not above 0, or there are more than :data:`MOST_STEPS`.
    """
    if not (math.isfinite(timestep) and timestep > 0.0 and period / timestep <= MOST_STEPS * (1.0 + 1e-9)):
        raise ModelRefused(
            f"found a timestep of {timestep:g} s; expected at least {period / MOST_STEPS:g} s, "
            f"{MOST_STEPS} steps in a tick of {period:g} s"
        )
    return max(1, math.ceil(period / timestep - 1e-9))


def require_model(model: Any, period: float) -> None:
    """Hold the model that MuJoCo has made of a text against the same bounds.

    Args:
        model: MuJoCo's ``MjModel``.
        period: T, s.

    Raises:
        ModelRefused: it is beyond one of them.
    """
    steps_of(float(model.opt.timestep), period)
    for name, most in OPTIONS.items():
        _require_at_most(name, int(getattr(model.opt, name, 0)), most)
    _require_at_most("ngeom", int(model.ngeom), MOST_GEOMS)
    for name in ("nbody", "nv", "nsite", "ntendon", "nu", "nsensor", "neq", "npair", "nflexvert", "nflexelem"):
        _require_at_most(name, int(getattr(model, name, 0)), MOST_PARTS)
    _require_at_most("narena", int(model.narena), MOST_ARENA)


def _require_at_most(name: str, value: int, most: int) -> None:
    if value > most:
        raise ModelRefused(f"found a model with {name} = {value}; expected at most {most}")


def _walked(root: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, int, int]]:
    """Every element in the order of the text, its depth, and how often the elements around it and it repeat it."""
    waiting = [(root, 1, 1)]
    while waiting:
        element, depth, times = waiting.pop()
        times = min(times * _copies(element), MOST_PARTS + 1)
        yield element, depth, times
        waiting.extend((child, depth + 1, times) for child in reversed(element))


def _copies(element: ElementTree.Element) -> int:
    """How often an element makes what is in it; 1 for most."""
    if element.tag not in _REPEATING:
        return 1
    stated = element.get("count", _FLEXCOMP_COUNT if element.tag == "flexcomp" else "1")
    return math.prod(max(1, _whole(element, "count", word)) for word in stated.split()[:3])


def _require_names(element: ElementTree.Element, assets: Collection[str]) -> None:
    for name in FILES:
        value = element.get(name)
        if value is not None and value not in assets:
            raise ModelRefused(
                f"found {name}={value[:100]!r} at <{element.tag}>; expected the name of a file that the session lists "
                f"under assets{': ' + ', '.join(sorted(assets)) if assets else ', where there is none'}"
            )
    for name in FOLDERS:
        if element.get(name):
            raise ModelRefused(f"found {name}={element.get(name, '')[:100]!r}; expected assets by name alone")


def _require_sizes(element: ElementTree.Element) -> None:
    for name, most in SIZES.get(element.tag, {}).items():
        for word in element.get(name, "").split():
            if _whole(element, name, word) > most:
                raise ModelRefused(f"found {name}={word[:40]!r} at <{element.tag}>; expected at most {most}")
    if element.tag == "size" and (memory := element.get("memory", "").strip()):
        parsed = _MEMORY.fullmatch(memory)
        if parsed is None or int(parsed[1]) * _UNITS[parsed[2].upper()] > MOST_ARENA:
            raise ModelRefused(f"found memory={memory[:40]!r} at <size>; expected at most {MOST_ARENA >> 20}M")


def _whole(element: ElementTree.Element, name: str, word: str) -> int:
    if not _WHOLE.fullmatch(word):
        raise ModelRefused(f"found {name}={word[:40]!r} at <{element.tag}>; expected whole numbers")
    return int(word)


def _number(element: ElementTree.Element, name: str) -> float:
    word = element.get(name, "")
    try:
        return float(word)
    except ValueError:
        raise ModelRefused(f"found {name}={word[:40]!r} at <{element.tag}>; expected a number") from None
