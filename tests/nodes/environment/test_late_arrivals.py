"""Which party is charged for the time that the others waited, and when it is frozen for it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.environment.late_arrivals import (
    AT_ONCE,
    BURST,
    COMMON,
    LEAST_ALLOWANCE,
    SHARE,
    LateArrivals,
    allowance,
)
from manyhands.protocol.clock import Duration

T = Duration(1_000_000)  # ns
DUE = 7 * T
HALF = Duration(T // 2)


def after_due(*arrivals: tuple[float, int]) -> list[tuple[int, int]]:
    """Signals that were read so many periods after the tick was due, and whose."""
    return [(DUE + round(at * T), index) for at, index in arrivals]


def judged(*arrivals: tuple[float, int], crossed: bool = False) -> dict[int, float]:
    """What one such tick is charged, in periods, by coupling; the allowance is half a period."""
    late = LateArrivals(4, T, HALF)
    assert late.judge(0, DUE, crossed, after_due(*arrivals)) == []
    assert [bool(ticks) for ticks in late.ticks] == [bool(waited) for waited in late.waited]
    return {index: waited / T for index, waited in enumerate(late.waited) if waited}


@pytest.mark.parametrize(
    ("arrivals", "charged"),
    [
        ([(0.1, 0), (0.12, 1), (2.3, 2)], {2: 2.18}),  # the last is charged what it adds
        ([(0.1, 0), (0.6, 1)], {}),  # within the allowance
        ([(0.1, 0), (0.61, 1)], {1: 0.51}),
        ([(2.2, 0), (2.21, 1), (2.22, 2)], {}),  # all late alike: no member waited for any other
        ([(2.2, 0)], {}),  # no other member is there
        ([(0.1, 0), (2.2, 1), (2.21, 2)], {1: 2.1}),  # read at once after a late one: it was there
        ([(0.1, 0), (1.0, 1), (2.2, 2)], {1: 0.9, 2: 1.2}),  # two together: each what it adds
        ([(0.1, 0), (0.5, 1), (0.9, 2)], {2: 0.4}),  # small steps do not hide the sum
        ([(-0.9, 0), (0.15, 1)], {}),  # a signal before the tick is due makes no other late
        ([(-0.9, 0), (0.6, 1)], {1: 0.6}),  # and waits from when it is due on
    ],
)
def test_who_is_charged_how_much(arrivals: list[tuple[float, int]], charged: dict[int, float]) -> None:
    assert judged(*arrivals) == pytest.approx(charged)


@pytest.mark.parametrize(
    ("at", "crossed", "charged"),
    [(1.1, True, {}), (1.1, False, {1: 1.0}), (0.9, True, {1: 0.8}), (1.6, True, {1: 1.5}), (2.1, True, {1: 2.0})],
)
def test_forces_sent_late_in_a_period_may_miss_the_next_sample(
    at: float, crossed: bool, charged: dict[int, float]
) -> None:
    assert judged((0.1, 0), (at, 1), crossed=crossed) == pytest.approx(charged)


def late_for_ever(late: LateArrivals, ticks: range, at: float = 2.2) -> list[int]:
    """The ticks at which coupling 1 is to be frozen, when it is late in all of these."""
    return [tick for tick in ticks if 1 in late.judge(tick, DUE, False, after_due((0.1, 0), (at, 1)))]


def test_a_burst_is_no_reason_to_freeze_and_one_more_is() -> None:
    late = LateArrivals(2, T, HALF)
    assert late_for_ever(late, range(BURST)) == []
    assert late_for_ever(late, range(BURST, BURST + 3))[0] == BURST


def test_after_a_burst_only_a_share_is_allowed_until_it_lapses() -> None:
    late = LateArrivals(2, T, HALF)
    assert late_for_ever(late, range(BURST)) == []
    every = round(1 / SHARE)
    assert late_for_ever(late, range(BURST + every, 100 * every, every)) == []
    assert late_for_ever(late, range(100 * every, 100 * every + 2)) != []
    rested = 100 * every + round((BURST + 2) / SHARE)
    assert late_for_ever(late, range(rested, rested + BURST)) == []


def test_a_frozen_member_is_frozen_again_at_its_first_late_tick() -> None:
    late = LateArrivals(2, T, HALF)
    (*_, frozen) = late_for_ever(late, range(BURST + 2))
    back = frozen + 10_000
    late.begin(1, back)
    assert late_for_ever(late, range(back, back + 1)) == [back]


def test_however_often_it_was_frozen_the_same_time_lets_it_lapse() -> None:
    late = LateArrivals(2, T, HALF)
    for tick in range(10 * BURST):
        late.missed(tick, [1], Duration(3 * T))
    rested = 10 * BURST + round((BURST + 2) / SHARE)
    assert late_for_ever(late, range(rested, rested + BURST)) == []


def test_on_a_slow_machine_members_late_in_turns_stay_active() -> None:
    late = LateArrivals(3, T, HALF)
    for tick in range(20_000):
        slow = tick % 3
        rest = [index for index in range(3) if index != slow]
        assert late.judge(tick, DUE, False, after_due((0.1, rest[0]), (0.11, rest[1]), (2.2, slow))) == []
    assert min(late.ticks) > 6000


def test_who_is_never_late_spares_nobody() -> None:
    """Two in turns, and one that is on time: the delay that the two share is not common to all."""
    late = LateArrivals(3, T, HALF)
    frozen = set()
    for tick in range(3 * BURST):
        slow = 1 + tick % 2
        frozen |= set(late.judge(tick, DUE, False, after_due((0.1, 0), (0.11, 3 - slow), (2.2, slow))))
    assert frozen == {1, 2}


def test_who_is_late_more_often_than_all_are_together_is_frozen() -> None:
    late = LateArrivals(2, T, HALF)
    ticks = iter(range(10_000))
    frozen: list[int] = []
    for tick in ticks:  # for each late tick of the one the other has two more than it is forgiven
        first, last = (1, 0) if tick % (COMMON + 3) == 0 else (0, 1)
        frozen += late.judge(tick, DUE, False, after_due((0.1, first), (2.2, last)))
    assert set(frozen) == {1}


def test_who_is_waited_for_in_vain_is_charged_the_time_together() -> None:
    late = LateArrivals(3, T, HALF)
    late.missed(4, [0, 2], Duration(3 * T))
    assert late.ticks == [1, 0, 1]
    assert late.waited == [1.5 * T, 0, 1.5 * T]
    assert late.lately == [[4], [], [4]]


@pytest.mark.parametrize(("tau", "part"), [(0.0, LEAST_ALLOWANCE), (0.3, LEAST_ALLOWANCE), (0.6, 0.3), (1.0, 0.5)])
def test_half_of_the_delay_is_for_waiting(tau: float, part: float) -> None:
    assert allowance(T, Duration(round(tau * T))) == round(part * T)


arrivals = st.lists(st.integers(-T, 3 * T), min_size=1, max_size=4).map(sorted)


@given(ats=arrivals, crossed=st.booleans())
def test_charges_never_exceed_the_wait_and_the_first_pays_nothing(ats: list[int], crossed: bool) -> None:
    late = LateArrivals(len(ats), T, HALF)
    late.judge(0, DUE, crossed, [(DUE + at, index) for index, at in enumerate(ats)])
    base = max(ats[0], 0)
    assert sum(late.waited) <= max(0, ats[-1] - base)
    assert late.ticks[0] == 0
    for index, at in enumerate(ats):
        if late.ticks[index]:
            assert at - base > HALF
            assert late.waited[index] > AT_ONCE * T


@given(ats=arrivals)
def test_whenever_somebody_exceeds_the_allowance_somebody_is_charged(ats: list[int]) -> None:
    """Steps so small that a signal may have been there are excepted: at most one for each coupling."""
    late = LateArrivals(len(ats), T, HALF)
    late.judge(0, DUE, False, [(DUE + at, index) for index, at in enumerate(ats)])
    if ats[-1] - max(ats[0], 0) > HALF + len(ats) * AT_ONCE * T:
        assert any(late.ticks)


def test_a_wait_for_a_gone_member_is_charged_to_nobody() -> None:
    late = LateArrivals(2, T, HALF)
    late.gone(5, [1])
    assert late.lately == [[], [5]]
    assert late.ticks == late.waited == [0, 0]


def test_a_tick_is_noted_once_however_often_a_member_was_waited_for_in_it() -> None:
    late = LateArrivals(2, T, HALF)
    late.missed(5, [1], T)
    late.gone(5, [1])
    late.gone(6, [1])
    assert late.lately == [[], [5, 6]]
