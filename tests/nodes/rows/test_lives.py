"""The figures of a node that came back are those of all its processes, as each figure's declaration has it."""

from __future__ import annotations

import math

import pytest

from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.figures import FIGURES, OverLives
from manyhands.nodes.rows.lives import Lives, together
from manyhands.protocol.messages import Figures


def lives(*processes: Figures) -> Figures:
    found = Lives()
    for figures in processes:
        found.forget("dx")
        found.take("dx", figures)
    return found.of("dx")


@pytest.mark.parametrize(
    "figure", [figure for figure in FIGURES.values() if not figure.beside], ids=lambda one: one.name
)
def test_every_figure_is_joined_as_it_is_declared(figure: names.Figure) -> None:
    expected = {OverLives.SUM: 6.0, OverLives.GREATEST: 3.0, OverLives.LEAST: 1.0, OverLives.LATEST: 2.0}
    values = (1.0, 3.0, 2.0)
    if figure.key is None:
        found = lives(*(Figures({figure.name: value}) for value in values))[figure.name]
    else:
        found = lives(*(Figures({}, {figure.name: {"cx": value}}) for value in values)).table(figure.name)["cx"]
    assert found == expected[figure.over_lives]


def test_what_is_called_the_greatest_or_the_least_of_a_run_is_never_a_sum() -> None:
    """Nor is it that of the latest process, unless it is about its latest moments alone."""
    for figure in FIGURES.values():
        extreme = figure.says.startswith(("the greatest", "the least ")) or "the most in" in figure.says
        if extreme and "since the last telemetry" not in figure.says and "of the last rows" not in figure.says:
            assert figure.over_lives in (OverLives.GREATEST, OverLives.LEAST), figure.name


def test_the_tick_of_the_least_ledger_is_of_the_process_that_had_it() -> None:
    def told(least: float, tick: float, final: float) -> Figures:
        return Figures({names.LEDGER_MIN: least, names.LEDGER_MIN_TICK: tick, names.LEDGER: final})

    assert dict(lives(told(-1.0, 7.0, 2.0), told(-0.5, 3.0, 1.0))) == dict(told(-1.0, 7.0, 1.0))
    assert dict(lives(told(-0.5, 3.0, 1.0), told(-1.0, 7.0, 2.0))) == dict(told(-1.0, 7.0, 2.0))


def test_what_a_process_did_not_tell_of_is_that_of_the_others() -> None:
    before, after = Figures({names.LATE: 3.0, names.PEAK_FORCE: 2.0}), Figures({names.LATE: 1.0, names.RUNG: 1.0})
    assert dict(together(before, after)) == {names.LATE: 4.0, names.PEAK_FORCE: 2.0, names.RUNG: 1.0}
    assert dict(together(Figures({names.RUNG: 2.0, "began@7": 1.0}), Figures())) == {}
    driver = Figures({}, {names.DRIVER: {"missing": 3.0}, names.LATE_CAUSE: {"own": 2.0}})
    found = together(driver, Figures({}, {names.LATE_CAUSE: {"own": 1.0, "partner": 4.0}}))
    assert found.tables == {names.LATE_CAUSE: {"own": 3.0, "partner": 4.0}}


def test_numbers_that_make_no_sense_hide_no_others() -> None:
    broken = Figures({names.LATE: math.nan, names.PEAK_FORCE: math.inf, names.LEDGER_MIN: -math.inf})
    sound = Figures({names.LATE: 3.0, names.PEAK_FORCE: 2.0, names.LEDGER_MIN: -1.0})
    for processes in ((broken, sound), (sound, broken)):
        assert dict(lives(*processes)) == dict(sound)


def test_a_node_of_which_nothing_is_known_has_no_figures() -> None:
    assert lives() == Figures()
    alone = Figures({names.LATE: math.nan})
    assert lives(alone) is alone  # of one process everything stays as it was told
