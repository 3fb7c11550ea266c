"""The supervisor's budget of frames: generous to members, bounded in floods, with pauses between reads."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from manyhands.launch.run.supervisor import FrameAllowance
from manyhands.protocol.clock import Instant

SECOND = 1_000_000_000
PER_SECOND = 500


def test_what_an_honest_session_sends_is_never_held_up() -> None:
    allowance = FrameAllowance(PER_SECOND, Instant(0))
    for tenth in range(100):
        now = Instant(tenth * SECOND // 10)
        for _ in range(PER_SECOND // 20):
            assert allowance.pause(now) == 0
            allowance.spend(1, now)
    assert allowance.exhausted == 0


def test_a_flood_is_read_at_the_stated_rate_in_few_calls() -> None:
    allowance, now, read, sittings = FrameAllowance(PER_SECOND, Instant(0)), 0, 0, 0
    while now < 10 * SECOND:
        sittings += 1
        while (pause := allowance.pause(Instant(now))) == 0:
            allowance.spend(1, Instant(now))
            read += 1
        now += pause
    assert 10 * PER_SECOND <= read <= 11 * PER_SECOND  # what it had at first, and ten seconds' worth
    assert sittings <= 102  # ten a second, not one a frame
    assert allowance.exhausted == sittings


def test_frames_dropped_at_once_are_charged_to_later_reads() -> None:
    allowance = FrameAllowance(PER_SECOND, Instant(0))
    allowance.spend(3 * PER_SECOND, Instant(0))
    assert allowance.pause(Instant(0)) == 2 * SECOND + SECOND // 10
    assert allowance.pause(Instant(2 * SECOND)) == SECOND // 10
    assert allowance.pause(Instant(2 * SECOND + SECOND // 10)) == 0


@given(st.lists(st.tuples(st.integers(0, SECOND), st.integers(1, 40)), max_size=60))
def test_never_more_than_a_seconds_worth_beyond_the_rate(steps: list[tuple[int, int]]) -> None:
    allowance, now, read, most = FrameAllowance(PER_SECOND, Instant(0)), 0, 0, 0
    for wait, frames in steps:
        now += wait
        if allowance.pause(Instant(now)) == 0:
            allowance.spend(frames, Instant(now))
            read, most = read + frames, max(most, frames)
        assert read <= PER_SECOND * (now / SECOND + 1.0) + most + 1
