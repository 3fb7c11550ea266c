"""A device's tick, without links: what is sent, what is exerted, and which work of the hand counts with which tick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from manyhands.design.levels.dry_friction import DryFriction
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import load_session
from manyhands.nodes.device.tick import NO_INSTANTS, OwnTimeTick, WallTimeTick, in_steps, tick_of
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED, DeviceBundle, PluginDevice
from manyhands.nodes.kernel.driver_statement import DeviceTiming
from manyhands.nodes.kernel.factory import FactoryName
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Figures
from tests.support.instants import instant

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"


class Scripted:
    """A driver whose displacement in sample k is k mm, and whose hand has done 2^k mJ since the sample before."""

    def __init__(self) -> None:
        self.turn = -1
        self.calls: list[tuple[str, Instant, list[float], Instant | None]] = []

    @property
    def axes(self) -> int:
        return 1

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        self.turn = tick
        return [1e-3 * tick]

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float]:
        self.calls.append(("apply", at, list(f), until))
        return [1e-3 * self.turn + 1e-4]

    def release(self, at: Instant) -> Sequence[float]:
        self.calls.append(("release", at, [0.0], None))
        return [1e-3 * self.turn]

    def idle(self, due: Instant) -> None:
        pass

    def intended_work(self) -> float:
        return 1e-3 * 2.0**self.turn

    def figures(self) -> Figures:
        return Figures()

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def bundles() -> dict[str, DeviceBundle]:
    """A device in wall time, under ``realtime``, and one in its own, under ``simulated``."""
    prepared = prepare(load_session(SESSIONS / "example1.yaml", ["design.tau=0.0005", "devices.dx.limits={force: 2}"]))
    out = {}
    for clock in (REALTIME, SIMULATED):
        bundle = cut(prepared, RunPlan(clock, None, ""))["dx"]
        assert isinstance(bundle, DeviceBundle)
        out[clock] = bundle
    return out


def test_the_time_is_that_of_the_bundle(bundles: dict[str, DeviceBundle]) -> None:
    assert isinstance(tick_of(bundles[REALTIME], Scripted()), WallTimeTick)
    own = tick_of(bundles[SIMULATED], Scripted())
    assert isinstance(own, OwnTimeTick)
    assert (own.interface, own.instants) == (None, NO_INSTANTS)


def test_what_is_sent_in_wall_time_stays_until_it_is_answered(bundles: dict[str, DeviceBundle]) -> None:
    driver = Scripted()
    tick = WallTimeTick(bundles[REALTIME], driver)
    assert tick.sample(1, instant(1.1)) == [1e-3]
    tick.release(instant(1.6))
    tick.free(instant(2.0))
    for turn in (2, 3):
        assert tick.sample(turn, instant(turn), first=False) == [1e-3]
    assert tick.exert([3.0], instant(3.4)) == [2.0]  # its limit
    tick.book()
    assert (tick.x, tick.x_a) == ([1e-3], [pytest.approx(3.1e-3)])
    assert tick.instants == (instant(1.1), instant(3.4), instant(1.6))
    energies = (tick.ledger.total,), (tick.wall_interface.account.energy,)
    assert tick.row() == ([1e-3], [2.0], *energies, tick.x_a, tick.instants, ())
    assert [call[:3] for call in driver.calls] == [
        ("release", instant(1.6), [0.0]),
        ("release", instant(2.0), [0.0]),
        ("apply", instant(3.4), [2.0]),
    ]
    assert driver.calls[-1][-1] is not None  # the end of the force
    assert tick.sample(4, instant(4)) == [4e-3]


def test_work_after_the_motion_that_was_sent_counts_with_the_next_tick(bundles: dict[str, DeviceBundle]) -> None:
    tick, counted = WallTimeTick(bundles[REALTIME], Scripted()), []
    for turn, first, answered in [
        (0, True, True),
        (1, True, False),
        (2, False, False),
        (3, False, True),
        (4, True, True),
    ]:
        tick.sample(turn, instant(turn), first)
        if answered:
            tick.exert([0.1], instant(turn + 0.3))
            tick.book()
            counted.append(1e3 * tick.work)
        else:
            tick.free(instant(turn + 1))
    assert counted == pytest.approx([1.0, 2.0, 4.0 + 8.0 + 16.0])


def test_in_its_own_time_every_sample_is_a_period_of_the_ledger(bundles: dict[str, DeviceBundle]) -> None:
    driver = Scripted()
    tick = OwnTimeTick(bundles[SIMULATED], driver)
    totals = []
    for turn in range(3):
        assert tick.sample(turn, Instant(0), first=turn == 0) == tick.x == [1e-3 * turn]
        if turn < 2:
            tick.free(Instant(0))
        else:
            assert tick.exert([-3.0], Instant(0)) == [-2.0]
            tick.book()
        totals.append(tick.core.ledger.total)
    (level, K), T = bundles[SIMULATED].promises[0], 1e-3
    v, g = 1.0, -2.0 * K.item() / T
    burned = T * level.item() * v * v
    last = T * (-2.0 * (v + g) - level.item() * (v + g) ** 2)
    assert totals == pytest.approx([1e-3, 3e-3 - burned, 7e-3 - burned + last])
    assert tick.instants == NO_INSTANTS
    assert tick.row() == ([2e-3], [-2.0], (tick.ledger.total,), (), (), (), ())


@pytest.mark.parametrize("clock", [REALTIME, SIMULATED])
def test_a_simulated_device_sends_whole_steps_of_its_encoder(clock: str) -> None:
    """Row and ledger have the true displacement: the energy that the rounding puts in is not the device's."""
    overrides = ["design.tau=0.0005", "devices.dx.step=0.0004", "devices.dx.limits={displacement: 0.0031}"]
    bundle = cut(prepare(load_session(SESSIONS / "example1.yaml", overrides)), RunPlan(clock, None, ""))["dx"]
    assert isinstance(bundle, DeviceBundle)
    tick, sent = tick_of(bundle, Scripted()), []
    for turn in range(4):
        sent.append(tick.sample(turn, instant(turn)))
        tick.exert([0.0], instant(turn + 0.1))
        tick.book()
        assert tick.x == [1e-3 * turn]
    assert [x[0] for x in sent[:3]] == pytest.approx([0.0, 1.2e-3, 2e-3], abs=1e-15)
    assert sent[3] == [3.1e-3]  # 3.2 mm by its encoder are beyond its limit, and it lets go; 3 mm are not


