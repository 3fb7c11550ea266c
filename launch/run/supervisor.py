"""Runs the processes of a session from start to end, and leaves nothing behind.

The :class:`manyhands.launch.run.conductor.Conductor` decides; this module does its I/O. Frames at the hub, ends of
processes, Ctrl-C and deadlines go in, and the supervisor carries out the instructions that come back. One thread waits
in one poll for all of them, and never for time to pass.

A budget of frames that refills with time bounds the work of a flood. Frames beyond it stay unread: ZeroMQ takes turns
between senders and stops reading those whose queues are full. So a flooding sender is slowed down, and the frames of
the others still come through.
"""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from manyhands.launch.files import EXIT_FAILED, EXIT_OK
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.engine import drawing_of
from manyhands.launch.plan.hosts import ended_there, ssh_command
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.reach import HUB_NAME, Reach
from manyhands.launch.plan.seats import seat_parts
from manyhands.launch.plan.topology import usual_placement
from manyhands.launch.recordings.recording import Collector, one_period
from manyhands.launch.run.breaches import Assumptions, Cause, EndSession, ShiftCoupling, UserIncidents
from manyhands.launch.run.broadcast import ObserverBroadcast, Showing, condition_frame, describe, observation_frame
from manyhands.launch.run.conductor import Conductor
from manyhands.launch.run.directory import kept_files, run_directory
from manyhands.launch.run.outcome import Outcome, Progress, felt_links, lateness_entry, run_report
from manyhands.launch.run.processes import EndRequest, Interrupt, Processes
from manyhands.launch.run.recorder import Recorder
from manyhands.launch.run.recovery import Restarts
from manyhands.launch.run.running import Running, twins
from manyhands.launch.run.states import (
    Instruction,
    Kill,
    KillProcess,
    NodeState,
    ReleaseName,
    Send,
    SessionPhase,
    StartProcess,
    Terminate,
)
from manyhands.launch.session import ENVIRONMENT, SUPERVISOR
from manyhands.nodes.guest.handed_over import handed_over
from manyhands.nodes.joins import HANDSHAKE_TIME
from manyhands.nodes.kernel import bundle as bundle_files
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED
from manyhands.nodes.kernel.log import Log, LogEvent, log_path
from manyhands.nodes.monitor.health import PromiseState, cut_forces
from manyhands.nodes.monitor.health_model import HealthModel
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.lives import Lives
from manyhands.nodes.rows.promises import Promise
from manyhands.nodes.wave_link.felt import round_trip
from manyhands.protocol.clock import Duration, Instant, RealtimeClock, from_seconds, seconds
from manyhands.protocol.codec import ForeignHello, decode, encode
from manyhands.protocol.limits import HUB_FRAMES_PER_S, MAX_CONTROL_BYTES
from manyhands.protocol.messages import Fetch, Figures, NodeHello, PromiseStatus, Ready, Report, Role, Telemetry
from manyhands.protocol.transport import Hub
from manyhands.protocol.transport.zeromq import ZmqTransport

_NS_PER_S = 1_000_000_000

_ABOUT = {
    Cause.DELAY: Promise.DELAY,
    Cause.PERIOD: Promise.PERIOD,
    Cause.WAITS: Promise.PUNCTUALITY,
}
"""The promise that a notice of each cause is about."""


class FrameAllowance:
    """A token bucket of frames. Once empty it stays closed until it holds a tenth of a second's worth: few wake-ups in
    a flood.

    Attributes:
        exhausted: number of times that it ran empty.
    """

    def __init__(self, per_second: int, now: Instant) -> None:
        """The bucket is full at ``now``: ``per_second`` frames at once, and as many a second in the long run."""
        self._interval = _NS_PER_S // per_second
        self._credit = _NS_PER_S  # ns
        self._at = now
        self._dry = False
        self.exhausted = 0

    def spend(self, frames: int, now: Instant) -> None:
        """Take ``frames`` off, even if that is more than there are."""
        self._refill(now)
        self._credit -= frames * self._interval
        if self._credit < self._interval and not self._dry:
            self._dry = True
            self.exhausted += 1

    def pause(self, now: Instant) -> Duration:
        """How long not to read, ns; 0 while frames are left."""
        self._refill(now)
        wanted = _NS_PER_S // 10 if self._dry else self._interval
        if self._credit >= wanted:
            self._dry = False
            return Duration(0)
        return Duration(wanted - self._credit)

    def _refill(self, now: Instant) -> None:
        self._credit = min(_NS_PER_S, self._credit + now - self._at)
        self._at = now


