"""Force and torque that joints hold together: what they take, and that it pays for them on devices of six axes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.levels.held_torque import HeldTorque, held_torque_of
from manyhands.design.levels.orientation import OrientationLevel, stiffest
from tests.support.turning_arm import Arm
from tests.support.twisting import (
    SUBSTEPS,
    Gantry,
    Mechanism,
    Ways,
    bending,
    chain_at_random,
    curvature,
    leaks,
    longest_twist,
    scale,
    steepest,
    straightest,
    ways,
)

T = 1e-3
DELAYS = (0, 1, 2, SUBSTEPS)
OF = {
    "gantry": Gantry(np.array([0.05, 0.0, 0.02]), 0.6, 0.05),
    "chain": chain_at_random(np.random.default_rng(1)),
    "wrist": chain_at_random(np.random.default_rng(2), wrist=True),
}


def middle(of: Mechanism) -> np.ndarray:
    """A pose within the ranges."""
    return np.where(np.isinf(of.low), 0.1, 0.7 * np.nan_to_num(of.low) + 0.3 * np.nan_to_num(of.high))


@pytest.mark.parametrize("name", OF)
def test_the_twist_and_its_change_are_those_of_the_place(name: str) -> None:
    of, h = OF[name], 1e-6
    q = middle(of)
    J, change = of.jacobian(q), of.changes(q)
    for joint, way in enumerate(np.eye(6)):
        (before, x), (after, y) = of.place(q - h * way), of.place(q + h * way)
        spin = (after - before) / (2 * h) @ of.place(q)[0].T
        assert J[:3, joint] == pytest.approx((y - x) / (2 * h), abs=1e-8)
        assert J[3:, joint] == pytest.approx([spin[2, 1], spin[0, 2], spin[1, 0]], abs=1e-8)
        assert change[joint] == pytest.approx((of.jacobian(q + h * way) - of.jacobian(q - h * way)) / (2 * h), abs=1e-8)


def test_two_directions_are_needed_for_kappa() -> None:
    """Of a gimbal about its tip the greatest |S(u) u| alone is less: of an angular velocity S is not symmetric."""
    rng = np.random.default_rng(0)
    of = Gantry(np.zeros(3), 0.6, 0.05)
    S = bending(of, middle(of)[None])
    u = straightest(S, rng)[0]
    assert np.linalg.norm(np.einsum("acd,c,d->a", S[0], u, u)) < 0.8 * steepest(S, rng)[0]


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("name", OF)
def test_what_the_worst_wrenches_give_out_is_paid_for(name: str, delay: int) -> None:
    of, rng = OF[name], np.random.default_rng(delay)
    kappa = 1.05 * curvature(of, rng, poses=300, closer=4)
    moved = ways(of, rng, 100, 10, 0.03 / kappa, delay)
    way = longest_twist(of, moved.q) * (1.0 + delay / SUBSTEPS)
    force, turning = 2.0, of.length**2
    d = kappa * force / (1.0 - kappa * way / 2.0) * (1.0 + 3.0 * delay / SUBSTEPS) / 2.0
    given_out, burnt = leaks(of, moved)
    assert (d * burnt - force * given_out).min() >= -1e-12
    arm = Arm(of, 1.0, turning, force, d / (0.5 + 1.5 * delay / SUBSTEPS), delay)
    assert arm.least(rng, moved).min() >= -1e-12


@pytest.mark.parametrize(("delay", "factor"), [(0, 1.2), (2, 1.5), (SUBSTEPS, 1.7)])
def test_with_less_it_is_not(delay: int, factor: float) -> None:
    """Even motion where it bends most, with every delay the longest, and a wrench that does not change."""
    of, rng = OF["gantry"], np.random.default_rng(0)
    places = rng.uniform([-1, -1, -1, 0, -0.6, -3], [1, 1, 1, 0, 0.6, 3], (400, 6))
    worst = places[int(np.argmax(steepest(bending(of, places), rng)))]
    kappa = float(steepest(bending(of, worst[None]), rng)[0])
    u = straightest(bending(of, worst[None]), rng)[0]
    ticks = 30
    q = np.empty((1, ticks * SUBSTEPS + 1, 6))
    q[0, 0] = worst
    for i in range(ticks * SUBSTEPS):
        q[0, i + 1] = q[0, i] + np.linalg.solve(of.jacobian(q[0, i]), 1e-5 * u / scale(of))
    late = np.full((1, ticks), delay, dtype=np.intp)
    given_out, burnt = leaks(of, Ways(q, late, np.zeros_like(late)))
    d = kappa * (1.0 + 3.0 * delay / SUBSTEPS) / 2.0
    assert given_out[0, -1] <= 1.001 * d * burnt[0, -1]
    assert given_out[0, -1] > d * burnt[0, -1] / factor


@given(
    st.floats(0.1, 100.0), st.floats(0.1, 50.0), st.floats(0.01, 3.0), st.floats(1e-3, 1.0), st.floats(0.0, 1.0),
    st.floats(0.0, 0.5),
)  # fmt: skip
def test_it_takes_at_least_its_formula_and_what_is_left_is_proved(
    kappa: float, force: float, speed: float, length: float, part: float, rho: float
) -> None:
    held, tau = HeldTorque(kappa, force, speed, None, length), part * T
    assert held_torque_of(held.describe()) == held
    bent = held.stiffness(T, tau, rho)
    assert bent is not None
    exact = Fraction(length) ** 2 * bent * ((1 + Fraction(rho)) * Fraction(T) + 3 * Fraction(tau)) / 2
    taken = held.turning(T, tau, rho)
    assert exact <= Fraction(taken) <= exact * (1 + Fraction(1, 10**14))
    k = stiffest(2.0 * taken, T, tau, rho, taken=taken)
    assert OrientationLevel(2.0 * taken, k, held).proved(T, tau, rho)
    assert not OrientationLevel(2.0 * taken, k / 0.98, held).proved(T, tau, rho)
    assert stiffest(taken, T, tau, rho, taken=taken) == 0.0
    assert not OrientationLevel(taken, 1e-9, held).proved(T, tau, rho)


@pytest.mark.parametrize(
    "data",
    [{"kappa": 1.0, "force": 1.0, "speed": 1.0, "length": length} for length in (0.0, -1.0, float("inf"), float("nan"))]
    + [{"kappa": 1.0, "force": 1.0, "speed": 1.0, "length": 1.0, "linkage": {"kind": "chain"}}],
)
def test_a_length_that_is_none_is_refused(data: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="length"):
        held_torque_of(data)
