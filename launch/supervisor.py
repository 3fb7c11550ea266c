"""Runs a session's processes from start to end, and leaves nothing behind.

The decisions are the :class:`manyhands.launch.conductor.Conductor`'s; here are its senses and hands: the hub's
frames, the ends of processes, Ctrl-C and deadlines go in, and its instructions are carried out. One thread, one
poll over all of them, and no waiting for time to pass.
"""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from manyhands.launch.allowance import Allowance
from manyhands.launch.audience import Audience
from manyhands.launch.bundles import Run, cut
from manyhands.launch.conductor import Conductor, Instruction, Kill, NodeState, Phase, Release, Send, Terminate
from manyhands.launch.exits import EXIT_FAILED, EXIT_OK
from manyhands.launch.interrupt import Interrupt
from manyhands.launch.outcome import Outcome, Progress
from manyhands.launch.placement import placement
from manyhands.launch.preparation import Prepared
from manyhands.launch.processes import Processes
from manyhands.launch.reach import HUB_NAME, Reach
from manyhands.launch.recording import Collector
from manyhands.launch.report import run_report
from manyhands.launch.run_directory import run_directory
from manyhands.launch.topology import topology
from manyhands.nodes import bundle as bundle_files
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import REALTIME, SIMULATED
from manyhands.protocol.clock import Duration, Instant, RealtimeClock, from_seconds, seconds
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import HUB_FRAMES_PER_S, MAX_CONTROL_BYTES
from manyhands.protocol.messages import Role, Telemetry
from manyhands.protocol.transport import Hub
from manyhands.protocol.transport.zeromq import ZmqTransport

STARTUP_TIME = from_seconds(60.0)
ENDING_TIME = from_seconds(5.0)
REFRESH = from_seconds(0.2)
READING_TIME = from_seconds(0.05)  # at most, before there is a look at processes, signals and deadlines
REMOTE_SILENCE = from_seconds(3.0)  # a node says something every second
FRAMES_A_NODE = {REALTIME: 50, SIMULATED: 2000}  # a second; an honest one sends a telemetry in a hundred ticks


