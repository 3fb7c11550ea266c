"""docs/security.md is executed: its terminals are shells, and its commands run in order with the quoted output."""

from __future__ import annotations

import os
import re
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import pytest

from manyhands.launch.plan.bundles import RunPlan, bundle_of
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.reach import Listen, reach
from manyhands.launch.plan.topology import topology
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.bundle import DeviceBundle
from manyhands.nodes.rows import figures as names
from manyhands.protocol.gate import DROP_REASONS
from manyhands.protocol.transport import Trouble
from manyhands.protocol.transport.door import NotAdmitted
from manyhands.protocol.transport.zeromq import HUB_DROPS

from ..support.capture import free_ports
from .test_design_docs import blocks, missing

PAGE = (Path(__file__).parents[2] / "docs" / "security.md").read_text(encoding="utf-8")
PORT = 7400  # the page's
PORTS = 6
SESSION = "two-hands.yaml"
DEADLINE = 120.0  # s, for a command of the page on a busy machine
PROMPT = re.compile(r"^(\w+)\$ ", flags=re.MULTILINE)


@dataclass(frozen=True)
class Command:
    """A command at a terminal, and its expected output."""

    terminal: str
    line: str
    code: int
    goes_on: bool
    quoted: list[str]


def commands(text: str) -> Iterator[Command]:
    """The commands of the console blocks, in the page's order."""
    for block in blocks(text):
        if block.language != "console":
            continue
        parts = PROMPT.split(block.text)
        for terminal, part in zip(parts[1::2], parts[2::2], strict=True):
            line, *quoted = part.strip().splitlines()
            line, _, comment = line.partition("    # ")
            stated = re.search(r"exit (\d+)", comment)
            yield Command(terminal, line, int(stated[1]) if stated else 0, "goes on" in comment, quoted)


class Terminal:
    """A shell that keeps its folder and its background jobs from one command to the next."""

    _PROMPT = "--- the command has ended with"

    def __init__(self, shell: subprocess.Popen[bytes]) -> None:
        assert shell.stdin is not None
        assert shell.stdout is not None
        self._stdin: IO[bytes] = shell.stdin
        self._stdout: IO[bytes] = shell.stdout
        self._waits: Command | None = None
        self.wrong: list[str] = []

    def type(self, command: Command) -> None:
        """Enter a command, once the one before has ended."""
        self.finish()
        self._stdin.write(f"{command.line}\necho {self._PROMPT} $?\n".encode())
        self._stdin.flush()
        self._waits = command
        if not command.goes_on:
            self.finish()

    def finish(self) -> None:
        """Wait for the last command's end, and compare its output with the page."""
        command, self._waits = self._waits, None
        if command is None:
            return
        output, code = self._read()
        if code != command.code:
            self.wrong.append(f"{command.line}: exit {code}, expected {command.code}\n{output}")
        self.wrong += [f"{command.line} did not say: {line}\n{output}" for line in missing(command.quoted, output)]

    def _read(self) -> tuple[str, int]:
        heard, deadline = b"", time.monotonic() + DEADLINE
        with selectors.DefaultSelector() as selector:
            selector.register(self._stdout, selectors.EVENT_READ)
            while (end := re.search(rf"{self._PROMPT} (\d+)\n".encode(), heard)) is None:
                assert selector.select(max(0.0, deadline - time.monotonic())), f"no end within {DEADLINE} s: {heard!r}"
                chunk = os.read(self._stdout.fileno(), 65536)
                assert chunk, f"the shell has ended: {heard!r}"
                heard += chunk
        return heard[: end.start()].decode(), int(end[1])


@contextmanager
def terminal(folder: Path) -> Iterator[Terminal]:
    """A terminal in ``folder``; processes that still run in it at the end are ended."""
    program = folder / "bin" / "manyhands"
    program.parent.mkdir(exist_ok=True)
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -P -m manyhands "$@"\n')
    program.chmod(0o755)
    shell = subprocess.Popen(
        ["bash", "--noprofile", "--norc"],
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        env={**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}"},
    )
    with shell:
        try:
            yield Terminal(shell)
        except BaseException:
            os.killpg(shell.pid, signal.SIGTERM)  # the supervisor then ends its nodes
            raise


