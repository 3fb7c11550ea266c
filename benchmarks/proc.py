"""Data from Linux's /proc about the processes that a benchmark watches, and about the machine."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from pathlib import Path

TICK = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")
_PARENT, _USER, _SYSTEM = 1, 11, 12  # fields of stat behind the command's name, from 0


def _stat(pid: int) -> list[str] | None:
    """The fields of a process behind its command's name; None if it has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except (FileNotFoundError, ProcessLookupError):
        return None


def family(pid: int) -> list[int]:
    """A process and all that descend from it."""
    parents = {
        int(entry): int(stat[_PARENT])
        for entry in os.listdir("/proc")
        if entry.isdigit() and (stat := _stat(int(entry)))
    }
    found = [pid]
    for one in found:  # grows meanwhile
        found += [child for child, parent in parents.items() if parent == one]
    return found


def cpu_seconds(pids: Iterable[int]) -> float:
    """Processor time that the processes have used so far, s; those that have ended count nothing."""
    return sum((int(stat[_USER]) + int(stat[_SYSTEM])) / TICK for pid in pids if (stat := _stat(pid)))


def resident(pid: int) -> float | None:
    """Resident memory of a process, MiB; None if it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (FileNotFoundError, ProcessLookupError, IndexError):
        return None
    return pages * PAGE / 2**20 if pages else None


def arguments(pid: int) -> list[str]:
    """A process's command line."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except (FileNotFoundError, ProcessLookupError):
        return []


def threads(pid: int) -> list[int]:
    """The threads of a process, the main one first."""
    try:
        return sorted(int(entry) for entry in os.listdir(f"/proc/{pid}/task"))
    except FileNotFoundError:
        return []


def thread_seconds(pid: int, thread: int) -> float:
    """Processor time that one thread of a process has used so far, s; 0 if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/task/{thread}/schedstat").read_text().split()[0]) / 1e9
    except (FileNotFoundError, ProcessLookupError):
        return 0.0


def machine() -> dict[str, str]:
    """What a reader of figures wants to know of the machine."""
    models = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    return {
        "processor": models[0].split(":", 1)[1].strip() if models else platform.machine(),
        "cores": str(len(os.sched_getaffinity(0))),
        "kernel": platform.release(),
        "python": platform.python_version(),
    }
