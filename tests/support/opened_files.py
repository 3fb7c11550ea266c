"""Every file that a process and its children open, as strace sees it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from pathlib import Path

from .capture import missing

# the calls in the log, and what they return: a descriptor, with the path behind it
_OPENING = "trace=/^(open|creat)"
_OPENED = re.compile(r" = \d+<(/.*)>(?:\(deleted\))?$")


def watched(command: Sequence[str], log: Path) -> list[str]:
    """The command line that runs ``command`` and writes what it opens to ``log``.

    Skips or fails the test where there is no strace; see :func:`.capture.missing`.
    """
    strace = shutil.which("strace")
    if strace is None:
        missing("no strace was found")
    return [strace, "-f", "-qq", "-y", "-s", "4096", "-e", _OPENING, "-o", str(log), "--", *command]


def opened(log: Path) -> set[Path]:
    """The opened files and folders, by their names in the file system."""
    found = (_OPENED.search(line) for line in log.read_text().splitlines())
    return {Path(match[1]) for match in found if match}
