"""The report of a run: the nodes' final messages go in, one JSON object comes out, whatever they contain."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from manyhands.launch.app.design_report import print_report
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.run.outcome import (
    Progress,
    last_line,
    lateness_entry,
    lateness_sentence,
    node_entry,
    run_report,
    save_json,
)
from manyhands.launch.run.states import Incidents, SessionPhase
from manyhands.launch.session import load_session
from manyhands.nodes.monitor.given import FIGURES
from manyhands.nodes.rows import figures as names
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_COUNT
from manyhands.protocol.messages import Figures, PromiseStatus, Report, Role, Telemetry

from ...support.simulated_recordings import SESSIONS

HONEST = Report(
    100,
    Figures(
        {
            names.LEDGER: 0.5,
            names.LEDGER_MIN: 0.0,
            names.PEAK_SPEED: 0.25,
            names.FINAL_SPEED: 0.125,
            **{names.LATE: 3, names.TAU_BREACHES: 0, names.CLIPPED: 2, names.STALE: 1},
        },
        {
            names.TAU: {"p50": 1.0, "p99": 2.0, "p999": 3.0, "max": 4.0},
            names.DROPPED: {"old_tick": 4, "malformed": 0},
            names.REFUSED: {"no_key": 5, "shut": 0},
        },
    ),
)
TABLES = [name for name, figure in names.FIGURES.items() if figure.key is not None]
some_keys = st.sampled_from(["x", "own", "p50", "max"]) | st.text("abc[/]\n" + chr(27), min_size=1, max_size=8).filter(
    str.isprintable
)
numbers = st.floats() | st.sampled_from([math.inf, -math.inf, math.nan])
figures = st.builds(
    Figures,
    st.dictionaries(st.sampled_from([*names.FIGURES]) | some_keys, numbers, max_size=8),
    st.dictionaries(st.sampled_from(TABLES) | some_keys, st.dictionaries(some_keys, numbers, max_size=4), max_size=4),
)
reports = st.builds(Report, st.integers(0, MAX_COUNT), figures)


def test_an_honest_nodes_entry() -> None:
    assert node_entry(Role.DEVICE, HONEST) == {
        "role": "device",
        "ticks": 100,
        "late": 3,
        "tau_us": {"p50": 1.0, "p99": 2.0, "p999": 3.0, "max": 4.0},
        "ledger": {"min": 0.0, "final": 0.5},
        "peak_speed": 0.25,
        "final_speed": 0.125,
        "tau_breaches": 0,
        "clipped": 2,
        "refused": {"no_key": 5},
        "dropped": {"old_tick": 4},
    }


def test_who_made_the_others_wait_and_for_how_long() -> None:
    tables = {
        names.WAITED_TICKS: {"cz": 53.0, "cx": 1.0, "cy": 4.0},
        names.WAITED_TIME: {"cz": 117e3, "cx": 600.0},
        names.FROZEN_LATE: {"cz": 2.0},
        names.OVERDUE: {"cz": 9.0},
        names.WAIVED: {"cz": 1.0},
    }
    entry = node_entry(Role.ENVIRONMENT, Report(100, Figures({}, tables)))
    assert entry["late_couplings"] == {
        "cz": {"ticks": 53, "seconds": 0.117, "frozen": 2, "held": 9, "waived": 1},
        "cx": {"ticks": 1, "seconds": 0.0006, "frozen": 0, "held": 0, "waived": 0},
    }
    assert "late_causes" not in entry


def test_what_a_role_does_not_have_is_absent() -> None:
    assert node_entry(Role.ENVIRONMENT, Report(7, Figures())) == {"role": "environment", "ticks": 7}


@pytest.mark.parametrize("left_out", [names.LEDGER, names.LEDGER_MIN, names.PEAK_SPEED])
@pytest.mark.parametrize("instead", [None, math.nan, math.inf])
def test_a_group_is_left_out_without_what_it_needs(left_out: str, instead: float | None) -> None:
    told: dict[str, float] = {name: value for name, value in HONEST.figures.items() if name != left_out}
    if instead is not None:
        told[left_out] = instead
    entry = node_entry(Role.DEVICE, Report(1, Figures(told)))
    assert ("ledger" in entry) == (left_out not in (names.LEDGER, names.LEDGER_MIN))
    assert ("peak_speed" in entry) == (left_out != names.PEAK_SPEED)
    assert "final_speed" in entry


def whole(
    nodes: dict[str, Report],
    refused: dict[str, int] | None = None,
    incidents: Incidents | None = None,
    enforced: tuple[str, ...] = (),
    lateness: dict[str, Any] | None = None,
    unreported: tuple[str, ...] = (),
    visits: tuple[str, ...] = (),
) -> dict[str, Any]:
    roles, withstood = dict.fromkeys((*nodes, "silent"), Role.DEVICE), incidents or Incidents()
    return run_report(
        *("example-1", "c0ffee", "simulated", 0.5, roles, nodes, refused or {}, withstood, enforced, lateness),
        unreported=unreported,
        visits=visits,
    )


def test_what_a_node_withstood_and_where_its_ledger_was_least() -> None:
    told = {names.LEDGER: 0.5, names.LEDGER_MIN: -0.25, names.LEDGER_MIN_TICK: 17.0, names.LEDGER_MARGIN: 0.125}
    counts = {names.FROZEN_TICKS: 7, names.JUMPS: 2, names.RELEASED: 0, names.RUNG: 0}
    causes = {names.LATE_CAUSE: {"own": 1.0, "partner": 0.0}}
    entry = node_entry(Role.DEVICE, Report(9, Figures({**told, **counts}, causes)), restarts=3)
    assert entry == {
        "role": "device",
        "ticks": 9,
        "late_causes": {"own": 1, "partner": 0},
        "ledger": {"min": -0.25, "final": 0.5, "at": 17, "margin": 0.125},
        "rung": 0,
        "incidents": {"frozen": 7, "jumps": 2, "restarts": 3},
    }


def test_how_long_a_process_did_not_run_is_in_seconds() -> None:
    told = {names.SUSPENDED: 2.0, names.SUSPENDED_TIME: 250e3, names.SUSPENDED_ENERGY: 0.5}
    entry = node_entry(Role.DEVICE, Report(9, Figures(told)))
    assert entry["suspended"] == {"times": 2, "seconds": pytest.approx(0.25), "energy": 0.5}
    assert "suspended" not in node_entry(Role.DEVICE, Report(9, Figures({**told, names.SUSPENDED: 0.0})))


@pytest.mark.parametrize("tick", [math.nan, -1.0, 1e300])
def test_a_tick_that_is_none_is_left_out(tick: float) -> None:
    entry = node_entry(
        Role.DEVICE, Report(1, Figures({names.LEDGER: 0.5, names.LEDGER_MIN: 0.0, names.LEDGER_MIN_TICK: tick}))
    )
    assert entry["ledger"] == {"min": 0.0, "final": 0.5}


def test_incidents_are_listed_where_there_were_any() -> None:
    incidents = Incidents()
    incidents.add("dx was killed by SIGKILL while running")
    incidents.restarts["dx"] += 1
    made = whole({"dx": HONEST}, incidents=incidents)
    assert made["incidents"] == ["dx was killed by SIGKILL while running"]
    assert made["nodes"]["dx"]["incidents"] == {"restarts": 1}
    assert "incidents" not in whole({"dx": HONEST})


def test_visits_are_no_incidents() -> None:
    made = whole({"dx": HONEST}, visits=("dx has joined",))
    assert made["visits"] == ["dx has joined"]
    assert "incidents" not in made
    assert "visits" not in whole({"dx": HONEST})


@given(reports)
def test_any_node_message_gives_a_report_that_can_be_shown(report: Report) -> None:
    received = decode(encode(report), MAX_CONTROL_BYTES)
    assert isinstance(received, Report)
    made = whole({"dx": received})
    assert json.loads(json.dumps(made, allow_nan=False)) == made
    shown = StringIO()
    print_report(Console(file=shown, width=200), made)
    assert "dx" in shown.getvalue()


def test_the_whole_and_its_file(tmp_path: Path) -> None:
    made = whole({"dx": HONEST})
    assert made.keys() == {"session", "certificate", "clock", "duration", "nodes"}
    assert made["nodes"].keys() == {"dx"}  # the other gave no last word
    assert whole({}, {"no_key": 2})["refused"] == {"no_key": 2}
    assert whole({}, enforced=("environment",))["enforced"] == ["environment"]
    save_json(made, tmp_path / "run.json")
    assert json.loads((tmp_path / "run.json").read_text()) == made
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


POWER = 1e-3  # W
PROMISE = {"tau": 0.00085, "period_tolerance": 0.25, "enforced": True, "tank": 0.005, "power": POWER}


def late(
    least: float, ticks: float = 0.0, kept_back: float = 0.0, asked: float = 0.0, given: float = 0.0, away: float = 0.0
) -> Report:
    account = {names.INTERFACE: 0.02, names.INTERFACE_LEAST: least, names.INTERFACE_TICKS: ticks}
    account |= {names.INTERFACE_MARGIN: 0.005 + least, names.FORCE_ASKED: asked, names.FORCE_GIVEN: given}
    if asked:
        times = (10e6, 1e6 * away, 0.0, 0.0)
        account |= dict(zip(FIGURES[2:], times, strict=True))
    own = {name: value for name, value in HONEST.figures.items() if name != names.CLIPPED}
    return Report(100, Figures({**own, **account, names.INTERFACE_KEPT_BACK: kept_back}))


@pytest.mark.parametrize(
    ("nodes", "promise", "sentence"),
    [
        ({"dx": HONEST}, PROMISE, None),
        (
            {"dx": late(0.0), "dy": late(0.0)},
            PROMISE,
            "lateness: proved up to τ = 0.85 ms, enforced beyond: 0 ticks changed, 0 mJ kept back; no account fell "
            "below 0, bound -5 mJ, falling by 1 mW",
        ),
        (
            {"dx": late(-1e-3, 1.0, 2e-4), "dy": late(-0.0025, 6.0, 1e-4), "dz": HONEST},
            PROMISE,
            "lateness: proved up to τ = 0.85 ms, enforced beyond: 7 ticks changed, 0.3 mJ kept back; least account "
            "-2.5 mJ (dy), bound -5 mJ, falling by 1 mW",
        ),
        (
            {"dx": late(-312.0)},
            {**PROMISE, "tau": 0.0, "enforced": False},
            "lateness: proved up to τ = 0 ms, only counted beyond; least account -312 J (dx), bound -5 mJ, "
            "falling by 1 mW",
        ),
        (
            {"dx": late(0.0, asked=4.0, given=3.9), "dy": late(0.0, asked=1.0, given=1.0, away=0.2), "dz": late(0.0)},
            PROMISE,
            "lateness: proved up to τ = 0.85 ms, enforced beyond: 0 ticks changed, 0 mJ kept back; no account fell "
            "below 0, bound -5 mJ, falling by 1 mW; least given: 97.5 % of the force asked (dx), 98 % by time (dy)",
        ),
        (
            {"dx": late(-312.0)},
            None,
            "lateness: nothing is proved, and it was only counted; least account -312 J (dx)",
        ),
    ],
)
def test_a_sentence_about_lateness(
    nodes: dict[str, Report], promise: dict[str, Any] | None, sentence: str | None
) -> None:
    made = whole(nodes, lateness=promise)
    assert lateness_sentence(made) == sentence
    shown = StringIO()
    print_report(Console(file=shown, width=123), made)
    assert (sentence or "no sentence") in shown.getvalue() + "no sentence"


def test_what_a_hand_was_given_is_a_share_by_force_and_one_by_time() -> None:
    made = whole({"dx": late(0.0, asked=4.0, given=3.9, away=6.0), "dy": late(0.0), "dz": HONEST})
    given = {"force": 0.975, "time": 0.4, "seconds": 10.0, "away": 6.0, "held_back": 0.0, "cut": 0.0}
    assert made["nodes"]["dx"]["given"] == pytest.approx(given)
    assert not [name for name in ("dy", "dz") if "given" in made["nodes"].get(name, {})]


def test_a_hand_that_lacked_its_force_has_a_sentence_with_the_cause_and_what_helps() -> None:
    remark = "dx was given 98 % of the force asked, and 40 % by time: for 6 s it had no answer. What helps: rest"
    row = {"promise": "force given", "state": "broken", "who": ["dx"], "since": 1.0, "until": None, "cost": {"s": 6.0}}
    made = whole({"dx": late(0.0, asked=4.0, given=3.9, away=6.0)}) | {"promises": [{**row, "remark": remark}]}
    shown = StringIO()
    print_report(Console(file=shown, width=250), made)
    said = shown.getvalue().splitlines()
    assert said[-1] == f"worst: force given: broken at dx since 1.0 s (6 s). {remark}. Late: dx in 3 % of its ticks."
    assert shown.getvalue().count(remark) == 1
    failed = StringIO()
    print_report(Console(file=failed, width=250), made, ("a fault",))
    assert failed.getvalue().splitlines()[-2:] == [remark, "failed: a fault"]
    assert re.search(r" dx .* 97/40 ", shown.getvalue())


def test_a_node_without_a_report_has_a_row_and_nothing_is_claimed_of_it() -> None:
    made = whole({"dx": late(0.0)}, lateness=PROMISE, unreported=("silent",))
    assert (made["unreported"], made["nodes"].keys()) == (["silent"], {"dx"})
    shown = StringIO()
    print_report(Console(file=shown, width=200), made)
    assert re.search("silent .* no report ", shown.getvalue())
    assert "no account fell below 0 of those reported, and no figures came from silent, bound -5 mJ" in shown.getvalue()


def test_a_node_whose_last_process_sent_no_report_has_a_row() -> None:
    """Its greatest speed is known by its telemetry, and that of its last rows is not."""
    figures = Figures({names.PEAK_SPEED: 0.25})
    made = whole({"dx": HONEST}) | {"nodes": {"dx": node_entry(Role.DEVICE, Report(100, figures))}}
    shown = StringIO()
    print_report(Console(file=shown, width=200), made)
    assert re.search(r"dx .* 0\.25 ", shown.getvalue())


def test_a_study_can_ask_whose_wall_is_gone() -> None:
    def now(*rows: PromiseStatus) -> tuple[str, ...]:
        return Progress(SessionPhase.RUNNING, {}, {}, {}, 1.0, (), {}, promises=rows).without_force

    gone = PromiseStatus("force given", "broken", ("dx", "dy"), since=1.0)
    assert now(gone, PromiseStatus("pace", "broken", ("dz",))) == ("dx", "dy")
    assert now(dataclasses.replace(gone, until=2.0), PromiseStatus("force given", "kept")) == ()


def test_a_run_that_had_no_tick_claims_no_promise() -> None:
    rows = [{"promise": "pace", "state": "kept", "who": [], "since": 0.0, "until": None, "cost": {}, "remark": ""}]
    shown = StringIO()
    early = whole({}) | {"promises": rows, "duration": 0.0}
    print_report(Console(file=shown, width=200), early, ("dx ended with exit code 2",))
    assert shown.getvalue() == f"{early['session']}: failed before its first tick: dx ended with exit code 2\n"


def test_the_last_line_says_what_was_worst() -> None:
    def last(report: dict[str, Any], *faults: str) -> str:
        shown = StringIO()
        print_report(Console(file=shown, width=200), report, faults)
        return shown.getvalue().splitlines()[-1]

    rows = [{"promise": "pace", "state": "kept", "who": [], "since": 0.0, "until": None, "cost": {}, "remark": ""}]
    whole_run = whole({"dx": HONEST}) | {"promises": rows}
    assert last(whole_run) == "all promises kept; late: dx in 3 % of its ticks"
    assert last(whole_run, "dx was killed\nat once", "and more") == "failed: dx was killed"
    away = rows[0] | {"promise": "presence", "state": "broken", "who": ["dx"], "since": 0.5, "cost": {"s": 0.25}}
    assert last(whole_run | {"promises": [*rows, away]}).startswith(
        "worst: presence: broken by dx since 0.5 s (0.25 s). The others go on, still certified."
    )


KEPT = {"promise": "pace", "state": "kept", "who": [], "since": 0.0, "until": None, "cost": {}, "remark": ""}
ENFORCED = KEPT | {"promise": "delay", "state": "enforced", "who": ["dx"], "cost": {"ticks": 9.0}}
AWAY = KEPT | {"promise": "presence", "state": "broken", "who": ["Cx"], "since": 0.5, "cost": {"s": 0.25}}
CHECKED = "all promises kept, or enforced: delay (dx)"


def test_a_device_that_is_late_by_its_own_work_is_told_apart() -> None:
    """Such as one whose driver waits; a few such ticks are any machine's."""
    causes = {"a": {"own": 74, "partner": 90, "descheduled": 0}, "b": {"own": 9, "partner": 191, "descheduled": 0}}
    nodes = {name: {"ticks": 1000, "late": sum(of.values()), "late_causes": of} for name, of in causes.items()}
    report = whole({}) | {"nodes": nodes, "promises": [KEPT]}
    assert last_line(report).endswith("late: b in 20 % of its ticks, a in 16.4 % of its ticks (7.4 % by its own work)")


