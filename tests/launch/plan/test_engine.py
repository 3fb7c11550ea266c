"""What is said of an engine's model beside what refuses it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from manyhands.launch.app import start
from manyhands.launch.app.cli import app
from manyhands.launch.plan.engine import engine_lines
from manyhands.launch.plan.reach import ReachError
from manyhands.launch.session import Session
from manyhands.launch.session.shipped import load_named
from tests.support.slot import sensed, slot

DAMPED = 'damping="0.0005"'
SAID = (
    "slot: environment.model: found a damping of 5e-05 N·m·s/rad at the ball joint 'turn', by which its tool swings "
    "up by itself beside a hand that holds still; expected 0.0003 N·m·s/rad (k T) or more"
)


def swinging(found: dict[str, object]) -> dict[str, object]:
    text = json.dumps(found)
    escaped = json.dumps(DAMPED)[1:-1]
    assert text.count(escaped) == 1
    changed: dict[str, object] = json.loads(text.replace(escaped, escaped.replace("0.0005", "0.00005")))
    return changed


@pytest.mark.parametrize("found", [slot(), sensed()], ids=["felt", "sensed"])
def test_a_ball_joint_at_which_a_tool_swings_is_named(found: dict[str, object]) -> None:
    pytest.importorskip("mujoco")
    assert engine_lines(Session.from_dict(found)) == []
    assert engine_lines(Session.from_dict(swinging(found))) == [SAID]


@pytest.mark.parametrize("name", ["insert", "stretcher", "screw", "mujoco", "example1"])
def test_nothing_is_said_of_shipped_sessions(name: str) -> None:
    assert engine_lines(load_named(name, [])) == []


def test_a_model_that_is_refused_is_refused_elsewhere() -> None:
    found = slot()
    assert (
        engine_lines(Session.from_dict({**found, "environment": found["environment"] | {"model": "<mujoco/>"}})) == []
    )


@pytest.mark.parametrize("command", ["design", "simulate", "launch"])
def test_each_command_that_makes_a_session_says_it_once(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")

    def stop(*_: object) -> None:
        raise ReachError("this test runs no processes")

    monkeypatch.setattr(start, "run_session", stop)
    file = tmp_path / "slot.yaml"
    file.write_text(json.dumps(swinging(slot())))
    rest = {"design": [], "simulate": ["--duration", "0.01"], "launch": ["--duration", "1", "--clock", "simulated"]}
    found = CliRunner().invoke(app, [command, str(file), *rest[command]])
    assert found.stderr.splitlines().count(SAID) == 1
    assert found.exit_code == (2 if command == "launch" else 0)
