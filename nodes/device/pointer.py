"""The browser driver: a simulated device that a person with a browser holds and drags. No haptic loop: nothing is felt.

The person gives a trajectory, as the intended motion of a simulated hand: a spring and a damper between the device and
the pointer, which is smoothed (:mod:`manyhands.nodes.device.smoother`). What the coupling does to that hand is that of
every simulated device, and the work that the motion does is in the ledger.

Held by nobody the hand is open: the device is a mass with its damping. An opening hand forgets its spring's tension and
its operator's state, and a closing one begins at rest on the device, its spring slack. So either way the energy that is
stored in it is lost or 0, and the hand, whose parameters change with time, is passive all the same. Its mass stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from manyhands.nodes.bundle import SIMULATED, Common, Limits
from manyhands.nodes.bundle_sources import SimulatedHand
from manyhands.nodes.device.grip import Grip
from manyhands.nodes.device.plant import Intention, Plant, PlantDriver, bare_device_of, device_of
from manyhands.nodes.device.smoother import Follower
from manyhands.protocol.transport.grip import GripInlet

REACH: Final = 0.8
"""Of the device's limit of displacement: how far the pointer draws it; the rest is for what others do to it."""

SPEED: Final = 0.5
"""m/s, and also of the device's limit of speed: how fast the pointer draws it; likewise."""

ACCELERATION: Final = 20.0
"""m/s^2, the most."""

RATE: Final = 30.0
"""rad/s, of the follower: some 0.1 s behind a hand that moves steadily."""


class BrowserDriver(PlantDriver):
    """A :class:`manyhands.nodes.device.driver.Driver` around a device that is held, or not."""

    def __init__(self, hand: SimulatedHand, limits: Limits, T: float, inlet: GripInlet | None) -> None:
        """Start at rest in x = 0, held by nobody.

        Args:
            hand: the device, and the hand that holds it to the pointer.
            limits: the device's own.
            T: period, s.
            inlet: where a person's hand is heard, closed by the driver; None where nobody can be.

        Raises:
            ValueError: no device can be made of it.
        """
        self._inlet = inlet
        self._held, self._bare = Plant(device_of(hand), T), Plant(bare_device_of(hand), T)
        super().__init__(self._bare)
        speed = [min(SPEED, SPEED * limit) for limit in limits.speed]
        self._follower = Follower([REACH * most for most in limits.displacement], speed, ACCELERATION, RATE, T)
        self._grip = Grip(self.axes, self._follower.within, T)
        self._at_rest = Intention(self._zero, self._zero)

    def figures(self) -> Mapping[str, float]:
        """Whether it is held, and what was said at its grip."""
        return self._grip.figures(0 if self._inlet is None else self._inlet.malformed)

    def close(self) -> None:
        """Close the grip. A second time does nothing."""
        if self._inlet is not None:
            self._inlet.close()

    def _intend(self, tick: int) -> Intention:
        if self._inlet is not None:
            self._grip.tick(self._inlet.latest())
        goal = self._grip.goal
        if goal is None:
            self._become(self._bare)
            return self._at_rest
        if self._plant is not self._held:
            self._become(self._held)
            self._follower.begin(self._state[: self._m])
        return Intention(self._zero, self._follower.step(goal))

    def _become(self, plant: Plant) -> None:
        """The hand opens, or closes: the device's motion goes on, and what the hand stored does not."""
        if self._plant is not plant:
            m = self._m
            self._plant, self._state = plant, plant.holding(self._state[:m], self._state[m : 2 * m])


def grip_of(common: Common) -> GripInlet | None:
    """Where the device of a bundle can be held; None under the simulated clock, and without a session's directory.

    Raises:
        TransportError: it cannot be opened.
    """
    if common.clock == SIMULATED or not common.directory:
        return None
    return GripInlet(Path(common.directory), common.name)
