"""Sessions withstand faults, by a fixed set of seeds.

Others, by the thousand: ``python -m tests.deterministic.campaign``.
"""

from __future__ import annotations

import pytest

from .campaign import SESSIONS, run

CLOCKS = ("simulated", "realtime")


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("session", SESSIONS)
@pytest.mark.parametrize("seed", range(2))
def test_a_session_withstands_faults(session: str, clock: str, seed: int) -> None:
    outcome = run(session, clock, faults=8, seed=seed)
    assert not outcome.violations, "\n".join([*outcome.violations, outcome.account])
    assert outcome.faults == 8


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_seed_decides_all_that_happens(clock: str) -> None:
    assert run("example-1", clock, faults=3, seed=7) == run("example-1", clock, faults=3, seed=7)
