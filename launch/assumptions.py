"""What telemetry says of the certificate's assumptions: told to people at once and once, and judged by the policy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from manyhands.launch.policy import BreachPolicy, EndSession, Notice, Policy, ShiftCoupling
from manyhands.launch.preparation import Prepared
from manyhands.launch.topology import ENVIRONMENT, Topology
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import REALTIME
from manyhands.protocol.messages import Role, Telemetry


class Assumptions:
    """The assumptions of one run.

    Attributes:
        notices: those found broken, in words, by what each is about.
    """

    def __init__(self, prepared: Prepared, graph: Topology, clock: str, rungs: Mapping[str, int]) -> None:
        """Nothing has been heard yet.

        Args:
            prepared: the session with its coupling and certificate.
            graph: its nodes and links.
            clock: "realtime" or "simulated"; nothing is late under the simulated one.
            rungs: the rung of the ladder that each coupling was changed to.
        """
        session, certificate = prepared.session, prepared.certificate
        devices = [name for name, role in graph.nodes.items() if role is Role.DEVICE]
        chains = {device: tuple(link.binder for link in graph.links_of(device)) for device in devices}
        self._policy = BreachPolicy(
            Policy(session.faults.breach),
            chains if certificate is not None and clock == REALTIME else {},
            0.0 if certificate is None else certificate.tau,
            session.period,
            prepared.ladder,
            rungs,
        )
        self._couplings = [name for name, role in graph.nodes.items() if role is Role.COUPLING]
        self._chains, self._moved = chains, dict[str, float]()
        self._policy.take_waits(0, {})  # the environment tells who was waited for, from the first tick on
        self.notices: dict[str, str] = {}

    def forget(self, node: str) -> None:
        """``node`` has a new process, which counts from 0."""
        self._policy.forget(node)

    def check(self, node: str, telemetry: Telemetry) -> list[ShiftCoupling | EndSession]:
        """Take what is to be told of ``node`` into the notices; returns what is to be done."""
        deeds: list[ShiftCoupling | EndSession] = []
        if node == ENVIRONMENT:
            self._moved = {key: J for key, J in telemetry.figures.items() if key.startswith(names.MOVED)}
            decisions = self._policy.take_waits(telemetry.tick, self._late_ticks(telemetry))
        else:
            tau = telemetry.traces.get(names.TAU, _NO_TAU)
            decisions = self._policy.judge(node, telemetry.tick, telemetry.figures, (tau.ravel() * 1e-6).tolist())
        for decision in decisions:
            if isinstance(decision, Notice):
                self.notices.setdefault(decision.key, decision.text)
            else:
                deeds.append(decision)
        if any(telemetry.figures.get(clips, 0.0) > 0 for clips in (names.CLIPPED, names.SATURATED)):
            text = f"{node}: a force was clipped to the limits; the certificate is about forces within them"
            self.notices.setdefault(f"{node} limits", text + self._moved_by(node))
        return deeds

    def _moved_by(self, node: str) -> str:
        """Who moved a device or a coupling most, where the environment has told of anybody, in words."""
        couplings = self._chains.get(node, (node,))
        by: dict[str, float] = {}
        for key, energy in self._moved.items():
            supplier, _, receiver = key.removeprefix(names.MOVED).partition("/")
            if receiver in couplings and energy > 0.0:
                by[supplier] = by.get(supplier, 0.0) + energy
        most = max(by, key=by.__getitem__, default=None)
        return "" if most is None else f"; of all others {most} has put the most energy into it, {by[most]:.3g} J"

    def _late_ticks(self, telemetry: Telemetry) -> dict[str, list[int]]:
        """In which ticks the others waited, by whom they waited for; who was frozen for it is told to people."""
        for name, lateness in names.lateness_by_coupling(telemetry.figures, telemetry.figures).items():
            if lateness.frozen:
                text = f"{name} made the others wait, and was frozen for it; nobody else is softened"
                self.notices.setdefault(f"{name} late", text)
        traces = {name: telemetry.traces.get(names.WAITED_IN + name) for name in self._couplings}
        return {name: ticks.ravel().astype(int).tolist() for name, ticks in traces.items() if ticks is not None}


_NO_TAU: Final = np.empty((0, 1))
