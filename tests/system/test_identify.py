"""`manyhands identify` on a fake board: a process of its own behind a pseudo-terminal, in real time."""

from __future__ import annotations

from pathlib import Path

import yaml

from ..fakes.board import Axis, fake_board
from ..support.commands import run


def test_a_board_is_identified_in_real_time_and_its_file_is_written(tmp_path: Path) -> None:
    file = tmp_path / "stick.device.yaml"
    with fake_board(Axis(m=0.15, b=1.5, c=0.1, step=1e-5), period_us=500) as one:
        # a busy machine gives the board late turns: the driver is told how late a sample may be
        parameters = f"{{port: {one.path}, silence: 0.9, sample_age: 0.002, actuation_delay: 0.001}}"
        arguments = (
            "serial-board",
            "--parameters",
            parameters,
            "--period",
            "0.004",
            "--travel",
            "0.025",
            "--speed",
            "0.12",
            "--yes",
        )
        said = run("identify", *arguments, "-o", file)
    assert "for the session file: osp:" in said
    read = yaml.safe_load(file.read_text())
    assert 0.0 < read["keys"]["osp"] <= 1.5
    assert read["keys"]["mass"] <= 0.15
    assert abs(read["keys"]["step"] - 1e-5) < 1e-9
    assert "manyhands identify" in read["sources"]["osp"]
