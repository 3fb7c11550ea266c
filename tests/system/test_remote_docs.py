"""The walk-through of docs/remote.md is executed between two machines, which are two namespaces of this one."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from ..support.commands import manyhands_command
from ..support.wan import Side, Wire, wan
from .test_design_docs import blocks, missing
from .test_design_docs import commands as typed_in
from .test_security_docs import PROMPT, Command, commands

PAGE = (Path(__file__).parents[2] / "docs" / "remote.md").read_text(encoding="utf-8")
SECTION = PAGE.split("## From an invitation to a felt ball\n")[1].split("\n## ")[0]
HOST = "192.0.2.7"  # the page's
SIDES: dict[str, Side] = {"host": "near", "left": "near", "look": "near", "right": "far"}
DEADLINE = 90.0  # s, for one command on a busy machine


class Terminal:
    """Runs one command after the other; one that goes on is left alone once its output is there."""

    def __init__(self, folder: Path, within: list[str]) -> None:
        self._folder, self._within = folder, within
        self._running: subprocess.Popen[bytes] | None = None
        self._output = b""

    def type(self, command: Command) -> None:
        """Enter a command."""
        if command.line == "^C":
            assert self._running is not None
            self._running.send_signal(signal.SIGINT)
            self.finish(command)
            return
        if command.line == "wait":
            self.finish(command)
            return
        answers = any(line.endswith("[y/N] y") for line in command.quoted)
        self._output = b""
        self._running = subprocess.Popen(
            [
                *self._within,
                "bash",
                "-c",
                command.line,
            ],  # bash becomes a single command, which the signals below then reach
            cwd=self._folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={**os.environ, "PATH": f"{self._folder / 'bin'}:{os.environ['PATH']}", "COLUMNS": "200"},
        )
        assert self._running.stdin is not None
        with self._running.stdin as stdin:
            stdin.write(b"y\n" if answers else b"")
        self._running.stdin = None
        if command.goes_on:
            self._read(command)
        else:
            self.finish(command)

    def finish(self, command: Command) -> None:
        """Wait for the command's end, and compare its output with the page."""
        process, self._running = self._running, None
        assert process is not None
        rest, _ = process.communicate(timeout=DEADLINE)
        output = (self._output + rest).decode()
        assert process.returncode == command.code, f"{command.line}: exit {process.returncode}\n{output}"
        assert not (lack := missing(expected(command), output)), f"{command.line} did not say {lack}, but\n{output}"

    def _read(self, command: Command) -> None:
        """Read until all of the quoted lines are there."""
        process = self._running
        assert process is not None
        assert process.stdout is not None
        end = time.monotonic() + DEADLINE
        while lack := missing(expected(command), self._output.decode()):
            left = end - time.monotonic()
            ready = left > 0 and select.select([process.stdout], [], [], left)[0]
            assert ready, f"{command.line} did not say {lack} within {DEADLINE} s, but\n{self._output.decode()}"
            chunk = os.read(process.stdout.fileno(), 65536)
            assert chunk, f"{command.line} ended with {process.wait()} without {lack}\n{self._output.decode()}"
            self._output += chunk

    def close(self) -> None:
        """End what still runs."""
        if self._running is not None:
            if self._running.poll() is None:  # one that has failed has ended already
                os.killpg(self._running.pid, signal.SIGTERM)
            self._running.communicate(timeout=DEADLINE)
            self._running = None


def expected(command: Command) -> list[str]:
    """The quoted lines; what the user types stands in the same line as what comes next."""
    return "\n".join(command.quoted).replace("[y/N] y\n", "[y/N] ").splitlines()


def program(folder: Path) -> None:
    """Put `manyhands` into a machine's folder."""
    path = folder / "bin" / "manyhands"
    path.parent.mkdir(parents=True)
    path.write_text(f'#!/bin/sh\nexec "{sys.executable}" -P -m manyhands "$@"\n')
    path.chmod(0o755)


@pytest.mark.long
def test_the_walk_through(tmp_path: Path) -> None:
    with wan(Wire(delay=0.01, jitter=0.002)) as net, ExitStack() as ending:
        typed = list(commands(SECTION.replace(HOST, net.address("near"))))
        folders: dict[Side, Path] = {"near": tmp_path, "far": tmp_path / "guest"}
        for folder in folders.values():
            program(folder)
        terminals = {name: Terminal(folders[side], net.within(side)) for name, side in SIDES.items()}
        for one in terminals.values():
            ending.callback(one.close)
        for command in typed:
            terminals[command.terminal].type(command)
    assert sorted(path.name for path in (tmp_path / "guest").iterdir()) == ["bin", "right_seat.invitation"]


@pytest.mark.usefixtures("own_interrupt")
def test_the_delay_can_be_tried_without_a_partner() -> None:
    (shown,) = blocks(PAGE.split("## Try the delay first\n")[1].split("\n## ")[0])
    ((arguments, code, quoted),) = typed_in(shown.text)
    done = manyhands_command(*arguments)
    assert done.exit_code == code, done.output
    assert len(quoted) == 2
    assert missing(quoted, done.output) == []


def test_the_page_has_its_terminals_and_commands() -> None:
    typed = list(commands(SECTION))
    assert {command.terminal for command in typed} == set(SIDES)
    assert len(typed) >= 9
    assert {command.line.split()[1] for command in typed if command.line.startswith("manyhands")} == {
        "host",
        "join",
        "top",
        "echo",
    }
    assert len(PROMPT.findall(SECTION)) == len(typed)