@pytest.mark.parametrize(
    ("late", "given", "rows", "said"),
    [
        ({}, {}, [KEPT], "all promises kept"),
        ({"dx": 9}, {}, [KEPT], "all promises kept"),  # as on any machine
        ({"world": 455, "dx": 10}, {}, [KEPT],
         "all promises kept; late: world in 45.5 % of its ticks, dx in 1 % of its ticks"),
        ({"a": 600, "b": 500, "c": 400, "d": 300, "e": 200}, {}, [KEPT],
         "all promises kept; late: a in 60 % of its ticks, b in 50 % of its ticks, c in 40 % of its ticks and 2 more"),
        ({}, {"dx": (0.0, 0.0), "dy": (0.0, 0.0)}, [ENFORCED], f"{CHECKED}; no force was taken away"),
        ({"dx": 400}, {"dx": (0.001, 0.0), "dy": (3.0, 1.25)}, [ENFORCED],
         f"force was taken away for 42.5 % of the time (dy); {CHECKED}; late: dx in 40 % of its ticks"),
        ({}, {"dx": (0.001, 0.0)}, [ENFORCED], f"force was taken away for 0.1 % of the time (dx); {CHECKED}"),
        ({}, {"dx": (0.001, 0.0)}, [KEPT], "all promises kept"),  # not for being late
        ({}, {}, [ENFORCED], CHECKED),
    ],
)  # fmt: skip
def test_the_last_line_says_who_was_late_and_for_how_long_force_was_taken_away(
    late: dict[str, int], given: dict[str, tuple[float, float]], rows: list[dict[str, Any]], said: str
) -> None:
    nodes: dict[str, dict[str, Any]] = {name: {"ticks": 1000} for name in {**late, **given, "cx": 0}}
    for name, ticks in late.items():
        nodes[name]["late"] = ticks
    for name, (away, held_back) in given.items():
        nodes[name]["given"] = {"seconds": 10.0, "away": away, "held_back": held_back, "cut": 5.0}
    report = whole({}) | {"nodes": nodes, "promises": rows}
    assert last_line(report) == said
    lost, _, after = said.partition(CHECKED if CHECKED in said else "all promises kept")
    after = "; ".join(part for part in (after.removeprefix("; "), lost.removesuffix("; ")) if part)
    after = re.sub("(no force|force) was taken", r"besides absences, \1 was taken", after)
    worst = last_line(report | {"promises": [*rows, AWAY]})
    assert worst.startswith("worst: presence: broken by Cx since 0.5 s (0.25 s). The others go on, still certified.")
    assert worst.endswith(f" {after[0].upper()}{after[1:]}." if after else "let in again by a ramp.")