class LastMessages:
    """When the latest message of each node came; for an unknown node, when it is first asked for."""

    def __init__(self) -> None:
        self._came: dict[str, Instant] = {}

    def note(self, name: str, now: Instant) -> None:
        """Note that a message of ``name`` came at ``now``."""
        self._came[name] = now

    def forget(self, name: str) -> None:
        """Forget ``name``: its next message comes from a new process."""
        self._came.pop(name, None)

    def quiet(self, names: Iterable[str], now: Instant, after: Duration) -> list[str]:
        """Those of ``names`` whose latest message came more than ``after``, ns, ago."""
        return [name for name in names if now - self._came.setdefault(name, now) > after]


class Listening:
    """For how long a supervisor has listened, and no node has said a word.

    A supervisor that gets no turn has not listened. So only turns count after which nothing was left to read, and of a
    longer one no more than :data:`LONGEST_TURN`.

    Attributes:
        unheard: that time, ns.
    """

    def __init__(self, now: Instant) -> None:
        """Listening begins at ``now``."""
        self._since = now
        self.unheard = Duration(0)

    def turn(self, now: Instant, empty: bool) -> None:
        """A turn of the supervisor's loop ends at ``now``; ``empty`` is whether it has read all that had come."""
        if empty:
            self.unheard = Duration(self.unheard + min(now - self._since, LONGEST_TURN))
        self._since = now

    def hear(self) -> None:
        """Telemetry has come."""
        self.unheard = Duration(0)


STARTUP_TIME = from_seconds(60.0)
ENDING_TIME = from_seconds(5.0)
ENDING_ELSEWHERE = 3.0  # s; for a node on another machine, and its ssh, to end after its last message
REFRESH = from_seconds(0.2)
READING_TIME = from_seconds(0.05)  # the longest time between two checks of processes, signals and deadlines
LONGEST_TURN = Duration(REFRESH + READING_TIME)  # of a loop that gets the processor when it needs it
CLOSING_TIME = from_seconds(10.0)  # for the nodes that are not done, after the last report
REMOTE_SILENCE = from_seconds(3.0)  # an honest remote node sends a frame every second
JOINING_SILENCE = Duration(HANDSHAKE_TIME + REMOTE_SILENCE)  # it sends nothing while it shakes hands
TELEMETRY_SILENCE = from_seconds(1.0)  # ten telemetry messages in real time
LEFT_BEHIND = 0.5  # s of the session's time, five telemetry messages; a silent node then breaks its presence
HEARD_BEFORE = 1.0  # s; telemetry in the turn that begins the session can be of ticks before we noted the beginning
CLOCKS_DIFFER = 0.01  # relative; a hundred times the error of a quartz
FASTEST_TICK = 1e-5  # s; under the simulated clock, where every tick still passes between processes
FRAMES_A_NODE = {REALTIME: 50, SIMULATED: 2000}  # a second; an honest node sends one telemetry message in 100 ticks


