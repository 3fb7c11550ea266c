"""Linkages of the sizes that devices on desks have, away from singular poses. They are examples, and no product's."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import product

import numpy as np
from flint import fmpq

from manyhands.design.models.linkage import Delta, FiveBar, Linkage, LinkageError, Poses, SerialChain, greatest_bending
from manyhands.design.models.statespace import matrix
from manyhands.design.proof.exact import Item
from manyhands.design.proof.linkage import LinkageData, bends_at_most, read_linkage

ARM = SerialChain(Poses((-1.0, 0.9), (1.0, 2.5)), (2, 2), matrix([[0.12, 0.0, 0.0], [0.14, 0.0, 0.0]]))
STYLUS = SerialChain(
    Poses((-0.8, -0.3, -2.0), (0.8, 0.8, -1.0)), (1, 2, 2), matrix([[0.0] * 3, [0.133, 0.0, 0.0], [0.133, 0.0, 0.0]])
)
FIVE_BAR = FiveBar(Poses((-0.05, 0.13), (0.05, 0.19)), apart=0.06, upper=0.12, rod=0.16)
DELTA = Delta(Poses((-0.04, -0.04, 0.12), (0.04, 0.04, 0.16)), base=0.06, platform=0.03, upper=0.08, rod=0.16)

LINKAGES: dict[str, Linkage] = {"chain of two": ARM, "chain of three": STYLUS, "five-bar": FIVE_BAR, "delta": DELTA}

_CONDITION = 4.0  # of J at most, in the middle and the corners


def data_of(linkage: Linkage) -> LinkageData:
    """What the prover reads of it."""
    return read_linkage(Item(linkage.describe(), "linkage"))


def rational(number: float) -> fmpq:
    """The number, exactly."""
    exact = Fraction(number)
    return fmpq(exact.numerator, exact.denominator)


def least_proved(linkage: Linkage, most_parts: int, width: float = 0.01, most: float = 1.5) -> float:
    """The least kappa that is proved with so many parts, over that of the search; by bisection.

    Args:
        linkage: the linkage.
        most_parts: that a proof may take.
        width: how exactly.
        most: infinite if not even this factor is proved.
    """
    data, kappa = data_of(linkage), greatest_bending(linkage)
    proved = lambda factor: bends_at_most(data, rational(kappa * factor), most_parts).holds  # noqa: E731
    if not proved(most):
        return np.inf
    low, high = 0.9, most
    while high - low > width:
        middle = (low + high) / 2.0
        low, high = (low, middle) if proved(middle) else (middle, high)
    return high


def random_linkage(kind: str, random: np.random.Generator) -> Linkage:
    """A linkage of the kind with a narrow box, in which J is of a good condition."""
    while True:
        linkage = _DRAWN[kind](lambda low, high: float(random.uniform(low, high)))
        box = linkage.poses
        corners = product(*zip(box.low, linkage.home.tolist(), box.high, strict=True))
        try:
            if max(np.linalg.cond(linkage.jacobian(np.array(pose))) for pose in corners) < _CONDITION:
                return linkage
        except (LinkageError, np.linalg.LinAlgError):
            continue


Uniform = Callable[[float, float], float]


def _around(middles: list[float], halves: list[float]) -> Poses:
    return Poses(
        tuple(a - b for a, b in zip(middles, halves, strict=True)),
        tuple(a + b for a, b in zip(middles, halves, strict=True)),
    )


def _chain_of_two(uniform: Uniform) -> Linkage:
    links = [[uniform(0.08, 0.2), uniform(-0.03, 0.03), 0.0] for _ in range(2)]
    return SerialChain(_around([0.0, uniform(0.6, 2.5)], [1.0, 0.3]), (2, 2), matrix(links))


def _chain_of_three(uniform: Uniform) -> Linkage:
    turns = ((1, 2, 2), (2, 1, 1), (2, 0, 1))[int(uniform(0, 3))]
    links = [[uniform(-0.2, 0.2) for _ in range(3)] for _ in range(3)]
    return SerialChain(_around([0.0, uniform(-1.0, 1.0), uniform(-2.5, 2.5)], [0.8, 0.15, 0.15]), turns, matrix(links))


def _five_bar(uniform: Uniform) -> Linkage:
    upper = uniform(0.08, 0.15)
    box = _around([uniform(-0.02, 0.02), uniform(0.1, 0.2)], [0.02, 0.015])
    return FiveBar(box, apart=uniform(0.0, 0.1), upper=upper, rod=upper * uniform(1.0, 1.6))


def _delta(uniform: Uniform) -> Linkage:
    upper, platform = uniform(0.06, 0.12), uniform(0.02, 0.04)
    box = _around([uniform(-0.02, 0.02), uniform(-0.02, 0.02), uniform(0.08, 0.2)], [0.01, 0.01, 0.01])
    return Delta(
        box, base=platform + uniform(0.01, 0.06), platform=platform, upper=upper, rod=upper * uniform(1.6, 2.4)
    )


_DRAWN: dict[str, Callable[[Uniform], Linkage]] = {
    "chain of two": _chain_of_two,
    "chain of three": _chain_of_three,
    "five-bar": _five_bar,
    "delta": _delta,
}
