"""One block of V in its loop: its link to the environment, its rung, its telemetry and its report.

The samples of its devices come from the coupling's own process (:mod:`manyhands.nodes.coupling.node`). Where a session
runs coupling and device in one process, the device's loop brings them (:mod:`manyhands.nodes.coupling.within`).
"""

from __future__ import annotations

from manyhands.nodes.coupling.port import CouplingPort
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import REALTIME, CouplingBundle
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.link.join import Join, Received, dropped_frames, stray_frames
from manyhands.nodes.link.supervisor_line import ControlLine
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.tick_events import TickEvents
from manyhands.nodes.rows.two_port import RowBuffer
from manyhands.nodes.wave_link.rows import user_row
from manyhands.protocol.clock import Duration
from manyhands.protocol.messages import Absent, Figures, Report, Role, Rung, Telemetry, Tool


class Block:
    """The block in its loop, and the :class:`manyhands.nodes.link.join.Listener` on its link to the environment.

    Attributes:
        port: the block, with its rung.
        environment: the link to the environment.
        jumps: how often the session had gone on to a later tick without this block.
        ticks: the tick after the latest.
        sent: the tick of the latest p that was sent; -1 before the first.
    """

    def __init__(self, bundle: CouplingBundle, environment: Join) -> None:
        """At rest, at rung 0."""
        self._bundle, self._common = bundle, bundle.common
        self.port = CouplingPort(bundle)
        self.environment = environment
        self._next_rung = 0
        self.jumps = self.ticks = 0
        self._stamp, self._pressed, self.sent = 0, 0, -1
        self._life: Life | None = None  # until the loop begins
        self._ports = len(self._common.ports)
        self._f: Floats = [0.0] * self._common.width  # the environment's force and what rides with it, filled in place
        self._rides: Floats = []  # what rides with the devices' last samples
        self._rows = RowBuffer(Role.COUPLING, self._common.telemetry_first, self._common.telemetry_ticks)
        self._events = TickEvents()

    @property
    def applied(self) -> Floats:
        """The force of the latest tick, within the limits of its devices, N, and what rides with it."""
        return self.port.f + self._f[self._ports :] if self._common.riding else self.port.f

    def begin(self, life: Life) -> None:
        """Begin the loop; ``life`` fails when the environment floods the link."""
        self._life = life

    def send(self, x: Floats, tick: int, stamp: int, pressed: int = 0) -> None:
        """Send the environment p(k), m, for the devices' x(k), m.

        Orientations that ride with x pass through as they are, here and on the way back.

        Args:
            x: those of all devices.
            tick: k.
            stamp: of the first sample, ns.
            pressed: the devices' buttons that are held down.
        """
        self.sent, self._pressed = tick, pressed
        self._stamp = stamp  # the age of the force is counted from the sample
        if self._common.riding:
            x, self._rides = x[: self._ports], x[self._ports :]
        self.port.up(x)
        self.environment.send(Tool, tick, stamp, self._signal, pressed)

    def send_again(self, tick: int) -> None:
        """Send the last p once more: the signal or its answer may have been lost, or the session has gone on."""
        self.environment.send(Tool, tick, self._stamp, self._signal, self._pressed)

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
            self.port.down(self._force)
        elif received is Received.DECLINED:
            environment.take_other(self._f, "future_tick")
            self.port.down(self._force)
            self.jumps += 1
        elif received is Received.RECONNECTED:
            self._next_rung = 0  # an environment that greets the block has put D_V of rung 0 into its loop
            if self.sent == tick:
                self.send_again(tick)
        return received

    @property
    def _signal(self) -> Floats:
        return self.port.p + self._rides if self._rides else self.port.p

    @property
    def _force(self) -> Floats:
        return self._f[: self._ports] if self._common.riding else self._f

    def climb(self, tick: int) -> int | None:
        """Change to the rung that the environment has just chosen, at rest; returns it, or None without a change."""
        rung = self._next_rung
        if rung == self.port.rung:
            return None
        self.port.change(rung)
        self._events.change_rung(tick, rung)
        return rung

    def settle(self, tick: int) -> None:
        """Step past ``tick``, and keep its row; all this can wait until the forces are on their way."""
        self.environment.settle(tick)
        self.port.book()
        self.ticks = tick + 1
        self._rows.add((*self.port.row(), *user_row(self.environment.row)))

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
        if self._rows.full:
            self.publish_rest(control, devices)

    def publish_rest(self, control: ControlLine, devices: tuple[Join, ...] = ()) -> None:
        """Send the telemetry of the ticks since the last one, if there are any."""
        rows = self._rows.filled
        if rows == 0:
            return
        numbers = {
            **self._numbers(),
            **stray_frames([*devices, self.environment]),
            **self._events.take(self.ticks - rows, self.ticks),
        }
        control.publish(Telemetry(self.ticks, Figures(numbers), self._rows.take()))

    def _numbers(self) -> dict[str, float]:
        """What telemetry and report have alike."""
        return {
            names.SATURATED: float(self.port.core.saturated),
            names.JUMPS: float(self.jumps),
            names.RUNG: float(self.port.rung),
            **names.ledger_figures(self.port.ledger),
            **self.environment.figures(),
        }

    def report(self, devices: tuple[Join, ...] = ()) -> Report:
        """Ticks, ledger, ticks with a clipped force, and the frames that were not admitted."""
        dropped = dropped_frames([*devices, self.environment])
        return Report(self.ticks, Figures(self._numbers(), {names.DROPPED: dropped}))
