"""Random devices with dry friction at stiff walls, and hands that look for energy there (`make friction`).

Each session has a device of 0.02 to 0.5 N*s/m and 0.02 to 0.5 N of dry friction at 0.5 to 4 kHz, and a spring to a
wall that is proved below a speed v*, by 5 % softer than the greatest that v* allows. The same spring is refused without
the friction. Half of the devices burn more than that at rest, and in places (:class:`FrictionCurve`), which no claim
counts. Hands dither at Nyquist's rate, turn round within the stiction, creep, push along their own motion, or do what
they like; delays are within the certificate, or far beyond.

What has to hold: no account is below its bound; where delays were covered and every piece of motion was slower than v*,
no account falls below 0 and nothing was enforced; no device runs away. Where delays are covered, the tank has 1 J: with
5 mJ a device keeps strong forces back for the lateness that might come, with friction or without. With ``--table``, the
stiffness that friction adds by b, c and v*, in Markdown.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys
import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from manyhands.design.certificate import Certificate
from manyhands.design.errors import DesignError
from manyhands.design.levels.dry_friction import DryFriction
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.device import held_device
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperGiven
from manyhands.design.synthesis import design
from manyhands.nodes.device.friction import DryPlant
from manyhands.nodes.device.simulated import Hand, HeldDeviceDriver, Intention
from manyhands.nodes.device.tick import WallTimeTick
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import WALL, DeviceBundle, DeviceRung, Limits, SimulatedHand
from manyhands.nodes.kernel.friction_curve import FrictionCurve
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.messages import Figures
from tests.support.mechanisms import mechanism_bundle

WALL_STIFFNESS: Final = 1e7  # N/m: a wall that hardly yields
BELOW_LIMIT: Final = 0.95
TANK: Final = LatenessAllowance(5e-3, 1e-3)
FULL: Final = LatenessAllowance(1.0, 1e-3)
KINDS: Final = ("dithers", "turns", "creeps", "drives", "any")
ROUNDING: Final = 1e-9  # J
TICKS: Final = 240
AWAY: Final = 0.5  # m: a device that ran away


@dataclass(frozen=True)
class Drawn:
    """A random session: T and tau in s, b in N*s/m, c in N, v* in m/s, K in N/m."""

    T: float
    tau: float
    b: float
    c: float
    speed: float

    @property
    def stiffness(self) -> float:
        """The spring that is allowed below v*, and a little less."""
        return BELOW_LIMIT * greatest(self.b + self.c / self.speed, self.T, self.tau)


def greatest(level: float, T: float, tau: float) -> float:
    """The stiffest plain spring at a level (N*s/m), for every sequence of delays up to tau (s), N/m."""
    return level / (0.5 * T + 1.5 * tau)


def drawn(rng: np.random.Generator) -> Drawn:
    """A session."""
    T = float(rng.choice([2.5e-4, 5e-4, 1e-3, 2e-3]))
    b, c = (float(np.exp(rng.uniform(np.log(0.02), np.log(0.5)))) for _ in range(2))
    speed = float(np.exp(rng.uniform(np.log(0.02), np.log(0.5))))
    return Drawn(T, float(rng.choice([0.0, 0.1, 0.5, 1.0])) * T, b, c, speed)


def certified(of: Drawn, friction: bool) -> Certificate | None:
    """The certificate of the spring at a wall, with the friction or without it; None where it is refused."""
    wall = Network(("p",), (), (NetworkLink(("p", GROUND), WALL_STIFFNESS, 0.0),))
    device = DeviceLevel("d", (0,), np.array([[of.b]]), friction=(of.c,) if friction else None)
    speed = of.speed if friction else None
    loop = HapticLoop("wall", of.T, ("p",), (device,), Partition(("c",), ((0,),)), wall, tau=of.tau, speed=speed)
    given = SpringDamperGiven(SpringDamper(np.array([[of.stiffness]]), np.array([[0.0]])))
    try:
        return design(loop, given).certificate
    except DesignError:
        return None


def burned(of: Drawn, rng: np.random.Generator) -> tuple[float] | FrictionCurve:
    """The friction of a device with the least c: constant, or up to five times as much at rest and in places."""
    if rng.random() < 0.5:
        return (of.c,)
    most, static = ((of.c * float(rng.uniform(1.0, 5.0)),) for _ in range(2))
    pitch, stribeck = (
        (float(np.exp(rng.uniform(np.log(low), np.log(high)))),) for low, high in ((1e-5, 1e-2), (1e-3, 0.1))
    )
    return FrictionCurve((of.c,), most, pitch, static, stribeck)


class Hostile(Hand):
    """A hand of one kind on a device with one axis."""

    def __init__(
        self,
        of: Drawn,
        friction: tuple[float] | FrictionCurve,
        kind: str,
        mass: float,
        firm: bool,
        rng: np.random.Generator,
    ) -> None:
        nothing = StateSpace.static(np.zeros((1, 1)))
        hold = ([200.0], [1e6]) if firm else ([float(rng.uniform(0.0, 5.0))], [float(rng.uniform(0.0, 300.0))])
        self.plant = DryPlant(held_device([mass], [of.b], nothing, *hold), of.T, friction)
        self._of, self._kind, self._rng, self._firm = of, kind, rng, firm
        self._size, self._way = float(rng.choice([0.2, 0.9, 0.98, 3.0])) * of.speed, 1.0

    def prepare(self, tick: int) -> None:
        """Nothing."""

    def intend(self, tick: int, state: Floats) -> tuple[Floats, Intention]:
        """A motion of a firm hand, or a force of a soft one; nothing in the last third."""
        if tick > 2 * TICKS // 3:
            return state, Intention([0.0], [0.0])
        match self._kind:
            case "dithers":
                self._way = -self._way
            case "turns":
                self._way = self._way if self._rng.random() < 0.6 else -self._way
            case "drives":
                self._way = 1.0 if state[1] >= 0.0 else -1.0
            case "any":
                self._way = float(self._rng.uniform(-1.0, 1.0))
        size = 0.02 if self._kind == "creeps" else 1.0
        if self._firm:
            return state, Intention([0.0], [size * self._size * self._way])
        return state, Intention([self._way * (self._of.c * float(self._rng.uniform(0.8, 1.5)))], [0.0])

    def figures(self) -> Figures:
        """None."""
        return Figures()

    def close(self) -> None:
        """Nothing."""


@dataclass
class Ran:
    """What came of a session: of pieces the greatest speed (m/s), the account (J), and what was done about it."""

    fastest: float
    least: float
    margin: float
    changed: int
    furthest: float
    curved: bool


_base = functools.cache(mechanism_bundle)


def run(of: Drawn, found: Certificate, covered: bool, rng: np.random.Generator) -> Ran:
    """Run the device in wall time."""
    base, kind, firm = _base(), str(rng.choice(KINDS)), bool(rng.random() < 0.5)
    mass = 1e-5 if firm else float(rng.uniform(0.02, 0.5))
    friction = burned(of, np.random.default_rng(rng.integers(2**32)))
    hand = Hostile(of, friction, kind, mass, firm, rng)
    nothing = StateSpace.static(np.zeros((1, 1)))
    physics = SimulatedHand((mass,), (of.b,), nothing, (0.0,), (0.0,), (0.0,), (0.0,), friction=friction)
    tick = WallTimeTick(
        DeviceBundle(
            dataclasses.replace(base.common, ports=("d",), period=of.T),
            np.array([[of.b]]),
            (DeviceRung(found.tau, 0.0, found.levels.device),),
            physics,
            Limits((1e3,), (10.0,), (2.0,)),
            WALL,
            FULL if covered else TANK,
            None if firm else Inertia((mass,), (50.0,), (0.0,)),
            friction=DryFriction((of.c,), (0.0,), of.speed),
        ),
        HeldDeviceDriver(hand, of.T),
    )
    period, at, place, fastest, furthest = from_seconds(of.T), 0, 0.0, 0.0, 0.0
    before = None
    for number in range(TICKS):
        sampled = max(number * period, at)
        sent = tick.sample(number, Instant(sampled))
        late = rng.uniform(0.0, of.tau) if covered else rng.uniform(0.0, 3.0 * of.T) * (rng.random() < 0.3)
        at = sampled + int(1e9 * late)
        tick.exert([-of.stiffness * sent[0]], Instant(at))
        tick.book()
        for to, when in ((tick.x[0], sampled), ((tick.x_a or tick.x)[0], at)):
            if before is not None and when > before:
                fastest = max(fastest, abs(to - place) / (1e-9 * (when - before)))
            place, before = to, when
        furthest = max(furthest, abs(place))
    account = tick.wall_interface
    curved = isinstance(friction, FrictionCurve)
    return Ran(fastest, account.account.least, account.margin, account.ticks, furthest, curved)


def table() -> None:
    """Print what friction adds to the stiffness of a plain spring."""
    print("| b, N·s/m | c, N | v*, m/s | (c)/v*, N·s/m | 1 kHz, τ = 1 ms | 1 kHz, τ = 0.25 ms | 4 kHz, τ = 0.1 ms |")
    print("|---:|---:|---:|---:|---:|---:|---:|")
    for b, c in ((0.02, 0.05), (0.1, 0.1), (0.1, 0.3), (0.5, 0.2)):
        for speed in (0.05, 0.2, 0.5):
            cells = []
            for T, tau in ((1e-3, 1e-3), (1e-3, 2.5e-4), (2.5e-4, 1e-4)):
                without, with_it = (greatest(level, T, tau) for level in (b, b + c / speed))
                cells.append(f"{without:,.0f} → {with_it:,.0f}")
            print(f"| {b:g} | {c:g} | {speed:g} | {c / speed:.3g} | {' | '.join(cells)} |")


def main() -> int:
    """Run so many sessions; returns 1 where something did not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    if options.table:
        table()
        return 0
    began, failed = time.monotonic(), 0
    ran: dict[str, list[Ran]] = {"below": [], "beyond v*": [], "beyond tau": []}
    for number in range(options.sessions):
        rng = np.random.default_rng([options.seed, number])
        of = drawn(rng)
        found = certified(of, friction=True)
        covered = bool(rng.random() < 0.6)
        if found is None or certified(of, friction=False) is not None:
            print(f"session {number}: {of} is refused, or certified without its friction")
            failed += 1
            continue
        one = run(of, found, covered, rng)
        kind = "beyond tau" if not covered else "below" if one.fastest <= of.speed else "beyond v*"
        ran[kind].append(one)
        wrong = one.margin < -ROUNDING or one.furthest > AWAY
        if wrong or (kind == "below" and (one.least < -ROUNDING or one.changed)):
            print(f"session {number}: {of}, {kind}: {one}")
            failed += 1
    print(f"{options.sessions} sessions, {time.monotonic() - began:.0f} s; {failed} in which something did not hold")
    for kind, each in ran.items():
        if each:
            enforced, furthest = sum(one.changed > 0 for one in each), 1e3 * max(one.furthest for one in each)
            least, margin = (
                1e3 * min(numbers) for numbers in zip(*((one.least, one.margin) for one in each), strict=True)
            )
            curved = sum(one.curved for one in each)
            print(
                f"{kind}: {len(each)} sessions, {curved} with more friction; least account {least:.3g} mJ, "
                f"least margin {margin:.3g} mJ, enforced in {enforced}, furthest {furthest:.3g} mm"
            )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
