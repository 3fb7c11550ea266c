"""What the programs of this folder share: a line for each finding, and the end of all that they have started.

Each program tries one way in which manyhands is installed or reached, with the real programs of this machine, and ends
with exit code 1 if anything was not as it should be. They are behind targets of the Makefile, and no test runs them:
they need programs that a developer's machine may lack, rights, and minutes.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]

_MARK: Final = "MANYHANDS_TRIED_BY"
"""In the environment of all processes that a program here starts, and that these start in turn: its process id."""


class Checks:
    """The findings of one program."""

    def __init__(self) -> None:
        self.failed = 0
        self._began = time.monotonic()
        os.environ[_MARK] = str(os.getpid())

    def that(self, sentence: str, holds: bool, found: object = "") -> None:
        """Print a finding; ``found`` is what was found in place of it, or the figure of it."""
        self.failed += not holds
        shown = str(found).strip()
        more = "" if not shown else (f": {shown}" if holds else f"\n      found: {shown[-2000:]}")
        self.say(f"{'ok  ' if holds else 'FAIL'}  {sentence}{more}")

    def say(self, line: str) -> None:
        """Print a line that is no finding."""
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()

    def end(self) -> int:
        """Check that no process is left, and end what is; returns the exit code."""
        left = _marked()
        self.that("nothing that was started here runs on", not left, ", ".join(left.values()))
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.say(f"{self.failed or 'none'} failed, {time.monotonic() - self._began:.0f} s")
        return 1 if self.failed else 0


def _marked() -> dict[int, str]:
    """The processes that have the mark, but for this one: their names by process id."""
    wanted, found = f"{_MARK}={os.getpid()}".encode(), dict[int, str]()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if folder.name != str(os.getpid()) and wanted in (folder / "environ").read_bytes().split(b"\0"):
                found[int(folder.name)] = (folder / "comm").read_text().strip()
        except OSError:  # it has ended meanwhile, or belongs to another user
            continue
    return found


def require_programs(programs: Mapping[str, str]) -> None:
    """End the program unless these are there; by name, Debian's package that has it.

    Raises:
        SystemExit: one is missing; exit code 2.
    """
    os.environ["PATH"] += f"{os.pathsep}/usr/sbin{os.pathsep}/sbin"  # where Debian keeps some of them
    missing = {program: package for program, package in programs.items() if shutil.which(program) is None}
    if missing:
        packages = " ".join(sorted(set(missing.values())))
        sys.stderr.write(f"error: found no {', '.join(missing)}; expected them: apt-get install {packages}\n")
        raise SystemExit(2)


def require_root() -> None:
    """End the program unless it runs as root.

    Raises:
        SystemExit: it does not; exit code 2.
    """
    if os.geteuid() != 0:
        sys.stderr.write("error: found another user; expected root, who may make namespaces and file systems\n")
        raise SystemExit(2)


def done(
    command: Sequence[str | Path], *, within: float = 600.0, **options: object
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, at most so many seconds; its output is kept."""
    words = [str(word) for word in command]
    try:
        return subprocess.run(words, capture_output=True, text=True, check=False, timeout=within, **options)  # type: ignore[call-overload,no-any-return]
    except subprocess.TimeoutExpired as late:
        said = late.stderr.decode(errors="replace") if isinstance(late.stderr, bytes) else ""
        return subprocess.CompletedProcess(words, -1, "", f"{said}\nno end within {within:g} s")


def must(command: Sequence[str | Path], **options: object) -> str:
    """Run a command that a check stands on; returns its standard output.

    Raises:
        SystemExit: it failed.
    """
    found = done(command, **options)  # type: ignore[arg-type]
    if found.returncode:
        raise SystemExit(f"error: {' '.join(map(str, command))}\n{found.stdout[-2000:]}{found.stderr[-2000:]}")
    return found.stdout


@contextmanager
def stopped_at_the_end(command: Sequence[str | Path], **options: object) -> Iterator[subprocess.Popen[str]]:
    """A command that runs meanwhile; it is killed if it has not ended."""
    with subprocess.Popen(list(map(str, command)), text=True, **options) as process:  # type: ignore[call-overload]
        try:
            yield process
        finally:
            process.kill()


def sources(target: Path) -> Path:
    """A copy of what is committed or was changed since, in a new folder; returns it."""
    listed = must(["git", "-C", ROOT, "ls-files", "--cached", "--others", "--exclude-standard", "-z"])
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_symlink() or (ROOT / name).exists():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name, follow_symlinks=False)
    return target