def test_the_table_has_each_least_account_and_what_was_left_of_it() -> None:
    shown = StringIO()
    print_report(Console(file=shown, width=123), whole({"dx": late(-0.0025), "dy": HONEST}, lateness=PROMISE))
    rows = {line.split()[0]: line for line in shown.getvalue().splitlines() if line.startswith((" dx ", " dy "))}
    assert "-2.5e-03/2.5e-03" in rows["dx"]
    assert "/-5e-03" not in rows["dy"]
    assert whole({"dx": late(-0.0025)}, lateness=PROMISE)["lateness"] == PROMISE


def test_a_promise_about_lateness_needs_a_certificate_and_a_device_in_wall_time() -> None:
    def promise(clock: str, *settings: str, uncertified: bool = False) -> dict[str, Any] | None:
        session = load_session(SESSIONS / "example1.yaml", ["design.tau=0.0003", *settings])
        return lateness_entry(prepare(session, uncertified=uncertified), clock)

    expected = {"tau": 0.0003, "period_tolerance": 0.0, "enforced": True, "tank": 0.005, "power": POWER}
    assert promise("realtime") == expected
    counted = promise("realtime", "faults.lateness=count", "faults.tank=0.002", "devices.dx.time=own")
    assert counted == {**expected, "enforced": False, "tank": 0.002, "power": 0.0}
    assert promise("simulated") is None
    assert promise("realtime", *(f"devices.{name}.time=own" for name in ("dx", "dy", "dz"))) is None
    assert promise("realtime", "design.coupling=none", uncertified=True) is None


