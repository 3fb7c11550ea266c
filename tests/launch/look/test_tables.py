"""The tables of `list` and `top`, and the bounded time in which both end."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from dataclasses import replace

import pytest
from rich.console import Console

from manyhands.launch.look.display import COLUMNS
from manyhands.launch.look.sessions import watch
from manyhands.launch.look.tables import (
    GLANCE,
    PRINT_EVERY,
    Glance,
    glance,
    picture,
    print_sessions,
    session_object,
    show_live,
    show_repeatedly,
    top_object,
)
from manyhands.nodes.monitor import given
from manyhands.nodes.monitor.session_state import LiveSession
from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures

from ...support.observed_frames import ABOUT, MS, Frames, condition, telemetry
from ...support.observed_session import judged


def minute(extra: dict[int, list[bytes]] | None = None, seconds: int = 3) -> dict[int, list[bytes]]:
    """Frames of a session in which all is well: each node's telemetry ten times a second, conditions five times."""
    frames = {100 * n: [telemetry(name, 100 * n, late=0.0) for name in ABOUT.nodes] for n in range(1, 10 * seconds + 1)}
    for at in range(200, 1000 * seconds, 200):
        frames[at].append(condition())
    for at, more in (extra or {}).items():
        frames[at] = frames.get(at, []) + more
    return frames


def glanced(*sessions: Frames) -> tuple[list[Glance], float]:
    """What is seen of sessions that share a clock, and how long it took, s."""
    clock = sessions[0].clock
    glances = [Glance(LiveSession(ABOUT), frames) for frames in sessions]

    def await_frames(unsettled: Sequence[Glance], timeout: Duration) -> None:
        assert timeout <= GLANCE
        clock.sleep_until(Instant(clock.now() + min(timeout, 10 * MS)))

    glance(glances, clock, await_frames)
    return glances, clock.now() / 1e9


def test_a_glance_ends_as_soon_as_all_rates_are_known() -> None:
    (one,), took = glanced(Frames(minute()))
    assert one.settled
    assert took == pytest.approx(0.6, abs=0.02)
    assert one.live.rate == pytest.approx(1000.0, rel=0.05)


def test_who_does_not_run_is_not_waited_for() -> None:
    frames = {at: [f for f in some if f != telemetry("cx", at, late=0.0)] for at, some in minute().items()}
    frames[200] = [*frames[200], condition(cx="lost")]
    frames = {at: [condition(cx="lost") if f == condition() else f for f in some] for at, some in frames.items()}
    (one,), took = glanced(Frames(frames))
    assert took < 0.7
    assert session_object(one.live)["nodes"]["cx"]["health"] == "away"


def test_a_silent_session_is_awaited_for_a_bounded_time() -> None:
    (one,), took = glanced(Frames({}))
    assert took == pytest.approx(GLANCE / 1e9, abs=0.02)
    said = session_object(one.live)
    assert (said["phase"], said["rate"], said["tick"], said["health"]) == (None, None, 0, "waiting")
    json.dumps(said, allow_nan=False)


def shown(text: io.StringIO) -> list[list[str]]:
    return [[c.strip() for c in line.split("│")[1:-1]] for line in text.getvalue().splitlines() if line[:1] == "│"]


def test_a_list_has_a_row_for_each_session_and_node() -> None:
    (one,), _ = glanced(Frames(minute()))
    text = io.StringIO()
    print_sessions(Console(file=text, width=140), [one.live], ABOUT.started + 3700.0)
    session, *nodes = shown(text)
    assert session[:3] == ["s", "17", "realtime"]
    assert session[3].endswith("(1:01:40)")
    assert session[4:] == ["600", "1000", "ok"]
    assert nodes[0] == ["d", "device", "running", "1000", "ok"]
    assert [row[0] for row in nodes] == list(ABOUT.nodes)


def scene_of(*frames: bytes) -> LiveSession:
    scene = LiveSession(ABOUT)
    for number, frame in enumerate(frames):
        scene.take(frame, Instant(number * 100 * MS))
    return scene


def printed(scene: LiveSession, width: int) -> str:
    text = io.StringIO()
    Console(file=text, width=width, highlight=False).print(picture(scene, width))
    return text.getvalue()


FIGURES = Figures(
    {"late": 3.0, "speed": 0.01, "ledger": 0.25, "ledger_margin": 0.125, "interface": 0.0625, "rung": 1.0,
     "not_admitted": 7.0},
    {"tau_us": {"p50": 120.0, "p99": 350.0}},
)  # fmt: skip


def test_the_table_has_every_node_figure_and_alarm() -> None:
    scene = scene_of(
        telemetry("d", 100, tables=FIGURES.tables, **FIGURES), condition(silent=("cx",), incidents=("dx came back",))
    )
    text = printed(scene, 200)
    (row,) = [line.split() for line in text.splitlines() if line.split()[:2] == ["d", "device"]]
    assert row == [
        "d",
        "device",
        "running",
        "100",
        "3",
        "120",
        "350",
        "1",
        "1.00e-02",
        "6.25e-02",
        "2.50e-01",
        "1.25e-01",
        "7",
        "ok",
    ]
    for line in ("link cx - environment: silent", "link d - cx: silent", "notice: a notice", "incident: dx came back"):
        assert line in text
    assert "link d - cy" not in text  # it is well
    assert "s (process 17, realtime clock): running, 2 s; silent" in text


def test_a_user_frozen_for_lateness_is_named_with_its_cost() -> None:
    late = {
        "waited_ticks": {"cx": 53.0, "cy": 1.0},
        "waited_us": {"cx": 117e3, "cy": 600.0},
        "frozen_late": {"cx": 2.0},
    }
    told = telemetry("environment", 100, tables=late)
    text = printed(scene_of(told, judged(told, condition(), about=ABOUT)), 200)
    assert "the others waited for cx in 53 ticks, 0.117 s in all, and then no more; its tool rested for 0 ticks" in text
    assert "waited for cy" not in text


