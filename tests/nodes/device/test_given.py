"""What a hand was given of the force that was asked for, by force and by time."""

from __future__ import annotations

import pytest

from manyhands.nodes.device.given import ForceGiven, Loss
from manyhands.nodes.kernel.timeouts import PATIENCE_TICKS, RAMP
from manyhands.protocol.clock import Duration, Instant

T = Duration(1_000_000)


def tick(account: ForceGiven, k: float, f: float = 5.0, **other: float) -> None:
    """At k T the device is asked for f, within its limits for ``within``, and exerts ``r`` of that."""
    at = Instant(round(k * T))
    within = other.get("within", f)
    account.ask([f], [within])
    ended = Instant(round(other.get("ended", k) * T))
    early = other.get("early", 0.0) > 0.0
    account.applied(at, ended, early, [other.get("r", within)], other.get("lowered", 0.0) > 0.0)


def milliseconds(account: ForceGiven) -> tuple[float, dict[Loss, float]]:
    return account.time / 1e6, {loss: account.lost[loss] / 1e6 for loss in Loss if account.lost[loss]}


def test_a_loop_in_time_is_given_all() -> None:
    account = ForceGiven(T)
    for k in range(101):
        tick(account, k, f=0.0 if k % 2 else -5.0)
    assert account.given == account.asked == pytest.approx(50 * 5e-3)
    assert milliseconds(account) == (100.0, {})


def test_a_device_without_an_answer_is_given_nothing_in_that_time_and_while_its_force_rises_again() -> None:
    """By force it would have all of what was asked, for nothing is asked of it."""
    account = ForceGiven(T)
    for k in range(11):
        tick(account, k, f=0.0)
    account.let_go()  # 5 ms after the sample of a tick that is never answered
    # and the session takes it in again 200 ms later, with a zero force
    for k in range(210, 411):
        tick(account, k, f=0.0 if k < 250 else 5.0, ended=15 if k == 210 else k)
    assert account.given == account.asked
    time, lost = milliseconds(account)
    assert (time, lost) == (410.0, {Loss.AWAY: 195.0 + RAMP})


def test_one_that_was_held_for_some_ticks_goes_on_without_a_ramp() -> None:
    account = ForceGiven(T)
    for k in range(11):
        tick(account, k)
    account.let_go()
    for k in range(10 + PATIENCE_TICKS, 300):
        tick(account, k, ended=15 if k == 10 + PATIENCE_TICKS else k)
    assert milliseconds(account)[1] == {Loss.AWAY: PATIENCE_TICKS - 5.0}


def test_a_device_that_joins_does_not_count_the_time_before_it_takes_part() -> None:
    account = ForceGiven(T)
    account.joins()
    for k in range(5000, 5301):
        tick(account, k)
    assert milliseconds(account) == (300.0 - RAMP, {})
    account.let_go()
    tick(account, 5400, ended=5306)
    assert milliseconds(account)[1] == {Loss.AWAY: 94.0}
    account.leaves()
    tick(account, 5500)
    assert milliseconds(account)[0] == 300.0 - RAMP + 100.0


def test_one_that_was_sent_on_before_its_first_force_joins_as_well() -> None:
    account = ForceGiven(T)
    account.skipped()
    for k in range(50, 250):
        tick(account, k)
    assert milliseconds(account) == (199.0 - RAMP, {})


@pytest.mark.parametrize(
    ("other", "lost"),
    [
        ({"r": 4.0, "lowered": 1.0}, Loss.HELD_BACK),
        ({"within": 4.0}, Loss.CUT),
        ({"within": 0.0}, Loss.CUT),  # the device is beyond its limits of motion
        ({"r": 4.0}, Loss.CUT),  # its hardware exerts less
    ],
)
def test_why_a_force_is_not_all(other: dict[str, float], lost: Loss) -> None:
    account = ForceGiven(T)
    for k in range(11):
        tick(account, k, **other)
    assert milliseconds(account) == (10.0, {lost: 10.0})


def test_a_force_that_ends_early_was_held_back_unless_no_answer_came_at_all() -> None:
    account = ForceGiven(T)
    tick(account, 0)
    tick(account, 4, ended=1, early=1.0)
    assert milliseconds(account) == (4.0, {Loss.HELD_BACK: 3.0})
    assert account.given == pytest.approx(0.25 * account.asked)
    account.let_go()
    tick(account, 14, ended=5, early=1.0)
    assert milliseconds(account) == (14.0, {Loss.HELD_BACK: 3.0, Loss.AWAY: 9.0})


def test_a_process_that_ends_without_an_answer_counts_that_time() -> None:
    account = ForceGiven(T)
    tick(account, 0)
    tick(account, 1)
    account.conclude(Instant(50 * T), Instant(50 * T))  # it had an answer: the session was over
    assert milliseconds(account) == (1.0, {})
    account.let_go()
    account.conclude(Instant(50 * T), Instant(6 * T))
    assert milliseconds(account) == (50.0, {Loss.AWAY: 44.0})
