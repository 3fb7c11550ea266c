"""The program's commands: within the test's process, or started as a user starts them for tests of whole sessions."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Final

from click.testing import Result
from typer.testing import CliRunner

from manyhands.launch.app.cli import app

MANYHANDS = [sys.executable, "-P", "-m", "manyhands"]


STARTS_PROCESSES: Final = ("launch", "host", "doctor")
"""Commands that ask the kernel for what a test's process should not have, and so run in processes of their own."""


def manyhands_command(*arguments: object) -> Result:
    """Run a command within this process; the fixture ``own_interrupt`` restores what it does to Ctrl-C."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def run(*arguments: str | Path, cwd: Path | None = None) -> str:
    """Run a command to its end and return its standard output.

    It runs within this process, which has imported everything, unless it starts a session. Ctrl-C is as it was before.

    Raises:
        AssertionError: its exit code is not 0; the message has its output.
    """
    words = [str(argument) for argument in arguments]
    if words[0] in STARTS_PROCESSES:
        done = subprocess.run([*MANYHANDS, *words], cwd=cwd, capture_output=True, text=True, timeout=120)
        code, out, errors = done.returncode, done.stdout, done.stderr
    else:
        before = signal.getsignal(signal.SIGINT)
        try:
            with chdir(cwd or Path.cwd()):
                ended = manyhands_command(*words)
        finally:
            signal.signal(signal.SIGINT, before)
        code, out, errors = ended.exit_code, ended.stdout, ended.stderr
    assert code == 0, f"manyhands {' '.join(words)} ended with {code}: {errors}"
    return out


@contextmanager
def started(*arguments: str | Path, cwd: Path | None = None) -> Iterator[subprocess.Popen[str]]:
    """Start a command that runs beside the test; if the test fails before it ends the command, Ctrl-C ends it."""
    command = [*MANYHANDS, *map(str, arguments)]
    with subprocess.Popen(
        command, cwd=cwd, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        except BaseException:
            process.send_signal(signal.SIGINT)
            raise


def read_until(process: subprocess.Popen[str], words: str) -> str:
    """Read a process's error output up to the line with ``words``; returns that line."""
    assert process.stderr is not None
    heard = ""
    while words not in (line := process.stderr.readline()):
        heard += line
        assert line, f"it ended with {process.wait()} and never said {words!r}, but: {heard}"
    return line
