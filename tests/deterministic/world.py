"""A whole session on one scheduler: the product's nodes and its conductor, with a virtual supervisor between them."""

from __future__ import annotations

import itertools
import math
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from chaos_kinds import PROMISE

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.topology import topology
from manyhands.launch.run.breaches import Assumptions, ShiftCoupling, UserIncidents
from manyhands.launch.run.broadcast import describe
from manyhands.launch.run.conductor import Conductor
from manyhands.launch.run.recovery import Restarts
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
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.environment.membership import Members
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.kernel.bundle import CouplingBundle
from manyhands.nodes.kernel.lifetime import Stopped
from manyhands.nodes.monitor.health_model import HealthModel
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Probe, Report, SignalMessage, Telemetry
from manyhands.protocol.transport import Link

from .guests import Guest
from .process import SimulatedProcess, Witness
from .scheduler import Killed, Scheduler, VirtualClock
from .wires import Wires

KEPT: Final = 120  # notes
ENDING_TIME: Final = from_seconds(5.0)  # the supervisor's
LOOK: Final = from_seconds(0.2)  # the supervisor's, at what falls due
STARTS: Final = (0.5e6, 40e6)  # ns from a process's start to its hello
SEEN: Final = (50_000, 2_000_000)  # ns from a process's end to when the supervisor sees it
AWAY: Final = (20_000_000, 200_000_000)  # ns from a guest's end to its coming back


