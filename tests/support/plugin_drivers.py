"""A driver as another package would write it, moved by the instants of its calls, and eight that are broken."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from manyhands.nodes.device.plugin import DeviceDriver
from manyhands.nodes.device.specification import NO_DELAY, DeviceSpecification, DeviceTiming
from manyhands.protocol.clock import Instant

STEP = 50_000  # ns of the integration
SLOW = 3_000_000  # ns that a blocking call takes by CALLS


class Calls:
    """A timer of calls that only a driver moves on."""

    def __init__(self) -> None:
        self.ns = 0

    def __call__(self) -> int:
        return self.ns


CALLS = Calls()


class Counterpart(DeviceDriver):
    """A mass with damping on each axis: what a package ships beside the driver of its hardware.

    Its samples are ``age`` old, and its forces act ``delay`` later, s.
    """

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        self.n = n = len(ports)
        self.mass, self.damping = parameters.get("mass", 0.2), parameters.get("damping", 1.5)
        self.step = parameters.get("step", 0.0)  # of its encoders, m
        self.dry = parameters.get("friction", 0.0)  # N
        self.clip = parameters.get("clip", 8.0)
        self.age, self.delay = (round(1e9 * parameters.get(key, 0.0)) for key in ("age", "delay"))
        self.stated = DeviceTiming(**parameters["timing"]) if "timing" in parameters else NO_DELAY
        self.hardware = bool(parameters.get("hardware", False))
        self.turning = tuple(parameters["turning"]) if "turning" in parameters else None
        self.push, self.hertz = (
            parameters.get("push", 0.0),
            parameters.get("hertz", 1.5),
        )  # of a person's hand, N and Hz
        self.now: int | None = None
        self.x, self.v, self.f = [0.0] * n, [0.0] * n, [0.0] * n
        self.commanded = [0.0] * n
        self.coming: list[tuple[int, list[float]]] = []  # forces, from an instant on
        self.done = 0.0  # by the motors, J
        self.past: list[tuple[int, list[float], float]] = []  # displacements, and what was done until then
        self.closed = False

    def specification(self) -> DeviceSpecification:
        n = self.n
        return DeviceSpecification(
            *((8.0,) * n, (0.2,) * n, (2.0,) * n, self.stated),
            mass=(self.mass,) * n, step=(self.step,) * n if self.step else None, hardware=self.hardware,
            turning=self.turning,
        )  # fmt: skip

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        self._move(at)
        wanted = at - self.age
        while len(self.past) > 1 and self.past[1][0] <= wanted:
            del self.past[0]
        return [x if self.step == 0.0 else self.step * round(x / self.step) for x in self.past[0][1]]

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        self._move(at)
        clipped = [max(-self.clip, min(self.clip, force)) for force in f]
        # what was to come later than this is replaced
        self.coming = [one for one in self.coming if one[0] <= at + self.delay] + [(at + self.delay, clipped)]
        if until is not None:
            self.coming.append((until + self.delay, [0.0] * self.n))
        self.commanded = clipped
        return None if self.age or self.delay else self.x

    def release(self, at: Instant) -> Sequence[float] | None:
        return self.apply([0.0] * self.n, at)

    def exerted(self) -> Sequence[float] | None:
        return self.commanded

    def close(self) -> None:
        self.closed = True

    def _move(self, to: int) -> None:
        now = to if self.now is None else self.now
        if self.now is None:
            self.past.append((now, list(self.x), 0.0))
        while now < to:
            end = min(to, now + STEP)
            while self.coming and self.coming[0][0] <= now:
                self.f = self.coming.pop(0)[1]
            if self.coming:
                end = min(end, self.coming[0][0])
            dt = (end - now) * 1e-9
            pushed = self.push * math.sin(2.0 * math.pi * self.hertz * now * 1e-9) if self.push else 0.0
            for i in range(self.n):
                self.v[i] += dt * (self.f[i] + pushed - self.damping * self.v[i]) / self.mass
                brake = dt * self.dry / self.mass
                self.v[i] = math.copysign(max(0.0, abs(self.v[i]) - brake), self.v[i])
                self.x[i] += dt * self.v[i]
                self.done += self.f[i] * dt * self.v[i]
            now = end
            self.past.append((now, list(self.x), self.done))
        self.now = now


class Working(Counterpart):
    """It tells the work of its motors."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        super().__init__(ports, period, parameters)
        self.seen = self.told = 0.0

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        x = super().sample(tick, at)
        self.seen = self.past[0][2]
        return x

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        x = super().apply(f, at, until)
        if x is not None:
            self.seen = self.done
        return x

    def work(self) -> float | None:
        since, self.told = self.seen - self.told, self.seen
        return since


class HoldsTorque(Working):
    """Its motors hold the torques of joints."""

    def specification(self) -> DeviceSpecification:
        return replace(super().specification(), holds_torque=True)


class WorkAgainst(Working):
    """Wrong work: that of the device on its motors."""

    def work(self) -> float | None:
        return -(super().work() or 0.0)


class WorkInMillijoules(Working):
    """Wrong work: it is not in J."""

    def work(self) -> float | None:
        return 1e3 * (super().work() or 0.0)


