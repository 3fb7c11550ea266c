"""Members of the environment: every event in every state, and pauses that grow, end, and are forgiven."""

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
    Membership,
    MembershipEvent,
    MembershipRecord,
)

TO_SEAT = {
    Membership.ACTIVE: (),
    Membership.HELD: (MembershipEvent.OVERDUE,),
    Membership.FROZEN: (MembershipEvent.PAUSES,),
    Membership.REJOINING: (MembershipEvent.PAUSES, MembershipEvent.BEHIND),
    Membership.GONE: (MembershipEvent.LOST,),
}
"""How a coupling that is active comes to stand so."""


def standing(state: Membership, tick: int = 0) -> MembershipRecord:
    membership = MembershipRecord()
    for event in TO_SEAT[state]:
        membership.on(event, tick)
    assert membership.state is state
    return membership


def test_every_event_follows_the_transition_table_or_changes_nothing() -> None:
    for state, event in product(Membership, MembershipEvent):
        membership = standing(state)
        expected = TRANSITIONS.get((state, event), state)
        assert membership.on(event, 0) == (expected is not state), (state, event)
        assert membership.state is expected, (state, event)


def test_only_active_or_awaited_members_are_missed_only_gone_ones_return() -> None:
    """The table leaves out the events that cannot happen in a state."""
    out = {pair for pair in product(Membership, MembershipEvent) if pair not in TRANSITIONS}
    assert out == {
        (Membership.ACTIVE, MembershipEvent.RECONNECTED),
        (Membership.HELD, MembershipEvent.RECONNECTED),
        (Membership.REJOINING, MembershipEvent.RECONNECTED),
        (Membership.FROZEN, MembershipEvent.RECONNECTED),
        (Membership.GONE, MembershipEvent.SIGNAL),
        (Membership.GONE, MembershipEvent.BEHIND),
        (Membership.ACTIVE, MembershipEvent.AHEAD),
        (Membership.GONE, MembershipEvent.AHEAD),
        (Membership.GONE, MembershipEvent.SILENT),
        (Membership.REJOINING, MembershipEvent.OVERDUE),  # only who is there is held
        (Membership.FROZEN, MembershipEvent.OVERDUE),
        (Membership.GONE, MembershipEvent.OVERDUE),
        (Membership.GONE, MembershipEvent.FLOODED),
    }


happenings = st.lists(st.tuples(st.sampled_from(MembershipEvent), st.integers(0, 2 * LONGEST_PAUSE)), max_size=60)


@given(happened=happenings)
def test_whatever_happens_a_pause_ends_and_absences_are_counted_once(
    happened: list[tuple[MembershipEvent, int]],
) -> None:
    membership, tick, absences = MembershipRecord(), 0, 0
    for event, later in happened:
        tick += later
        before = membership.state
        changed = membership.on(event, tick)
        allowed = {before, TRANSITIONS.get((before, event), before)}
        assert membership.state in allowed
        assert changed == (membership.state is not before)
        there = (Membership.ACTIVE, Membership.HELD)
        if before in there and membership.state not in there:
            absences += 1
        assert membership.absences == absences
    if membership.state is Membership.FROZEN:  # no member is kept out for longer
        assert membership.on(MembershipEvent.BEHIND, tick + LONGEST_PAUSE)
        assert membership.state is Membership.REJOINING


def test_the_first_time_is_everybodys() -> None:
    membership = MembershipRecord()
    membership.on(MembershipEvent.SILENT, FORGIVEN)
    assert membership.on(MembershipEvent.BEHIND, FORGIVEN)
    assert membership.state is Membership.REJOINING


def pause_after(membership: MembershipRecord, tick: int) -> int:
    """How long it is not expected; it is frozen at ``tick``."""
    pause = 0
    while not membership.on(MembershipEvent.BEHIND, tick + pause):
        pause += 1
        assert pause <= LONGEST_PAUSE
    return pause


def test_repeated_waits_in_vain_double_the_pause() -> None:
    membership, tick, pauses = MembershipRecord(), FORGIVEN, []
    for _ in range(9):
        membership.on(MembershipEvent.SILENT, tick)
        pauses.append(pause_after(membership, tick))
        tick += pauses[-1]
    assert pauses == [0, FIRST_PAUSE, 2 * FIRST_PAUSE, 4 * FIRST_PAUSE, 8 * FIRST_PAUSE, 16 * FIRST_PAUSE, *[256] * 3]
    assert LONGEST_PAUSE == 256


@pytest.mark.parametrize("event", [MembershipEvent.BEHIND, MembershipEvent.AHEAD, MembershipEvent.SIGNAL])
def test_messages_in_its_pause_do_not_make_it_expected(event: MembershipEvent) -> None:
    membership = MembershipRecord()
    for _ in range(2):  # the first silence brings no pause
        membership.on(MembershipEvent.SILENT, FORGIVEN)
        membership.on(MembershipEvent.BEHIND, FORGIVEN)
    assert membership.state is Membership.FROZEN
    assert not any(membership.on(event, tick) for tick in range(FORGIVEN, FORGIVEN + FIRST_PAUSE))
    assert membership.state is Membership.FROZEN
    assert membership.on(event, FORGIVEN + FIRST_PAUSE)


def test_who_is_held_again_and_again_is_never_absent_and_its_membership_goes_on() -> None:
    membership = MembershipRecord()
    for tick in range(FORGIVEN, 4 * FORGIVEN):
        assert membership.on(MembershipEvent.OVERDUE, tick)
        assert not membership.on(MembershipEvent.BEHIND, tick)
        assert membership.on(MembershipEvent.SIGNAL, tick)
    assert (membership.state, membership.absences, membership.since) == (Membership.ACTIVE, 0, 0)


@pytest.mark.parametrize(("stays", "pause"), [(FORGIVEN - 1, 2 * FIRST_PAUSE), (FORGIVEN, 0)])
def test_absences_are_forgiven_after_a_while_of_membership(stays: int, pause: int) -> None:
    membership, tick = MembershipRecord(), FORGIVEN
    for _ in range(2):
        membership.on(MembershipEvent.SILENT, tick)
        tick += pause_after(membership, tick)
    membership.on(MembershipEvent.SIGNAL, tick)
    membership.on(MembershipEvent.SILENT, tick + stays)
    assert pause_after(membership, tick + stays) == pause


def test_a_coupling_that_explains_its_pause_is_expected_at_once() -> None:
    membership = MembershipRecord()
    for tick in range(0, 50, 5):  # it loses its device again and again
        assert membership.on(MembershipEvent.PAUSES, tick)
        assert membership.on(MembershipEvent.BEHIND, tick)
        assert membership.on(MembershipEvent.SIGNAL, tick + 1)
    assert membership.absences == 10
