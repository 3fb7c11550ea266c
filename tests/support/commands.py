"""The program's commands: within the test's process, or started as a user starts them for tests of whole sessions."""

from __future__ import annotations

import functools
import gc
import importlib
import inspect
import os
import pkgutil
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Any, Final, Never

from click.testing import Result
from typer.testing import CliRunner

from manyhands.__main__ import main
from manyhands.launch.app import cli

MANYHANDS = [sys.executable, "-P", "-m", "manyhands"]


STARTS_PROCESSES: Final = ("launch", "host", "doctor")
"""Commands that ask the kernel for what a test's process should not have, and so run in processes of their own."""


def manyhands_command(*arguments: object) -> Result:
    """Run a command within this process; the fixture ``own_interrupt`` restores what it does to Ctrl-C."""
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


PATIENCE: Final = 120.0  # s, for a command to end; far more than it takes


@functools.cache
def _imported() -> None:
    """Import what commands need, once for all copies of this process."""
    for module in pkgutil.iter_modules(cli.__path__):
        importlib.import_module(f"{cli.__name__}.{module.name}")
    for name in ("design.ladder", "design.synthesis", "launch.run.supervisor"):
        importlib.import_module(f"manyhands.{name}")


class Command(subprocess.Popen[Any]):
    """A command in a process of its own, which begins as a copy of this one; all else is as in ``Popen``.

    It goes through the program's entry point, with arguments, streams, folder, environment and session of its own.
    What this process has imported need not be imported again, which takes a second or two. What begins with the
    interpreter (``PYTHONPATH``, ``sitecustomize``) does not happen again, this process's secrets are in the copy's
    memory, and threads of libraries (ROS, Foxglove) are not in it: a test of any of these starts :data:`MANYHANDS`.
    The nodes of a session are programs that start from nothing, as always.
    """

    def _execute_child(self, *arguments: Any) -> None:
        _imported()
        asked = inspect.signature(super()._execute_child).bind(*arguments).arguments
        pipes = [asked[name] for name in ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")]
        try:
            sys.stdout.flush()
            sys.stderr.flush()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # pytest-xdist's thread holds no lock of ours
                self.pid = os.fork()
            if self.pid == 0:
                _be_a_command(asked, (pipes[0], pipes[3], pipes[5]))
            self._child_created = True
        finally:
            self._close_pipe_fds(*pipes)


def _be_a_command(asked: Mapping[str, Any], streams: tuple[int, int, int]) -> Never:
    """The command, in the copy; it ends the process."""
    code = 70
    try:
        gc.freeze()  # what would be collected belongs to the other process
        if asked["start_new_session"]:
            os.setsid()
        held = [os.dup(number if stream < 0 else stream) for number, stream in enumerate(streams)]
        for number, stream in enumerate(held):
            os.dup2(stream, number)
        os.closerange(3, 4096)
        sys.stdin = os.fdopen(0, encoding="utf-8", closefd=False)
        sys.stdout, sys.stderr = (os.fdopen(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))
        warnings.simplefilter("ignore")
        if asked["env"] is not None:
            for name in os.environ.keys() - asked["env"].keys():
                del os.environ[name]
            os.environ.update(asked["env"])
        os.chdir(asked["cwd"] or ".")
        tempfile.tempdir = None  # it was the test's; now the environment says where
        cli.common.ctrl_c.clear()
        sys.argv = ["manyhands", *asked["args"]]
        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:  # noqa: BLE001 -- as the interpreter ends a program
        sys.excepthook(*sys.exc_info())
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)


def forked(
    *arguments: str | Path, cwd: Path | None = None, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a :class:`Command` to its end."""
    words = [str(argument) for argument in arguments]
    with Command(
        words,
        cwd=cwd,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            out, errors = process.communicate(timeout=PATIENCE)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(words, process.returncode, out, errors)


def run(*arguments: str | Path, cwd: Path | None = None) -> str:
    """Run a command to its end and return its standard output.

    It runs within this process, which has imported everything, unless it starts a session. Ctrl-C is as it was before.

    Raises:
        AssertionError: its exit code is not 0; the message has its output.
    """
    words = [str(argument) for argument in arguments]
    if words[0] in STARTS_PROCESSES:
        done = forked(*words, cwd=cwd)
        code, out, errors = done.returncode, done.stdout, done.stderr
    else:
        before = signal.getsignal(signal.SIGINT)
        try:
            with chdir(cwd or Path.cwd()):
                ended = manyhands_command(*words)
        finally:
            signal.signal(signal.SIGINT, before)
        code, out, errors = ended.exit_code, ended.stdout, ended.stderr
    assert code == 0, f"manyhands {' '.join(words)} ended with {code}: {errors or out[-2000:]}"
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
