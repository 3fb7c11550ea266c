"""What moved the devices of a recorded session: what can be computed again, and what was a person's doing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.session import Session
from manyhands.nodes.bundle import SIMULATED, DeviceBundle
from manyhands.nodes.device.driver import Driver
from manyhands.nodes.device.drivers import driver_of

COMPUTED: Final = frozenset({"simulated", "trace"})
"""Drivers whose motion follows from the session and the forces alone."""


def given_devices(session: Session, clock: str) -> tuple[str, ...]:
    """The devices whose motion only a recording knows, since a person moved them; nobody does in simulated time."""
    if clock == SIMULATED:
        return ()
    return tuple(name for name, device in session.devices.items() if device.driver not in COMPUTED)


def hand_of(bundle: DeviceBundle, session: Session, clock: str) -> Driver | None:
    """The device and its hand, at rest; None where a person was the hand."""
    return None if bundle.common.name in given_devices(session, clock) else driver_of(bundle)


class GivenMotion:
    """A :class:`manyhands.nodes.device.driver.Driver` that moves as was recorded, whatever is exerted on it.

    Attributes:
        ticks: as many as were recorded without a gap.
    """

    def __init__(self, x: NDArray[np.float64]) -> None:
        """``x``: ticks x axes, m."""
        self._x = x
        holes = np.flatnonzero(~np.isfinite(x).all(axis=1))
        self.ticks = int(holes[0]) if len(holes) else len(x)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return int(self._x.shape[1])

    def sample(self, tick: int) -> list[float]:
        """Where it was at that tick, m."""
        row: list[float] = self._x[tick].tolist()
        return row

    def apply(self, f: Sequence[float]) -> None:
        """The force is not felt."""

    def release(self) -> None:
        """There is none."""

    def idle(self) -> None:
        """Nothing was put off."""

    def intended_work(self) -> float:
        """Unknown."""
        return 0.0

    def figures(self) -> Mapping[str, float]:
        """None."""
        return {}

    def close(self) -> None:
        """Nothing is held."""
