"""Which page holds which device: one at a time, and none for longer than it says so."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from manyhands.launch.view.demands import Hold
from manyhands.nodes.observer.about import About
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.messages import Grasp, Release
from manyhands.protocol.transport.grip import GripOutlet

GRIP_LASTS: Final = from_seconds(3.0)
"""How long a device is held for a page that says nothing more: a page that holds one says so ten times a second."""


class Holding:
    """The devices that can be held, and the pages (by number) that hold them."""

    def __init__(self, directory: Path, about: About) -> None:
        """Nobody holds any.

        Raises:
            TransportError: a device cannot be there.
        """
        self._outlets: dict[str, GripOutlet] = {}
        self._held: dict[str, tuple[int, Instant]] = {}
        for device in about.grips:
            self._outlets[device] = GripOutlet(directory, device)

    def hold(self, page: int, demand: Hold, now: Instant) -> str | None:
        """Hold a device for a page; returns why not, if not."""
        holder, _ = self._held.get(demand.device, (page, now))
        if holder != page:
            return f"{demand.device} is held by another page"
        if not self._outlets[demand.device].say(Grasp(np.array(demand.position))):
            self._held.pop(demand.device, None)
            return f"{demand.device} cannot be held now: it is not there, or does not listen"
        self._held[demand.device] = page, now
        return None

    def let_go(self, page: int, device: str | None = None) -> None:
        """Let go of what a page holds: of one device, or of all."""
        for held, (holder, _) in list(self._held.items()):
            if holder == page and device in (None, held):
                self._release(held)

    def expire(self, now: Instant) -> None:
        """Let go of what pages hold that have said nothing for a while."""
        for device, (_, said) in list(self._held.items()):
            if now - said > GRIP_LASTS:
                self._release(device)

    def of(self, page: int) -> dict[str, str]:
        """Of each device that is held, whether it is held ``here`` or ``elsewhere``, as seen from a page."""
        return {device: "here" if holder == page else "elsewhere" for device, (holder, _) in self._held.items()}

    def close(self) -> None:
        """Let go of everything. A second time does nothing."""
        for device in list(self._held):
            self._release(device)
        for outlet in self._outlets.values():
            outlet.close()
        self._outlets.clear()

    def _release(self, device: str) -> None:
        del self._held[device]
        self._outlets[device].say(Release())  # a device that does not hear it lets go by itself, or is gone
