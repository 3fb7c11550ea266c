"""``python -m manyhands.nodes.device BUNDLE SUPERVISOR_PID [COUPLING_BUNDLE ...]``: couplings that it carries."""

import sys
from pathlib import Path

from manyhands.nodes.bundle import DeviceBundle
from manyhands.nodes.device.colocated import colocated
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.device.simulated import simulated_driver
from manyhands.nodes.process import main, main_together


def make(bundle: DeviceBundle) -> DeviceNode:
    """The node around a simulated device."""
    return DeviceNode(bundle, simulated_driver(bundle))


if __name__ == "__main__":
    carried = [Path(path) for path in sys.argv[3:]]
    del sys.argv[3:]
    sys.exit(
        main_together(DeviceBundle, lambda device: colocated(device, carried)) if carried else main(DeviceBundle, make)
    )
