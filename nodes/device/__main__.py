"""``python -m manyhands.nodes.device BUNDLE SUPERVISOR_PID``."""

import sys

from manyhands.nodes.bundle import DeviceBundle
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.device.simulated import simulated_driver
from manyhands.nodes.process import main


def make(bundle: DeviceBundle) -> DeviceNode:
    """The node around a simulated device."""
    return DeviceNode(bundle, simulated_driver(bundle))


if __name__ == "__main__":
    sys.exit(main(DeviceBundle, make))
