"""What is felt of a wave link follows from the figures of its two ends, and from nothing less."""

from __future__ import annotations

import math

import pytest

from manyhands.nodes.rows import figures as names
from manyhands.nodes.wave_link.felt import FeltLink, felt_link
from manyhands.protocol.messages import Figures
from manyhands.protocol.plain import read

USER = {
    names.WAVE_LAG: 5000.0,
    names.WAVE_TANK: 5e-3,
    names.WAVE_CLIPPED: 2.0,
    names.WAVE_SILENCES: 0.0,
    names.WAVE_HOLDING: 0.0,
}
WORLD = USER | {names.WAVE_LAG: 1000.0, names.WAVE_TANK: 4e-3}


def felt(user: dict[str, float] = USER, world: dict[str, float] = WORLD) -> FeltLink | None:
    of_world = {names.of(name): {"cx": value} for name, value in world.items()}
    return felt_link("cx", (20.0, 60.0), Figures(user), Figures({}, of_world))


@pytest.mark.parametrize("offset", [0.0, 3.6e9])
def test_the_round_trip_is_the_sum_of_both_lags_whenever_their_counts_began(offset: float) -> None:
    found = felt(USER | {names.WAVE_LAG: 5000.0 - offset}, WORLD | {names.WAVE_LAG: 1000.0 + offset})
    assert found is not None
    assert found.round_trip == pytest.approx(6e-3)


def test_it_has_the_figures_of_both_ends() -> None:
    found = felt()
    assert found is not None
    assert found.round_trip == pytest.approx(6e-3)
    assert found.stiffness == pytest.approx(2.0 * 20.0 / 6e-3)
    assert found.mass == pytest.approx(0.5 * 60.0 * 6e-3)
    assert (found.tanks, found.limited, found.silences, found.holding) == ((5e-3, 4e-3), 4, 0, False)
    assert read(FeltLink, found.as_plain()) == found


def test_the_sentence_names_what_a_user_wants_to_know() -> None:
    found, silent = felt(), felt(USER | {names.WAVE_SILENCES: 1.0, names.WAVE_HOLDING: 1.0})
    assert found is not None
    assert found.sentence("cx") == (
        "wave link of cx: a round trip of 6 ms is felt as 6667 N/m in series with the coupling, and as 180 g; 5 and 4 "
        "mJ in its tanks; waves limited by a tank in 4 ticks"
    )
    assert silent is not None
    assert silent.sentence("cx").endswith("; silent 1 time; an end hears nothing now, and holds the tool")
    assert silent.sentence("cx", over=True).endswith("; silent 1 time")


@pytest.mark.parametrize("name", USER)
@pytest.mark.parametrize("value", [None, math.nan, -1e4, math.inf])
def test_without_sensible_figures_of_both_ends_nothing_is_claimed(name: str, value: float | None) -> None:
    for end in (USER, WORLD):
        changed = {other: old for other, old in end.items() if other != name}
        changed |= {} if value is None else {name: value}
        assert (felt(user=changed) if end is USER else felt(world=changed)) is None
