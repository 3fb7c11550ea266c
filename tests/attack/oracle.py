"""Contradictions to a certificate: suspects in floats, and those that long numbers confirm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from flint import ctx

from tests.attack.arithmetic import BITS, Floats, Precise
from tests.attack.hands import at_level, worst
from tests.attack.linkages import pays
from tests.attack.loop import Hand, Repeating, Tick, growth
from tests.attack.mechanisms import at_its_level, orientations
from tests.attack.mechanisms import steps as of_steps
from tests.attack.parties import Data, NoSystem, Reader, precise
from tests.attack.passivity import confirmed, levels, mixture_levels, poles, statics, suspects

SHAKEN = 1e-7  # of a period, in floats: eigenvalues at 1 that meet are split by the root of rounding
PAYS = 1e-6  # relative: sums of a few hundred terms in floats, whose differences are a millionth of them
MOST_STEPS = 10  # of the search among motions, each of some hundred of them
CERTAIN = 1e-30  # in long numbers of 600 bits, where six that meet are split by 2^-100


@dataclass
class Judgement:
    """What was looked at and found.

    Attributes:
        loops: how many closed loops.
        suspects: what floats contradict.
        findings: what long numbers, or rationals, contradict too.
        growth: of a period, the greatest that is certain.
    """

    loops: int = 0
    suspects: list[str] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    growth: float = 0.0

    def __iadd__(self, other: Judgement) -> Judgement:
        """Both together."""
        self.loops += other.loops
        self.suspects += other.suspects
        self.findings += other.findings
        self.growth = max(self.growth, other.growth)
        return self


def judge(data: Data, rng: np.random.Generator, draws: int = 3, steps: int = 0) -> Judgement:
    """Hold a certificate against everything that it claims.

    Args:
        data: the certificate's plain data.
        rng: for hands, delays, clutches and members of intervals.
        draws: random loops of each kind.
        steps: of the search from the worst of them.
    """
    out, stated = Judgement(), data
    data = at_its_level(stated)
    for what in [*statics(data), *levels(data), *of_steps(stated), *orientations(stated)]:
        out.suspects.append(what)
        out.findings.append(what)
    if out.findings and data["environment"]["type"] != "declared" and rng.random() < 0.1:
        out.growth = alone(data)
    with np.errstate(all="ignore"):
        for what, A in poles(Reader(data, Floats())).items():
            if Floats().radius(A) > -1e-9:
                out.suspects.append(what)
                with ctx.workprec(BITS):
                    if Precise().radius(poles(precise(data))[what]) >= 0.0:
                        out.findings.append(what)
        high = int(rng.integers(2**31))
        ratios = tuple(float(rng.choice([1.0, 1.0, rng.random()])) for _ in data["structure"])
        for suspect in suspects(data, ratios, high):
            out.suspects.append(suspect.what)
            with ctx.workprec(BITS):
                if confirmed(data, suspect, high):
                    out.findings.append(f"{suspect.what}, at {suspect.angle:.4g} rad")
        if data["environment"]["type"] != "declared":
            out += shaken([data], rng, draws, steps)
        out += paid(stated, rng, steps)
        out += shaken([at_level(rng, data)], rng, max(draws // 2, 1), steps, "with an environment at its level: ")
    return out


def paid(data: Data, rng: np.random.Generator, steps: int) -> Judgement:
    """Whether some motion of an arm that holds torques gives more than the mechanism burns."""
    out = Judgement()
    if any("linkage" in device.get("held", {}) for device in data["devices"].values()):
        ratio, out.loops = pays(data, rng, min(steps, MOST_STEPS))
        if ratio > 1.0 + PAYS:
            out.suspects.append("held torques pay")
            out.findings.append(f"held torques pay {ratio:.6g} times what is burnt")
    return out


def alone(data: Data) -> float:
    """Growth without hands at the devices, light or heavy, in long numbers: the effect of nonpassive statics."""
    return max(_alone(data, ticks) for ticks in (1.0, 1e3))


def _alone(data: Data, ticks: float) -> float:
    """With masses that stop within so many ticks."""
    hands = []
    for device in data["devices"].values():
        m = len(device["osp"])
        mass = ticks * data["period"] * sum(device["osp"][i][i] for i in range(m)) / m
        zeros = [[0.0] * m for _ in range(m)]
        hands.append(Hand([[mass * (i == j) for j in range(m)] for i in range(m)], zeros, zeros))
    tick = Tick((0.0,) * len(hands), (1.0,) * len(data["structure"]))
    with ctx.workprec(BITS):
        try:
            value = growth([precise(data)], Repeating(tuple(hands), (tick,)))
        except (ArithmeticError, NoSystem):
            return 0.0
    return value if value > CERTAIN else 0.0


def judge_ladder(
    rungs: Sequence[Data], common: int, independent: bool, rng: np.random.Generator, draws: int = 4
) -> Judgement:
    """Hold a ladder against what it claims: mixtures of rungs, together where they are not independent.

    The environment is the ladder's own, then one exactly at the level of the rung ``common``, which serves all.
    """
    out = Judgement()
    if independent:
        out.findings += mixture_levels(list(rungs))
        out.suspects += out.findings
    with np.errstate(all="ignore"):
        out += shaken(list(rungs), rng, draws, 2 * draws, "in a mixture of rungs: ", independent)
        worst_environment = at_level(rng, rungs[common])["environment"]
        levelled = [{**rung, "environment": worst_environment} for rung in rungs]
        where = "in a mixture of rungs, with an environment at their level: "
        out += shaken(levelled, rng, draws, 2 * draws, where, independent)
    return out


def shaken(
    rungs: Sequence[Data], rng: np.random.Generator, draws: int, steps: int, where: str = "", independent: bool = True
) -> Judgement:
    """Whether some passive hand shakes the loop; what does so in floats is built again in long numbers."""
    value, loop, looked = worst(rng, [Reader(data, Floats()) for data in rungs], draws, steps, independent)
    out = Judgement(looked)
    if loop is None or not value > SHAKEN:
        return out
    out.suspects.append(f"{where}shaken")
    with ctx.workprec(BITS):
        try:
            certain = growth([precise(data) for data in rungs], loop)
        except (ArithmeticError, NoSystem):
            return out
    if certain > CERTAIN:
        out.growth = certain
        out.findings.append(f"{where}shaken, by {certain:.3g} in {len(loop.ticks)} ticks")
    return out
