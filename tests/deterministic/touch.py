"""One device in wall time that touches a world, whatever computes the force: ours, or what others do.

The device lives in wall time. Its encoder is read at every kT, in steps of :data:`ENCODER`; the force that a
:class:`Renderer` computes from it is exerted from kT + :data:`DELAY` on, and held until the next. A renderer of ours is
made of the product's own cores, from a session that is designed and certified (:class:`Certified`).

Two worlds: a wall, and three stones that overlap. Coordinates are x and y from where the tool begins; y points up.

**The account at the hand.** With the exact motion of the device between all events, the force f has taken in

    E = - sum of f^T dx,        E_h = E + sum of b |dx|^2/h,

b being the device's own damping, h the time of each piece. E is what the world received from the device; the sampled
force of a spring puts some out by itself. E_h is what world and device have received from the hand and not given back,
less the device's motion: below 0 the hand was given energy that nobody had put in. The sum over pieces is at most what
the damping burns, so E_h is never too great.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import StateSpace
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.device.simulated import HeldDeviceDriver, intent_hand
from manyhands.nodes.environment.chatter import Chatter
from manyhands.nodes.environment.core import environment_core
from manyhands.nodes.kernel.bundle import REALTIME, CouplingBundle, EnvironmentBundle, SimulatedHand
from manyhands.protocol.clock import Instant, from_seconds
from tests.deterministic.lateness import HostileHand

Tree = dict[str, Any]
Vector = NDArray[np.float64]
Floats = list[float]

T: Final = 1e-3
DELAY: Final = 0.3e-3
"""s; from a sample to its force, for every renderer."""

ENCODER: Final = 0.0254 / 400
"""m; 1/400 inch, the resolution that is stated for a Novint Falcon [H3D2021]_."""

DAMPING: Final = 0.5
"""N*s/m; of the device itself, on each axis."""

MASS: Final = 0.15
"""kg; of the device with the hand's fingers."""

AXES: Final = ("x", "y")
PIECES: Final = 4
"""Pieces of a period over which the device's motion is followed."""

SURFACE: Final = -0.005
"""m; y of the wall's surface."""

STONES: Final = ((0.0, -0.03), (-0.025, -0.035), (0.025, -0.035))
RADIUS: Final = 0.02
"""m; of each stone, with the tool's radius."""

TOOL: Final = 0.005
"""m; the tool's part of it."""


class Renderer(Protocol):
    """What computes the force."""

    def step(self, x: Floats) -> Floats:
        """The force, N, for the measured position x, m, of this tick."""
        ...


@dataclass(frozen=True)
class Grip:
    """A hand: it follows a motion with a spring and a damper, and may push along its own motion as well."""

    stiffness: float
    damping: float
    hostile: bool = False


FIRM: Final = Grip(500.0, 4.0)
LIGHT: Final = Grip(100.0, 0.2)
HOSTILE: Final = Grip(100.0, 0.2, hostile=True)

REST: Final = (1.0, 2.0)
"""s; the hand stands still and presses."""

RESTING: Final = ("0", "-0.006*(1 - cos(pi*min(1, t/1.5)))")
"""m; the hand presses on the wall, without a blow, and stays."""

MOTIONS: Final[Mapping[str, tuple[str, str]]] = {
    # press for a second; then tap three times a second, and slide
    "wall": (
        "0.01*sin(2*pi*0.7*t)*step(t - 2)",
        "-0.015*min(1, t/0.3) + 0.014*max(0, sin(2*pi*3*t))*step(t - 2)",
    ),
    # the same on the stone in the middle; then to and fro over all three
    "stones": (
        "0.03*sin(2*pi*0.7*(t - 2))*step(t - 2)",
        "-0.02*min(1, t/0.3) + 0.008*max(0, sin(2*pi*3*t))*step(t - 2)",
    ),
}


def depth(world: str, x: Sequence[float]) -> float:
    """How deep a position is in the world's things, m."""
    if world == "wall":
        return SURFACE - x[1]
    return max(RADIUS - float(np.hypot(x[0] - a, x[1] - b)) for a, b in STONES)


def nearest(world: str, x: Sequence[float]) -> Floats:
    """A free position near x, m: by projections out of one thing after another, as a god-object does it."""
    if world == "wall":
        return [x[0], max(x[1], SURFACE)]
    at, to = x[0], x[1]
    for _ in range(20):
        inside = False
        for a, b in STONES:
            dx, dy = at - a, to - b
            distance = float(np.hypot(dx, dy))
            if distance < RADIUS * (1.0 - 1e-9):
                inside = True
                if distance == 0.0:
                    dx, dy, distance = 0.0, 1.0, 1.0
                at, to = a + dx * RADIUS / distance, b + dy * RADIUS / distance
        if not inside:
            break
    return [at, to]