class Supervisor:
    """One run of one session."""

    def __init__(
        self,
        prepared: Prepared,
        *,
        clock: str,
        reach: Reach,
        ticks: int,
        record: bool,
        show: Callable[[Progress], None] | None = None,
    ) -> None:
        """Prepare a run; nothing is started yet.

        Args:
            prepared: the session with its coupling and certificate.
            clock: "realtime" or "simulated".
            reach: how the processes reach each other.
            ticks: number of ticks; 0 runs until interrupted.
            record: whether to keep every x and f_v.
            show: told about the progress a few times a second.
        """
        session = prepared.session
        self._prepared, self._session, self._certificate = prepared, session, prepared.certificate
        self._clock_name, self._reach, self._record = clock, reach, record
        self._show = show
        self._graph = topology(session)
        self._conductor = Conductor(self._graph, prepared.id, session.name, ticks, reach.remote)
        self._clock = RealtimeClock()
        self._audience = Audience(session)
        self._heard: dict[str, Instant] = {}
        self._refused: Mapping[str, int] = {}
        self._telemetry: dict[str, Telemetry] = {}
        self._notices: dict[str, str] = {}
        self._began: Instant | None = None
        devices = {name: self._graph.ports[name] for name, role in self._graph.nodes.items() if role is Role.DEVICE}
        self._collector = Collector(devices)

    def run(self) -> Outcome:
        """Run the session to its end."""
        with Interrupt() as interrupt:
            with run_directory() as directory:
                self._run_in(directory, interrupt)
            return self._outcome(interrupt.signal)

    def _run_in(self, directory: Path, interrupt: Interrupt) -> None:
        reach = self._reach
        transport = ZmqTransport.of(reach.transport, directory, reach.ring())
        processes = Processes(directory)
        try:
            local = [name for name in self._graph.nodes if name not in reach.remote]
            private = {} if reach.keys is None else {name: reach.keys.file(name, directory) for name in local}
            members = (*self._graph.nodes, *self._session.observers)
            hub, endpoint = transport.bind_hub(HUB_NAME, members, reach.hub_address())
            self._conductor.observers = self._audience.serve(transport, reach, self._graph)
            traces = self._record or self._audience.wants_traces
            run = Run(self._clock_name, directory, endpoint, traces, reach, private)
            places = placement(self._graph, sorted(os.sched_getaffinity(0))) if self._clock_name == REALTIME else {}
            bundles = cut(self._prepared, run)
            for name in local:
                path = directory / f"{name}.bundle"
                bundle_files.save(bundles[name], path)
                processes.start(name, self._graph.nodes[name], path, places.get(name))
            self._watch(hub, transport, processes, interrupt)
        finally:
            processes.end_all()
            transport.close()

    def _watch(self, hub: Hub, transport: ZmqTransport, processes: Processes, interrupt: Interrupt) -> None:
        """The loop: wait for anything, tell the conductor, do as it says."""
        conductor, clock = self._conductor, self._clock
        phase, deadline = conductor.phase, Instant(clock.now() + STARTUP_TIME)
        shown = Instant(0)
        per_second = HUB_FRAMES_PER_S + FRAMES_A_NODE[self._clock_name] * len(self._graph.nodes)
        allowance = Allowance(per_second, clock.now())
        while conductor.phase is not Phase.OVER:
            pause = allowance.pause(clock.now())
            timeout = min(REFRESH, max(deadline - clock.now(), 0), *([pause] if pause else []))
            ready = hub.wait(Duration(timeout), (*processes.fds, interrupt.fd), frames=pause == 0)
            if interrupt.fd in ready and interrupt.signal is not None:
                interrupt.clear()
                self._carry_out(conductor.interrupt(), hub, processes)
            until = clock.now() + READING_TIME
            while allowance.pause(clock.now()) == 0 and clock.now() < until:
                before = hub.handled
                received = hub.recv()
                allowance.spend(hub.handled - before, clock.now())  # what it dropped counts, too
                if received is None:
                    break
                self._hear(*received, hub, processes)
            for name in self._silent():
                self._carry_out(conductor.silent(name), hub, processes)
            for name, code in processes.reap(ready).items():
                self._carry_out(conductor.exited(name, code), hub, processes)
            if conductor.phase is not phase:
                phase, shown = conductor.phase, Instant(0)
                deadline = Instant(clock.now() + ENDING_TIME if phase is Phase.ENDING else 2**62)
                if phase is Phase.RUNNING:
                    self._began = clock.now()
                    self._heard = dict.fromkeys(self._reach.remote, self._began)  # who was ready first has waited
            elif conductor.phase is Phase.STARTING and conductor.awaited:
                deadline = Instant(clock.now() + STARTUP_TIME)
            elif clock.now() >= deadline:
                self._carry_out(conductor.too_late(), hub, processes)
                deadline = Instant(clock.now() + ENDING_TIME)
            if self._show is not None and clock.now() - shown >= REFRESH:
                shown = clock.now()
                self._tally(hub, transport)
                self._show(self._progress(processes))
        self._tally(hub, transport)
        for fault in _with_logs(conductor, processes):
            conductor.faults.append(fault)
        if self._show is not None:
            self._show(self._progress(processes))

    def _silent(self) -> list[str]:
        """Remote nodes that run and have not been heard for too long."""
        conductor, now = self._conductor, self._clock.now()
        running = [n for n in self._reach.remote if conductor.states[n] is NodeState.RUNNING]
        return [name for name in running if now - self._heard.get(name, now) > REMOTE_SILENCE]

    def _tally(self, hub: Hub, transport: ZmqTransport) -> None:
        counts = {**transport.refused(), **hub.dropped, "out_of_turn": self._conductor.ignored}
        counts["telemetry_that_does_not_fit"] = self._collector.refused
        self._refused = {kind: count for kind, count in counts.items() if count > 0}

    def _hear(self, sender: str, frame: bytes, hub: Hub, processes: Processes) -> None:
        if sender in self._reach.remote:
            self._heard[sender] = self._clock.now()
        message = decode(frame, MAX_CONTROL_BYTES)
        self._carry_out(self._conductor.hear(sender, message, self._clock.now()), hub, processes)
        if isinstance(message, Telemetry) and self._conductor.states.get(sender) is NodeState.RUNNING:
            self._telemetry[sender] = message
            self._check_assumptions(sender, message)
            self._audience.tell(sender, message)
            x, f_v = message.traces.get(names.DISPLACEMENT), message.traces.get(names.FORCE)
            if self._graph.nodes[sender] is Role.DEVICE and x is not None and f_v is not None:
                self._collector.add(sender, message.tick, x, f_v)

    def _carry_out(self, instructions: Iterable[Instruction], hub: Hub, processes: Processes) -> None:
        for instruction in instructions:
            match instruction:
                case Send(node, message):
                    hub.send(node, encode(message))  # one that is gone hears nothing; its exit is seen
                case Release(observer):
                    hub.forget(observer)
                case Terminate():
                    processes.send(signal.SIGTERM)
                case Kill():
                    processes.send(signal.SIGKILL)

    def _check_assumptions(self, node: str, telemetry: Telemetry) -> None:
        """Tell at once, and once, when a device's loop is not the one the certificate is about."""
        breaches = telemetry.figures.get(names.TAU_BREACHES, 0.0)
        if self._certificate is not None and breaches > 0 and node not in self._notices:
            tau = telemetry.figures.get(f"{names.TAU}_p50", math.nan)
            self._notices[node] = (
                f"{node}: the force is applied {tau:.0f} us (median) after the sample; the certificate assumes "
                f"{self._certificate.tau * 1e6:g} us"
            )
        if any(telemetry.figures.get(clips, 0.0) > 0 for clips in (names.CLIPPED, names.SATURATED)):
            self._notices.setdefault(
                f"{node} limits",
                f"{node}: a force was clipped to the limits; the certificate is about forces within them",
            )

    def _progress(self, processes: Processes) -> Progress:
        elapsed = 0.0 if self._began is None else seconds(Duration(self._clock.now() - self._began))
        return Progress(
            self._conductor.phase,
            {name: state.value for name, state in self._conductor.states.items()},
            dict(processes.pids),
            self._telemetry,
            elapsed,
            tuple(self._notices.values()),
            self._refused,
        )

    def _outcome(self, ended_by: signal.Signals | None) -> Outcome:
        conductor = self._conductor
        code = EXIT_FAILED if conductor.faults else EXIT_OK
        if conductor.interrupted and ended_by is not None:
            code = 128 + int(ended_by)
        ticks = max((report.ticks for report in conductor.reports.values()), default=0)
        recording = None
        if self._record:
            recording = self._collector.recording(self._session.name, conductor.certificate, self._session.period)
        return Outcome(
            code,
            tuple(conductor.faults),
            tuple(self._notices.values()),
            run_report(
                self._session.name,
                conductor.certificate,
                self._clock_name,
                ticks * self._session.period,
                self._graph.nodes,
                conductor.reports,
                self._refused,
            ),
            recording,
            {device: n for device, n in self._collector.lost.items() if n > 0},
            self._refused,
        )


def _with_logs(conductor: Conductor, processes: Processes) -> list[str]:
    """What the processes of a failed run wrote to their error output and did not say otherwise."""
    if not conductor.faults:
        return []
    told = "\n".join(conductor.faults)
    logs = ((name, processes.log(name)) for name in conductor.graph.nodes)
    return [f"{name} wrote:\n{text}" for name, text in logs if text and text not in told]
