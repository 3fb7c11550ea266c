"""The first ten minutes: the page's commands run in its order, in one folder, and print what it quotes."""

from __future__ import annotations

import re
import shlex
import signal
import urllib.request
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from ..support.commands import manyhands_command, read_until, started
from .test_design_docs import missing
from .test_installing_docs import PROJECT, rows

PAGE = (Path(__file__).parents[2] / "docs" / "tutorial.md").read_text(encoding="utf-8")
TYPED = re.compile(r"^(\w*)\$ manyhands (.*?)(?: +# exit (\d))?$\n((?:(?!\w*\$ ).*\n)*)", re.MULTILINE)
"""A terminal's name, a command, its exit code, and the lines of its output."""


def typed() -> list[tuple[str, list[str], int, list[str]]]:
    """The page's commands with their terminal, exit code and quoted output."""
    shown = "".join(re.findall(r"^```console\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL))
    return [
        (terminal, shlex.split(line), int(code or 0), [line for line in quoted.splitlines() if line])
        for terminal, line, code, quoted in TYPED.findall(shown)
    ]


@pytest.mark.usefixtures("own_interrupt")
def test_the_tutorial_runs_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    commands = [command for command in typed() if not command[0]]
    assert len(commands) == PAGE.count("\n$ manyhands ") == 9
    for _, arguments, code, quoted in commands:
        done = manyhands_command(*arguments)
        assert done.exit_code == code, (arguments, done.output)
        assert missing(quoted, done.output) == [], (arguments, done.output)
    assert (tmp_path / "simulated.png").stat().st_size > 10_000


def test_its_install_line_brings_what_its_commands_need() -> None:
    """By the table of docs/installing.md, whose parts are those of pyproject.toml."""
    (extra,) = re.findall(r"`pip install '\.\[(\w+)\]'`", PAGE)
    parts = {"base", extra}.union(*(Requirement(one).extras for one in PROJECT["optional-dependencies"][extra]))
    brought = {command for part in parts for command in rows()[part][1]}
    assert {arguments[0] for _, arguments, _, _ in typed()} <= brought


@pytest.mark.long
@pytest.mark.usefixtures("own_interrupt")
def test_the_two_terminals_show_what_they_say(tmp_path: Path) -> None:
    """A page is served that a browser may open; Ctrl-C ends both commands."""
    one, two = (command for command in typed() if command[0])
    (tmp_path / "two-hands.yaml").write_text(manyhands_command("sessions", "browser").stdout)
    slowed = ["--set", "period=0.01", "--set", "design.tau=0.004"]  # a busy machine has other work
    with started(*one[1], *slowed, cwd=tmp_path) as session:
        assert "(realtime, ipc), certificate" in read_until(session, ": running")
        with started(*two[1]) as page:
            address = re.search(r"http://127\.0\.0\.1:\S+", read_until(page, "http://127.0.0.1:"))
            assert address is not None
            with urllib.request.urlopen(address[0], timeout=60) as answer:
                assert b"<title>" in answer.read()
            page.send_signal(signal.SIGINT)
            page.communicate(timeout=60)
        session.send_signal(signal.SIGINT)
        session.communicate(timeout=60)
        assert (page.returncode, session.returncode) == (130, 130)
