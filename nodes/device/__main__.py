"""``python -m manyhands.nodes.device BUNDLE SUPERVISOR_PID [COUPLING_BUNDLE ...]``; the couplings run in its loop."""

import sys
from contextlib import ExitStack
from pathlib import Path

from manyhands.nodes.device.colocated import colocated
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.device.plugin import DriverFailure
from manyhands.nodes.kernel.bundle import DeviceBundle
from manyhands.nodes.link.process import EXIT_FAILED, main, main_together


def run(carried: list[Path]) -> int:
    """Run the device and the couplings in its process, and close its driver however that ends; returns the exit code.

    Args:
        carried: the bundles of the couplings.
    """
    try:
        with ExitStack() as ending:

            def driver(bundle: DeviceBundle) -> Driver:
                made = driver_of(bundle)
                ending.callback(made.close)
                return made

            if carried:
                return main_together(DeviceBundle, lambda bundle: colocated(bundle, driver(bundle), carried))
            return main(DeviceBundle, lambda bundle: DeviceNode(bundle, driver(bundle)))
    except DriverFailure as error:  # while it was closed
        print(error, file=sys.stderr)  # noqa: T201 -- there is no line to the supervisor any more
        return EXIT_FAILED


if __name__ == "__main__":
    couplings = [Path(path) for path in sys.argv[3:]]
    del sys.argv[3:]
    sys.exit(run(couplings))
