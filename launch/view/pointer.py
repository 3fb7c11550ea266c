"""What a page may say: its token, where a hand wants a device, that it lets go; and how often. Pure.

A page is a stranger until it is proved otherwise: whatever it sends is bounded, checked against the session, and
answered with a sentence where it is wrong.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Final, TypeAlias

from manyhands.nodes.observer.about import About
from manyhands.protocol.clock import Instant

MAX_DEMAND_BYTES: Final = 4096
"""Longest message of a page: a position of every axis of the largest device that a browser can hold is shorter."""

DEMANDS_PER_S: Final = 100
"""Messages a second that a page may send in the long run: a pointer tells of its moves at most so often."""

DEMANDS_AT_ONCE: Final = 200
"""And so many at once, which a page may have in hand when its machine was busy."""


@dataclass(frozen=True)
class Hold:
    """A hand wants the device there: m, one entry an axis, none beyond the device's reach."""

    device: str
    position: tuple[float, ...]


@dataclass(frozen=True)
class LetGo:
    """A hand has let go of the device."""

    device: str


@dataclass(frozen=True)
class Wrong:
    """A message that is none of a page's; ``why`` in a sentence."""

    why: str


Demand: TypeAlias = Hold | LetGo | Wrong


def demand_of(text: str, about: About) -> Demand:
    """What a page's message means in this session."""
    match _parsed(text):
        case {"grasp": str(device), "position": list(position), **rest} if not rest:
            if device not in about.grips:
                return _no_grip(device, about)
            return _hold(device, position, about)
        case {"release": str(device), **rest} if not rest:
            return LetGo(device) if device in about.grips else _no_grip(device, about)
        case _:
            return Wrong('found no message of a page; expected {"grasp": NAME, "position": [m, ...]} or release')


def token_of(text: str) -> object:
    """The token in a page's first message; None where there is none."""
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


def _hold(device: str, position: list[object], about: About) -> Hold | Wrong:
    ports = about.nodes[device].ports
    numbers = [number for entry in position if (number := _number(entry)) is not None]
    if len(numbers) != len(position) or len(numbers) != len(ports):
        return Wrong(f"{device}: found {len(position)} entries; expected {len(ports)} numbers in m")
    limits = [about.reach.get(port, math.inf) for port in ports]
    return Hold(device, tuple(max(-r, min(r, x)) for x, r in zip(numbers, limits, strict=True)))


def _number(entry: object) -> float | None:
    if not isinstance(entry, int | float) or isinstance(entry, bool):
        return None
    try:
        number = float(entry)
    except OverflowError:  # an integer that no float holds
        return None
    return number if math.isfinite(number) else None


class Allowance:
    """How many messages a page may still send: a bucket that fills with time."""

    def __init__(self, now: Instant) -> None:
        self._left, self._then = float(DEMANDS_AT_ONCE), now

    def spend(self, now: Instant) -> bool:
        """Whether one more may be taken now."""
        filled = self._left + (now - self._then) / 1e9 * DEMANDS_PER_S
        self._left, self._then = min(float(DEMANDS_AT_ONCE), filled), now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
