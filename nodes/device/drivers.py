"""Which driver a device's bundle asks for."""

from __future__ import annotations

from manyhands.nodes.bundle import BrowserHand, DeviceBundle, RecordedMotion, SimulatedHand
from manyhands.nodes.device.browser import BrowserDriver, grip_of
from manyhands.nodes.device.driver import Driver
from manyhands.nodes.device.simulated import simulated_driver
from manyhands.nodes.device.trace import TraceDriver


def driver_of(bundle: DeviceBundle) -> Driver:
    """The device itself; whoever asked for it closes it.

    Raises:
        ValueError: the bundle's numbers make no device.
        TransportError: its grip cannot be opened.
    """
    T = bundle.common.period
    match bundle.source:
        case SimulatedHand() as hand:
            return simulated_driver(hand, T)
        case RecordedMotion() as motion:
            return TraceDriver(motion, T)
        case BrowserHand(physics):
            return BrowserDriver(physics, bundle.limits, T, grip_of(bundle.common))
