"""A device's process whose driver logs every call.

    python -m faults.logged_device BUNDLE SUPERVISOR_PID LOG

One letter a call: ``s`` for a sample, ``a`` for a force, ``z`` for a force of zero, ``r`` for letting go, and ``e`` for
an earlier end of the force that is exerted, which the interface sets at the sample.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import BinaryIO

from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.kernel.bundle import DeviceBundle
from manyhands.nodes.link.process import main
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Figures


class Logged:
    """A driver that keeps a log."""

    def __init__(self, driver: Driver, log: BinaryIO) -> None:
        self._driver, self._log = driver, log
        self._sampled = Instant(-1)

    @property
    def axes(self) -> int:
        return self._driver.axes

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        self._log.write(b"s")
        self._sampled = at
        return self._driver.sample(tick, at)

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float]:
        self._log.write(b"e" if at == self._sampled else b"a" if any(f) else b"z")
        return self._driver.apply(f, at, until)

    def release(self, at: Instant) -> Sequence[float]:
        self._log.write(b"r")
        return self._driver.release(at)

    def idle(self, due: Instant) -> None:
        self._driver.idle(due)

    def intended_work(self) -> float:
        return self._driver.intended_work()

    def figures(self) -> Figures:
        return self._driver.figures()

    def close(self) -> None:
        self._driver.close()


if __name__ == "__main__":
    path = sys.argv.pop()
    with open(path, "ab", buffering=0) as file:
        sys.exit(main(DeviceBundle, lambda bundle: DeviceNode(bundle, Logged(driver_of(bundle), file))))
