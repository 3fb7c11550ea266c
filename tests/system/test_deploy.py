"""The container image, the compose file and the unit name commands, files and rights that there are.

No image is built here, and no unit is started. What these files say of manyhands is held against it.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from configparser import ConfigParser
from pathlib import Path
from typing import Any

import click
import pytest
import typer
import yaml

from manyhands.extras import EXTRAS
from manyhands.launch.app.cli import app
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.kernel.realtime import FIFO_PRIORITY, NETWORK_NICE

from ..support.installed import PURE, run
from ..support.rooms import ROOMS

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
CONTAINERFILE = (DEPLOY / "Containerfile").read_text()
UNIT = DEPLOY / "manyhands-host@.service"


def services() -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]
    return found


def service_section() -> dict[str, str]:
    parser = ConfigParser(strict=False, interpolation=None, delimiters=("=",))
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(UNIT)
    return dict(parser["Service"])


def instructions(stage: int) -> list[list[str]]:
    """The instructions of a stage of the image, split into words."""
    text = re.sub(r"\\\n", " ", re.sub(r"^ *#.*\n", "", CONTAINERFILE, flags=re.MULTILINE))
    return [line.split() for line in re.split(r"^(?=FROM )", text, flags=re.MULTILINE)[stage].splitlines() if line]


def require_parses(arguments: list[str]) -> None:
    """The program has this command with these options."""
    name, *rest = arguments
    command = typer.main.get_group(app).get_command(None, name)
    assert command is not None, f"there is no command {name}"
    try:
        command.make_context(name, rest)
    except click.exceptions.UsageError as error:
        pytest.fail(f"{arguments}: {error.format_message()}")


def without_variables(text: str) -> str:
    """A text in which each variable of the shell has some value."""
    return re.sub(r"\$\{[^}]*\}", "192.0.2.7", text)


def test_every_command_that_the_files_run_parses() -> None:
    for service in services().values():
        require_parses([without_variables(argument) for argument in service["command"]])
    program, *arguments = shlex.split(without_variables(service_section()["ExecStart"]))
    assert program.endswith("/manyhands")
    require_parses(arguments)
    last = {words[0]: " ".join(words[1:]) for words in instructions(2)}
    assert last["ENTRYPOINT"] == '["manyhands"]'
    assert last["CMD"] == '["--help"]'


def test_the_rights_are_those_that_nodes_ask_for_and_no_more() -> None:
    wanted = {"rtprio": FIFO_PRIORITY, "memlock": -1, "nice": 20 - NETWORK_NICE}
    for service in services().values():
        assert service["ulimits"] == wanted
        assert service["cap_drop"] == ["ALL"]
        assert not service.keys() & {"cap_add", "privileged", "devices", "ipc", "pid"}
        assert not service["user"].startswith("0")
        assert "no-new-privileges:true" in service["security_opt"]
        assert service["read_only"] is True
    unit = service_section()
    assert int(unit["LimitRTPRIO"]) == FIFO_PRIORITY
    assert int(unit["LimitNICE"]) == NETWORK_NICE
    assert unit["LimitMEMLOCK"] == "infinity"
    assert unit["CapabilityBoundingSet"] == unit["AmbientCapabilities"] == ""
    assert (unit["NoNewPrivileges"], unit["DynamicUser"]) == ("yes", "yes")
    assert "RestrictRealtime" not in unit


def test_each_guest_is_handed_its_own_invitation_alone() -> None:
    compose = services()
    session = compose.pop("session")
    handed = []
    for service in compose.values():
        (mount,) = service["volumes"]
        assert mount["read_only"] is True
        assert mount["bind"] == {"create_host_path": False}  # a folder of that name would be made otherwise
        assert service["command"] == ["join", mount["target"]]
        handed.append(mount["source"])
    folder = session["volumes"][0].partition(":")[0]
    assert handed == [f"{folder}/{seat}.invitation" for seat in load_named("ball").wave_links]


def test_the_image_is_built_from_what_a_wheel_needs(tmp_path: Path) -> None:
    """The files that the first stage copies give the whole wheel."""
    source = tmp_path / "source"
    source.mkdir()
    for instruction, *words in instructions(1):
        assert instruction in ("FROM", "ARG", "WORKDIR", "COPY", "RUN")
        if instruction == "COPY":
            *names, target = words
            for name in names:
                if (ROOT / name).is_dir():
                    shutil.copytree(ROOT / name, source / target, symlinks=True)
                else:
                    shutil.copy(ROOT / name, source / target)
    command = [sys.executable, "-P", "-m", "build", "--no-isolation", "--wheel", "--outdir", tmp_path]
    run(*command, source, cwd=tmp_path, **PURE)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if name.startswith("manyhands/") and "__pycache__" not in name}
    expected = [path for path in (ROOT / "src" / "manyhands").iterdir() if not path.is_symlink()]
    files = {f"manyhands/{path.name}" for path in expected if path.is_file()}
    for room in ROOMS:
        expected = [path for path in (ROOT / room).rglob("*") if "__pycache__" not in path.parts]
        files |= {f"manyhands/{path.relative_to(ROOT)}" for path in expected if path.is_file()}
    assert held == files


def test_the_image_runs_as_nobody_in_particular_without_tools() -> None:
    (build, *_), last = instructions(1), instructions(2)
    given = dict(words[1].split("=") for words in instructions(0) if words[0] == "ARG")
    assert given["BUILD"].endswith("python:${PYTHON}-bookworm")
    assert given["RUN"] == given["BUILD"].replace("-bookworm", "-slim-bookworm")
    assert (build, last[0]) == (["FROM", "${BUILD}", "AS", "build"], ["FROM", "${RUN}"])
    users = [words[1] for words in last if words[0] == "USER"]
    assert users == ["10001:10001"]
    assert not [words for words in last if words[0] == "ADD" or "pip" in words or "apt-get" in words]
    (default,) = [words[1] for words in instructions(1) if words[0] == "ARG"]
    assert set(default.removeprefix("EXTRAS=").split(",")) <= EXTRAS.keys()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_understands_the_unit(tmp_path: Path) -> None:
    text = UNIT.read_text().replace("/opt/manyhands/bin/manyhands", sys.executable)
    copy = tmp_path / "manyhands-host@ball.service"
    copy.write_text(text)
    done = subprocess.run(["systemd-analyze", "verify", copy], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
