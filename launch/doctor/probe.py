"""What the probe measures: how late a process wakes, and how long a tick takes between processes.

The ticks run on the session's own graph, with its processes, links and placement, and without its mathematics and
encoding: what is left is what the machine asks for carrying a tick, which no session can go below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manyhands.launch.doctor.conversation import granted
from manyhands.launch.doctor.crew import Crew
from manyhands.launch.interrupt import Interrupt
from manyhands.launch.placement import placement
from manyhands.launch.topology import Topology
from manyhands.nodes.distribution import PERCENTILES
from manyhands.nodes.realtime import FIFO_PRIORITY, Grant
from manyhands.protocol.clock import Duration, Instant, RealtimeClock, from_seconds
from manyhands.protocol.messages import Role

MOST_PROCESSES = 64
LEAST_TICKS = 50
ANSWER_TIME = from_seconds(60.0)  # for a process to start, on a machine that is busy
HEAD_START = from_seconds(0.1)  # from the word to start to the first tick
SLOWEST = 20  # periods that a tick may take on average before the probe is given up

WAKING_PART = 0.3  # of the seconds; the ways of carrying a tick share the rest

_RANKS = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}
_TOWARDS_THE_WORLD = {Role.DEVICE: 0, Role.COUPLING: 1, Role.ENVIRONMENT: 2}


@dataclass(frozen=True)
class Way:
    """A way of carrying a tick.

    Attributes:
        key: its name in the JSON.
        text: its name for people.
        transport: "ipc", or "tcp" with CURVE.
        fifo: whether pinned processes run under SCHED_FIFO.
    """

    key: str
    text: str
    transport: str
    fifo: bool = False


IPC = Way("ipc", "ipc", "ipc")
IPC_FIFO = Way("ipc_fifo", "ipc, SCHED_FIFO", "ipc", fifo=True)
TCP = Way("tcp_curve", "tcp with CURVE", "tcp")


@dataclass(frozen=True)
class Spread:
    """Percentiles of a duration, us; what lies between two values counts as the greater."""

    p50: float
    p99: float
    p999: float
    max: float

    @classmethod
    def of(cls, nanoseconds: Sequence[int]) -> Spread:
        """The percentiles of some durations, at least one."""
        values = np.quantile(np.array(nanoseconds, dtype=np.float64), [_RANKS[p] for p in PERCENTILES], method="higher")
        return cls(*(float(value) / 1e3 for value in values))

    def plain(self) -> dict[str, float]:
        """As the JSON has it."""
        return {name: getattr(self, name) for name in PERCENTILES}


@dataclass(frozen=True)
class Waking:
    """How late a process wakes, by way, and what the kernel granted to it."""

    late: Mapping[str, Spread]
    granted: Mapping[str, Grant]


@dataclass(frozen=True)
class Ticking:
    """One way's ticks.

    Attributes:
        way: which.
        places: the processor of each process that was pinned.
        tau: from sampling to applying, over all devices.
        ticks: ticks of all devices together.
        late: those that ended after the next was due.
    """

    way: Way
    places: Mapping[str, int]
    tau: Spread
    ticks: int
    late: int


@dataclass(frozen=True)
class Measured:
    """All that the probe has measured."""

    waking: Waking
    ticking: tuple[Ticking, ...]


def measure(
    graph: Topology,
    period: float,
    seconds: float,
    processors: Sequence[int],
    directory: Path,
    interrupt: Interrupt,
    curve: bool,
    show: Callable[[str], None],
) -> Measured:
    """Measure all of it, one thing after the other.

    Args:
        graph: the session's nodes and links, at most :data:`MOST_PROCESSES` nodes.
        period: T, s.
        seconds: how long to measure in all, s; starting the processes comes on top.
        processors: those that may be used.
        directory: empty, for sockets and logs.
        interrupt: entered.
        curve: whether ZeroMQ can encrypt.
        show: told what is being measured.

    Raises:
        Interrupted: on Ctrl-C.
        ProbeFailed: something did not start, or not answer.
    """
    probe = _Probe(graph, from_seconds(period), directory, interrupt)
    show("how late a process wakes")
    waking = probe.wake(seconds * WAKING_PART, processors[0])
    fifo = bool(placement(graph, processors)) and waking.granted["fifo"].granted
    ways = [IPC, *([IPC_FIFO] if fifo else []), *([TCP] if curve else [])]
    each = seconds * (1.0 - WAKING_PART) / len(ways)
    ticking = []
    for way in ways:
        show(f"a tick over {way.text}")
        ticking.append(probe.tick(way, each, placement(graph, processors, raised=way.fifo)))
    return Measured(waking, tuple(ticking))


def sides(graph: Topology) -> dict[str, tuple[list[str], list[str]]]:
    """By node, its links towards the hands and those towards the world, by their number in the graph."""
    found: dict[str, tuple[list[str], list[str]]] = {name: ([], []) for name in graph.nodes}
    for i, link in enumerate(graph.links):
        inner, outer = sorted((link.binder, link.connector), key=lambda name: _TOWARDS_THE_WORLD[graph.nodes[name]])
        found[inner][1].append(str(i))
        found[outer][0].append(str(i))
    return found


class _Probe:
    def __init__(self, graph: Topology, period: Duration, directory: Path, interrupt: Interrupt) -> None:
        self._graph, self._period, self._directory, self._interrupt = graph, period, directory, interrupt
        self._clock = RealtimeClock()

    def _ticks(self, seconds: float) -> int:
        return max(LEAST_TICKS, int(from_seconds(seconds) // self._period))

    def _patience(self, ticks: int) -> Duration:
        return Duration(ANSWER_TIME + SLOWEST * ticks * self._period)

    def wake(self, seconds: float, processor: int) -> Waking:
        """How late one process wakes on ``processor``, in three ways by turns."""
        ticks = self._ticks(seconds / 3)
        with Crew(self._directory, self._interrupt, self._clock) as crew:
            crew.start("waking", processor)
            task = {"period": self._period, "ticks": ticks, "priority": FIFO_PRIORITY}
            crew.tell("waking", {"kind": "wake", "task": task})
            figures = crew.hear_all(self._patience(3 * ticks))["waking"]
        return Waking({way: Spread.of(late) for way, late in figures["late_ns"].items()}, granted(figures))

    def tick(self, way: Way, seconds: float, places: Mapping[str, int]) -> Ticking:
        """The session's ticks, carried in one way."""
        graph, ticks = self._graph, self._ticks(seconds)
        with Crew(self._directory, self._interrupt, self._clock) as crew:
            for name in graph.nodes:
                crew.start(name, places.get(name))
            for name, (inner, outer) in sides(graph).items():
                task = {
                    "period": self._period,
                    "ticks": ticks,
                    "priority": FIFO_PRIORITY if way.fifo else 0,
                    "binds": {i: self._address(way, i) for i in (*inner, *outer) if self._end(i)[0] == name},
                    "connects": [i for i in (*inner, *outer) if self._end(i)[1] == name],
                    "inner": inner,
                    "outer": outer,
                }
                crew.tell(name, {"kind": "tick", "task": task})
            bound: dict[str, Any] = {}
            for answer in crew.hear_all(ANSWER_TIME).values():
                bound |= answer["endpoints"]
            for name in graph.nodes:
                mine = {i: endpoint for i, endpoint in bound.items() if self._end(i)[1] == name}
                crew.tell(name, {"endpoints": mine})
            crew.hear_all(ANSWER_TIME)
            epoch = Instant(self._clock.now() + HEAD_START)
            for name in graph.nodes:
                crew.tell(name, {"epoch": epoch})
            figures = crew.hear_all(self._patience(ticks))
        devices = [name for name, role in graph.nodes.items() if role is Role.DEVICE]
        taus = [tau for name in devices for tau in figures[name]["tau_ns"]]
        return Ticking(way, places, Spread.of(taus), len(taus), sum(figures[name]["late"] for name in devices))

    def _end(self, link: str) -> tuple[str, str]:
        """Who binds a link, and who connects to it."""
        plan = self._graph.links[int(link)]
        return plan.binder, plan.connector

    def _address(self, way: Way, link: str) -> str:
        return f"ipc://{self._directory}/{way.key}-{link}" if way.transport == "ipc" else ""
