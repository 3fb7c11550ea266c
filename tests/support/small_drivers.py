"""Drivers of small devices, in their own time and in wall time, for what every driver must do."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import cycle
from typing import Any

import numpy as np

from manyhands.design.models.device import held_device
from manyhands.design.models.statespace import StateSpace
from manyhands.design.passivity.operators import RationalMatrix
from manyhands.nodes.device.drivers import Driver, TraceDriver, WallTimeTrace
from manyhands.nodes.device.pointer import PointerHand, browser_goal
from manyhands.nodes.device.simulated import (
    Hand,
    HeldDeviceDriver,
    IntentHand,
    OwnTimeDriver,
    Plant,
    bare_device_of,
    device_of,
)
from manyhands.nodes.kernel.bundle import Limits, RecordedMotion, SimulatedHand
from manyhands.nodes.kernel.intent import intent_from
from manyhands.protocol.messages import Grasp, Release

T = 1e-3


def held(hand: Hand, wall: bool) -> Driver:
    return HeldDeviceDriver(hand, T) if wall else OwnTimeDriver(hand)


@lru_cache
def operated(axes: int, stiffness: float, wall: bool) -> Plant:
    """A plant whose hand has the operator of Example 1 on every axis; plants keep no state."""
    entry = ((0.02, 1.2, 20.0), (1.0, 10.3, 100.0))
    none = ((0.0,), (1.0,))
    operator = RationalMatrix(tuple(tuple(entry if i == j else none for j in range(axes)) for i in range(axes)))
    device = held_device([0.2] * axes, [1.37] * axes, operator.realisation(), [0.5] * axes, [stiffness] * axes)
    return Plant(device, T, wall)


def simulated(force: str = "0", motion: str = "0", axes: int = 2, stiffness: float = 0.0, wall: bool = False) -> Driver:
    forces, motions = [intent_from(force)] * axes, [intent_from(motion)] * axes
    return held(IntentHand(operated(axes, stiffness, wall), forces, motions, T), wall)


def trace(wall: bool = False) -> Driver:
    times = tuple(0.004 * k for k in range(30))
    motion = RecordedMotion(1.37 * np.eye(2), times, tuple(tuple(0.01 * t * a for t in times) for a in (1, -3)))
    return WallTimeTrace(motion, T) if wall else TraceDriver(motion, T)


class Said:
    """An inlet that repeats one message."""

    malformed = 0

    def __init__(self, *said: Grasp | Release | None) -> None:
        self._said = cycle(said)
        self.closed = 0

    def latest(self) -> Grasp | Release | None:
        return next(self._said)

    def close(self) -> None:
        self.closed += 1


@lru_cache
def browser_plants(axes: int, wall: bool) -> tuple[Plant, Plant]:
    """The device in the hand at the pointer, and in the open hand; plants keep no state."""
    hand = SimulatedHand(
        (0.2,) * axes, (1.37,) * axes, StateSpace.static(np.zeros((axes, axes))), (5.0,) * axes, (200.0,) * axes,
        (0.0,) * axes, (0.0,) * axes,
    )  # fmt: skip
    return Plant(device_of(hand), T, wall), Plant(bare_device_of(hand), T, wall)


def browser(*said: Grasp | Release | None, axes: int = 2, wall: bool = False) -> Driver:
    inlet: Any = Said(*said) if said else None
    limits = Limits((30.0,) * axes, (0.1,) * axes, (3.0,) * axes)
    return held(PointerHand(*browser_plants(axes, wall), limits, T, browser_goal(T, inlet)), wall)


def dragged(wall: bool = False) -> Driver:
    """Held, let go and held elsewhere, all the time."""
    said = Grasp(np.array([0.05, -0.02])), None, None, Release(), None, Grasp(np.array([0.3, 0.0]))
    return browser(*said, wall=wall)


def waving(wall: bool = False) -> Driver:
    return simulated("sin(9*t)", wall=wall)


def carried(wall: bool = False) -> Driver:
    """A hand with an intended motion and a spring."""
    return simulated("0.5*sin(40*t)", "0.01*sin(30*t)", stiffness=200.0, wall=wall)


Make = Callable[[], Driver]


def in_wall_time(make: Callable[..., Driver]) -> Make:
    def made() -> Driver:
        return make(wall=True)

    made.__name__ = f"{make.__name__}_in_wall_time"
    return made


def both(*makes: Callable[..., Driver]) -> list[Make]:
    return [*makes, *map(in_wall_time, makes)]
