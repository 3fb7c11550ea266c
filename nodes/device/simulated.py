"""The simulated driver: a mass held by a simulated hand, whose intention is a function of time."""

from __future__ import annotations

from collections.abc import Sequence

from manyhands.design.device import HeldDevice
from manyhands.nodes.bundle_sources import SimulatedHand
from manyhands.nodes.device.intent import Intent, intent_from
from manyhands.nodes.device.plant import Intention, Plant, PlantDriver, device_of


class SimulatedDriver(PlantDriver):
    """A :class:`manyhands.nodes.device.driver.Driver` around a :class:`HeldDevice`."""

    def __init__(self, device: HeldDevice, force: Sequence[Intent], motion: Sequence[Intent], T: float) -> None:
        """Start at rest in x = 0.

        Args:
            device: the device with its hand, m axes.
            force: the intended force (N) of each axis as a function of time (s).
            motion: the intended motion (m) of each axis as a function of time (s).
            T: period, s.
        """
        super().__init__(Plant(device, T))
        self._force, self._motion, self._T = tuple(force), tuple(motion), T

    def _intend(self, tick: int) -> Intention:
        T = self._T
        t = tick * T
        goal = [(motion(t + T) - motion(t)) / T for motion in self._motion]
        return Intention([force(t) for force in self._force], goal)


def simulated_driver(hand: SimulatedHand, T: float) -> SimulatedDriver:
    """The simulated device and hand that a bundle describes; ``T``: period, s.

    Raises:
        ValueError: no device, or no intention, can be made of it.
    """
    forces, motions = ([intent_from(data) for data in every] for every in (hand.force, hand.motion))
    return SimulatedDriver(device_of(hand), forces, motions, T)
