"""Random sessions whose devices live in wall time, at delays that no certificate covers.

``make lateness`` has networks as environments, ``make scenes`` (``--scenes``) scenes with contacts and friction. Each
session is designed, certified and cut into bundles as a launch does it. Its devices, couplings and environment are
the product's own cores, and the instants of every sample and every force are drawn: there are no processes, and nothing
here takes time. Each session runs four times:

- *covered*: every delay is within the certificate's tau. No account may fall below 0, and no device may diverge. With a
  network nothing may be changed either; the blows of a scene are stronger than what a tank of E_0 always pays for;
- *enforced*: delays of up to 20 tau, bursts, processes that stop for 50 ms, missed and early ticks, with the tank. No
  account may fall below -E_0, and no device may diverge;
- *stronger*: the same instants, and hands that push with three times what is stated of them: that has to be named;
- *counted*: the same instants without the tank. It is counted how many diverge or break their account: a campaign in
  which none does shows nothing.

In the first two courses every ledger keeps its bound, and a scene's controller has nothing to do.

Hands push for a while, and are passive afterwards. In a scene they press on what is nearest, and some are *hostile*:
such a hand also pushes along its own motion all the time, and so feeds the mode that is damped least. The clutches of a
scene freeze, ramp and come back at random. With a *latency* every device measures and acts late by itself, as a driver
may state: its samples are old, and its forces act after their call. The certificate's tau has that in it.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from manyhands.design.errors import DesignError
from manyhands.design.models.scene import ToolSphere
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.launch.session.device import Device
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.device.simulated import HeldDeviceDriver, IntentHand, Intention, Plant, device_of
from manyhands.nodes.device.tick import WallTimeTick
from manyhands.nodes.environment.core import environment_core, respond
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.arithmetic import plus
from manyhands.nodes.kernel.bundle import (
    REALTIME,
    CouplingBundle,
    DeviceBundle,
    EnvironmentBundle,
    PluginDevice,
    SimulatedHand,
)
from manyhands.nodes.kernel.driver_statement import DeviceTiming
from manyhands.nodes.kernel.factory import FactoryName
from manyhands.nodes.kernel.intent import intent_from
from manyhands.nodes.kernel.orientation import NO_RIDER, RIDER
from manyhands.nodes.kernel.passivity import Ledger
from manyhands.nodes.kernel.timeouts import STALE_TICKS
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.messages import Figures
from tests.support.scenes import random_scene, scene_session

Tree = dict[str, Any]
Generator = np.random.Generator

E_0: Final = 5e-3
POWER: Final = 1e-3  # W
SPEED: Final = 10.0
"""m/s; the hands push so that a device alone stays below 0.3 m/s, or 3 m/s in a scene: a faster one has diverged."""

STOPPED: Final = from_seconds(0.05)
ROUNDING: Final = 1e-9
"""J; sums of some 1e4 terms, each of at most some joules, in doubles."""

KEPT_BACK: Final = 1e-6
"""J; what a scene's controller may keep back: what its iteration leaves, and no more."""

FELT: Final = 0.01  # N

PUSH: Final = 0.3
"""m/s; a hostile hand pushes with this times the device's damping, so that a passive loop stays about as slow."""

OVERLAP: Final = 0.1
"""J; the greatest energy of contacts that overlap at the start of a scene: more would throw devices about by itself."""


