"""Sessions whose devices live in wall time, at delays that no certificate covers (:mod:`tests.deterministic.lateness`).

``make lateness`` runs a thousand of them.
"""

from __future__ import annotations

import pytest

from tests.deterministic.lateness import Outcome, outcome_of

SEEDS = (1, 2, 3, 5)


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    found = [outcome_of(seed, 800) for seed in SEEDS]
    return [outcome for outcome in found if outcome is not None]


def test_no_account_falls_below_its_bound_and_nobody_diverges(outcomes: list[Outcome]) -> None:
    assert len(outcomes) >= 3
    assert [outcome.violations for outcome in outcomes] == [()] * len(outcomes)


def test_without_the_tank_the_same_instants_break_accounts(outcomes: list[Outcome]) -> None:
    """Otherwise the other test would show nothing."""
    assert any(outcome.counted.diverged for outcome in outcomes)
    assert any(outcome.enforced.changed > 0 for outcome in outcomes)
