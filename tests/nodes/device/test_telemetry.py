"""A device's record of its ticks: rows in order, breaches, and the telemetry of a session that jumps."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.levels.contract import DeviceShare
from manyhands.design.levels.device import device_share
from manyhands.nodes.device.core import DeviceCore, Guard
from manyhands.nodes.device.telemetry import DeviceTelemetry
from manyhands.nodes.kernel.bundle import Common, DeviceRung, Limits
from manyhands.nodes.kernel.buttons import Buttons
from manyhands.nodes.rows.two_port import Row
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Figures, Role

MS = 1_000_000
ROWS = 10
TAU = MS // 4

COMMON = Common(
    session="s", name="dx", role=Role.DEVICE, certificate="c", period=0.001, clock="realtime",
    transport="ipc", public={}, private="", directory="", control="", ports=("dx",), peers=(), telemetry_ticks=ROWS,
    telemetry_first=ROWS,
)  # fmt: skip
CORE = DeviceCore(np.eye(1), np.zeros((1, 1)), 0.001)
NO_BUTTONS = Buttons((), 0.001)
GUARD = Guard(Limits((10.0,), (1.0,), (1.0,)), 0.001, ("dx",))


def rung(tau: int, period_tolerance: float = 0.0) -> DeviceRung:
    """A rung that covers delays of ``tau``, ns, and periods up to (1 + period_tolerance) T."""
    return DeviceRung(tau / 1e9, period_tolerance, DeviceShare())


class TelemetryDevice:
    """A device's telemetry, and a session that feeds it tick by tick."""

    def __init__(self, line: Any) -> None:
        self.x = np.zeros(1)
        driver = SimpleNamespace(figures=Figures)
        device = SimpleNamespace(
            core=CORE, guard=GUARD, interface=None, driver=driver, row=self.row, below=None, buttons=NO_BUTTONS,
            orientation=None,
        )  # fmt: skip
        self.account, self.line, self.at = DeviceTelemetry(COMMON, rung(TAU), device), line, 0  # type: ignore[arg-type]

    def row(self) -> Row:
        return self.x, -self.x, (CORE.ledger.total,), (), (), (), ()

    def tick(self, tick: int, after: int = MS, tau: int = 0, value: float | None = None) -> None:
        """A tick that comes ``after`` ns, and whose force is there ``tau`` ns after the sample."""
        self.at += after
        due, applied = Instant(self.at), Instant(self.at + tau)
        self.x = np.array([float(tick) if value is None else value])
        self.account.tick(tick, (due, due, due, due, applied, applied))
        self.account.publish(self.line, [])

    def jump(self) -> None:
        self.account.jump(self.line, [])

    def end(self) -> dict[str, Any]:
        self.account.publish_rest(self.line, [])
        report = self.account.report([], 2)
        return {"ticks": report.ticks, **report.figures, **report.figures.tables}


@pytest.fixture
def device(new_line: Callable[[], Any]) -> TelemetryDevice:
    return TelemetryDevice(new_line())


@given(steps=st.lists(st.one_of(st.integers(1, 25), st.just(0), st.integers(-40, -1)), max_size=30))
def test_rows_are_those_up_to_tick_without_a_gap(steps: list[int], new_line: Callable[[], Any]) -> None:
    """Positive: so many ticks; 0: a period without a force; negative: the session is so many ticks further on."""
    device, tick, done = TelemetryDevice(new_line()), 0, []
    jumps = released = 0
    for step in steps:
        if step < 0:
            tick -= step
            device.jump()
            jumps += 1
        elif step == 0:
            device.account.release(tick)
            released += 1
        for _ in range(step):
            device.tick(tick)
            done.append(tick)
            tick += 1
    counts = device.end()
    assert counts["ticks"] == (done[-1] + 1 if done else 0)  # the session's, whatever was missed
    assert (counts["jumps"], counts["released"], counts["rung"]) == (jumps, released, 2)
    told: list[int] = []
    for telemetry in device.line.telemetry:
        rows = telemetry.traces["x"][:, 0]
        assert 0 < len(rows) <= ROWS
        assert list(rows) == list(range(telemetry.tick - len(rows), telemetry.tick))
        np.testing.assert_array_equal(telemetry.traces["f_v"][:, 0], -rows)
        assert telemetry.traces["ledger"].shape == telemetry.traces["tau_us"].shape == (len(rows), 1)
        told += [int(row) for row in rows]
    assert told == done


def test_telemetry_is_sent_when_due_and_nothing_twice(device: TelemetryDevice) -> None:
    for tick in range(2 * ROWS):
        device.tick(tick)
    assert [telemetry.tick for telemetry in device.line.telemetry] == [ROWS, 2 * ROWS]
    device.end()
    assert len(device.line.telemetry) == 2


