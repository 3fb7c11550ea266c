"""A run of the session itself, as its user launches it, and measurements of its processes meanwhile."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import proc
from loop_runs import Failed, Run, Treatment, share_late

OURS = "manyhands"
COMPILED = Path(__file__).parents[1] / "out" / "compiled"
"""Where :func:`install_compiled` puts the package with its compiled tick."""

MANYHANDS = [sys.executable, "-P", "-m", "manyhands"]
SAMPLES_EVERY = 0.5  # s, between two looks at our processes


def install_compiled() -> bool:
    """Compile the package's tick into :data:`COMPILED`; returns whether that succeeded."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--upgrade", "--target", str(COMPILED)]
    shutil.rmtree(COMPILED, ignore_errors=True)  # an extension of an earlier build would pass for one of this
    code = subprocess.run([*command, str(Path(__file__).parents[1])], check=False).returncode  # noqa: S603
    return code == 0 and any(COMPILED.glob("*.so"))


@dataclass(frozen=True)
class Variant:
    """A way to run the session.

    Attributes:
        label: what the table calls it.
        colocated: whether each coupling runs in its device's process.
        compiled: whether the tick is compiled.
    """

    label: str
    colocated: bool = False
    compiled: bool = False


VARIANTS = {
    OURS: Variant("manyhands"),
    "manyhands-colocated": Variant("manyhands, co-located", colocated=True),
    "manyhands-compiled": Variant("manyhands, compiled", compiled=True),
    "manyhands-compiled-colocated": Variant("manyhands, compiled, co-located", colocated=True, compiled=True),
}


@dataclass
class Watch:
    """What was seen of our processes while their ticks went on.

    Attributes:
        treatment: of each node.
        cpu: processors used.
        processes: how many there are.
        seconds: when each look was, since the first tick.
        resident: MiB at each look, by process.
    """

    treatment: dict[str, Treatment] = field(default_factory=dict)
    cpu: float = 0.0
    processes: int = 0
    seconds: list[float] = field(default_factory=list)
    resident: dict[str, list[float]] = field(default_factory=dict)


def ours(folder: Path, seconds: float, period: float = 1e-3, compiled: bool = False) -> tuple[Run, Watch]:
    """The session in ``folder``, as its user launches it.

    Args:
        folder: has the session and its certificate.
        seconds: how long.
        period: of the session, s.
        compiled: whether the tick is compiled.

    Raises:
        Failed: it ended with an error, or there is no compiled tick.
    """
    report = folder / "report.json"
    if compiled and not any(COMPILED.glob("*.so")):
        raise Failed(f"found no extension in {COMPILED.name}; run loop.py --install where there is a C compiler")
    with subprocess.Popen(  # noqa: S603 -- our own command
        [*MANYHANDS, "launch", str(folder / "session.yaml"), "--certificate", str(folder / "certificate.json"),
         "--duration", str(seconds), "--report", str(report)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(COMPILED)} if compiled else None,
    ) as launch:  # fmt: skip
        try:
            said = until(launch.stderr, ": running")
            seen = _watch(launch, min(SAMPLES_EVERY, seconds / 4))
        except BaseException:
            launch.terminate()
            raise
        rest = launch.stderr.read() if launch.stderr else ""
    if launch.returncode:
        raise Failed(f"the session ended with exit code {launch.returncode}:\n{said}{rest}")
    if not seen.seconds:
        raise Failed(f"the session was over before it could be looked at; expected more than {seconds:g} s")
    devices = {name: node for name, node in json.loads(report.read_text())["nodes"].items() if node["role"] == "device"}
    planned = max(1, round(seconds / period))
    run = Run(
        {name: device["tau_us"] for name, device in devices.items()},
        min(device["ticks"] for device in devices.values()),
        share_late(planned, [(device["ticks"], device["late"]) for device in devices.values()]),
        seen.processes,
        seen.cpu,
        sum(found[-1] for found in seen.resident.values()),
    )
    return run, seen


def until(stream: IO[str] | None, words: str) -> str:
    """Read up to the line with ``words``; returns what was read."""
    said = ""
    for line in stream or ():
        said += line
        if words in line:
            break
    return said


def _watch(launch: subprocess.Popen[str], every: float) -> Watch:
    """Look at our processes until they end."""
    pids = proc.family(launch.pid)
    names = {pid: _node(pid) for pid in pids}
    seen = Watch(processes=len(pids), resident={name: [] for name in names.values()})
    began, used = time.monotonic(), proc.cpu_seconds(pids)
    while True:
        found = {name: proc.resident(pid) for pid, name in names.items()}
        now, cpu = time.monotonic(), proc.cpu_seconds(pids)
        if any(one is None for one in found.values()):  # one has ended, and the run with it
            return seen
        try:  # at every look: a node asks for its scheduling when its first tick is near, and gives it back at the end
            treatment = {name: Treatment.of(pid) for pid, name in names.items() if pid != launch.pid}
        except ProcessLookupError:
            return seen
        if _raised(treatment) >= _raised(seen.treatment):
            seen.treatment = treatment
        seen.seconds.append(now - began)
        for name, mebibytes in found.items():
            seen.resident[name].append(mebibytes or 0.0)
        if now > began:
            seen.cpu = (cpu - used) / (now - began)
        try:
            launch.wait(every)
        except subprocess.TimeoutExpired:
            continue
        return seen


def _raised(treatment: dict[str, Treatment]) -> int:
    """How many processes have a real-time priority."""
    return sum(one.main[2] > 0 for one in treatment.values())


def _node(pid: int) -> str:
    """Which of our processes this is: a node has its bundle's file among its arguments."""
    return next((Path(one).stem for one in proc.arguments(pid) if one.endswith(".bundle")), "supervisor")
