"""What a call takes by itself: the clock's time, or the processor's where the thread was preempted."""

from __future__ import annotations

import itertools

from manyhands.launch.conformance.timing import CallTimer

MS = 1_000_000


def test_a_call_that_waits_counts_by_the_clock() -> None:
    timer = CallTimer(itertools.count(0, 5 * MS).__next__, lambda: 0)
    timer.begin()
    assert timer.end() == 5 * MS


def test_a_call_that_was_preempted_counts_by_its_processor_time() -> None:
    """Here it does nothing at all while 1000 s pass by the clock."""
    timer = CallTimer(itertools.count(0, 1_000_000 * MS).__next__, itertools.count().__next__)
    timer.begin()
    assert timer.end() < 1000 * MS


def test_the_kernels_count_of_preemptions_does_not_fall() -> None:
    timer = CallTimer()
    timer.begin()
    assert timer.end() >= 0
