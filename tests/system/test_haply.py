"""A fake Inverse Service with somebody at its devices: a session in real time, audited, and back after its end."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from ..fakes.haply import FakeHaply, fake_haply
from ..support.commands import read_until, run, started

DEVICE = """
  {name}:
    dof: 3
    axes: [x, y, z]
    osp: 1.0
    driver: haply-inverse3
    parameters:
      {{port: {port}, events: {events}, device_id: "{id}", silence: {silence}, force: 5, sample_age: 0.002,
        actuation_delay: 0.001}}
    sample_age: 0.002
    actuation_delay: 0.001
    held: torque
    linkage: {{kappa: 8}}
    limits: {{force: 5, displacement: 0.15, speed: 1}}
"""

SESSION = """
session: inverse
period: 0.004
devices:
{devices}
couplings:
{couplings}
environment:
  type: network
  links:
{links}
design: {{coupling: spring-damper, tau: 0.004, period_tolerance: 0.5}}
"""


def session(one: FakeHaply, silence: float, **ids: str) -> str:
    """Devices with these ids, which springs hold at their origin."""
    at = {"port": one.port, "events": one.events, "silence": silence}
    return SESSION.format(
        devices="".join(DEVICE.format(name=name, id=id, **at) for name, id in ids.items()),
        couplings="\n".join(f"  c{name}: {{devices: [{name}]}}" for name in ids),
        links="\n".join(
            f"    - {{between: [{name}.{axis}, ground], stiffness: 60}}" for name in ids for axis in ("x", "y", "z")
        ),
    )


HAND = {"mass": 0.15, "damping": 1.0, "step": 0.001, "hand": 100.0, "amplitude": 0.015}
"""Somebody holds the device, and moves."""


@pytest.mark.alone  # its recording is judged in real time
def test_two_devices_of_one_service_are_felt_in_a_session_and_its_recording_holds(tmp_path: Path) -> None:
    with fake_haply(devices=["049D", "04BA"], **HAND) as one:
        path = tmp_path / "inverse.yaml"
        path.write_text(session(one, 0.9, hand="049D", other="04BA"))
        recording, report = tmp_path / "inverse.mcap", tmp_path / "inverse.json"
        run("launch", path, "--duration", "3", "--record", recording, "--report", report)
        ends = [one.asked("049D"), one.asked("04BA")]
    nodes = json.loads(report.read_text())["nodes"]
    for name, end in zip(("hand", "other"), ends, strict=True):
        assert end["f"] == [0.0, 0.0, 0.0]
        assert end["most"] > 0.1  # N, what the motors have really done
        assert end["enabled"] == {"gravity_compensation": True, "torque_scaling": True}  # as it was before
        assert nodes[name]["ticks"] == 750
        assert nodes[name]["peak_force"] > 0.1
        assert nodes[name]["interface"]["margin"] > 0.0  # from its bound
    assert ": holds (" in run("audit", recording)


@pytest.mark.long
def test_a_service_that_was_killed_and_started_again_comes_back(tmp_path: Path) -> None:
    """The device's process ends by name, a new one finds the service, and the session goes on."""
    with fake_haply(**HAND) as one:
        path = tmp_path / "inverse.yaml"
        path.write_text(session(one, 0.2, hand="049D"))
        report = tmp_path / "inverse.json"
        with started("launch", path, "--duration", "8", "--report", report) as launched:
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
