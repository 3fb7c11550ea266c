"""A fake device in a process of its own, which takes orders on its standard input, a line each."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import ClassVar


class OrderedFake:
    """A running fake.

    Attributes:
        path: of its port, or of its event device.
        process: that it runs in.
    """

    def __init__(self, path: str, process: subprocess.Popen[str]) -> None:
        self.path, self.process = path, process

    def order(self, line: str) -> None:
        """Give an order of the fake's own program."""
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def answer(self) -> str:
        """What it says to the order ``ask``."""
        self.order("ask")
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def unplug(self) -> None:
        """End it: its port is gone."""
        self.process.kill()
        self.process.wait()


class AxesFake(OrderedFake):
    """One whose answer is ``x ... f ...``, and then counts by name, of which ``first_count`` is the first."""

    first_count: ClassVar[str]

    def asked(self) -> tuple[list[float], list[float], dict[str, int]]:
        """Its displacements (m, or rad), the forces of its motors (N, or N·m), and its counts, of this instant."""
        words = self.answer().split()
        cut, rest = words.index("f"), words.index(self.first_count)
        counts = dict(zip(words[rest::2], map(int, words[rest + 1 :: 2]), strict=True))
        return [*map(float, words[1:cut])], [*map(float, words[cut + 1 : rest])], counts


@contextmanager
def ended(process: subprocess.Popen[str]) -> Iterator[None]:
    """Ends the process of a fake afterwards, and closes its streams."""
    try:
        yield
    finally:
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()
