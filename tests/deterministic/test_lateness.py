"""Sessions whose devices live in wall time, at delays that no certificate covers (:mod:`tests.deterministic.lateness`).

``make lateness`` runs a thousand of them with networks, ``make scenes`` 500 with scenes.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.environment.scene import SceneLaw
from manyhands.nodes.kernel.bundle import REALTIME, DeviceBundle
from manyhands.protocol.clock import Instant
from tests.deterministic.lateness import (
    E_0,
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


def account_of(bundle: DeviceBundle, events: list[tuple[int, str]], x: Matrix, f: Matrix) -> float:
    """e by its definition, J, where the device knows its place at its samples alone.

    Args:
        bundle: of the device.
        events: instants at which a sample was taken or a force began to act, ns, in their order.
        x: of the samples, m.
        f: the forces, N.
    """
    share, osp, T = bundle.rungs[0].share, bundle.osp, bundle.common.period
    C = np.linalg.inv(osp)
    w, g = np.diff(x, axis=0, prepend=0.0), np.diff(f, axis=0, prepend=0.0)
    y = (w + share.kappa * T * g @ C) / T
    e = T * float(np.sum(f * y)) - T * share.share * float(np.sum((y @ osp) * y))
    samples = forces = 0
    pieces: list[tuple[Matrix, float]] = []
    for (at, what), (end, _) in pairwise(events):
        if what == "sample":
            if samples > 0:
                e -= worst_case(pieces, x[samples] - x[samples - 1], osp, C)
            samples, pieces = samples + 1, []
        else:
            forces += 1
        pieces.append((f[forces - 1] if forces else 0.0 * f[0], (end - at) * 1e-9))
    return e


def worst_case(pieces: list[tuple[Matrix, float]], d: Matrix, osp: Matrix, C: Matrix) -> float:
    """The most that the forces of these pieces can have cost over the motion d, J (decision 30)."""
    pieces = [(r, h) for r, h in pieces if h > 0.0]
    h = sum(length for _, length in pieces)
    mean = sum((r * length for r, length in pieces), 0.0 * d) / h
    spread = sum(0.25 * length * (r - mean) @ C @ (r - mean) for r, length in pieces)
    most = sum(0.25 * length * r @ C @ r for r, length in pieces)
    cost = mean @ d - d @ osp @ d / h + spread
    return float(min(cost, most) if len(pieces) > 1 else cost)


@pytest.mark.parametrize("keeps_on", [False, True], ids=["the next sample waits", "the next sample is taken before"])
def test_the_account_of_a_late_device_is_that_of_its_true_instants(keeps_on: bool) -> None:
    """A device that is late by itself, and a prompt one whose loop is late by as much, move and pay alike.

    The prompt one does all in the order in which it happens, and so may sample between two forces.
    """
    prepared = prepared_session(2)
    assert prepared is not None
    bundle = next(one for one in cut(prepared, RunPlan(REALTIME, None, "")).values() if isinstance(one, DeviceBundle))
    m, T = len(bundle.common.ports), round(1e9 * bundle.common.period)
    latency, age = 3 * (T // 6), T // 6
    bundle = replace(bundle, inertia=None)  # with one, two forces between two samples cost less at most
    late, true = Late(bundle, None, latency), driver_of(bundle)
    rng = np.random.default_rng(4)
    at, events, taken = 0, [], []
    for k in range(300):
        sampled = at + latency
        applied = sampled + int(rng.integers(0, 2 * T))
        at = max(at + T, -(-(applied - latency * keeps_on) // T) * T)
        events += [(sampled - age, "sample", k, sampled), (applied + latency - age, "force", k, applied)]
        taken.append(rng.normal(0.0, 1.0, m).tolist())
    crossed = sum(a[1] == "force" and b[1] == "sample" and a[0] > b[0] for a, b in pairwise(events))
    assert (crossed > 100) is keeps_on
    late_x, true_x = [], []
    for _, what, k, called in events:
        if what == "sample":
            late_x.append(late.tick.sample(k, Instant(called)))
        else:
            late.tick.exert(taken[k], Instant(called))
            late.tick.book()
    for acts, what, k, _ in sorted(events):
        if what == "sample":
            true_x.append(list(map(float, true.sample(k, Instant(acts)))))
        else:
            true.apply(taken[k], Instant(acts))
    assert late_x == true_x
    e = account_of(bundle, [(at, what) for at, what, *_ in sorted(events)], np.array(true_x), np.array(taken))
    assert late.tick.wall_interface.account.energy == pytest.approx(e, abs=1e-12)
    assert e > 1e-3
