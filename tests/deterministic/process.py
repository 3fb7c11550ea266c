"""One process of a session: the product's own life of a process, on a thread and over virtual wires."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.environment.core import Core
from manyhands.nodes.environment.node import EnvironmentNode, EnvironmentTelemetry
from manyhands.nodes.kernel.bundle import SIMULATED, Bundle, Common, CouplingBundle, DeviceBundle, EnvironmentBundle
from manyhands.nodes.kernel.lifetime import Sight, Stopped
from manyhands.nodes.kernel.log import Log, LogEvent, Value
from manyhands.nodes.link.join import WaveRow
from manyhands.nodes.link.peer_link import PeerLink
from manyhands.nodes.link.process import HostedNode, Node, run_members
from manyhands.nodes.link.supervisor_line import ControlLine
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Telemetry
from manyhands.protocol.transport import Link

from .guests import Guest, GuestLink
from .scheduler import Scheduler, Turn, VirtualClock
from .wires import ProcessTransport, WireLink, Wires

Note = Callable[[str], None]


class VirtualLife:
    """A :class:`manyhands.nodes.kernel.lifetime.Life` that only the world's signals reach."""

    def __init__(self) -> None:
        self.stopping = self.leaving = self.orphaned = False
        self.failure: str | None = None
        self.watch: Callable[[], Sight] = lambda: Sight.PRESENT
        self.starting = True

    def look(self, _now: Instant) -> None:
        """The supervisor is there."""

    def check(self) -> None:
        """The supervisor is there."""

    def fail(self, text: str) -> None:
        """End at the next tick."""
        self.stopping, self.failure = True, self.failure or text

    def enter_loop(self) -> None:
        """From now on a request to end is only noted."""
        self.starting = False
        if self.stopping:
            raise Stopped

    def leave_loop(self) -> None:
        """The ticks are over."""


class NotedLog(Log):
    """A log whose events go into the world's account of what happened."""

    def __init__(self, name: str, clock: VirtualClock, note: Note) -> None:
        super().__init__(None, "s", name, clock)
        self._name, self._note = name, note

    def note(self, event: LogEvent, **data: Value) -> None:
        """Tell of what happens in the loop; how it began is the world's own to tell."""
        if event in (
            LogEvent.FROZEN,
            LogEvent.RETURNED,
            LogEvent.LOST,
            LogEvent.JUMPED,
            LogEvent.STALE,
            LogEvent.BREACH,
            LogEvent.FAULT,
        ):
            self._note(f"{self._name}: {event.value} {' '.join(f'{key}={value}' for key, value in data.items())}")


class SimulatedLine(ControlLine):
    """A line to the supervisor that reports a process id of its own."""

    pid = 0
    silent = False

    def publish(self, telemetry: Telemetry) -> None:
        """Send telemetry, unless this is a guest that sends none."""
        if not self.silent:
            super().publish(telemetry)

    def hello(self, endpoints: Mapping[str, str], pid: int) -> None:
        """Introduce the process that this is taken for."""
        super().hello(endpoints, self.pid)


class LimitedDriver:
    """A driver that holds every force against its limits."""

    def __init__(self, driver: Driver, name: str, limits: Sequence[float], violate: Note) -> None:
        self._driver, self._name, self._limits, self._violate = driver, name, limits, violate
        self.axes = driver.axes
        self.sample, self.release, self.idle = driver.sample, driver.release, driver.idle
        self.intended_work, self.figures, self.close = driver.intended_work, driver.figures, driver.close

    def work(self) -> float | None:
        """That of the motors, where the driver knows it."""
        return self._driver.work()

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float]:
        """Exert ``f``."""
        for force, most in zip(f, self._limits, strict=True):
            if not abs(force) <= most * (1.0 + 1e-9):
                self._violate(f"{self._name}: found a force of {force:g} N; expected at most {most:g} N")
        return self._driver.apply(f, at, until)


class Witness(Protocol):
    """An observer of all events in a session."""

    def hear(self, sender: str, telemetry: Telemetry) -> None:
        """The supervisor has heard telemetry of a node that runs."""
        ...

    def settle(self, tick: int, f: Sequence[float], tools: Sequence[float], node: EnvironmentNode) -> None:
        """The environment has settled a tick: the forces f_e (N) and the tools x_e (m) at its ports."""
        ...


class WitnessedAccount(EnvironmentTelemetry):
    """An environment's account whose every tick is seen."""

    def __init__(self, common: Common, witness: Witness, node: EnvironmentNode) -> None:
        super().__init__(common)
        self._witness, self._node = witness, node

    def tick(self, tick: int, core: Core, waves: Sequence[WaveRow] = ()) -> None:
        """``core`` has settled ``tick``."""
        super().tick(tick, core, waves)
        self._witness.settle(tick, core._f, core.tools, self._node)  # type: ignore[union-attr]