def test_delays_beyond_the_certificates_are_counted_by_the_rung_that_holds(device: TelemetryDevice) -> None:
    for tick, tau in enumerate([TAU, TAU + 1, 3 * TAU]):
        device.tick(tick, tau=tau)
    assert device.end()["tau_breaches"] == 2
    device.account.change_rung(2, 1, rung(3 * TAU))
    device.tick(3, tau=3 * TAU)
    device.tick(4, tau=3 * TAU + 1)
    assert device.end()["tau_breaches"] == 3


def test_the_greatest_force_is_that_of_the_run_in_either_direction(device: TelemetryDevice) -> None:
    for tick in range(2 * ROWS):
        device.tick(tick, value=7.5 if tick == 1 else -2.0 if tick == ROWS + 1 else 0.25)
    assert [telemetry.figures["peak_force"] for telemetry in device.line.telemetry] == [7.5, 7.5]
    device.tick(2 * ROWS, value=9.0)
    assert device.end()["peak_force"] == 9.0


def test_the_worst_delay_is_that_since_the_last_telemetry(device: TelemetryDevice) -> None:
    for tick in range(2 * ROWS):
        device.tick(tick, tau=5000 if tick == 1 else 1000)
    assert [telemetry.figures["tau_worst_us"] for telemetry in device.line.telemetry] == [5.0, 1.0]
    first, second = (telemetry.traces["tau_us"][:, 0].tolist() for telemetry in device.line.telemetry)
    assert first == [1.0, 5.0, *[1.0] * (ROWS - 2)]
    assert second == [1.0] * ROWS


def test_telemetry_has_percentiles_of_the_true_period_since_the_start(device: TelemetryDevice) -> None:
    for tick in range(2 * ROWS):
        device.tick(tick, after=3 * MS if tick == 15 else MS)
    first, second = (telemetry.figures.table("period_us") for telemetry in device.line.telemetry)
    assert first["p50"] == first["p99"] == pytest.approx(1000.0, rel=0.01)
    assert second["p50"] == pytest.approx(1000.0, rel=0.01)
    assert second["p99"] == pytest.approx(3000.0, rel=0.01)


@pytest.mark.parametrize(
    ("rho", "after", "breaches"),
    [
        (0.0, MS // 2, 0),
        (0.0, MS, 0),
        (0.0, MS + 1, 1),
        (0.1, round(1.1 * MS), 0),
        (0.1, round(1.1 * MS) + 1, 1),
        (0.4, round(1.4 * MS), 0),
        (0.4, round(1.4 * MS) + 1, 1),
    ],
)
def test_periods_that_are_too_long_are_counted(device: TelemetryDevice, rho: float, after: int, breaches: int) -> None:
    """A shorter one is covered: the device dissipates more in it."""
    device.account.change_rung(0, 1, rung(0, rho))
    device.tick(0)
    device.tick(1, after=after)
    assert device.end()["period_breaches"] == breaches


@pytest.mark.parametrize(("delay", "longest"), [(0.0, 1.51), (0.2, 1.44), (0.4, 1.1), (0.5, 1.1)])
def test_a_longer_period_is_covered_after_an_early_force(device: TelemetryDevice, delay: float, longest: float) -> None:
    """The delay that counts is that of the force in the period, and not that of the force at its end."""
    found = device_share(1.16, 0.4, period_tolerance=0.1)
    promise = DeviceShare(1.16, found.share, found.c)
    device.account.change_rung(0, 1, DeviceRung(0.4e-3, 0.1, promise))
    most = math.floor(max(1.1, promise.longest_period(min(delay, 0.4))) * MS)
    assert most == pytest.approx(longest * MS, rel=0.01)
    device.tick(0, tau=round(delay * MS))
    device.tick(1, after=most, tau=round(delay * MS))
    assert device.end()["period_breaches"] == 0
    device.tick(2, after=most + 1)
    assert device.end()["period_breaches"] == 1


def test_periods_without_force_or_with_a_jump_are_not_judged(device: TelemetryDevice) -> None:
    device.tick(0)
    device.account.release(1)
    device.tick(1, after=7 * MS)
    device.jump()
    device.tick(5, after=9 * MS)
    assert device.end()["period_breaches"] == 0


def test_a_force_after_the_next_due_time_makes_its_tick_late(device: TelemetryDevice) -> None:
    device.tick(0, tau=MS)
    device.tick(1, tau=MS + 1)
    counts = device.end()
    assert counts["late"] == 1
    assert sum(counts["late_cause"].values()) == 1


def test_the_speed_at_which_it_came_beyond_a_limit_is_told_without_a_row_of_it(device: TelemetryDevice) -> None:
    """A sample in a period without a force has no row, and whose fault it was is judged by that speed."""
    guard = Guard(Limits((10.0,), (1.0,), (1.0,)), 0.001, ("dx",))
    device.account._device.guard = guard
    guard.report([0.004])
    guard.report([4.0])
    for tick in range(2 * ROWS):
        device.tick(tick, value=0.0)
    first, second = device.line.telemetry
    assert first.figures["speed"] == pytest.approx(3996.0)
    assert second.figures["speed"] == CORE.speed
