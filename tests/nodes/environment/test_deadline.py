"""When the environment gives a coupling up: a table of instants and decisions, without a socket."""

from __future__ import annotations

import pytest

from manyhands.nodes.environment.deadline import Deadline, Decision, Step
from manyhands.nodes.kernel.timeouts import Timeouts
from manyhands.protocol.clock import Duration, Instant

MS = 10**6
BEGAN, PERIOD, FREEZE, STALE = 100.0, 1.0, 3.0, 5.0  # ms


def in_real_time(due: float = BEGAN) -> Deadline:
    """A wait that begins at BEGAN, for a tick that the devices sample at ``due``, ms."""
    return waiting(Timeouts(ns(FREEZE), ns(STALE), ns(FREEZE), ns(FREEZE), ns(2.0), ns(STALE)), due)


def waiting(patience: Timeouts, due: float) -> Deadline:
    return Deadline(patience, ns(PERIOD), at(due), at(BEGAN))


def ns(ms: float) -> Duration:
    return Duration(round(ms * MS))


def at(ms: float) -> Instant:
    return Instant(round(ms * MS))


def decide(deadline: Deadline, now: float, *facts: str) -> Decision:
    """The decision at ``now``, ms, where the facts named are true."""
    return deadline.decide(at(now), *(fact in facts for fact in ("present", "missing", "later", "early")))


@pytest.mark.parametrize(
    ("seen", "due", "given_up"),
    [
        # first member found there, sampling of the devices, giving up of the missing one; ms after BEGAN
        (0.2, 0.0, 3.2),  # the present member waits since it was found
        (1.0, 0.0, 4.0),
        (2.5, 0.0, 4.0),  # found later than a period after the tick before: it came after a period at the earliest
        (0.2, 0.8, 3.8),  # and not before the devices sample
        (2.5, 2.0, 5.0),
    ],
)
def test_missing_is_given_up_once_others_have_waited_for_freeze(seen: float, due: float, given_up: float) -> None:
    for shift, step in ((-1e-6, Step.LISTEN), (0.0, Step.GIVE_UP)):
        deadline = in_real_time(BEGAN + due)
        deadline.listened = True
        assert decide(deadline, BEGAN + seen, "present", "missing").step is Step.LISTEN
        found = decide(deadline, BEGAN + given_up + shift, "present", "missing")
        assert found.step is step
        assert found.waited == (ns(FREEZE) if step is Step.GIVE_UP else 0)


@pytest.mark.parametrize(
    ("now", "facts", "forget", "pardon"),
    [
        (3.0, (), False, False),
        (3.1, (), False, True),
        (3.1, ("present",), False, False),
        (5.0, (), False, True),
        (5.1, (), True, True),
        (5.1, ("present",), True, False),
        (5.1, ("later",), True, True),
    ],
)
def test_forgets_beyond_stale_and_pardons_while_nobody_is_there(
    now: float, facts: tuple[str, ...], forget: bool, pardon: bool
) -> None:
    found = decide(in_real_time(), BEGAN + now, *facts)
    assert (found.forget, found.pardon) == (forget, pardon)


@pytest.mark.parametrize(
    ("facts", "listened"),
    [
        (("present", "missing"), False),  # the node was away itself
        (("present",), True),  # no member is missing
        (("missing",), True),  # no member waits
        (("missing", "later"), True),
    ],
)
def test_nobody_is_given_up(facts: tuple[str, ...], listened: bool) -> None:
    deadline = in_real_time()
    deadline.listened = listened
    for now in (0.5, 10.0, 100.0):
        assert decide(deadline, BEGAN + now, *facts).step is not Step.GIVE_UP


@pytest.mark.parametrize("present", [False, True])
@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("listened", [False, True])
def test_complete_with_somebody_there_nobody_missing_and_all_listened_to(
    present: bool, missing: bool, listened: bool
) -> None:
    deadline = in_real_time()
    deadline.listened = listened
    assert deadline.complete(present, missing) == ((present, missing, listened) == (True, False, True))


def test_moves_to_a_later_tick_and_waits_there_from_the_beginning() -> None:
    deadline = in_real_time()
    deadline.listened = True
    decide(deadline, BEGAN + 0.5, "present", "missing")
    assert decide(deadline, BEGAN + 4.0, "missing", "later").step is Step.MOVE
    assert decide(deadline, BEGAN + 4.0, "missing").step is Step.LISTEN
    assert decide(deadline, BEGAN + 4.0, "present", "missing").step is Step.GIVE_UP  # a period after the wait began


def test_an_early_signal_waits_too() -> None:
    deadline = in_real_time()
    deadline.listened = True
    assert decide(deadline, BEGAN + 2.0, "missing", "early").step is Step.LISTEN
    assert decide(deadline, BEGAN + 4.9, "missing", "early").step is Step.LISTEN
    assert decide(deadline, BEGAN + 5.0, "missing", "early") == Decision(Step.GIVE_UP, False, True, ns(FREEZE))


def test_after_a_restart_all_times_count_from_then() -> None:
    deadline = in_real_time()
    deadline.listened = True
    decide(deadline, BEGAN + 1.0, "present", "missing")
    deadline.restart(at(BEGAN + 4.0))
    found = decide(deadline, BEGAN + 6.0, "present", "missing")
    assert found == Decision(Step.LISTEN, False, False)
    assert decide(deadline, BEGAN + 8.0, "present", "missing").step is Step.GIVE_UP


def test_whoever_was_given_up_makes_nobody_wait_again_at_once() -> None:
    deadline = in_real_time()
    deadline.listened = True
    decide(deadline, BEGAN, "present", "missing")
    assert decide(deadline, BEGAN + 3.0, "present", "missing").step is Step.GIVE_UP
    assert decide(deadline, BEGAN + 3.0, "missing").step is Step.LISTEN


def test_under_the_simulated_clock_nobody_is_given_up_forgotten_or_pardoned() -> None:
    deadline = waiting(Timeouts(None, None, ns(1.0), ns(1.0), ns(1.0), None), BEGAN)
    deadline.listened = True
    for now in (1.0, 1e6):
        assert decide(deadline, BEGAN + now, "present", "missing") == Decision(Step.LISTEN, False, False)
        assert decide(deadline, BEGAN + now, "missing", "early") == Decision(Step.LISTEN, False, False)
