"""Runs a session's processes from start to end, and leaves nothing behind.

The decisions are the :class:`manyhands.launch.conductor.Conductor`'s; here are its senses and hands: the hub's
frames, the ends of processes, Ctrl-C and deadlines go in, and its instructions are carried out. One thread, one
poll over all of them, and no waiting for time to pass.
"""

from __future__ import annotations

import math
import os
import shutil
import signal
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manyhands.launch.bundles import Run, cut
from manyhands.launch.conductor import Conductor, Instruction, Kill, Phase, Send, Terminate
from manyhands.launch.exits import EXIT_FAILED, EXIT_OK
from manyhands.launch.interrupt import Interrupt
from manyhands.launch.placement import placement
from manyhands.launch.preparation import Prepared
from manyhands.launch.processes import Processes
from manyhands.launch.recording import Collector, Recording
from manyhands.launch.report import run_report
from manyhands.launch.topology import topology
from manyhands.nodes import bundle as bundle_files
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import REALTIME
from manyhands.protocol.clock import Duration, Instant, RealtimeClock, from_seconds, seconds
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Role, Telemetry
from manyhands.protocol.transport import Hub
from manyhands.protocol.transport.zeromq import ZmqTransport

STARTUP_TIME = from_seconds(60.0)
ENDING_TIME = from_seconds(5.0)
REFRESH = from_seconds(0.2)

_PREFIX = "manyhands-"


@dataclass(frozen=True)
class Progress:
    """What a display is told.

    Attributes:
        phase: where the session stands.
        states: where each node stands.
        pids: process ids of the nodes that run.
        telemetry: the latest telemetry of each node.
        elapsed: since the first tick, s.
        notices: assumptions found broken, each told once.
    """

    phase: Phase
    states: Mapping[str, str]
    pids: Mapping[str, int]
    telemetry: Mapping[str, Telemetry]
    elapsed: float
    notices: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """How a run went.

    Attributes:
        code: exit code: 0, 1 a process failed, 130 on Ctrl-C (143 on SIGTERM, 129 on SIGHUP).
        faults: what went wrong, empty for a good run.
        notices: assumptions of the certificate that the run broke.
        report: the report's object.
        recording: every x and f_v, when wanted and any were received.
        lost: ticks missing from the recording, by device.
        refused: telemetry messages and control messages that made no sense.
    """

    code: int
    faults: tuple[str, ...]
    notices: tuple[str, ...]
    report: Mapping[str, Any]
    recording: Recording | None
    lost: Mapping[str, int]
    refused: int