def write_session(folder: Path) -> Path:
    """The session of the page, as a file."""
    (block,) = [block for block in blocks(PAGE) if block.language == "yaml"]
    path = folder / SESSION
    path.write_text(block.text)
    return path


@pytest.mark.long
def test_the_walk_through(tmp_path: Path) -> None:
    """As the page has it, except for the port, which may be in use here."""
    write_session(tmp_path)
    page = PAGE.replace(str(PORT), str(free_ports(PORTS)[0]))
    typed = list(commands(page))
    assert len(typed) >= 20, "the page has lost its commands"
    assert {command.terminal for command in typed} == {"host", "guest"}
    with ExitStack() as stack:
        terminals = {name: stack.enter_context(terminal(tmp_path)) for name in ("host", "guest")}
        for command in typed:
            terminals[command.terminal].type(command)
        for one in terminals.values():
            one.finish()
        wrong = [text for one in terminals.values() for text in one.wrong]
    assert not wrong, "\n".join(wrong)


def test_the_ports_it_names(tmp_path: Path) -> None:
    session = load_session(write_session(tmp_path))
    ways = reach(Plan(session), "tcp", insecure=True, listen=Listen("127.0.0.1", PORT))
    graph = topology(session)
    last = ways.observer_address(graph, len(session.observers) - 1)
    assert last == f"127.0.0.1:{PORT + PORTS - 1}"
    assert f"up to {PORT + PORTS - 1}" in PAGE


def test_a_guests_bundle_holds_what_the_page_lists(tmp_path: Path) -> None:
    prepared = prepare(load_session(write_session(tmp_path)), uncertified=True)
    bundle = bundle_of(prepared, RunPlan("realtime", None, ""), "right")
    assert isinstance(bundle, DeviceBundle)
    assert bundle.common.ports == ("right",)
    assert [peer.name for peer in bundle.common.peers] == ["right_coupling"]


def rows(header: str) -> list[list[str]]:
    """The cells of a table of the page."""
    below = PAGE.split(header + "\n")[1].splitlines()[1:]
    table = below[: next(i for i, line in enumerate(below) if not line.startswith("|"))]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in table]


def test_every_count_is_explained_and_every_count_explained_there_is() -> None:
    at_supervisor = (*NotAdmitted, *HUB_DROPS, "out_of_turn", "telemetry_that_does_not_fit")
    expected = [[f"`{name}`", "`refused`"] for name in at_supervisor]
    expected += [[f"`{name}`", "`dropped`"] for name in DROP_REASONS]
    expected += [[f"`{names.SATURATED}`", "a coupling's entry"], [f"`{names.CLIPPED}`", "a device's entry"]]
    assert [row[:2] for row in rows("| count | where | happened | look at |")] == expected


def test_the_page_lists_every_message_of_a_guest() -> None:
    assert {row[0] for row in rows("| it says | look at |")} == set(Trouble)


def test_the_check_sees_what_is_wrong(tmp_path: Path) -> None:
    with terminal(tmp_path) as shell:
        for line, code, quoted in (("echo a; exit_code() { return 3; }; exit_code", 3, ["a"]), ("echo b", 0, ["b"])):
            shell.type(Command("host", line, code, False, quoted))
        assert shell.wrong == []
        shell.type(Command("host", "false", 0, False, []))
        shell.type(Command("host", "echo c", 0, True, ["d"]))
        shell.finish()
    assert len(shell.wrong) == 2
    assert shell.wrong[0].startswith("false: exit 1, expected 0")
    assert shell.wrong[1].startswith("echo c did not say: d")


@pytest.mark.parametrize("text", ["```console\nhost$ true    # exit 2, goes on\nsaid\n```\n"])
def test_a_command_is_read_as_it_stands(text: str) -> None:
    assert list(commands(text)) == [Command("host", "true", 2, True, ["said"])]
