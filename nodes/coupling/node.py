"""The coupling block's process: x of its own ports in, p out; f_v in, f_v of its own ports out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import CouplingBundle
from manyhands.nodes.control import ControlLine
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.exchange import Joint, bounds_by_peer, establish
from manyhands.nodes.life import Life
from manyhands.protocol.clock import RealtimeClock
from manyhands.protocol.messages import Force, Reaction, Report, Role, Sample, SignalMessage, Start, Telemetry, Tool
from manyhands.protocol.transport import Link


class CouplingNode:
    """A :class:`manyhands.nodes.process.Node` for one block of V."""

    def __init__(self, bundle: CouplingBundle) -> None:
        """Make the node."""
        common = bundle.common
        self._common, self._feedthrough, self._limits = common, bundle.block.D, bundle.limits
        self._core = CouplingCore(bundle.block, bundle.K, bundle.level, common.period, bundle.limits.force)
        self._devices: list[Joint] = []
        self._environment: list[Joint] = []
        self._ticks = 0
        # filled in place: nothing of telemetry's size is allocated in a tick
        rows, m = common.telemetry_ticks if common.traces else 0, len(common.ports)
        self._trace_p, self._trace_f = np.zeros((rows, m)), np.zeros((rows, m))

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with the environment, which is told D_V, and with the block's devices."""
        admits: dict[str, type[SignalMessage]] = {
            peer.name: Reaction if peer.role is Role.ENVIRONMENT else Sample for peer in self._common.peers
        }
        step = [self._common.period * speed for speed in self._limits.speed]
        bounds = bounds_by_peer(self._common, Role.DEVICE, self._limits.displacement, step)
        joints, _ = establish(self._common, links, admits, RealtimeClock(), self._feedthrough, bounds)
        self._devices = [j for j in joints if j.peer.role is Role.DEVICE]
        self._environment = [j for j in joints if j.peer.role is Role.ENVIRONMENT]

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Run the ticks, paced by the devices' samples."""
        x, f = np.zeros(len(self._common.ports)), np.zeros(len(self._common.ports))
        core, devices, environment = self._core, self._devices, self._environment
        rows, traces = self._common.telemetry_ticks, self._common.traces
        tick = 0
        while not life.stopping and (start.ticks == 0 or tick < start.ticks):
            if not all(joint.receive_into(x, tick, life) for joint in devices):
                break
            stamp = devices[0].gate.stamp  # the chain's age is counted from the sample
            p = core.free_position(x)
            for joint in environment:
                joint.send(Tool, tick, stamp, p)
            if not all(joint.receive_into(f, tick, life) for joint in environment):
                break
            applied = core.limited(f)
            for joint in devices:
                joint.send(Force, tick, stamp, applied)
            core.absorb(applied)
            if traces:
                row = tick % rows
                self._trace_p[row], self._trace_f[row] = p, applied
            tick += 1
            self._ticks = tick
            if tick % rows == 0:
                self._publish(control, rows)
        if traces and (rest := tick % rows) > 0:
            self._publish(control, rest)

    def report(self) -> Report:
        """Ticks, ledger and how often the force was clipped."""
        return Report(
            self._ticks,
            names.ledger_figures(self._core.ledger),
            {
                names.SATURATED: self._core.saturated,
                **names.dropped_frames([*self._devices, *self._environment]),
            },
            {},
        )

    def _publish(self, control: ControlLine, rows: int) -> None:
        """Telemetry of the last ``rows`` ticks; its encoding is paid once in ``telemetry_ticks`` ticks."""
        figures = {
            names.SATURATED: float(self._core.saturated),
            **names.ledger_figures(self._core.ledger),
            **names.stray_frames([*self._devices, *self._environment]),
        }
        traces = (
            {names.FREE_POSITION: self._trace_p[:rows], names.FORCE: self._trace_f[:rows]}
            if self._common.traces
            else {}
        )
        control.publish(Telemetry(self._ticks, figures, traces))
