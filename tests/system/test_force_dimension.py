"""A fake omega on the desk: in a session in real time whose linkage is stated, audited, and back after unplugging."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from ..fakes.dhd import LINKAGE, MIDDLE, FakeDevices, fake_devices
from ..support.commands import read_until, run, started

REACH = 0.02

KINEMATICS = {
    **LINKAGE, "low": [-REACH, -REACH, MIDDLE - REACH], "high": [REACH, REACH, MIDDLE + REACH],
    "kappa": 14,  # it is 10.0; a greater one is proved in less time
}  # fmt: skip

SESSION = """
session: omega
period: 0.004
devices:
  omega:
    dof: 3
    axes: [x, y, z]
    osp: 1.5
    driver: force-dimension
    parameters: {{library: {library}, reach: 0.02, silence: 0.9, sample_age: 0.0005, actuation_delay: 0.0005}}
    axis_map: [y, z, x]
    sample_age: 0.0005
    actuation_delay: 0.0005
    step: 0.0001
    held: torque
    linkage: {linkage}
    limits: {{force: 3, displacement: 0.02, speed: 0.5}}
couplings:
  hand: {{devices: [omega]}}
environment:
  type: network
  links:
    - {{between: [omega.x, ground], stiffness: 100}}
    - {{between: [omega.y, ground], stiffness: 100}}
    - {{between: [omega.z, ground], stiffness: 100}}
design: {{coupling: spring-damper, tau: 0.003, period_tolerance: 0.5}}
"""


@pytest.fixture
def devices() -> Iterator[FakeDevices]:
    """Somebody holds it, and moves."""
    with fake_devices() as found:
        for line in ("plant 0.2 1.5 0", "hand 100 0.7", "to 0.012 0.008 -0.01"):
            found.order(line)
        yield found


def session_of(folder: Path, devices: FakeDevices, linkage: object) -> Path:
    path = folder / "omega.yaml"
    path.write_text(SESSION.format(library=devices.path, linkage=json.dumps(linkage)), encoding="utf-8")
    return path


@pytest.mark.alone  # its recording is judged in real time
def test_a_device_is_felt_in_a_session_and_its_recording_holds(tmp_path: Path, devices: FakeDevices) -> None:
    recording, report = tmp_path / "omega.mcap", tmp_path / "omega.json"
    session = session_of(tmp_path, devices, KINEMATICS)
    run("launch", session, "--duration", "3", "--record", recording, "--report", report)
    omega = json.loads(report.read_text())["nodes"]["omega"]
    assert omega["ticks"] == 750
    assert omega["peak_force"] > 0.2  # the hand pushes with up to 1.5 N, and the world pushes back
    assert omega["interface"]["margin"] >= 0.0  # from its bound
    audited = run("audit", recording)
    assert ": holds (" in audited
    assert "torques," in audited  # the driver's work is that of the stated kinematics


@pytest.mark.long
def test_a_device_that_is_unplugged_comes_back(tmp_path: Path, devices: FakeDevices) -> None:
    report = tmp_path / "omega.json"
    with started(
        "launch", session_of(tmp_path, devices, {"kappa": 12}), "--duration", "6", "--report", report
    ) as launched:
        read_until(launched, ": running")
        while not any(devices.asked().t):
            time.sleep(0.01)  # until the world pushes back
        devices.order("unplugged 1")
        time.sleep(0.05)
        devices.order("unplugged 0")
        _, error = launched.communicate(timeout=60.0)
        assert launched.returncode == 0, error
    found = json.loads(report.read_text())
    assert any("omega failed" in sentence and "communication error" in sentence for sentence in found["incidents"])
    assert found["nodes"]["omega"]["ticks"] == 1500
