"""What a device may exert and reach, axis by axis: checked at the device itself, last before its actuator.

A certificate speaks of energy and not of size: a session can be certified and still ask for more than a mechanism or a
hand should bear. The defaults stop nothing but a runaway; who knows the device states its own.

What a device may put into the *others* is watched by the environment, which scales a party beyond it down
(docs/decisions/0029-energy-budgets.md). No honest device puts more into the world than its greatest force at its
greatest speed, or over its whole reach; and no hand more than :data:`HAND_POWER` and :data:`HAND_ENERGY`.
"""

import math
from typing import Annotated, Final

from pydantic import BeforeValidator, Field, ValidationInfo

from manyhands.launch.session.fields import DEVICE_AXES, Dof, PerAxis, Quantity, SessionModel, defaulted
from manyhands.launch.session.limits import (
    DEFAULT_DISPLACEMENT,
    DEFAULT_FORCE,
    DEFAULT_SPEED,
    HAND_ENERGY,
    HAND_POWER,
    MIN_POSITIVE,
)

_FORCE: Final = Quantity("a limit of the force", "N", above=0.0, smallest=MIN_POSITIVE)
_DISPLACEMENT: Final = Quantity("a limit of the displacement", "m", above=0.0, smallest=MIN_POSITIVE)
_SPEED: Final = Quantity("a limit of the speed", "m/s", above=0.0, smallest=MIN_POSITIVE)
_POWER: Final = Quantity("a power put into the others", "W", above=0.0, smallest=MIN_POSITIVE)
_ENERGY: Final = Quantity("an energy put into the others", "J", above=0.0, smallest=MIN_POSITIVE)


def _power(value: object, info: ValidationInfo) -> object:
    """P, W; by default the greatest force at the greatest speed, summed over the axes, and at most a hand's."""
    return _POWER(value) if value is not None else min(HAND_POWER, _products(info, "speed"))


def _energy(value: object, info: ValidationInfo) -> object:
    """E, J; by default the greatest force over the reach, there and back, and at most a hand's."""
    return _ENERGY(value) if value is not None else min(HAND_ENERGY, 2.0 * _products(info, "displacement"))


def _products(info: ValidationInfo, quantity: str) -> float:
    """The sum over the axes of force times ``quantity``; infinite where one of the two was refused."""
    forces, others = info.data.get("force"), info.data.get(quantity)
    if not forces or not others or len(forces) != len(others):
        return math.inf
    return float(sum(force * other for force, other in zip(forces, others, strict=True)))


class PortLimits(SessionModel):
    """The greatest sizes at a device's ports; every tuple has one entry for each axis.

    Units are those of a translational axis; of a rotational one N·m, rad and rad/s. A force beyond its limit is
    clipped; beyond a displacement or a speed the device lets go. Power and energy are the whole device's.
    """

    dof: Dof = Field(alias=DEVICE_AXES, exclude=True, repr=False)
    force: Annotated[tuple[float, ...], BeforeValidator(PerAxis(_FORCE))] = defaulted(
        DEFAULT_FORCE, "the greatest force in N that is applied, either way: a number, or one for each axis"
    )
    displacement: Annotated[tuple[float, ...], BeforeValidator(PerAxis(_DISPLACEMENT))] = defaulted(
        DEFAULT_DISPLACEMENT, "the greatest displacement in m from 0: a number, or one for each axis"
    )
    speed: Annotated[tuple[float, ...], BeforeValidator(PerAxis(_SPEED))] = defaulted(
        DEFAULT_SPEED, "the greatest speed in m/s: a number, or one for each axis"
    )
    power: Annotated[float, BeforeValidator(_power)] = defaulted(
        None, "the power in W that it may put into the other users for as long as it likes"
    )
    energy: Annotated[float, BeforeValidator(_energy)] = defaulted(
        None, "the energy in J that it may put into the other users at once"
    )
