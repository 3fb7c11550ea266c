"""The tank of a wave link: its rules hold for every float, and no rounding makes energy."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.wave_link.play_out import PlayOut
from manyhands.nodes.wave_link.tank import FULL, Tank

from .exact_tank import ExactTank, joules

T = 1e-3
ANY = st.floats() | st.floats(-1e6, 1e6) | st.sampled_from([0.0, 5e-324, 1e-300, 1e-162, 1e-154, 1e154, 1e300, -1e300])
"""All there are, NaN and infinities among them, and those whose squares underflow or overflow."""
WAVES = st.lists(ANY, min_size=2, max_size=2)
STEPS = st.lists(
    st.tuples(st.just("receive"), ANY)
    | st.tuples(st.just("pay"), WAVES)
    | st.tuples(st.just("earn"), WAVES, ANY)
    | st.tuples(st.just("ship"), ANY),
    max_size=40,
)


@given(E_0=st.sampled_from([0.0, 5e-324, 1e-300, 5e-3, 10.0, 1e12]), steps=STEPS)
def test_whatever_it_is_given_it_never_pays_nor_ships_more_than_it_has(E_0: float, steps: list[tuple]) -> None:
    """Exactly, in every step (:class:`ExactTank` checks it); and no step raises."""
    tank = ExactTank(T, E_0)
    for step, *of in steps:
        getattr(tank, step)(*of)
        assert all(math.isfinite(x) and x >= 0.0 for x in (tank.level, tank.cost, *tank.row()))


@given(level=st.floats(0.0, FULL), c=st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=4))
def test_a_limited_wave_keeps_its_direction_and_uses_what_is_there(level: float, c: list[float]) -> None:
    tank = Tank(T, level)
    paid = tank.pay(c)
    if paid == c:
        return
    assert all(at * to >= 0.0 for at, to in zip(paid, c, strict=True))
    ratios = [at / to for at, to in zip(paid, c, strict=True) if abs(at) > 1e-290]
    assert ratios == pytest.approx(ratios[:1] * len(ratios), rel=1e-9)
    # below it nothing is left but what the margin of 1e-9 keeps, twice as much of a square
    assert tank.level <= 3e-9 * level + 1e-307


@given(shipped=st.floats(0.0, 1e9), level=st.floats(0.0, 1e9), s=st.floats(0.0, 1e9))
def test_what_is_shipped_is_what_leaves_the_tank_to_a_last_bit(shipped: float, level: float, s: float) -> None:
    tank = Tank(T, level)
    tank.shipped = shipped
    tank.ship(s)
    left, came = joules(level) - joules(tank.level), joules(tank.shipped) - joules(shipped)
    assert 0 <= came <= left
    assert tank.shipped == pytest.approx(shipped + min(s, level), rel=1e-15)
    assert tank.level == pytest.approx(level - min(s, level), rel=1e-15, abs=1e-15 * (level + shipped))


def test_energy_that_passes_is_not_lost_to_rounding() -> None:
    """An hour at 1 kHz with 8 N: some 1e-15 of each tick's energy; all told less than a nanojoule."""
    tank = Tank(T, 5e-3)
    wave = [8.0 / math.sqrt(40.0)]
    for _ in range(100_000):
        tank.pay(wave)
        tank.ship(tank.earn(wave, 0.0))
        tank.receive(tank.shipped)
    assert 0.0 <= 5e-3 - tank.level < 36.0 * 1e-11


def test_small_waves_after_great_ones_leave_nothing_owed() -> None:
    """A running sum kept the rounding of the great ones, which counted as spare energy, and the tank shipped it."""
    line = PlayOut(T, T, 3.0)
    U = 0.0
    for n in range(60):
        U += 10.0 ** (6 if n % 7 == 0 and n < 30 else -2)
        line.hear(n, [U])
        line.advance()
        assert line.owed >= 0.0
    for n in range(60, 200):
        line.hear(n, [U])
        line.advance()
    assert line.owed == 0.0
