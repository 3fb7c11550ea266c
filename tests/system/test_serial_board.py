"""A fake board on the desk: in a session in real time, audited, and back after a reset."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from ..fakes.board import Axis, fake_board
from ..support.commands import read_until, run, started

SESSION = """
session: board
period: 0.004
devices:
  stick:
    dof: 1
    osp: 1.0
    driver: serial-board
    parameters: {{port: {port}, silence: 0.9, sample_age: 0.001, actuation_delay: 0.0005}}
    sample_age: 0.001
    actuation_delay: 0.0005
    mass: 0.149
    step: 0.00001
    limits: {{force: 5, displacement: 0.1, speed: 2}}
couplings:
  cs: {{devices: [stick]}}
environment:
  type: network
  links:
    - {{between: [stick.0, ground], stiffness: 100}}
design: {{coupling: spring-damper, tau: 0.003, period_tolerance: 0.5}}
"""

HAND = Axis(m=0.15, b=1.0, step=1e-5, k=100.0, amplitude=0.01, frequency=0.7)
"""Somebody holds the board, and moves."""


@pytest.mark.alone  # its recording is judged in real time
def test_a_board_is_felt_in_a_session_and_its_recording_holds(tmp_path: Path) -> None:
    with fake_board(HAND, period_us=500) as one:
        session = tmp_path / "board.yaml"
        session.write_text(SESSION.format(port=one.path))
        recording, report = tmp_path / "board.mcap", tmp_path / "board.json"
        run("launch", session, "--duration", "3", "--record", recording, "--report", report)
    nodes = json.loads(report.read_text())["nodes"]
    stick = nodes["stick"]
    assert stick["ticks"] == 750
    assert stick["peak_force"] > 0.2  # the hand pushes with up to 1 N, and the world pushes back
    assert stick["interface"]["margin"] > 0.0  # from its bound
    assert ": holds (" in run("audit", recording)


@pytest.mark.long
def test_a_board_that_resets_itself_comes_back(tmp_path: Path) -> None:
    """Its device's process ends by name, a new one greets the board anew, and the session goes on."""
    with fake_board(HAND, period_us=500) as one:
        session = tmp_path / "board.yaml"
        session.write_text(SESSION.format(port=one.path).replace("silence: 0.9", "silence: 0.2"))
        report = tmp_path / "board.json"
        arguments = (session, "--duration", "6", "--report", report)
        with started("launch", *arguments) as launched:
            read_until(launched, ": running")
            while one.asked()[1] == [0.0]:
                time.sleep(0.01)  # until the world pushes back
            one.order("reset")
            _, error = launched.communicate(timeout=60.0)
            assert launched.returncode == 0, error
    found = json.loads(report.read_text())
    assert any("stick failed" in sentence and "found no state for" in sentence for sentence in found["incidents"])
    assert found["nodes"]["stick"]["ticks"] == 1500
