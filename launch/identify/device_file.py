"""What may be stated of a device, from all poses, and the device file that says so with its sources.

All numbers are rounded to the safe side. A device file is YAML: the keys of a session's device, a source for each, and
what was measured. A session's device names it with ``from``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import manyhands
from manyhands.design.files import replacing
from manyhands.launch.identify.experiment import AtPose, line_name
from manyhands.nodes.device.specification import ROOM, DeviceSpecification, DeviceTiming

CLASS = "m-b-c: inertia, linear damping, dry friction that does not grow with the speed, drag of a power of 1.5 to 3"


@dataclass(frozen=True)
class Statement:
    """What a session may state, and of which poses.

    Attributes:
        osp: N*s/m; None where nothing can be.
        friction: by axis, N; None where nothing can be on some axis.
        mass: of a single axis, kg; None of several, where a push along an axis meets less than moves along it.
        step: by axis, m; None where none was found.
        poses: what was found.
    """

    osp: float | None
    friction: tuple[float, ...] | None
    mass: float | None
    step: tuple[float, ...] | None
    poses: tuple[AtPose, ...]


def below(value: float, digits: int = 3) -> float:
    """The greatest number of so many digits that is at most ``value``."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return float(f"{math.floor(value / unit * (1.0 + 1e-12)) * unit:.{digits}g}")


def above(value: float, digits: int = 3) -> float:
    """The least number of so many digits that is at least ``value``."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return float(f"{math.ceil(value / unit * (1.0 - 1e-12)) * unit:.{digits}g}")


def statement(found: Sequence[AtPose], stated: DeviceSpecification) -> Statement:
    """The least of all poses."""
    damping = below(min(one.found.damping.low for one in found))
    friction = tuple(below(value) for value in np.min([one.found.by_axis for one in found], axis=0))
    mass = below(min(interval.low for one in found for interval in one.found.mass)) if len(friction) == 1 else 0.0
    if stated.mass is not None:
        mass = min(mass, *stated.mass)
    step = tuple(above(value, 6) for value in np.max([one.steps for one in found], axis=0))
    return Statement(
        damping or None, friction if all(friction) else None, mass or None, step if all(step) else None, tuple(found)
    )  # fmt: skip


def device_file(
    name: str,
    driver: str,
    parameters: dict[str, Any],
    stated: DeviceSpecification,
    promised: DeviceTiming,
    starts: int,
    of: Statement,
    day: str,
) -> dict[str, Any]:
    """The content of a device file.

    Args:
        name: of the device, one line.
        driver: as the user named it.
        parameters: of the driver.
        stated: what the driver states.
        promised: the timing that the file states.
        starts: of the driver, of which that is.
        of: what was found.
        day: of the measurement, YYYY-MM-DD.
    """
    m = len(stated.force)
    program = f"manyhands identify {manyhands.__version__}, {day}"
    where = f"{program}: {len(of.poses)} pose{'s' * (len(of.poses) > 1)}"
    damping = [one.found.damping for one in of.poses]
    low, high = min(one.low for one in damping), min(one.high for one in damping)
    ends = f"interval [{low:.4g}, {high:.4g}] {stated.units('N·s/m')}"
    said = f"the driver's statement, {day}"
    keys: dict[str, tuple[Any, str]] = {"driver": (driver, "as given to identify")}
    if parameters:
        keys["parameters"] = parameters, "as given to identify"
    keys["dof"] = m, "as given to identify, and the driver's"
    if stated.axes != tuple(map(str, range(m))):
        kinds = {axis: kind.value for axis, kind in zip(stated.axes, stated.kinds, strict=True)}
        keys["axes"] = kinds if stated.turning else list(stated.axes), said
    if of.osp is not None:
        sure = "bounded errors, no probability"
        keys["osp"] = of.osp, f"{where}, least eigenvalue, {ends}, class {CLASS}, confidence: {sure}"
    if of.mass is not None:
        keys["mass"] = of.mass, f"{where}, the least that the bounds allow"
    if of.step is not None:
        keys["step"] = _plain(of.step), f"{program}: the steps of all samples, and the driver's statement"
    if of.friction is not None and of.step is not None:
        keys["friction"] = (
            {"least": _plain(of.friction)},
            f"{where}, least level over the places, beyond Stribeck's speed",
        )
    for key, value in stated.session_keys(promised).items():
        if key in ("mass", "step"):  # they were found
            continue
        source = f"{said}; state its linkage or its bending as well" if key == "held" else said
        if key in stated.measured:
            source = f"{ROOM:g} times the greatest that the driver measured at {starts} starts, {day}"
        keys[key] = _plain(value), source
    return {
        "device": name,
        "keys": {key: value for key, (value, _) in keys.items()},
        "sources": {key: source for key, (_, source) in keys.items()},
        "by_itself": list(stated.by_itself),
        "identification": {"program": program, "class": CLASS, "poses": [_pose(one, stated) for one in of.poses]},
    }


def _plain(value: Any) -> Any:
    """A value as a session file has it: of one axis the number alone."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, tuple):
        return float(value[0]) if len(value) == 1 else [float(one) for one in value]
    return value


def _pose(one: AtPose, stated: DeviceSpecification) -> dict[str, Any]:
    found, lines = one.found, {}
    for at, line in enumerate(one.lines):
        speeds = [pair.fast for pair in line.pairs] or [0.0]
        lines[line_name(line.u, stated.axes)] = {
            "damping": _ends(found.by_line[at]),
            "friction": _ends(found.friction[at]),
            "mass": _ends(found.mass[at]),
            "speeds": [float(f"{value:.3g}") for value in (min(speeds), max(speeds))],
            "displacement_error": float(f"{one.doubts[at].delta:.3g}"),
        }
    return {
        "place": [float(f"{value:.4g}") for value in one.place],
        "damping": _ends(found.damping),
        "friction_falls_with_speed": found.stribeck,
        "lines": lines,
    }


def _ends(interval: Any) -> list[float]:
    return [float(f"{interval.low:.4g}"), float(f"{interval.high:.4g}")]


def write_device_file(path: Path, content: dict[str, Any]) -> None:
    """Write a device file whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120)
    with replacing(path) as file:
        file.write(text.encode())
