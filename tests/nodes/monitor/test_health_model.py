"""The model of health: telemetry and events go in, and each promise's state, party, time and cost come out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.device.specification import DeviceSpecification
from manyhands.nodes.kernel.driver_statement import IMPOSED, DriverWord
from manyhands.nodes.monitor.given import MEASURE
from manyhands.nodes.monitor.health import (
    Health,
    PromiseState,
    grouped,
    holds,
    is_present,
    missed,
    sentence,
    session_health,
    summary,
)
from manyhands.nodes.monitor.health_model import HOLD, PACE_SILENCE, HealthModel, Terms
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_BY_ITSELF, MAX_CONTROL_BYTES, MAX_SENTENCE
from manyhands.protocol.messages import Condition, Figures, PromiseStatus, Role

from ...support.figures import as_figures, drawn_figures

T = 1e-3
ROLES = {"dx": Role.DEVICE, "dy": Role.DEVICE, "cx": Role.COUPLING, "cy": Role.COUPLING, "world": Role.ENVIRONMENT}
TERMS = Terms(T, ROLES, realtime=True, wall=("dx", "dy"), certified=True, tank=0.005, bounded=True)
COUNTED = replace(TERMS, bounded=False)
OWN_TIME = replace(TERMS, wall=())
UNCERTIFIED = replace(TERMS, certified=False, tank=0.0, bounded=False)
SIMULATED = replace(TERMS, realtime=False, wall=())
SEATED = replace(TERMS, linked=("cx",), seats={"cx": "dx"})
RUNNING = dict.fromkeys(ROLES, "running")

Told = tuple[str, int, Mapping[str, float]]


def model(terms: Terms, *told: Told) -> HealthModel:
    found = HealthModel(terms)
    for node, tick, figures in told:
        found.take(node, tick, as_figures(figures))
    found.conclude()
    return found


def only(found: HealthModel) -> PromiseStatus:
    [row] = missed(found.rows())
    return row


def test_a_session_that_is_well_keeps_all_its_promises() -> None:
    quiet = {"tau_breaches": 0.0, "ledger_margin": 0.0, "interface_min": 0.0, "interface_ticks": 0.0, "clipped": 0.0}
    rows = model(TERMS, ("dx", 100, quiet), ("world", 100, {"frozen": 0.0, "began@0": 1.0})).rows()
    assert {row.state for row in rows} == {"kept"}
    assert [row.promise for row in rows] == [
        "passivity", "delay", "period", "lateness energy", "stated inertia", "force limits", "force given",
        "motion limits", "presence", "punctuality",
        "pace",
    ]  # fmt: skip
    assert (session_health(rows), holds(rows), summary(rows)) == (Health.OK, True, "")


@pytest.mark.parametrize(
    ("terms", "promises"),
    [
        (UNCERTIFIED, {"force limits", "force given", "motion limits", "presence", "punctuality", "pace"}),
        (SIMULATED, {"passivity", "force limits", "motion limits", "presence"}),
        (OWN_TIME,
         {"passivity", "delay", "period", "force limits", "motion limits", "presence", "punctuality", "pace"}),
        (replace(SIMULATED, enforced=("environment",), linked=("cx",)),
         {"passivity", "force limits", "declared level", "wave link", "motion limits", "presence"}),
    ],
)  # fmt: skip
def test_a_session_promises_what_its_kind_can(terms: Terms, promises: set[str]) -> None:
    assert {row.promise for row in model(terms).rows()} == promises


ENFORCED, BROKEN, KEPT = PromiseState.ENFORCED, PromiseState.BROKEN, PromiseState.KEPT


@pytest.mark.parametrize(
    ("terms", "node", "figures", "promise", "state", "who", "cost"),
    [
        (TERMS, "dx", {"tau_breaches": 14.0}, Promise.DELAY, ENFORCED, "dx", {"ticks": 14.0}),
        (COUNTED, "dx", {"tau_breaches": 14.0}, Promise.DELAY, BROKEN, "dx", {"ticks": 14.0}),
        (OWN_TIME, "dx", {"tau_breaches": 14.0}, Promise.DELAY, BROKEN, "dx", {"ticks": 14.0}),
        (TERMS, "dy", {"period_breaches": 3.0}, Promise.PERIOD, ENFORCED, "dy", {"ticks": 3.0}),
        (COUNTED, "dy", {"period_breaches": 3.0}, Promise.PERIOD, BROKEN, "dy", {"ticks": 3.0}),
        (TERMS, "dx", {"interface_ticks": 2.0, "interface_min": -0.004}, Promise.LATENESS, ENFORCED, "dx",
         {"ticks": 2.0, "J": 0.004}),
        (TERMS, "dx", {"interface_min": -0.25}, Promise.LATENESS, BROKEN, "dx", {"J": 0.25}),
        (COUNTED, "dx", {"interface_min": -0.25}, Promise.LATENESS, BROKEN, "dx", {"J": 0.25}),
        (TERMS, "cx", {"ledger_margin": -0.25}, Promise.PASSIVITY, BROKEN, "cx", {"J": 0.25}),
        (TERMS, "dx", {"clipped": 7.0}, Promise.FORCE, BROKEN, "dx", {"ticks": 7.0}),
        (UNCERTIFIED, "dx", {"clipped": 7.0}, Promise.FORCE, ENFORCED, "dx", {"ticks": 7.0}),
        (TERMS, "cx", {"saturated": 7.0}, Promise.FORCE, BROKEN, "cx", {"ticks": 7.0}),
        (TERMS, "dx", {"let_go": 1.0}, Promise.MOTION, ENFORCED, "dx", {"times": 1.0}),
        (replace(TERMS, enforced=("world",)), "world", {"enforced_ticks": 9.0, "enforced_energy": 0.5}, Promise.LEVEL,
         ENFORCED, "world", {"ticks": 9.0, "J": 0.5}),
        (TERMS, "world", Figures({}, {"scaled": {"cx": 12.0}, "given": {"cx": 0.02}}), Promise.BUDGET, ENFORCED, "cx",
         {"ticks": 12.0, "J": 0.02}),
        (TERMS, "world", {"frozen:cy@95": 1.0}, Promise.PRESENCE, ENFORCED, "cy", {"times": 1.0, "s": 0.005}),
        (TERMS, "world",
         Figures({}, {"waited_ticks": {"cx": 53.0}, "waited_us": {"cx": 117e3}, "frozen_late": {"cx": 2.0}}),
         Promise.PUNCTUALITY, ENFORCED, "cx", {"ticks": 53.0, "s": 0.117, "times": 2.0}),
        (SEATED, "cx", {"wave_clipped": 4.0}, Promise.LINK, ENFORCED, "cx", {"ticks": 4.0}),
        (SEATED, "world", Figures({}, {"wave_silences_of": {"cx": 1.0}, "wave_holding_of": {"cx": 1.0}}),
         Promise.LINK, ENFORCED, "cx", {"times": 1.0}),
    ],
)  # fmt: skip
def test_what_a_figure_says_of_a_promise(
    terms: Terms,
    node: str,
    figures: Mapping[str, float],
    promise: Promise,
    state: PromiseState,
    who: str,
    cost: Mapping[str, float],
) -> None:
    found = model(terms, (node, 100, figures))
    row = only(found)
    since = 0.095 if promise is Promise.PRESENCE else 0.1
    assert (row.promise, row.state, row.who, row.since, row.until) == (promise, state, (who,), since, None)
    assert row.cost == pytest.approx(cost)
    broken = state is BROKEN
    assert holds(found.rows()) == (not broken)
    expected = Health.BROKEN if broken else Health.FROZEN if promise is Promise.PRESENCE else Health.ENFORCED
    assert session_health(found.rows()) is expected
    [kept] = [row for row in found.rows() if row.promise == promise and row.state == KEPT] or [row]
    assert kept.who in ((), (who,))  # all others keep it
    assert who in sentence(row)
    assert f"{promise} {state} ({who})" in summary(found.rows())


@pytest.mark.parametrize(
    ("terms", "node", "figures"),
    [
        (UNCERTIFIED, "dx", {"tau_breaches": 9.0, "ledger_margin": -1.0, "interface_min": -1.0}),
        (SIMULATED, "dx", {"tau_breaches": 9.0}),
        (TERMS, "dx", {"interface_min": -0.005 - 1e-12}),  # rounding
        (TERMS, "cx", {"ledger_margin": -1e-10}),
        (TERMS, "stranger", {"clipped": 9.0}),
        (
            TERMS,
            "world",
            Figures({"frozen:stranger@50": 1.0}, {"scaled": {"stranger": 3.0}, "waited_ticks": {"stranger": 3.0}}),
        ),
        (
            TERMS,
            "world",
            Figures({}, {"waited_ticks": {"cx": 3.0}, "waited_us": {"cx": 900.0}, "frozen_late": {"cx": 0.0}}),
        ),  # now and then
        *[(TERMS, "dx", {"clipped": bad, "let_go": bad}) for bad in (math.nan,)],
        *[(TERMS, "dx", {"clipped": bad, "let_go": bad}) for bad in (math.inf, -3.0)],
    ],
)
def test_what_was_not_promised_or_makes_no_sense_changes_nothing(
    terms: Terms, node: str, figures: Mapping[str, float]
) -> None:
    assert missed(model(terms, (node, 100, figures)).rows()) == []


def test_a_frozen_coupling_comes_back_and_what_it_missed_stays() -> None:
    found = model(TERMS, ("world", 200, {"frozen:cx@150": 1.0}), ("world", 500, {"returned:cx@420": 1.0}))
    row = only(found)
    assert (row.since, row.until) == (0.15, 0.42)
    assert row.cost == pytest.approx({"times": 1.0, "s": 0.27})
    assert session_health(found.rows()) is Health.OK
    found.take("world", 900, Figures({"frozen:cx@850": 1.0}))
    row = only(found)
    assert (row.since, row.until) == (0.85, None)
    assert row.cost == pytest.approx({"times": 2.0, "s": 0.27 + 0.05})
    assert session_health(found.rows()) is Health.FROZEN


def test_what_is_enforced_is_over_when_its_cost_stays_the_same() -> None:
    found = model(TERMS, ("dx", 100, {"tau_breaches": 3.0}), ("dx", 200, {"tau_breaches": 5.0}))
    rest = round(HOLD / T)
    found.take("dx", 200 + rest, Figures({"tau_breaches": 5.0}))
    assert only(found).until is None
    found.take("dx", 300 + rest, Figures({"tau_breaches": 5.0}))
    row = only(found)
    assert (row.since, row.until, row.cost) == (0.1, 0.2, {"ticks": 5.0})
    assert not is_present(row)
    assert session_health(found.rows()) is Health.OK


def test_what_the_certificate_needs_and_was_broken_stays_broken() -> None:
    found = model(COUNTED, ("dx", 100, {"tau_breaches": 3.0}), ("dx", 9000, {"tau_breaches": 3.0}))
    row = only(found)
    assert (row.since, row.until) == (0.1, 0.1)
    assert is_present(row)
    assert session_health(found.rows()) is Health.BROKEN
    assert not holds(found.rows())


@pytest.mark.parametrize("event", [True, False])
def test_costs_are_those_of_all_processes_of_a_node(event: bool) -> None:
    found = model(TERMS, ("dx", 100, {"let_go": 3.0}))
    found.take("dx", 300, Figures({"let_go": 1.0, **({"began@200": 1.0} if event else {})}))
    assert only(found).cost == {"times": 4.0}
    found.forget("dx")
    found.take("dx", 400, Figures({"let_go": 4.0}))
    assert only(found).cost == {"times": 8.0}


@pytest.mark.parametrize("terms", [TERMS, COUNTED])
def test_the_worst_account_of_all_processes_is_told(terms: Terms) -> None:
    """A promise that broke in a former process stays broken, at what it cost then."""
    found = model(terms, ("dx", 100, {"interface_ticks": 2.0, "interface_min": -0.25}))
    found.take("dx", 300, Figures({"interface_ticks": 3.0, "interface_min": -0.001, "began@200": 1.0}))
    row = only(found)
    assert (row.promise, row.state, row.cost["J"]) == (Promise.LATENESS, BROKEN, 0.25)
    assert row.remark.startswith("dx: lateness has put 0.25 J into the loop")
    kept = model(terms, ("dx", 100, {"interface_ticks": 2.0, "interface_min": -0.003}))
    kept.take("dx", 300, Figures({"interface_ticks": 3.0, "interface_min": -0.001, "began@200": 1.0}))
    if terms is TERMS:
        assert only(kept).cost == {"ticks": 5.0, "J": 0.003}


def test_the_greatest_speed_of_all_processes_is_told() -> None:
    found = model(TERMS, ("dx", 100, {"beyond": 2.0, "fastest": 0.7}))
    found.take("dx", 300, Figures({"beyond": 1.0, "fastest": 0.6, "began@200": 1.0}))
    assert only(found).remark == "dx moved at up to 0.7 m/s on an axis"


def test_a_node_of_its_own_period_counts_the_sessions_time() -> None:
    found = model(replace(TERMS, rates={"dx": 4.0}), ("dx", 400, {"let_go": 1.0}))
    assert (found.now, only(found).since) == (0.1, 0.1)


def test_a_node_that_is_away_or_silent_breaks_its_presence_until_it_is_back() -> None:
    found = model(TERMS, ("world", 1000, {}))
    found.look(RUNNING | {"dx": "lost"}, ())
    row = only(found)
    assert (row.promise, row.state, row.who, row.since, row.remark) == ("presence", "broken", ("dx",), 1.0, "dx: lost")
    assert session_health(found.rows()) is Health.OK  # the node shows it itself
    found.look(RUNNING | {"dx": "starting"}, ())
    assert only(found).until is None
    found.take("world", 1500, Figures({}))
    found.look(RUNNING, ("cy",))
    back, silent = sorted(missed(found.rows()), key=lambda row: row.who, reverse=True)
    assert (back.who, back.until, back.cost) == (("dx",), 1.5, {"s": 0.5})
    assert (silent.who, silent.since, silent.remark) == (("cy",), 1.5, "cy: no telemetry has come from it for a while")


@pytest.mark.parametrize("state", ["lost", "starting", "connecting", "shaking hands", "ready", "leaving", "failed"])
def test_who_is_on_the_way_back_is_away_but_for_the_user_of_a_seat(state: str) -> None:
    found = model(TERMS, ("world", 1000, {}))
    found.look(RUNNING | {"dx": state}, ())
    assert (only(found).who, only(found).remark) == (("dx",), f"dx: {state}")
    seated = model(SEATED, ("world", 1000, {}))
    seated.look(RUNNING | {"dx": state}, ())
    assert missed(seated.rows()) == []


@pytest.mark.parametrize("state", ["running", "done", "ended", "free"])
def test_who_has_done_its_part_is_not_away(state: str) -> None:
    found = model(SEATED, ("world", 1000, {}))
    found.look(dict.fromkeys(ROLES, state), ())
    assert missed(found.rows()) == []


def test_a_frozen_coupling_whose_process_dies_is_away_since_it_froze() -> None:
    found = model(TERMS, ("world", 200, {"frozen:cx@150": 1.0}))
    found.look(RUNNING | {"cx": "lost"}, ())
    row = only(found)
    assert (row.state, row.since) == (BROKEN, 0.15)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_an_account_that_is_no_number_is_not_called_kept(bad: float) -> None:
    rows = missed(model(TERMS, ("dx", 100, {"ledger_margin": bad, "interface_min": bad})).rows())
    assert [(row.promise, row.state, row.who, row.cost) for row in rows] == [
        ("passivity", "broken", ("dx",), {}), ("lateness energy", "broken", ("dx",), {}),
    ]  # fmt: skip
    assert rows[0].remark == "dx: its ledger is no finite number"


def test_a_free_seat_breaks_no_promise() -> None:
    found = model(SEATED, ("world", 1000, Figures({"frozen": 1.0}, {"wave_holding_of": {"cx": 1.0}})))
    free = {"cx": "free", "dx": "free"}
    found.look(RUNNING | free, ())
    assert missed(found.rows()) == []
    found.look(RUNNING, ())
    found.take(
        "world",
        2000,
        Figures({"frozen:cx@1900": 1.0}, {"wave_silences_of": {"cx": 1.0}, "wave_holding_of": {"cx": 1.0}}),
    )
    assert {row.promise for row in missed(found.rows()) if row.until is None} == {"presence", "wave link"}
    found.look(RUNNING | free, ())
    found.take(
        "world",
        9000,
        Figures({"frozen:cx@8950": 1.0}, {"wave_silences_of": {"cx": 1.0}, "wave_holding_of": {"cx": 1.0}}),
    )
    assert [row for row in missed(found.rows()) if is_present(row)] == []


def ticking(elapsed: float) -> Figures:
    """What a node tells of its clock, ``elapsed`` s after tick 0."""
    return Figures({names.ELAPSED: 1e6 * elapsed})


def paced(ratio: float, seconds: float, terms: Terms = TERMS) -> HealthModel:
    """A session at a part of its own speed, whose telemetry comes in batches of a tenth of its time."""
    found = HealthModel(terms)
    for tick in range(100, int(seconds * ratio / T) + 1, 100):
        found.take("world", tick, ticking(tick * T / ratio))
        found.look(RUNNING, ())
    return found


@pytest.mark.parametrize("seconds", [0.6, 2.0, 8.0, 40.0])
@pytest.mark.parametrize("ratio", [1.0, 0.97])
def test_a_session_that_keeps_up_says_nothing_of_its_pace(ratio: float, seconds: float) -> None:
    assert missed(paced(ratio, seconds).rows()) == []


@pytest.mark.parametrize("ratio", [0.25, 0.5, 0.9])
def test_a_session_slower_than_its_period_says_so_with_the_ratio(ratio: float) -> None:
    found = paced(ratio, 20.0)
    row = only(found)
    assert (row.promise, row.state, row.who, row.until) == ("pace", "broken", ("session",), None)
    assert row.cost["x"] == pytest.approx(ratio, abs=0.03)
    assert row.cost["s"] == pytest.approx(20.0 * (1.0 - ratio), abs=0.4)
    assert session_health(found.rows()) is Health.SLOW
    assert holds(found.rows())  # no proof is about the clock
    assert "of real time" in row.remark
    assert "of 1000 ticks a second" in row.remark
    assert row.remark.endswith(MEASURE)
    assert "longer" not in row.remark  # nothing is advised that was not measured


def test_a_supervisor_that_is_late_itself_blames_nobody() -> None:
    """All telemetry of three seconds comes at once, after the supervisor had no turn."""
    found = paced(1.0, 4.0)
    found.look(RUNNING, ())
    for tick in range(4100, 7001, 100):
        found.take("world", tick, ticking(tick * T + 0.008))
    found.look(RUNNING, ())
    assert missed(found.rows()) == []


@pytest.mark.parametrize("late", [0.0, 0.008])
def test_a_device_that_is_slow_by_its_own_clock_is_named_however_late_the_supervisor_reads(late: float) -> None:
    found = paced(1.0, 4.0)
    for number in range(1, 31):
        found.take("world", 4000 + 100 * number, ticking(4.0 + 0.3 * number + late))
    found.look(RUNNING, ())
    row = only(found)
    assert (row.promise, row.state, row.who) == ("pace", "broken", ("session",))
    assert row.cost["s"] == pytest.approx(6.0, abs=0.01)


@pytest.mark.parametrize("told", [0.0, 4.0])
def test_a_session_of_which_nothing_is_heard_stands_still(told: float) -> None:
    found = paced(1.0, told)
    found.look(RUNNING, (), 0.9 * PACE_SILENCE)
    assert missed(found.rows()) == []
    found.look(RUNNING, (), 2.0)
    row = only(found)
    assert (row.promise, row.state) == ("pace", "broken")
    assert row.cost["s"] == pytest.approx(2.0)
    found.take("world", 6100, ticking(6.1))  # it had gone on, and its telemetry was held up
    found.look(RUNNING, ())
    assert only(found).until is not None


def test_a_node_that_is_left_behind_does_not_slow_the_session() -> None:
    found = paced(1.0, 4.0)
    found.take("dx", 100, ticking(0.1))
    found.take("dx", 110, ticking(4.0))
    found.look(RUNNING, ())
    assert missed(found.rows()) == []


def test_a_new_process_is_judged_from_its_own_first_word() -> None:
    """Its clock may be set a little apart from the clocks of the others."""
    found = paced(1.0, 4.0)
    for tick in range(4100, 9000, 100):
        found.take("dx", tick, ticking(tick * T + 0.5))
        found.look(RUNNING, ())
    assert missed(found.rows()) == []


def test_the_pace_is_reported_once_however_often_it_is_lost() -> None:
    found = paced(0.5, 10.0)
    first = only(found).remark
    tick, elapsed = 5000, 10.0
    for ratio, steps in ((1.0, 60), (0.3, 60)):
        for _ in range(steps):
            tick, elapsed = tick + round(200 * ratio), elapsed + 0.2
            found.take("world", tick, ticking(elapsed))
            found.look(RUNNING, ())
        over = only(found).until is not None
        assert over == (ratio == 1.0)
    assert only(found).remark == first


def test_the_simulated_clock_has_no_pace() -> None:
    assert missed(paced(0.1, 10.0, SIMULATED).rows()) == []


def test_remarks_belong_to_what_is_not_kept() -> None:
    found = model(TERMS, ("dx", 100, {"tau_breaches": 1.0}), ("dy", 100, {"tau_breaches": 1.0}))
    rows = found.rows({Promise.DELAY: "forces came late"})
    assert {(row.who, row.remark) for row in rows if row.promise == "delay"} == {
        ((), ""), (("dx",), "forces came late"), (("dy",), "forces came late"),
    }  # fmt: skip
    [both] = grouped(missed(rows))
    assert (both.who, both.cost, both.remark) == (("dx", "dy"), {"ticks": 2.0}, "forces came late")
    assert sentence(both) == "delay: enforced at dx, dy since 0.1 s (2 ticks in all)"


NODES = st.sampled_from([*ROLES, "stranger"])
FIGURES = drawn_figures(
    ["tau_breaches", "elapsed_us", "clipped", "ledger_margin", "interface_min", "interface_ticks", "let_go",
     "frozen:cx@7", "returned:cx@9", "frozen:dx@3", "began@5"],
    {name: ["cx", "x"] for name in
     ("wave_silences_of", "wave_holding_of", "scaled", "waited_ticks", "waited_us", "frozen_late")},
    st.floats(),
)  # fmt: skip
STATES = st.dictionaries(NODES, st.sampled_from(["running", "lost", "free", "starting", "odd"]))


@given(
    st.lists(
        st.one_of(
            st.tuples(NODES, st.integers(0, 2**62), FIGURES),
            st.tuples(STATES, st.lists(NODES, max_size=2), st.floats(0.0, 1e9)),
        ),
        max_size=12,
    )
)
def test_whatever_comes_the_rows_fit_a_condition(news: Sequence[tuple[object, ...]]) -> None:
    found = HealthModel(SEATED)
    for one in news:
        if isinstance(one[0], str):
            found.take(*one)  # type: ignore[arg-type]  # as hypothesis built it
        else:
            found.look(*one)  # type: ignore[arg-type]  # likewise
        rows = found.rows()
        sent = Condition("running", 0.0, {}, promises=rows)
        assert decode(encode(sent), MAX_CONTROL_BYTES) == sent
        assert session_health(rows) in Health
        assert all(row.since is None or row.since >= 0.0 for row in rows)


def told(at: float, asked: float, given: float, **seconds: float) -> Told:
    """What dx has told of its force at ``at`` (s): impulses, and the time without all of it by its cause."""
    figures = {"force_asked": asked, "force_given": given, "force_time_us": 1e6 * at}
    kinds = ("away", "held_back", "cut")
    figures |= {f"force_{kind}_us": 1e6 * seconds.get(kind, 0.0) for kind in kinds}
    return "dx", round(at / T), figures


def frozen(at: float, times: float) -> Told:
    return (
        "world",
        round(at / T),
        Figures({}, {"waited_ticks": {"cx": 9.0 * times}, "waited_us": {"cx": 1e3}, "frozen_late": {"cx": times}}),
    )


def of_force(found: HealthModel) -> PromiseStatus | None:
    rows = [row for row in missed(found.rows()) if row.promise == Promise.GIVEN]
    return rows[0] if rows else None


def test_a_hand_that_waits_for_answers_is_not_given_its_force_though_all_that_was_asked_was_exerted() -> None:
    """The coupling is frozen again and again: by force 98 % were given, while the hand felt next to nothing."""
    found = model(replace(TERMS, couplings={"dx": ("cx",)}), frozen(2.0, 9.0), told(2.0, 1.0, 0.98, away=1.2))
    row = of_force(found)
    assert row is not None
    assert (row.state, row.who, row.since, row.cost) == (BROKEN, ("dx",), 2.0, {"s": pytest.approx(1.2)})
    assert row.remark == (
        "dx was given 98 % of the force asked, and all of it in 40 % of the last 2 s: for 1.2 s of them it had no "
        "answer in time, or its force rose again after that; cx was frozen 9 times for staying silent, which "
        f"the machine that they share may have caused. {MEASURE}"
    )
    assert "at dx" in sentence(row)  # it is nobody's deed, least of all the deed of the one who lacks the force
    assert "by dx" not in sentence(row)
    assert session_health(found.rows()) is Health.ENFORCED
    assert holds(found.rows())  # the certificate is about energy, and stands


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        ({"away": 1.5}, f"or its force rose again after that. {MEASURE}"),
        ({"held_back": 1.5}, f"the reserve for lateness (faults.tank) held them back. {MEASURE}"),
        ({"cut": 1.5, "away": 0.2}, "its limits of force or motion cut the force"),
    ],
)
def test_why_a_force_was_not_given(seconds: Mapping[str, float], words: str) -> None:
    row = of_force(model(TERMS, told(2.0, 10.0, 9.9, **seconds)))
    assert row is not None
    assert words in row.remark
    assert "frozen" not in row.remark


@pytest.mark.parametrize(
    ("terms", "one"),
    [
        (TERMS, told(1.9, 1.0, 0.0, away=1.9)),  # too short to judge
        (TERMS, told(10.0, 50.0, 46.0, away=0.9)),
        (TERMS, told(10.0, 1e-9, 0.0)),  # what was asked is nothing that a hand feels
        (SIMULATED, told(10.0, 50.0, 5.0, away=9.0)),
        (TERMS, ("dx", 10_000, {"force_asked": math.nan, "force_given": 0.0, "force_time_us": 1e7})),
    ],
)
def test_what_is_enough_or_no_lack_at_all(terms: Terms, one: Told) -> None:
    assert of_force(model(terms, one)) is None


def test_a_lack_of_force_is_over_once_the_last_seconds_are_well() -> None:
    found = model(TERMS, told(2.0, 10.0, 6.0, held_back=0.8), told(3.0, 15.0, 11.0, held_back=0.8))
    row = of_force(found)
    assert row is not None
    assert row.until is None
    for at in range(4, 8):
        found.take(*told(float(at), 5.0 * at, 5.0 * at - 4.0, held_back=0.8))
    row = of_force(found)
    assert row is not None
    assert row.until == 7.0  # in the five seconds before, more than nine tenths were given
    found.take("dx", 8000, Figures({"began@8000": 1.0}))  # a new process counts from 0
    found.take(*told(8.0, 40.0, 36.0, held_back=0.8))
    assert session_health(found.rows()) is Health.OK


@pytest.mark.parametrize(
    ("device", "state"),
    [("dx", PromiseState.ENFORCED), ("dz", PromiseState.BROKEN)],
    ids=["in wall time", "in its own"],
)
def test_a_speed_below_which_a_certificate_holds_is_promised_by_the_device_that_states_it(
    device: str, state: PromiseState
) -> None:
    terms = replace(TERMS, roles={**ROLES, "dz": Role.DEVICE})
    health = HealthModel(terms)
    assert "proved speed" not in {row.promise for row in health.rows()}
    health.take(device, 100, Figures({names.BEYOND: 0.0, names.FASTEST: 0.04}))
    (row,) = [row for row in health.rows() if row.promise == "proved speed"]
    assert (row.state, row.remark) == (PromiseState.KEPT, "")
    health.take(device, 200, Figures({names.BEYOND: 3.0, names.FASTEST: 0.135}))
    row = next(row for row in health.rows() if row.promise == "proved speed" and row.who)
    assert (row.state, row.who, dict(row.cost)) == (state, (device,), {"times": 3.0})
    assert row.remark == f"{device} moved at up to 0.135 m/s on an axis"


def test_what_a_device_does_by_itself_is_said_with_its_drivers_word() -> None:
    """In the row that is not judged, in the one that is broken, and no more once another process states nothing."""
    deed = "dx does by itself, outside the certificate: compensates gravity by a force of its own; gates forces"
    found = HealthModel(replace(TERMS, drivers={"dx": DriverWord("a.b:C")}))
    found.hear("dx", ("compensates gravity by a force of its own", "gates forces"))
    found.hear("cx", ("is no device",))
    assert found.by_itself == {"dx": ("compensates gravity by a force of its own", "gates forces")}

    def remark() -> str:
        [row] = [row for row in found.rows() if row.promise == Promise.DRIVER]
        return row.remark

    assert remark().startswith("dx rests on the word of its driver a.b:C: ")
    assert remark().endswith("; " + deed)
    found.take("dx", 100, as_figures({"untrue": 3.0, "untrue_most": 2.0}))
    assert remark().startswith("dx: by its own measurement")
    assert remark().endswith("; " + deed)
    found.hear("dx", ())
    assert deed not in remark()


def test_a_device_that_no_force_moves_is_held_by_nobody() -> None:
    """Its driver says so at the start, or its session, which states the same words."""
    word = DriverWord("a.b:C")
    heard = HealthModel(replace(TERMS, drivers={"dx": word}))
    assert "a person's hand holds dx" in _passivity_of(heard)
    heard.hear("dx", DeviceSpecification((1.0,), (1.0,), (1.0,), moved_by_force=False).uncovered)
    stated = HealthModel(replace(TERMS, drivers={"dx": replace(word, by_itself=(IMPOSED,))}))
    for found in (heard, stated):
        nothing = "no force moves dx, so this run shows nothing about stability with a hand"
        assert _passivity_of(found) == f"{nothing}; it has put in at least 0 J so far"
        [row] = [row for row in found.rows() if row.promise == Promise.DRIVER]
        assert row.remark.endswith(f"; dx does by itself, outside the certificate: {IMPOSED}")


def _passivity_of(found: HealthModel) -> str:
    [row] = [row for row in found.rows() if row.promise == Promise.PASSIVITY and row.who == ("dx",)]
    return row.remark


def test_a_device_that_exerted_no_force_is_no_fault_of_its_driver() -> None:
    found = HealthModel(replace(TERMS, drivers={"dx": DriverWord("a.b:C")}))

    def row() -> PromiseStatus:
        [one] = [one for one in found.rows() if one.promise == Promise.DRIVER]
        return one

    found.take("dx", 100, as_figures({"limp": 3.0, "limp_most": 2.0}))
    assert row().state == PromiseState.ENFORCED
    assert row().cost == {"ticks": 3.0, "N": 2.0}
    assert row().remark.startswith("dx: its device exerted no force")
    found.take("dx", 200, as_figures({"limp": 3.0, "limp_most": 2.0, "untrue": 1.0, "untrue_most": 0.5}))
    assert row().state == PromiseState.BROKEN
    assert row().cost == {"ticks": 1.0, "N": 0.5}
    found.take("dx", 300, as_figures({"limp": 9.0, "limp_most": 2.0, "untrue": 1.0, "untrue_most": 0.5}))
    assert row().state == PromiseState.BROKEN


FACTORY = "a.b:" + "C" * 200
LONG = tuple(f"{i}{'x' * (MAX_SENTENCE - 1)}" for i in range(MAX_BY_ITSELF))


def test_a_remark_has_room_for_all_that_may_be_said() -> None:
    found = HealthModel(replace(TERMS, drivers={"dx": DriverWord(FACTORY, 1.0, 1.0, (1.0,), (1.0,), True, LONG)}))
    found.hear("dx", tuple(f"{i}{'y' * (MAX_SENTENCE - 1)}" for i in range(MAX_BY_ITSELF)))
    assert len(found.by_itself["dx"]) == 2 * MAX_BY_ITSELF
    encode(Condition("running", 0.0, {}, promises=found.rows(), by_itself=found.by_itself))
