"""ODrive motor controllers (firmware 0.6) as one-axis devices, by their ASCII protocol; short name ``odrive``."""

from manyhands.devices.motor_axis import MotorError
from manyhands.devices.odrive.driver import ODrive

__all__ = ["MotorError", "ODrive"]
