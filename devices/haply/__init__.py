"""Haply's Inverse3 through the maker's own service on this machine, a WebSocket; short name ``haply-inverse3``.

The wire is in :mod:`manyhands.devices.haply.channel`, what the service says in ``service.py``, the work of the motors
in ``work.py``, and the driver in ``driver.py``. ``docs/devices/haply-inverse3.md`` has the sources.
"""

from manyhands.devices.haply.driver import HaplyInverse3
from manyhands.devices.haply.service import HaplyError

__all__ = ["HaplyError", "HaplyInverse3"]
