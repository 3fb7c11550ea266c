"""When a world whose users are all behind wave links does its ticks: a table of instants, without a clock."""

from __future__ import annotations

from itertools import pairwise

import pytest

from manyhands.nodes.environment.pace import UNRESTED, Pace
from manyhands.protocol.clock import Duration, Instant

PERIOD = Duration(1000)
EPOCH = Instant(10_000)


def run(pace: Pace, begins: int, lasts: list[int], wakes: int = 0) -> list[int]:
    """The beginnings of ticks that take ``lasts`` ns, the first after ``begins``, each ``wakes`` ns after it is due."""
    now, found = begins, []
    for duration in lasts:
        now = max(now, pace.due(Instant(now)) + wakes)
        found.append(now)
        pace.begun(Instant(now + duration // 2))
        now += duration
    pace.due(Instant(now))
    return found


def test_ticks_in_time_begin_with_their_periods() -> None:
    pace = Pace(EPOCH, PERIOD, EPOCH)
    assert run(pace, EPOCH, [300] * 4) == [10_000, 11_000, 12_000, 13_000]
    assert pace.late == 0


def test_a_world_that_begins_later_begins_with_the_next_period() -> None:
    pace = Pace(EPOCH, PERIOD, Instant(12_300))
    assert run(pace, 12_300, [300, 300]) == [13_000, 14_000]
    assert pace.late == 0


def test_a_tick_that_ends_too_late_is_made_up_for() -> None:
    pace = Pace(EPOCH, PERIOD, EPOCH)
    assert run(pace, EPOCH, [1400, 300, 300]) == [10_000, 11_400, 12_000]
    assert pace.late == 1


def test_a_process_that_was_held_up_goes_on_with_the_present_period() -> None:
    pace = Pace(EPOCH, PERIOD, EPOCH)
    assert run(pace, EPOCH, [300, 9000, 300]) == [10_000, 11_000, 20_000]
    assert pace.late == 10  # of 11,000 to 20,000 two were done, at 11,000 and at 20,000, and ended too late


@pytest.mark.parametrize("duration", [1100, 1900, 2600])
def test_a_machine_that_is_too_slow_still_waits_now_and_then(duration: int) -> None:
    pace = Pace(EPOCH, PERIOD, EPOCH)
    begun = run(pace, EPOCH, [duration] * 100)
    rests = [i for i, (last, at) in enumerate(pairwise(begun)) if at - last > duration]
    assert rests, "the loop never waited"
    assert max(b - a for a, b in pairwise([-1, *rests])) <= UNRESTED + 1
    periods = (begun[-1] + duration - EPOCH) // PERIOD
    assert 0.8 * periods <= pace.late <= periods