class Proxies:
    """A model whose proxies are the nearest free positions (docs/models.md)."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        """Touch the world that the parameters name."""
        self._world = parameters["world"]

    def proxy(self, x: Vector, k: int) -> Floats:
        """The nearest free position, m."""
        return nearest(self._world, x.tolist())


def scene(world: str, stiffness: float) -> Tree:
    """The world as an environment of the type ``scene``."""
    things: Tree = {"floor": {"shape": "wall", "at": [0, SURFACE - TOOL, 0], "normal": [0, 1, 0]}}
    if world == "stones":
        things = {
            f"stone{i}": {"shape": "sphere", "at": [*at, 0], "radius": RADIUS - TOOL} for i, at in enumerate(STONES)
        }
    return {
        "type": "scene",
        "tools": {"pen": {"at": [0, 0, 0], "radius": TOOL}},
        "obstacles": things,
        "contact": {"stiffness": stiffness},
    }


def proxies(world: str, stiffness: float) -> Tree:
    """The world as a model that proposes proxies."""
    model = f"{__name__}:Proxies"
    return {"type": "python", "model": model, "stiffness": stiffness, "parameters": {"world": world}}


def mujoco_model(world: str, avatar: str) -> str:
    """The world in MuJoCo's XML, with contacts of MuJoCo's own softness; ``avatar`` is the body that touches it."""
    things = f'<geom type="plane" pos="0 {SURFACE - TOOL} 0" zaxis="0 1 0" size="1 1 0.1"/>'
    if world == "stones":
        things = "".join(f'<geom type="sphere" pos="{a} {b} 0" size="{RADIUS - TOOL}"/>' for a, b in STONES)
    return f"""
    <mujoco>
      <option timestep="{T}" integrator="implicitfast" cone="elliptic" gravity="0 0 0" jacobian="dense"/>
      <default><geom solref="0.004 1" condim="1"/></default>
      <worldbody>{things}{avatar}</worldbody>
      <!-- more -->
    </mujoco>"""


AVATAR: Final = f"""
    <body name="pen">
      <joint name="pen_x" type="slide" axis="1 0 0" damping="0.2"/>
      <joint name="pen_y" type="slide" axis="0 1 0" damping="0.2"/>
      <geom type="sphere" size="{TOOL}" mass="0.05"/>
    </body>"""


def engine(world: str, stiffness: float) -> Tree:
    """The world as a MuJoCo model under the proxy test."""
    return {
        "type": "engine",
        "engine": "mujoco",
        "stiffness": stiffness,
        "tools": {"pen": ["pen_x", "pen_y"]},
        "model": mujoco_model(world, AVATAR),
    }


def session_tree(environment: Tree, objective: str) -> Tree:
    """A session file of the device, as plain data."""
    return {
        "session": "touch",
        "period": T,
        "devices": {
            "pen": {
                "dof": 2,
                "axes": list(AXES),
                "osp": DAMPING,
                "driver": "simulated",
                "mass": MASS,
            }
        },
        "couplings": {"c": {"devices": ["pen"]}},
        "environment": environment,
        "design": {"coupling": "spring-damper", "objective": objective, "tau": DELAY, "ladder": []},
    }


class Certified:
    """Coupling and environment of a designed and certified session.

    Attributes:
        environment: the environment's core.
        stiffness: that of the coupling within a tick, K + B/T, N/m.
    """

    def __init__(self, environment: Tree, objective: str = "stiffest") -> None:
        """Design the session with this environment; it must be certified."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "touch.yaml"
            path.write_text(json.dumps(session_tree(environment, objective)))
            prepared = prepare(load_session(path))
        bundles = cut(prepared, RunPlan(REALTIME, None, ""))
        for bundle in bundles.values():
            match bundle:
                case CouplingBundle():
                    self.coupling = CouplingCore(bundle.block, bundle.K, bundle.level, T, bundle.limits.force)
                    D_V = bundle.block.D
                case EnvironmentBundle():
                    world = bundle
        self.stiffness = 1.0 / float(D_V[0, 0])
        self.environment = environment_core(world, D_V, (slice(0, 2),))

    def step(self, x: Floats) -> Floats:
        """f_v(k)."""
        f = self.coupling.limited(self.environment.react(self.coupling.free_position(x)))
        self.environment.settle()
        self.coupling.absorb(f)
        return f


