"""`manyhands identify` on a fake board, a process of its own behind a pseudo-terminal, in real time, up to the wall."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pytest
import yaml

from ..fakes.board import Axis, fake_board
from ..support.commands import manyhands_command, run

TRUTH: Final = Axis(m=0.15, b=3.0, c=0.1, step=1e-5, displacement=0.2)
HAND: Final = replace(TRUTH, k=100.0, amplitude=0.02, frequency=0.7)

PERIODS: Final = (0.004, 0.01)
"""s; a busy machine may keep the second where it does not keep the first."""

FEW: Final = 0.005
"""Part of the ticks that come late, and of the displacements that are too old, where the machine gave all its turns."""

OPTIONS: Final = ("--travel", 0.06, "--speed", 0.25, "--force", 4, "--yes")

SESSION = """
session: wall
period: 0.004
devices:
  stick: {{from: {file}, parameters: {{port: {port}, silence: 0.9}}}}
couplings:
  cs: {{devices: [stick]}}
environment:
  type: network
  links:
    - {{between: [stick.x, ground], stiffness: 50}}
design: {{coupling: spring-damper, tau: 0.003, period_tolerance: 0.5}}
"""


def identified(file: Path, period: float) -> tuple[dict[str, Any] | None, bool, str]:
    """The device file if it has an osp, whether the machine gave the loop and the board their turns, and the output."""
    with fake_board(TRUTH, period_us=500) as one:
        parameters = f"{{port: {one.path}, silence: 0.9, sample_age: 0.001, actuation_delay: 0.0003}}"
        options = ("--parameters", parameters, "--period", period, *OPTIONS, "-o", file, "--overwrite")
        done = manyhands_command("identify", "serial-board", *options)
        assert one.asked()[1] == [0.0]  # released, however it ended
    assert done.exit_code in (0, 1), done.output
    counts = re.search(r"(\d+) of (\d+) ticks came late, .*; (\d+) displacements were older", done.output)
    assert counts, done.output
    late, ticks, old = map(int, counts.groups())
    read = yaml.safe_load(file.read_text()) if file.exists() else None
    if read is not None:  # whatever the machine did, nothing false is written
        assert 0.0 < read["keys"].get("osp", 1e-9) <= TRUTH.b
        assert read["keys"].get("friction", {"least": 0.0})["least"] <= TRUTH.c
        assert read["keys"].get("mass", 0.0) <= TRUTH.m
        assert read["sources"].keys() == read["keys"].keys()
    stated = read is not None and "osp" in read["keys"]
    assert stated == (done.exit_code == 0), done.output
    return read if stated else None, max(late, old) <= FEW * ticks, done.output


@pytest.mark.long
@pytest.mark.alone  # beside other tests the loop has no turns
def test_a_board_is_identified_in_real_time_and_its_wall_is_felt(tmp_path: Path) -> None:
    file = tmp_path / "stick.device.yaml"
    for period in PERIODS:
        read, had_turns, said = identified(file, period)
        if read is not None:
            break
        assert not had_turns, said
    else:
        pytest.skip(f"this machine gave the loop no turns at any period, and nothing was stated: {said[-300:]}")
    assert abs(read["keys"]["step"] - TRUTH.step) < 1e-9
    with fake_board(HAND, period_us=500) as one:
        session = tmp_path / "wall.yaml"
        session.write_text(SESSION.format(file=file.name, port=one.path))
        run("design", session)
        report = tmp_path / "wall.json"
        run("launch", session, "--duration", "3", "--report", report)
    assert json.loads(report.read_text())["nodes"]["stick"]["peak_force"] > 0.2  # the wall pushes back
