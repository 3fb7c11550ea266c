"""Random devices to identify: their physics, encoders, noise, age and delay are code of their own, in simulated time.

Three kinds: a slide with dry friction that changes with place and speed, and inertia that changes with the place; two
links in a plane whose joints have inertia, damping and dry friction, whose motors may hold torques; and a delta robot,
likewise, with a mass at its tip.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.device.plugin import DeviceDriver
from manyhands.nodes.device.specification import TIMES, DeviceSpecification, DeviceTiming
from manyhands.protocol.clock import Instant

Floats = list[float]


@dataclass
class Slide:
    """m(x) x'' + m'(x) x'^2/2 = f + g + k x - b x' - (c(x, x') + drag |x'|^power) sgn(x')."""

    m: float = 0.2
    b: float = 0.3
    c: float = 0.1
    teeth: float = 0.0
    pitch: float = 0.02
    static: float = 0.0
    stribeck: float = 0.01
    slope: float = 0.0
    g: float = 0.0
    k: float = 0.0
    drag: float = 0.0
    power: float = 2.0
    x: float = 0.0
    v: float = 0.0
    extra: float = field(default=0.0, init=False)

    @property
    def axes(self) -> int:
        return 1

    def place(self) -> Floats:
        return [self.x]

    def level(self, x: float, v: float) -> float:
        rest = self.static * math.exp(-min(700.0, (v / self.stribeck) ** 2))
        return self.c + self.teeth * 0.5 * (1.0 - math.cos(2.0 * math.pi * x / self.pitch)) + rest

    def hold(self, f: Floats) -> None:
        self._f = f[0]

    def step(self, h: float) -> None:
        x, v = self.x, self.v
        m, dm = self.m * (1.0 + self.slope * x), self.m * self.slope
        push, c = self._f + self.g + self.k * x - 0.5 * dm * v * v, self.level(x, v)
        if v == 0.0 and abs(push) <= c:
            return
        way = math.copysign(1.0, v if v else push)
        b = self.b + self.drag * abs(v) ** (self.power - 1.0)
        a = (push - b * v - c * way) / (m + 0.5 * b * h)
        after = v + a * h
        if after * way < 0.0:
            h, after = -v / a, 0.0
        self.x, self.v = x + 0.5 * h * (v + after), after

    def damping(self, x: Sequence[float] = (0.0,)) -> NDArray[np.float64]:
        return np.array([[self.b]])

    def friction(self, u: NDArray[np.float64]) -> float:
        """The least at speed, in any place."""
        return self.c


@dataclass
class Arm:
    """Two links whose joints have masses at their ends, damping and dry friction; x is the tip's way from home."""

    lengths: tuple[float, float] = (0.14, 0.14)
    masses: tuple[float, float] = (0.08, 0.12)
    damping_of_joints: tuple[float, float] = (0.004, 0.003)
    friction_of_joints: tuple[float, float] = (0.004, 0.003)
    home: tuple[float, float] = (-0.1, 1.7)
    torques: bool = False
    q: Floats = field(default_factory=list)
    w: Floats = field(default_factory=lambda: [0.0, 0.0])

    def __post_init__(self) -> None:
        self.q = list(self.home)
        self._origin = self.tip(self.q)
        self._t = [0.0, 0.0]
        self._f = [0.0, 0.0]

    @property
    def axes(self) -> int:
        return 2

    def tip(self, q: Sequence[float]) -> Floats:
        a, b = self.lengths
        return [a * math.cos(q[0]) + b * math.cos(q[0] + q[1]), a * math.sin(q[0]) + b * math.sin(q[0] + q[1])]

    def joints(self, x: Sequence[float]) -> Floats:
        """The angles at a displacement, with the elbow on the side where it was at home."""
        a, b = self.lengths
        X, Y = x[0] + self._origin[0], x[1] + self._origin[1]
        elbow = math.copysign(math.acos((X * X + Y * Y - a * a - b * b) / (2.0 * a * b)), self.home[1])
        return [math.atan2(Y, X) - math.atan2(b * math.sin(elbow), a + b * math.cos(elbow)), elbow]

    def jacobian(self, q: Sequence[float]) -> tuple[float, float, float, float]:
        a, b = self.lengths
        s, c = math.sin(q[0] + q[1]), math.cos(q[0] + q[1])
        return -a * math.sin(q[0]) - b * s, -b * s, a * math.cos(q[0]) + b * c, b * c

    def place(self) -> Floats:
        tip = self.tip(self.q)
        return [tip[0] - self._origin[0], tip[1] - self._origin[1]]

    def hold(self, f: Floats) -> None:
        """Hold a force, or the torques that stand for it."""
        if self.torques:
            self._t = f
        else:
            self._f = f
            self._turn()

    def _turn(self) -> None:
        A, B, C, D = self.jacobian(self.q)
        self._t = [A * self._f[0] + C * self._f[1], B * self._f[0] + D * self._f[1]]

    def step(self, h: float) -> None:
        if not self.torques:
            self._turn()
        a, b = self.lengths
        m1, m2 = self.masses
        c2, s2 = math.cos(self.q[1]), math.sin(self.q[1])
        M11, M12, M22 = m1 * a * a + m2 * (a * a + b * b + 2 * a * b * c2), m2 * (b * b + a * b * c2), m2 * b * b
        M11, M22 = M11 + 2e-4, M22 + 1e-4
        k = m2 * a * b * s2
        w1, w2 = self.w
        t1 = self._t[0] + k * w2 * (2 * w1 + w2) - self.damping_of_joints[0] * w1
        t2 = self._t[1] - k * w1 * w1 - self.damping_of_joints[1] * w2
        # momenta after the step without friction, and then friction's impulse joint by joint (Gauss and Seidel)
        det = M11 * M22 - M12 * M12
        f1 = f2 = 0.0
        c1, c2_ = self.friction_of_joints
        n1 = w1 + h * (M22 * t1 - M12 * t2) / det
        n2 = w2 + h * (M11 * t2 - M12 * t1) / det
        for _ in range(30):
            free = n1 + h * (M22 * 0.0 - M12 * f2) / det
            f1 = max(-c1, min(c1, -free * det / (h * M22)))
            free = n2 - h * M12 * f1 / det
            new = max(-c2_, min(c2_, -free * det / (h * M11)))
            if abs(new - f2) < 1e-12:
                f2 = new
                break
            f2 = new
        a1, a2 = n1 + h * (M22 * f1 - M12 * f2) / det, n2 + h * (M11 * f2 - M12 * f1) / det
        d1, d2 = 0.5 * h * (w1 + a1), 0.5 * h * (w2 + a2)
        self.q = [self.q[0] + d1, self.q[1] + d2]
        self.w = [a1, a2]

    def damping(self, x: Sequence[float] = (0.0, 0.0)) -> NDArray[np.float64]:
        """B at the tip, at a displacement."""
        A, B, C, D = self.jacobian(self.joints(x))
        P = np.linalg.inv(np.array([[A, B], [C, D]]))
        return np.asarray(P.T @ np.diag(self.damping_of_joints) @ P)

    def friction(self, u: NDArray[np.float64]) -> float:
        A, B, C, D = self.jacobian(self.home)
        P = np.linalg.inv(np.array([[A, B], [C, D]]))
        return float(np.abs(P @ u) @ np.array(self.friction_of_joints))