def session_tree(rng: Generator) -> Tree:
    """A session file as plain data: 1 to 6 ports, blocks that split and join devices, hands that push, then yield."""
    T = float(rng.choice([1e-3, 1e-3, 5e-4, 2e-3]))
    devices: Tree = {}
    ports: list[str] = []
    while len(ports) == 0 or (len(ports) < 6 and rng.random() < 0.6):
        dof = int(min(rng.choice([1, 1, 2, 3]), 6 - len(ports)))
        name = f"d{len(devices)}"
        osp = [round(float(10.0 ** rng.uniform(-1.7, 0.8)), 3) for _ in range(dof)]
        push = [f"{round(float(rng.uniform(-0.3, 0.3)) * b, 4)}*pulse(t, 0.02, 0.3)" for b in osp]
        spring = [0.0 if rng.random() < 0.5 else round(float(10.0 ** rng.uniform(0.5, 3.0)), 2) for _ in osp]
        devices[name] = {
            "dof": dof,
            "osp": osp,
            "driver": "simulated",
            "mass": [round(float(10.0 ** rng.uniform(math.log10(0.02), math.log10(5.0))), 4) for _ in osp],
            "hand": {
                "force": push,
                "stiffness": spring,
                "damping": [0.0 if rng.random() < 0.5 else round(float(rng.uniform(0.0, 3.0)), 3) for _ in osp],
            },
        }
        ports += [name] if dof == 1 else [f"{name}.{axis}" for axis in range(dof)]
    couplings = random_blocks(rng, ports)
    hub = float(rng.uniform(0.2, 5.0))
    stiff = [round(float(10.0 ** rng.uniform(2.3, 4.0)), 1) for _ in range(len(ports) + 1)]
    links: list[Tree] = [
        {"between": [port, "hub"], "stiffness": k, "damping": round(k * 1e-4, 4)}
        for port, k in zip(ports, stiff, strict=False)
    ]
    links.append({"between": ["hub", "ground"], "stiffness": stiff[-1], "damping": 0.5})
    return {
        "session": "late",
        "period": T,
        "devices": devices,
        "couplings": couplings,
        "environment": {"type": "network", "masses": {"hub": round(hub, 3)}, "links": links},
        "design": random_design(rng, T),
        "faults": {"tank": E_0},
    }


def random_blocks(rng: Generator, ports: Sequence[str]) -> Tree:
    """The ``couplings`` of a session file: blocks of one to three ports, whichever device they are of."""
    order, couplings = [str(port) for port in rng.permutation(ports)], {}
    while order:
        size = int(rng.integers(1, min(3, len(order)) + 1)) if rng.random() < 0.5 else 1
        couplings[f"c{len(couplings)}"] = {"ports": order[:size]}
        order = order[size:]
    return couplings


def random_design(rng: Generator, T: float) -> Tree:
    """The ``design`` of a session file."""
    return {
        "coupling": "spring-damper",
        "objective": str(rng.choice(["feasible", "stiffest"])),
        "tau": float(rng.choice([0.0, 0.2 * T, 0.5 * T, T])),
        "ladder": [],
    }


def scene_tree(rng: Generator) -> Tree:
    """A session file as plain data: a random scene with one to three tools, each with a device of its own."""
    T = float(rng.choice([1e-3, 1e-3, 5e-4, 2e-3]))
    tools, axes = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    while True:
        scene = random_scene(rng, tools, int(rng.integers(0, 4)), axes)
        if scene.contacts.energy(scene.points) <= OVERLAP:
            break

    gaps, gradients = scene.contacts.gaps(scene.points)

    def device(tool: ToolSphere) -> Tree:
        # towards the nearest thing, and into it
        ways = -gradients[:, list(tool.axes)]
        own = [pair.names[0] == tool.name for pair in scene.contacts.pairs]
        within = np.where(own & (gaps > 0.0) & (np.linalg.norm(ways, axis=1) > 0.5), gaps, np.inf)
        nearest = int(np.argmin(within))
        way = ways[nearest]
        osp = [round(float(10.0 ** rng.uniform(-0.5, 0.8)), 3) for _ in range(axes)]
        follows = rng.random() < 0.5
        hand: Tree = {
            "stiffness": [round(float(10.0 ** rng.uniform(1.0, 3.0)), 2) if follows else 0.0 for _ in osp],
            "damping": [0.0 if rng.random() < 0.5 else round(float(rng.uniform(0.0, 5.0)), 3) for _ in osp],
        }
        if follows:
            far, hertz = float(gaps[nearest]) + rng.uniform(0.0, 0.02), rng.uniform(0.5, 8.0)
            hand["motion"] = [
                f"{far * part:.5f}*min(1, t/{100 * T}) + {shake:.5f}*sin(2*pi*{hertz:.3f}*t)"
                for part, shake in zip(way, rng.uniform(0.0, 0.01, axes), strict=True)
            ]
        else:
            press = [2.0 * PUSH * b * part for b, part in zip(osp, way, strict=True)]
            hand["force"] = [f"{f:.5f}*pulse(t, {20 * T}, {400 * T})" for f in press]
        mass = [round(float(10.0 ** rng.uniform(math.log10(0.02), math.log10(2.0))), 4) for _ in osp]
        # springs of 1000 N/m that contacts stretch by centimetres
        return {"osp": osp, "mass": mass, "hand": hand, "limits": {"hand": 500.0}}

    tree = scene_session(scene, {tool.name: device(tool) for tool in scene.tools}, random_design(rng, T), T)
    return {**tree, "couplings": random_blocks(rng, scene.ports), "faults": {"tank": E_0}}


