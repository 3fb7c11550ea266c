"""Sessions withstand faults, by a fixed set of seeds.

Other seeds, by the thousand: ``python -m tests.deterministic.campaign``.
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


@pytest.mark.parametrize(
    ("session", "clock", "seed"),
    [
        ("example-1", "simulated", 100012),  # active in a tick before the one that it was sent on to
        ("example-1", "simulated", 200020),  # a device one tick behind a coupling that is new
        ("crossed", "simulated", 100004),  # sent on by one of its blocks, awaited by the other in the ticks between
        ("crossed", "realtime", 100005),  # a pause counted in ticks that do not come
        ("crossed", "simulated", 400016),  # a returned environment waits for a member without a sample
        ("alone", "realtime", 200031),  # a first signal after long, too far from the last
    ],
)
def test_what_once_stood_still_goes_on(session: str, clock: str, seed: int) -> None:
    outcome = run(session, clock, faults=20, seed=seed)
    assert not outcome.violations, "\n".join([*outcome.violations, outcome.account])


@pytest.mark.parametrize(
    ("session", "seed"),
    [
        *((session, seed) for session in SESSIONS for seed in range(2)),
        ("crossed", 700014),  # awaits a message at the end, which the other block could not bring about without it
        ("crossed", 700094),
    ],
)
def test_a_session_comes_to_its_end_however_late_its_processes_are(session: str, seed: int) -> None:
    outcome = run(session, "realtime", faults=50, seed=seed, ticks=60)
    assert not outcome.violations, "\n".join([*outcome.violations, outcome.account])


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_seed_decides_all_that_happens(clock: str) -> None:
    assert run("example-1", clock, faults=3, seed=7) == run("example-1", clock, faults=3, seed=7)
