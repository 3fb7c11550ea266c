"""The driver of docs/drivers.md for a device behind a network, as it stands there, with a fake at the other end."""

from __future__ import annotations

import json
import select
import sys
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from manyhands.launch.conformance.driver import BLOCKING, SILENCE, STALE, Bench, Push, check_driver
from manyhands.launch.conformance.judgement import Conformance, Judgement
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import AxisMap
from manyhands.protocol.clock import RealtimeClock

from ..fakes.ethernet import fake_controller
from ..fakes.ordered import OrderedFake
from .test_plugin_docs import manyhands, written

T = 0.002
ATTEMPTS = 3
"""A busy machine gives the fake no turn now and then."""

Made = Callable[[], Any]


@pytest.fixture
def far(tmp_path: Path) -> Iterator[OrderedFake]:
    written("drivers", tmp_path)
    with fake_controller(tmp_path) as one:
        yield one


@pytest.fixture
def make(far: OrderedFake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Made]:
    monkeypatch.syspath_prepend(tmp_path)
    kind, drivers = import_module("my_controller").Controller, []

    def made() -> Any:
        drivers.append(kind(("d.x", "d.y"), T, {"address": far.path}))
        return drivers[-1]

    yield made
    for driver in drivers:
        driver.close()
    sys.modules.pop("my_controller", None)


def heard(driver: Any, enough: Callable[[], bool]) -> None:
    """Read states until it is enough."""
    end = time.monotonic() + 5.0
    while not enough():
        assert time.monotonic() < end
        select.select([driver.link], [], [], 0.05)
        driver.sample(0, 0)


def judged(driver: Any) -> list[Judgement]:
    stated = driver.specification()
    plugin = PluginDriver("controller", driver, AxisMap((0, 1), (1.0, 1.0)), stated, T)
    return list(check_driver(Bench(plugin, T, RealtimeClock()), stated, Push()))


def broken(found: list[Judgement]) -> set[str]:
    """What is broken, but for calls and samples that came late: both processes share a busy machine."""
    return {one.check for one in found if one.verdict is Conformance.BROKEN} - {BLOCKING, STALE}


@pytest.mark.alone  # its forces and samples are judged by the clock
def test_the_suite_finds_it_in_order_and_a_far_side_without_an_end_out_of_it(far: OrderedFake, make: Made) -> None:
    for _ in range(ATTEMPTS):
        found = judged(make())
        kept = {one.check for one in found if one.verdict is Conformance.KEPT}
        if not broken(found) and SILENCE in kept:
            break
    else:
        pytest.fail(f"found {found}")
    far.order("forever")
    for _ in range(ATTEMPTS):
        found = judged(make())
        if broken(found) == {SILENCE}:
            return
    pytest.fail(f"found {found}")


def test_a_force_that_comes_after_its_end_is_none(far: OrderedFake, make: Made) -> None:
    driver = make()
    for stall, moves in ((True, False), (False, True)):
        if stall:
            far.order("stall 40")
        driver.apply([1.0, 0.0], 0, 20_000_000 if moves else 6_000_000)
        number = driver.number
        heard(driver, lambda number=number: number not in driver.sent or min(driver.sent) == number)  # type: ignore[misc]
        after = driver.stamp
        heard(driver, lambda after=after: driver.stamp > after + 30_000_000)  # type: ignore[misc]
        assert (driver.x[0] != 0.0) == moves


def test_the_age_of_samples_is_bounded_though_the_clocks_differ(make: Made) -> None:
    driver = make()
    heard(driver, lambda: driver.stamp > 7_300_000_000)
    assert driver.least <= driver.most
    assert driver.most - driver.least < 20_000_000  # ns: one way there and back
    driver.older, driver.most = 0, driver.most + 5_000_000  # as if it had been made 5 ms earlier
    driver.sample(0, 0)
    assert driver.figures() == {"older_than_stated": 1.0}


@pytest.mark.parametrize("order", ["mute", "deaf"])
def test_a_far_side_that_says_or_hears_nothing_any_more_is_named(far: OrderedFake, make: Made, order: str) -> None:
    driver = make()
    far.order(order)
    with pytest.raises(OSError, match="found no state that answers our forces for 500 ms"):
        heard(driver, lambda: driver.release(0) is not None)


def test_a_new_driver_is_obeyed_after_one_that_has_sent_much(far: OrderedFake, make: Made) -> None:
    driver = make()
    for _ in range(2000):
        driver.release(0)
    driver.close()
    driver.close()
    driver = make()
    driver.apply([1.0, 0.0], 0)
    heard(driver, lambda: driver.x[0] > 0.0)


def test_it_takes_part_in_a_session(far: OrderedFake, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    driver = ["devices.stick.driver=my_controller:Controller", f"devices.stick.parameters={{address: '{far.path}'}}"]
    times = [
        "period=0.004",
        "devices.stick.sample_age=0.001",
        "devices.stick.actuation_delay=0.0005",
        "design.tau=auto",
    ]
    options = [part for one in (*driver, *times) for part in ("--set", one)]
    run = ["launch", "joystick.yaml", *options, "--duration", "0.5", "--report", str(report)]
    done = manyhands(*run, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = json.loads(report.read_text())
    # how many ticks come in half a second is the busy machine's; that it moved and was pushed is the driver's
    assert told["nodes"]["stick"]["ticks"] > 0
    assert told["nodes"]["stick"]["peak_force"] > 0.0
    assert not [one for one in told.get("incidents", ()) if "failed" in one]
