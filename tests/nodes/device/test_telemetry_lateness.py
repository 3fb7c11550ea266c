"""Every late tick has exactly one cause, and more of one delay never moves the blame to another."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.device.telemetry import LateCause, LatenessCounter, cause
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
    ("parts", "expected"),
    [
        ((-400_000, 20_000, 1_100_000, 200_000, 50_000), LateCause.OWN),
        ((900_000, 20_000, 50_000, 200_000, 50_000), LateCause.OWN),  # telemetry went on beyond kT
        ((-400_000, 900_000, 50_000, 200_000, 50_000), LateCause.DESCHEDULED),
        ((-400_000, 20_000, 50_000, 1_200_000, 50_000), LateCause.PARTNER),
    ],
)
def test_the_greatest_part_is_the_cause(parts: tuple[int, ...], expected: LateCause) -> None:
    assert cause(*stamps(*parts)) is expected


@given(st.integers(-3_000_000, 3_000_000), SPANS, SPANS, SPANS, SPANS, SPANS)
def test_more_of_a_cause_leaves_it_the_cause(
    over: int, woke: int, sending: int, waiting: int, applying: int, more: int
) -> None:
    found = cause(*stamps(over, woke, sending, waiting, applying))
    match found:
        case LateCause.PARTNER:
            worse = stamps(over, woke, sending, waiting + more, applying)
        case LateCause.DESCHEDULED:
            worse = stamps(over, woke + more, sending, waiting, applying)
        case LateCause.OWN:
            worse = stamps(over, woke, sending, waiting, applying + more)
    assert cause(*worse) is found


@given(st.lists(st.tuples(st.integers(-900_000, 900_000), SPANS, SPANS, SPANS, SPANS), max_size=20))
def test_each_late_tick_is_counted_once_and_no_other(ticks: list[tuple[int, ...]]) -> None:
    lateness = LatenessCounter(T)
    late = 0
    for parts in ticks:
        instants = stamps(*parts)
        is_late = instants[-1] > instants[0] + T
        late += is_late
        assert (lateness.judge(*instants) is None) is not is_late
    assert sum(lateness.counts.values()) == late
    assert sum(lateness.table().values()) == late
    assert set(lateness.table()) == {"own", "descheduled", "partner"}


def test_a_tick_ending_when_the_next_is_due_is_in_time() -> None:
    lateness = LatenessCounter(T)
    due = Instant(0)
    assert lateness.judge(due, due, due, due, due, Instant(T)) is None
    assert lateness.judge(due, due, due, due, due, Instant(T + 1)) is LateCause.OWN
