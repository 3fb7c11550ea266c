"""What the doctor measures: how late a process wakes, and how long a tick takes in a session of this machine.

The ticks are those of a session that the ordinary supervisor runs in real time: the devices, couplings and links of
the user's session, with simulated devices whose hands rest and an environment of springs. Nothing has to be designed
for it, no code of a model is run, and no force is exerted.
"""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from manyhands.launch.doctor.wakeup import Spread, Waking
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared, unproved
from manyhands.launch.plan.reach import reach
from manyhands.launch.plan.topology import Topology, placement
from manyhands.launch.run.directory import run_directory
from manyhands.launch.run.processes import Interrupt, Processes
from manyhands.launch.run.recorder import Recorder
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import Session
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import REALTIME
from manyhands.nodes.realtime import FIFO_PRIORITY
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Observation, Role

MOST_PROCESSES = 64
LEAST_TICKS = 50
ANSWER_TIME = from_seconds(60.0)  # for a process to start, on a machine that is busy
SLOWEST = 20  # periods that a wake-up may take on average before the probe is given up

WAKING_PART = 0.3  # of the seconds; the ways of carrying a tick share the rest

_WAKING = "waking"  # the name of that process
_MOST_OUTPUT = 2**16  # bytes, what a pipe holds; percentiles and sentences take two thousand


class ProbeFailed(Exception):
    """The probe could not be done; says which process did what."""


class Interrupted(Exception):
    """The user interrupted the probe.

    Attributes:
        signal: by which signal.
    """

    def __init__(self, which: signal.Signals) -> None:
        super().__init__(which)
        self.signal = which


@dataclass(frozen=True)
class Way:
    """A way of carrying a tick.

    Attributes:
        key: its name in the JSON.
        text: its name for people.
        transport: "ipc", or "tcp" with CURVE.
        places: the processor of each process that is pinned; pinned processes over ipc run under SCHED_FIFO where
            that is permitted.
    """

    key: str
    text: str
    transport: str
    places: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Ticking:
    """One way's ticks.

    Attributes:
        way: which.
        tau: from sampling to applying, over all devices.
        ticks: ticks of all devices together.
        late: those that ended after the next was due.
    """

    way: Way
    tau: Spread
    ticks: int
    late: int


@dataclass(frozen=True)
class Measured:
    """All that the probe has measured."""

    waking: Waking
    ticking: tuple[Ticking, ...]


class Delays(Recorder):
    """A recorder that keeps the tau of every tick of every device, ns.

    Attributes:
        tau: in the order in which they were reported.
    """

    def __init__(self) -> None:
        self.tau: list[int] = []

    def take(self, frame: bytes | None) -> None:
        """Keep the delays of a device's telemetry; see :class:`Recorder`."""
        message = None if frame is None else decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Observation) and (trace := message.traces.get(names.TAU)) is not None:
            self.tau += [round(tau * 1e3) for (tau,) in trace.tolist()]


def measure(
    plan: Plan,
    seconds: float,
    processors: Sequence[int],
    curve: bool,
    show: Callable[[str], None],
) -> Measured:
    """Measure all of it, one thing after the other.

    Args:
        plan: of the session whose period and graph are taken, at most :data:`MOST_PROCESSES` nodes.
        seconds: how long to measure in all, s; starting the processes comes on top.
        processors: those that may be used.
        curve: whether ZeroMQ can encrypt.
        show: called with what is being measured.

    Raises:
        Interrupted: on Ctrl-C.
        ProbeFailed: a process did not start, not answer, or ended.
    """
    session = plan.session
    with Interrupt() as interrupt:
        show("how late a process wakes")
        with run_directory() as directory:
            waking = measure_waking(session.period, seconds * WAKING_PART, processors[0], directory, interrupt)
        ways = _ways(plan.graph, processors, waking.granted["fifo"].granted, curve)
        each = seconds * (1.0 - WAKING_PART) / len(ways)
        rested = unproved(at_rest(session))
        ticking = []
        for way in ways:
            if interrupt.signal is not None:
                raise Interrupted(interrupt.signal)
            show(f"a tick over {way.text}")
            ticking.append(measure_ticks(rested, way, _ticks(each, session.period)))
        return Measured(waking, tuple(ticking))


def _ways(graph: Topology, processors: Sequence[int], fifo: bool, curve: bool) -> list[Way]:
    """What there is to be compared: the session as `manyhands launch` would run it, and without SCHED_FIFO.

    A node takes SCHED_FIFO where it is pinned and may: without it, on a machine that permits it, nothing is pinned.
    """
    pinned, raised = placement(graph, processors), placement(graph, processors, raised=True)
    if fifo and raised:
        ways = [Way("ipc", "ipc, not pinned", "ipc"), Way("ipc_fifo", "ipc, SCHED_FIFO", "ipc", raised)]
    else:
        ways = [Way("ipc", "ipc", "ipc", pinned)]
    if curve:
        ways.append(Way("tcp_curve", "tcp with CURVE", "tcp", pinned))
    return ways


