"""A fake Inverse Service with somebody at its device: a session in real time, audited, and back after its end."""

from __future__ import annotations

import json
import time
from pathlib import Path

from ..fakes.haply import fake_haply
from ..support.commands import read_until, run, started

SESSION = """
session: inverse
period: 0.004
devices:
  hand:
    dof: 3
    axes: [x, y, z]
    osp: 1.0
    driver: haply-inverse3
    parameters:
      {{port: {port}, events: {events}, silence: {silence}, sample_age: 0.002, actuation_delay: 0.001, force: 5}}
    sample_age: 0.002
    actuation_delay: 0.001
    held: torque
    linkage: {{kappa: 8}}
    limits: {{force: 5, displacement: 0.15, speed: 1}}
couplings:
  ch: {{devices: [hand]}}
environment:
  type: network
  links:
    - {{between: [hand.x, ground], stiffness: 60}}
    - {{between: [hand.y, ground], stiffness: 60}}
    - {{between: [hand.z, ground], stiffness: 60}}
design: {{coupling: spring-damper, tau: 0.004, period_tolerance: 0.5}}
"""

HAND = {"mass": 0.15, "damping": 1.0, "step": 0.001, "hand": 100.0, "amplitude": 0.015}
"""Somebody holds the device, and moves."""


def test_an_inverse3_is_felt_in_a_session_and_its_recording_holds(tmp_path: Path) -> None:
    with fake_haply(**HAND) as one:
        session = tmp_path / "inverse.yaml"
        session.write_text(SESSION.format(port=one.port, events=one.events, silence=0.9))
        recording, report = tmp_path / "inverse.mcap", tmp_path / "inverse.json"
        run("launch", session, "--duration", "3", "--record", recording, "--report", report)
        after = one.asked()
    assert after["f"] == [0.0, 0.0, 0.0]
    assert after["most"] > 0.2  # N, what the motors have really done
    assert after["enabled"] == {"gravity_compensation": True, "torque_scaling": True}  # as it was before
    hand = json.loads(report.read_text())["nodes"]["hand"]
    assert hand["ticks"] == 750
    assert hand["peak_force"] > 0.2
    assert hand["interface"]["margin"] > 0.0  # from its bound
    assert ": holds (" in run("audit", recording)


def test_a_service_that_was_killed_and_started_again_comes_back(tmp_path: Path) -> None:
    """The device's process ends by name, a new one finds the service, and the session goes on."""
    with fake_haply(**HAND) as one:
        session = tmp_path / "inverse.yaml"
        session.write_text(SESSION.format(port=one.port, events=one.events, silence=0.2))
        report = tmp_path / "inverse.json"
        with started("launch", session, "--duration", "8", "--report", report) as launched:
            read_until(launched, ": running")
            while one.asked()["most"] < 0.05:
                time.sleep(0.01)  # until the world pushes back
            one.kill()
            one.start()
            while one.asked()["most"] < 0.05:
                time.sleep(0.01)  # until it does again
            _, error = launched.communicate(timeout=60.0)
            assert launched.returncode == 0, error
    found = json.loads(report.read_text())
    assert any("hand failed" in sentence and "ws://localhost" in sentence for sentence in found["incidents"])
    assert found["nodes"]["hand"]["ticks"] == 2000
