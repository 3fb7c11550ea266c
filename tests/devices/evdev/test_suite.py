"""The suite for drivers on fake wheels, whose time is the suite's own: it passes, and names what is wrong."""

from __future__ import annotations

import pytest

from manyhands.devices.evdev import EvdevWheel
from manyhands.devices.evdev.bus import KNOWN, PIDFF, UsbWay
from manyhands.launch.conformance.driver import (
    RELEASE,
    SIGN,
    SILENCE,
    STALE,
    SWAPPED,
    UNIT,
    Bench,
    Push,
    check_driver,
)
from manyhands.launch.conformance.judgement import Conformance
from manyhands.launch.conformance.timing import CallTimer
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import AxisMap
from manyhands.protocol.clock import Instant

from ...fakes.wheel import FakeCalls, FakeWheel, Turn, fake_wheel

T = 0.008
BUSES = {"memless": KNOWN["hid_logitech"], "lg4ff": KNOWN["hid_logitech_new"], "pid": PIDFF}
WHEEL = Turn(m=0.03, b=0.05)
STICK = Turn(m=0.003, b=0.05, range=1.2, most=0.5)


class FakesClock:
    """Time passes for the fake alone, and when the suite waits."""

    def __init__(self, one: FakeWheel) -> None:
        self._one, self._now = one, 0
        one.order("manual")

    def now(self) -> Instant:
        return Instant(self._now)

    def sleep_until(self, t: Instant) -> None:
        if t > self._now:
            self._one.advance(1e-9 * (t - self._now))
            self._now = t


def verdicts(kind: str, order: str | None, turns: tuple[Turn, ...], update: str = "replay") -> dict[str, Conformance]:
    """The worst verdict of each check."""
    with fake_wheel(*turns, kind=kind) as one:
        if order is not None:
            one.order(order)
        given = {"device": one.path, "range": turns[0].range, "most": turns[0].most, "update": update}
        given["mass"] = turns[0].m
        ports = tuple(f"d.{axis}" for axis in range(len(turns)))
        driver = EvdevWheel(ports, T, given, FakeCalls(), UsbWay(BUSES[kind], 0.001, 0.001))
        stated = driver.specification()
        own = AxisMap(tuple(range(len(turns))), (1.0,) * len(turns))
        clock = FakesClock(one)
        bench = Bench(PluginDriver("wheel", driver, own, stated, T), T, clock, CallTimer(lambda: 0, lambda: 0))
        push = Push(0.4, 0.9) if len(turns) == 1 else Push(0.05, 0.2)
        found: dict[str, Conformance] = {}
        for one_of in check_driver(bench, stated, push):
            if found.get(one_of.check) is not Conformance.BROKEN:
                found[one_of.check] = one_of.verdict
        return found


JUDGED = (RELEASE, SIGN, SILENCE, STALE, SWAPPED, UNIT)


@pytest.mark.parametrize(
    ("kind", "turns", "update"),
    [
        ("memless", (WHEEL,), "replay"),
        ("lg4ff", (WHEEL,), "replay"),
        ("lg4ff", (WHEEL,), "restart"),
        ("pid", (WHEEL,), "replay"),
        ("pid", (STICK, STICK), "replay"),
        ("memless", (STICK, STICK), "replay"),
    ],
)
def test_it_keeps_everything(kind: str, turns: tuple[Turn, ...], update: str) -> None:
    found = verdicts(kind, None, turns, update)
    assert {check: found[check] for check in JUDGED} == dict.fromkeys(JUDGED, Conformance.KEPT), found
    assert Conformance.BROKEN not in found.values()


@pytest.mark.parametrize(
    ("kind", "order", "broken"),
    [
        ("lg4ff", "mirror", SIGN),
        ("lg4ff", "endless", SILENCE),
        ("pid", "endless", SILENCE),
        ("pid", "late 60000", STALE),
    ],
)
def test_it_names_what_is_wrong(kind: str, order: str, broken: str) -> None:
    found = verdicts(kind, order, (WHEEL,))
    assert [check for check in JUDGED if found.get(check) is Conformance.BROKEN] == [broken], found
