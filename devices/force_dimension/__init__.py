"""Devices of Force Dimension (delta, omega, sigma, lambda), through the maker's own library on the user's machine.

The driver's short name is ``force-dimension``. ``python -m manyhands.devices.force_dimension`` prints what a session
has to state of the device that is plugged in.
"""

from manyhands.devices.force_dimension.driver import ForceDimension
from manyhands.devices.force_dimension.library import ForceDimensionError

__all__ = ["ForceDimension", "ForceDimensionError"]
