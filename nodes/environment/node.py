"""The environment's process: p of every coupling in, f_v of its own ports to each out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import EnvironmentBundle
from manyhands.nodes.control import ControlLine
from manyhands.nodes.environment.core import EnvironmentCore
from manyhands.nodes.exchange import Joint, bounds_by_peer, establish
from manyhands.nodes.feedthrough import feedthrough_digest
from manyhands.nodes.life import Life
from manyhands.protocol.clock import RealtimeClock
from manyhands.protocol.handshake import HandshakeRefused
from manyhands.protocol.messages import LinkHello, Reaction, Report, Role, Start, Telemetry, Tool
from manyhands.protocol.transport import Link


class EnvironmentNode:
    """A :class:`manyhands.nodes.process.Node` for the shared environment."""

    def __init__(self, bundle: EnvironmentBundle) -> None:
        """Make the node; its core waits for the couplings' feedthrough."""
        self._bundle, self._common = bundle, bundle.common
        self._joints: list[Joint] = []
        self._core: EnvironmentCore | None = None
        self._ticks = 0

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with every coupling, and close the algebraic loop with their D_V.

        Raises:
            HandshakeRefused: also where a coupling says another D_V than the certificate's.
        """
        admits = {peer.name: Tool for peer in self._common.peers}
        bounds = bounds_by_peer(self._common, Role.COUPLING, self._bundle.tool_magnitude, self._bundle.tool_step)
        self._joints, hellos = establish(self._common, links, admits, RealtimeClock(), bounds=bounds)
        m = len(self._common.ports)
        D_V = np.zeros((m, m))
        for joint in self._joints:
            self._require_feedthrough(hellos[joint.peer.name])
            ports = np.arange(m)[joint.indices]
            D_V[np.ix_(ports, ports)] = hellos[joint.peer.name].feedthrough
        self._core = EnvironmentCore(self._bundle.E, D_V, self._bundle.Phi_E, self._common.period)

    def _require_feedthrough(self, hello: LinkHello) -> None:
        found, expected = feedthrough_digest(hello.feedthrough or ()), self._bundle.feedthrough[hello.name]
        if found != expected:
            raise HandshakeRefused(
                f"{self._common.name} refused {hello.name}: found a feedthrough D_V with the digest {found[:16]}; "
                f"expected {expected[:16]}, that of the block in the certificate; start {hello.name} with the bundle "
                "that was cut for this session"
            )

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Run the ticks, paced by the couplings."""
        core, joints = self._core, self._joints
        if core is None:
            raise ValueError("the environment was started before its handshakes")
        p = np.zeros(len(self._common.ports))
        tick = 0
        while not life.stopping and (start.ticks == 0 or tick < start.ticks):
            if not all(joint.receive_into(p, tick, life) for joint in joints):
                break
            f = core.react(p)
            for joint in joints:
                joint.send(Reaction, tick, joint.gate.stamp, f)
            core.settle()
            tick += 1
            self._ticks = tick
            if tick % self._common.telemetry_ticks == 0:
                control.publish(
                    Telemetry(tick, {**names.ledger_figures(core.ledger), **names.stray_frames(joints)}, {})
                )

    def report(self) -> Report:
        """Ticks and ledger."""
        ledger = None if self._core is None else self._core.ledger
        return Report(self._ticks, names.ledger_figures(ledger), names.dropped_frames(self._joints), {})