class Supervisor:
    """One run of one session.

    Attributes:
        conductor: the state of the session and of each node.
    """

    def __init__(
        self,
        prepared: Prepared,
        *,
        clock: str,
        reach: Reach,
        ticks: int,
        record: bool,
        recorder: Recorder | None = None,
        logs: Path | None = None,
        together: bool = False,
        show: Callable[[Progress], str | None] | None = None,
        places: Mapping[str, int] | None = None,
        interrupt: EndRequest | None = None,
    ) -> None:
        """Prepare a run; nothing is started yet.

        Args:
            prepared: the session with its coupling and certificate.
            clock: "realtime" or "simulated".
            reach: how the processes reach each other.
            ticks: number of ticks; 0 runs until interrupted.
            record: whether to keep every x and f_v in memory, for the outcome.
            recorder: writes the recording while the session runs; none by default.
            logs: the folder for the processes' logs; by default they are removed with the run's directory.
            together: whether a guest that leaves ends the session.
            show: called with the progress a few times a second; returns an incident of the display, if there is one.
            places: the processor of each node that is pinned to one; by default :func:`usual_placement` chooses them.
            interrupt: what ends the run early; by default the signals of the terminal, in a main thread.
        """
        session = prepared.session
        self._prepared, self._session = prepared, session
        self._clock_name, self._reach, self._record = clock, reach, record
        self._recorder, self._logs, self._interrupt = recorder or Recorder(), logs, interrupt
        self._about = replace(
            describe(prepared, clock, reach.transport, ticks, reach.remote, reach.seats), drawing=drawing_of(session)
        )
        self._health = HealthModel(self._about.terms)
        self._showing: Showing | None = None
        self._show = show
        self._graph = prepared.graph
        restarts = Restarts(session.faults.restarts, from_seconds(session.faults.window))
        self.conductor = Conductor(
            self._graph,
            prepared.id,
            session.name,
            ticks,
            reach.remote,
            restarts=restarts,
            together=together,
            seats=reach.seats,
        )
        self._assumptions = Assumptions(prepared, self._graph, clock, self.conductor.rungs)
        self._users = UserIncidents(
            self._graph, session.period, session.own_periods, {n: device.units for n, device in session.devices.items()}
        )
        self._clock = RealtimeClock()
        self._log = Log(None, session.name, SUPERVISOR, self._clock)
        self._observer_broadcast = ObserverBroadcast(session)
        self._received, self._reported = LastMessages(), LastMessages()
        self._lives = Lives()
        self._directory = Path()
        self._places = self._choose_places() if places is None else places
        self._to_start: set[str] = set()
        self._refused: Mapping[str, int] = {}
        self._listening = Listening(self._clock.now())
        self._untimely = 0  # telemetry messages of ticks that cannot have run yet
        self._telemetry: dict[str, Telemetry] = {}
        self._began: Instant | None = None
        devices = {name: self._graph.ports[name] for name, role in self._graph.nodes.items() if role is Role.DEVICE}
        self._collector = Collector(devices)

    def _choose_places(self) -> Mapping[str, int]:
        return usual_placement(self._graph, self._reach.remote) if self._clock_name == REALTIME else {}

    def run(self) -> Outcome:
        """Run the session to its end; processes, sockets and the run's directory are gone afterwards."""
        with self._interrupt or Interrupt() as interrupt:
            with run_directory(self._logs) as directory:
                self._log = Log(log_path(str(directory), SUPERVISOR), self._session.name, SUPERVISOR, self._clock)
                self._log.note(LogEvent.START, pid=os.getpid(), certificate=self._prepared.id, clock=self._clock_name)
                try:
                    self._run_in(directory, interrupt)
                finally:
                    self._log.note(LogEvent.END, reason=str(interrupt.signal or "over"))
                    self._log.close()
            return self.outcome(interrupt.signal)

    def _run_in(self, directory: Path, interrupt: EndRequest) -> None:
        reach = self._reach
        transport = ZmqTransport.of(reach.transport, directory, reach.ring())
        processes, elsewhere = Processes(directory), Processes(directory)
        try:
            self._showing = Showing(directory, self._about, kept_files(self._prepared))
            for twin in twins(Running(directory, self._about)):
                self._note_incident(twin)
            local = [name for name in self._graph.nodes if name not in reach.remote]
            of_ours, keys = (*local, *reach.hosts), reach.keys
            private = {} if keys is None else {name: keys.file(name, directory) for name in of_ours}
            members = (*self._graph.nodes, *self._session.observers)
            hub, endpoint = transport.bind_hub(HUB_NAME, members, reach.hub_address())
            self.conductor.observers = self._observer_broadcast.serve(transport, reach, self._graph)
            self._recorder.start(directory)  # first, so that it is ready by the time the nodes are
            run = RunPlan(self._clock_name, directory, endpoint, reach, private)
            self._directory = directory
            bundles = cut(self._prepared, run)
            self.conductor.ids.update({name: bundles[name].common.certificate for name in self._session.sites})
            if reach.seats and keys is not None:
                self.conductor.parts.update(seat_parts(self._prepared, keys))
            for name in local:
                bundle_files.save(bundles[name], self._bundle_path(name))
            for name in local:
                self._start_process(name, processes)
            for name, host in reach.hosts.items():
                given = handed_over(bundles[name], private[name].read_bytes())
                elsewhere.start_elsewhere(name, ssh_command(name, host, endpoint, reach.program), given)
            self._recorder.await_ready(interrupt.fd)
            self._watch(hub, transport, processes, interrupt, elsewhere)
            elsewhere.await_all(ENDING_ELSEWHERE)
            self._note_incident(self._recorder.finish(interrupt.fd))
        finally:
            self._recorder.close()
            processes.end_all()
            elsewhere.end_all()  # the node there ends with its standard input
            transport.close()
            if self._showing is not None:
                self._showing.close()

    def _watch(
        self, hub: Hub, transport: ZmqTransport, processes: Processes, interrupt: EndRequest, elsewhere: Processes
    ) -> None:
        """The loop: wait for any event, pass it to the conductor, carry out its instructions, until the session is
        over.
        """
        conductor, clock, recorder = self.conductor, self._clock, self._recorder
        phase, deadline = conductor.phase, Instant(clock.now() + STARTUP_TIME)
        shown, reported = Instant(0), 0
        per_second = HUB_FRAMES_PER_S + FRAMES_A_NODE[self._clock_name] * len(self._graph.nodes)
        allowance = FrameAllowance(per_second, clock.now())
        while conductor.phase is not SessionPhase.OVER:
            # while the budget is empty or the recorder is full, frames stay in their queues and do not wake the poll
            pause = allowance.pause(clock.now())
            timeout = min(REFRESH, max(deadline - clock.now(), 0), *([pause] if pause else []))
            fds = (*processes.fds, *elsewhere.fds, *recorder.fds, interrupt.fd)
            ready = hub.wait(Duration(timeout), fds, frames=pause == 0 and recorder.has_room)
            if interrupt.fd in ready and interrupt.signal is not None:
                interrupt.clear()
                self.carry_out(conductor.interrupt(), hub, processes)
            # reading is bounded in frames and in time: processes, signals and deadlines are served even in a flood
            until, empty = clock.now() + READING_TIME, False
            while allowance.pause(clock.now()) == 0 and clock.now() < until and recorder.has_room:
                before = hub.handled
                received = hub.recv()
                allowance.spend(hub.handled - before, clock.now())  # frames that the hub dropped count, too
                if received is None:
                    empty = True
                    break
                self.receive(*received, hub, processes)
            self._listening.turn(clock.now(), empty)
            self._note_incident(recorder.attend(ready))
            if not recorder.has_room:  # we do not read now, so no node counts as silent
                for name in self._reach.remote:
                    self._received.note(name, clock.now())
            for name in self._silent():
                self.carry_out(conductor.silent(name, clock.now()), hub, processes)
            for name, code in processes.reap(ready).items():
                self._log.note(LogEvent.EXITED, peer=name, code=code)
                said = processes.last_words(name) if code > 0 else ""
                self.carry_out(conductor.exited(name, code, clock.now(), said), hub, processes)
            for name, code in elsewhere.reap(ready).items():
                self._log.note(LogEvent.EXITED, peer=name, code=code)
                how = ended_there(self._reach.hosts[name], code, elsewhere.log(name))
                self.carry_out(conductor.silent(name, clock.now(), how), hub, processes)
            self.carry_out(conductor.look(clock.now()), hub, processes)
            if conductor.phase is not phase:
                phase, shown = conductor.phase, Instant(0)
                self._log.note(LogEvent.PHASE, phase=phase.value)
                deadline = Instant(clock.now() + ENDING_TIME if phase is SessionPhase.ENDING else 2**62)
                if phase is SessionPhase.RUNNING:
                    self._began = clock.now()
                    self._listening = Listening(self._began)
                    for name in self._reach.remote:
                        self._received.note(name, self._began)  # a node that was ready early had nothing to send
            elif conductor.phase is SessionPhase.STARTING and conductor.awaited:
                deadline = Instant(clock.now() + STARTUP_TIME)
            elif conductor.phase is SessionPhase.RUNNING and len(conductor.finished) > reported:
                reported, deadline = len(conductor.finished), Instant(clock.now() + CLOSING_TIME)
            elif clock.now() >= deadline:
                self.carry_out(conductor.too_late(), hub, processes)
                deadline = Instant(clock.now() + ENDING_TIME)
            if clock.now() - shown >= REFRESH:
                shown = clock.now()
                self._log.flush()
                self._tally(hub, transport)
                self._report(self.progress(processes))
        self._tally(hub, transport)
        for fault in conductor.faults:
            self._log.note(LogEvent.FAULT, text=fault)
        for text in self._notices(self._promises()):
            self._log.note(LogEvent.NOTICE, text=text)
        for text in conductor.incidents.sentences:
            self._log.note(LogEvent.INCIDENT, text=text)
        for text in conductor.visits.sentences:
            self._log.note(LogEvent.VISIT, text=text)
        for fault in _with_logs(conductor, processes):
            conductor.faults.append(fault)
        self._report(self.progress(processes))

    def _report(self, progress: Progress) -> None:
        """Report the session's condition to the display, the recorder and the observers."""
        if self._show is not None:
            self._note_incident(self._show(progress))
        frame = condition_frame(progress)
        if frame is not None:  # a condition that is too long for a frame is no loss: the next one repeats it
            self._recorder.take(frame)
        if self._showing is not None:
            self._showing.show(frame)

    def _note_incident(self, incident: str | None) -> None:
        if incident is not None:
            self.conductor.incidents.add(incident)

    def _silent(self) -> list[str]:
        """Remote nodes that run, or come back into a running session, and have sent nothing for too long."""
        states, now = self.conductor.states, self._clock.now()
        running = [n for n in self._reach.remote if states[n] is NodeState.RUNNING]
        joining = [n for n in self._reach.remote if self.conductor.comes_back(n)]
        quiet = self._received.quiet
        return quiet(running, now, REMOTE_SILENCE) + quiet(joining, now, JOINING_SILENCE)

    def _tally(self, hub: Hub, transport: ZmqTransport) -> None:
        counts = {**transport.refused(), **hub.dropped, "out_of_turn": self.conductor.ignored}
        counts["telemetry_that_does_not_fit"] = self._collector.refused + self._untimely
        self._refused = {kind: count for kind, count in counts.items() if count > 0}

    def receive(self, sender: str, frame: bytes, hub: Hub, processes: Processes) -> None:
        """Decode one frame of the hub, pass it to the conductor, and carry out what the conductor decides.

        Telemetry of a tick that cannot have run yet is counted and dropped.
        """
        message = decode(frame, MAX_CONTROL_BYTES)
        if sender in self._reach.remote and not isinstance(message, NodeHello | ForeignHello | Fetch):
            self._received.note(sender, self._clock.now())
        if isinstance(message, Telemetry) and message.tick > self._most_ticks(sender):
            self._untimely += 1
            return
        if isinstance(message, Report):
            if message.ticks <= self._most_ticks(sender):
                self._health.take(sender, message.ticks, message.figures)
            else:  # no node can have done so many: what was seen of it stands in place of what it says
                self._untimely += 1
                seen = self._telemetry.get(sender)
                message = Report(0 if seen is None else seen.tick, Figures())
        before = self.conductor.states.get(sender)
        if isinstance(message, Ready) and before is NodeState.CONNECTED:
            self._health.hear(sender, message.by_itself)
        self.carry_out(self.conductor.receive(sender, message, self._clock.now()), hub, processes)
        after = self.conductor.states.get(sender)
        if sender in self._reach.remote and before is not after:
            # so a hello counts once it is taken: one that knocks at a seat that is taken is of another process, and
            # would keep a dead one from being counted as silent
            self._received.note(sender, self._clock.now())
            if after is NodeState.RUNNING:
                self._forget(sender)  # it is another process than before, which was not started here
        conductor = self.conductor
        if message is conductor.reports.get(sender) or message is conductor.left.get(sender):
            self._lives.take(sender, message.figures)
        if isinstance(message, Telemetry) and self.conductor.states.get(sender) is NodeState.RUNNING:
            self._telemetry[sender] = message
            self._lives.take(sender, message.figures)
            self._note_round_trip(sender)
            self._health.take(sender, message.tick, message.figures)
            self._listening.hear()
            self._reported.note(sender, self._clock.now())
            for deed in self._assumptions.check(sender, message):
                match deed:
                    case ShiftCoupling(coupling, rung):
                        self.carry_out(self.conductor.shift(coupling, rung), hub, processes)
                    case EndSession(reason):
                        self.carry_out(self.conductor.stop(reason), hub, processes)
            for sentence in self._users.receive(sender, message, self._in_tick()):
                self.conductor.note(sentence, self._clock.now())
            message = names.shown(message)
            self._observer_broadcast.send(sender, message)
            observation = observation_frame(sender, message)
            self._recorder.take(observation)
            if self._showing is not None:
                self._showing.show(observation)
            x, f_v = message.traces.get(names.DISPLACEMENT), message.traces.get(names.FORCE)
            if self._record and self._graph.nodes[sender] is Role.DEVICE and x is not None and f_v is not None:
                self._collector.add(sender, message.tick, x, f_v)

    def _note_round_trip(self, coupling: str) -> None:
        """Tell the conductor R of a wave link by the latest figures of its two ends, for its coupling."""
        if coupling in self._session.wave_links:
            user, world = (self._figures_of(node) for node in (coupling, ENVIRONMENT))
            self.conductor.note_round_trip(coupling, round_trip(coupling, user, world))

    def _figures_of(self, node: str) -> Figures:
        """The latest figures of a node; none where none have come."""
        latest = self._telemetry.get(node)
        return Figures() if latest is None else latest.figures

    def _most_ticks(self, node: str) -> int:
        now, period = self._clock.now(), self._session.period_of(node)
        elapsed = Duration(now - (now if self._began is None else self._began))
        ticks = round(self.conductor.ticks * self._session.period / period)
        return most_ticks(elapsed, period, self._clock_name, ticks)

    def carry_out(self, instructions: Iterable[Instruction], hub: Hub, processes: Processes) -> None:
        """Do what the conductor decided: send messages, release names, start and end processes."""
        for instruction in instructions:
            match instruction:
                case Send(node, message):
                    hub.send(node, encode(message))  # a frame to a dead node is lost; we see its process end
                case ReleaseName(name):
                    hub.forget(name)
                case StartProcess(node):
                    self._start_anew(node, hub, processes)
                case KillProcess(node):
                    processes.kill(node)
                    self._give_up({node}, hub, processes)
                case Terminate():
                    processes.send(signal.SIGTERM)
                    self._give_up(self._to_start, hub, processes)
                case Kill():
                    processes.send(signal.SIGKILL)

    def _bundle_path(self, name: str) -> Path:
        return self._directory / f"{name}.bundle"

    def _start_process(self, name: str, processes: Processes) -> None:
        """Start a node; nodes that share a process are started together, when the last of them is to be started."""
        together = self._graph.together(name)
        self._to_start.add(name)
        if self._to_start.issuperset(together):
            self._to_start.difference_update(together)
            role, paths = self._graph.nodes[together[0]], [self._bundle_path(node) for node in together]
            processes.start(together, role, paths, self._places.get(together[0]))

    def _give_up(self, names: Collection[str], hub: Hub, processes: Processes) -> None:
        """Report those of ``names`` that still wait for the others of their process: none of theirs could ever end."""
        waiting = self._to_start.intersection(names)
        self._to_start -= waiting
        for name in sorted(waiting):
            told = self.conductor.not_started(name, "others of its process never came", self._clock.now())
            self.carry_out(told, hub, processes)

    def _forget(self, name: str) -> None:
        """Forget what the former process of a node has reported: the next one counts anew, and is not silent yet."""
        self._telemetry.pop(name, None)
        self._lives.forget(name)
        self._note_round_trip(name)
        self._reported.forget(name)
        self._assumptions.forget(name)
        self._users.forget(name)
        self._health.forget(name)

    def _in_tick(self) -> list[str]:
        """The couplings without a wave link whose nodes all run, while the session runs."""
        states = self.conductor.states
        if self.conductor.phase is not SessionPhase.RUNNING:
            return []
        return [
            name
            for name in self._session.couplings
            if name not in self._session.wave_links
            and all(states[node] is NodeState.RUNNING for node in (name, *self._session.devices_of(name)))
        ]

    def _unreported(self) -> list[str]:
        """The nodes that have run and sent no final report; nobody has sat at a seat without telemetry."""
        reported, seats = {**self.conductor.left, **self.conductor.reports}, self._reach.seats
        if self._began is None:
            return []
        return [n for n in self._graph.nodes if n not in reported and (n not in seats or n in self._telemetry)]

    def _start_anew(self, name: str, hub: Hub, processes: Processes) -> None:
        """Start the next process of a lost node; only its bundle and its log are kept from the former one."""
        self._forget(name)
        try:
            self._start_process(name, processes)
            for node in self._graph.together(name):
                if node in processes.pids:
                    self.conductor.started(node, processes.pids[node])
        except OSError as error:
            for node in self._graph.together(name):
                told = self.conductor.not_started(node, str(error.strerror), self._clock.now())
                self.carry_out(told, hub, processes)

    def progress(self, processes: Processes) -> Progress:
        """The state of the session now, for the table and the observers."""
        elapsed = 0.0 if self._began is None else seconds(Duration(self._clock.now() - self._began))
        conductor = self.conductor
        running = [name for name, state in conductor.states.items() if state is NodeState.RUNNING]
        silent = frozenset(self._reported.quiet(running, self._clock.now(), TELEMETRY_SILENCE))
        states = {name: conductor.shown_state(name) for name in conductor.states}
        if conductor.phase is SessionPhase.RUNNING and not conductor.finished:
            sent = {name: latest.tick * self._session.period_of(name) for name, latest in self._telemetry.items()}
            self._health.look(states, left_behind(silent, sent), seconds(self._listening.unheard))
        promises = self._promises()
        return Progress(
            conductor.phase,
            states,
            dict(processes.pids),
            self._telemetry,
            elapsed,
            self._notices(promises),
            self._refused,
            silent,
            conductor.incidents.sentences,
            tuple(conductor.faults),
            promises,
            dict(self._health.by_itself),
            conductor.visits.sentences,
        )

    def _promises(self) -> tuple[PromiseStatus, ...]:
        """How each promise stands, with the notices about them."""
        return self._health.rows(
            {_ABOUT[cause]: text for cause, text in self._assumptions.notices.items() if cause in _ABOUT}
        )

    def _notices(self, promises: Iterable[PromiseStatus]) -> tuple[str, ...]:
        """The sentences about broken assumptions: forces that were cut and a slow session have theirs in their rows."""
        rows = list(promises)
        cut = [row for row in rows if row.promise == Promise.FORCE and row.state != PromiseState.KEPT]
        pace = tuple(row.remark for row in rows if row.promise == Promise.PACE and row.remark)
        return (*self._assumptions.notices.values(), *([cut_forces(cut)] if cut else []), *pace)

    def outcome(self, ended_by: signal.Signals | None) -> Outcome:
        """The result of the run: exit code, faults, report and recording.

        Args:
            ended_by: the signal that interrupted the run, if one did.
        """
        conductor, recorder = self.conductor, self._recorder
        if recorder.failure is not None:
            conductor.faults.append(recorder.failure)
        code = EXIT_FAILED if conductor.faults or recorder.stopped else EXIT_OK
        if conductor.interrupted and ended_by is not None:
            code = 128 + int(ended_by)
        lasted = max(
            (
                min(report.ticks, self._most_ticks(node)) * self._session.period_of(node)
                for node, report in conductor.reports.items()
            ),
            default=0.0,
        )
        recording = None
        if self._record:
            period = one_period({device: self._session.period_of(device) for device in self._session.devices})
            recording = self._collector.recording(
                self._session.name, conductor.certificate, period, self._session.turning
            )
        self._health.conclude()
        # of a run that failed before its first tick no promise was tried
        promises = self._promises() if lasted or not conductor.faults else ()
        reports = {
            node: replace(report, figures=self._lives.of(node))
            for node, report in {**conductor.left, **conductor.reports}.items()
        }
        return Outcome(
            code,
            tuple(conductor.faults),
            self._notices(promises),
            run_report(
                self._session.name,
                conductor.certificate,
                self._clock_name,
                lasted,
                self._graph.nodes,
                reports,
                self._refused,
                conductor.incidents,
                self._prepared.loop.enforced,
                lateness_entry(self._prepared, self._clock_name),
                felt_links(self._session, {node: report.figures for node, report in reports.items()}),
                promises,
                self._unreported(),
                self._health.by_itself,
                {name: device.kinds for name, device in self._session.devices.items()} if self._session.turning else {},
                conductor.visits.sentences,
            )
            | recorder.as_plain(),
            recording,
            {**self._collector.missing, **recorder.missing},
            self._refused,
            conductor.incidents.sentences,
        )


