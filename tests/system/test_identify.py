"""`manyhands identify` on a fake board: a process of its own behind a pseudo-terminal, in real time."""

from __future__ import annotations

from pathlib import Path

import yaml

from ..fakes.board import Axis, FakeBoard, fake_board
from ..support.commands import manyhands_command

TRUTH = Axis(m=0.15, b=1.5, c=0.1, step=1e-5)


def identified(one: FakeBoard, file: Path) -> str:
    """What the command says; where the machine let no motion be measured, it has to say so, and to write nothing."""
    # a busy machine gives the board late turns: the driver is told how late a sample may be
    parameters = f"{{port: {one.path}, silence: 0.9, sample_age: 0.002, actuation_delay: 0.001}}"
    options = ("--parameters", parameters, "--period", 0.004, "--travel", 0.025, "--speed", 0.12, "--yes", "-o", file)
    done = manyhands_command("identify", "serial-board", *options)
    assert one.asked()[1] == [0.0]  # released, however it ended
    assert done.exit_code in (0, 1), done.output
    if done.exit_code == 1 and "no osp can be stated" not in done.output:
        assert "error: " in done.output
        assert not file.exists()
    return done.output


def test_a_board_is_identified_in_real_time_and_nothing_false_is_written(tmp_path: Path) -> None:
    file = tmp_path / "stick.device.yaml"
    with fake_board(TRUTH, period_us=500) as one:
        said = identified(one, file)
    if not file.exists():
        assert "expected" in said  # found …; expected …: the machine was too late for a motion without a stop
        return
    read = yaml.safe_load(file.read_text())
    assert 0.0 < read["keys"].get("osp", 1e-9) <= TRUTH.b
    assert read["keys"].get("friction", 0.0) <= TRUTH.c
    assert read["keys"].get("mass", 0.0) <= TRUTH.m
    assert abs(read["keys"]["step"] - TRUTH.step) < 1e-9
    assert read["sources"].keys() == read["keys"].keys()