@pytest.mark.parametrize(
    ("offset", "axes", "said"),
    [
        (0.0172, {}, f"the tool of dx was up to 17.2 mm behind it; {CHECKED}"),
        (0.0009, {}, CHECKED),
        (0.25, {"dx": ["rotation"]}, f"the tool of dx was up to 250 mrad behind it; {CHECKED}"),
    ],
)
def test_the_last_line_says_how_far_lateness_made_a_tool_lag_behind(
    offset: float, axes: dict[str, list[str]], said: str
) -> None:
    """Of that nothing is asked of the device, so that shares of force cannot show it."""
    given = {"seconds": 10.0, "away": 0.0, "held_back": 0.0, "cut": 0.0}
    node = {"ticks": 1000, "given": given, "interface": {"offset": offset, "changed_ticks": 7}}
    nodes = {"dx": node, "cx": {"ticks": 1000}}
    report = whole({}) | {"nodes": nodes, "promises": [ENFORCED], "axes": axes}
    assert last_line(report) == f"{said}; no force was taken away, and the motion of 7 ticks was changed"
    assert last_line(report | {"promises": [KEPT]}) == "all promises kept"


def test_progress_tells_how_far_tools_lag_behind() -> None:
    told = {"dx": Telemetry(10, Figures({"interface_behind": 0.004}), {}), "cx": Telemetry(10, Figures({}), {})}
    assert Progress(SessionPhase.RUNNING, {}, {}, told, 1.0, (), {}).behind == {"dx": 0.004}
