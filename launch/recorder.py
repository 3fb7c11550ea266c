"""What a supervisor asks of whoever writes its run down while it goes on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


class Recorder:
    """Who writes a run down while it goes on: here nobody, in :class:`RecorderProcess` a process of its own."""

    def start(self, directory: Path) -> None:
        """Start it; ``directory`` is the run's own."""

    def await_ready(self, interrupt: int) -> None:
        """Wait until it can be told something, or the descriptor ``interrupt`` is readable."""

    @property
    def fds(self) -> tuple[int, ...]:
        """Descriptors to wait on; when one of them is readable, :meth:`attend`."""
        return ()

    @property
    def has_room(self) -> bool:
        """Whether what nodes tell should be read on; False only where nothing may be lost."""
        return True

    def tell(self, frame: bytes | None) -> None:
        """Pass on what was told, now or when there is room for it; None is what is too long to be passed on."""

    def attend(self, ready: set[int]) -> str | None:
        """Hear what it says and supply it; returns why the recording has stopped, once, when that happens."""
        return None

    def finish(self, interrupt: int) -> str | None:
        """The session is over: have the rest written, unless ``interrupt`` becomes readable; returns as ``attend``."""
        return None

    def close(self) -> None:
        """End it if it still runs."""

    @property
    def missing(self) -> Mapping[str, int]:
        """Ticks that were never told of, by device, those devices that miss some."""
        return {}

    @property
    def failure(self) -> str | None:
        """What is wrong with a recording that has to be whole, the simulated clock's; None if nothing is."""
        return None

    def as_plain(self) -> dict[str, Any]:
        """What it adds to a report: ``recording``, unless there is none."""
        return {}
