"""The orientation of a device, where that is a port: a tool that its hand turns in space.

The device states what it burns at least (``osp``), and its limits. A simulated one turns as a body of one inertia about
every axis, whose hand intends a torque about each of the world's axes. The torque of the hand's spring follows in the
device's own process (docs/decisions/0054-orientation.md).

A *sensed* orientation has no motors, as a grip on a passive wrist. Its hand leads the tool's avatar by the spring, and
feels no torque. So it states no osp and no limits, and the certificate asks nothing of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Final, Self

from pydantic import Field, PlainSerializer, model_validator

from manyhands.launch.session.errors import show
from manyhands.launch.session.fields import (
    Described,
    Flag,
    Problem,
    Quantity,
    SessionModel,
    refusal,
    refuse,
)
from manyhands.launch.session.forms import either, list_of
from manyhands.launch.session.limits import MIN_POSITIVE
from manyhands.launch.session.motion import require_formula
from manyhands.nodes.kernel.bundle import OrientationPart, SensedPart, TurnedHand

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


def _plain(torque: tuple[float | str, ...] | None) -> list[float | str] | None:
    return None if torque is None else list(torque)


_TORQUES_FORM: Final = list_of(either(_NUMBER.json_schema, {"type": "string"}), 3, 3)


_OF_A_TORQUE: Final = ("osp", "limits")
"""The keys that only an orientation with a torque has, and needs."""

_STIFFNESS: Final = "stiffness, k in N·m/rad of the spring by which the tool's avatar follows the hand"
_OF_A_SIMULATION: Final = ("inertia", "damping", "torque")
"""The keys that only the orientation of a simulated device has."""


class OrientationLimits(SessionModel):
    """The limits of an orientation, about any axis."""

    torque: Annotated[float, _positive("a torque", "N·m")] = Field(
        description="the greatest torque in N·m; beyond it the proxy follows the hand"
    )
    speed: Annotated[float, _positive("a speed", "rad/s")] = Field(
        description="the greatest angular velocity in rad/s; beyond it the device exerts no torque"
    )


class Orientation(SessionModel):
    """The orientation of a device that its hand turns, and that feels a torque unless it is sensed alone.

    Raises:
        PydanticCustomError: the damping of a simulated device is below what it burns at least, a key of a torque is
            missing, or it stands beside a sensed orientation.
    """

    sensed: Flag = Field(default=False, description="true: orientation in, and no torque out")
    osp: Annotated[float | None, _positive("a level", "N·m·s/rad")] = Field(
        default=None, description="b in N·m·s/rad: the device burns b|ω|² at least"
    )
    stiffness: Annotated[float | None, _positive("a stiffness", "N·m/rad")] = Field(
        default=None,
        description="k in N·m/rad of the spring to the tool's avatar; the stiffest that is proved, less 1 %",
    )
    limits: OrientationLimits | None = Field(
        default=None, description="the torque and the speed that it never goes beyond"
    )
    inertia: Annotated[float | None, _positive("an inertia", "kg·m²")] = Field(
        default=None, description="of the simulated device and its hand, the same about every axis, in kg·m²"
    )
    damping: Annotated[float | None, _positive("a damping", "N·m·s/rad")] = Field(
        default=None, description="of the simulated device, in N·m·s/rad; osp unless given"
    )
    torque: Annotated[tuple[float | str, ...] | None, Described(_torques, _TORQUES_FORM), PlainSerializer(_plain)] = (
        Field(
            default=None,
            description="what its simulated hand intends about the world's x, y and z, in N·m: numbers or formulas; "
            "0 unless given",
        )
    )

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        if problems := tuple(self._problems()):
            raise refusal(*problems)
        return self

    def _problems(self) -> Iterator[Problem]:
        """A problem for each key that a torque needs, or that a sensed orientation does not use or lacks."""
        fields = type(self).model_fields
        for key in _OF_A_TORQUE:
            if self.sensed and getattr(self, key) is not None:
                yield Problem((key,), f"{key} with sensed: true", f"no {key}: no motor turns a sensed device")
            if not self.sensed and getattr(self, key) is None:
                yield Problem((), f"no key '{key}'", f"{key}, {fields[key].description}; or sensed: true")
        if self.sensed and self.stiffness is None:
            yield Problem((), "no key 'stiffness' with sensed: true", _STIFFNESS)
        if self.damping is not None and self.osp is not None and self.damping < self.osp:
            expected = f"at least the osp, {self.osp:g} N·m·s/rad, which it is said to burn"
            yield Problem(("damping",), f"{self.damping:g} N·m·s/rad", expected)

    def problems_with(self, simulated: bool, here: str) -> Iterator[Problem]:
        """A problem for each key that the device's driver needs and lacks, or does not use; ``here`` names it."""
        needed = ("inertia", "damping") if self.sensed else ("inertia",)
        for key in needed if simulated else ():
            if getattr(self, key) is None:
                yield Problem((), f"no key '{key}' {here}", f"{key}, {type(self).model_fields[key].description}")
        for key in () if simulated else _OF_A_SIMULATION:
            if getattr(self, key) is not None:
                yield Problem((key,), f"{key} {here}", f"no {key}: the driver's device and its user have their own")

    def part(self, stiffness: float) -> OrientationPart | SensedPart:
        """What the device's process is given, with the spring's k, N*m/rad."""
        damping, hand = self.damping or self.osp, None
        if self.inertia is not None and damping is not None:  # of a simulated device
            hand = TurnedHand(self.inertia, damping, self.torque or (0.0, 0.0, 0.0))
        if self.osp is None or self.limits is None:
            return SensedPart(stiffness, hand)
        return OrientationPart(self.osp, stiffness, self.limits.torque, self.limits.speed, hand)
