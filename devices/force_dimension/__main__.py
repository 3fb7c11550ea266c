"""What a session has to state of a device that is plugged in: ``python -m manyhands.devices.force_dimension``.

It prints the limits, times and step of the device, and kappa in its box, as lines of a session file. No force is
exerted. The library is loaded and runs.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from typing import Any

from manyhands.devices.force_dimension import survey
from manyhands.devices.force_dimension.driver import ForceDimension
from manyhands.devices.force_dimension.library import ForceDimensionError


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the lines; returns the exit code: 0, or 2 where the device is not usable."""
    parser = argparse.ArgumentParser(prog="python -m manyhands.devices.force_dimension", description=__doc__)
    parser.add_argument("--library", help="the path of libdrd")
    parser.add_argument("--device", type=int, help="which of the devices that are plugged in, from 0")
    parser.add_argument("--serial", type=int, help="its serial number, in place of --device")
    parser.add_argument("--reach", type=float, help="how far it goes from 0 on each axis, m")
    given: dict[str, Any] = {name: value for name, value in vars(parser.parse_args(arguments)).items() if value}
    try:
        driver = ForceDimension(("x", "y", "z"), 1e-3, given)
        try:
            stated = driver.specification()
            kappa = survey.bending(driver.kinematics, stated.displacement[0])
        finally:
            driver.close()
    except (ForceDimensionError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)  # noqa: T201 -- the command's own error channel
        return 2
    limits = f"force: {stated.force[0]:g}, displacement: {stated.displacement[0]:g}, speed: {stated.speed[0]:g}"
    lines = (
        f"# {driver.kinematics.name}: in the cube of {stated.displacement[0]:g} m either way",
        "dof: 3",
        "driver: force-dimension",
        f"sample_age: {stated.timing.sample_age:g}",
        f"actuation_delay: {stated.timing.actuation_delay:g}",
        f"limits: {{{limits}}}",
        f"step: {1e-6 * math.ceil(1e6 * max(stated.step or (0.0,))):.3g}",
        "held: torque",
        f"linkage: {{kappa: {math.ceil(10.0 * kappa) / 10.0:g}}}  # searched on a grid, with 5 % added; not proved",
    )
    print("\n".join(lines))  # noqa: T201 -- what the command is for
    return 0


if __name__ == "__main__":
    sys.exit(main())
