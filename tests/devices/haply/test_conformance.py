"""The suite of `check-driver` on a fake service: it finds the driver in order, and each planted fault by its name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from manyhands.devices.haply import HaplyInverse3
from manyhands.launch.conformance.driver import BLOCKING, FORCE, SIGN, SILENCE, WORK, Bench, Push, check_driver
from manyhands.launch.conformance.judgement import Conformance, Judgement
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import AxisMap
from manyhands.protocol.clock import Instant, RealtimeClock

from ...fakes.haply import fake_haply

T = 0.004
"""s; longer than a busy machine takes for a message and its answer in most ticks."""

ATTEMPTS = 3
"""For what a busy machine may spoil."""


class Unkept(HaplyInverse3):
    """Its keeper does nothing: nobody ends a force in silence."""

    def _keep(self) -> None:
        return


class Waiting(HaplyInverse3):
    """It waits for the answer to a message of its own."""

    def sample(self, tick: int, at: Instant) -> Any:
        self._exchange(self._speech.force(self._force))
        self._channel.wait(2.0 * T)
        return super().sample(tick, at)


class Yesterday(HaplyInverse3):
    """It tells the work of the last tick alone."""

    def work(self) -> float | None:
        done = super().work()
        return None if done is None else done / 5.0


def judged(make: Callable[..., HaplyInverse3], push: float = 0.5, **given: Any) -> list[Judgement]:
    with fake_haply(**{"mass": 0.3, "damping": 2.0, **given}) as one:
        driver = make(("d.x", "d.y", "d.z"), T, {"port": one.port, "events": one.events, "silence": 0.9})
        stated = driver.specification()
        plugin = PluginDriver("haply-inverse3", driver, AxisMap((0, 1, 2), (1.0,) * 3), stated, T)
        return list(check_driver(Bench(plugin, T, RealtimeClock()), stated, Push(push)))


def broken(found: list[Judgement]) -> list[str]:
    return [one.check for one in found if one.verdict is Conformance.BROKEN]


def test_the_driver_is_in_order() -> None:
    found: list[Judgement] = []
    for _ in range(ATTEMPTS):
        found = judged(HaplyInverse3)
        kept = {one.check for one in found if one.verdict is Conformance.KEPT}
        if not broken(found) and {WORK, SILENCE, FORCE} <= kept:
            return
    pytest.fail(f"found {found}")


@pytest.mark.parametrize(
    ("make", "push", "given", "check"),
    [
        (HaplyInverse3, 0.5, {"sign": -1.0}, SIGN),
        pytest.param(HaplyInverse3, 2.0, {"filters": False}, FORCE, marks=pytest.mark.long),
        (Unkept, 0.5, {"idle": 10.0}, SILENCE),
        pytest.param(Waiting, 0.5, {}, BLOCKING, marks=pytest.mark.long),
        (Yesterday, 0.5, {}, WORK),
    ],
)
def test_a_planted_fault_is_named(
    make: Callable[..., HaplyInverse3], push: float, given: dict[str, Any], check: str
) -> None:
    found: list[Judgement] = []
    for _ in range(ATTEMPTS):
        found = judged(make, push, **given)
        if check in broken(found):
            return
    pytest.fail(f"found {found}")
