"""The dry friction of a device: what it burns at least, which is claimed, and what a simulated one burns beyond.

A certificate, a budget and the account of a device know ``least`` alone. A simulated device burns more at rest
(``static``, until it is faster than ``stribeck``) and in places (up to ``most``, once in each ``pitch``), so that a run
shows what a claim of the least leaves out.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Final, Self

from pydantic import Field, model_validator

from manyhands.design.models.axis import Units
from manyhands.launch.session.fields import (
    OnAxes,
    PerAxis,
    Problem,
    Quantity,
    refusal,
)
from manyhands.launch.session.limits import MIN_POSITIVE
from manyhands.nodes.kernel.friction_curve import FrictionCurve

_LEVEL: Final = PerAxis(Quantity("a friction", "N", above=0.0, smallest=MIN_POSITIVE))
_PITCH: Final = PerAxis(Quantity("a pitch", "m", above=0.0, smallest=MIN_POSITIVE))
_SPEED: Final = PerAxis(Quantity("a speed", "m/s", above=0.0, smallest=MIN_POSITIVE))
_EACH: Final = "a number, or one for each axis"
_TOGETHER: Final = (("most", "pitch"), ("static", "stribeck"))
SIMULATED_ALONE: Final = tuple(key for pair in _TOGETHER for key in pair)
"""Keys that say what a simulated device burns beyond its least; no claim rests on them."""


class Friction(OnAxes):
    """The dry friction of a device; every tuple has one entry for each axis.

    The level at the place x and the speed v is :meth:`manyhands.nodes.kernel.friction_curve.FrictionCurve.level`.

    Raises:
        PydanticCustomError: a level is below the least, or one of two keys that belong together is missing.
    """

    least: Annotated[tuple[float, ...], _LEVEL] = Field(
        description=f"the least dry friction in N, over every pose and direction: {_EACH}"
    )
    most: Annotated[tuple[float, ...] | None, _LEVEL] = Field(
        default=None, description=f"simulated, the greatest in N once it slides, in one place of each pitch: {_EACH}"
    )
    pitch: Annotated[tuple[float, ...] | None, _PITCH] = Field(
        default=None, description=f"with most, the way in m from one place of the least friction to the next: {_EACH}"
    )
    static: Annotated[tuple[float, ...] | None, _LEVEL] = Field(
        default=None, description=f"simulated, the friction at rest in N, where the place adds none: {_EACH}"
    )
    stribeck: Annotated[tuple[float, ...] | None, _SPEED] = Field(
        default=None, description=f"with static, the speed in m/s at which 1/e of what rest adds is left: {_EACH}"
    )

    @property
    def simulated(self) -> tuple[float, ...] | FrictionCurve:
        """What a simulated device burns: constants by axis, N, or how they change."""
        if self.most is None and self.static is None:
            return self.least
        unit = (1.0,) * len(self.least)  # of a place or a speed that adds nothing
        return FrictionCurve(
            self.least, self.most or self.least, self.pitch or unit, self.static or self.least, self.stribeck or unit
        )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if problems := tuple(self._problems()):
            raise refusal(*problems)
        return self

    def _problems(self) -> Iterator[Problem]:
        for pair in _TOGETHER:
            missing = [key for key in pair if getattr(self, key) is None]
            if len(missing) == 1:
                (stated,) = {*pair} - {*missing}
                yield Problem((stated,), f"{stated} alone", f"{missing[0]} as well, or no {stated}")
        for key in ("most", "static"):
            for level, least, kind in zip(getattr(self, key) or (), self.least, self.kinds, strict=False):
                if level < least:
                    unit = Units.of([kind])("N")
                    yield Problem((key,), f"{level:g} {unit}", f"at least the least friction, {least:g} {unit}")
