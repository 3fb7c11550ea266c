"""A fake SpaceMouse and a fake gamepad in a session in real time: felt by the other user, judged, audited, back."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from ..fakes.motion_device import fake_motion_device
from ..support.commands import read_until, run, started

SESSION = """
session: moved
period: 0.004
devices:
  left:
    dof: 2
    axes: [x, z]
    osp: 1.37
    driver: {driver}
    parameters: {{device: {device}, speed: 0.2}}
    axis_map: {axis_map}
    mass: 0.2
    limits: {{force: 30, displacement: 0.1, speed: 3}}
  right:
    dof: 2
    axes: [x, z]
    osp: 1.37
    driver: simulated
    mass: 0.2
    limits: {{force: 30, displacement: 0.1, speed: 3}}
    hand: {{stiffness: 60, damping: 2}}
couplings:
  left_tool: {{devices: [left]}}
  right_tool: {{devices: [right]}}
environment:
  type: network
  links:
    - {{between: [left.x, right.x], stiffness: 100}}
    - {{between: [left.z, right.z], stiffness: 100}}
design: {{coupling: spring-damper, tau: 0.003, period_tolerance: 0.5}}
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "driver", "axis_map", "pushed"),
    [
        ("enterprise", "spacemouse", "[x, z]", (1.0, 0.0, -0.8, 0.0, 0.0, 0.0)),
        ("gamepad", "gamepad", "[x, triggers]", (1.0, 0.0, -1.0, 0.0, 0.0, 1.0)),
    ],
)
def test_it_is_felt_in_a_session_and_the_recording_holds(
    kind: str, driver: str, axis_map: str, pushed: tuple[float, ...], tmp_path: Path
) -> None:
    with fake_motion_device(kind, tmp_path) as fake:
        session = tmp_path / "moved.yaml"
        session.write_text(SESSION.format(driver=driver, device=fake.path, axis_map=axis_map))
        recording, report = tmp_path / "moved.mcap", tmp_path / "moved.json"
        with started("launch", session, "--duration", "2", "--record", recording, "--report", report) as launched:
            read_until(launched, ": running")
            time.sleep(0.5)  # a person waits as well, and a hand closes only from rest
            fake.deflect(*pushed)
            _, error = launched.communicate(timeout=60.0)
            assert launched.returncode == 0, error
        told = json.loads(report.read_text())
        assert told["nodes"]["left"]["ticks"] == 500
        assert told["nodes"]["right"]["peak_force"] > 0.2
        audited = run("audit", recording)
        assert ": holds (" in audited


def test_one_that_is_unplugged_comes_back(tmp_path: Path) -> None:
    """Its device's process ends by name, the others go on without it, and a new process opens the file again."""
    session, report = tmp_path / "moved.yaml", tmp_path / "moved.json"
    with fake_motion_device("compact", tmp_path) as fake:
        session.write_text(SESSION.format(driver="spacemouse", device=fake.path, axis_map="[x, z]"))
        with started("launch", session, "--duration", "4", "--report", report) as launched:
            read_until(launched, ": running")
            fake.deflect(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            time.sleep(0.5)
            fake.unplug()
            with fake_motion_device("compact", tmp_path):
                _, error = launched.communicate(timeout=60.0)
            assert launched.returncode == 0, error
    told = json.loads(report.read_text())
    assert any("left failed" in line and "expected reports of a SpaceMouse" in line for line in told["incidents"])
    assert told["nodes"]["right"]["ticks"] == 1000


def test_one_that_is_not_there_is_told_before_anything_moves(tmp_path: Path) -> None:
    session = tmp_path / "moved.yaml"
    session.write_text(SESSION.format(driver="gamepad", device=tmp_path / "none", axis_map="[x, z]"))
    with pytest.raises(AssertionError, match="found no such file; expected a gamepad that is plugged in"):
        run("launch", session, "--duration", "1")
