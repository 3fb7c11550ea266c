"""A fake board behind a pseudo-terminal: the firmware's own core, with plants, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass

from manyhands.devices.serial_board.frames import Feature

from .compiled import board
from .ordered import AxesFake, ended


@dataclass(frozen=True)
class Axis:
    """One axis: mass (kg), damping (N·s/m), friction (N), step (m), the hand's spring (N/m), its motion, the limits."""

    m: float = 0.15
    b: float = 0.5
    c: float = 0.0
    step: float = 1e-5
    k: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    force: float = 5.0
    displacement: float = 0.1
    speed: float = 2.0


class FakeBoard(AxesFake):
    """A running board; its orders are those of board.c."""

    first_count = "broken"


@contextmanager
def fake_board(
    *axes: Axis, period_us: int = 500, longest_us: int = 50_000, features: Feature = Feature.TELLS_WORK
) -> Iterator[FakeBoard]:
    """A board of these axes that runs meanwhile."""
    of: Sequence[Axis] = axes or (Axis(),)
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    numbers = [f"{number:.9g}" for axis in of for number in astuple(axis)]
    try:
        process = subprocess.Popen(
            [board(), str(master), str(period_us), str(longest_us), str(int(features)), str(len(of)), *numbers],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, pass_fds=(master,),
        )  # fmt: skip
    finally:
        os.close(master)
    try:
        with ended(process):
            yield FakeBoard(path, process)
    finally:
        os.close(slave)
