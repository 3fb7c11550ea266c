"""Peers of the law of an orientation are what they are said to be, and get the energy that the table shows."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, angle, turned_by
from tests.support.turning import Motions, bound, least_energy
from tests.support.turning_peers import HOLE, MidpointBody, geodesic, hands, in_a_hole, midpoint

BEST = "midpoint body, damper, torque of the sample"


def moved(late: bool = False) -> Motions:
    return hands(np.random.default_rng(33), 40, 60, 0, late)


@pytest.mark.parametrize("hole", [False, True])
@pytest.mark.parametrize("damper", [0.0, 0.25])
def test_a_midpoint_body_never_gains_more_than_its_port_put_in(hole: bool, damper: float) -> None:
    samples = moved().samples
    bodies, before, lost, tilted = MidpointBody(len(samples), damper, hole), np.zeros(len(samples)), 0.0, 0.0
    for k in range(samples.shape[1]):
        bodies.step(samples[:, k])
        assert (bodies.kept - before).max() < 1e-12
        lost, before = max(lost, float((before - bodies.kept).max())), bodies.kept
        tilted = max(tilted, *(angle(Quaternion(*q), UPRIGHT) for q in bodies.Q.tolist()))
    assert tilted > HOLE  # there were hands that turned it so far
    assert (lost < 1e-12) == (not hole and not damper)  # by itself it is lossless: midpoint, not backward Euler
    upright = bodies.Q[:, 0] ** 2 + bodies.Q[:, 3] ** 2 - bodies.Q[:, 1] ** 2 - bodies.Q[:, 2] ** 2
    assert (upright.min() > np.cos(HOLE + 1e-4)) == hole


def test_a_god_object_is_the_nearest_orientation_and_its_torque_the_angle() -> None:
    R = turned_by(turned_by(UPRIGHT, (0.0, 0.0, 0.3)), (0.5, 0.0, 0.0))
    Q = in_a_hole(R)
    assert angle(R, Q) == pytest.approx(0.5 - HOLE)
    assert geodesic(R, Q) == pytest.approx((-(0.5 - HOLE), 0.0, 0.0))
    assert in_a_hole(turned_by(UPRIGHT, (0.1, 0.1, 2.0))) == turned_by(UPRIGHT, (0.1, 0.1, 2.0))


def test_held_torques_of_a_midpoint_body_give_out_energy_and_fewer_by_a_damper() -> None:
    motions = moved()
    plain, _, _ = midpoint(motions.samples)
    _, fresh, _ = midpoint(motions.samples, 0.25)
    given = [-least_energy(motions, torque, bound(0.0)).min() for torque in (plain, fresh)]
    assert given[0] > 0.01 > given[1]


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The benchmark, which is run from the repository's root."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    return import_module("benchmarks.orientation_peers")


def test_the_table_has_ours_at_nothing_and_the_god_object_in_time_as_well(benchmark: Any) -> None:
    rows = benchmark.measure(100, [1])
    assert benchmark.holds(rows)
    worst = {(row.timing, row.world, row.law): max(row.worst[1.0]) for row in rows}
    assert worst["at once", "a hole", "god-object"] <= benchmark.ROUNDING
    assert worst["late ticks", "a hole", "god-object"] > 1e-4
    assert worst["late ticks", "a hole", "ours, the god-object's proxies"] <= benchmark.ROUNDING
    assert worst["after T", "nothing", "midpoint body"] > 1e-4
    assert benchmark.table(rows).count("\n") == 1 + len(rows)
    assert (
        worst["late ticks", "nothing", "ours, the midpoint body as proxy"] < 0.2 * worst["late ticks", "nothing", BEST]
    )
    for row in rows:
        row.beyond[:] = [1e-6]
    assert not benchmark.holds(rows)
