"""The suite for models: good ones pass, and each broken one is named for what it is."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from manyhands.launch.conformance.driver import BLOCKING, EXCEPTION, SIGN, WRONG_ANSWER
from manyhands.launch.conformance.judgement import Conformance, Judgement, broken
from manyhands.launch.conformance.model import HELD, LEVEL, REPEATED, check_model
from manyhands.launch.conformance.timing import CallTimer

T = 1e-3
PORTS = ("a", "b")


class Model:
    """A model whose answer is a function of the tool positions and the tick."""

    def __init__(self, answer: Callable[[np.ndarray, int], Any]) -> None:
        self._answer = answer

    def react(self, x_e: np.ndarray, k: int) -> Any:
        return self._answer(x_e, k)


def timer_of(ticks: Iterator[int]) -> CallTimer:
    return CallTimer(lambda: next(ticks), lambda: 0)


def findings(make: Callable[[], Callable[[np.ndarray, int], Any]], level: float | None = None) -> list[Judgement]:
    ticks = itertools.count(0, 1000)  # ns: every look at the clock is 1 us later
    return list(check_model("some:model", lambda: Model(make()), PORTS, T, 0.02, level, timer_of(ticks)))


def spring(stiffness: float) -> Callable[[], Callable[[np.ndarray, int], Any]]:
    return lambda: lambda x_e, k: -stiffness * x_e


def damper(damping: float) -> Callable[[np.ndarray, int], Any]:
    last = np.zeros(2)

    def answer(x_e: np.ndarray, k: int) -> np.ndarray:
        nonlocal last
        v, last = (x_e - last) / T, x_e
        return -damping * v - 100.0 * x_e

    return answer


def test_a_spring_and_a_damper_keep_everything() -> None:
    for make in (spring(1000.0), lambda: damper(2.0)):
        assert {finding.verdict for finding in findings(make)} == {Conformance.KEPT}
        assert broken(findings(make, level=0.0)) == []


def test_a_world_that_no_probe_has_met_is_not_judged() -> None:
    found = {one.check: one for one in findings(lambda: lambda x_e, k: -500.0 * np.maximum(x_e - 0.5, 0.0))}
    for check in (SIGN, LEVEL):
        assert found[check].verdict is Conformance.OPEN
        assert found[check].text == "no motion of up to 0.02 m met a force; --reach tries further ones"
    assert broken(found.values()) == []


def test_the_level_that_the_probes_need_is_that_of_a_negative_damper() -> None:
    """Its ledger falls by b w^T w T in every tick; its spring, asked at the newest position, burns k T / 2 of it."""
    (found,) = (finding for finding in findings(lambda: damper(-0.3)) if finding.check == LEVEL)
    assert found.verdict is Conformance.OPEN
    assert float(found.text.split("level of ")[1].split()[0]) == pytest.approx(0.3 - 100.0 * T / 2.0, abs=0.005)
    assert broken(findings(lambda: damper(-0.3), level=0.2)) == [LEVEL]
    assert broken(findings(lambda: damper(-0.3), level=0.31)) == []


def raising(x_e: np.ndarray, k: int) -> Any:
    if abs(x_e[0]) > 0.01:
        raise LookupError("no such contact")
    return np.zeros(2)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: raising, EXCEPTION),
        (lambda: lambda x_e, k: np.zeros(3), WRONG_ANSWER),
        (lambda: lambda x_e, k: np.full(2, np.nan), WRONG_ANSWER),
        (spring(-30.0), SIGN),
    ],
)
def test_a_broken_model_is_named_for_what_it_is(
    make: Callable[[], Callable[[np.ndarray, int], Any]], name: str
) -> None:
    assert broken(findings(make)) == [name]


class Overshooting:
    """Proxies that go further than their tools, which the proxy test holds where no spring is stretched, too."""

    def proxy(self, x: np.ndarray, k: int) -> np.ndarray:
        return x if k % 3 == 2 else 1.5 * x


def test_no_more_steps_are_held_than_there_were() -> None:
    ticks = itertools.count(0, 1000)
    (text,) = (
        finding.text
        for finding in check_model("some:model", Overshooting, PORTS, T, 0.02, None, timer_of(ticks), 2000.0)
        if finding.check == HELD
    )
    held, of = map(int, re.findall(r"shortened (\d+) of (\d+) steps", text)[0])
    assert 0 < held <= of


def test_a_model_that_differs_from_run_to_run_is_named() -> None:
    runs = itertools.count()

    def make() -> Callable[[np.ndarray, int], Any]:
        stiffness = 100.0 + next(runs)
        return lambda x_e, k: -stiffness * x_e

    assert broken(findings(make)) == [REPEATED]


def test_a_slow_model_is_named() -> None:
    ticks = itertools.count(0, round(0.6e9 * T))
    found = list(check_model("some:model", lambda: Model(spring(10.0)()), PORTS, T, 0.02, None, timer_of(ticks)))
    assert broken(found) == [BLOCKING]
