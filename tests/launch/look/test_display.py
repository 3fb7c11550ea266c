"""Tables and sentences on a terminal of any width: no heading is cut, and no sentence within a word."""

from __future__ import annotations

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from manyhands.launch.look.display import COLUMNS, figure_table, heading, ranks, say
from manyhands.launch.look.live import LiveTable, late_line
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.states import SessionPhase
from manyhands.protocol.messages import Figures, PromiseStatus, Telemetry

from ...support.observed_frames import ABOUT

TITLES = ("node", "role", "tick", "rate\n[Hz]", *(heading(column.title) for _, column in COLUMNS))
cells = st.text(st.characters(categories=["L", "N"], max_codepoint=255), max_size=12)


def shown(width: int, rows: list[list[str]]) -> tuple[str, list[str]]:
    out = io.StringIO()
    table, left_out = figure_table("t", TITLES, rows, ranks(), width)
    Console(file=out, width=width, force_terminal=True, color_system=None).print(table)
    return out.getvalue(), left_out


@given(st.integers(80, 250), st.lists(st.lists(cells, min_size=len(TITLES), max_size=len(TITLES)), max_size=3))
def test_what_is_shown_is_whole_and_the_rest_is_named(width: int, rows: list[list[str]]) -> None:
    text, left_out = shown(width, rows)
    kept = [place for place, title in enumerate(TITLES) if title not in left_out]
    assert max(map(len, text.splitlines())) <= width
    for word in " ".join(TITLES[place] for place in kept).split():
        assert word in text
    for row in rows:
        assert all(row[place] in text for place in kept)
    assert [ranks()[name] for name in left_out] == sorted((ranks()[name] for name in left_out), reverse=True)


def test_a_usual_session_has_its_most_important_figures_in_80_columns() -> None:
    row = ["environment", "environment", "123456", "1000", "12345", "1234", "1234", "100/100", "0", "0",
           "-1.23e-02", "50.00", *["-1.23e-02"] * 3, "9", "2"]  # fmt: skip
    _, left_out = shown(80, [row])
    assert not {"node", "tick", "rate\n[Hz]", "late", "τ p50\n[µs]", "τ p99\n[µs]", "frozen"} & set(left_out)
    _, wide = shown(200, [row])
    assert wide == []


@pytest.mark.parametrize(("terminal", "lines"), [(True, 3), (False, 1)])
def test_a_terminal_breaks_a_sentence_between_words(terminal: bool, lines: int) -> None:
    out = io.StringIO()
    sentence = "notice: the delay of dx was above the certified one in 12 % of its ticks; choose a longer period than T"
    say(Console(file=out, width=40, force_terminal=terminal, color_system=None), sentence)
    found = out.getvalue().splitlines()
    assert len(found) == lines
    assert " ".join(line.strip() for line in found) == sentence


@pytest.mark.parametrize(
    ("late", "said"),
    [
        ({"dx": 0, "dy": 0}, "none late"),
        ({"dx": 30, "dy": 1200}, "late ticks: dy 60.0%, dx 1.5%"),
        ({f"d{i}": i for i in range(1, 8)}, "late ticks: d7 0.4%, d6 0.3%, d5 0.2%, d4 0.2% and 3 more"),
    ],
)
def test_late_ticks_are_each_devices_own(late: dict[str, int], said: str) -> None:
    telemetry = {name: Telemetry(2000, Figures({"late": float(ticks)}), {}) for name, ticks in late.items()}
    assert late_line(telemetry | {"cx": Telemetry(2000, Figures({"speed": 1.0}), {})}) == said


def test_a_line_says_once_that_a_hand_lacks_its_force_though_its_figures_change() -> None:
    out = io.StringIO()
    table = LiveTable(Console(file=out, width=200), "s", ABOUT)
    for n in range(3):
        row = PromiseStatus("force given", "broken", ("dx",), 1.0, remark=f"dx was given {n} %")
        table(Progress(SessionPhase.RUNNING, {}, {}, {}, 0.1 * n, (), {}, promises=(row,)))
    assert [line for line in out.getvalue().splitlines() if "given" in line] == ["! dx was given 0 %"]


def test_who_comes_and_goes_is_said_once_and_warns_of_nothing() -> None:
    out = io.StringIO()
    table = LiveTable(Console(file=out, width=200), "s", ABOUT)
    for visits in (("dx has joined",), ("dx has joined", "dx left after 5 ticks")):
        table(Progress(SessionPhase.RUNNING, {}, {}, {}, 0.1, (), {}, incidents=("dy is back",), visits=visits))
    said = out.getvalue().splitlines()
    assert said == ["s: running", "dx has joined", "! dy is back", "dx left after 5 ticks"]
