"""The row of an ODrive in the campaign of faults (tests/system/device_faults.py)."""

from __future__ import annotations

from typing import Final

from ..fakes.far_side import Given
from ..fakes.odrive import fake_odrive
from .device_row import Fault
from .device_row_motor_axis import AT_ONCE, motor_row


class ODriveWire:
    """The torques on an ODrive's wire, by the maker's page of the ASCII protocol.

    Attributes:
        given: the torques, in the order in which they came.
    """

    def __init__(self) -> None:
        self.given: list[Given] = []
        self._lives = 0.0

    def take(self, line: str, at: int) -> None:
        """A line that was read at an instant, ns."""
        match line.partition("*")[0].split():
            case ["w", "axis0.config.watchdog_timeout", time]:
                self._lives = float(time)
            case ["c", "0", torque]:
                self.given.append(Given(at, at + int(1e9 * self._lives), (float(torque),)))


ODRIVE: Final = motor_row(
    "odrive",
    fake_odrive,
    ODriveWire,
    {
        "emergency stop": Fault(
            ["hold 0x2000000"],
            AT_ONCE,
            "disarm reason ESTOP_REQUESTED",
            then=["free"],
            after="cannot be made: found MotorError",
        ),
    },
    precision=1e-5,  # it is given six digits
)
