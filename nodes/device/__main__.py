"""``python -m manyhands.nodes.device BUNDLE SUPERVISOR_PID [COUPLING_BUNDLE ...]``; the couplings run in its loop."""

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.device.plugin import DriverFailure
from manyhands.nodes.kernel.bundle import CouplingBundle, DeviceBundle, load
from manyhands.nodes.link.process import EXIT_FAILED, Node, main_together


def run(couplings: Sequence[Path]) -> int:
    """Run the device and the couplings in its process, and close its driver however that ends; returns the exit code.

    Args:
        couplings: the bundles of the couplings, in the order of the session.
    """
    try:
        with ExitStack() as ending:

            def nodes(bundle: DeviceBundle) -> list[tuple[DeviceBundle | CouplingBundle, Node]]:
                driver = driver_of(bundle)
                ending.callback(driver.close)
                return together(bundle, driver, couplings)

            return main_together(DeviceBundle, nodes)
    except DriverFailure as error:  # while it was closed
        print(error, file=sys.stderr)  # noqa: T201 -- there is no line to the supervisor any more
        return EXIT_FAILED


def together(
    device: DeviceBundle, driver: Driver, couplings: Sequence[Path]
) -> list[tuple[DeviceBundle | CouplingBundle, Node]]:
    """The nodes of the process with their bundles: the device, whose loop runs the ticks of all, then its couplings.

    Args:
        device: the bundle of the device.
        driver: the device itself.
        couplings: the bundles of the couplings, in the order of the session.

    Raises:
        BundleError: a coupling's bundle cannot be read.
    """
    inside = [(bundle, CouplingNode(bundle)) for bundle in (load(path, CouplingBundle) for path in couplings)]
    return [(device, DeviceNode(device, driver, inside=[node for _, node in inside])), *inside]


if __name__ == "__main__":
    carried = [Path(path) for path in sys.argv[3:]]
    del sys.argv[3:]
    sys.exit(run(carried))
