"""Sessions whose tools are turned by devices in wall time (:mod:`tests.deterministic.late_turns`).

``make orientation`` runs five hundred of them.
"""

from __future__ import annotations

from typing import Any

import pytest

from manyhands.nodes.device.orientation import DeviceOrientation
from tests.deterministic.late_turns import Outcome, course, outcome_of, prepared_session

pytest.importorskip("mujoco")

SEEDS = (17, 23, 38)
"""With delays of any length, with bursts and stops alone, and with hands that would get energy."""


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    found = [outcome_of(seed, 200) for seed in SEEDS]
    return [outcome for outcome in found if outcome is not None]


def test_no_hand_gets_what_its_account_and_its_lateness_do_not_leave(outcomes: list[Outcome]) -> None:
    assert len(outcomes) == len(SEEDS)
    assert [outcome.violations for outcome in outcomes] == [()] * len(outcomes)
    assert all(outcome.covered[1].torques > 150 for outcome in outcomes)
    assert all(outcome.enforced[1].late > 0.0 for outcome in outcomes)
    assert any(outcome.enforced[1].torques > 100 for outcome in outcomes)


def test_with_less_damping_or_uncharged_a_hand_gets_energy(outcomes: list[Outcome]) -> None:
    """Otherwise the other test would show nothing."""
    assert any(outcome.weaker.below < -1e-5 for outcome in outcomes)
    assert any(outcome.uncharged.beyond < -1e-5 for outcome in outcomes)


def test_a_late_tick_that_is_credited_without_a_torque_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The proxy rests while a process stands still: the spring to it has stored nothing."""
    judge = DeviceOrientation._judge

    def credited(of: DeviceOrientation, *tick: Any) -> None:
        proxy, owed = of.spring.proxy, of.spring.owed
        judge(of, *tick)
        if not any(of.torque) and not any(of._before):
            of.spring.proxy, of.spring.owed = proxy, min(of.spring.owed, owed)

    monkeypatch.setattr(DeviceOrientation, "_judge", credited)
    prepared = prepared_session(17)
    assert prepared is not None
    assert course(prepared, 17, "beyond", 200)[1].below < -1e-3
