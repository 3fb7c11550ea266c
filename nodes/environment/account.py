"""What the environment keeps of its ticks: where tools and masses were, its ledger, and when it tells of them.

Rows hold the lists that the core has made anyway; what costs is done once in ``telemetry_ticks`` ticks.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import Common
from manyhands.nodes.control import ControlLine
from manyhands.nodes.environment.cores import Core
from manyhands.nodes.linear_map import Floats
from manyhands.nodes.tick_events import TickEvents
from manyhands.protocol.messages import Telemetry


class Account:
    """The traces of the environment.

    Attributes:
        ticks: the tick after the latest.
    """

    def __init__(self, common: Common) -> None:
        rows = common.telemetry_ticks
        self._tools: list[Floats] = [[]] * rows
        self._masses: list[Floats] = [[]] * rows
        self._energy = [0.0] * rows
        self._filled, self._rows, self._every = 0, common.telemetry_first, rows
        self.ticks = 0

    def tick(self, tick: int, core: Core) -> None:
        """``core`` has settled ``tick``."""
        row, ledger = self._filled, core.ledger
        self._tools[row], self._masses[row] = core.tools, core.masses
        self._energy[row] = 0.0 if ledger is None else ledger.total
        self._filled = row + 1
        self.ticks = tick + 1

    @property
    def due(self) -> bool:
        """Whether there are as many rows as a telemetry has."""
        return self._filled == self._rows

    def publish(
        self,
        control: ControlLine,
        core: Core,
        figures: Mapping[str, float],
        late: Mapping[str, list[int]],
        events: TickEvents,
    ) -> bool:
        """Telemetry of the ticks since the last; whether there are any.

        Args:
            control: the line to the supervisor.
            core: the environment.
            figures: what is told besides.
            late: by coupling, the ticks since the last telemetry in which it was late.
            events: what happened since the last telemetry.
        """
        rows, self._filled, self._rows = self._filled, 0, self._every
        if rows == 0:
            return False
        traces = {
            names.TOOL_POSITION: np.array(self._tools[:rows]),
            **({names.MASS_POSITION: np.array(self._masses[:rows])} if self._masses[0] else {}),
            **names.ledger_trace(core.ledger, self._energy[:rows]),
            **{names.WAITED_IN + name: np.array(ticks, dtype=np.float64)[:, None] for name, ticks in late.items()},
        }
        happened = events.take(self.ticks - rows, self.ticks)
        control.publish(Telemetry(self.ticks, {**figures, **happened}, traces))
        return True
