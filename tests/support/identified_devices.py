"""Random devices for identification, and what came of them: for `make identify`, and a few of them for the tests."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from manyhands.design.identification import NotOfThisClass, TooLittle
from manyhands.launch.identify.experiment import experiment
from manyhands.launch.identify.rig import Aborted, Rig, Safety
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import AxisMap
from manyhands.protocol.clock import SimulatedClock

from .identified_plants import Arm, Delta, PlantDriver, Slide, WorkingDriver

ARMS: Final = 10
"""One in so many is an arm."""

DRAGS: Final = 5
"""One in so many is a slide with drag, half of these without damping."""

DELTAS: Final = 1_000_000
"""From this number on all are delta robots."""

T: Final = 0.002
"""s; the period of the loop, half of the usual rate to save time."""

ROUNDING: Final = 1e-9
COVERED: Final = 0.95


@dataclass(frozen=True)
class Outcome:
    """What came of one device."""

    number: int
    kind: str
    truth: tuple[float, float]  # the least damping on the ways, and friction on the first line
    damping: tuple[float, float] = (0.0, 0.0)
    friction: tuple[float, float] = (0.0, 0.0)
    latency: float = 0.0
    refused: str = ""

    @property
    def false(self) -> bool:
        """Whether a lower end is above the truth."""
        more = 1.0 + ROUNDING
        return self.damping[0] > self.truth[0] * more or self.friction[0] > self.truth[1] * more

    @property
    def stated(self) -> bool:
        """Whether an osp is stated: an interval from 0 on says nothing."""
        return not self.refused and self.damping[0] > 0.0

    @property
    def covered(self) -> bool:
        """Whether the interval of the damping holds the truth."""
        return not self.refused and self.damping[0] <= self.truth[0] <= self.damping[1]

    @property
    def useful(self) -> bool:
        """Whether what is stated is more than half of the truth."""
        return self.stated and self.damping[0] > 0.5 * self.truth[0]


def random_driver(number: int, seed: int) -> tuple[PlantDriver, float, str]:
    """The device of this number, the period that it is moved with (s), and its kind."""
    random = np.random.default_rng([seed, number])

    def within(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    def sometimes(part: float, value: float) -> float:
        return value if random.random() < part else 0.0

    age, delay = sometimes(0.6, within(1e-4, 1e-3)), sometimes(0.6, within(1e-4, 1e-3))
    jitter = float(random.choice([0.0, 0.3, 1.0])) * age
    step = float(random.choice([1e-6, 5e-6, 1e-5, 2e-5, 5e-5]))
    noise = sometimes(0.3, within(1e-6, 2e-5))
    if number >= DELTAS:
        one, other = within(0.003, 0.03), within(0.0005, 0.01)
        spread = [float(random.uniform(0.7, 1.4)) for _ in range(6)]
        plant = Delta(
            within(0.08, 0.25),
            (within(5e-5, 5e-4),) * 3,
            (one * spread[0], one * spread[1], one * spread[2]),
            (other * spread[3], other * spread[4], other * spread[5]),
        )
        return PlantDriver(plant, step, noise, age, jitter, delay, seed=number, h=1e-3), T, "delta"
    if number % ARMS == 0:
        damping, friction = (within(0.002, 0.02), within(0.002, 0.02)), (within(1e-4, 0.01), within(1e-4, 0.01))
        torques = bool(random.random() < 0.5)
        home = (float(random.uniform(-0.5, 0.5)), float(random.uniform(1.2, 1.9)))
        arm = Arm((0.14, 0.14), (within(0.03, 0.1), within(0.05, 0.15)), damping, friction, home, torques)
        make = WorkingDriver if torques else PlantDriver
        return make(arm, step, noise, age, jitter, delay, seed=number), T, "arm"
    c = sometimes(0.8, within(0.005, 1.0))
    m = within(0.04, 0.8)
    slide = Slide(
        m=m,
        b=within(0.03, 2.0),
        c=c,
        teeth=sometimes(0.4, c * float(random.uniform(0.0, 0.5))),
        pitch=float(random.uniform(0.008, 0.04)),
        static=sometimes(0.5, c * float(random.uniform(0.0, 1.0))),
        stribeck=within(0.001, 0.03),
        slope=sometimes(0.5, float(random.uniform(-3.0, 3.0))),
        g=sometimes(0.5, float(random.uniform(-0.8, 0.8))),
        k=sometimes(0.3, float(random.uniform(-5.0, 5.0))),
    )
    kind = "slide"
    if number % DRAGS == 1:  # at 0.25 m/s it pulls as much as the damping would
        power = float(random.choice([1.5, 2.0, 2.0, float(random.uniform(1.5, 3.0))]))
        slide.drag, slide.power = slide.b * float(random.uniform(0.2, 2.0)) / 0.25 ** (power - 1.0), power
        if random.random() < 0.5:
            slide.b = 0.0
        kind = "drag" if slide.b == 0.0 else "damping and drag"
    return PlantDriver(slide, step, noise, age, jitter, delay, seed=number, h=5e-4), T, kind


def least_damping(plant: Slide | Arm | Delta, travel: float) -> float:
    """The least eigenvalue of B on the ways: in the middle, and half and all of the way along many lines, N*s/m."""
    m = plant.axes
    lines = [u for u in product((-1.0, -0.5, 0.0, 0.5, 1.0), repeat=m) if any(u)]
    places = [part * travel * np.array(u) / np.linalg.norm(u) for u in lines for part in (0.5, 1.0)]
    return min(float(np.linalg.eigvalsh(plant.damping(list(x)))[0]) for x in (np.zeros(m), *places))


def identified(number: int, seed: int) -> Outcome:
    """Identify the device of this number."""
    driver, period, kind = random_driver(number, seed)
    plant, m = driver.plant, driver.plant.axes
    first = np.eye(m)[0]
    safety = (Safety(force=4.0), Safety(4.0, 0.04, 0.4), Safety(4.0, 0.025, 0.3))[m - 1]
    truth = least_damping(plant, safety.travel), plant.friction(first)
    own = AxisMap(tuple(range(m)), (1.0,) * m)
    plugin = PluginDriver("counterpart", driver, own, driver.stated, period)
    rig = Rig(plugin, driver.stated, period, SimulatedClock(), safety)
    latency = driver.stated.timing.latency
    try:
        found = experiment(rig).found
    except (Aborted, NotOfThisClass, TooLittle) as error:
        return Outcome(number, kind, truth, latency=latency, refused=f"{type(error).__name__}: {error}")
    finally:
        rig.close()
    one = found.friction[0]
    damping = found.damping
    return Outcome(number, kind, truth, (damping.low, damping.high), (one.low, one.high), latency)


def summary(every: list[Outcome]) -> tuple[list[str], bool]:
    """Lines to print, and whether all that has to hold does."""
    told = [one for one in every if one.stated]
    refused = [one for one in every if one.refused]
    false = [one for one in every if one.false]
    covered = sum(one.covered for one in told)
    lines = [
        f"{len(every)} devices: an osp is stated of {len(told)}, nothing of "
        f"{len(every) - len(told) - len(refused)}, refused {len(refused)}; "
        f"lower ends above the truth: {len(false)}; intervals that hold it: {covered} of {len(told)} stated"
    ]
    slides = [one for one in every if one.kind == "slide"]
    groups = {
        "slides, latency 0": [one for one in slides if one.latency == 0.0],
        "slides, up to 0.5 ms": [one for one in slides if 0.0 < one.latency <= 5e-4],
        "slides, beyond": [one for one in slides if one.latency > 5e-4],
        **{kind: [one for one in every if one.kind == kind] for kind in ("damping and drag", "drag", "arm", "delta")},
    }
    for name, group in groups.items():
        if not group:
            continue
        ends = np.array([one.damping[0] / one.truth[0] for one in group if one.truth[0] and not one.refused] or [0.0])
        dry = np.array([one.friction[0] / one.truth[1] for one in group if one.truth[1] and not one.refused] or [0.0])
        lines.append(
            f"  {name}: {len(group)}, useful {sum(one.useful for one in group)}, nothing "
            f"{sum(not one.stated and not one.refused for one in group)}, refused "
            f"{sum(bool(one.refused) for one in group)}; lower end / truth of the damping: median "
            f"{np.median(ends):.2f}, quartiles {np.quantile(ends, 0.25):.2f} and {np.quantile(ends, 0.75):.2f}; of the "
            f"friction: median {np.median(dry):.2f}"
        )
    lines += [f"  FALSE: {one}" for one in false]
    lines += [f"  missed: {one}" for one in every if not one.covered and not one.refused]
    lines += [f"  refused, {one.kind} {one.number}: {one.refused}" for one in refused]
    return lines, not false and covered >= COVERED * len(told)
