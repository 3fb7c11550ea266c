"""Every late tick has exactly one cause, and more of one delay never moves the blame to another."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.device.lateness import Cause, Lateness, cause, times_preempted
from manyhands.protocol.clock import Duration, Instant

T = Duration(1_000_000)
SPANS = st.integers(0, 3_000_000)


def stamps(over: int, woke: int, sending: int, waiting: int, applying: int) -> list[Instant]:
    """Instants of a tick from its parts, ns; ``over``: how far the tick before went beyond kT."""
    due = Instant(5_000_000_000)
    found = [due, Instant(due + over)]
    at = max(found)
    for part in (woke, sending, waiting, applying):
        at = Instant(at + part)
        found.append(at)
    return found


@pytest.mark.parametrize(
    ("parts", "computed", "expected"),
    [
        ((-400_000, 20_000, 1_100_000, 200_000, 50_000), 1_150_000, Cause.OWN),
        ((900_000, 20_000, 50_000, 200_000, 50_000), 100_000, Cause.OWN),  # telemetry went on beyond kT
        ((-400_000, 900_000, 50_000, 200_000, 50_000), 100_000, Cause.DESCHEDULED),
        ((-400_000, 20_000, 50_000, 1_200_000, 50_000), 100_000, Cause.PARTNER),
        ((-400_000, 20_000, 1_100_000, 200_000, 50_000), 150_000, Cause.DESCHEDULED),  # its own part, but not run
        ((-400_000, 20_000, 1_100_000, 200_000, 50_000), None, Cause.OWN),
    ],
)
def test_the_greatest_part_is_the_cause(parts: tuple[int, ...], computed: int | None, expected: Cause) -> None:
    assert cause(*stamps(*parts), None if computed is None else Duration(computed)) is expected


def test_a_thread_that_was_never_preempted_has_waited_by_its_own_doing() -> None:
    parts = stamps(-400_000, 20_000, 1_100_000, 200_000, 50_000)
    assert cause(*parts, Duration(150_000), preempted=False) is Cause.OWN


@given(st.integers(-3_000_000, 3_000_000), SPANS, SPANS, SPANS, SPANS, st.none() | SPANS, st.booleans(), SPANS)
def test_more_of_a_cause_leaves_it_the_cause(
    over: int, woke: int, sending: int, waiting: int, applying: int, ran: int | None, preempted: bool, more: int
) -> None:
    computed = None if ran is None else Duration(ran)
    found = cause(*stamps(over, woke, sending, waiting, applying), computed, preempted)
    match found:
        case Cause.PARTNER:
            worse, now = stamps(over, woke, sending, waiting + more, applying), computed
        case Cause.DESCHEDULED:
            worse, now = stamps(over, woke + more, sending, waiting, applying), computed
        case Cause.OWN:
            worse = stamps(over, woke, sending, waiting, applying + more)
            now = None if ran is None else Duration(ran + more)
    assert cause(*worse, now, preempted) is found


@given(st.integers(-3_000_000, 3_000_000), SPANS, SPANS, SPANS, SPANS, SPANS)
def test_processor_time_only_moves_blame_between_own_and_descheduled(
    over: int, woke: int, sending: int, waiting: int, applying: int, ran: int
) -> None:
    parts = stamps(over, woke, sending, waiting, applying)
    known, unknown = cause(*parts, Duration(ran)), cause(*parts)
    assert known is unknown or {known, unknown} != {Cause.PARTNER, Cause.OWN} or known is Cause.PARTNER
    if unknown is Cause.DESCHEDULED:
        assert known is Cause.DESCHEDULED


@given(st.lists(st.tuples(st.integers(-900_000, 900_000), SPANS, SPANS, SPANS, SPANS), max_size=20))
def test_each_late_tick_is_counted_once_and_no_other(ticks: list[tuple[int, ...]]) -> None:
    asked: list[int] = []
    lateness = Lateness(T, lambda: asked.append(1) or len(asked))  # type: ignore[func-returns-value]
    late = 0
    for parts in ticks:
        instants = stamps(*parts)
        is_late = instants[-1] > instants[0] + T
        late += is_late
        assert (lateness.judge(*instants) is None) is not is_late
    assert sum(lateness.counts.values()) == late
    assert len(asked) == 1 + late  # the kernel is asked about late ticks alone
    assert sum(lateness.figures().values()) == late
    assert set(lateness.figures()) == {"late_own", "late_descheduled", "late_partner"}


def test_a_tick_that_ends_when_the_next_is_due_is_in_time() -> None:
    lateness = Lateness(T)
    due = Instant(0)
    assert lateness.judge(due, due, due, due, due, Instant(T)) is None
    assert lateness.judge(due, due, due, due, due, Instant(T + 1)) is Cause.OWN


def test_preemptions_count_since_the_last_late_tick() -> None:
    times = 7
    lateness = Lateness(T, lambda: times)
    blocked = stamps(-400_000, 20_000, 1_100_000, 200_000, 50_000)
    assert lateness.judge(*blocked, Duration(150_000)) is Cause.OWN
    times = 8
    assert lateness.judge(*blocked, Duration(150_000)) is Cause.DESCHEDULED
    assert lateness.judge(*blocked, Duration(150_000)) is Cause.OWN


def test_the_kernel_tells_how_often_it_took_the_processor() -> None:
    before = times_preempted()
    assert times_preempted() >= before >= 0