class HostileHand(IntentHand):
    """The hand of a bundle, which also pushes along its own motion: negative friction, of a constant force."""

    def __init__(self, source: SimulatedHand, T: float) -> None:
        """Hold the device of ``source``; T is the period, s."""
        force, motion = ([intent_from(data) for data in every] for every in (source.force, source.motion))
        super().__init__(Plant(device_of(source), T, True), force, motion, T)
        self._push = [PUSH * b for b in source.damping]

    def intend(self, tick: int, state: list[float]) -> tuple[list[float], Intention]:
        """The intention of the period that begins with the velocity in ``state``."""
        m = self.plant.axes
        state, (force, velocity) = super().intend(tick, state)
        along = [math.copysign(push, v) for push, v in zip(self._push, state[m : 2 * m], strict=True)]
        return state, Intention(plus(force, along), velocity)


@dataclass
class Plan:
    """The instants of one run, as a device's process would meet them.

    Attributes:
        tau: the certificate's delay, ns.
        period: T, ns.
        kind: "covered" or "beyond".
        seed: of the instants.
    """

    tau: int
    period: int
    kind: str
    seed: int

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        longest = 20 * max(self.tau, self.period // 20)
        self._base = int(self._rng.choice([0.3, 0.6, 1.0, 2.0]) * self.period)
        self._base = min(self._base, longest)
        self._longest, self._burst = longest, 0

    def delay(self) -> int:
        """From the last sample of a tick to one device's force."""
        rng = self._rng
        if self.kind == "covered":
            return int(rng.integers(0, self.tau + 1))
        if self._burst == 0 and rng.random() < 0.01:
            self._burst = int(rng.integers(1, 20))
        if self._burst > 0:
            self._burst -= 1
            return int(rng.integers(0, self._longest + 1))
        return int(rng.integers(0, 2 * self._base + 1))

    def wake(self, due: int) -> int:
        """When a sample is taken that is due at ``due``."""
        rng = self._rng
        if self.kind == "covered":
            return due
        chance = rng.random()
        if chance < 0.002:
            return due + STOPPED
        if chance < 0.03:
            return due - int(rng.integers(0, self.period // 2))  # early
        return due + int(rng.exponential(0.03 * self.period))

    def following(self, slot: int, applied: int) -> int:
        """The next multiple of T at which a tick is due."""
        slot = max(slot + 1, -(-applied // self.period))
        return slot + 1 if self.kind == "beyond" and self._rng.random() < 0.01 else slot  # missed


@dataclass(frozen=True)
class Course:
    """What became of one run.

    Attributes:
        least: the least account of any device, J.
        margin: the least distance of any account from its bound, J.
        quicker: the devices that moved further than their stated mass and hand allow.
        fastest: the greatest speed of any device, m/s.
        changed: the ticks in which any interface changed a motion or a force.
        offset: the greatest offset of any device at the end, m.
        ticks: those of the run.
        felt: the ticks in which a force of at least :data:`FELT` was applied to any device.
        ledgers: by party, the least margin of its ledger above its bound, J.
        kept_back: what a controller of the environment kept back, J.
    """

    least: float
    margin: float
    quicker: int
    fastest: float
    changed: int
    offset: float
    ticks: int
    felt: int
    ledgers: Mapping[str, float]
    kept_back: float

    @property
    def diverged(self) -> bool:
        """Whether a device was faster than any of these hands can make it."""
        return not self.fastest < SPEED

    @property
    def broken(self) -> str:
        """A sentence about a promise of couplings, environment or devices that was not kept; empty if all were."""
        for party, margin in self.ledgers.items():
            if not margin >= -ROUNDING:
                return f"found a ledger of {party} {margin:g} J above its bound; expected at least 0 J"
        if not self.kept_back <= KEPT_BACK:
            return f"found {self.kept_back:g} J kept back by the controller; expected at most {KEPT_BACK:g} J"
        return ""


class DelayedDriver:
    """A device whose samples are ``age`` old, and whose forces act ``delay`` after their call, both in ns.

    A force may act later than the next sample was taken: what was called first is not always what happens first.
    """

    def __init__(self, driver: Driver, age: int, delay: int) -> None:
        self._driver, self._age, self._delay, self.axes = driver, age, delay, driver.axes
        self._coming: deque[tuple[Instant, Sequence[float] | None, Instant | None]] = deque()

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        taken = Instant(at - self._age)
        while self._coming and self._coming[0][0] <= taken:
            acts, f, end = self._coming.popleft()
            self._driver.release(acts) if f is None else self._driver.apply(f, acts, end)
        return self._driver.sample(tick, taken)

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> None:
        end = None if until is None else Instant(until + self._delay)
        self._coming.append((Instant(at + self._delay), f, end))

    def release(self, at: Instant) -> None:
        self._coming.append((Instant(at + self._delay), None, None))

    def idle(self, due: Instant) -> None:
        """Nothing is integrated ahead: the next sample may be of an earlier instant than ``due``."""

    def intended_work(self) -> float:
        return self._driver.intended_work()

    def figures(self) -> Figures:
        return self._driver.figures()

    def close(self) -> None:
        self._driver.close()


class Late:
    """One device in wall time, with the instants of its loop, and a latency of its own in ns."""

    def __init__(
        self, bundle: DeviceBundle, allowance: LatenessAllowance | None, latency: int = 0, hostile: bool = False
    ) -> None:
        if hostile:
            assert isinstance(bundle.source, SimulatedHand)
            driver: Driver = HeldDeviceDriver(HostileHand(bundle.source, bundle.common.period), bundle.common.period)
        else:
            driver = driver_of(bundle)
        if latency:
            age = latency // 3
            driver = DelayedDriver(driver, age, latency - age)
            timing = DeviceTiming(age * 1e-9, 0.0, (latency - age) * 1e-9)
            name = FactoryName("tests:made", {})
            bundle = replace(bundle, source=PluginDevice(name, bundle.source.axes, timing=timing))
        self.tick, self.latency = WallTimeTick(replace(bundle, allowance=allowance), driver), latency
        self.period = from_seconds(bundle.common.period)
        self.stale = Duration(STALE_TICKS * self.period)
        self.slot, self.turn, self.now, self.sampled, self.fastest = 0, 0, 0, 0, 0.0

    def sample(self, at: int) -> list[float]:
        self.now = self.sampled = max(self.now, at)
        interface = self.tick.wall_interface
        before = interface.until
        sent = self.tick.sample(self.turn, Instant(self.now))
        if interface.shortened:
            assert before is None or interface.until < before, "found a force that ends later than it had to"
            assert interface.until >= self.now, "found a force that ends before its device is told to end it"
        self.turn += 1
        self.fastest = max(self.fastest, self.tick.wall_interface.speed)
        return sent

    @property
    def rides(self) -> Sequence[float]:
        """What rides with its sample."""
        return self.tick.rides

    def answer(self, f: list[float], at: int, came: Sequence[float] = NO_RIDER) -> None:
        if at - self.sampled > self.stale:
            self.tick.release(Instant(self.sampled + self.stale))
        self.now = at
        self.tick.exert(f, Instant(at), came=came)
        self.tick.book()
        self.tick.driver.idle(Instant((at // self.period + 1) * self.period))


def run(
    prepared: Prepared,
    plan: Plan,
    ticks: int,
    allowance: LatenessAllowance | None,
    latency: int = 0,
    hostile: Sequence[str] = (),
    clutched: bool = False,
    weaker: float = 1.0,
    make: Callable[[DeviceBundle, LatenessAllowance | None, int, bool], Late] = Late,
) -> Course:
    """Run a session at drawn instants; it ends early once a device has diverged.

    Args:
        prepared: the session with its coupling.
        plan: the instants.
        ticks: the number of ticks.
        allowance: E_0 and P of every device; None to count alone.
        latency: of every device itself, ns.
        hostile: the devices that are in hostile hands.
        clutched: whether blocks freeze, leave and join at random.
        weaker: where it is above 1, the greatest force of every hand is stated as its push over this, and no more.
        make: makes each device in wall time.
    """
    session = prepared.session
    bundles = cut(prepared, RunPlan(REALTIME, None, ""))
    index = {port: i for i, port in enumerate(session.ports)}
    m = len(index)
    ledgers: dict[str, Ledger] = {}
    devices: list[tuple[Late, list[int]]] = []
    by_name: dict[str, Late] = {}
    couplings: list[tuple[CouplingCore, list[int]]] = []
    D_V = np.zeros((m, m))
    world: EnvironmentBundle | None = None
    for name, bundle in bundles.items():
        ports = [index[port] for port in bundle.common.ports]
        match bundle:
            case DeviceBundle():
                if weaker > 1.0 and bundle.inertia is not None:
                    pushes = tuple(abs(push) / weaker for push in _pushes(session.devices[name]))
                    bundle = replace(bundle, inertia=replace(bundle.inertia, hand=pushes))
                by_name[name] = late = make(bundle, allowance, latency, name in hostile)
                devices.append((late, ports))
                ledgers[name] = late.tick.core.ledger
            case CouplingBundle():
                core = CouplingCore(bundle.block, bundle.K, bundle.level, session.period, bundle.limits.force)
                couplings.append((core, ports))
                if core.ledger is not None:
                    ledgers[name] = core.ledger
                D_V[np.ix_(ports, ports)] = bundle.block.D
            case EnvironmentBundle():
                world = bundle
    assert world is not None
    environment = environment_core(world, D_V, tuple(np.array(ports) for _, ports in couplings))
    if environment.ledger is not None:
        ledgers["environment"] = environment.ledger
    clutches, chance = environment.clutches, np.random.default_rng(plan.seed)
    turned = [by_name[tool.device] for tool in world.oriented_tools]
    x, p, f = [0.0] * m, [0.0] * m, [0.0] * m
    ran = felt = 0
    for k in range(ticks):
        ran += 1
        if clutched and chance.random() < 0.02:
            change = (clutches.freeze, clutches.disengage, clutches.engage, clutches.engage)[chance.integers(4)]
            change(int(chance.integers(len(couplings))))
        for device, ports in devices:
            for port, at in zip(ports, device.sample(plan.wake(device.slot * plan.period)), strict=True):
                x[port] = at
        closed = max(device.now for device, _ in devices)
        for coupling, ports in couplings:
            for port, at in zip(ports, coupling.free_position([x[port] for port in ports]), strict=True):
                p[port] = at
        forces = list(respond(environment, p + [number for device in turned for number in device.rides], k))
        came = {id(device): forces[m + RIDER * i : m + RIDER * (i + 1)] for i, device in enumerate(turned)}
        environment.settle()
        for coupling, ports in couplings:
            applied = coupling.limited([float(forces[port]) for port in ports])
            coupling.absorb(applied)
            for port, force in zip(ports, applied, strict=True):
                f[port] = force
        felt += max(map(abs, f)) >= FELT
        for device, ports in devices:
            at = closed + plan.delay()
            device.answer([f[port] for port in ports], at, came.get(id(device), NO_RIDER))
            device.slot = plan.following(device.slot, at)
        if any(device.fastest > SPEED for device, _ in devices):
            break
    return Course(
        min(device.tick.wall_interface.account.least for device, _ in devices),
        min(device.tick.wall_interface.margin for device, _ in devices),
        sum(device.tick.wall_interface.account.broken is not None for device, _ in devices),
        max(device.fastest for device, _ in devices),
        sum(device.tick.wall_interface.ticks for device, _ in devices),
        max(abs(to - at) for device, _ in devices for to, at in zip(device.tick.x, device.tick.sent, strict=True)),
        ran,
        felt,
        {name: ledger.margin for name, ledger in ledgers.items()} if allowance is not None else {},
        environment.controller.energy
        if isinstance(environment, EnforcedCore) and environment.controller is not None
        else 0.0,
    )


def _pushes(device: Device) -> list[float]:
    """The greatest force of each axis's hand, N, as :func:`session_tree` writes it."""
    assert device.hand is not None
    return [float(str(force).partition("*")[0]) for force in device.hand.force]


def prepared_session(seed: int, scenes: bool = False) -> Prepared | None:
    """The random session of this seed with its certificate; None where nothing can be certified."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "late.yaml"
        path.write_text(json.dumps((scene_tree if scenes else session_tree)(np.random.default_rng(seed))))
        try:
            return prepare(load_session(path))
        except DesignError:
            return None


@dataclass(frozen=True)
class Outcome:
    """The three courses of one session; ``scenes`` for one with a scene."""

    seed: int
    scenes: bool
    covered: Course
    enforced: Course
    counted: Course
    stronger: Course | None

    @property
    def violations(self) -> tuple[str, ...]:
        """A sentence for each promise that was not kept."""
        found = [course.broken for course in (self.covered, self.enforced) if course.broken]
        if self.covered.diverged:
            found.append(f"found a device at {self.covered.fastest:g} m/s within tau; expected less than {SPEED:g}")
        if self.covered.least < -ROUNDING:
            found.append(f"found an account of {self.covered.least:g} J within tau; expected at least 0 J")
        if self.covered.changed and not self.scenes:
            found.append(f"found {self.covered.changed} changed ticks within tau; expected none")
        if self.enforced.margin < -ROUNDING:
            found.append(f"found an account {-self.enforced.margin:g} J below its bound; expected none")
        if self.covered.quicker or self.enforced.quicker:
            found.append("found a statement called broken; expected none, for every hand keeps to its own")
        if self.stronger is not None and not self.stronger.quicker:
            found.append("found no statement called broken; expected one, for hands push with three times the force")
        if self.enforced.diverged:
            found.append(f"found a device at {self.enforced.fastest:g} m/s beyond tau; expected less than {SPEED:g}")
        return tuple(found)


def outcome_of(seed: int, ticks: int, part: float = 0.0, scenes: bool = False) -> Outcome | None:
    """Design and run the session of this seed; None where nothing can be certified.

    ``part`` is that of tau which is each device's own latency.
    """
    prepared = prepared_session(seed, scenes)
    return None if prepared is None else outcome_of_session(prepared, seed, ticks, part, scenes)


def outcome_of_session(prepared: Prepared, seed: int, ticks: int, part: float, scenes: bool) -> Outcome | None:
    """Run a session with a certificate; None for one without."""
    if prepared.certificate is None:
        return None
    chance = np.random.default_rng(seed)
    hostile = [name for name in prepared.session.devices if scenes and chance.random() < 0.4]
    period, tau = from_seconds(prepared.session.period), from_seconds(prepared.certificate.tau)

    def course(kind: str, allowance: LatenessAllowance | None, weaker: float = 1.0) -> Course:
        latency = int(part * tau)
        plan = Plan(tau - latency, period, kind, seed)
        return run(prepared, plan, ticks, allowance, latency, hostile, scenes, weaker)

    tank = LatenessAllowance(E_0, POWER)
    stronger = None if scenes else course("beyond", tank, weaker=3.0)
    return Outcome(seed, scenes, course("covered", tank), course("beyond", tank), course("beyond", None), stronger)


def _outcome(job: tuple[int, int, bool]) -> Outcome | None:
    seed, ticks, scenes = job
    return outcome_of(seed, ticks, scenes=scenes)


def campaign(sessions: int, ticks: int, seed: int, processes: int, scenes: bool = False) -> Iterator[Outcome]:
    """The outcomes of this many certified sessions, in the order in which they end."""
    done = 0
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for outcome in pool.imap_unordered(_outcome, ((seed + i, ticks, scenes) for i in range(100 * sessions))):
            if outcome is None:
                continue
            yield outcome
            done += 1
            if done == sessions:
                return


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign; returns 1 if a promise was not kept, or if nothing would have happened without the tank."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=1000, help="certified sessions to run (1000)")
    parser.add_argument("--ticks", type=int, default=3000, help="ticks of each run (3000)")
    parser.add_argument("--seed", type=int, default=1, help="of the first session (1)")
    parser.add_argument("--processes", type=int, default=2, help="processes to share the work (2)")
    parser.add_argument("--scenes", action="store_true", help="scenes in place of networks")
    asked = parser.parse_args(arguments)
    outcomes: list[Outcome] = []
    for outcome in campaign(asked.sessions, asked.ticks, asked.seed, asked.processes, asked.scenes):
        outcomes.append(outcome)
        for text in outcome.violations:
            print(f"seed {outcome.seed}: {text}", flush=True)  # noqa: T201 -- what a campaign is for
        if len(outcomes) % 50 == 0:
            print(f"{len(outcomes)} of {asked.sessions}", file=sys.stderr, flush=True)  # noqa: T201
    diverged = sum(outcome.counted.diverged for outcome in outcomes)
    broken = sum(outcome.counted.least < -E_0 for outcome in outcomes)
    bad = sum(bool(outcome.violations) for outcome in outcomes)
    courses = [course for o in outcomes for course in (o.covered, o.enforced)]
    print(  # noqa: T201
        f"{len(outcomes)} sessions, {sum(course.ticks for course in courses)} ticks with the tank, a force in "
        f"{sum(course.felt for course in courses)} of them; {sum(bool(o.covered.changed) for o in outcomes)} sessions "
        f"were changed within tau. Least margin of a "
        f"ledger {min(min(course.ledgers.values()) for course in courses):.3g} J; kept back at most "
        f"{max(course.kept_back for course in courses):.3g} J. "
        f"Within tau: least account {min(o.covered.least for o in outcomes):.3g} J, greatest speed "
        f"{max(o.covered.fastest for o in outcomes):.3g} m/s. "
        f"Beyond, enforced: least account {min(o.enforced.least for o in outcomes):.6g} J of {-E_0:g}, "
        f"least margin {min(o.enforced.margin for o in outcomes):.3g} J, greatest speed "
        f"{max(o.enforced.fastest for o in outcomes):.3g} m/s, median offset at the end "
        f"{np.median([o.enforced.offset for o in outcomes]) * 1e3:.3g} mm. Not enforced: {diverged} diverged, {broken} "
        f"were below {-E_0:g} J. Hands of three times the stated force: named in "
        f"{sum(o.stronger is not None and o.stronger.quicker > 0 for o in outcomes)} sessions. "
        f"Promises not kept: {bad}."
    )
    return 1 if bad or not diverged else 0


if __name__ == "__main__":
    sys.exit(main())
