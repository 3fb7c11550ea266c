"""What a device may exert and reach, axis by axis: checked at the device itself, last before its actuator.

A certificate speaks of energy and not of size: a session can be certified and still ask for more than a mechanism or a
hand should bear. The defaults stop nothing but a runaway; who knows the device states its own.
"""

from typing import Annotated, Final

from pydantic import BeforeValidator, Field

from manyhands.launch.session.fields import DEVICE_AXES, Dof, PerAxis, Quantity, SessionModel, defaulted
from manyhands.launch.session.limits import DEFAULT_DISPLACEMENT, DEFAULT_FORCE, DEFAULT_SPEED, MIN_POSITIVE

_FORCE: Final = Quantity("a limit of the force", "N", above=0.0, smallest=MIN_POSITIVE)
_DISPLACEMENT: Final = Quantity("a limit of the displacement", "m", above=0.0, smallest=MIN_POSITIVE)
_SPEED: Final = Quantity("a limit of the speed", "m/s", above=0.0, smallest=MIN_POSITIVE)


class PortLimits(SessionModel):
    """The greatest sizes at a device's ports; every tuple has one entry for each axis.

    Units are those of a translational axis; of a rotational one N·m, rad and rad/s. A force beyond its limit is
    clipped; a displacement or a speed beyond ends the session.
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
