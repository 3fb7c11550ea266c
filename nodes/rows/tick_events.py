"""Events between the ticks of a node, recorded with their tick: figures of its telemetry such as ``released@217``.

| figure | of a | value |
|---|---|---|
| ``began@k`` | device, coupling | 1: the process began at rest, and its first row is that of tick k |
| ``jumped@k`` | device, coupling | the tick after the row before; the session had gone on, and the next row is of k |
| ``released@k`` | device | periods without force while the device awaited the forces of tick k |
| ``rung@k`` | device, coupling | the rung to which the node changed in tick k, at rest |
| ``leaving@k`` | device | 1: with the sample of tick k it begins to let go, by the ramp and for good |
| ``frozen:cx@k`` | environment | 1: from tick k on the coupling cx was sent no force |
| ``free:cx@k`` | environment | 1: from tick k on nobody was at cx's wave link yet, which was sent no force |
| ``returned:cx@k`` | environment | 1: from tick k on it was again |
| ``held:cx@k`` | environment | ticks, from tick k on, in which cx was held, for its signal had not come |
| ``raised@k`` | environment | 1: in tick k it raised the forces of all couplings again by the ramp |
| ``pressed:d.grip@k`` | device, environment | 1: from tick k on the button grip of d is held down; 0: no more |
| ``linked:cx@k`` | environment | 1: in tick k the tool took its place from the first wave of a life of cx's wave link |

Rows and events travel in one telemetry message, so a recording that has the rows has the events as well. An audit
computes the node again from its rows and events alone. A tick without an event costs nothing. An environment records
``began@k`` and ``jumped@k`` as well.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import Final, NamedTuple

MOST_EVENTS: Final = 512
"""The most events of one telemetry; further releases and holds are only counted in the figures, which show it."""

_FIGURE: Final = re.compile(
    r"(?:(began|jumped|released|rung|leaving|raised)|(frozen|free|returned|held|linked|pressed):(.+))@([0-9]{1,15})"
)
_MOST_VALUE: Final = 2.0**53


class Kind(StrEnum):
    """The kinds of events; the table of this module explains each."""

    BEGAN = "began"
    JUMPED = "jumped"
    RELEASED = "released"
    RUNG = "rung"
    LEAVING = "leaving"
    FROZEN = "frozen"
    FREE = "free"
    RETURNED = "returned"
    HELD = "held"
    LINKED = "linked"
    RAISED = "raised"
    PRESSED = "pressed"


class TickEvent(NamedTuple):
    """One event: its kind, its tick, its value by the table of this module, and the peer or button that it is about.

    ``peer`` is empty for an event of the node itself.
    """

    kind: Kind
    tick: int
    value: int
    peer: str = ""


class TickEvents:
    """The events of one process since its last telemetry."""

    def __init__(self) -> None:
        """No event yet, and no telemetry."""
        self._figures: dict[str, float] = {}
        self._held: dict[str, int] = {}  # by coupling, the tick since which it has been held without a break
        self._next: int | None = None  # the tick after the last row of the last telemetry

    def release(self, tick: int) -> None:
        """Record a period without force, while the forces of ``tick`` were awaited."""
        name = f"{Kind.RELEASED}@{tick}"
        if name in self._figures or len(self._figures) < MOST_EVENTS:
            self._figures[name] = self._figures.get(name, 0.0) + 1.0

    def change_rung(self, tick: int, rung: int) -> None:
        """Record that the node changed to ``rung`` in ``tick``."""
        self._figures[f"{Kind.RUNG}@{tick}"] = float(rung)

    def leave(self, tick: int) -> None:
        """Record that the device begins to let go for good with its sample of ``tick``."""
        self._figures[f"{Kind.LEAVING}@{tick}"] = 1.0

    def freeze(self, tick: int, coupling: str) -> None:
        """Record that the environment sends ``coupling`` no force from ``tick`` on."""
        self._figures[f"{Kind.FROZEN}:{coupling}@{tick}"] = 1.0

    def begin_free(self, tick: int, coupling: str) -> None:
        """Record that nobody is at the wave link of ``coupling`` yet, with which the environment begins in ``tick``."""
        self._figures[f"{Kind.FREE}:{coupling}@{tick}"] = 1.0

    def activate(self, tick: int, coupling: str) -> None:
        """Record that the environment sends ``coupling`` its force again from ``tick`` on."""
        self._figures[f"{Kind.RETURNED}:{coupling}@{tick}"] = 1.0

    def hold(self, tick: int, coupling: str) -> None:
        """Record that ``coupling`` was held in ``tick``."""
        first = self._held.get(coupling, tick)
        name = f"{Kind.HELD}:{coupling}@{first}"
        if self._figures.get(name) != float(tick - first):  # it was not held in the tick before
            first, name = tick, f"{Kind.HELD}:{coupling}@{tick}"
        self._held[coupling] = first
        if name in self._figures or len(self._figures) < MOST_EVENTS:
            self._figures[name] = tick - first + 1.0

    def raise_again(self, tick: int) -> None:
        """Record that the environment raised the forces of all couplings again in ``tick``, by the ramp."""
        if len(self._figures) < MOST_EVENTS:
            self._figures[f"{Kind.RAISED}@{tick}"] = 1.0

    def press(self, tick: int, button: str, held_down: bool) -> None:
        """Record that ``button`` is held down from ``tick`` on, or not any more.

        How often it may change is bounded (:mod:`manyhands.nodes.kernel.buttons`), so none of these is left out.
        """
        self._figures[f"{Kind.PRESSED}:{button}@{tick}"] = float(held_down)

    def link(self, tick: int, coupling: str) -> None:
        """Record that a life of the wave link of ``coupling`` begins with the tool's place in ``tick``."""
        self._figures[f"{Kind.LINKED}:{coupling}@{tick}"] = 1.0

    def take(self, first: int, end: int) -> dict[str, float]:
        """The events as figures of the telemetry whose rows are ``first`` to ``end - 1``; each is returned once."""
        figures, self._figures = self._figures, {}
        if self._next is None:
            figures[f"{Kind.BEGAN}@{first}"] = 1.0
        elif first != self._next:
            figures[f"{Kind.JUMPED}@{first}"] = float(self._next)
        self._next = end
        return figures


def events_in(figures: Mapping[str, float]) -> Iterator[TickEvent]:
    """The events among the figures of one telemetry; a figure with an event's name but no whole value is none."""
    for name, value in figures.items():
        found = _FIGURE.fullmatch(name)
        if found is not None and 0.0 <= value <= _MOST_VALUE and value == int(value):
            yield TickEvent(Kind(found[1] or found[2]), int(found[4]), int(value), found[3] or "")
