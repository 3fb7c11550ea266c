"""A device's process whose driver logs every call.

    python -m faults.logged_device BUNDLE SUPERVISOR_PID LOG

One letter a call: ``s`` for a sample, ``a`` for a force, ``z`` for a force of zero, ``r`` for letting go.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.bundle import DeviceBundle
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.process import main

Vector = NDArray[np.float64]


class Logged:
    """A driver that keeps a log."""

    def __init__(self, driver: Driver, log: BinaryIO) -> None:
        self._driver, self._log = driver, log

    @property
    def axes(self) -> int:
        return self._driver.axes

    def sample(self, tick: int) -> Vector:
        self._log.write(b"s")
        return self._driver.sample(tick)

    def apply(self, f: Vector) -> None:
        self._log.write(b"a" if any(f) else b"z")
        self._driver.apply(f)

    def release(self) -> None:
        self._log.write(b"r")
        self._driver.release()

    def idle(self) -> None:
        self._driver.idle()

    def intended_work(self) -> float:
        return self._driver.intended_work()

    def figures(self) -> Mapping[str, float]:
        return self._driver.figures()

    def close(self) -> None:
        self._driver.close()


if __name__ == "__main__":
    path = sys.argv.pop()
    with open(path, "ab", buffering=0) as file:
        sys.exit(main(DeviceBundle, lambda bundle: DeviceNode(bundle, Logged(driver_of(bundle), file))))
