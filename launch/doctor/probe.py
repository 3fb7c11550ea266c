"""What the doctor measures: how late a process wakes, and how long a tick takes in a session of this machine.

The ordinary supervisor runs a session in real time. It has the devices, couplings and links of the user's session, but
its devices are simulated, their hands rest, and its environment consists of springs. This session needs no design, runs
no model's code, and exerts no force.
"""

from __future__ import annotations

import math
import os
import select
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

from manyhands.launch.doctor.profile import (
    Lateness,
    ProbeFailed,
    ProbeInterrupted,
    Profile,
    Stated,
    allowance,
    profile_key,
)
from manyhands.launch.doctor.wakeup import Spread, Waking
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared, unproved
from manyhands.launch.plan.reach import reach
from manyhands.launch.plan.topology import Topology, placement, usual_placement
from manyhands.launch.run.directory import run_directory
from manyhands.launch.run.options import StartOptions
from manyhands.launch.run.processes import Interrupt, Processes
from manyhands.launch.run.recorder import Recorder
from manyhands.launch.run.supervised import run_prepared
from manyhands.launch.session import Session
from manyhands.nodes.kernel.realtime import FIFO_PRIORITY
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Observation, Role

MOST_PROCESSES = 64
LEAST_TICKS = 50
ANSWER_TIME = from_seconds(60.0)  # for a process to start on a busy machine
SLOWEST = 20  # periods that a wake-up may take on average; beyond, the probe fails

WAKING_PART = 0.15  # of the measuring time; the ways of carrying a tick, and the rates, share the rest
PROFILE_TIME = 2.0  # s, for a launch that measures for itself

_WAKING = "waking"  # name of the process that measures wake-ups
_MOST_OUTPUT = 2**16  # bytes, the capacity of a pipe; the answer takes about two thousand


@dataclass(frozen=True)
class Way:
    """A way of carrying a tick: a transport, and the processors of the processes.

    Attributes:
        key: its name in the JSON object.
        text: its name in tables.
        transport: "ipc" or "tcp".
        places: the processor of each process that is pinned; pinned processes run under SCHED_FIFO where that is
            permitted.
        encrypted: whether links over "tcp" are encrypted with CURVE.
    """

    key: str
    text: str
    transport: str
    places: Mapping[str, int] = field(default_factory=dict)
    encrypted: bool = True

    @classmethod
    def of_run(cls, plan: Plan, transport: str = "ipc", encrypted: bool = True) -> Self:
        """The way in which `manyhands launch` runs a session on this machine."""
        return cls("run", transport, transport, usual_placement(plan.graph), encrypted)

    def profile_key(self, plan: Plan) -> dict[str, Any]:
        """The key under which the delays of ``plan`` in this way are kept."""
        return profile_key(plan, self.transport, self.encrypted and self.transport == "tcp", self.places)


@dataclass(frozen=True)
class Ticking:
    """The measured ticks of one way.

    Attributes:
        way: the way.
        tau: the delay from sample to force, over all devices, us.
        ticks: number of ticks of all devices together.
        late: number of ticks that ended after the next tick was due.
        slowest: the delay of the device with the longest p99.5, us, of those of :attr:`Session.device_period`.
        period: the p99 of the time between two samples, us, of the device where it is the longest part of the period;
            as it would be with :attr:`Session.device_period`.
        others: as ``slowest``, of the devices of each other period, by that period, s.
    """

    way: Way
    tau: Spread
    ticks: int
    late: int
    slowest: Lateness
    period: float
    others: Mapping[float, Lateness] = field(default_factory=dict)

    def profile(self, plan: Plan, seconds: float, now: float) -> Profile:
        """What to keep of ``plan``, whose ticks these are; ``seconds`` were measured until ``now``, in s since the
        epoch.
        """
        late = self.late / self.ticks
        return Profile(self.way.profile_key(plan), self.slowest, self.period, late, seconds, now, self.others)