@pytest.mark.parametrize("width", [60, 80, 100, 140])
def test_in_a_narrow_table_figures_are_omitted_and_names_stay_whole(width: int) -> None:
    scene = scene_of(*(telemetry(name, 100, tables=FIGURES.tables, **FIGURES) for name in ABOUT.nodes), condition())
    text = printed(scene, width)
    assert max(map(len, text.splitlines())) <= width
    assert "environment" in text
    assert "running" in text
    heads = [column.title.split(" [")[0] for _, column in sorted(COLUMNS, key=lambda one: one[1].rank)]
    kept = [head in text for head in heads]
    assert kept == sorted(kept, reverse=True)  # the more important ones


SEATED = replace(ABOUT, seats={"cx": "d"})


def test_a_free_seat_is_free_and_nothing_is_wrong_with_its_links() -> None:
    scene = LiveSession(SEATED)
    scene.take(judged(condition(d="free", cx="free"), about=SEATED), Instant(0))
    text = printed(scene, 140)
    assert "seat cx: free" in text
    assert "link" not in text
    assert "lost" not in text
    assert "(process 17, realtime clock): running, 2 s; waiting" not in text
    said = top_object(scene)
    assert said["seats"] == {"cx": {"device": "d", "state": "free", "felt": None, "health": "free"}}
    assert said["nodes"]["cx"]["health"] == "free"
    json.dumps(said, allow_nan=False)


def test_list_and_top_name_what_is_not_kept_and_whom_it_is_about() -> None:
    told = telemetry("d", 3400, clipped=7.0)
    scene = scene_of(told, judged(told, condition(), about=ABOUT))
    text = io.StringIO()
    print_sessions(Console(file=text, width=140), [scene], ABOUT.started + 1.0)
    assert shown(text)[0][-1] == "broken"
    assert "s: force limits broken (d)" in text.getvalue()
    top = printed(scene, 140)
    assert "running, 2 s; broken" in top
    assert "force limits: broken by d since 3.4 s (7 ticks)" in top
    assert (
        "kept: passivity, delay, period, lateness energy, stated inertia, force given, motion limits, presence, "
        "punctuality, pace" in top
    )
    rows = [row for row in session_object(scene)["promises"] if row["state"] == "broken"]
    assert [(row["promise"], row["who"], row["since"], row["cost"]) for row in rows] == [
        ("force limits", ["d"], 3.4, {"ticks": 7.0})
    ]


def test_only_the_latest_sentences_are_shown() -> None:
    text = printed(scene_of(condition(incidents=tuple(f"number {n}" for n in range(20)))), 100)
    assert "incidents: 12 earlier ones" in text
    assert "incident: number 11" not in text
    assert "incident: number 19" in text


def test_markup_of_a_node_is_no_markup() -> None:
    text = printed(scene_of(condition(incidents=("[bold]x[/bold] :smile:",))), 100)
    assert "incident: [bold]x[/bold] :smile:" in text


def test_as_json() -> None:
    told = telemetry("d", 100, tables=FIGURES.tables, **{**FIGURES, "ledger": math.nan})
    said = top_object(scene_of(told, condition(silent=("cx",))))
    json.dumps(said, allow_nan=False)
    assert said["nodes"]["d"]["figures"] == {**FIGURES, "ledger": None, **FIGURES.tables}
    assert {"between": ["d", "cx"], "health": "silent"} in said["links"]
    assert (said["notices"], said["incidents"], said["faults"]) == (["a notice"], [], [])


def test_a_visit_is_in_the_object_and_no_sentence_below_the_table() -> None:
    live = scene_of(encode(Condition("running", 2.5, dict.fromkeys(ABOUT.nodes, "running"), visits=("d has joined",))))
    assert top_object(live)["visits"] == ["d has joined"]
    assert "d has joined" not in printed(live, 200)


def test_a_terminal_is_drawn_at_most_five_times_a_second() -> None:
    frames, text = Frames(minute()), io.StringIO()
    scene, console = LiveSession(ABOUT), Console(file=text, width=100, height=30, force_terminal=True)
    seeing = watch(frames, scene, frames.clock, lambda: False)
    show_live(scene, seeing, console, stop=lambda: frames.clock.now() >= 2000 * MS)
    assert frames.clock.now() == 2000 * MS
    assert 5 <= text.getvalue().count("(process 17") <= 11


def test_without_a_terminal_it_prints_every_two_seconds_and_finally() -> None:
    frames = Frames(minute({5000: [condition("over")]}, seconds=5))
    scene, told = LiveSession(ABOUT), []
    show_repeatedly(
        scene, watch(frames, scene, frames.clock, lambda: False), lambda seen: told.append(frames.clock.now() / 1e9)
    )
    assert told == pytest.approx([0.1 + PRINT_EVERY / 1e9, 0.1 + 2 * PRINT_EVERY / 1e9, 5.0])


def test_top_shows_what_each_hand_was_given_by_force_and_by_time() -> None:
    figures = dict(zip(given.FIGURES, (4.0, 3.9, 10e6, 5e6, 1e6, 0.0), strict=True))
    scene = scene_of(telemetry("d", 300, **figures), telemetry("cx", 300))
    top = printed(scene, 180)
    assert "given" in top
    assert "97/40" in top  # rounded down: what lacks something is not all
    assert top_object(scene)["nodes"]["d"]["figures"] == figures
    assert "-/40" in printed(scene_of(telemetry("d", 300, **{**figures, "force_asked": 0.0})), 180)
