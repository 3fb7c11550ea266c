"""Whatever number a party sends under a known name, everything that reads it goes on, and says what it can."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from rich.console import Console

from manyhands.launch.app.design_report import print_report
from manyhands.launch.look.live import LiveTable
from manyhands.launch.look.page.feed import Cursor, Feed
from manyhands.launch.look.tables import picture, session_object, top_object
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.recorded import recorded_of
from manyhands.launch.recordings.info import read_info
from manyhands.launch.recordings.run import export, read_run
from manyhands.launch.run.broadcast import condition_frame, describe, observation_frame
from manyhands.launch.run.outcome import rows_of
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.monitor.health import missed, verdict
from manyhands.nodes.monitor.session_state import LiveSession
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Instant
from manyhands.protocol.limits import MAX_COUNT
from manyhands.protocol.messages import Figures, Report, Telemetry

from .test_supervisor_messages import Heard

SESSIONS: Final = Path(__file__).parents[3] / "launch" / "sessions"
KNOWN: Final = sorted({value for name, value in vars(names).items() if name.isupper() and isinstance(value, str)})
VALUES: Final = (math.nan, math.inf, -math.inf, -1e308, 1e308, -1.0, 5e-324, 2.0**63)
TRACES: Final = (names.DISPLACEMENT, names.FORCE, names.TAU, names.LEDGER, names.TOOL_POSITION)


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "ball.yaml"))


def everything(value: float) -> dict[str, float]:
    """Every figure of every kind, and those about a party and about two."""
    about = [f"{name}{of}" for name in KNOWN for of in ("", "left_seat", "_left_seat", "left_seat/right_seat", "_p99")]
    return dict.fromkeys((*about, "driver_x", "began@1", "frozen:left_seat@3"), value)


def read_everywhere(prepared: Prepared, heard: Heard, told: list[tuple[str, Telemetry]], folder: Path) -> None:
    """Show a session to all that look at it, while it runs and afterwards."""
    about = describe(prepared, REALTIME, "ipc", 0)
    scene, feed, now = LiveSession(about), Feed(about), Instant(1_000_000_000)
    core = RecorderCore(recorded_of(prepared, REALTIME), {}, 0)
    frames = [observation_frame(node, telemetry) for node, telemetry in told]
    for frame in (*frames, condition_frame(heard.progress())):
        assert frame is not None
        scene.take(frame, now)
        feed.take(frame, now)
        core.take(frame, now)
    feed.look(now)
    console = Console(file=io.StringIO(), width=200, force_terminal=True)
    json.dumps([session_object(scene), top_object(scene)], allow_nan=False)
    console.print(picture(scene, 200))
    json.loads(feed.picture(Cursor(), {}), parse_constant=lambda word: pytest.fail(f"found {word} on the page"))
    LiveTable(console, "t", about)(heard.progress())
    console.print(LiveTable(console, "t", about)._render(heard.progress()))
    outcome = heard.supervisor.outcome(None)
    plain = json.loads(json.dumps(outcome.report, allow_nan=False))
    print_report(console, plain)
    assert verdict(rows_of(plain))
    recording = folder / "run.mcap"
    recording.write_bytes(core.cut() + core.end())
    assert read_info(recording)
    export(read_run(recording), folder / "run.csv", "csv")


@pytest.mark.parametrize("value", VALUES)
def test_no_number_of_a_party_is_an_error_anywhere(
    prepared: Prepared, value: float, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    heard, told = Heard(prepared, run=True), list[tuple[str, Telemetry]]()
    request.addfinalizer(heard.transport.close)
    for tick in (10, 20):  # sums of what two parties say twice
        for node in heard.graph.nodes:
            width = len(heard.graph.ports[node])
            traces = {name: np.full((10, 1 if name in (names.TAU, names.LEDGER) else width), value) for name in TRACES}
            told.append((node, Telemetry(tick, Figures(everything(value)), traces)))
            heard.say(*told[-1])
    read_everywhere(prepared, heard, told, tmp_path)
    for node in heard.graph.nodes:
        counts = dict.fromkeys(everything(value), MAX_COUNT)
        percentiles = {names.TAU: {"p50": value, "p99": value, "p999": value, "max": value}}
        heard.say(node, Report(20, Figures({**everything(value), **counts}, percentiles)))
    read_everywhere(prepared, heard, told, tmp_path)


def test_a_ledger_of_minus_infinity_at_two_parties_is_broken_and_not_an_error(prepared: Prepared) -> None:
    """The two costs were added when the report was printed: None and None, after all else was done."""
    heard = Heard(prepared, run=True)
    for node in ("left_seat", "right_seat"):
        heard.say(node, Telemetry(10, Figures({names.LEDGER_MARGIN: -math.inf}), {}))
    outcome, shown = heard.supervisor.outcome(None), io.StringIO()
    print_report(Console(file=shown, width=200), json.loads(json.dumps(outcome.report)))
    assert "passivity: broken by left_seat" in shown.getvalue()
    rows = [row for row in missed(rows_of(outcome.report)) if row.promise == "passivity"]
    assert {row.remark for row in rows} == {
        "left_seat: its ledger is no finite number", "right_seat: its ledger is no finite number",
    }  # fmt: skip
    heard.transport.close()
