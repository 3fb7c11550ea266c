"""The devices without motors by which a person moves a simulated device: ``spacemouse``, ``gamepad``.

Their ``parameters`` and ``axis_map`` become a :class:`manyhands.nodes.kernel.bundle.RateMotion`. The kinds and their
axes are those of :data:`manyhands.nodes.device.motion_sources.MOTION_SOURCES`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from pydantic_core import PydanticCustomError

from manyhands.launch.session.errors import one_of, show
from manyhands.launch.session.fields import Problem, Quantity, problems_of, refusal, refuse
from manyhands.nodes.device.motion_sources import MOTION_SOURCES
from manyhands.nodes.device.pointer import SPEED
from manyhands.nodes.kernel.bundle import RateMotion

DEFAULT_SPEED: Final = 0.1
"""Of the goal at full deflection, m/s, where the session says nothing."""

_FILE: Final = re.compile(r"/[A-Za-z0-9_.+:/-]{1,200}")


def _device(value: object) -> str:
    if isinstance(value, str) and _FILE.fullmatch(value):
        return value
    raise refuse(show(value), "the path of its file, such as /dev/hidraw3, or no device for the one that is plugged in")


_CHECKS: Final[Mapping[str, Callable[[object], Any]]] = {
    "device": _device,
    "speed": Quantity("a speed", "m/s", above=0.0, most=SPEED),
    "dead_zone": Quantity("a part of the full deflection", least=0.0, most=0.9),
}


def rate_motion(driver: str, parameters: Mapping[str, object], axes: Sequence[str] | None, dof: int) -> RateMotion:
    """What a bundle says of the device that moves the goal.

    Args:
        driver: its kind.
        parameters: as the session has them.
        axes: the session's ``axis_map``; None for the first axes of the kind.
        dof: number of axes of the session's device.

    Raises:
        PydanticCustomError: a parameter is unknown or wrong, or there is not one axis for each degree of freedom.
    """
    kind, values, problems = MOTION_SOURCES[driver], dict[str, Any](), list[Problem]()
    for key, value in parameters.items():
        try:
            if key not in _CHECKS:
                raise refuse(f"the key {show(key)}", one_of(tuple(_CHECKS), key))
            values[key] = _CHECKS[key](value)
        except PydanticCustomError as error:
            problems += [problem._replace(at=("parameters", key, *problem.at)) for problem in problems_of(error)]
    names = [axis.removeprefix("-") for axis in axes or ()]
    if axes is None and dof > len(kind.AXES):
        problems.append(Problem(("dof",), str(dof), f"at most {len(kind.AXES)}, the axes of a {kind.NAME}"))
    elif axes is not None and (len(names) != dof or len(set(names)) != dof or not set(names) <= {*kind.AXES}):
        expected = f"{dof} of {', '.join(kind.AXES)}, each once, one for each degree of freedom"
        problems.append(Problem(("axis_map",), show(axes), expected))
    if problems:
        raise refusal(*problems)
    chosen = kind.AXES[:dof] if axes is None else tuple(axes)
    given = {"device": "", "speed": DEFAULT_SPEED, "dead_zone": kind.DEAD_ZONE, **values}
    return RateMotion(driver, given["device"], chosen, given["speed"], given["dead_zone"])
