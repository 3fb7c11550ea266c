"""Random devices of known damping and friction, identified in simulated time (`make identify`).

Slides in one dimension have masses of 0.04 to 0.8 kg, 0.03 to 2 N*s/m, up to 1 N of dry friction that may rise at rest
(Stribeck) and change with the place, inertia that changes with the place, gravity or a spring of their own, encoders of
1 to 50 um, noise, samples of an age that varies, and forces that act late. One in five has drag that grows faster than
the speed, by a power of 1.5 to 3; half of these have no damping beside it, so that the truth is 0. One in ten devices
is an arm of two links, whose joints have inertia, damping and dry friction; half of these hold torques. ``--deltas``
adds delta robots of three axes.

What has to hold: no lower end is above the truth (of a linkage the least at any place of its ways), neither of the
damping nor of the friction; of the intervals that do not begin at 0, which say something, 95 % hold the truth. The exit
code is 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor

from tests.support.identified_devices import DELTAS, identified, summary


def main() -> int:
    """Identify the devices, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=200)
    parser.add_argument("--deltas", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    began = time.perf_counter()
    with ProcessPoolExecutor(given.processes) as pool:
        every = []
        numbers = [*range(given.devices), *range(DELTAS, DELTAS + given.deltas)]
        for one in pool.map(identified, numbers, [given.seed] * len(numbers)):
            every.append(one)
            print(one, file=sys.stderr, flush=True)
    lines, holds = summary(every)
    print("\n".join(lines))
    print(f"{time.perf_counter() - began:.0f} s")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
