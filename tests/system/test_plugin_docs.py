"""Drivers and models of other packages: the pages are followed as they stand, in a folder outside the repository."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from ..support.commands import MANYHANDS, forked, manyhands_command, run

ROOT = Path(__file__).parents[2]
PAGES = {"drivers": ("my_joystick.py", "joystick.yaml"), "models": ("my_world.py", "room.yaml")}
EITHER = ["drivers", pytest.param("models", marks=pytest.mark.long)]


def manyhands(*arguments: str, cwd: Path, path: str = "") -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    if not path:
        return forked(*arguments, cwd=cwd, environment=environment)
    environment["PYTHONPATH"] = path
    return subprocess.run(
        [*MANYHANDS, *arguments], cwd=cwd, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


def written(page: str, folder: Path) -> str:
    """Write the files of a page into a folder; returns its text."""
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    for name, content in re.findall(r"<!-- file: (\S+) -->\n```\w+\n(.*?)```", text, flags=re.DOTALL):
        (folder / name).write_text(content, encoding="utf-8")
    return text


@pytest.mark.long
@pytest.mark.alone  # `check-driver` judges how long calls take, by the clock
@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_followed_from_its_template_to_a_recording(page: str, tmp_path: Path) -> None:
    text, (template, _) = written(page, tmp_path), PAGES[page]
    assert len((tmp_path / template).read_text().splitlines()) < 40
    commands = re.findall(r"^\$ manyhands (.*)$", text, flags=re.MULTILINE)
    assert len(commands) >= 5
    if page == "drivers":
        pytest.importorskip("mujoco")  # of the pen
    for line in commands:
        command, _, comment = line.partition(" #")
        expected = int(comment.split()[1]) if comment else 0
        done = manyhands(*shlex.split(command), cwd=tmp_path)
        assert done.returncode == expected, f"{command}: {done.stdout}{done.stderr}"
        runs_code = command.split()[0] in ("simulate", "launch", "replay")
        assert ("runs the code of the" in done.stderr) == runs_code, command


@pytest.mark.parametrize("page", EITHER)
def test_it_runs_in_real_time_and_its_device_is_let_go(page: str, tmp_path: Path) -> None:
    written(page, tmp_path)
    session, report = PAGES[page][1], tmp_path / "report.json"
    arguments = ["--duration", "0.5", "--set", "design.tau=0.0005", "--report", str(report)]
    done = manyhands("launch", session, *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    nodes = json.loads(report.read_text())["nodes"]
    assert {node["ticks"] for node in nodes.values()} == {500}
    if page == "drivers":  # the driver's 0.3 ms are in every delay of its device
        assert nodes["stick"]["tau_us"]["p50"] > max(300.0, nodes["other"]["tau_us"]["p50"])


def test_the_arm_of_the_page_tells_the_exact_work_of_its_torques(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Held for 60 ms they do what the mass has and the damping burns, and 6 % more than the force along the way."""
    written("drivers", tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    board: Any = import_module("my_arm").ArmBoard("simulated")
    f, burned = (2.5, 1.5), 0.0
    board.positions(0)
    board.exert(list(f), 0, None)
    for step in range(1, 1201):
        board.positions(step * 50_000)
        burned += 1.5 * sum(v * v for v in board.v) * 50e-6
    kinetic, ports = 0.1 * sum(v * v for v in board.v), sum(a * b for a, b in zip(f, board.x, strict=True))
    assert board.done == pytest.approx(kinetic + burned, rel=1e-3)
    assert board.done / ports == pytest.approx(1.06, abs=0.01)
    for name in ("my_arm", "my_joystick", "board"):
        sys.modules.pop(name, None)


def test_the_arm_of_the_page_runs_in_real_time_under_a_certificate_of_its_torques(tmp_path: Path) -> None:
    text = written("drivers", tmp_path)
    (line,) = re.findall(r"^\$ manyhands simulate (joystick.yaml .*my_arm:Arm.*)$", text, flags=re.MULTILINE)
    report = tmp_path / "report.json"
    arm = [*shlex.split(line), "--duration", "0.5", "--set", "design.tau=0.0005", "--report", str(report)]
    done = manyhands("launch", *arm, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = manyhands("design", *(part for part in arm[:-2] if part not in ("--duration", "1", "0.5")), cwd=tmp_path)
    assert re.search(r"held torques .*stick: .* proved of its kinematics", said.stdout)
    nodes = json.loads(report.read_text())["nodes"]
    assert nodes["stick"]["ticks"] == 500


UNPLUGGED = """
from my_joystick import Joystick as Good


class Joystick(Good):
    def sample(self, tick, at):
        if tick == 200:
            raise OSError("unplugged")
        return super().sample(tick, at)

    def release(self, at):
        print("released", file=open("calls", "a"))
        super().release(at)

    def close(self):
        print("closed", file=open("calls", "a"))
        super().close()
"""


@pytest.mark.long
def test_a_driver_that_fails_is_released_and_named_and_ends_a_session_that_is_to_stay_together(tmp_path: Path) -> None:
    written("drivers", tmp_path)
    (tmp_path / "unplugged.py").write_text(UNPLUGGED)
    broken = ["joystick.yaml", "--duration", "1", "--set", "devices.stick.driver=unplugged:Joystick"]
    for command in (["launch", *broken, "--clock", "simulated", "--together"], ["simulate", *broken]):
        done = manyhands(*command, cwd=tmp_path)
        assert done.returncode == 1, done.stderr
        assert "the driver unplugged:Joystick failed in sample: found OSError: unplugged" in done.stderr
        assert "Traceback" not in done.stderr
    assert (tmp_path / "calls").read_text().split() == ["released", "closed", "closed"]
    greedy = ["joystick.yaml", "--duration", "1", "--set", "devices.stick.limits.force=4", "--clock", "simulated"]
    refused = manyhands("launch", *greedy, cwd=tmp_path)
    assert refused.returncode == 1
    expected = "states: limits.force: found 4 N; expected at most 3 N"
    assert f"devices.stick: the session promises more than its driver my_joystick:Joystick {expected}" in refused.stderr


@pytest.mark.alone  # likewise
def test_an_installed_package_publishes_a_driver_and_a_model_by_short_names(tmp_path: Path) -> None:
    """A distribution in a folder on the path, with its metadata, is one that is installed there."""
    site, work = tmp_path / "site", tmp_path / "work"
    for page in PAGES:
        for folder in (site, work):
            folder.mkdir(exist_ok=True)
            written(page, folder)
    for module in work.glob("*.py"):
        module.unlink()
    metadata = site / "joystick-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: joystick\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        "[manyhands.drivers]\njoystick = my_joystick:Joystick\n[manyhands.models]\nroom = my_world:Room\n"
    )
    found = manyhands("check-driver", "joystick", "--dof", "1", cwd=work, path=str(site))
    assert found.returncode == 0, found.stdout + found.stderr
    by_short_name = ["--set", "devices.stick.driver=joystick"]
    done = manyhands("simulate", "joystick.yaml", "--duration", "0.1", *by_short_name, cwd=work, path=str(site))
    assert done.returncode == 0, done.stderr
    assert "the driver my_joystick:Joystick, which is not confined (devices.stick.driver)" in done.stderr
    assert "it is from Python's import path" in done.stderr
    model = ["--set", "environment.model=room"]
    done = manyhands("simulate", "room.yaml", "--duration", "0.1", *model, cwd=work, path=str(site))
    assert done.returncode == 0, done.stderr
    absent = manyhands("simulate", "joystick.yaml", *by_short_name, cwd=work)
    assert absent.returncode == 2
    assert "found 'joystick'; expected one of simulated, trace, browser" in absent.stderr


NOISY = "raise SystemExit('this code ran')\n"


CODELESS = (
    ["design", "{}"],
    ["budget", "{}"],
    ["graph", "{}"],
    ["graph", "{}", "--access"],
    ["invite", "{}", "--keys", "keys"],
    ["invite", "{}", "NODE", "--insecure", "--uncertified", "-o", "node.bundle"],
)


@pytest.mark.usefixtures("own_interrupt")
@pytest.mark.parametrize("page", EITHER)
def test_commands_that_need_no_code_run_none(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(page, tmp_path)
    template, session = PAGES[page]
    node = {"drivers": "stick", "models": "environment"}[page]
    (tmp_path / template).write_text(NOISY)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for command in CODELESS:
        done = manyhands_command(*({"{}": session, "NODE": node}.get(part, part) for part in command))
        assert done.exit_code == 0, (command, done.stderr)
        assert "this code ran" not in done.output
    monkeypatch.undo()
    ran = manyhands("simulate", session, "--duration", "0.1", cwd=tmp_path)
    assert ran.returncode == 2
    assert "this code ran" in ran.stderr


@pytest.mark.parametrize("page", EITHER)
def test_a_bundle_from_elsewhere_runs_its_code_only_where_the_user_names_it(page: str, tmp_path: Path) -> None:
    written(page, tmp_path)
    template, session = PAGES[page]
    node, factory = {
        "drivers": ("stick", "my_joystick:Joystick"),
        "models": ("environment", "my_world:Room"),
    }[page]
    run("invite", session, node, "--insecure", "--uncertified", "-o", "n.bundle", cwd=tmp_path)
    assert str(tmp_path) not in (tmp_path / "n.bundle").read_text()
    (tmp_path / template).write_text(NOISY)
    join = ["node", node, "--bundle", "n.bundle", "--connect", "tcp://127.0.0.1:1"]
    for allowed in ([], ["--allow-code", "other:code"]):
        done = manyhands(*join, *allowed, cwd=tmp_path, path=str(tmp_path))
        assert done.returncode == 2
        assert f"expected --allow-code {factory}" in done.stderr
        assert "this code ran" not in done.stderr


@pytest.mark.long
@pytest.mark.usefixtures("own_interrupt")
def test_a_recording_brings_no_code_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """audit and info run none; replay runs a model that is on the user's own path, and a driver never."""
    for page, (template, session) in PAGES.items():
        folder = tmp_path / page
        folder.mkdir()
        written(page, folder)
        launch = ["launch", session, "--clock", "simulated", "--duration", "0.1", "--record", "run.mcap"]
        assert manyhands(*launch, cwd=folder).returncode == 0
        (folder / template).write_text(NOISY)
        with monkeypatch.context() as here:
            here.chdir(folder)
            here.syspath_prepend(folder)
            for command in ("audit", "info"):
                done = manyhands_command(command, "run.mcap")
                assert done.exit_code == 0, done.stderr
                assert "this code ran" not in done.output
        again = manyhands("replay", "run.mcap", cwd=folder, path=str(folder))
        assert ("this code ran" in again.stderr) == (page == "models")
        assert again.returncode == (2 if page == "models" else 0), again.stderr
        assert sys.executable not in again.stderr
        if page == "models":  # and from a folder that the user names
            absent = manyhands("replay", "run.mcap", cwd=folder)
            assert absent.returncode == 2
            assert "cannot be made: found ModuleNotFoundError" in absent.stderr
            named = manyhands("replay", "run.mcap", "--code-in", ".", cwd=folder)
            assert named.returncode == 2
            assert "this code ran" in named.stderr
