"""docs/installing.md is true: its commands run, its parts are those of pyproject.toml, its refusal is the program's."""

from __future__ import annotations

import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from manyhands.extras import EXTRAS
from manyhands.launch.app.cli import GROUPS
from manyhands.nodes.kernel.realtime import FIFO_PRIORITY, NETWORK_NICE

from ..support.commands import forked, manyhands_command
from ..support.installed import NEEDED
from .test_docs import commands

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "installing.md").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def rows() -> dict[str, tuple[str, set[str]]]:
    """The table of parts: what each brings, and the commands that it is for."""
    known = {name for group in GROUPS.values() for name in group}
    found = {}
    for name, brings, purpose in re.findall(
        r"^\| (base|`\w+`) \| (.*?) \| (.*?) \| [\d ]+ \|$", PAGE, flags=re.MULTILINE
    ):
        found[name.strip("`")] = brings, known & set(re.findall(r"`([\w-]+)`", purpose))
    return found


def libraries(requirements: list[str]) -> set[str]:
    return {Requirement(text).name for text in requirements}


def test_its_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that are the README's as well run with that page."""
    monkeypatch.chdir(tmp_path)
    found = commands(PAGE)
    assert len(found) == 5
    already = commands((ROOT / "README.md").read_text(encoding="utf-8"))
    own = [command for command in found if command not in already]
    assert len(own) >= 3
    for arguments, expected in own:
        done = forked(*arguments)
        assert done.returncode == expected, f"{arguments}: {done.stderr}"


def test_its_parts_bring_what_is_declared() -> None:
    declared = {"base": PROJECT["dependencies"], **PROJECT["optional-dependencies"]}
    for part in ("base", "design", "record", "plot", "view"):
        assert set(rows()[part][0].split(", ")) == libraries(declared[part])


def test_it_names_the_part_of_every_command() -> None:
    """A command stands in the row of each extra that it needs; the others stand in the base's."""
    found = {part: commands for part, (_, commands) in rows().items()}
    every = {name for group in GROUPS.values() for name in group}
    assert found["base"] == every - NEEDED.keys()
    for extra in ("design", "record", "plot", "view"):
        needing = {name for name, extras in NEEDED.items() if extra in extras.split(",")}
        alone = {name for name, extras in NEEDED.items() if extras == extra}
        assert alone <= found[extra]
        assert found[extra] - needing <= EXTRAS.keys()  # an extra is mentioned, and a command has its name
    text = " ".join(PAGE.split())
    for name in NEEDED:
        assert f"`{name}`" in text


def test_every_extra_that_it_installs_is_there() -> None:
    named = {extra for listed in re.findall(r"(?:manyhands|\.)\[([\w,]+)\]'", PAGE) for extra in listed.split(",")}
    assert {"all", "design", "record"} <= named <= {*EXTRAS, "all"}


@pytest.mark.usefixtures("own_interrupt")
def test_the_refusal_that_it_quotes_is_the_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    (line, quoted) = re.findall(r"^\$ manyhands (.*)\n(error: .*)$", PAGE, flags=re.MULTILINE)[0]
    for module in EXTRAS["design"]:
        monkeypatch.setitem(sys.modules, module, None)
    done = manyhands_command(*shlex.split(line))
    assert (done.exit_code, done.stderr.strip()) == (2, quoted)


def test_its_rights_are_those_that_nodes_ask_for() -> None:
    assert f"SCHED_FIFO at priority {FIFO_PRIORITY}," in PAGE
    assert f"`rtprio {FIFO_PRIORITY}`" in PAGE
    assert f"`nice {NETWORK_NICE}`" in PAGE
    assert f"--ulimit rtprio={FIFO_PRIORITY} --ulimit memlock=-1 --ulimit nice={20 - NETWORK_NICE} " in PAGE
