"""Drivers of real devices, each a package of its own, as a stranger's would be.

They use what any other package has: the entry points ``manyhands.drivers``, and
:class:`manyhands.nodes.device.plugin.DeviceDriver`. Nothing else of manyhands imports them.
What several of them stand on is beside them: ``serial_port.py``.
"""
