"""A fake board is probed as its user would: by hand at a terminal, and from a script."""

from __future__ import annotations

import json
import os
import pty
import subprocess

import pytest
from click.testing import Result

from ..fakes.board import Axis, FakeBoard, fake_board
from ..support.commands import Command, manyhands_command

pytestmark = pytest.mark.usefixtures("own_interrupt")


def arguments(one: FakeBoard, *more: str) -> list[str]:
    quick = ("--seconds", "0.3", "--period", "0.002")
    return ["probe", "serial-board", "--parameters", f"{{port: {one.path}, silence: 0.9}}", *quick, *more]


def probed(one: FakeBoard, *more: str) -> Result:
    return manyhands_command(*arguments(one, *more))


def test_each_axis_answers_in_its_direction() -> None:
    with fake_board(Axis(b=2.0), Axis(b=2.0)) as one:
        done = probed(one, "--dof", "2", "--yes", "--json")
    assert (done.exit_code, done.stderr) == (0, "")
    answers = json.loads(done.stdout)["answers"]
    assert [(answer["axis"], answer["right"]) for answer in answers] == [("x", True), ("y", True)]
    assert all(answer["measured"] == pytest.approx(0.5) for answer in answers)


def test_one_that_does_not_move_is_explained() -> None:
    with fake_board(Axis(c=2.0)) as one:
        done = probed(one, "--yes")
    assert done.exit_code == 1, done.stderr
    assert (
        "x did not move under ±0.5 N, though its driver measured 0.5 N: the force is there; is it held" in done.stdout
    )


def test_nothing_is_pushed_without_an_answer() -> None:
    with fake_board() as one:
        done = probed(one)
        assert one.asked()[1] == [0.0]
    assert done.exit_code == 0, done.stderr
    assert "this pushes real hardware with 0.5 N, up to 10 mm at a time; nobody may hold it" in done.stderr
    assert "no force was exerted" in done.stdout


def test_at_a_terminal_it_asks_while_the_board_is_read_on() -> None:
    terminal, slave = pty.openpty()
    with fake_board(Axis(b=2.0)) as one:
        try:
            with Command(
                arguments(one), stdin=slave, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            ) as process:
                assert process.stderr is not None
                asked = process.stderr.readline()
                assert asked.endswith("nobody may hold it. Push it? [y/N]\n")
                os.write(terminal, b"y\n")
                out, error = process.communicate(timeout=120)
        finally:
            os.close(terminal)
            os.close(slave)
    assert (process.returncode, error) == (0, "")
    assert "x answered +0.5 N by moving +" in out
