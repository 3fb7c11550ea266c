"""What held torques take of a level: the formula, its rounding, and the inequality that its theorem rests on."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.levels.held_torque import HeldTorque, held_torque_of

T = 1e-3
numbers = st.floats(1e-3, 1e3)


def test_the_example_of_a_small_arm() -> None:
    held = HeldTorque(18.8, 12.0, 1.0)
    K_geo = held.stiffness(T, 0.0, 0.0)
    assert K_geo is not None
    assert float(K_geo) == pytest.approx(18.8 * 12.0 / (1.0 - 0.0094), rel=1e-12)
    assert held.damping(T, 0.0, 0.0) == pytest.approx(0.1139, abs=1e-4)
    assert held.left(0.1 * np.eye(2), T, 0.0, 0.0) is None
    left = held.left(np.array([[0.3, 0.05], [0.05, 0.2]]), T, 0.0, 0.0)
    assert left is not None
    assert left == pytest.approx(np.array([[0.3 - 0.11387, 0.05], [0.05, 0.2 - 0.11387]]), abs=1e-5)


def test_a_tip_that_may_turn_too_far_in_one_hold_leaves_nothing() -> None:
    held = HeldTorque(100.0, 1.0, 20.0)  # kappa v T = 2
    assert held.stiffness(T, 0.0, 0.0) is None
    assert held.left(1e6 * np.eye(1), T, 0.0, 0.0) is None
    assert held.stiffness(0.9 * T, 0.0, 0.0) is not None


@given(numbers, numbers, numbers, st.floats(1e-5, 1e-2), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.1, 1e3))
def test_what_is_left_is_never_more_than_exactly_and_hardly_less(
    kappa: float, force: float, speed: float, period: float, part: float, rho: float, osp: float
) -> None:
    held, tau = HeldTorque(kappa, force, speed), part * period
    K_geo = held.stiffness(period, tau, rho)
    left = held.left(np.array([[osp]]), period, tau, rho)
    if K_geo is None:
        assert left is None
        return
    exact = Fraction(osp) - K_geo * ((1 + Fraction(rho)) * Fraction(period) + 3 * Fraction(tau)) / 2
    if left is None:
        assert exact <= Fraction(osp) / 10**11
    else:
        assert exact - Fraction(osp) / 10**11 < Fraction(float(left[0, 0])) <= exact


@given(st.floats(1e-6, 1.0), st.floats(1e-6, 1.0))
def test_the_damping_pays_at_every_delay_up_to_the_longest(t: float, part: float) -> None:
    # decision 50: D (a^2/s + b^2/(1 - s)) - (1/2 + t)(a + b)^2 - a^2/(4t) >= 0, s the delay, t the longest one
    s, D = part * t, 0.5 + 1.5 * t
    rest = 1.0 - s
    form = np.array(
        [[D / s - (0.5 + t) - 0.25 / t, -(0.5 + t)], [-(0.5 + t), (D / rest if rest > 1e-12 else 1e12) - (0.5 + t)]]
    )
    scale = np.diag([np.sqrt(s), np.sqrt(max(rest, 1e-12))])
    assert np.linalg.eigvalsh(scale @ form @ scale)[0] >= -1e-12


def test_plain_data_come_back() -> None:
    for held in (HeldTorque(18.8, 12.0, 1.0), HeldTorque(0.1, 0.2, 0.3, {"kind": "chain"})):
        assert held_torque_of(held.describe()) == held


@pytest.mark.parametrize(
    "data", [{"kappa": 1.0, "force": 1.0}, {"kappa": 1.0, "force": 1.0, "speed": 1.0, "mass": 1.0},
             {"kappa": 0.0, "force": 1.0, "speed": 1.0}, {"kappa": 1.0, "force": float("inf"), "speed": 1.0},
             {"kappa": 1.0, "force": 1.0, "speed": 1.0, "linkage": "arm"}],
)  # fmt: skip
def test_other_data_are_refused(data: dict[str, object]) -> None:
    with pytest.raises((KeyError, ValueError)):
        held_torque_of(data)
