"""The dry friction of a simulated device, where it is more than a constant.

Dry friction is greatest at rest, falls as a device begins to slide (Stribeck), and changes with the place, as the teeth
of gears and the strands of a rope do. On each axis the level at the place x and the speed v is

    c(x, v) = least + (most - least) (1 - cos(2 pi x/pitch))/2 + (static - least) exp(-(v/stribeck)^2),

so that no level is below the least one, which is what a session claims of its device.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from manyhands.protocol.plain import PlainForm, optional, read, written


@dataclass(frozen=True)
class FrictionCurve:
    """The levels of dry friction, each by axis.

    Attributes:
        least: c at speed, where the place makes it least, N.
        most: c at speed, where the place makes it greatest, N; at least ``least``.
        pitch: from one such place to the next, m.
        static: c at rest, where the place makes it least, N; at least ``least``.
        stribeck: the speed at which 1/e of what rest adds is left, m/s.

    Raises:
        ValueError: the entries are not of one number of axes, one is out of its range, or a level is below the least.
    """

    least: tuple[float, ...]
    most: tuple[float, ...]
    pitch: tuple[float, ...]
    static: tuple[float, ...]
    stribeck: tuple[float, ...]

    def __post_init__(self) -> None:
        every = {field.name: getattr(self, field.name) for field in fields(self)}
        if len(set(map(len, every.values()))) != 1:
            raise ValueError(f"friction: found {every}; expected each by as many axes")
        for name, values in every.items():
            if not all(0.0 < value < math.inf for value in values):
                raise ValueError(f"friction: found the {name} {values}; expected finite numbers greater than 0")
        for level in (self.most, self.static):
            if any(a < b for a, b in zip(level, self.least, strict=True)):
                raise ValueError(f"friction: found {level} N; expected at least {self.least} N")

    def level(self, axis: int, x: float, v: float) -> float:
        """The level at the place x (m) and the speed v (m/s), N; at least the least one, whatever they are."""
        least = self.least[axis]
        pitch = self.pitch[axis]
        teeth = 0.5 * (self.most[axis] - least) * (1.0 - math.cos(2.0 * math.pi * (math.fmod(x, pitch) / pitch)))
        return least + teeth + (self.static[axis] - least) * math.exp(-min(_GONE, (v / self.stribeck[axis]) ** 2))


_GONE = 700.0  # e^-700 is 1e-304; a greater square might be infinite

_LEAST = PlainForm(list, lambda data: read(_Levels, {"least": data}).least)
_CURVE = PlainForm(written, lambda data: read(FrictionCurve, data))


@dataclass(frozen=True)
class _Levels:
    least: tuple[float, ...]


FRICTION_FORM = optional(
    PlainForm(
        lambda value: (_CURVE if isinstance(value, FrictionCurve) else _LEAST).write(value),
        lambda data: (_CURVE if isinstance(data, dict) else _LEAST).read(data),
    )
)
"""Friction as plain data: null, a list of constants by axis in N, or the object of a :class:`FrictionCurve`."""