class SimulatedSession:
    """The session.

    Attributes:
        scheduler: its time.
        conductor: the product's conductor.
        assumptions: the product's judgement of what devices measure.
        health: the product's judgement of the promises.
        processes: the living processes, by node.
        violations: what did not hold, in words.
        notes: what happened lately, in words.
        heard: how many messages that move a node's state the conductor has heard.
        restarts: processes that were started anew.
        shifts: changes to another rung, in order.
    """

    def __init__(
        self,
        prepared: Prepared,
        clock: str,
        seed: int,
        frames: bool = False,
        ticks: int = 0,
        moved: Callable[[str, Driver, VirtualClock], Driver] = lambda _name, driver, _clock: driver,
        guest: Guest | None = None,
        witness: Witness | None = None,
        led: Mapping[str, Callable[[Link, Scheduler], Link]] = MappingProxyType({}),
    ) -> None:
        """Start every process of a session; nothing goes on before :meth:`Scheduler.run`.

        Args:
            prepared: the session, designed.
            clock: of the product: "simulated" or "realtime".
            seed: of all that happens.
            frames: whether every frame between nodes is noted, too.
            ticks: of the session; 0 for one that goes on until it is ended.
            moved: makes another driver of each device's own, by its name.
            guest: leads one of the devices, from a remote machine; None for a session of honest users.
            witness: looks at every tick and every telemetry; None for nobody.
            led: by hostile node, what it makes of each of its links to a peer; these nodes are remote, too.
        """
        self._led = led
        self.scheduler = Scheduler(seed)
        self.random = self.scheduler.random
        self.graph = topology(prepared.session)
        self._bundles = cut(prepared, RunPlan(clock, None, "wire://hub"))
        budget = Restarts(10**9)
        self._guest, self._witness = guest, witness
        self.health = HealthModel(describe(prepared, clock, "ipc", ticks).terms)
        self._energy = UserIncidents(self.graph, prepared.session.period)
        remote = frozenset(led) if guest is None else frozenset({guest.name})
        self.conductor = Conductor(self.graph, prepared.id, prepared.session.name, ticks, remote, restarts=budget)
        sites = prepared.session.sites
        self.conductor.ids.update({name: self._bundles[name].common.certificate for name in sites})
        self.assumptions = Assumptions(prepared, self.graph, clock, self.conductor.rungs)
        self.shifts: list[ShiftCoupling] = []
        self._moved = moved
        self.processes: dict[str, SimulatedProcess] = {}
        self.violations: list[str] = []
        self.notes: deque[str] = deque(maxlen=20 * KEPT if frames else KEPT)
        self.heard = self.restarts = 0
        self._ending = self.scheduler.now
        self._wires = Wires(self.scheduler, self._hear)
        if frames:
            self._wires.seen = self._see
        self._pids = itertools.count(1)
        self._to_start: set[str] = set()
        for name in self.graph.nodes:
            if name not in self.graph.carriers:
                self._start(name)
        self._look()

    def note(self, text: str) -> None:
        """Something happens."""
        self.notes.append(f"{self.scheduler.now / 1e6:.3f} ms, tick {self.tick}: {text}")

    def violate(self, text: str) -> None:
        """Something does not hold; the first of its kind is enough."""
        if text not in self.violations and len(self.violations) < 10:
            self.note(f"VIOLATION {text}")
            self.violations.append(text)

    def kill(self, name: str) -> None:
        """SIGKILL; frames that it sent last may not have left it. A coupling may be in its device's process."""
        process = self.processes.get(self.graph.carriers.get(name, name))
        if process is None or process.turn is None:
            return
        self.note(f"{process.name} is killed")
        del self.processes[process.name]
        process.die(self.random.choice((0.0, 0.5, 1.0)))
        self.scheduler.raise_in(process.turn, Killed())

    def stop(self, name: str, duration: int) -> None:
        """SIGSTOP, and SIGCONT after ``duration``, ns."""
        process = self.processes.get(self.graph.carriers.get(name, name))
        if process is not None and process.turn is not None:
            process.held = process.turn.ready = Instant(max(process.turn.ready, self.scheduler.now + duration))

    def interrupt(self) -> None:
        """The user ends the session."""
        self.note("the session is ended")
        self._obey(self.conductor.interrupt())

    @property
    def environment(self) -> EnvironmentNode | None:
        """The environment, if it is there."""
        process = self.processes.get(ENVIRONMENT)
        return process.node if process is not None and isinstance(process.node, EnvironmentNode) else None

    @property
    def members(self) -> Members | None:
        """The environment's, once it is in its loop."""
        return None if self.environment is None else self.environment.members

    @property
    def tick(self) -> int:
        """The environment's; 0 for none."""
        return 0 if self.environment is None else self.environment._account.ticks

    @property
    def whole(self) -> bool:
        """Whether all nodes take part."""
        members, states = self.members, self.conductor.states
        if self.conductor.phase is not SessionPhase.RUNNING or any(s is not NodeState.RUNNING for s in states.values()):
            return False
        if members is None or not members.all_active or len(self.processes) + len(self.graph.carriers) < len(states):
            return False
        for process in self.processes.values():
            if process.held > self.scheduler.now or not all(join.here for join in process.joins):
                return False
            if isinstance(process.node, DeviceNode) and process.node._free:
                return False
        return True

    def _start(self, name: str) -> None:
        pid, (_, *carried) = next(self._pids), self.graph.together(name)
        guest = self._guest if self._guest is not None and name == self._guest.name else None
        process = SimulatedProcess(
            self._bundles[name],
            pid,
            self._wires,
            self.note,
            self.violate,
            self._moved,
            guest,
            self._witness,
            self._led.get(name),
            [bundle for one in carried if isinstance(bundle := self._bundles[one], CouplingBundle)],
        )
        self.processes[name] = process
        for one in (name, *carried):
            self.assumptions.forget(one)
            self._energy.forget(one)
            self.health.forget(one)
            if self.conductor.phase is SessionPhase.RUNNING and guest is None:
                self.conductor.started(one, pid)
                self.restarts += 1
        delay = int(math.exp(self.random.uniform(*map(math.log, STARTS))))
        process.turn = self.scheduler.begin(name, process.run, delay, lambda error: self._ended(process, error))

    def _start_together(self, node: str) -> None:
        """Start a node; nodes that share a process are started together, when the last of them is to be started."""
        together = self.graph.together(node)
        self._to_start.add(node)
        if self._to_start.issuperset(together):
            self._to_start.difference_update(together)
            self.note(f"{node} is started")
            self._start(together[0])

    def _ended(self, process: SimulatedProcess, error: BaseException | None) -> None:
        """Report the end of a process; runs in its own thread."""
        if process.dead and error is not None:
            error = Killed()  # what it does while its thread unwinds, a killed process would not do
        code = process.code if error is None else -9 if isinstance(error, Killed | Stopped) else 1
        if error is not None and not isinstance(error, Killed | Stopped):
            told = "".join(traceback.format_exception(error))
            self.violate(f"{process.name} raised {error!r}\n{told}")
        if self.processes.get(process.name) is process:
            del self.processes[process.name]
        delay = self.random.randint(*SEEN)
        self.scheduler.after(delay, lambda: self._see_end(process.name, code))

    def _see_end(self, name: str, code: int) -> None:
        if name in self.conductor.remote:  # its end is not seen
            if self.conductor.phase is SessionPhase.RUNNING:
                self._obey(self.conductor.silent(name, self.scheduler.now))
            if self.conductor.phase is SessionPhase.RUNNING:
                self.scheduler.after(self.random.randint(*AWAY), lambda: self._come_back(name))
            return
        self.note(f"the supervisor sees the end of {name} ({code})")
        for one in self.graph.together(name):
            self._obey(self.conductor.exited(one, code, self.scheduler.now))

    def _come_back(self, name: str) -> None:
        """A guest joins again."""
        if self.conductor.phase is SessionPhase.RUNNING:
            self.note(f"{name} joins again")
            self._start(name)

    def _see(self, sender: str, peer: str, frame: bytes) -> None:
        message = decode(frame, MAX_CONTROL_BYTES)
        text = type(message).__name__
        if isinstance(message, SignalMessage):
            text += f" {message.tick}" + ("" if any(message.values) else " of zero")
        self.note(f"{sender} says to {peer}: {text}")

    def _look(self) -> None:
        self._obey(self.conductor.look(self.scheduler.now))
        if self.conductor.phase is not SessionPhase.ENDING:
            self._ending = self.scheduler.now
        elif self.scheduler.now - self._ending >= ENDING_TIME:
            self._ending = self.scheduler.now
            self._obey(self.conductor.too_late())
        if self.conductor.phase is not SessionPhase.OVER:
            self.scheduler.after(LOOK, self._look)

    def _hear(self, sender: str, frame: bytes) -> None:
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Telemetry):
            margin = message.figures.get(names.LEDGER_MARGIN, 0.0)
            if margin < PROMISE and (self._guest is None or sender != self._guest.name):
                self.violate(f"{sender}: found a ledger {-margin:g} J below its bound; expected none")
        elif not isinstance(message, Probe):
            self.heard += 1
            self.note(f"the supervisor hears of {sender}: {type(message).__name__}")
        if isinstance(message, Report):
            self.health.take(sender, message.ticks, message.figures)
        self._obey(self.conductor.receive(sender, message, self.scheduler.now))
        if isinstance(message, Telemetry) and self.conductor.states.get(sender) is NodeState.RUNNING:
            self.health.take(sender, message.tick, message.figures)
        if isinstance(message, Telemetry) and self.conductor.states.get(sender) is NodeState.RUNNING:
            if self._witness is not None:
                self._witness.hear(sender, message)
            for deed in self.assumptions.check(sender, message):
                if isinstance(deed, ShiftCoupling):
                    self.note(f"{deed.coupling} is to change to rung {deed.rung}")
                    self.shifts.append(deed)
                    self._obey(self.conductor.shift(deed.coupling, deed.rung))
                else:
                    self._obey(self.conductor.stop(deed.reason))
            for sentence in self._energy.receive(sender, message):
                self.conductor.note(sentence, self.scheduler.now)

    def _obey(self, instructions: list[Instruction]) -> None:
        for one in instructions:
            match one:
                case Send(node, message):
                    self.note(f"the supervisor tells {node}: {str(message)[:80]}")
                    self._wires.tell(node, encode(message))
                case ReleaseName(name):
                    self._wires.release(name)
                case StartProcess(node):
                    self._start_together(node)
                case KillProcess(node):
                    self.kill(node)
                case Terminate():
                    for process in list(self.processes.values()):
                        process.terminate()
                case Kill():
                    for node in list(self.processes):
                        self.kill(node)
