"""A run's own directory: bundles, logs, sockets and the keys of one run, for the session's user alone (mode 0700)."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PREFIX = "manyhands-"


@contextmanager
def run_directory() -> Iterator[Path]:
    """A new directory that is gone afterwards."""
    sweep_directories()
    directory = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
    try:
        yield directory
    finally:
        shutil.rmtree(directory)


def sweep_directories() -> None:
    """Remove what runs whose supervisor was killed have left in the temporary directory.

    A run's directory bears its supervisor's process id; it is ours and nobody's when that process is gone.
    """
    for path in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*-*"):
        pid = path.name.removeprefix(_PREFIX).split("-")[0]
        if pid.isdigit() and path.is_dir() and path.stat().st_uid == os.getuid() and not Path(f"/proc/{pid}").exists():
            shutil.rmtree(path, ignore_errors=True)  # another supervisor may be sweeping too
