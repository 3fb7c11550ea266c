"""Hostile guests within their bounds cost the others at most a stated transient, by a fixed set of seeds.

Other seeds, by the thousand: ``python -m tests.deterministic.hostile``.
"""

from __future__ import annotations

import pytest

from .guests import Motion, Stamps, Strategy, Timing
from .hostile import HostileCase, run
from .hostile import case as of_hostile
from .innocence import Wrong
from .magnitudes import run as besiege
from .seats import Seats, giant, silent, wrong
from .seats import case as at_seats

PATIENT = 300  # ticks: enough to be frozen, expected again and frozen again


@pytest.mark.parametrize("seed", range(5))
def test_hostile_guests_harm_nobody(seed: int) -> None:
    outcome = run(of_hostile(seed), PATIENT)
    assert not outcome.wrong, "\n".join([*(f"{kind}: {text}" for kind, text in outcome.wrong), outcome.account])


@pytest.mark.parametrize("seed", range(2))
def test_honest_sessions_do_not_notice(seed: int) -> None:
    outcome = run(of_hostile(seed, honest=True), PATIENT)
    assert not outcome.wrong, "\n".join([*(f"{kind}: {text}" for kind, text in outcome.wrong), outcome.account])
    assert outcome.ticks >= PATIENT


@pytest.mark.parametrize("clock", ["simulated", "realtime"])
def test_lying_stamps_gain_nothing(clock: str) -> None:
    """A guest that moves six times as fast as its limit claims six periods in every tick."""
    lies = Strategy(stamps=Stamps.LONG, periods=6, motion=Motion.BANG, frequency=2.0)
    outcome = run(HostileCase(1, clock, 1, "plain", False, lies), PATIENT)
    assert not outcome.wrong, "\n".join([*(f"{kind}: {text}" for kind, text in outcome.wrong), outcome.account])


@pytest.mark.parametrize("late", [0.2, 0.7, 2.2])
def test_guests_late_within_the_timeout_cost_others_only_a_transient(late: float) -> None:
    outcome = run(HostileCase(2, "realtime", 2, "plain", False, Strategy(timing=Timing.LATE, late=late)), PATIENT)
    assert not outcome.wrong, "\n".join([*(f"{kind}: {text}" for kind, text in outcome.wrong), outcome.account])


def test_a_start_far_from_its_tool_stays_within_the_energy_budget() -> None:
    """The first sample has no step: at once it was 4.8 J, and 1.7 J of that reached the others in a quarter second."""
    outcome = run(of_hostile(100616), 60)
    assert not [text for kind, text in outcome.wrong if kind is Wrong.ENERGY]
    assert outcome.received < 0.2


def test_of_two_late_couplings_of_a_guest_neither_hides_the_other() -> None:
    """A link read right behind a late one was read first in the next tick: no wait was charged to it."""
    outcome = run(of_hostile(100525), 400)
    assert Wrong.SOFTENED not in {kind for kind, _ in outcome.wrong}, outcome.wrong


@pytest.mark.parametrize(("seed", "ticks"), [(4100141, 150), (4100291, 320)])
def test_ticks_of_a_return_and_ambiguous_ticks_are_not_the_others(seed: int, ticks: int) -> None:
    """Of a late guest: each of its returns delayed the others; a sixth of its late ticks was taken for theirs."""
    assert run(of_hostile(seed), ticks).wrong == ()


def test_a_seed_decides_all_that_happens() -> None:
    assert run(of_hostile(3), 60) == run(of_hostile(3), 60)


@pytest.mark.parametrize("seed", range(20))
def test_waves_of_any_magnitude_break_no_account(seed: int) -> None:
    """By the million: ``python -m tests.deterministic.magnitudes``."""
    besiege(seed, 1000)


@pytest.mark.parametrize("kind", ["square", "jump", "swing"])
def test_a_guest_of_giant_waves_changes_nobody_elses_account(kind: str) -> None:
    """U up to 9e11 and G = 1e12: its tool was at 14 km, its account at 2e6 J, the other's force stepped by 16 N, and
    the other was stopped for it."""
    found, alone = (Seats(guest, lambda t: 3.0 if t > 0.2 else 0.0).run(1.0) for guest in (giant(kind), silent))
    assert not wrong(found)
    assert found.refused > 900
    assert found.furthest <= 0.5
    assert found.step == pytest.approx(alone.step, rel=0.1)


@pytest.mark.parametrize("seed", [100001, 100003])
def test_a_guest_at_its_bounds_keeps_to_its_budget_and_nobody_else_is_stopped(seed: int) -> None:
    """For longer, and by the hundred: ``python -m tests.deterministic.seats``."""
    _, guest, hand = at_seats(seed)
    found = Seats(guest, hand).run(1.5)
    assert not wrong(found)
