"""The passivity controller alone: its closed form, against the equation that it solves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from manyhands.nodes.kernel.passivity import PassivityController

T = 1e-3
NUMBER = st.floats(-1e3, 1e3)
ROUNDING = 1e-11  # of the work in a tick


def gain(s: float, f: float, w: float, hold: float, allowed: float) -> float:
    """What a ledger gains in a tick with the part s of the force, by definition, J."""
    exerted, velocity = s * f + (1.0 - s) * hold, s * w
    return T * (-velocity * exerted + s * s * allowed)


def work(f: float, w: float, hold: float, allowed: float) -> float:
    return T * (abs(w * f) + abs(w * hold) + abs(allowed))


@given(balance=st.floats(0.0, 10.0), f=NUMBER, w=NUMBER, hold=NUMBER, level=st.floats(-10.0, 10.0))
@example(balance=0.0, f=1.0, w=1.0, hold=1.0, level=0.0)  # the tool moves against the hand
@example(balance=1e-3, f=3.0, w=1.0, hold=-1.0, level=0.0)  # part of it is in the ledger, part the hand pays
@example(balance=0.5, f=-2.0, w=1.0, hold=-3.0, level=-10.0)  # a promise to dissipate
def test_the_part_keeps_the_promise_and_no_less_would(
    balance: float, f: float, w: float, hold: float, level: float
) -> None:
    allowed = level * w * w
    controller = PassivityController(T)
    s = controller.part(balance, np.array([f]), np.array([w]), np.array([hold]), allowed)
    size = work(f, w, hold, allowed)
    assert 0.0 <= s <= 1.0
    assert balance + gain(s, f, w, hold, allowed) >= -ROUNDING * size
    if s < 1.0:  # the least that had to be kept back: a little more of the force breaks the promise
        more = min(1.0, s * (1.0 + 1e-6) + 1e-9)
        assert balance + gain(more, f, w, hold, allowed) <= ROUNDING * size + 1e-8 * size * more


@given(f=NUMBER, hold=NUMBER)
def test_where_nothing_moves_nothing_is_kept_back(f: float, hold: float) -> None:
    controller = PassivityController(T)
    assert controller.part(0.0, np.array([f]), np.zeros(1), np.array([hold]), 0.0) == 1.0
    controller.settle()
    assert (controller.ticks, controller.energy) == (0, 0.0)


def test_the_damper_that_it_stands_for() -> None:
    """F = f_m - alpha Z w with alpha = (1 - s)/s, solved here for one port as the fixed point that it is."""
    G, w_0, f_m, balance = 0.25, 0.4, 2.0, 0.0  # w = w_0 + G f
    w_m, hold = w_0 + G * f_m, -w_0 / G
    controller = PassivityController(T)
    s = controller.part(balance, np.array([f_m]), np.array([w_m]), np.array([hold]), 0.0)
    alpha = (1.0 - s) / s
    w = w_m / (1.0 + alpha)
    f = f_m - alpha / G * w
    assert w == pytest.approx(w_0 + G * f, rel=1e-12)
    assert f == pytest.approx(s * f_m + (1.0 - s) * hold, rel=1e-12)
    assert -w * f == pytest.approx(0.0, abs=1e-7)  # just what keeps a ledger of zero at zero


def test_what_is_kept_back_is_counted_once_a_tick() -> None:
    """Energy: the raw force would have put out w f = 6 J/s more than the ledger has."""
    controller = PassivityController(T)
    f, w, hold = np.array([3.0]), np.array([2.0]), np.array([-1.0])
    for _ in range(3):  # a tick may be tried several times
        s = controller.part(0.0, f, w, hold, 0.0)
    controller.settle()
    controller.settle()
    assert controller.ticks == 1
    controller.part(0.0, f, w, hold, 0.0)
    assert controller.part(1.0, f, w, hold, 0.0) == 1.0  # the last try is the one that counts
    controller.settle()
    assert controller.ticks == 1
    assert controller.energy == pytest.approx(gain(s, 3.0, 2.0, -1.0, 0.0) - T * -6.0, rel=1e-12)


@given(
    seed=st.integers(0, 2**32 - 1),
    m=st.integers(1, 4),
    softness=st.floats(-6.0, -1.0),
    skew=st.floats(0.0, 3.0),
    level=st.floats(-2.0, 2.0),
)
def test_any_feedthrough_with_a_positive_symmetric_part_will_do(
    seed: int, m: int, softness: float, skew: float, level: float
) -> None:
    """The line between f_m and the holding force is the damped algebraic loop's, for unsymmetric G as well."""
    rng = np.random.default_rng(seed)
    root, turn = rng.normal(size=(m, m)), rng.normal(size=(m, m))
    G = 10.0**softness / T * (root @ root.T + 0.1 * np.eye(m) + skew * (turn - turn.T))
    w_0, f_m = rng.normal(size=m), 10.0 ** rng.uniform(-2, 3) * rng.normal(size=m)
    hold, w_m = -np.linalg.solve(G, w_0), w_0 + G @ f_m
    assume(np.linalg.cond(G) < 1e6)
    s = PassivityController(T).part(0.0, f_m, w_m, hold, level * float(w_m @ w_m))
    f = s * f_m + (1.0 - s) * hold
    np.testing.assert_allclose(w_0 + G @ f, s * w_m, atol=1e-9 * (np.abs(w_0).max() + np.abs(G @ f_m).max()))
    size = float(np.abs(w_m * f_m).sum() + np.abs(w_m * hold).sum() + abs(level) * (w_m @ w_m))
    assert -s * (w_m @ f) + level * s * s * (w_m @ w_m) >= -1e-11 * size
