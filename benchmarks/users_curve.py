"""Users against late ticks: what the benchmarks of users in the tick and behind wave links share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from page import tell
from users_load import Broken

HOLDS = 0.01
"""The part of the ticks that may be late; more users do not hold."""


class Late(Protocol):
    """What was measured with one number of users."""

    @property
    def late(self) -> float:
        """The part of its ticks that were late."""
        ...


P = TypeVar("P", bound=Late)


def curve(numbers: Sequence[int], repeats: int, measure: Callable[[int], P], describe: Callable[[P], str]) -> list[P]:
    """The medians by late ticks of every number of users, up to two in a row that do not hold, or one that breaks."""
    points: list[P] = []
    for users in numbers:
        try:
            runs = [measure(users) for _ in range(repeats)]
        except Broken as error:
            tell(f"{users} users: {error}")
            break
        points.append(sorted(runs, key=lambda run: run.late)[repeats // 2])
        tell(f"{users} users{describe(points[-1])}")
        if len(points) > 1 and all(point.late > HOLDS for point in points[-2:]):
            break
    return points


def headline(content: Mapping[str, Any]) -> str:
    """How a table was measured, and on which machine."""
    machine = ", ".join(f"{name} {value}" for name, value in content["machine"].items())
    return f"{content['seconds']:g} s each, median of {content['repeats']} by late ticks; {machine}."


def verdict(most: int, target: int) -> str:
    """The greatest number of users that holds, beside what was aimed at."""
    met = "met" if most >= target else "missed"
    return f"at most {HOLDS:.0%} late with up to {most} users; target {target}: {met}."
