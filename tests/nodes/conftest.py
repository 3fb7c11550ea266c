"""Surroundings of a node's loop in a test: a life that goes on, and a line without a supervisor."""

from __future__ import annotations

import numpy as np
import pytest

from manyhands.nodes.kernel.log import Log
from manyhands.protocol.clock import RealtimeClock
from manyhands.protocol.messages import Telemetry


class Running:
    """A life that goes on until something fails."""

    def __init__(self) -> None:
        self.stopping = self.leaving = False
        self.failure = ""

    def look(self, _now: int) -> None:
        """Nothing to look after."""

    def check(self) -> None:
        """Nothing to look after."""

    def fail(self, text: str) -> None:
        self.stopping, self.failure = True, self.failure or text


class Kept:
    """A line to the supervisor that keeps every telemetry."""

    def __init__(self) -> None:
        self.telemetry: list[Telemetry] = []
        self.dropped = 0
        self.log = Log(None, "s", "n", RealtimeClock())

    def listen(self, _timeouts: object = None) -> None:
        """There is no message."""

    def publish(self, telemetry: Telemetry) -> None:
        traces = {name: trace.copy() for name, trace in telemetry.traces.items()}
        self.telemetry.append(Telemetry(telemetry.tick, telemetry.figures, traces))

    def trace(self, name: str) -> np.ndarray:
        """One trace over all ticks."""
        return np.vstack([telemetry.traces[name] for telemetry in self.telemetry])


@pytest.fixture
def new_life() -> type[Running]:
    return Running


@pytest.fixture
def new_line() -> type[Kept]:
    return Kept
