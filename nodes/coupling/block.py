"""One block of V in its loop: its link to the environment, its rung, its telemetry and its report.

The samples of its devices come from the coupling's own process (:mod:`manyhands.nodes.coupling.node`). Where a session
runs coupling and device in one process, the device's loop brings them (:mod:`manyhands.nodes.coupling.within`).
"""

from __future__ import annotations

import numpy as np

from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import REALTIME, CouplingBundle
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.link.join import Join, Received, WaveRow, dropped_frames, stray_frames
from manyhands.nodes.link.supervisor_line import ControlLine
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.tick_events import TickEvents
from manyhands.nodes.wave_link.rows import wave_traces
from manyhands.protocol.clock import Duration
from manyhands.protocol.messages import Absent, Figures, Report, Rung, Telemetry, Tool


class Block:
    """The block in its loop, and the :class:`manyhands.nodes.link.join.Listener` on its link to the environment.

    Attributes:
        core: the block at its present rung.
        environment: the link to the environment.
        rung: the present rung of the ladder.
        jumps: how often the session had gone on to a later tick without this block.
        ticks: the tick after the latest.
        applied: the force of the latest tick, within its limits, N.
        sent: the tick of the latest p that was sent; -1 before the first.
    """

    def __init__(self, bundle: CouplingBundle, environment: Join) -> None:
        """At rest, at rung 0."""
        self._bundle, self._common = bundle, bundle.common
        self.core = self._core_of(0)
        self.environment = environment
        self.rung = self._next_rung = 0
        self.jumps = self.ticks = 0
        self._stamp, self.sent = 0, -1
        self._life: Life | None = None  # until the loop begins
        m = len(self._common.ports)
        self._p: Floats = [0.0] * m
        self._f: Floats = [0.0] * m  # the environment's force, filled in place
        self.applied = self._f
        self._rows = self._common.telemetry_first
        # allocated here, so that a tick allocates nothing of the telemetry's size
        rows = self._common.telemetry_ticks
        self._trace_p: list[Floats] = [self._p] * rows
        self._trace_f: list[Floats] = [self._p] * rows
        self._energy = [0.0] * rows
        self._waves: list[WaveRow] = [] if environment.row is None else [environment.row] * rows
        self._filled = 0
        self._events = TickEvents()

    def _core_of(self, rung: int) -> CouplingCore:
        bundle, of = self._bundle, self._bundle.rungs[rung]
        return CouplingCore(of.block, of.K, of.level, bundle.common.period, bundle.limits.force)

    def begin(self, life: Life) -> None:
        """Begin the loop; ``life`` fails when the environment floods the link."""
        self._life = life

    def send(self, x: Floats, tick: int, stamp: int) -> None:
        """Send the environment p(k), m, for the devices' x(k), m; ``stamp`` is that of the first sample, ns."""
        self.sent = tick
        self._stamp = stamp  # the age of the force is counted from the sample
        self._p = p = self.core.free_position(x)
        self.environment.send(Tool, tick, stamp, p)

    def send_again(self, tick: int) -> None:
        """Send the last p once more: the signal or its answer may have been lost, or the session has gone on."""
        self.environment.send(Tool, tick, self._stamp, self._p)

    def hear(self, tick: int, timeout: Duration) -> Received:
        """Listen for f_v(k), at most ``timeout``.

        Returns:
            SIGNAL when :attr:`applied` is the force of ``tick``. DECLINED when :attr:`applied` belongs to the later
            tick ``environment.other_tick``: it is zero, or holds the block's end. RECONNECTED when the environment is
            back; p(k) is then sent again, if it was sent before. NOTHING otherwise.
        """
        environment = self.environment
        received = environment.hear(self._f, tick, timeout, self)
        if received is Received.SIGNAL:
            self.applied = self.core.limited(self._f)
        elif received is Received.DECLINED:
            environment.take_other(self._f, "future_tick")
            self.applied = self.core.limited(self._f)
            self.jumps += 1
        elif received is Received.RECONNECTED:
            self._next_rung = 0  # an environment that greets the block has put D_V of rung 0 into its loop
            if self.sent == tick:
                self.send_again(tick)
        return received

    def climb(self, tick: int) -> int | None:
        """Change to the rung that the environment has just chosen, at rest; returns it, or None without a change."""
        if self._next_rung == self.rung:
            return None
        before, self.rung = self.core, self._next_rung
        self.core = self._core_of(self.rung)
        self.core.succeed(before)
        self._events.change_rung(tick, self.rung)
        return self.rung

    def settle(self, tick: int) -> None:
        """Step past ``tick``, and keep its row; all this can wait until the forces are on their way."""
        self.environment.settle(tick)
        self.core.absorb(self.applied)
        self.ticks = tick + 1
        row, ledger = self._filled, self.core.ledger
        self._trace_p[row], self._trace_f[row] = self._p, self.applied.copy()
        self._energy[row] = 0.0 if ledger is None else ledger.total
        if (wave := self.environment.row) is not None:
            self._waves[row] = wave
        self._filled += 1

    def on_other_tick(self, join: Join, other: int, awaited: int) -> bool:
        """Stop waiting at the force of a later tick: the session has gone on without this block.

        It is zero, or in real time the force that holds the block's end (:mod:`manyhands.nodes.environment.clutch`).
        """
        return other > awaited and (join.other_zero or self._common.clock == REALTIME)

    def on_notice(self, join: Join, message: Rung | Absent) -> bool:
        """Note the environment's change of rung; the zero force that follows is the first of the new rung."""
        if isinstance(message, Rung) and message.rung < len(self._bundle.rungs):
            self._next_rung = message.rung
        return False

    def flooded(self, text: str) -> None:
        """End the node: the environment floods the link, and its forces cannot be found among other frames in time."""
        if self._life is not None:
            self._life.fail(text)

    def publish(self, control: ControlLine, devices: tuple[Join, ...] = ()) -> None:
        """Send telemetry once its rows are full: its encoding costs time once in ``telemetry_ticks`` ticks."""
        if self._filled == self._rows:
            self.publish_rest(control, devices)

    def publish_rest(self, control: ControlLine, devices: tuple[Join, ...] = ()) -> None:
        """Send the telemetry of the ticks since the last one, if there are any."""
        rows, self._filled, self._rows = self._filled, 0, self._common.telemetry_ticks
        if rows == 0:
            return
        numbers = {
            **self._numbers(),
            **stray_frames([*devices, self.environment]),
            **self._events.take(self.ticks - rows, self.ticks),
        }
        traces = {
            names.FREE_POSITION: np.array(self._trace_p[:rows]),
            names.FORCE: np.array(self._trace_f[:rows]),
            **names.ledger_trace(self.core.ledger, self._energy[:rows]),
            **wave_traces(self._waves[:rows]),
        }
        control.publish(Telemetry(self.ticks, Figures(numbers), traces))

    def _numbers(self) -> dict[str, float]:
        """What telemetry and report have alike."""
        return {
            names.SATURATED: float(self.core.saturated),
            names.JUMPS: float(self.jumps),
            names.RUNG: float(self.rung),
            **names.ledger_figures(self.core.ledger),
            **self.environment.figures(),
        }

    def report(self, devices: tuple[Join, ...] = ()) -> Report:
        """Ticks, ledger, ticks with a clipped force, and the frames that were not admitted."""
        dropped = dropped_frames([*devices, self.environment])
        return Report(self.ticks, Figures(self._numbers(), {names.DROPPED: dropped}))
