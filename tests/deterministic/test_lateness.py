"""Sessions whose devices live in wall time, at delays that no certificate covers (:mod:`tests.deterministic.lateness`).

``make lateness`` runs a thousand of them with networks, ``make scenes`` 500 with scenes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from manyhands.design.models.statespace import StateSpace
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.nodes.bundle import REALTIME, DeviceBundle
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.tick import WallTimeTick
from manyhands.nodes.environment.scene import SceneLaw
from manyhands.protocol.clock import Instant
from tests.deterministic.lateness import (
    E_0,
    DelayedDriver,
    Late,
    Outcome,
    outcome_of,
    outcome_of_session,
    prepared_session,
)
from tests.support.cases import cases

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


@pytest.mark.parametrize("part", [0.4, 1.0])
def test_a_latency_that_is_stated_is_as_a_delay_of_the_loop(part: float) -> None:
    """A part of tau, or all of it, is the devices' own: their age and delay are accounted for, and bounded alike."""
    found = [outcome for seed in (2, 5) if (outcome := outcome_of(seed, 500, part)) is not None]
    assert len(found) == 2
    assert [outcome.violations for outcome in found] == [(), ()]
    assert any(outcome.enforced.changed > 0 for outcome in found)
    assert any(outcome.counted.least < -E_0 for outcome in found)


@pytest.fixture(scope="module")
def scenes() -> list[Outcome]:
    found = [outcome_of(seed, 400, scenes=True) for seed in range(9, 9 + cases(3, 60))]
    return [outcome for outcome in found if outcome is not None]


@pytest.mark.wide
def test_no_device_in_a_scene_breaks_its_account_or_diverges(scenes: list[Outcome]) -> None:
    assert len(scenes) >= 3
    assert [outcome.violations for outcome in scenes] == [()] * len(scenes)
    assert all(outcome.covered.felt > 40 for outcome in scenes[:3])


def test_in_a_scene_the_same_instants_break_accounts_without_the_tank(scenes: list[Outcome]) -> None:
    assert any(outcome.counted.least < -E_0 for outcome in scenes)
    assert any(outcome.enforced.changed > 0 for outcome in scenes)


def test_a_coupling_that_is_stiffer_than_its_certificate_is_found() -> None:
    """Ten times as stiff under the same claim: its ledger falls below 0."""
    prepared = prepared_session(9, scenes=True)
    assert prepared is not None
    blocks = tuple(StateSpace(block.A, block.B, block.C / 10.0, block.D / 10.0) for block in prepared.blocks)
    outcome = outcome_of_session(replace(prepared, blocks=blocks), 9, 400, 0.0, scenes=True)
    assert outcome is not None
    assert "found a ledger of c" in outcome.violations[0]


def test_a_contact_that_pulls_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The wrong sign in a scene's forces: the controller has to keep back what they would put out."""
    prepared = prepared_session(9, scenes=True)
    assert prepared is not None
    law = SceneLaw.propose
    monkeypatch.setattr(SceneLaw, "propose", lambda *arguments: -law(*arguments))
    outcome = outcome_of_session(prepared, 9, 400, 0.0, scenes=True)
    assert outcome is not None
    assert "kept back by the controller" in outcome.violations[0]


def test_the_account_of_a_late_device_is_that_of_its_true_instants() -> None:
    """A device that is late by itself, and a prompt one whose loop is late by as much, move and pay alike."""
    prepared = prepared_session(2)
    assert prepared is not None
    bundle = next(one for one in cut(prepared, RunPlan(REALTIME, None, "")).values() if isinstance(one, DeviceBundle))
    m, T = len(bundle.common.ports), round(1e9 * bundle.common.period)
    latency, age = 3 * (T // 6), T // 6
    late = Late(bundle, None, latency)
    true = WallTimeTick(replace(bundle, tank=None), DelayedDriver(driver_of(bundle), 0, 0))
    rng = np.random.default_rng(4)
    at = 0
    for k in range(300):
        sampled = at + latency
        applied = sampled + int(rng.integers(0, 2 * T))
        at = max(at + T, -(-applied // T) * T)
        f = rng.normal(0.0, 1.0, m).tolist()
        for tick, sample, force in (
            (late.tick, sampled, applied),
            (true, sampled - age, applied + latency - age),
        ):
            tick.sample(k, Instant(sample))
            tick.exert(f, Instant(force))
            tick.book()
        assert late.tick.x == true.x
        e = late.tick.wall_interface.account.energy
        assert e == pytest.approx(true.wall_interface.account.energy, abs=1e-12)
    assert late.tick.wall_interface.account.energy > 1e-3
