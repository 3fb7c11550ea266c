"""What a driver states of its timing, and what is believed of it: :class:`DeviceTiming`, :class:`DriverWord`.

A driver states the greatest age of its samples, by how much the age varies, and the delay of its actuator. With age a
and delay d the force that answers a sample acts a + d later than the loop sees. So the *latency* a + d is a part of
tau, and the variation of a is a part of the period tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from manyhands.protocol.plain import Added


@dataclass(frozen=True)
class DeviceTiming:
    """How late a device measures and acts, beside the loop.

    Attributes:
        sample_age: the greatest time from the instant of a displacement to the return of ``sample``, s.
        age_jitter: by how much that age varies, s; None for all of it.
        actuation_delay: the greatest time from the call of ``apply`` until the force acts, s.

    Raises:
        ValueError: a number is negative or not finite, or the jitter is greater than the age.
    """

    sample_age: float = 0.0
    age_jitter: float | None = None
    actuation_delay: float = 0.0

    def __post_init__(self) -> None:
        for what, value in (("sample_age", self.sample_age), ("actuation_delay", self.actuation_delay)):
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{what}: found {value!r:.40}; expected a time in s, at least 0")
        if not 0.0 <= self.jitter <= self.sample_age:
            raise ValueError(f"age_jitter: found {self.jitter!r:.40}; expected from 0 s to the sample_age")

    @property
    def latency(self) -> float:
        """The part of tau that the loop does not see: age and delay together, s."""
        return round(self.sample_age + self.actuation_delay, 12)

    @property
    def jitter(self) -> float:
        """By how much the time between two samples may differ from the time between their calls, s."""
        return self.sample_age if self.age_jitter is None else self.age_jitter


SENSED: Final = "sensed"
FELT: Final = "felt"
JOINED: Final = "joined"
"""Of an orientation whose torque joints hold together with the force."""


@dataclass(frozen=True)
class DriverWord:
    """The driver of another package that a device has: what is believed of it, because nothing here can check it.

    A person's hand holds such a device, and its work is not known. So the device's ledger judges nobody.

    Attributes:
        factory: of the driver.
        sample_age: the greatest age of its samples, as the session has it, s.
        actuation_delay: the greatest delay of its forces, likewise, s.
        step: of its encoder by axis, likewise, m; None where none is stated.
        friction: what it burns at least, by axis, likewise, N; None where none is stated.
        torques: whether its motors hold joint torques from tick to tick, in place of the force.
        by_itself: what the session states that the device does by itself; its driver may state more.
        turns: whether it tells its orientation: :data:`SENSED`, :data:`FELT` with a torque, or :data:`JOINED` with one
            that joints hold; empty for none.
    """

    factory: str
    sample_age: float = 0.0
    actuation_delay: float = 0.0
    step: Added[tuple[float, ...] | None] = None
    friction: Added[tuple[float, ...] | None] = None
    torques: Added[bool] = False
    by_itself: Added[tuple[str, ...]] = ()
    turns: Added[str] = ""

    def believed(self, measured: bool) -> tuple[str, ...]:
        """Everything that rests on the driver's word; ``measured`` is whether it measures the force that it exerts."""
        found = [
            "its displacements",
            f"the age of its samples (at most {1e3 * self.sample_age:g} ms)",
            f"the delay of its forces (at most {1e3 * self.actuation_delay:g} ms) and their end",
            "its damping (osp)",
        ]
        if self.step and any(self.step):
            found.append(f"the step of its encoder (at most {1e6 * max(self.step):g} µm)")
        if self.friction:
            found.append(f"its dry friction (at least {1e3 * min(self.friction):g} mN)")
        if self.turns == JOINED:
            found += [
                "that its motors hold force and torque as torques of joints, which it reads between sample and force",
                "how these bend in all six directions",
            ]
        elif self.torques:
            found += ["that its motors hold joint torques of the stated linkage", "the work of these motors"]
        else:
            found.append("that it holds the force at the tip from tick to tick")
        if self.turns:
            found.append("its orientation")
        if self.turns in (FELT, JOINED):
            found.append("its damping in turning")
        if self.turns == FELT:
            found.append("that it holds the torque that it was given, about axes at rest")
        found.append("its own measurement of the force" if measured else "that it exerts the force that it was given")
        return tuple(found)

    def sentence(self, device: str, measured: bool) -> str:
        """What rests on the driver's word; ``measured`` is whether it measures the force that it exerts."""
        *most, last = self.believed(measured)
        return f"{device} rests on the word of its driver {self.factory}: {', '.join(most)}, and {last}"


def outside(device: str, by_itself: Sequence[str]) -> str:
    """What a device does by itself, beside what is certified, as a sentence; empty for nothing."""
    return f"{device} does by itself, outside the certificate: {'; '.join(by_itself)}" if by_itself else ""


IMPOSED: Final = "moves whatever force acts on it, as no hand does, so a run shows nothing about stability with a hand"
"""What a device does by itself that no force moves, in the words of ``by_itself``: no certificate is about it."""

NO_DELAY = DeviceTiming()
"""Of a device that measures and acts at the instants of its calls."""