def _ticks(seconds: float, period: float) -> int:
    return max(LEAST_TICKS, int(seconds / period))


def at_rest(session: Session) -> Session:
    """A session of the same processes, ports and links in which nothing moves: it needs no design, and no model."""
    devices = {
        name: {"dof": device.dof, "axes": device.axes, "osp": 1.0, "driver": "simulated", "mass": 1.0,
               "hand": {"force": 0.0}}
        for name, device in session.devices.items()
    }  # fmt: skip
    links = [{"between": [port, "ground"], "stiffness": 1.0, "damping": 1.0} for port in session.ports]
    return Session.model_validate(
        {
            "session": "doctor",
            "period": session.period,
            "devices": devices,
            "couplings": {name: {"ports": list(ports)} for name, ports in session.blocks_by_name.items()},
            "environment": {"type": "network", "links": links},
            "design": {"coupling": "none", "objective": "feasible"},
            "colocate": session.colocate,
        }
    )


def measure_waking(
    period: float, seconds: float, processor: int, directory: Path, interrupt: Interrupt, clock: Clock | None = None
) -> Waking:
    """How late one process wakes on ``processor``, in three ways by turns.

    Args:
        period: T, s.
        seconds: how long to measure, s.
        processor: where.
        directory: for the process's error output.
        interrupt: entered; ends the wait.
        clock: for the time limit.

    Raises:
        Interrupted: on Ctrl-C.
        ProbeFailed: the process failed, or did not end in time.
    """
    ticks, nanoseconds = _ticks(seconds / 3, period), from_seconds(period)
    within = Duration(ANSWER_TIME + 3 * SLOWEST * ticks * nanoseconds)
    processes = Processes(directory)
    pipe, its_end = os.pipe2(os.O_CLOEXEC)
    try:
        try:
            arguments = [str(number) for number in (nanoseconds, ticks, FIFO_PRIORITY)]
            processes.spawn((_WAKING,), "manyhands.launch.doctor.wakeup", arguments, processor, its_end)
        finally:
            os.close(its_end)
        code = _end_of(processes, within, interrupt, RealtimeClock() if clock is None else clock)
        line = os.read(pipe, _MOST_OUTPUT).decode()
        if code != 0 or not line.endswith("\n"):
            wrote = processes.log(_WAKING)
            raise ProbeFailed(
                f"{_WAKING}: ended with {code} before it had answered" + (f"; it wrote:\n{wrote}" if wrote else "")
            )
        return Waking.from_json(line)
    finally:
        processes.end_all()
        os.close(pipe)


def _end_of(processes: Processes, within: Duration, interrupt: Interrupt, clock: Clock) -> int:
    """The exit code of the one process."""
    poll = select.poll()
    for fd in (*processes.fds, interrupt.fd):
        poll.register(fd, select.POLLIN)
    deadline = Instant(clock.now() + within)
    while True:
        ready = {fd for fd, _ in poll.poll(max(deadline - clock.now(), 0) / 1e6)}
        if interrupt.signal is not None:
            raise Interrupted(interrupt.signal)
        if ended := processes.reap(ready):
            return ended[_WAKING]
        if not ready:
            raise ProbeFailed(f"{_WAKING}: no answer within {within / 1e9:g} s; see what else runs here")


def measure_ticks(rested: Prepared, way: Way, ticks: int) -> Ticking:
    """So many ticks of a session at rest, carried in one way.

    Raises:
        Interrupted: on Ctrl-C.
        ProbeFailed: the session failed, or none of its devices ever got a force.
    """
    delays = Delays()
    outcome = Supervisor(
        rested,
        clock=REALTIME,
        reach=reach(rested, way.transport),
        ticks=ticks,
        record=False,
        recorder=delays,
        places=way.places,
    ).run()
    if outcome.code > 128:
        raise Interrupted(signal.Signals(outcome.code - 128))
    if outcome.faults:
        raise ProbeFailed("; ".join(outcome.faults))
    if not delays.tau:
        raise ProbeFailed(f"{way.text}: found no tick that was answered; see what else runs here")
    nodes = outcome.report["nodes"]  # one without a last word is not in it
    devices = [name for name, role in rested.graph.nodes.items() if role is Role.DEVICE]
    late = sum(nodes[name][names.LATE] for name in devices if name in nodes)
    return Ticking(way, Spread.of(delays.tau), len(delays.tau), late)