@dataclass(frozen=True)
class Form:
    """A rate of a session, and whether its couplings run in their devices' processes.

    Attributes:
        period: T, s.
        colocated: whether they do.
    """

    period: float
    colocated: bool

    def plan(self, session: Session) -> Plan:
        """The session at rest in this form."""
        return Plan(at_rest(session, self))


RATES: Final = (1e-3, 0.5e-3, 0.25e-3)
"""The periods at which a session is measured besides its own, s: 1, 2 and 4 kHz."""


def forms_of(session: Session) -> tuple[Form, ...]:
    """The forms in which a session is measured: each rate, co-located too where every coupling is of one device."""
    together = (False,) if session.shared_couplings else (False, True)
    periods = sorted({session.period, *RATES}, reverse=True)
    return tuple(Form(period, colocated) for period in periods for colocated in together)


_LONGER: Final = 1.5  # times its p99.5: what another measurement of the same ticks may give here


def longer_period(profile: Profile, stated: Stated) -> float:
    """A period in which such a tick fits: rounded up to a tenth of a millisecond, and a tenth or more in reserve."""
    tau = profile.tau
    # beside a stated latency little of the period is left, and the ticks of the next measurement may be longer
    lasts = min(tau.p999, _LONGER * tau.p995) if stated.latency else tau.p995
    tenths = math.ceil((lasts * 1e-6 + stated.latency) * 1e4 - 1e-6) + 1
    while not allowance(profile, tenths / 1e4, stated).covered:
        tenths += 1
    return tenths / 1e4


@dataclass(frozen=True)
class Measured:
    """All measurements of the probe.

    Attributes:
        waking: how late a process wakes.
        ticking: the session's own ticks, by way.
        forms: its ticks as `manyhands launch` would run it in each form; where a form gave none, the reason.
        each: how long each was measured, s.
    """

    waking: Waking
    ticking: tuple[Ticking, ...]
    forms: Mapping[Form, Ticking | str] = field(default_factory=dict)
    each: float = 0.0


class DelayRecorder(Recorder):
    """A recorder that keeps the delay tau of every tick of every device.

    Attributes:
        by_device: the delays of each device, ns, in the order in which they were reported.
    """

    def __init__(self) -> None:
        self.by_device: dict[str, list[int]] = {}

    @property
    def tau(self) -> list[int]:
        """The delays of all devices, ns."""
        return [tau for delays in self.by_device.values() for tau in delays]

    def take(self, frame: bytes | None) -> None:
        """Keep the delays of a device's telemetry; see :class:`Recorder`."""
        message = None if frame is None else decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Observation) and (trace := message.traces.get(names.TAU)) is not None:
            self.by_device.setdefault(message.node, []).extend(round(tau * 1e3) for (tau,) in trace.tolist())


