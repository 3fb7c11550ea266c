"""The network under the simulated clock: what comes, and when."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.kernel.simulated_way import SimulatedWay, WavesUnderWay

T = 1e-3


def ticks_of_arrival(way: SimulatedWay, waves: int = 400) -> dict[int, int]:
    """By wave the tick in which it comes, where one leaves in every tick."""
    under_way, found = WavesUnderWay(way, T), dict[int, int]()
    for tick in range(1, waves + 1000):
        if tick <= waves:
            under_way.send((tick, [0.0], 0.0))
        for wave in under_way.arrived(tick * T):
            assert wave[0] not in found
            found[wave[0]] = tick
    return found


def test_without_a_delay_a_wave_arrives_in_its_tick() -> None:
    assert all(tick == wave for wave, tick in ticks_of_arrival(SimulatedWay()).items())


@given(st.floats(0.0, 0.2), st.floats(0.0, 0.05), st.integers(0, 1 << 20))
def test_a_wave_is_under_way_for_its_delay_and_at_most_the_jitter_more(delay: float, jitter: float, seed: int) -> None:
    """A time that is no whole number of ticks ends within the next one; 1 ns for the rounding of products."""
    found = ticks_of_arrival(SimulatedWay(delay, jitter, seed=seed), 60)
    assert len(found) == 60
    least, most = math.ceil((delay - 1e-9) / T - 1e-9), math.ceil((delay + jitter) / T + 1e-6)
    assert all(least <= tick - wave <= most for wave, tick in found.items())


def test_the_stated_part_is_lost_and_the_same_at_every_run() -> None:
    way = SimulatedWay(0.01, 0.02, 0.1, seed=7)
    found = ticks_of_arrival(way)
    assert 400 * 0.04 < 400 - len(found) < 400 * 0.16  # four deviations of a binomial: 24 of 400
    assert found == ticks_of_arrival(way)
    assert found != ticks_of_arrival(SimulatedWay(0.01, 0.02, 0.1, seed=8))
    assert any(found[wave] > found[wave + 1] for wave in found if wave + 1 in found)  # some overtake


@pytest.mark.parametrize(
    "of", [{"delay": -1.0}, {"delay": math.inf}, {"jitter": math.nan}, {"loss": 1.0}, {"loss": -0.1}]
)
def test_networks_that_are_none_are_refused(of: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="expected finite times"):
        SimulatedWay(**of)
