"""The play-out: no noise and no creep where a force is constant, and no step after a silence."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.wave_link.play_out import HOLD_AFTER, PlayOut

T = 1e-3
SLOPE = 0.8
"""U per tick of a constant wave, in units of T: 5 N at b = 20 N*s/m."""


def played(
    jitter: int, depth: float, ticks: int, seed: int, ppm: float = 0.0, thin: int = 1, sender: float = T
) -> np.ndarray:
    """The increments of the sum that is played for a constant wave, whose messages are up to ``jitter`` ticks late."""
    random = Random(seed)
    line = PlayOut(T, sender, depth)
    due: dict[int, list[int]] = {}
    sums = []
    for n in range(ticks):
        at = n * sender * (1.0 + 1e-6 * ppm)
        if n % thin == 0:
            due.setdefault(math.ceil(at / T + random.uniform(0, jitter)), []).append(n)
    for k in range(round(ticks * sender / T)):
        for n in due.get(k, []):
            if n > line.newest:
                line.hear(n, [SLOPE * sender * n])
        sums.append(line.advance())
    return np.diff([at[0] for at in sums if at]) / (SLOPE * T)


@given(
    seed=st.integers(0, 2**32 - 1),
    jitter=st.integers(0, 20),
    depth=st.floats(0.0, 20.0),
    thin=st.sampled_from([1, 1, 2, 5]),
)
def test_a_constant_wave_is_played_at_its_own_rate(seed: int, jitter: int, depth: float, thin: int) -> None:
    """Late, overtaken and thinned messages change the rate by less than 2 %, and in the end by less than 1 %.

    The latter is what such messages do to the mean depth: 1,200 runs of the worst kind reach 0.84 %.
    """
    rate = played(jitter, depth, 2000, seed, thin=thin)
    start = math.ceil(depth) + 5 * thin + jitter + 10
    assert np.abs(rate[start:] - 1.0).max() <= 0.0201
    assert np.abs(rate[1500:] - 1.0).max() <= 1e-2


@pytest.mark.parametrize("depth", [30.0, 1.0])
def test_a_wrong_depth_is_made_up_at_2_percent(depth: float) -> None:
    line = PlayOut(T, T, 15.0)
    sums = []
    for n in range(3000):
        if n == 500:
            line.depth = depth
        line.hear(n, [SLOPE * T * n])
        sums.append(line.advance()[0])
    rate = np.diff(sums[20:]) / (SLOPE * T)
    assert np.abs(rate - 1.0).max() == pytest.approx(0.02, rel=0.01)
    assert line.lag() == pytest.approx(depth, abs=0.1)


@pytest.mark.parametrize("ppm", [100.0, -100.0])
def test_clocks_that_differ_make_no_creep(ppm: float) -> None:
    """The depth stays where it is wanted: the rate follows the sender's clock."""
    line = played(10, 5.0, 20000, 1, ppm)
    assert np.mean(line[10000:]) == pytest.approx(1.0 - 1e-6 * ppm, abs=2e-5)


def test_a_sender_of_a_different_period_is_played_at_the_receivers() -> None:
    assert played(3, 8.0, 8000, 1, sender=0.25 * T)[500:] == pytest.approx(1.0, abs=2e-3)


@given(seed=st.integers(0, 2**32 - 1), depth=st.integers(5, 30), loss=st.floats(0.0, 0.9))
def test_what_is_played_across_gaps_costs_no_more_than_what_was_sent(seed: int, depth: int, loss: float) -> None:
    """Jensen's inequality: at the sender's rate and behind the newest message, any waves, any losses."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(400, 2)) * rng.choice([0.1, 1.0, 10.0], size=(400, 1))
    U = np.cumsum(T * a, axis=0)
    line = PlayOut(T, T, float(depth))
    line._gain = 0.0  # the rate stays the sender's
    kept = np.flatnonzero((rng.random(400) >= loss) | (np.arange(400) % depth == 0))
    sums = []
    for k in range(400):
        if k in kept:
            line.hear(k, U[k].tolist())
        sums.append(line.advance())
    c = np.diff(np.array(sums)[1:], axis=0) / T
    assert np.sum(c**2) <= np.sum(a**2) * (1.0 + 1e-9)


def test_what_is_owed_is_what_waits() -> None:
    """The cost of the straight ways beyond nu; nothing once all is played."""
    line = PlayOut(T, T, 10.0)
    for n in range(0, 21, 2):
        line.hear(n, [SLOPE * T * n])
        line.advance()
        line.advance()
    assert line.owed == pytest.approx(10 * 0.5 * T * SLOPE**2, rel=0.3)
    for _ in range(40):
        line.advance()
    assert line.owed == 0.0


def test_a_line_is_starved_after_30_ms_and_runs_on() -> None:
    """So it is at the right place when messages come again, without a jump."""
    line = PlayOut(T, T, 2.0)
    assert line.starved
    for n in range(100):
        line.hear(n, [SLOPE * T * n])
        line.advance()
        assert not line.starved
    silent = [(line.advance()[0], line.starved) for _ in range(500)]
    assert [starved for _, starved in silent].index(True) == pytest.approx(HOLD_AFTER / T + 2, abs=1)
    assert silent[20][0] == pytest.approx(SLOPE * T * (97 + 21), rel=1e-3)  # the last slope
    assert silent[-1][0] == pytest.approx(SLOPE * T * (99 + 30), rel=1e-3)  # and no further
    line.hear(600, [SLOPE * T * 600])
    assert line.advance()[0] == pytest.approx(SLOPE * T * 598, rel=1e-3)
    assert not line.starved
    assert not line.jumped


@pytest.mark.parametrize("n", [105, 5000])
def test_a_sender_or_a_receiver_that_paused_is_followed_by_a_jump(n: int) -> None:
    """A sender that stood still is behind the time line, and a receiver that stood still is behind the sender."""
    line = PlayOut(T, T, 2.0)
    for k in range(100):
        line.hear(k, [SLOPE * T * k])
        line.advance()
    for _ in range(200):
        line.advance()
    line.hear(n, [SLOPE * T * n])
    line.advance()
    assert line.jumped
    assert line.lag() == pytest.approx(2.0)


def test_the_measured_depth_covers_the_latest_message() -> None:
    """Every tenth message is 7 ticks late, the others in time: the mean depth has to exceed the tail over the mean."""
    line = PlayOut(T, T, 2.0)
    line.hear(0, [0.0])
    line.measure()
    for k in range(1, 1001):
        if k % 10:
            line.hear(k, [0.0])
        line.advance()
    assert line.measured() == pytest.approx(1.0 - 0.1 + 1.0)
