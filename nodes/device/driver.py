"""What the loop asks of a force-feedback device, whichever it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol


class Driver(Protocol):
    """A force-feedback device: displacement out, force in, one of each a tick."""

    @property
    def axes(self) -> int:
        """Number of axes."""
        ...

    def sample(self, tick: int) -> Sequence[float]:
        """The displacement x(k), m, one entry an axis, at this moment."""
        ...

    def apply(self, f: Sequence[float]) -> None:
        """Exert the force f (N) and hold it until the next call."""
        ...

    def release(self) -> None:
        """Exert no force: what a device does that hears nothing."""
        ...

    def idle(self) -> None:
        """The tick's force is applied and the next sample is not yet due: do what has been put off."""
        ...

    def intended_work(self) -> float:
        """Work done by the hand's intention between the last two samples, J; 0 where that is unknown."""
        ...

    def figures(self) -> Mapping[str, float]:
        """What is to be told of the device with its telemetry, by the names of :mod:`manyhands.nodes.telemetry`."""
        ...

    def close(self) -> None:
        """Exert no force, and give back what is held of the machine. A second time does nothing."""
        ...
