"""Buttons of devices: which are held down, and how often that may change.

The state of some buttons is one integer, whose bit i is 1 while the i-th of them is held down. A device states it with
each sample, its coupling hands it on with the tool's position, and the environment learns it in the same tick. What
counts is the state, and not a message of its change: a signal that is lost, or sent twice, changes nothing.

**A change counts once in** :data:`LEAST` **seconds for each button**: the first at once, a further one when that time
is over. No finger is faster. A contact that bounces, or a peer that lies, does so at every tick; and every change is an
event of the telemetry, whose number is bounded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, TypeAlias

LEAST: Final = 0.02
"""The least time between two changes of a button, s: five changes in a tenth of a second, the time of a telemetry."""

Script: TypeAlias = tuple[tuple[float, float], ...]
"""When a button is held down: from, and until, s; one after the other."""


class Buttons:
    """The buttons at a node, in the order of its bundle.

    Attributes:
        names: of the buttons, each after its device.
        state: those that are held down.
    """

    __slots__ = ("_every", "_free", "names", "state")

    def __init__(self, names: Sequence[str], T: float) -> None:
        """None is held down; T is the period, s."""
        self.names = tuple(names)
        self._every = max(1, math.ceil(LEAST / T - 1e-9))  # ticks; a quotient of two decimals
        self._free = [0] * len(self.names)  # the first tick in which each may change again
        self.state = 0

    def take(self, k: int, wanted: int) -> int:
        """The buttons that change in tick ``k``, where those of ``wanted`` are held down; ticks never decrease."""
        differ = wanted ^ self.state
        if not differ:
            return 0
        changed = 0
        for i in range(len(self._free)):
            if differ >> i & 1 and k >= self._free[i]:
                changed |= 1 << i
                self._free[i] = k + self._every
        self.state ^= changed
        return changed

    def changes(self, changed: int) -> Iterator[tuple[str, bool]]:
        """Of each button that has ``changed`` its name, and whether it is held down now."""
        for i, name in enumerate(self.names):
            if changed >> i & 1:
                yield name, bool(self.state >> i & 1)

    def table(self) -> dict[str, float]:
        """By button, 1 while it is held down, else 0."""
        return {name: float(self.state >> i & 1) for i, name in enumerate(self.names)}


def picked(state: int, numbers: Sequence[int]) -> int:
    """The state of some buttons among others: bit i is the bit ``numbers[i]`` of ``state``."""
    return sum((state >> number & 1) << i for i, number in enumerate(numbers))


def scripted(scripts: Sequence[Script], t: float) -> int:
    """The buttons that their scripts hold down at the time t, s."""
    state = 0
    for i, script in enumerate(scripts):
        for begin, end in script:
            if begin <= t < end:
                state |= 1 << i
    return state
