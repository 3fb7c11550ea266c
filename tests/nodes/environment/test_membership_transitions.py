"""Seats around the environment: every event in every seat, and pauses that grow, end, and are forgiven."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.environment.membership import (
    FIRST_PAUSE,
    FORGIVEN,
    LONGEST_PAUSE,
    TRANSITIONS,
    Attendance,
    Membership,
    MembershipEvent,
)

TO_SEAT = {
    Membership.SEATED: (),
    Membership.FROZEN: (MembershipEvent.PAUSES,),
    Membership.EXPECTED: (MembershipEvent.PAUSES, MembershipEvent.BEHIND),
    Membership.GONE: (MembershipEvent.LOST,),
}
"""How a coupling that is seated comes to stand so."""


def standing(seat: Membership, tick: int = 0) -> Attendance:
    attendance = Attendance()
    for event in TO_SEAT[seat]:
        attendance.on(event, tick)
    assert attendance.seat is seat
    return attendance


def test_every_event_in_every_seat_leads_where_the_table_says_or_nowhere() -> None:
    for seat, event in product(Membership, MembershipEvent):
        attendance = standing(seat)
        expected = TRANSITIONS.get((seat, event), seat)
        assert attendance.on(event, 0) == (expected is not seat), (seat, event)
        assert attendance.seat is expected, (seat, event)


def test_only_who_is_seated_or_awaited_can_be_missed_and_only_who_is_gone_can_be_met() -> None:
    """What the table leaves out is what nobody can hear of a coupling that stands so."""
    out = {pair for pair in product(Membership, MembershipEvent) if pair not in TRANSITIONS}
    assert out == {
        (Membership.SEATED, MembershipEvent.MET),
        (Membership.EXPECTED, MembershipEvent.MET),
        (Membership.FROZEN, MembershipEvent.MET),
        (Membership.GONE, MembershipEvent.SIGNAL),
        (Membership.GONE, MembershipEvent.BEHIND),
        (Membership.SEATED, MembershipEvent.AHEAD),
        (Membership.GONE, MembershipEvent.AHEAD),
        (Membership.GONE, MembershipEvent.SILENT),
        (Membership.EXPECTED, MembershipEvent.LATE),  # with a signal of the tick it is seated
        (Membership.FROZEN, MembershipEvent.LATE),
        (Membership.GONE, MembershipEvent.LATE),
    }


happenings = st.lists(st.tuples(st.sampled_from(MembershipEvent), st.integers(0, 2 * LONGEST_PAUSE)), max_size=60)


@given(happened=happenings)
def test_whatever_happens_a_pause_ends_and_absences_are_counted_once(
    happened: list[tuple[MembershipEvent, int]],
) -> None:
    attendance, tick, absences = Attendance(), 0, 0
    for event, later in happened:
        tick += later
        before = attendance.seat
        changed = attendance.on(event, tick)
        allowed = {before, TRANSITIONS.get((before, event), before)}
        assert attendance.seat in allowed
        assert changed == (attendance.seat is not before)
        if before is Membership.SEATED and changed:
            absences += 1
        assert attendance.absences == absences
    if attendance.seat is Membership.FROZEN:  # nobody is kept out for longer
        assert attendance.on(MembershipEvent.BEHIND, tick + LONGEST_PAUSE)
        assert attendance.seat is Membership.EXPECTED


def test_the_first_time_is_everybodys() -> None:
    attendance = Attendance()
    attendance.on(MembershipEvent.SILENT, FORGIVEN)
    assert attendance.on(MembershipEvent.BEHIND, FORGIVEN)
    assert attendance.seat is Membership.EXPECTED


def pause_after(attendance: Attendance, tick: int) -> int:
    """How long it is not expected; it is frozen at ``tick``."""
    pause = 0
    while not attendance.on(MembershipEvent.BEHIND, tick + pause):
        pause += 1
        assert pause <= LONGEST_PAUSE
    return pause


def test_who_is_waited_for_in_vain_again_and_again_is_expected_after_a_pause_that_doubles() -> None:
    attendance, tick, pauses = Attendance(), FORGIVEN, []
    for _ in range(9):
        attendance.on(MembershipEvent.SILENT, tick)
        pauses.append(pause_after(attendance, tick))
        tick += pauses[-1]
    assert pauses == [0, FIRST_PAUSE, 2 * FIRST_PAUSE, 4 * FIRST_PAUSE, 8 * FIRST_PAUSE, 16 * FIRST_PAUSE, *[256] * 3]
    assert LONGEST_PAUSE == 256


@pytest.mark.parametrize("event", [MembershipEvent.BEHIND, MembershipEvent.AHEAD, MembershipEvent.SIGNAL])
def test_whatever_it_says_in_its_pause_it_is_not_expected(event: MembershipEvent) -> None:
    attendance = Attendance()
    attendance.on(MembershipEvent.LATE, FORGIVEN)
    assert not any(attendance.on(event, tick) for tick in range(FORGIVEN, FORGIVEN + FIRST_PAUSE))
    assert attendance.seat is Membership.FROZEN
    assert attendance.on(event, FORGIVEN + FIRST_PAUSE)


def test_who_is_late_again_and_again_pauses_from_the_first_time_on() -> None:
    attendance, tick, pauses = Attendance(), FORGIVEN, []
    for _ in range(8):
        attendance.on(MembershipEvent.LATE, tick)
        pauses.append(pause_after(attendance, tick))
        tick += pauses[-1]
        assert attendance.on(MembershipEvent.SIGNAL, tick)
    assert pauses == [FIRST_PAUSE << n for n in range(6)] + [LONGEST_PAUSE] * 2


@pytest.mark.parametrize(("stays", "pause"), [(FORGIVEN - 1, 2 * FIRST_PAUSE), (FORGIVEN, 0)])
def test_absences_are_forgiven_after_a_while_in_the_seat(stays: int, pause: int) -> None:
    attendance, tick = Attendance(), FORGIVEN
    for _ in range(2):
        attendance.on(MembershipEvent.SILENT, tick)
        tick += pause_after(attendance, tick)
    attendance.on(MembershipEvent.SIGNAL, tick)
    attendance.on(MembershipEvent.SILENT, tick + stays)
    assert pause_after(attendance, tick + stays) == pause


def test_a_coupling_that_says_itself_why_it_pauses_is_expected_at_once() -> None:
    attendance = Attendance()
    for tick in range(0, 50, 5):  # it loses its device again and again
        assert attendance.on(MembershipEvent.PAUSES, tick)
        assert attendance.on(MembershipEvent.BEHIND, tick)
        assert attendance.on(MembershipEvent.SIGNAL, tick + 1)
    assert attendance.absences == 10