def measure(
    plan: Plan,
    seconds: float,
    processors: Sequence[int],
    curve: bool,
    show: Callable[[str], None],
) -> Measured:
    """Measure wake-ups and then each way of carrying a tick, one after the other.

    Args:
        plan: the session, of which the period and the graph are used; at most :data:`MOST_PROCESSES` nodes.
        seconds: how long to measure in all, s; the start of the processes takes additional time.
        processors: the processors that may be used.
        curve: whether ZeroMQ can encrypt.
        show: called with what is being measured.

    Raises:
        ProbeInterrupted: on Ctrl-C.
        ProbeFailed: a process did not start, did not answer, or ended early.
    """
    session, forms = plan.session, forms_of(plan.session)
    own = Form(session.period, session.colocated)
    with Interrupt() as interrupt:
        show("how late a process wakes")
        with run_directory() as directory:
            waking = measure_waking(session.period, seconds * WAKING_PART, processors[0], directory, interrupt)
        ways = _ways(plan.graph, processors, waking.granted["fifo"].granted, curve)
        each = seconds * (1.0 - WAKING_PART) / (len(ways) + len(forms) - 1)
        rested = unproved(at_rest(session))
        ticking = []
        for way in ways:
            if interrupt.signal is not None:
                raise ProbeInterrupted(interrupt.signal)
            show(f"a tick over {way.text}")
            ticking.append(measure_ticks(rested, way, ticks_in(each, session.period)))
        usual = usual_placement(plan.graph)  # one of the ways, unless the kernel refuses a right that we hold
        found: dict[Form, Ticking | str] = {}
        for one in ticking:
            if one.way.transport == "ipc" and one.way.places == usual:
                found[own] = one
        first = found.get(own)
        profile, stated = first.profile(plan, each, 0.0) if isinstance(first, Ticking) else None, Stated.of(session)
        if profile is not None and not allowance(profile, session.period, stated).covered:
            longer = longer_period(profile, stated)  # no certificate covers such a tick: would one of this period?
            forms += tuple(Form(longer, form.colocated) for form in forms if form.period == session.period)
        left = [form for form in forms if form not in found]
        for number, form in enumerate(left):
            if interrupt.signal is not None:
                raise ProbeInterrupted(interrupt.signal)
            where = "co-located" if form.colocated else "separate processes"
            show(f"a tick at {1e-3 / form.period:g} kHz, {where} ({number + 1} of {len(left)})")
            try:
                other = unproved(at_rest(session, form))
                found[form] = measure_ticks(other, Way.of_run(other), ticks_in(each, form.period))
            except ProbeFailed as error:  # a rate beyond this machine says nothing against the others
                found[form] = str(error)
        return Measured(waking, tuple(ticking), {form: found[form] for form in forms}, each)


def _ways(graph: Topology, processors: Sequence[int], fifo: bool, curve: bool) -> list[Way]:
    """The ways to compare: as `manyhands launch` would run the session, without SCHED_FIFO, and over encrypted tcp.

    A node takes SCHED_FIFO where it is pinned and permitted. To compare without it, nothing is pinned on a machine that
    permits it.
    """
    pinned, raised = placement(graph, processors), placement(graph, processors, raised=True)
    if fifo and raised:
        ways = [Way("ipc", "ipc, not pinned", "ipc"), Way("ipc_fifo", "ipc, SCHED_FIFO", "ipc", raised)]
    else:
        ways = [Way("ipc", "ipc", "ipc", pinned)]
    if curve:
        ways.append(Way("tcp_curve", "tcp with CURVE", "tcp", raised if fifo else pinned))
    return ways


def ticks_in(seconds: float, period: float) -> int:
    """Number of ticks that are measured in a time (s), at least :data:`LEAST_TICKS`."""
    return max(LEAST_TICKS, int(seconds / period))


def at_rest(session: Session, form: Form | None = None) -> Session:
    """A session of the same processes, ports and links in which nothing moves; it needs no design and no model.

    Args:
        session: the session.
        form: its rate, and whether its couplings are co-located; by default its own.
    """
    if form is None:
        form = Form(session.period, session.colocated)
    devices = {
        name: {"dof": device.dof, "axes": device.axes, "osp": 1.0, "driver": "simulated", "mass": 1.0,
               "hand": {"force": 0.0}}
        for name, device in session.devices.items()
    }  # fmt: skip
    links = [{"between": [port, "ground"], "stiffness": 1.0, "damping": 1.0} for port in session.ports]
    couplings: dict[str, dict[str, Any]] = {
        name: {"ports": list(ports)} for name, ports in session.blocks_by_name.items()
    }
    for name, link in session.wave_links.items():  # sites keep their own periods, but for another rate of the session
        own = link.period_in(session.period) if form.period == session.period else form.period
        couplings[name]["wave_link"] = {"b": 1.0, "period": own}
    # a wave link needs a coupling; one that yields as soon as anything pulls keeps the session at rest as well
    design = {"coupling": "given", "stiffness": 1.0, "damping": 1.0} if session.wave_links else {"coupling": "none"}
    return Session.model_validate(
        {
            "session": "doctor",
            "period": form.period,
            "devices": devices,
            "couplings": couplings,
            "environment": {"type": "network", "links": links},
            "design": {**design, "objective": "feasible"},
            "colocate": form.colocated,
        }
    )


