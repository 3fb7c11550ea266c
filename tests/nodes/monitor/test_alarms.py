"""Alarms: the cause of each, its first time, its end; an intermittent cause raises one alarm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.monitor.alarms import HOLD, MOST_ALARMS, UNHEARD, Alarm, AlarmLevel, Alarms
from manyhands.nodes.monitor.given import FIGURES
from manyhands.nodes.monitor.health import Health
from manyhands.nodes.monitor.session_state import About, LiveSession
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Condition, Figures

from ...support.figures import drawn_figures
from ...support.observed_session import ABOUT, UNCERTIFIED, conditioned, judged, observed

NO_TRACE: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]] = {}
START = Instant(10**9)


def at(seconds: float) -> Instant:
    return Instant(START + from_seconds(seconds))


def looked(*frames: bytes, about: About = ABOUT) -> tuple[LiveSession, Alarms]:
    scene, alarms = LiveSession(about), Alarms()
    for frame in (*frames, judged(*frames, about=about)):
        assert scene.take(frame, START) is not None
    alarms.look(scene, START)
    return scene, alarms


def only(alarms: Alarms) -> Alarm:
    [alarm] = alarms.listed()
    return alarm


def test_a_session_that_is_well_has_none() -> None:
    _, alarms = looked(conditioned(), observed("left", 100, NO_TRACE, ledger_margin=0.0, tau_worst_us=299.0))
    assert alarms.listed() == []
    assert alarms.version == 0


@pytest.mark.parametrize(
    ("frame", "level", "words"),
    [
        (conditioned(notices=("left: a delay",)), AlarmLevel.WARNING, "left: a delay"),
        (conditioned(incidents=("vl came back",)), AlarmLevel.NOTE, "vl came back"),
        (conditioned(faults=("vl was killed",)), AlarmLevel.FAULT, "vl was killed"),
        (conditioned(silent=("vr",)), AlarmLevel.FAULT, "vr: no telemetry has come"),
        (conditioned(lost=("left",)), AlarmLevel.FAULT, "left: lost"),
        (
            observed("vl", 100, NO_TRACE, ledger_margin=-0.25),
            AlarmLevel.FAULT,
            "vl: its ledger fell 0.25 J below",
        ),
        (
            observed("left", 100, NO_TRACE, interface_min=-0.25),
            AlarmLevel.FAULT,
            "left: lateness has put 0.25 J into the loop, more than the 0.005 J that its interface has to keep to",
        ),
        (
            observed(
                "environment",
                100,
                NO_TRACE,
                Figures({}, {"waited_ticks": {"vl": 53.0}, "waited_us": {"vl": 117e3}, "frozen_late": {"vl": 2.0}}),
            ),
            AlarmLevel.WARNING,
            "waited for vl in 53 ticks, 0.117 s in all, and then no more; its tool rested for 0 ticks",
        ),
        (
            observed("environment", 100, NO_TRACE, frozen=2.0, **{"frozen:vl@90": 1.0, "frozen:vr@95": 1.0}),
            AlarmLevel.WARNING,
            "vl is frozen: it takes no part, and the others go on; vr is frozen",
        ),
        (
            observed("left", 100, NO_TRACE, **dict(zip(FIGURES, (9.0, 4.5, 2e6, 0.0, 1e6, 0.0), strict=True))),
            AlarmLevel.WARNING,
            "left was given 50 % of the force asked, and all of it in 50 % of the last 2 s",
        ),
    ],
)
def test_what_raises_an_alarm(frame: bytes, level: AlarmLevel, words: str) -> None:
    scene, alarms = looked(frame)
    alarm = only(alarms)
    since = 0.09 if "frozen" in words and "waited" not in words else scene.time
    assert (alarm.level, alarm.since, alarm.cleared) == (level, since, None)
    assert words in alarm.text
    assert alarm.advice


@pytest.mark.parametrize("frozen", [0.0, -1.0, np.inf, np.nan])
def test_a_member_late_now_and_then_but_never_frozen_is_unnamed(frozen: float) -> None:
    late = Figures({}, {"waited_ticks": {"vl": 3.0}, "waited_us": {"vl": 900.0}, "frozen_late": {"vl": frozen}})
    assert looked(observed("environment", 100, NO_TRACE, late))[1].listed() == []


def test_late_ticks_raise_one() -> None:
    scene, alarms = looked(conditioned(), observed("left", 100, NO_TRACE, late=0.0))
    scene.take(observed("left", 1100, NO_TRACE, late=200.0), at(1.0))
    alarms.look(scene, at(1.0))
    assert only(alarms).text == "more ticks are late than is usual on any machine: left"
    assert (only(alarms).headline, only(alarms).who) == ("many late ticks", ("left",))


def test_many_late_nodes_are_one_cause() -> None:
    scene, alarms = looked(conditioned(), *(observed(node, 100, NO_TRACE, late=0.0) for node in ("left", "right")))
    for node in ("left", "right"):
        scene.take(observed(node, 1100, NO_TRACE, late=200.0), at(1.0))
    alarms.look(scene, at(1.0))
    assert only(alarms).who == ("left", "right")


def test_the_same_at_several_nodes_is_one_alarm_with_all_that_was_said() -> None:
    told = (
        "at 1.0 s: vl was killed by SIGKILL",
        "at 2.0 s: vr was killed by SIGKILL",
        "at 3.0 s: vr was started again",
    )
    scene, alarms = looked(conditioned(incidents=told[:1]))
    scene.take(conditioned(incidents=told), at(1.0))
    scene.take(observed("left", 700, NO_TRACE), at(1.0))
    alarms.look(scene, at(1.0))
    again, killed = alarms.listed()
    assert (again.headline, again.who) == ("was started again", ("vr",))
    assert (killed.headline, killed.who) == ("was killed by SIGKILL", ("vl", "vr"))
    assert killed.text.split("\n") == [*told[:2]]
    assert (killed.since, killed.latest) == (0.0, pytest.approx(0.7))


def test_a_headline_ends_where_the_sentence_explains_itself_and_names_no_part_of_a_word() -> None:
    told = (
        "vl was killed; it stays away: its restarts are used up",
        "vleft was killed",
        "the recording stopped: no room",
    )
    _, alarms = looked(conditioned(faults=told))
    assert {(alarm.headline, alarm.who) for alarm in alarms.listed()} == {
        ("was killed", ("vl",)),
        ("vleft was killed", ()),
        ("the recording stopped", ()),
    }


def test_a_promise_that_many_break_is_one_alarm_that_names_them() -> None:
    _, alarms = looked(
        observed("vl", 100, NO_TRACE, ledger_margin=-0.25), observed("vr", 100, NO_TRACE, ledger_margin=-0.5)
    )
    assert (only(alarms).headline, only(alarms).who) == ("passivity broken", ("vl", "vr"))


def test_a_delay_raises_none_until_the_session_has_a_notice_of_it() -> None:
    slow = observed("left", 100, NO_TRACE, tau_worst_us=1e6)
    assert looked(slow)[1].listed() == []
    assert only(looked(slow, conditioned(notices=("forces came later",)))[1]).text == "forces came later"


@pytest.mark.parametrize("least", [0.0, -0.005, -0.005 - 1e-12])
def test_an_account_within_its_tank_raises_none(least: float) -> None:
    assert looked(observed("left", 100, NO_TRACE, interface_min=least))[1].listed() == []


def test_an_account_that_is_counted_alone_advises_to_bound_it() -> None:
    assert ABOUT.certificate is not None
    counted = replace(ABOUT, certificate=replace(ABOUT.certificate, bounded=False))
    below = observed("left", 100, NO_TRACE, interface_min=-0.25)
    alarm = only(looked(below, about=counted)[1])
    assert "it is counted and not bounded" in alarm.text
    assert "faults: {lateness: enforce}" in alarm.advice
    assert looked(below, about=UNCERTIFIED)[1].listed() == []  # nothing is promised


def test_a_softer_coupling_covers_a_longer_delay() -> None:
    scene, _ = looked(observed("vl", 100, NO_TRACE, rung=1.0))
    assert (scene.covered_tau("left"), scene.covered_tau("right")) == (0.0005, 0.0003)


def test_it_does_so_in_its_devices_process_too() -> None:
    """No link joins the two."""
    nodes = {**ABOUT.nodes, "vl": replace(ABOUT.nodes["vl"], process="left")}
    links = tuple(link for link in ABOUT.links if "left" not in link.ends)
    scene, _ = looked(observed("vl", 100, NO_TRACE, rung=1.0), about=replace(ABOUT, nodes=nodes, links=links))
    assert (scene.covered_tau("left"), scene.covered_tau("right")) == (0.0005, 0.0003)


@pytest.mark.parametrize("rung", [-1.0, 2.0, np.inf, np.nan])
def test_a_rung_that_makes_no_sense_covers_what_the_certificate_does(rung: float) -> None:
    scene, _ = looked(observed("vl", 100, NO_TRACE, rung=rung))
    assert scene.covered_tau("left") == 0.0003


def test_an_alarm_clears_once_its_cause_is_absent_long_enough() -> None:
    scene, alarms = looked(observed("left", 700, NO_TRACE), conditioned(silent=("vr",)))
    scene.take(conditioned(), at(0.1))
    alarms.look(scene, Instant(START + HOLD))
    assert only(alarms).cleared is None
    alarms.look(scene, Instant(START + HOLD + 1))
    assert only(alarms).cleared == pytest.approx(0.7)


def test_what_comes_and_goes_is_one_alarm() -> None:
    scene, alarms = looked(conditioned(silent=("vr",)))
    version = alarms.version
    for step in range(1, 20):
        scene.take(judged(conditioned(silent=("vr",) if step % 2 else ())), at(step * 0.5))
        alarms.look(scene, at(step * 0.5))
    assert (only(alarms).since, only(alarms).cleared) == (0.0, None)
    assert alarms.version == version


def test_what_is_raised_again_is_a_new_one() -> None:
    scene, alarms = looked(conditioned(silent=("vr",)))
    scene.take(conditioned(), at(1.0))
    alarms.look(scene, at(10.0))
    late = observed("left", 11_000, NO_TRACE), conditioned(silent=("vr",))
    scene.take(judged(*late), at(11.0))
    alarms.look(scene, at(11.0))
    assert (only(alarms).since, only(alarms).cleared) == (11.0, None)


def test_what_has_happened_is_not_cleared() -> None:
    scene, alarms = looked(conditioned(faults=("vl was killed",)))
    scene.take(conditioned(), at(1.0))
    alarms.look(scene, at(100.0))
    assert only(alarms).cleared is None


def test_a_silent_session_raises_an_alarm_until_it_ends() -> None:
    scene, alarms = looked(conditioned(), observed("left", 100, NO_TRACE))
    alarms.look(scene, Instant(START + UNHEARD + 1))
    assert only(alarms).key == "unheard"
    over, quiet = looked(conditioned("over"), observed("left", 100, NO_TRACE))
    quiet.look(over, Instant(START + UNHEARD + 1))
    assert quiet.listed() == []


def test_the_gravest_come_first_and_the_cleared_last() -> None:
    told = conditioned(silent=("vr",), notices=("n",), faults=("f",), incidents=("i",))
    scene, alarms = looked(told)
    scene.take(conditioned(notices=("n",), faults=("f",), incidents=("i",)), at(1.0))
    alarms.look(scene, at(10.0))
    assert [alarm.text for alarm in alarms.listed()][:3] == ["f", "n", "i"]
    assert alarms.listed()[3].cleared is not None


FIGURES = drawn_figures(
    ["tau_breaches", "period_breaches", "clipped", "saturated", "ledger_margin", "interface_min", "interface_ticks",
     "let_go", "late", "frozen:vl@50", "returned:vl@90", "frozen:vr@20"],
    {"frozen_late": ["vl"], "waited_ticks": ["vl"], "waited_us": ["vl"]},
    st.floats(-1.0, 1e6),
)  # fmt: skip


@given(
    st.lists(st.tuples(st.sampled_from([*ABOUT.nodes]), st.integers(1, 50), FIGURES), max_size=8),
    st.lists(st.sampled_from([*ABOUT.nodes]), max_size=1).map(tuple),
    st.booleans(),
)
def test_no_alarm_but_a_note_stands_beside_a_health_that_is_ok(
    told: list[tuple[str, int, Figures]], silent: tuple[str, ...], noticed: bool
) -> None:
    frames = [observed(node, 100 * tick, NO_TRACE, figures) for node, tick, figures in told]
    shown = decode(judged(*frames, conditioned(silent=silent)), MAX_CONTROL_BYTES)
    assert isinstance(shown, Condition)
    if noticed:  # a notice comes of the same figures as its row
        rows = tuple(replace(row, remark=f"{row.promise}!") if row.state != "kept" else row for row in shown.promises)
        shown = replace(shown, promises=rows, notices=tuple(dict.fromkeys(row.remark for row in rows if row.remark)))
    scene, alarms = LiveSession(ABOUT), Alarms()
    for frame in (*frames, encode(shown)):
        scene.take(frame, START)
    alarms.look(scene, START)
    if any(alarm.level is not AlarmLevel.NOTE for alarm in alarms.listed()):
        assert scene.health is not Health.OK, alarms.listed()


def test_no_more_are_kept_than_so_many() -> None:
    scene, alarms = looked(conditioned())
    for step in range(30):
        scene.take(conditioned(incidents=tuple(f"{step} {i}" for i in range(100))), at(step))
        alarms.look(scene, at(step))
    assert len(alarms.listed()) == MOST_ALARMS
    assert alarms.listed()[0].text.startswith("29 ")
