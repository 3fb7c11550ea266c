"""The clocks, and the arithmetic of time."""

import ctypes
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.protocol import clock as clock_module
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, SimulatedClock, from_seconds, seconds

MILLISECOND = 1_000_000
PR_GET_TIMERSLACK = 30


@given(st.integers(-(2**50), 2**50))
def test_seconds_and_back_give_the_same_duration(nanoseconds: int) -> None:
    assert from_seconds(seconds(Duration(nanoseconds))) == nanoseconds


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_duration_is_finite(value: float) -> None:
    with pytest.raises(ValueError, match="expected a finite number of seconds"):
        from_seconds(value)


def test_simulated_time_passes_only_when_waited_for_and_never_goes_back() -> None:
    clock: Clock = SimulatedClock()
    assert clock.now() == 0
    clock.sleep_until(Instant(5))
    assert clock.now() == 5
    clock.sleep_until(Instant(3))
    assert clock.now() == 5


def test_realtime_never_wakes_early() -> None:
    clock: Clock = RealtimeClock()
    for _ in range(20):
        target = Instant(clock.now() + MILLISECOND // 4)
        clock.sleep_until(target)
        assert clock.now() >= target


def test_realtime_goes_on_waiting_when_woken_early(monkeypatch: pytest.MonkeyPatch) -> None:
    elapsed = [0]

    def wake_early(duration: float) -> None:
        elapsed[0] += max(1, int(duration * 1e9 * 0.6))

    monkeypatch.setattr(clock_module.time, "monotonic_ns", lambda: elapsed[0])
    monkeypatch.setattr(clock_module.time, "sleep", wake_early)
    RealtimeClock().sleep_until(Instant(MILLISECOND))
    assert elapsed[0] >= MILLISECOND


def test_realtime_does_not_wait_for_what_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = RealtimeClock()
    monkeypatch.setattr(clock_module.time, "sleep", lambda _: pytest.fail("it slept"))
    clock.sleep_until(Instant(clock.now() - 1))


def test_granted_timer_slack_is_in_force() -> None:
    clock = RealtimeClock()
    assert clock.timer_slack_set
    assert ctypes.CDLL(None).prctl(PR_GET_TIMERSLACK, 0, 0, 0, 0) == 1


def test_unavailable_timer_slack_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_module.ctypes, "CDLL", lambda *_, **__: object())
    assert not RealtimeClock().timer_slack_set
