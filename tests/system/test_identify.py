"""`manyhands identify` on the fake of each driver, in real time, up to a wall that is felt.

The fakes are those of the campaign of faults (device_rows.py), each a process of its own. A fake's truth is known, so
that nothing false may be stated, whatever the machine did. Whether something is stated is judged where the loop and
the fake had their turns.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
import yaml

from manyhands.launch.recordings.run import read_run
from manyhands.launch.recordings.run import rows_of as rows_of_trace
from manyhands.launch.run.outcome import rows_of
from manyhands.protocol.channels import DISPLACEMENT, FORCE

from ..support.commands import MANYHANDS, run
from .device_faults import INNOCENT, OF_THE_MACHINE, TESTED, session_of
from .device_row import Row
from .device_rows import ROWS

PERIODS: Final = (0.004, 0.01)
"""s; a busy machine may keep the second where it does not keep the first."""

FEW: Final = 0.005
"""Part of the ticks that come late, and of the displacements that are too old, where the machine gave all its turns."""

PATIENCE: Final = 1500.0
"""s, for a command to end: along seven lines of three axes it takes ten minutes."""

_COUNTS: Final = re.compile(r"(\d+) of (\d+) ticks came late, .*; (\d+) displacements were older")


@dataclass(frozen=True)
class Attempt:
    """What one run of the command has written, whether the machine gave it its turns, and what it said."""

    file: Path
    read: dict[str, Any] | None
    had_turns: bool
    said: str

    @property
    def stated(self) -> bool:
        """Whether an osp was."""
        return self.read is not None and "osp" in self.read["keys"]


def identified(driver: str, row: Row, folder: Path, period: float) -> Attempt:
    """Identify the fake of ``driver``, which nobody holds, and see that nothing false is stated."""
    file, free = folder / "stick.device.yaml", row.free
    (own := folder / f"{period:g}").mkdir()
    with free.opened(own) as far:
        given = json.dumps({**row.parameters, **far.parameters})
        command = ["identify", driver, "--parameters", given, "--period", period, *free.options, "--yes", "-o", file]
        done = subprocess.run(
            [*MANYHANDS, *map(str, command), "--overwrite"], capture_output=True, text=True, timeout=PATIENCE
        )
        assert not any(far.force()), "a force acts after the end"
    said = done.stdout + done.stderr
    sys.stdout.write(said)  # what was found, for pytest -rP
    assert done.returncode in (0, 1), said
    counts = _COUNTS.search(said)
    assert counts, said
    late, ticks, old = map(int, counts.groups())
    read = yaml.safe_load(file.read_text()) if file.exists() else None
    if read is not None:
        keys = read["keys"]
        assert 0.0 < keys.get("osp", 1e-9) <= free.damping
        assert all(least <= free.friction for least in _numbers(keys.get("friction", {"least": 0.0})["least"]))
        assert all(mass <= free.mass for mass in _numbers(keys.get("mass", 0.0)))
        assert read["sources"].keys() == keys.keys()
    found = Attempt(file, read, max(late, old) <= FEW * ticks, said)
    assert found.stated == (done.returncode == 0), said
    return found


def _numbers(value: float | list[float]) -> Iterator[float]:
    yield from value if isinstance(value, list) else [value]


def stiffness_felt(recording: Path) -> float:
    """How the force on the first axis of the device rises with its displacement, and beside that with its speed.

    It is the median of parts of half a second: a late tick shifts the tool against the hand, and a part may have one.
    """
    run = read_run(recording)
    x, f = (rows_of_trace(run, TESTED, trace)[:, 0] for trace in (DISPLACEMENT, FORCE))
    by, each, found = np.column_stack([x, np.gradient(x), np.ones_like(x)]), round(0.5 / run.period), []
    for begin in range(0, len(x) - each, each):
        part = slice(begin, begin + each)
        known = np.isfinite(by[part]).all(axis=1) & np.isfinite(f[part])
        found.append(abs(np.linalg.lstsq(by[part][known], f[part][known], rcond=None)[0][0]))
    return float(np.median(found))


@pytest.mark.long
@pytest.mark.alone  # beside other tests the loop has no turns
@pytest.mark.minutes
@pytest.mark.parametrize("driver", ROWS)
def test_a_device_is_identified_in_real_time_and_its_wall_is_felt(driver: str, tmp_path: Path) -> None:
    row = ROWS[driver]
    for period in PERIODS if row.free.stated else PERIODS[:1]:
        found = identified(driver, row, tmp_path, period)
        if found.stated:
            break
        assert not (row.free.stated and found.had_turns), found.said
    else:
        if row.free.stated:
            pytest.skip(
                f"this machine gave the loop no turns at any period, and nothing was stated: {found.said[-300:]}"
            )
    if found.read is not None and found.stated and row.free.step:
        assert abs(found.read["keys"]["step"] - row.free.step) < 1e-9
    with row.opened(tmp_path) as far:
        content = session_of(row, far, {})
        content["devices"][INNOCENT]["hand"]["force"] = 0.0  # a wall that moves would be felt as another stiffness
        if found.stated and row.free.stated:  # otherwise the row's keys have one that somebody has measured
            parameters = {**row.parameters, **far.parameters}
            content["devices"][TESTED] = {"from": found.file.name, "parameters": parameters}
        session, report, recording = (tmp_path / f"wall.{suffix}" for suffix in ("yaml", "json", "mcap"))
        session.write_text(yaml.safe_dump(content))
        designed = json.loads(run("design", session, "--json"))
        ports = [port for block in designed["structure"] for port in block]
        place = next(i for i, port in enumerate(ports) if port.partition(".")[0] == TESTED)
        K = designed["coupling"]["stiffness"][place][place]
        run("launch", session, "--duration", "5", "--report", report, "--record", recording)
    done = json.loads(report.read_text())
    assert done["nodes"][TESTED]["peak_force"] > row.felt  # the wall pushes back
    felt, both = stiffness_felt(recording), 1.0 / (1.0 / K + 1.0 / row.stiffness)
    sys.stdout.write(f"K {K:.4g}, with the wall {both:.4g}, felt {felt:.4g}\n")
    assert felt > 0.5 * both
    broken = [row for row in rows_of(done) if row.state == "broken" and row.promise not in OF_THE_MACHINE]
    assert not broken
