"""The orientation of a device, where that is a port: a tool that its hand turns in space.

The device states what it burns at least (``osp``), and its limits. A simulated one turns as a body of one inertia about
every axis, whose hand intends a torque about each of the world's axes. The torque of the hand's spring follows in the
device's own process (docs/decisions/0054-orientation.md).
"""

from __future__ import annotations

from typing import Annotated, Final, Self

from pydantic import Field, PlainSerializer, model_validator

from manyhands.launch.session.errors import show
from manyhands.launch.session.fields import (
    Described,
    Problem,
    Quantity,
    SessionModel,
    defaulted,
    refusal,
    refuse,
)
from manyhands.launch.session.forms import either, list_of
from manyhands.launch.session.limits import MIN_POSITIVE
from manyhands.launch.session.motion import require_formula
from manyhands.nodes.kernel.bundle import OrientationPart, TurnedHand

MOST: Final = 1e6
"""The greatest number of an orientation's keys, in SI units."""


def _positive(what: str, unit: str) -> Quantity:
    return Quantity(what, unit, above=0.0, smallest=MIN_POSITIVE, most=MOST)


_NUMBER: Final = Quantity("an intended torque", "N·m", most=MOST, least=-MOST)


def _torques(value: object) -> tuple[float | str, ...]:
    """What the hand intends about x, y and z."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise refuse(show(value), "three torques in N·m, about x, y and z: numbers, or formulas in t")
    return tuple(_torque(one) for one in value)


def _torque(value: object) -> float | str:
    if not isinstance(value, str):
        return float(_NUMBER(value))
    require_formula(value)
    return value


_TORQUES_FORM: Final = list_of(either(_NUMBER.json_schema, {"type": "string"}), 3, 3)


class OrientationLimits(SessionModel):
    """The limits of an orientation, about any axis."""

    torque: Annotated[float, _positive("a torque", "N·m")] = Field(
        description="the greatest torque in N·m; beyond it the proxy follows the hand"
    )
    speed: Annotated[float, _positive("a speed", "rad/s")] = Field(
        description="the greatest angular velocity in rad/s; beyond it the device exerts no torque"
    )


class Orientation(SessionModel):
    """The orientation of a device that its hand turns, and that feels a torque.

    Raises:
        PydanticCustomError: the damping of a simulated device is below what it burns at least.
    """

    osp: Annotated[float, _positive("a level", "N·m·s/rad")] = Field(
        description="b in N·m·s/rad: the device burns b|ω|² at least"
    )
    stiffness: Annotated[float | None, _positive("a stiffness", "N·m/rad")] = Field(
        default=None, description="k in N·m/rad of the spring at the hand; the stiffest that is proved, less 1 %"
    )
    limits: OrientationLimits = Field(description="the torque and the speed that it never goes beyond")
    inertia: Annotated[float, _positive("an inertia", "kg·m²")] = Field(
        description="of the simulated device and its hand, the same about every axis, in kg·m²"
    )
    damping: Annotated[float | None, _positive("a damping", "N·m·s/rad")] = Field(
        default=None, description="of the simulated device, in N·m·s/rad; osp unless given"
    )
    torque: Annotated[tuple[float | str, ...], Described(_torques, _TORQUES_FORM), PlainSerializer(list)] = defaulted(
        (0.0, 0.0, 0.0),
        "what its simulated hand intends about the world's x, y and z, in N·m: numbers or formulas",
    )

    @model_validator(mode="after")
    def _burns_what_it_states(self) -> Self:
        if self.damping is not None and self.damping < self.osp:
            expected = f"at least the osp, {self.osp:g} N·m·s/rad, which it is said to burn"
            raise refusal(Problem(("damping",), f"{self.damping:g} N·m·s/rad", expected))
        return self

    def part(self, stiffness: float) -> OrientationPart:
        """What the device's process is given, with the spring's k, N*m/rad."""
        hand = TurnedHand(self.inertia, self.damping or self.osp, self.torque)
        return OrientationPart(self.osp, stiffness, self.limits.torque, self.limits.speed, hand)
