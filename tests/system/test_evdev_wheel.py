"""A fake wheel in real processes, whose own calls of the C library reach it: felt, audited, unplugged, and back."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path

import pytest

from manyhands.devices.evdev.bus import tick

from ..fakes.wheel import FakeWheel, Turn, fake_wheel
from ..support.commands import MANYHANDS, read_until, run, started

SESSION = """
session: wheel
period: 0.008
devices:
  wheel:
    dof: 1
    axes: rotation
    osp: 0.05
    driver: evdev-wheel
    parameters: {{device: {device}, range: 15.0, most: 2.0, sample_age: 0.002, actuation_delay: 0.004}}
    sample_age: 0.002
    actuation_delay: 0.004
    mass: 0.0299
    step: 0.00023
    friction: {{least: 0.05}}
    limits: {{force: 2, displacement: 7, speed: 20}}
couplings:
  cw: {{devices: [wheel]}}
environment:
  type: network
  links:
    - {{between: [wheel.0, ground], stiffness: 3}}
design: {{coupling: spring-damper, speed: 4, tau: 0.008, period_tolerance: 0.5}}
"""

HANDS = Turn(m=0.03, b=0.06, c=0.06, k=4.0, amplitude=0.4, frequency=0.5)
"""Hands that turn a geared wheel to and fro, 1.3 rad/s at most."""

PAGE = Path(__file__).parents[2] / "docs" / "devices" / "steering-wheels.md"

HZ = round(1.0 / tick())
"""The fake counts in ticks like the kernel's own, to whose clock the driver looks."""


def preloaded(one: FakeWheel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every process that starts from now on has the fake."""
    for name, value in one.environment.items():
        monkeypatch.setenv(name, value)


@pytest.mark.parametrize("kind", ["pid", pytest.param("lg4ff", marks=pytest.mark.long)])
@pytest.mark.alone  # its recording is judged in real time
def test_a_wheel_is_felt_in_a_session_and_its_recording_holds(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with fake_wheel(HANDS, kind=kind, hz=HZ) as one:
        preloaded(one, monkeypatch)
        session = tmp_path / "wheel.yaml"
        session.write_text(SESSION.format(device=one.path))
        recording, report = tmp_path / "wheel.mcap", tmp_path / "wheel.json"
        run("launch", session, "--duration", "3", "--record", recording, "--report", report)
        counts = one.asked()[2]
    wheel = json.loads(report.read_text())["nodes"]["wheel"]
    assert wheel["ticks"] == 375
    assert wheel["peak_force"] > 0.1
    assert wheel["interface"]["margin"] > 0.0  # from its bound
    assert (counts["opened"], counts["grabbed"], counts["playing"]) == (1, 0, 0)
    assert counts["uploads"] > 100
    assert ": holds (" in run("audit", recording)


@pytest.mark.long
def test_a_wheel_that_is_unplugged_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its device's process ends by name, a new one opens it anew, and the session goes on."""
    with fake_wheel(HANDS, hz=HZ) as one:
        preloaded(one, monkeypatch)
        session = tmp_path / "wheel.yaml"
        session.write_text(SESSION.format(device=one.path))
        report = tmp_path / "wheel.json"
        with started("launch", session, "--duration", "6", "--report", report) as launched:
            read_until(launched, ": running")
            while one.asked()[1] == [0.0]:
                time.sleep(0.01)  # until the world pushes back
            one.order("unplug")
            assert one.asked()[1] == [0.0]  # a wheel without its bus has no torque
            while one.asked()[2]["grabbed"]:
                time.sleep(0.01)  # until its process has ended
            one.order("plug")
            _, error = launched.communicate(timeout=60.0)
            assert launched.returncode == 0, error
        opened = one.asked()[2]["opened"]
    found = json.loads(report.read_text())
    assert any("wheel failed" in sentence and "found it unplugged" in sentence for sentence in found["incidents"])
    assert opened >= 2
    assert found["nodes"]["wheel"]["ticks"] == 750


def test_the_suite_for_drivers_finds_nothing_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over the calls of the C library; tests/devices/evdev/test_suite.py has what it finds wrong."""
    with fake_wheel(Turn(m=0.03, b=0.05), kind="pid", hz=HZ) as one:
        preloaded(one, monkeypatch)
        given = f"{{device: {one.path}, range: 15.0, most: 2.0, sample_age: 0.002, actuation_delay: 0.004}}"
        done = subprocess.run(
            [*MANYHANDS, "check-driver", "evdev-wheel", "--parameters", given, "--no-push", "--json"],
            capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        opened = one.asked()[2]["opened"]
    found = {judged["check"]: judged["verdict"] for judged in json.loads(done.stdout)["findings"]}
    assert (found["exception"], found["close"], opened) == ("ok", "ok", 1), done.stdout


def test_the_session_of_the_page_is_certified_for_what_the_page_says(tmp_path: Path) -> None:
    page = PAGE.read_text(encoding="utf-8")
    session = tmp_path / "wheel.yaml"
    session.write_text(page.split("<!-- file: wheel.yaml -->\n```yaml\n")[1].split("```")[0])
    said = page.split("$ manyhands design wheel.yaml\n")[1].split("$")[0].splitlines()
    out = run("design", session, "-o", tmp_path / "wheel.cert.json")
    for line in said:
        assert " ".join(line.split()) in " ".join(out.replace("\u2502", " ").split()), out
