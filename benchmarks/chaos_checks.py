"""The invariants of the chaos campaign, which hold for a session after any fault.

- **Limits**: no force, displacement or speed in the recording is beyond the device's limits; in real time, where a
  device moves on between the ticks that it misses, its speed is the device's own affair, which ends the session.
- **Promises**: no party's energy ledger was ever more than 1e-12 J below its bound, including processes that were
  killed later.
- **Steps**: from one tick to the next no user's force changes by more than twice what the single-process simulation of
  such faults finds, except where it falls to exactly zero: there a user lets go, and under the simulated clock
  there are at most as many of these as faults that concern the user.
- **The file**: the recording is whole, and a copy that is cut somewhere holds the same numbers up to where it ends.
- **Nothing left**: no process, descriptor or temporary file more than before.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from chaos_kinds import PROMISE
from numpy.typing import NDArray

from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.recordings.tables import read_recording

STEP = 2.0  # the simulation is exact, but cannot try every tick and every combination
AWAY = 300  # ticks that a user is away in these simulations: then a free hand moves as fast as it ever does
BEGINS = range(100, 900, 200)  # other moments of what the hands do
ROUNDING = 1e-9


def largest_step(f: NDArray[np.float64]) -> float:
    """The largest step from a tick to the next, N, but those to exactly zero; over a gap there is none."""
    steps = np.abs(np.diff(f))
    steps = steps[~np.isnan(steps) & (f[1:] != 0.0)]
    return float(steps.max(initial=0.0))


def step_bounds(prepared: Prepared) -> Mapping[str, float]:
    """By port: how large a step of the force may be, N."""
    couplings = tuple(prepared.session.couplings)
    away = [(coupling,) for coupling in couplings] + [couplings]
    worst = np.zeros(len(prepared.session.ports))
    for begin in BEGINS:
        for who in away:
            faults = [Silence(coupling, begin, begin + AWAY) for coupling in who]
            f = Simulation(prepared).run(begin + 2 * AWAY, faults=faults).f_v
            worst = np.maximum(worst, [largest_step(column) for column in f.T])
    return dict(zip(prepared.session.ports, (STEP * worst).tolist(), strict=True))


@dataclass(frozen=True)
class Found:
    """The findings in the recording of a run.

    Attributes:
        violations: what did not hold, in words.
        force: the greatest force, in parts of its limit.
        step: the greatest step, in parts of its bound.
        let_go: how often a force fell to zero from more than its bound, over all users.
        missing: ticks that are not in the recording, over all users.
    """

    violations: list[str]
    force: float
    step: float
    let_go: int
    missing: int


def examine(
    prepared: Prepared, recording: Recording, bounds: Mapping[str, float], hits: Mapping[str, int] | None
) -> Found:
    """Limits and steps; ``hits`` is how often each user may have let go, None for as often as the machine made it."""
    violations: list[str] = []
    worst_force = worst_step = 0.0
    let_go = missing = 0
    T = prepared.session.period
    if recording.cut is not None:
        violations.append(f"the recording is not whole: {recording.cut}")
    for name, device in prepared.session.devices.items():
        for axis, port in enumerate(prepared.session.ports_of(name)):
            column = recording.ports.index(port)
            x, f = recording.x[:, column], recording.f_v[:, column]
            limits = device.limits
            for what, found, most in (
                ("force", np.abs(f), limits.force[axis]),
                ("displacement", np.abs(x), limits.displacement[axis]),
                ("speed", np.abs(np.diff(x)) / T, limits.speed[axis]),
            ):
                greatest = float(np.max(found[~np.isnan(found)], initial=0.0))
                if what == "speed" and hits is None:  # in real time a device moves on between the ticks that it misses
                    continue
                if greatest > most * (1.0 + ROUNDING):
                    violations.append(f"{port}: found a {what} of {greatest:g}; expected at most {most:g}")
                if what == "force":
                    worst_force = max(worst_force, greatest / most)
            step = largest_step(f)
            worst_step = max(worst_step, step / bounds[port])
            if step > bounds[port]:
                violations.append(f"{port}: found a step of {step:g} N; expected at most {bounds[port]:g} N")
            fell = int(np.sum((f[1:] == 0.0) & (np.abs(f[:-1]) > bounds[port])))
            if hits is not None and fell > hits.get(name, 0):
                violations.append(f"{port}: let go {fell} times; expected at most {hits.get(name, 0)}, as often as hit")
            let_go += fell
            missing += int(np.isnan(f).sum())
    return Found(violations, worst_force, worst_step, let_go, missing)


def broken_promises(ledgers: Mapping[str, float]) -> list[str]:
    """Ledgers that fell below their bound."""
    return [
        f"{node}: found a ledger {-least:g} J below its bound; expected none"
        for node, least in ledgers.items()
        if least < PROMISE
    ]


def unreadable_when_cut(path: Path, whole: Recording, at: int) -> list[str]:
    """What is wrong with the first ``at`` bytes of the recording, as a dying machine might have left them."""
    cut = path.with_suffix(".cut.mcap")
    cut.write_bytes(path.read_bytes()[:at])
    found = read_recording(cut)
    ticks = min(len(found.x), len(whole.x))
    known = ~np.isnan(found.f_v[:ticks])
    if found.cut is None and (len(found.x), found.missing) != (len(whole.x), whole.missing):
        return [f"cut at byte {at}, the recording says that it is whole"]  # of a cut index nothing is lost
    if not np.array_equal(found.f_v[:ticks][known], whole.f_v[:ticks][known]):
        return [f"cut at byte {at}, the recording holds other numbers"]
    return []


def left_behind() -> frozenset[str]:
    """This process's children, descriptors, and the temporary files of its runs."""
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    files = [path.name for path in Path(tempfile.gettempdir()).glob(f"manyhands-{os.getpid()}-*")]
    descriptors = len(os.listdir("/proc/self/fd"))
    return frozenset([*(f"process {pid}" for pid in children), *files, f"{descriptors} descriptors"])