def most_ticks(elapsed: Duration, period: float, clock: str, ticks: int) -> int:
    """The most ticks that can have run; a node that claims more is not believed.

    Args:
        elapsed: time since the first tick by the supervisor's own clock, ns.
        period: T, s.
        clock: "realtime", where a node's clock may be ahead by :data:`CLOCKS_DIFFER` and by :data:`HEARD_BEFORE`; or
            "simulated", where a tick takes :data:`FASTEST_TICK` at least.
        ticks: of the whole session; 0: no end.
    """
    if clock == SIMULATED:
        most = (seconds(elapsed) + HEARD_BEFORE) / FASTEST_TICK
    else:
        most = ((1.0 + CLOCKS_DIFFER) * seconds(elapsed) + HEARD_BEFORE) / period
    return min(math.ceil(most), ticks) if ticks else math.ceil(most)


def left_behind(silent: Iterable[str], sent: Mapping[str, float]) -> frozenset[str]:
    """Those of ``silent`` who break their presence: the others have gone on without them.

    Silence is measured by the wall clock. A session that is simulated slowly, or a whole machine that stands still,
    makes every node silent, and none of them is away. Nor is a node that has sent all its ticks, and ends slowly.

    Args:
        silent: the nodes that run, and have sent no telemetry for a while.
        sent: the session's time up to which each node has sent telemetry, s; nodes that have sent none are absent.
    """
    newest = max(sent.values(), default=0.0)
    return frozenset(name for name in silent if newest - sent.get(name, 0.0) > LEFT_BEHIND)


def _with_logs(conductor: Conductor, processes: Processes) -> list[str]:
    """The error output of a failed run's processes, without the lines that its faults already contain."""
    if not conductor.faults:
        return []
    faults = "\n".join(conductor.faults)
    logs = {name: processes.log(name).splitlines() for name in conductor.graph.nodes}
    new = {name: "\n".join(line for line in lines if line not in faults) for name, lines in logs.items()}
    return [f"{name} wrote:\n{text}" for name, text in new.items() if text]