def measure_waking(
    period: float, seconds: float, processor: int, directory: Path, interrupt: Interrupt, clock: Clock | None = None
) -> Waking:
    """How late one process wakes on ``processor``, in three ways by turns.

    Args:
        period: T, s.
        seconds: how long to measure, s.
        processor: number of the processor.
        directory: the folder for the process's error output.
        interrupt: an entered one; a signal ends the wait.
        clock: the clock of the time limit; by default the real one.

    Raises:
        ProbeInterrupted: on Ctrl-C.
        ProbeFailed: the process failed, or did not end in time.
    """
    ticks, nanoseconds = ticks_in(seconds / 3, period), from_seconds(period)
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
    """The exit code of the only process, once it has ended.

    Raises:
        ProbeInterrupted: on Ctrl-C.
        ProbeFailed: the process did not end within the given time.
    """
    poll = select.poll()
    for fd in (*processes.fds, interrupt.fd):
        poll.register(fd, select.POLLIN)
    deadline = Instant(clock.now() + within)
    while True:
        ready = {fd for fd, _ in poll.poll(max(deadline - clock.now(), 0) / 1e6)}
        if interrupt.signal is not None:
            raise ProbeInterrupted(interrupt.signal)
        if ended := processes.reap(ready):
            return ended[_WAKING]
        if not ready:
            raise ProbeFailed(f"{_WAKING}: no answer within {within / 1e9:g} s; check what else runs on this machine")


def measure_profile(plan: Plan, way: Way, seconds: float = PROFILE_TIME) -> Profile:
    """The profile of a session on this machine: the delays of the session at rest.

    Raises:
        ProbeInterrupted: on Ctrl-C.
        ProbeFailed: the session failed, or none of its devices ever got a force.
    """
    ticking = measure_ticks(unproved(at_rest(plan.session)), way, ticks_in(seconds, plan.session.period))
    return ticking.profile(plan, seconds, time.time())


def measure_ticks(rested: Prepared, way: Way, ticks: int) -> Ticking:
    """Run ``ticks`` ticks of a session at rest in one way, and collect their delays.

    Raises:
        ProbeInterrupted: on Ctrl-C.
        ProbeFailed: the session failed, or none of its devices ever got a force.
    """
    delays = DelayRecorder()
    ways = reach(rested, way.transport, insecure=way.transport == "tcp" and not way.encrypted)
    outcome = run_prepared(rested, ways, StartOptions(ticks=ticks), recorder=delays, places=way.places)
    if outcome.code > 128:
        raise ProbeInterrupted(signal.Signals(outcome.code - 128))
    if outcome.faults:
        raise ProbeFailed("; ".join(outcome.faults))
    session = rested.session
    by_period: dict[float, list[list[int]]] = {}
    for name, of_device in delays.by_device.items():
        by_period.setdefault(session.period_of(name), []).append(of_device)
    slowest = {period: Lateness.slowest(of_devices) for period, of_devices in by_period.items()}
    if session.device_period not in slowest:
        raise ProbeFailed(f"{way.text}: found no tick that got a force; check what else runs on this machine")
    nodes = outcome.report["nodes"]  # a node that sent no last report is absent
    devices = [name for name, role in rested.graph.nodes.items() if role is Role.DEVICE]
    late = sum(nodes[name][names.LATE] for name in devices if name in nodes)
    longer = [
        nodes[name][names.PERIOD]["p99"] / session.period_of(name)
        for name in devices
        if names.PERIOD in nodes.get(name, {})
    ]
    longest, of_design = session.device_period * max(longer, default=1e6), slowest.pop(session.device_period)
    return Ticking(way, Spread.of(delays.tau), len(delays.tau), late, of_design, longest, slowest)
