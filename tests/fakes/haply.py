"""A fake of Haply's Inverse Service, in a process of its own (:mod:`tests.fakes.haply_service`)."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any


class FakeHaply:
    """A running service.

    Attributes:
        port: of WebSocket and HTTP.
        events: of the events.
        process: that it runs in.
    """

    def __init__(self, within: Sequence[str] = (), **given: Any) -> None:
        self._within, self._given = within, given
        self.port = self.events = 0
        self.start()

    def start(self) -> None:
        """Start it, on the ports that it had before, if it had any."""
        at = {"port": self.port, "events": self.events} if self.port else {}
        self.process = subprocess.Popen(
            [*self._within, sys.executable, str(Path(__file__).with_name("haply_service.py")),
             json.dumps(self._given | at)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.port, self.events = map(int, self._line().split())

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def order(self, *lines: str) -> dict[str, Any]:
        """Give orders of haply_service.py, all at once; returns what it is like after the last of them."""
        assert self.process.stdin is not None
        self.process.stdin.write("".join(f"{line}\n" for line in lines))
        self.process.stdin.flush()
        *_, found = [json.loads(self._line()) for _ in lines]
        return dict(found)

    def asked(self, name: str = "049D") -> dict[str, Any]:
        """How a device stands."""
        found: dict[str, Any] = self.order("ask")["devices"][name]
        return found

    def kill(self) -> None:
        """End it at once."""
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()


@contextmanager
def fake_haply(within: Sequence[str] = (), **given: Any) -> Iterator[FakeHaply]:
    """A service that runs meanwhile; ``given`` stands in for what DEFAULTS of haply_service.py has.

    ``within`` stands before its command, as :meth:`tests.support.wan.Wan.within` gives it.
    """
    one = FakeHaply(within, **given)
    try:
        yield one
    finally:
        one.kill()
