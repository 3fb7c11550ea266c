"""Who is named for a cut force and for late ticks: by the environment's account, whatever the parties say."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.monitor.causes import BEFORE, KEPT, Causes
from manyhands.nodes.monitor.health import cut_forces, missed, sentence, verdict
from manyhands.nodes.monitor.health_model import HealthModel, Terms
from manyhands.protocol.messages import Figures, PromiseStatus, Role

from ...support.figures import as_figures, drawn_figures

ROLES = {"dx": Role.DEVICE, "dy": Role.DEVICE, "cx": Role.COUPLING, "cy": Role.COUPLING, "world": Role.ENVIRONMENT}
TERMS = Terms(1e-3, ROLES, realtime=True, wall=("dx", "dy"), certified=True, couplings={"dx": ("cx",), "dy": ("cy",)})


def told(*messages: tuple[float, Mapping[str, float]]) -> Causes:
    found = Causes()
    for at, figures in messages:
        found.take(at, as_figures(figures))
    return found


def rows(*messages: tuple[str, int, Mapping[str, float]]) -> list[PromiseStatus]:
    found = HealthModel(TERMS)
    for node, tick, figures in messages:
        found.take(node, tick, as_figures(figures))
    found.conclude()
    return missed(found.rows())


def test_the_mover_is_the_one_whose_energy_came_in_that_stretch() -> None:
    before, after = Figures({}, {"moved": {"a/c": 9.0}}), Figures({}, {"moved": {"a/c": 9.5, "b/c": 2.0}})
    found = told((5.0, before), (6.0, before), (6.9, before), (7.0, after))
    mover = found.mover(("c",), 6.95, 7.0)
    assert mover is not None
    assert (mover.party, mover.energy, mover.total, mover.beyond) == ("b", 2.0, 2.5, False)
    before = found.mover(("c",), 5.0, 6.0)
    assert before is not None
    assert before.party == "a"


def test_one_that_was_held_to_its_budget_comes_first() -> None:
    mover = told((1.0, Figures({}, {"moved": {"a/c": 1.0, "b/c": 3.0}, "scaled": {"a": 7.0}}))).mover(("c",), 0.9, 1.0)
    assert mover is not None
    assert (mover.party, mover.beyond) == ("a", True)


@pytest.mark.parametrize("own", ["supplied", "given"])
def test_who_puts_in_more_of_its_own_moves_itself(own: str) -> None:
    assert told((1.0, Figures({}, {"moved": {"a/c": 1.0}, own: {"c": 1.5}}))).mover(("c",), 0.9, 1.0) is None
    assert told((1.0, Figures({}, {"moved": {"a/c": 1.0}, own: {"c": 0.5}}))).mover(("c",), 0.9, 1.0) is not None
    assert told((1.0, Figures({}, {"moved": {"c/a": 1.0}}))).mover(("c",), 0.9, 1.0) is None


def test_of_many_parties_only_what_each_gave_in_all_is_known() -> None:
    mover = told((1.0, Figures({}, {"given": {"a": 5.0, "b": 1.0}, "received": {"c": 2.0}}))).mover(("c",), 0.9, 1.0)
    assert mover is not None
    assert (mover.party, mover.energy) == ("a", 2.0)


def test_a_new_environment_counts_from_0() -> None:
    found = told((5.0, Figures({}, {"moved": {"a/c": 9.0}})), (0.1, Figures({}, {"moved": {"b/c": 1.0}})))
    mover = found.mover(("c",), 0.0, 0.1)
    assert mover is not None
    assert (mover.party, found.until) == ("b", 0.1)


ANY = drawn_figures(
    ["x"],
    {
        "moved": ["a/c", "/"],
        **{name: ["a", "c"] for name in ("given", "received", "supplied", "scaled", "waited_ticks")},
    },
    st.floats(),
)


@given(st.lists(st.tuples(st.floats(), ANY)), st.floats(), st.floats())
def test_no_figures_are_an_error(messages: list[tuple[float, Figures]], since: float, until: float) -> None:
    found = told(*messages)
    mover = found.mover(("c",), since, until)
    assert mover is None or mover.energy > 0.0
    assert all(ticks > 0.0 for ticks in found.waited_for(("c",), since, until).values())
    assert len(found._rows) <= KEPT


def test_the_moved_is_not_named_and_the_mover_beyond_its_budget_is() -> None:
    """The honest seat was named, and its limits were to be raised."""
    told_by_world = Figures({}, {"moved": {"cy/cx": 14.8}, "scaled": {"cy": 30.0}, "given": {"cy": 14.8}})
    found = rows(("cx", 100, {"saturated": 7.0}), ("world", 100, told_by_world))
    [force] = [row for row in found if row.promise == "force limits"]
    assert (force.who, force.cost) == (("cy",), {"ticks": 7.0})
    assert force.remark == "another party moved it: cy put 14.8 J into cx, whose force was cut"
    last = verdict(found)
    assert last.startswith("worst: force limits: broken by cy since 0.1 s (7 ticks); another party moved it")
    assert "Raise the limits" not in last
    assert "cy put 14.8 J into cx" in cut_forces([force])


def test_a_mover_within_its_budget_has_broken_nothing_and_the_moved_neither() -> None:
    found = rows(("dx", 100, {"clipped": 7.0}), ("world", 100, Figures({}, {"moved": {"cy/cx": 1.0}})))
    assert [row.who for row in found] == [("session",)]
    assert sentence(found[0]) == "force limits: broken since 0.1 s (7 ticks)"
    assert "; another party moved it: cy put 1 J into dx" in verdict(found)


def test_who_pushes_itself_beyond_its_force_is_named_with_the_advice_for_it() -> None:
    found = rows(
        ("dx", 100, {"clipped": 7.0}), ("world", 100, Figures({}, {"moved": {"cy/cx": 1e-4}, "supplied": {"cx": 0.5}}))
    )
    assert [row.who for row in found] == [("dx",)]
    assert "Raise the limits of force" in verdict(found)


def test_a_count_waits_for_the_environments_account_of_its_ticks() -> None:
    found = HealthModel(TERMS)
    found.take("world", 100, Figures({}, {"supplied": {"cx": 0.1}}))
    found.take("dx", 200, Figures({"clipped": 7.0}))
    assert missed(found.rows()) == []
    found.take("world", 200, Figures({}, {"supplied": {"cx": 0.1}, "moved": {"cy/cx": 3.0}, "scaled": {"cy": 1.0}}))
    assert {row.who for row in missed(found.rows()) if row.promise == "force limits"} == {("cy",)}


def test_without_the_environments_account_nobody_is_named() -> None:
    found = rows(("world", 100, {}), ("dx", 5000, {}), ("dx", 9000, {"clipped": 7.0}))
    assert [(row.who, row.remark) for row in found] == [
        (("session",), "the environment has not reported who moved dx, whose force was cut to its limit")
    ]


def test_late_ticks_are_those_of_the_coupling_that_was_waited_for() -> None:
    late = Figures({}, {"waited_ticks": {"cy": 12.0}, "waited_us": {"cy": 9000.0}})
    found = rows(("dx", 100, {"tau_breaches": 14.0}), ("dy", 100, {"tau_breaches": 5.0}), ("world", 100, late))
    by = {row.who: row.cost["ticks"] for row in found if row.promise == "delay"}
    assert by == {("cy",): 14.0, ("dy",): 5.0}  # its own coupling's ticks are no excuse for dy


def test_more_late_ticks_than_anybody_was_waited_for_are_its_own() -> None:
    found = rows(
        ("dx", 100, {"tau_breaches": 14.0}),
        ("world", 100, Figures({}, {"waited_ticks": {"cy": 3.0}, "waited_us": {"cy": 9.0}})),
    )
    by = {row.who: row.cost["ticks"] for row in found if row.promise == "delay"}
    assert by == {("cy",): 4.0, ("dx",): 10.0}


def test_who_only_passes_energy_on_is_not_said_to_be_beyond_its_budget() -> None:
    figures = Figures(
        {},
        {
            "moved": {"cy/cx": 1.6e7},
            "supplied": {"cx": 0.02},
            "scaled": {"cx": 230.0},
            "stops": {"cx": 1.0},
            "given": {"cx": 0.02},
        },
    )
    [row] = [row for row in rows(("world", 100, figures)) if row.promise == "energy budget"]
    assert row.remark == "cx passed on energy that cy had put into it"


def test_the_stretch_goes_back_a_while() -> None:
    figures = Figures({}, {"moved": {"cy/cx": 1.0}})
    ends = round(1e3 * BEFORE)
    first = ("world", 100, {}), ("world", 200, figures), ("dx", 100 + ends, {})
    assert [row.who for row in rows(*first, ("dx", 101 + ends, {"clipped": 1.0}), ("world", 101 + ends, figures))] == [
        ("session",)
    ]