class Supervisor:
    """One run of one session."""

    def __init__(
        self,
        prepared: Prepared,
        *,
        clock: str,
        transport: str,
        ticks: int,
        record: bool,
        show: Callable[[Progress], None] | None = None,
    ) -> None:
        """Prepare a run; nothing is started yet.

        Args:
            prepared: the session with its coupling and certificate.
            clock: "realtime" or "simulated".
            transport: "ipc" or "tcp" (on loopback).
            ticks: number of ticks; 0 runs until interrupted.
            record: whether to keep every x and f_v.
            show: told about the progress a few times a second.
        """
        session = prepared.session
        self._prepared, self._session, self._certificate = prepared, session, prepared.certificate
        self._clock_name, self._transport_name, self._record = clock, transport, record
        self._show = show
        self._graph = topology(session)
        self._conductor = Conductor(self._graph, prepared.id, session.name, ticks)
        self._clock = RealtimeClock()
        self._telemetry: dict[str, Telemetry] = {}
        self._notices: dict[str, str] = {}
        self._began: Instant | None = None
        devices = {name: self._graph.ports[name] for name, role in self._graph.nodes.items() if role is Role.DEVICE}
        self._collector = Collector(devices)

    def run(self) -> Outcome:
        """Run the session to its end."""
        with Interrupt() as interrupt:
            sweep_directories()
            directory = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
            try:
                self._run_in(directory, interrupt)
            finally:
                shutil.rmtree(directory)
            return self._outcome(interrupt.signal)

    def _run_in(self, directory: Path, interrupt: Interrupt) -> None:
        transport = ZmqTransport.of(self._transport_name, directory)
        processes = Processes(directory)
        try:
            hub, endpoint = transport.bind_hub("control")
            run = Run(self._clock_name, self._transport_name, directory, endpoint, self._record)
            places = placement(self._graph, sorted(os.sched_getaffinity(0))) if self._clock_name == REALTIME else {}
            for name, bundle in cut(self._prepared, run).items():
                path = directory / f"{name}.bundle"
                bundle_files.save(bundle, path)
                processes.start(name, self._graph.nodes[name], path, places.get(name))
            self._watch(hub, processes, interrupt)
        finally:
            processes.end_all()
            transport.close()

    def _watch(self, hub: Hub, processes: Processes, interrupt: Interrupt) -> None:
        """The loop: wait for anything, tell the conductor, do as it says."""
        conductor, clock = self._conductor, self._clock
        phase, deadline = conductor.phase, Instant(clock.now() + STARTUP_TIME)
        shown = Instant(0)
        while conductor.phase is not Phase.OVER:
            ready = hub.wait(Duration(min(REFRESH, max(deadline - clock.now(), 0))), (*processes.fds, interrupt.fd))
            if interrupt.fd in ready and interrupt.signal is not None:
                interrupt.clear()
                self._carry_out(conductor.interrupt(), hub, processes)
            while (received := hub.recv()) is not None:
                self._hear(*received, hub, processes)
            for name, code in processes.reap(ready).items():
                self._carry_out(conductor.exited(name, code), hub, processes)
            if conductor.phase is not phase:
                phase, shown = conductor.phase, Instant(0)
                deadline = Instant(clock.now() + ENDING_TIME if phase is Phase.ENDING else 2**62)
                if phase is Phase.RUNNING:
                    self._began = clock.now()
            elif clock.now() >= deadline:
                self._carry_out(conductor.too_late(), hub, processes)
                deadline = Instant(clock.now() + ENDING_TIME)
            if self._show is not None and clock.now() - shown >= REFRESH:
                shown = clock.now()
                self._show(self._progress(processes))
        for fault in _with_logs(conductor, processes):
            conductor.faults.append(fault)
        if self._show is not None:
            self._show(self._progress(processes))

    def _hear(self, sender: str, frame: bytes, hub: Hub, processes: Processes) -> None:
        message = decode(frame, MAX_CONTROL_BYTES)
        self._carry_out(self._conductor.hear(sender, message, self._clock.now()), hub, processes)
        if isinstance(message, Telemetry) and sender in self._graph.nodes:
            self._telemetry[sender] = message
            self._check_assumptions(sender, message)
            if names.DISPLACEMENT in message.traces and names.FORCE in message.traces:
                self._collector.add(
                    sender, message.tick, message.traces[names.DISPLACEMENT], message.traces[names.FORCE]
                )

    def _carry_out(self, instructions: Iterable[Instruction], hub: Hub, processes: Processes) -> None:
        for instruction in instructions:
            match instruction:
                case Send(node, message):
                    hub.send(node, encode(message))  # one that is gone hears nothing; its exit is seen
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

    def _progress(self, processes: Processes) -> Progress:
        elapsed = 0.0 if self._began is None else seconds(Duration(self._clock.now() - self._began))
        return Progress(
            self._conductor.phase,
            {name: state.value for name, state in self._conductor.states.items()},
            dict(processes.pids),
            self._telemetry,
            elapsed,
            tuple(self._notices.values()),
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
            ),
            recording,
            {device: n for device, n in self._collector.lost.items() if n > 0},
            self._collector.refused + conductor.ignored,
        )


def _with_logs(conductor: Conductor, processes: Processes) -> list[str]:
    """What the processes of a failed run wrote to their error output and did not say otherwise."""
    if not conductor.faults:
        return []
    told = "\n".join(conductor.faults)
    logs = ((name, processes.log(name)) for name in conductor.graph.nodes)
    return [f"{name} wrote:\n{text}" for name, text in logs if text and text not in told]


def sweep_directories() -> None:
    """Remove what runs whose supervisor was killed have left in the temporary directory.

    A run's directory bears its supervisor's process id; it is ours and nobody's when that process is gone.
    """
    for path in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*-*"):
        pid = path.name.removeprefix(_PREFIX).split("-")[0]
        if pid.isdigit() and path.is_dir() and path.stat().st_uid == os.getuid() and not Path(f"/proc/{pid}").exists():
            shutil.rmtree(path, ignore_errors=True)  # another supervisor may be sweeping too
