"""What a session withstands of its users' energy, in sentences for people: who was held to a budget, and who let go.

A device that is beyond its limits knows that it is, and not what moved it. The environment knows whose energy went
where (:mod:`manyhands.nodes.environment.energy`). Here the two come together, so that the sentence names the supplier
and not the one who was moved. Pure: telemetry goes in, sentences come out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final

from manyhands.launch.topology import Topology
from manyhands.nodes import telemetry as names
from manyhands.protocol.messages import Role, Telemetry

QUIET: Final = 10.0
"""s between two sentences about the same party: who comes back by a ramp may be beyond its limits again at once."""


class EnergyIncidents:
    """The incidents of one run."""

    def __init__(self, graph: Topology, period: float) -> None:
        """Nothing has been heard yet."""
        devices = [name for name, role in graph.nodes.items() if role is Role.DEVICE]
        self._couplings = {device: tuple(link.binder for link in graph.links_of(device)) for device in devices}
        self._worlds = {name for name, role in graph.nodes.items() if role is Role.ENVIRONMENT}
        self._quiet = QUIET / period
        self._moved: dict[tuple[str, str], float] = {}  # J, by supplier and receiver
        self._then: dict[str, dict[tuple[str, str], float]] = {}  # the same at a device's last sentence
        self._counts: dict[str, float] = {}
        self._awaiting: dict[str, int] = {}  # a device that let go, and the tick up to which the environment must tell
        self._next: dict[str, float] = {}  # tick from which on there is a sentence again

    def forget(self, node: str) -> None:
        """``node`` has a new process, which counts from 0."""
        self._counts.pop(node, None)
        if node in self._worlds:
            self._moved, self._then = {}, {}
            self._counts = {key: count for key, count in self._counts.items() if key in self._couplings}

    def hear(self, node: str, telemetry: Telemetry) -> list[str]:
        """What a node's telemetry says of it."""
        figures = {name: value for name, value in telemetry.figures.items() if math.isfinite(value)}
        if node in self._worlds:
            out = list(self._budgets(telemetry.tick, figures))
            for device in [device for device, tick in self._awaiting.items() if tick <= telemetry.tick]:
                del self._awaiting[device]
                out.append(self._let_go(device))
            return out
        if node in self._couplings and self._grown(node, figures.get(names.LET_GO, 0.0), telemetry.tick):
            self._awaiting[node] = telemetry.tick
        return []

    def _budgets(self, tick: int, figures: Mapping[str, float]) -> Iterator[str]:
        for name, value in figures.items():
            supplier, found, receiver = name.removeprefix(names.MOVED).partition("/")
            if found and name.startswith(names.MOVED):
                self._moved[supplier, receiver] = value
            elif name.startswith(names.STOPS):
                party = name.removeprefix(names.STOPS)
                if self._grown(party, value, tick):
                    given = figures.get(f"{names.GIVEN}{party}", 0.0)
                    yield (
                        f"{self._who(party)} was beyond its energy budget, and was stopped until it is within it "
                        f"again; it has put {given:.3g} J into the others so far"
                    )

    def _let_go(self, device: str) -> str:
        couplings, before = self._couplings[device], self._then.get(device, {})
        by: dict[str, float] = {}
        for (supplier, receiver), total in self._moved.items():
            if receiver in couplings:
                by[supplier] = by.get(supplier, 0.0) + total - before.get((supplier, receiver), 0.0)
        self._then[device] = dict(self._moved)
        text = f"{device} was beyond its limits of displacement or speed, and let go until it is within them again"
        most = max(by, key=by.__getitem__, default=None)
        if most is None or by[most] <= 0.0:
            return f"{text}; nobody else has moved it"
        return (
            f"{text}; of others it had received {sum(by.values()):.3g} J, {by[most]:.3g} J of it from {self._who(most)}"
        )

    def _who(self, coupling: str) -> str:
        devices = [device for device, couplings in self._couplings.items() if coupling in couplings]
        return f"{coupling} ({', '.join(devices)})"

    def _grown(self, key: str, count: float, tick: int) -> bool:
        """Whether ``count`` has grown, and there was no sentence about it lately."""
        grown = count > self._counts.get(key, 0.0)
        self._counts[key] = count
        if not grown or tick < self._next.get(key, 0.0):
            return False
        self._next[key] = tick + self._quiet
        return True
