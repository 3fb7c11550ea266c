"""A fake board behind a pseudo-terminal: the firmware's own core, with plants, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import astuple, dataclass

from manyhands.devices.serial_board.frames import Feature

from .compiled import board


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


class FakeBoard:
    """A running board.

    Attributes:
        path: of its port.
        process: that it runs in.
    """

    def __init__(self, path: str, process: subprocess.Popen[str]) -> None:
        self.path, self.process = path, process

    def order(self, line: str) -> None:
        """Give an order of board.c."""
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def asked(self) -> tuple[list[float], list[float], dict[str, int]]:
        """Its displacement (m), the force on its motors (N), and its counts, of this instant."""
        self.order("ask")
        assert self.process.stdout is not None
        words = self.process.stdout.readline().split()
        cut, rest = words.index("f"), words.index("broken")
        counts = dict(zip(words[rest::2], map(int, words[rest + 1 :: 2]), strict=True))
        return [*map(float, words[1:cut])], [*map(float, words[cut + 1 : rest])], counts

    def unplug(self) -> None:
        """End it: its port is gone."""
        self.process.kill()
        self.process.wait()


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
        yield FakeBoard(path, process)
    finally:
        os.close(slave)
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()