@dataclass
class Delta:
    """Three arms at 120 degrees, whose joints have inertia, damping and dry friction, with a mass at the tip.

    With P = dq/dx it obeys (m + P^T I P) x'' + P^T I P' x' = f - P^T (b q' + friction); a step has all at its middle.
    """

    m: float = 0.15
    inertia: tuple[float, float, float] = (2e-4, 2e-4, 2e-4)
    damping_of_joints: tuple[float, float, float] = (0.01, 0.01, 0.01)
    friction_of_joints: tuple[float, float, float] = (0.002, 0.002, 0.002)
    middle: float = 0.16
    radius: float = 0.05
    upper: float = 0.12
    rod: float = 0.2

    def __post_init__(self) -> None:
        around = 2.0 * np.pi * np.arange(3) / 3.0
        self._out = np.column_stack([np.cos(around), np.sin(around), np.zeros(3)])
        self._home, self._x, self._v = np.array([0.0, 0.0, self.middle]), np.zeros(3), np.zeros(3)
        self._f = np.zeros(3)

    @property
    def axes(self) -> int:
        return 3

    def place(self) -> Floats:
        return [float(value) for value in self._x]

    def hold(self, f: Floats) -> None:
        self._f = np.array(f)

    def by_tip(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """P: the rods do not change their lengths."""
        p = x + self._home
        r = p - self.radius * self._out
        a, b = np.einsum("ij,ij->i", r, self._out), r[:, 2]
        k = (np.einsum("ij,ij->i", r, r) + self.upper**2 - self.rod**2) / (2.0 * self.upper)
        root = np.sqrt(a * a + b * b - k * k)
        q = np.arctan2(b * k - a * root, a * k + b * root)
        cos, sin, up = np.cos(q)[:, None], np.sin(q)[:, None], np.array([0.0, 0.0, 1.0])
        rods = r - self.upper * (cos * self._out + sin * up)
        way = self.upper * (cos * up - sin * self._out)
        return np.asarray(rods / np.einsum("ij,ij->i", rods, way)[:, None])

    def step(self, h: float) -> None:
        v, P = self._v, self.by_tip(self._x + 0.5 * h * self._v)
        turn = self.by_tip(self._x + h * v) - self.by_tip(self._x)  # P' h
        inertia, burns = np.array(self.inertia), np.array(self.damping_of_joints)
        M, B = self.m * np.eye(3) + (P.T * inertia) @ P, (P.T * burns) @ P
        inverse = np.linalg.inv(M + 0.5 * h * B)
        free = inverse @ (M @ v - 0.5 * h * B @ v + h * self._f - (P.T * inertia) @ (turn @ v))
        moves, own = P @ inverse @ P.T, (P @ free).tolist()
        G, phi = (h * moves).tolist(), [0.0, 0.0, 0.0]
        for _ in range(30):  # friction joint by joint (Gauss and Seidel)
            before = list(phi)
            for j, c in enumerate(self.friction_of_joints):
                rate = own[j] + sum(G[j][i] * phi[i] for i in range(3) if i != j)
                phi[j] = max(-c, min(c, -rate / G[j][j]))
            if max(abs(a - b) for a, b in zip(phi, before, strict=True)) < 1e-12:
                break
        after = free + h * inverse @ (P.T @ np.array(phi))
        self._x, self._v = self._x + 0.5 * h * (v + after), after

    def damping(self, x: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
        """B at the tip, at a displacement."""
        P = self.by_tip(np.array(x))
        return np.asarray((P.T * np.array(self.damping_of_joints)) @ P)

    def friction(self, u: NDArray[np.float64]) -> float:
        return float(np.abs(self.by_tip(np.zeros(3)) @ u) @ np.array(self.friction_of_joints))


class PlantDriver(DeviceDriver):
    """A plant with encoders of a step, noise, samples of an age, and forces that act late."""

    def __init__(
        self,
        plant: Slide | Arm | Delta,
        step: float = 1e-5,
        noise: float = 0.0,
        age: float = 0.0,
        jitter: float | None = None,
        delay: float = 0.0,
        stated: DeviceSpecification | None = None,
        seed: int = 0,
        h: float = 2.5e-4,
        force: float = 5.0,
    ) -> None:
        self.plant, self._step, self._noise, self._age, self._delay, self._h = plant, step, noise, age, delay, h
        self._jitter = age if jitter is None else jitter
        self._random = np.random.default_rng(seed)
        m = plant.axes
        self.stated = stated or DeviceSpecification(
            (force,) * m, (0.2,) * m, (2.0,) * m, DeviceTiming(age, jitter, delay),
            step=(step,) * m if step else None, holds_torque=isinstance(plant, Arm) and plant.torques, hardware=False,
        )  # fmt: skip
        plant.hold([0.0] * m)
        self._t = 0.0
        self._times, self._places = [0.0], [plant.place()]
        self._due: list[tuple[float, Floats]] = []
        self._exact = plant.place()
        self.applied: list[Floats] = []
        self.released = True

    def specification(self) -> DeviceSpecification:
        return self.stated

    def _to(self, t: float) -> None:
        while self._t < t - 1e-12:
            due = self._due[0][0] if self._due else math.inf
            if due <= self._t + 1e-12:
                self.plant.hold(self._due.pop(0)[1])
                continue
            h = min(t, due, self._t + self._h) - self._t
            self.plant.step(h)
            self._t += h
            self._times.append(self._t)
            self._places.append(self.plant.place())
        if len(self._times) > 4000:
            del self._times[:2000], self._places[:2000]

    def _at(self, t: float) -> Floats:
        i = bisect_right(self._times, t)
        if i == 0 or i == len(self._times):
            return self._places[min(i, len(self._times) - 1)]
        part = (t - self._times[i - 1]) / (self._times[i] - self._times[i - 1])
        return [a + part * (b - a) for a, b in zip(self._places[i - 1], self._places[i], strict=True)]

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        now = at * 1e-9
        self._to(now)
        age = self._age - self._jitter * float(self._random.random())
        x = self._exact = self._at(now - age)
        if self._noise:
            x = [value + float(self._random.uniform(-self._noise, self._noise)) for value in x]
        return [self._step * round(value / self._step) for value in x] if self._step else x

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> None:
        now = at * 1e-9
        self._to(now)
        self.released = False
        self.applied.append(list(f))
        self._due = [entry for entry in self._due if entry[0] < now + self._delay]
        self._due.append((now + self._delay, list(f)))
        if until is not None:
            self._due.append((until * 1e-9 + self._delay, [0.0] * len(f)))

    def release(self, at: Instant) -> None:
        self.apply([0.0] * self.plant.axes, at)
        self.released = True

    def close(self) -> None:
        self._due = []


class WorkingDriver(PlantDriver):
    """One whose motors hold the torques of the joints that it has read, and which tells their work by these joints."""

    def __init__(self, plant: Arm, *given: Any, **others: Any) -> None:
        self._read: tuple[Floats, Floats] | None = None  # the joints that were read last, and the displacement
        self._held: tuple[Floats, Floats] = [0.0, 0.0], [0.0, 0.0]  # torques, and the force that they stand for
        self._done = 0.0
        super().__init__(plant, *given, **others)

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        assert isinstance(self.plant, Arm)
        x = list(super().sample(tick, at))
        q = self.plant.joints(self._exact)
        if self._read is not None:
            (before, place), (t, f) = self._read, self._held
            own = sum(t * (b - a) for t, a, b in zip(t, before, q, strict=True))
            exact = [b - a for a, b in zip(self.plant.tip(before), self.plant.tip(q), strict=True)]
            # the joints of a real one are those of its displacement
            self._done = own + sum(f * ((b - a) - d) for f, a, b, d in zip(f, place, x, exact, strict=True))
        self._read = q, x
        return x

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> None:
        assert isinstance(self.plant, Arm)
        q = self._read[0] if self._read is not None else list(self.plant.home)
        A, B, C, D = self.plant.jacobian(q)
        t = [A * f[0] + C * f[1], B * f[0] + D * f[1]]
        self._held = t, list(f)
        super().apply(t, at, until)

    def work(self) -> float | None:
        return self._done


def slide(ports: Sequence[str], period: float, parameters: Mapping[str, Any]) -> PlantDriver:
    """A counterpart for commands: a slide with the given b and c, which may claim to be hardware."""
    driver = PlantDriver(Slide(m=0.2, b=parameters.get("b", 0.5), c=parameters.get("c", 0.1)), step=5e-6)
    driver.stated = replace(driver.stated, hardware=bool(parameters.get("hardware", False)))
    return driver


def slide_of_starts(ports: Sequence[str], period: float, parameters: Mapping[str, Any]) -> PlantDriver:
    """The same, by a driver that measures its times at each start: the next line of the file ``starts`` has them, s."""
    driver, file = slide(ports, period, parameters), Path(parameters["starts"])
    now, *later = file.read_text().splitlines()
    file.write_text("\n".join(later))
    driver.stated = replace(driver.stated, timing=DeviceTiming(*map(float, now.split())), measured=TIMES)
    return driver