class WorkOfAll(Working):
    """Wrong work: all since the beginning, in every answer."""

    def work(self) -> float | None:
        return self.seen


class WorkOfOneSample(Working):
    """Wrong work: what was done since the last sample alone, however long nobody asked."""

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        self.told = self.seen
        return super().sample(tick, at)


class WorkUnknown(Working):
    """It cannot tell what a force did that its watchdog ended."""

    def work(self) -> float | None:
        super().work()
        return None


class OldSample(Counterpart):
    """Stale sample: it returns the displacement of 20 ms ago, and does not state it."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        super().__init__(ports, period, {**parameters, "age": 0.02})


class HeldSample(Counterpart):
    """Stale sample: it reads the device once in twelve calls."""

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        if tick % 12 == 0:
            self.held = list(super().sample(tick, at))
        return self.held


class Frozen(Counterpart):
    """Stale sample: it never reads the device again."""

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        return [0.0] * self.n


class NoRelease(Counterpart):
    def release(self, at: Instant) -> Sequence[float] | None:
        self._move(at)
        return self.x


class KeptOnSilence(Counterpart):
    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return super().apply(f, at)


class Watchdog(Counterpart):
    """Its device ends each force after the same time (``watchdog``, ns), whatever was asked."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        super().__init__(ports, period, parameters)
        self.watchdog = int(parameters["watchdog"])

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return super().apply(f, at, Instant(at + self.watchdog) if any(f) else None)


class MovesByItself(Counterpart):
    """A driven stage: it goes to and fro whatever the force, so a push seems to move it anyhow."""

    def specification(self) -> DeviceSpecification:
        return replace(super().specification(), moved_by_force=False)

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        return [0.02 * math.sin(-6.0 * at * 1e-9)] * self.n


class Drifting(Counterpart):
    """Its displacement creeps away, whatever the force."""

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        return [0.01 * at * 1e-9] * self.n


class Sprung(Counterpart):
    """A spring of its own holds it: ``spring``, N/m."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        super().__init__(ports, period, parameters)
        self.stiffness = float(parameters["spring"])

    def _move(self, to: int) -> None:
        now = to if self.now is None else self.now
        while now < to:
            now = min(to, now + STEP)
            self.v = [v - STEP * 1e-9 * self.stiffness * x / self.mass for v, x in zip(self.v, self.x, strict=True)]
            super()._move(now)
        super()._move(to)


class WrongSign(Counterpart):
    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return super().apply([-force for force in f], at, until)


class Millimetres(Counterpart):
    """Wrong unit."""

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        return [1e3 * x for x in super().sample(tick, at)]


class Threefold(Counterpart):
    """It exerts three times the force that it is given, beyond its own limit; by ``measures`` it measures that."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        super().__init__(ports, period, {**parameters, "clip": 100.0})
        self.measures = parameters.get("measures", False)

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return super().apply([3.0 * force for force in f], at, until)

    def exerted(self) -> Sequence[float] | None:
        return super().exerted() if self.measures else None


class Slightly(Counterpart):
    """Exerts a tenth more than it was given."""

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return super().apply([1.1 * force for force in f], at, until)

    def exerted(self) -> Sequence[float] | None:
        return None


class Unstepped(Counterpart):
    """Does not state the step of its encoder."""

    def specification(self) -> DeviceSpecification:
        return replace(super().specification(), step=None)


class Tenth(Threefold):
    """A tenth more than it is given."""

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return Counterpart.apply(self, [1.1 * force for force in f], at, until)


class LateForce(Counterpart):
    """Its forces act 2 ms late, which it does not state."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        super().__init__(ports, period, {**parameters, "delay": 0.002})

    def exerted(self) -> Sequence[float] | None:
        return self.f


class HoldsOn(Counterpart):
    """It exerts a force for 20 ms after its release."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        super().__init__(ports, period, parameters)
        self.released: int | None = None

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        self.released = None
        return super().apply(f, at, until)

    def release(self, at: Instant) -> Sequence[float] | None:
        self.released = at if self.released is None else self.released
        if at - self.released < 20_000_000:
            self._move(at)
            return None
        return Counterpart.apply(self, [0.0] * self.n, at)


class SometimesSlow(Counterpart):
    """One of its samples in a hundred waits."""

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        if tick % 100 == 50:
            CALLS.ns += SLOW
        return super().sample(tick, at)


class Millinewtons(Counterpart):
    """Wrong unit."""

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return super().apply([1e-3 * force for force in f], at, until)


class SwappedAxes(Counterpart):
    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return super().apply(list(reversed(f)), at, until)


class Blocking(Counterpart):
    """Its sample waits for the next frame of the device."""

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        CALLS.ns += SLOW
        return super().sample(tick, at)


class Endless(Counterpart):
    """A call of it returns only once somebody frees it."""

    freed = threading.Event()

    @classmethod
    def free(cls) -> None:
        """Let every call return that waits; later ones wait again."""
        before, cls.freed = cls.freed, threading.Event()
        before.set()

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        if tick == 100:
            self.freed.wait()
        return super().sample(tick, at)


class Raising(Counterpart):
    """Exception."""

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        if any(f):
            raise OSError("no such device")
        return super().apply(f, at, until)


class WrongAnswer(Counterpart):
    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        return [float("nan")] * self.n
