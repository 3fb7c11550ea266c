"""Drivers of an arm of two links whose motors hold torques, and which tell their work; two of them tell another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from manyhands.protocol.clock import Instant

from .held_arm import Arm
from .plugin_drivers import STEP, Counterpart


class Jointed(Counterpart):
    """The mass of a :class:`Counterpart` behind the joints of an arm; its samples are whole steps at its tip."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        super().__init__(ports, period, parameters)
        self.arm, self.x, self.v = Arm((0.3, 1.6)), np.zeros(2), np.zeros(2)
        self.torque, self.told = np.zeros(2), 0.0

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        self._move(at)
        self.read = np.array(super().sample(tick, at))
        return self.read.tolist()

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        self._move(at)
        self.commanded, self.until = list(f), until
        self.torque = self.arm.torque(np.array(f), self.read)
        return list(map(float, self.x))

    def work(self) -> float | None:
        since, self.told = self.done - self.told, self.done
        return since

    def _move(self, to: int) -> None:
        now = to if self.now is None else self.now
        until = getattr(self, "until", None)
        while now < to:
            if until is not None and until <= now:
                self.torque, until = np.zeros(2), None
            end = min([to, now + STEP, *([] if until is None else [until])])
            dt = (end - now) * 1e-9
            q = self.arm.joints(self.x)
            push = np.linalg.solve(self.arm.jacobian(q).T, self.torque)
            pushed = self.push * np.sin(2.0 * np.pi * self.hertz * now * 1e-9) * np.array([1.0, 0.5])
            self.v = self.v + dt * (push + pushed - self.damping * self.v) / self.mass
            self.x = self.x + dt * self.v
            self.done += float(self.torque @ (self.arm.joints(self.x) - q))
            now = end
        self.now = now
        self.past = [(now, self.x, self.done)]


class Against(Jointed):
    """Wrong work: that of the device on its motors."""

    def work(self) -> float | None:
        return -(super().work() or 0.0)


class Halved(Jointed):
    """Wrong work: that of one motor of two, as it were."""

    def work(self) -> float | None:
        return 0.5 * (super().work() or 0.0)
