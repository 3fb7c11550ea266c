"""The rows of a session's health as people read them: condensed, with units, the gravest kept."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest

from manyhands.nodes.monitor.health import (
    PROMISES,
    Health,
    cells,
    condensed,
    cost_text,
    holds,
    missed,
    most_grave,
    readable,
    sentence,
    session_health,
    summary,
    verdict,
)
from manyhands.protocol.limits import MAX_SENTENCES
from manyhands.protocol.messages import PromiseStatus


def test_people_read_one_row_where_many_parties_are_alike() -> None:
    rows = [PromiseStatus("motion limits", "kept"), PromiseStatus("force limits", "kept")]
    rows += [PromiseStatus("motion limits", "enforced", (f"d{i}",), 0.1, None, {"times": 1.0}) for i in range(5)]
    rows += [PromiseStatus("force limits", "broken", ("dx",), 0.1, None, {"ticks": 2.0})]
    found = condensed(rows)
    assert [(row.who, row.cost) for row in found if row.promise == "motion limits"] == [
        (("d0", "d1", "d2", "d3", "d4"), {"times": 5.0})
    ]
    assert [row.who for row in found if row.promise == "force limits"] == [("dx",)]  # and no row for all others
    assert (
        sentence(missed(found)[-1])
        == "motion limits: enforced at d0, d1, d2, d3 and 1 more since 0.1 s (5 times in all)"
    )


@pytest.mark.parametrize(
    ("cost", "text"),
    [
        ({}, ""),
        ({"ticks": 1.0, "J": 8e-4}, "1 tick, 0.8 mJ"),
        ({"ticks": 4 / 3}, "1 tick"),  # a third of a tick may be another party's
        ({"J": 2.5, "s": 0.117, "times": 2.0}, "2.5 J, 0.117 s, 2 times"),
        ({"x": 0.25, "N": 3.0, "ticks": math.nan}, "0.25 of real time, 3 N"),
    ],
)
def test_costs_have_units(cost: Mapping[str, float], text: str) -> None:
    assert cost_text(cost) == text


def test_of_too_many_rows_the_gravest_are_kept_and_every_promise() -> None:
    rows = [PromiseStatus("delay", "enforced", (f"d{i}",)) for i in range(500)]
    rows += [PromiseStatus("passivity", "broken", ("cx",)), *(PromiseStatus(one.value, "kept") for one in PROMISES)]
    kept = most_grave(rows)
    assert len(kept) == MAX_SENTENCES
    assert {row.promise for row in kept} == {one.value for one in PROMISES}
    assert ("passivity", "broken") in {(row.promise, row.state) for row in kept}


def test_rows_of_another_version_are_left_out() -> None:
    known = PromiseStatus("delay", "kept")
    assert readable((known, PromiseStatus("courage", "kept"), PromiseStatus("delay", "doubtful"))) == (known,)


def row(promise: str, state: str, who: str, **cost: float) -> PromiseStatus:
    return PromiseStatus(promise, state, (who,), 0.2, None, cost)


FASTER = (
    "manyhands doctor, with the session's file, measures what would help on this machine: other periods, or where "
    "couplings run."
)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([PromiseStatus("pace", "kept")], "all promises kept"),
        ([row("presence", "enforced", "cx"), row("motion limits", "enforced", "dx")],
         "all promises kept, or enforced: presence (cx), motion limits (dx)"),
        ([row("pace", "broken", "session", x=0.6, s=2.0)],
         "worst: pace: broken by session since 0.2 s (0.60 of real time, 2 s). " + FASTER),
        ([row("pace", "broken", "session", x=0.6), row("period", "broken", "dy", ticks=900.0),
          row("delay", "broken", "dx", ticks=5.0), row("delay", "broken", "dz", ticks=7.0),
          row("lateness energy", "enforced", "dx", ticks=9.0)],
         "worst: delay: broken by dz since 0.2 s (7 ticks), and by dx. " + FASTER + " Also broken: period, pace."),
    ],
)  # fmt: skip
def test_a_run_ends_with_the_worst_by_whom_how_much_and_what_to_do(rows: list[PromiseStatus], said: str) -> None:
    assert verdict([PromiseStatus("passivity", "kept"), *rows]) == said


def test_what_is_not_judged_is_said_and_is_neither_kept_nor_broken() -> None:
    unjudged = PromiseStatus("passivity", "not judged", ("d",), 0.0, None, {"J": 7.3}, "its work is its own")
    rows = [unjudged, PromiseStatus("passivity", "kept", since=0.0)]
    assert verdict(rows) == "all promises kept; not judged: passivity (d)"
    assert (holds(rows), session_health(rows), summary(rows)) == (True, Health.OK, "")
    assert condensed(rows) == rows  # the others keep it
    assert sentence(unjudged) == "passivity: not judged: its work is its own"
    assert cells(unjudged) == ("passivity", "not judged", "d", "", "7.3 J")
