"""A controller with an Ethernet port, as docs/drivers.md describes it: the page's board behind UDP, in its own process.

``python -m tests.fakes.ethernet FOLDER`` (with the page's board.py) prints its port. Its clock began before it did, and
is 100 ppm fast. Orders on standard input: ``forever`` (forces do not end), ``stall MS`` (neither read nor send for so
long), ``mute`` (send nothing any more), ``deaf`` (read nothing any more).
"""

from __future__ import annotations

import os
import select
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from .ordered import OrderedFake, ended

LAYOUT = struct.Struct("<QQ2d")
EVERY = 0.0005  # s, from one state to the next


@contextmanager
def fake_controller(folder: Path) -> Iterator[OrderedFake]:
    """A controller that runs meanwhile, and whose path is its address; ``folder`` has the page's files."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.fakes.ethernet", str(folder)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2],
    )  # fmt: skip
    with ended(process):
        assert process.stdout is not None
        yield OrderedFake(f"127.0.0.1:{int(process.stdout.readline())}", process)


def main() -> None:
    """Until standard input ends."""
    sys.path.insert(0, sys.argv[1])
    board = import_module("board").Board(2, "")
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", 0))
    link.setblocking(False)
    sys.stdout.write(f"{link.getsockname()[1]}\n")
    sys.stdout.flush()
    began, taken, peer, orders = time.monotonic(), 0, None, set[str]()
    due = stalled = began
    while True:
        wait = max(0.0, max(due, stalled) - time.monotonic())
        ready, _, _ = select.select([0] if time.monotonic() < stalled else [0, link], [], [], wait)
        now = 7_000_000_000 + int((time.monotonic() - began) * 1.0001e9)
        if 0 in ready:
            if not (said := os.read(0, 4096)):
                return
            for word, *rest in map(str.split, said.decode().splitlines()):
                orders.add(word)
                stalled = time.monotonic() + 1e-3 * float(rest[0]) if word == "stall" else stalled
        if link in ready and time.monotonic() >= stalled:
            data, peer = link.recvfrom(64)
            number, end, *f = LAYOUT.unpack(data)
            if number > taken and "deaf" not in orders:
                taken = number
                over = end <= now and "forever" not in orders
                board.exert([0.0, 0.0] if over else f, now, None if over or "forever" in orders else end)
        if time.monotonic() >= max(due, stalled):
            due = time.monotonic() + EVERY
            x = board.positions(now)
            if peer is not None and "mute" not in orders:
                link.sendto(LAYOUT.pack(taken, now, *x), peer)


if __name__ == "__main__":
    main()