class SimulatedProcess:
    """One process.

    Attributes:
        name: the node's.
        pid: no other process of the session has had it.
        node: None until it has started.
        life: what it is asked to do.
        turn: its thread.
        held: until when it is stopped.
        dead: whether it was killed.
    """

    def __init__(
        self,
        bundle: Bundle,
        pid: int,
        wires: Wires,
        note: Note,
        violate: Note,
        moved: Callable[[str, Driver, VirtualClock], Driver],
        guest: Guest | None = None,
        witness: Witness | None = None,
        led: Callable[[Link, Scheduler], Link] | None = None,
        carried: Sequence[CouplingBundle] = (),
    ) -> None:
        """A process of this bundle; nothing of it runs yet.

        Args:
            bundle: the node's.
            pid: no other process of the session has had it.
            wires: what it is linked by.
            note: called with each event.
            violate: called with each violation.
            moved: makes another driver of a device's own, by its name.
            guest: the guest that leads it; None for an honest process.
            witness: looks at every tick of the environment.
            led: what a hostile node makes of each of its links to a peer; None for an honest one.
            carried: the couplings that run in this process, which is a device's.
        """
        self._lead = led
        self._witness = witness
        self.name, self.pid, self._moved, self._guest = bundle.common.name, pid, moved, guest
        self.life, self.code = VirtualLife(), 0
        self.node: DeviceNode | CouplingNode | EnvironmentNode | None = None
        self._bundle, self._note, self._violate = bundle, note, violate
        self._scheduler: Scheduler = wires.scheduler
        self._wires = wires
        self._transports = [
            ProcessTransport(wires, f"{common.name}.{pid}", self._led)
            for common in (bundle.common, *(one.common for one in carried))
        ]
        self._carried = carried
        self.held, self.dead = Instant(0), False
        self.turn: Turn | None = None

    def run(self) -> None:
        """The whole life, in the process's thread."""
        clock = VirtualClock(self._scheduler)
        inside = [CouplingNode(bundle, clock) for bundle in self._carried]
        self.node = node = self._made(clock, inside)
        nodes: list[tuple[Common, Node]] = [(self._bundle.common, node)]
        nodes += [(bundle.common, coupling) for bundle, coupling in zip(self._carried, inside, strict=True)]
        members = [self._member(*one, transport, clock) for one, transport in zip(nodes, self._transports, strict=True)]
        self.code = run_members(members, self.life, remote=False)  # type: ignore[arg-type]
        for transport in self._transports:
            transport.close()

    def _member(self, common: Common, node: Node, transport: ProcessTransport, clock: VirtualClock) -> HostedNode:
        line = SimulatedLine(transport, common, NotedLog(common.name, clock, self._note))
        line.pid = self.pid
        line.silent = self._guest is not None and not self._guest.strategy.telemetry
        # nothing is asked of this machine's kernel
        return HostedNode(replace(common, clock=SIMULATED), node, transport, line)

    def terminate(self) -> None:
        """SIGTERM."""
        self.life.stopping = True
        if self.life.starting and self.turn is not None:
            self._scheduler.raise_in(self.turn, Stopped())

    def die(self, chance: float) -> None:
        """Its sockets are closed by the kernel; of what it sent last every frame is lost by this ``chance``."""
        self.dead = True
        for transport in self._transports:
            transport.die(chance)

    @property
    def joins(self) -> Sequence[PeerLink]:
        """Its links, once it has shaken hands."""
        return [] if self.node is None else self.node.joins

    def _led(self, link: WireLink) -> Link:
        """A link to a peer, under the guest's control if a guest leads the process."""
        if self._lead is not None:
            return self._lead(link, self._scheduler)
        if self._guest is None:
            return link
        return GuestLink(link, self._guest, self._scheduler, self._bundle.common.period)

    def _made(self, clock: VirtualClock, inside: Sequence[CouplingNode]) -> DeviceNode | CouplingNode | EnvironmentNode:
        """The node, which reads the virtual time in place of the real one; the ticks of ``inside`` run in its loop."""
        node: DeviceNode | CouplingNode | EnvironmentNode
        match self._bundle:
            case DeviceBundle() as bundle:
                limits = [float("inf") if most is None else most for most in bundle.limits.force]
                own = self._moved(self.name, driver_of(bundle), clock)
                # a driver of another package is held to its word by the node, which has to know it for one
                plugin = isinstance(own, PluginDriver)
                driver: Driver = own if plugin else LimitedDriver(own, self.name, limits, self._violate)
                node = DeviceNode(bundle, driver, clock, inside)
                if self._guest is not None:
                    self._guest.lead(node, bundle, self._scheduler)
            case CouplingBundle() as bundle:
                node = CouplingNode(bundle, clock)
            case EnvironmentBundle() as bundle:
                node = EnvironmentNode(bundle, clock)
                if self._witness is not None:
                    node._account = WitnessedAccount(bundle.common, self._witness, node)
        return node