def device(grip: Grip, motion: Sequence[str]) -> HeldDeviceDriver:
    """The simulated device in wall time, in a hand that follows ``motion``, m."""
    source = SimulatedHand(
        mass=2 * (MASS,),
        damping=2 * (DAMPING,),
        operator=StateSpace.static(np.zeros((2, 2))),
        hand_damping=2 * (grip.damping,),
        hand_stiffness=2 * (grip.stiffness,),
        force=(0.0, 0.0),
        motion=tuple(motion),
    )
    return HeldDeviceDriver(HostileHand(source, T) if grip.hostile else intent_hand(source, T, parts=True), T)


def measured(x: Sequence[float], step: float) -> Floats:
    """What an encoder with this step shows of x, m; x itself for a step of 0."""
    return [step * round(at / step) for at in x] if step else list(x)


@dataclass(frozen=True)
class Trace:
    """One run.

    Attributes:
        x: the device's true positions at the samples, m, a row for each tick.
        f: the forces, N, likewise.
        received: E at the end of each tick, J.
        account: E_h likewise, J.
        deepest: the greatest depth of the device, m.
    """

    x: Vector
    f: Vector
    received: Vector
    account: Vector
    deepest: float

    @property
    def reversals(self) -> float:
        """Ticks in which the force reversed, in a second."""
        chatter = Chatter([[0, 1]], T)
        for f in self.f:
            chatter.enter(f)
        return chatter.reversals[0] / (T * len(self.f))

    @property
    def noise(self) -> float:
        """RMS of the force above 100 Hz, N."""
        lines = np.fft.rfft(self.f, axis=0)
        lines[np.fft.rfftfreq(len(self.f), T) < 100.0] = 0.0
        return float(np.sqrt((np.fft.irfft(lines, len(self.f), axis=0) ** 2).sum(axis=1).mean()))

    def unrest(self, step: float, seconds: float = 1.0) -> tuple[float, float]:
        """How much the device moves along y at the end, where its hand rests, against an encoder's step, m.

        Returns:
            The amplitude of y in steps, and the greatest line of the speed's spectrum over step 2 pi f. A sine whose
            amplitude is one step is 1 in both.
        """
        n = round(seconds / T)
        y = self.x[-n - 1 :, 1]
        lines = 2.0 / n * np.abs(np.fft.rfft(np.diff(y) / T))[1:]
        limits = step * 2.0 * np.pi * np.fft.rfftfreq(n, T)[1:]
        return float(np.ptp(y)) / (2.0 * step), float((lines / limits).max())

    def stiffness(self, world: str) -> float:
        """The force over the depth while the hand rests, N/m, in the mean; not a number after a run that ended."""
        begin, end = (round(at / T) for at in REST)
        if len(self.x) < end:
            return float("nan")
        deep = float(np.mean([depth(world, x) for x in self.x[begin:end]]))
        return float(self.f[begin:end, 1].mean()) / deep


def touch(
    world: str,
    grip: Grip,
    renderer: Renderer,
    seconds: float,
    encoder: float = ENCODER,
    motion: Sequence[str] | None = None,
) -> Trace:
    """Let a hand touch the world.

    Args:
        world: "wall" or "stones".
        grip: the hand.
        renderer: computes the force.
        seconds: the length of the run; it ends earlier, with what there is, once the device is beyond 1 m.
        encoder: the encoder's step, m.
        motion: what the hand follows, x and y; None for that of :data:`MOTIONS`.
    """
    driver = device(grip, MOTIONS[world] if motion is None else motion)
    ticks, period, delay = round(seconds / T), from_seconds(T), from_seconds(DELAY)
    instants = [0, delay] + [delay + (period - delay) * i // (PIECES - 1) for i in range(1, PIECES)]
    x, f = np.zeros((ticks, 2)), np.zeros((ticks, 2))
    received, account = np.zeros(ticks), np.zeros(ticks)
    energy = burned = deepest = 0.0
    before = np.array(driver.sample(0, Instant(0)))
    exerted = np.zeros(2)
    for k in range(ticks):
        x[k] = before
        force = renderer.step(measured(before.tolist(), encoder))
        f[k] = force
        for begin, end in pairwise(instants):
            if begin == delay:
                driver.apply(force, Instant(k * period + begin))
                exerted = f[k]
            now = np.array(driver.sample(k, Instant(k * period + end)))
            moved = now - before
            energy -= float(exerted @ moved)
            burned += DAMPING * float(moved @ moved) / ((end - begin) * 1e-9)
            before = now
        received[k], account[k] = energy, energy + burned
        deepest = max(deepest, depth(world, before.tolist()))
        if not np.abs(before).max() < 1.0:
            return Trace(x[: k + 1], f[: k + 1], received[: k + 1], account[: k + 1], deepest)
    return Trace(x, f, received, account, deepest)
