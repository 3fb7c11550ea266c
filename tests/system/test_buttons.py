"""Buttons through processes: recorded, told by info, computed again by replay and audit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from manyhands.launch.recordings.run import read_run
from manyhands.launch.session.session import ENVIRONMENT

from ..support.buttons import handover, held_down
from ..support.commands import run

HELD = {"anna.grip": [range(50, 300)], "ben.grip": [range(200, 380)]}


@pytest.fixture(scope="module", params=["apart", "together"])
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """400 ticks, of couplings in processes of their own or in those of their devices."""
    folder = tmp_path_factory.mktemp("buttons")
    session, path = folder / "handover.yaml", folder / "run.mcap"
    session.write_text(yaml.safe_dump(handover(colocate=request.param == "together"), sort_keys=False))
    run("launch", session, "--clock", "simulated", "--duration", "0.4", "--record", path)
    return path


def test_presses_are_recorded_with_their_ticks_and_the_forces_follow_again(recording: Path) -> None:
    recorded = read_run(recording)
    assert held_down(recorded.figures[ENVIRONMENT], recorded.ticks) == HELD
    assert held_down(recorded.figures["anna"], recorded.ticks) == {"anna.grip": HELD["anna.grip"]}
    told = [figures.tables["buttons_down"]["anna.grip"] for _, figures in recorded.figures["anna"]]
    assert told == [1.0] * told.count(1.0) + [0.0] * told.count(0.0)
    assert 1.0 in told
    assert 0.0 in told
    assert "bit for bit" in run("replay", recording)
    assert json.loads(run("audit", recording, "--json"))["holds"]
    assert "button anna.grip: pressed 1 time" in run("info", recording)
    assert json.loads(run("info", recording, "--json"))["presses"] == {"anna.grip": 1, "ben.grip": 1}
