"""The messages of a page (its token, hold a device, let go of it), their limits, and which page holds which device.

A page is not trusted: the size and number of its messages are bounded, each is checked against the session, and a wrong
one is answered with a sentence. One page at a time holds a device, and only as long as it keeps saying so. The messages
are parsed without input or output; :class:`Holding` alone sends to devices.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, unit
from manyhands.nodes.monitor.session_state import About
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.messages import Grasp, Release
from manyhands.protocol.transport.pointer import PointerOutlet

MAX_DEMAND_BYTES: Final = 4096
"""Longest message of a page, in bytes: the positions of the largest device that a browser can hold take less."""

DEMANDS_PER_S: Final = 100
"""Messages a second that a page may send in the long run: a pointer's moves come at most this often."""

DEMANDS_AT_ONCE: Final = 200
"""Messages that a page may send at once, as it may after its machine was busy."""


@dataclass(frozen=True)
class Hold:
    """A request to hold a device.

    Attributes:
        device: its name.
        position: m, one entry for each axis, within the device's reach.
        turn: of a device whose orientation is a port, the unit quaternion of where it is to be turned; None for a
            hand that does not turn it.
    """

    device: str
    position: tuple[float, ...]
    turn: Quaternion | None = None


@dataclass(frozen=True)
class LetGo:
    """A request to let go of the device."""

    device: str


@dataclass(frozen=True)
class Wrong:
    """A message that no page sends, or that does not fit the session; ``why`` is a sentence."""

    why: str


Demand: TypeAlias = Hold | LetGo | Wrong


def demand_of(text: str, about: About) -> Demand:
    """The request in a page's message, checked against this session."""
    match _parsed(text):
        case {"grasp": str(device), "position": list(position), **rest} if rest.keys() <= {"turn"}:
            if device not in about.grips:
                return _no_grip(device, about)
            return hold_of(device, position, about, rest.get("turn"))
        case {"release": str(device), **rest} if not rest:
            return LetGo(device) if device in about.grips else _no_grip(device, about)
        case _:
            expected = '{"grasp": NAME, "position": [m, ...]}, perhaps with {"turn": [w, x, y, z]}, or release'
            return Wrong(f"found no message of a page; expected {expected}")


def token_of(text: str) -> object:
    """The token in a page's message; None where it has none."""
    match _parsed(text):
        case {"token": token, **rest} if not rest:
            return token
        case _:
            return None


def _parsed(text: str) -> object:
    if len(text.encode(errors="replace")) > MAX_DEMAND_BYTES:
        return None
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def _no_grip(device: str, about: About) -> Wrong:
    return Wrong(f"found {device[:96]!r}; expected a device that can be held: {', '.join(about.grips) or 'none'}")


def hold_of(device: str, position: Sequence[object], about: About, turn: object = None) -> Hold | Wrong:
    """The request to hold a device that can be held at a position, which ends at the device's reach.

    ``turn`` is where it is to be turned, a unit quaternion, or None; a device without an orientation is not turned.
    """
    ports = about.nodes[device].ports
    numbers = [number for entry in position if (number := _number(entry)) is not None]
    if len(numbers) != len(position) or len(numbers) != len(ports):
        return Wrong(f"{device}: found {len(position)} entries; expected {len(ports)} numbers in m")
    limits = [about.reach.get(port, math.inf) for port in ports]
    within = tuple(max(-r, min(r, x)) for x, r in zip(numbers, limits, strict=True))
    if turn is None:
        return Hold(device, within)
    if device not in about.hands:
        return Wrong(f"{device}: found a turn; expected none, for its orientation is no port")
    wanted = _turn(turn)
    if wanted is None:
        return Wrong(f"{device}: found a turn that is none; expected a unit quaternion, [w, x, y, z]")
    return Hold(device, within, wanted)


def _turn(entries: object) -> Quaternion | None:
    """The orientation in a page's message; None where it is none."""
    if not isinstance(entries, list) or len(entries) != len(UPRIGHT):
        return None
    parts = [number for entry in entries if (number := _number(entry)) is not None]
    return unit(parts) if len(parts) == len(UPRIGHT) else None


def _number(entry: object) -> float | None:
    if not isinstance(entry, int | float) or isinstance(entry, bool):
        return None
    try:
        number = float(entry)
    except OverflowError:  # an integer that no float holds
        return None
    return number if math.isfinite(number) else None


class MessageAllowance:
    """How many messages a page may still send: a token bucket that fills with time."""

    def __init__(self, now: Instant) -> None:
        self._left, self._then = float(DEMANDS_AT_ONCE), now

    def spend(self, now: Instant) -> bool:
        """Whether one more message is allowed now; if so, it is counted."""
        filled = self._left + (now - self._then) / 1e9 * DEMANDS_PER_S
        self._left, self._then = min(float(DEMANDS_AT_ONCE), filled), now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


GRIP_LASTS: Final = from_seconds(3.0)
"""How long a device stays held without a message of its page; a page that holds a device sends ten a second."""


class Holding:
    """The devices that can be held, and the pages that hold them, by number; a node of ROS 2 counts as a page."""

    def __init__(self, directory: Path, about: About) -> None:
        """No device is held.

        Raises:
            TransportError: the socket to a device cannot be made.
        """
        self._outlets: dict[str, PointerOutlet] = {}
        self._held: dict[str, tuple[int, Instant]] = {}
        for device in about.grips:
            self._outlets[device] = PointerOutlet(directory, device)

    def hold(self, page: int, demand: Hold, now: Instant) -> str | None:
        """Hold a device for a page; returns None, or why it cannot be held."""
        holder, _ = self._held.get(demand.device, (page, now))
        if holder != page:
            return f"{demand.device} is held by another page"
        if not self._outlets[demand.device].send(Grasp(np.array([*demand.position, *(demand.turn or ())]))):
            self._held.pop(demand.device, None)
            return f"{demand.device} cannot be held now: its process is not there, or does not receive"
        self._held[demand.device] = page, now
        return None

    def let_go(self, page: int, device: str | None = None) -> None:
        """Let go of one device that a page holds, or of all."""
        for held, (holder, _) in list(self._held.items()):
            if holder == page and device in (None, held):
                self._release(held)

    def expire(self, now: Instant) -> None:
        """Let go of the devices whose pages have sent nothing for :data:`GRIP_LASTS`."""
        for device, (_, latest) in list(self._held.items()):
            if now - latest > GRIP_LASTS:
                self._release(device)

    def of(self, page: int) -> dict[str, str]:
        """For each held device, whether this page holds it (``here``) or another page does (``elsewhere``)."""
        return {device: "here" if holder == page else "elsewhere" for device, (holder, _) in self._held.items()}

    def close(self) -> None:
        """Let go of every device, and close the sockets. A second call does nothing."""
        for device in list(self._held):
            self._release(device)
        for outlet in self._outlets.values():
            outlet.close()
        self._outlets.clear()

    def _release(self, device: str) -> None:
        del self._held[device]
        self._outlets[device].send(Release())  # a device that does not receive it lets go by itself, or has ended
