"""A session to observe in tests: its description, and frames that come by the test's own clock."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from manyhands.nodes.monitor.session_state import About, CertificateAbout, LinkAbout, NodeAbout
from manyhands.protocol.clock import Duration, Instant, SimulatedClock
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation, Role

MS = 1_000_000

NO_TABLES: Mapping[str, Mapping[str, float]] = MappingProxyType({})

PORTS = ("d.x", "d.y")
ABOUT = About(
    session="s", id="i", pid=17, clock="realtime", transport="ipc", period=0.001, ticks=0, started=1.6e9,
    nodes={"d": NodeAbout(Role.DEVICE, PORTS, wall=True), "cx": NodeAbout(Role.COUPLING, ("d.x",)),
           "cy": NodeAbout(Role.COUPLING, ("d.y",)), "environment": NodeAbout(Role.ENVIRONMENT, PORTS)},
    links=(LinkAbout(("cx", "environment"), ("d.x",)), LinkAbout(("cy", "environment"), ("d.y",)),
           LinkAbout(("d", "cx"), ("d.x",)), LinkAbout(("d", "cy"), ("d.y",))),
    masses={"hub": 3.0}, springs=(), grips=(), reach={}, environment="network",
    certificate=CertificateAbout(0.0, {}, None, {}, (), (), 0.005, True), observers={"scope": ("cx/tool", "telemetry")},
)  # fmt: skip


def telemetry(
    node: str, tick: int, rows: int = 100, tables: Mapping[str, Mapping[str, float]] = NO_TABLES, **numbers: float
) -> bytes:
    """A node's telemetry of so many ticks; the value in each tick is the tick's number."""
    ticks = np.arange(tick - rows, tick, dtype=np.float64)[:, None]
    columns = len(ABOUT.nodes[node].ports)
    if ABOUT.nodes[node].role is Role.DEVICE:
        traces = {
            "x": ticks + np.arange(columns) / 10,
            "f_v": -ticks.repeat(columns, 1),
            "ledger": ticks,
            "tau_us": ticks,
        }
    elif ABOUT.nodes[node].role is Role.COUPLING:
        traces = {"p": ticks.repeat(columns, 1), "f_v": -ticks.repeat(columns, 1), "ledger": ticks}
    else:
        traces = {"x_e": ticks.repeat(columns, 1), "q": ticks, "ledger": ticks}
    return encode(Observation(node, tick, Figures(numbers, tables), traces))


def condition(phase: str = "running", silent: tuple[str, ...] = (), incidents: tuple[str, ...] = (),
              **states: str) -> bytes:  # fmt: skip
    """A frame of the session's condition."""
    stand = {**dict.fromkeys(ABOUT.nodes, "running"), **states}
    return encode(Condition(phase, 2.5, stand, silent, ("a notice",), incidents, ()))


class Frames:
    """Frames that come at given instants, ms, on a clock that advances only during a wait for them."""

    def __init__(self, at: Mapping[int, list[bytes]]) -> None:
        """``at``: frames by the instant at which they come, ms."""
        self.clock = SimulatedClock()
        self._coming = sorted((ms * MS, frame) for ms, frames in at.items() for frame in frames)
        self.waits: list[Duration] = []

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame, if it comes in time."""
        assert timeout is not None, "nobody waits for ever"
        self.waits.append(timeout)
        until = Instant(self.clock.now() + timeout)
        if self._coming and self._coming[0][0] <= until:
            at, frame = self._coming.pop(0)
            self.clock.sleep_until(Instant(at))
            return frame
        self.clock.sleep_until(until)
        return None
