"""A knob on a motor of either controller: felt in a session in real time, audited, and back after what goes wrong."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from ..fakes.moteus import fake_moteus
from ..fakes.odrive import fake_odrive
from ..fakes.rotor import FakeMotor, Rotor
from ..support.commands import read_until, run, started

SESSION = """
session: knob
period: 0.02
devices:
  knob:
    dof: 1
    axes: {{rz: rotation}}
    osp: 0.01
    driver: {driver}
    parameters: {{port: {port}, torque: 0.5, inertia: 0.0002, counts: 16384, silence: {silence},
                  sample_age: 0.001, actuation_delay: 0.0005}}
    sample_age: 0.001
    actuation_delay: 0.0005
    mass: 0.0002
    step: 0.0004
    limits: {{force: 0.5, displacement: 6, speed: 60}}
couplings:
  ck: {{devices: [knob]}}
environment:
  type: network
  links:
    - {{between: [knob.rz, ground], stiffness: 0.1}}
design: {{coupling: spring-damper, tau: 0.015, period_tolerance: 0.5}}
"""

HAND = Rotor(J=2e-4, b=0.01, k=0.2, amplitude=0.5, frequency=0.7)
"""Somebody holds the knob, and turns it."""

Fake = Callable[..., AbstractContextManager[FakeMotor]]
KINDS = pytest.mark.parametrize(("driver", "fake"), [("moteus", fake_moteus), ("odrive", fake_odrive)])


def session(folder: Path, driver: str, port: object, silence: float) -> Path:
    path = folder / "knob.yaml"
    path.write_text(SESSION.format(driver=driver, port=port, silence=silence))
    return path


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 30.0
    while not true():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.005)


@KINDS
@pytest.mark.alone  # its recording is judged in real time
def test_a_knob_is_felt_in_a_session_and_its_recording_holds(driver: str, fake: Fake, tmp_path: Path) -> None:
    with fake(HAND) as one:
        recording, report = tmp_path / "knob.mcap", tmp_path / "knob.json"
        path = session(tmp_path, driver, one.path, silence=0.9)
        run("launch", path, "--duration", "3", "--record", recording, "--report", report)
        assert one.asked()["torque"] == 0.0  # it was let go
    knob = json.loads(report.read_text())["nodes"]["knob"]
    assert knob["ticks"] == 150
    assert knob["peak_force"] > 0.01  # N·m; the hand pushes with up to 0.1, and the spring pushes back
    assert knob["interface"]["margin"] > 0.0  # from its bound
    assert ": holds (" in run("audit", recording)


@pytest.mark.long
@KINDS
def test_a_knob_comes_back_after_its_watchdog_and_after_it_was_unplugged(
    driver: str, fake: Fake, tmp_path: Path
) -> None:
    link, report = tmp_path / "port", tmp_path / "knob.json"
    with fake(HAND, link) as one:
        path = session(tmp_path, driver, link, silence=0.9)  # longer than the stall, also on a busy machine
        with started("launch", path, "--duration", "6", "--report", report) as launched:
            read_until(launched, ": running")
            until(lambda: one.asked()["torque"] != 0.0)  # the world pushes back
            expired = one.asked()["expired"]
            one.order("stall 400")
            until(lambda: one.asked()["expired"] > expired)  # nothing is exerted, though nobody said so
            until(lambda: one.asked()["torque"] != 0.0)  # the same process has armed it again
            with fake(HAND, link) as other:
                one.unplug()
                until(lambda: other.asked()["torque"] != 0.0)  # a new process, on the port as it is now
                _, error = launched.communicate(timeout=60.0)
                assert launched.returncode == 0, error
    found = json.loads(report.read_text())
    said = [sentence for sentence in found["incidents"] if "knob failed" in sentence]
    assert said
    assert all("port: found" in sentence and "see that" in sentence for sentence in said), said
    assert found["nodes"]["knob"]["ticks"] == 300