def test_steps_are_rounded_to_the_nearest_on_each_axis() -> None:
    assert in_steps([0.24, 0.26, -0.26, 0.3], (0.5, 0.5, 0.5, 0.0)) == [0.0, 0.5, -0.5, 0.3]


def test_a_recorded_force_is_exerted_in_place_of_what_follows(bundles: dict[str, DeviceBundle]) -> None:
    driver = Scripted()
    tick = WallTimeTick(bundles[REALTIME], driver)
    tick.sample(0, instant(0))
    assert tick.exert([1.0], instant(0.2), [0.5]) == [1.0]
    assert tick.row()[1] == [0.5]
    tick.book()
    assert driver.calls[-1][2] == tick.interface.exerted == [0.5]
    assert tick.interface.account.f == [1.0]


def test_what_was_recorded_stands_for_the_drivers_own_motion_and_the_force_that_follows(
    bundles: dict[str, DeviceBundle],
) -> None:
    driver = Scripted()
    tick = OwnTimeTick(bundles[SIMULATED], driver)
    assert tick.sample(1, Instant(0), recorded=[7e-3]) == [7e-3]
    assert tick.moved == [1e-3]
    assert tick.exert([1.0], Instant(0), [0.5]) == [1.0]
    tick.book()
    assert driver.calls[-1][2] == [0.5]
    assert tick.row()[:2] == ([7e-3], [0.5])


def test_an_unarmed_guard_does_not_let_go(bundles: dict[str, DeviceBundle]) -> None:
    """An audit follows a device that did not, through samples of which it knows only some."""
    for armed in (True, False):
        tick = OwnTimeTick(bundles[SIMULATED], Scripted())
        tick.guard.armed = armed
        tick.sample(0, Instant(0))
        far = [tick.sample(turn, Instant(0), recorded=[1e3])[0] for turn in (1, 2)]
        assert (far == [1e3, 1e3]) is not armed
        assert tick.guard.let_go == armed


@pytest.mark.parametrize(
    ("measured", "jitter", "fastest", "beyond"),
    [(None, 0.0, 1.0, 0), ((1e-4,), 0.0, 1.1, 1), ((1e-4,), 2e-4, 1.375, 1), ((1e-4,), 1e-3, 0.0, 1)],
    ids=["true ones", "measured", "with a jitter", "with too much of it"],
)
def test_the_speed_that_is_judged_is_the_greatest_that_the_displacements_allow(
    bundles: dict[str, DeviceBundle], measured: tuple[float] | None, jitter: float, fastest: float, beyond: int
) -> None:
    """1 mm in 1 ms, which is v* itself: a step more, in a time that is shorter by the jitter of the samples' age."""
    source = PluginDevice(FactoryName("some:driver", {}), 1, timing=DeviceTiming(jitter), step=measured)
    bundle = replace(
        bundles[REALTIME],
        source=bundles[REALTIME].source if measured is None else source,
        friction=DryFriction((0.1,), (0.0,), 1.0),
    )
    tick = WallTimeTick(bundle, Scripted())
    for turn in (0, 1):
        tick.sample(turn, instant(turn))
    assert (tick.fastest, tick.beyond) == (pytest.approx(fastest), beyond)
