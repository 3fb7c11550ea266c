"""Steering wheels and joysticks with force feedback, by the kernel's event devices (Linux).

``event_device.py`` speaks to the kernel, ``bus.py`` reads what it knows of the way to the device, and ``driver.py`` is
the driver. Its short name is ``evdev-wheel``.
"""

from manyhands.devices.evdev.driver import EvdevWheel, WheelError

__all__ = ["EvdevWheel", "WheelError"]
