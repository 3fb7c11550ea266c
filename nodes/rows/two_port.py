"""What a party does in a tick, as its loop, the simulation and the audit call it: without sockets, and without a clock.

Between a hand and the world stand two-ports: motion goes up through them, and force comes down,

    device ──x──▶ coupling ──p──▶ (a wave link) ──p──▶ environment
    device ◀─f_v── coupling ◀─f_v── (a wave link) ◀─f_e─ environment

The device with its hand is the one end (:class:`manyhands.nodes.device.tick.DeviceTick`: ``sample`` and ``exert``), the
environment the other (:mod:`manyhands.nodes.environment.core`: ``react`` and ``settle``). Whatever a party does, it
reports by :data:`Row`.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from itertools import accumulate
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.protocol.channels import TOPICS
from manyhands.protocol.messages import Role

Row: TypeAlias = tuple[Sequence[float], ...]
"""A party's numbers of a tick: a part for each topic of its role (:data:`manyhands.protocol.channels.TOPICS`), in the
table's order; a part without numbers where it has none of the topic, and no part where it has none of the last topics.
A device's delay is measured by its loop alone, and is in no row of a party."""


class TwoPort(Protocol):
    """What stands between a hand and the world; a tick is :meth:`up`, :meth:`down`, :meth:`book`."""

    def up(self, x: Floats) -> Floats:
        """The motion towards the world, m, for that from the hand's side, m."""
        ...

    def down(self, f: Floats) -> Floats:
        """The force towards the hand, N, for that of the world, N; both lists are kept until :meth:`book`."""
        ...

    def book(self) -> None:
        """Do the accounts of the tick, and step to the next one: nobody waits for it."""
        ...


class RowBuffer:
    """The rows of a node since its last telemetry.

    Each tick is written down as numbers at once: to make arrays of 100 ticks of 64 links takes 5 ms, which would be
    five late ticks.

    Attributes:
        filled: the number of rows.
    """

    __slots__ = ("_every", "_traces", "_values", "_wanted", "_widths", "filled")

    def __init__(self, role: Role, first: int, every: int) -> None:
        """No row yet.

        Args:
            role: of the node; its topics are those of a row's parts.
            first: the rows of the first telemetry; fewer, so that not all nodes send theirs in the same tick.
            every: the rows of each further one.
        """
        self._traces = tuple(topic.trace for topic in TOPICS[role])
        self._wanted, self._every = first, every
        self._values, self._widths = array("d"), [0]
        self.filled = 0

    @property
    def full(self) -> bool:
        """Whether the rows fill a telemetry message."""
        return self.filled == self._wanted

    def add(self, row: Row) -> None:
        """Write down a tick's row, of which every part has as many numbers as in the row before."""
        if self.filled == 0:
            self._widths = [len(part) for part in row]
        numbers: Floats = []
        for part in row:
            numbers.extend(part)
        self._values.fromlist(numbers)
        self.filled += 1

    def take(self) -> dict[str, NDArray[np.float64]]:
        """The rows since the last call, as traces, ticks x columns; without traces of which they have no numbers."""
        rows = np.frombuffer(self._values).reshape(self.filled, -1)
        self.filled, self._wanted, self._values = 0, self._every, array("d")
        ends = list(accumulate(self._widths))
        found = zip(self._traces, self._widths, ends, strict=False)  # a row may end before the topics do
        return {name: rows[:, end - width : end] for name, width, end in found if width}
