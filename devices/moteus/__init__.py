"""moteus motor controllers as one-axis devices, through fdcanusb or their UART; the short name is ``moteus``."""

from manyhands.devices.moteus.driver import Moteus
from manyhands.devices.motor_axis import MotorError

__all__ = ["Moteus", "MotorError"]
