"""The sampled-data loop of a session in one process: the parties of the nodes, joined without processes.

The simulation starts from the same bundles, and its parties take the same steps in the same order as in the processes.
A run of the processes under the simulated clock therefore has the same numbers, bit for bit.

A list of faults states when a coupling falls silent. The environment then freezes the coupling's ports and sends them
no force, and the devices' hands go on without a force. A coupling that returns starts at rest, as a new process would.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.axis import AxisKind
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.recorded import Traces, recorded_of
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.recordings.run import RecordedRun
from manyhands.launch.run.directory import kept_files
from manyhands.launch.session import Session
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.coupling.port import CouplingPort
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.device.tick import DeviceTick, tick_of
from manyhands.nodes.environment.core import environment_core, respond, row_of
from manyhands.nodes.environment.model import ModelFailure
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import SIMULATED, CouplingBundle, DeviceBundle, EnvironmentBundle
from manyhands.nodes.kernel.buttons import Buttons
from manyhands.nodes.kernel.orientation import NO_RIDER, RIDER
from manyhands.nodes.kernel.passivity import Ledger
from manyhands.nodes.kernel.simulated_way import WavesUnderWay
from manyhands.nodes.link.join import WaveRow
from manyhands.nodes.rows.tick_events import TickEvents
from manyhands.nodes.rows.two_port import TwoPort
from manyhands.nodes.wave_link.ends import turns, user_face, world_face
from manyhands.nodes.wave_link.faces import UserFace, WorldFace, wave_feedthrough
from manyhands.nodes.wave_link.felt import FeltLink, stiffness_and_mass
from manyhands.nodes.wave_link.rows import user_row, world_row
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.messages import Figures

Array = NDArray[np.float64]

_PROGRESS_TICKS = 1000


@dataclass(frozen=True)
class Silence:
    """A coupling that sends nothing for some ticks.

    Attributes:
        coupling: the coupling's name.
        begin: the first tick at which it is frozen.
        end: the tick at which it is back, at rest, and engaged; None for never.

    Example:
        >>> import manyhands as mh
        >>> run = mh.simulate("example1", 1.0, silences=[mh.Silence("cx", begin=200, end=600)])
        >>> float(abs(run.f_v[200:600, 0]).max()), float(abs(run.f_v[600:, 0]).max().round(2))     # N
        (0.0, 0.24)
    """

    coupling: str
    begin: int
    end: int | None = None


class LinkInside:
    """A wave link within one process, as a :class:`manyhands.nodes.rows.two_port.TwoPort` between both its ends.

    A wave leaves and arrives in its tick, and the play-out alone delays it, unless the session states a network.

    Attributes:
        user: the face at the coupling.
        world: the face at the environment.
        at_user: the row of the user's end in the last tick.
        at_world: that of the world's end.
    """

    def __init__(self, coupling: CouplingBundle, environment: EnvironmentBundle) -> None:
        """Begin the first life of the wave link of ``coupling``."""
        self._coupling, self._end = coupling, environment.waves[coupling.common.name]
        self._world_sends, self._user_sends = turns(self._end)
        self.world = world_face(environment.common, self._end)
        self._period, self._silences = environment.common.period, 0
        self._start()
        self.at_world = WaveRow(self.world.wave, self.world.tank.row(), *self.world.signals)

    def _start(self) -> None:
        wave = self._coupling.wave
        if wave is None:
            raise AssertionError("the world has an end of each wave link, and so has its coupling")
        self.user = user_face(self._coupling.common, wave, self._coupling.block.D)
        self._down, self._up = (
            None if of.way is None else WavesUnderWay(of.way, of.peer_period) for of in (wave, self._end)
        )
        self.at_user = WaveRow(self.user.wave, self.user.tank.row())
        self._f: Floats = []
        self._holding = (True, True)  # a face hears nothing before its first wave

    def up(self, p: Floats) -> Floats:
        """The user's face answers, and sends a wave; returns the tool's position at the world's face, m."""
        user, world = self.user, self.world
        self._f = user.step(p)
        self.at_user = WaveRow(user.wave, user.tank.row())
        if self._user_sends.sends(user.n):
            _carry(user, world, self._up)
        _arrive(self._up, world, (world.n + 1) * self._period)
        return world.tool()

    def down(self, f: Floats) -> Floats:
        """The world's face takes in the force, and sends a wave; returns the force at the user's face, N."""
        user, world = self.user, self.world
        world.step(f)
        self.at_world = WaveRow(world.wave, world.tank.row(), *world.signals)
        if self._world_sends.sends(world.n):
            _carry(world, user, self._down)
        _arrive(self._down, user, user.n * self._period)
        holding = (user.holding, world.holding)
        self._silences += sum(now and not before for now, before in zip(holding, self._holding, strict=True))
        self._holding = holding
        return self._f

    def felt(self, impedance: tuple[float, float], kinds: tuple[AxisKind, ...] = ()) -> FeltLink:
        """What is felt of it now.

        Args:
            impedance: the least and the greatest eigenvalue of b, N·s/m.
            kinds: what its ports do.
        """
        ends = self.user, self.world
        R = sum(end.lag for end in ends)
        return FeltLink(
            R, *stiffness_and_mass(impedance, R), (self.user.tank.level, self.world.tank.level),
            limited=sum(end.tank.clipped for end in ends), silences=self._silences, holding=any(self._holding),
            kinds=kinds,
        )  # fmt: skip

    def book(self) -> None:
        """Nothing is left to do."""

    def fall_silent(self) -> None:
        """The user is gone: the world's end stays where it is."""
        nothing = [0.0] * len(self.world.x)
        self.at_world = WaveRow(nothing, self.at_world.tank, self.world.x, nothing)

    def come_back(self) -> None:
        """The user's end begins anew, with an empty tank, and the world's a new life."""
        self._start()
        self.user.tank.level = 0.0
        self.world.renew(0)


def _by_hand(hands: Sequence[str], riders: Sequence[float]) -> dict[str, Sequence[float]]:
    """What rides of each of these devices; nothing rides where there are no ``riders``."""
    if not riders:
        return dict.fromkeys(hands, NO_RIDER)
    return {hand: riders[RIDER * i : RIDER * (i + 1)] for i, hand in enumerate(hands)}


def _carry(sender: UserFace | WorldFace, hearer: UserFace | WorldFace, way: WavesUnderWay | None) -> None:
    """Send a wave: it arrives at once, or goes under way."""
    wave = sender.message()
    if way is None:
        hearer.hear(wave.n, wave.U, wave.G, buttons=wave.buttons, riders=wave.riders)
    else:
        way.send((wave.n, [*wave.U], wave.G, 0, wave.buttons, wave.riders))


def _arrive(way: WavesUnderWay | None, hearer: UserFace | WorldFace, by: float) -> None:
    """Hear what has come by a time, s."""
    for wave in () if way is None else way.arrived(by):
        hearer.hear(*wave)


class Simulation:
    """A session's parties, wired directly.

    Attributes:
        devices: the devices by name.
        couplings: the couplings by name; one that returns from silence is a new one.
        links: the wave links, by coupling.
        buttons: all of the session, as the environment knows them.
        events: by node with buttons, what it would record of them.
        environment: the environment's core; its blocks are ``couplings``, in this order.
    """

    def __init__(self, prepared: Prepared, drivers: Mapping[str, Driver] | None = None) -> None:
        """Everything at rest at tick 0.

        Args:
            prepared: the session with its coupling and certificate.
            drivers: for some devices, the driver to use in place of the session's.

        Raises:
            FactoryError: a driver or a model of another package cannot be made.
        """
        given = {} if drivers is None else drivers
        self._prepared, self._period = prepared, from_seconds(prepared.session.period)
        bundles = cut(prepared, RunPlan(SIMULATED, None, ""))
        world = bundles[ENVIRONMENT]
        if not isinstance(world, EnvironmentBundle):
            raise AssertionError("every session has an environment")
        index = {port: i for i, port in enumerate(prepared.session.ports)}
        self.buttons = Buttons(world.common.buttons, world.common.period)
        self.events = {name: TickEvents() for name, of in bundles.items() if of.common.buttons}
        self._hands = world.common.riding
        self._riding = {name: of.common.riding for name, of in bundles.items()}
        self._buttons_of = {name: of.common.buttons for name, of in bundles.items() if name != ENVIRONMENT}
        self._ports = {name: np.array([index[port] for port in of.common.ports]) for name, of in bundles.items()}
        self._bundles: dict[str, CouplingBundle] = {}
        self.devices: dict[str, DeviceTick] = {}
        self.couplings: dict[str, CouplingPort] = {}
        self.links: dict[str, LinkInside] = {}
        D_V = np.zeros((len(index), len(index)))
        for name, bundle in bundles.items():
            if isinstance(bundle, DeviceBundle):
                self.devices[name] = tick_of(bundle, given[name] if name in given else self._driver(bundle))
            elif isinstance(bundle, CouplingBundle):
                self._bundles[name], self.couplings[name] = bundle, CouplingPort(bundle)
                if bundle.wave is not None:
                    self.links[name] = LinkInside(bundle, world)
                wave, own = bundle.wave, np.ix_(self._ports[name], self._ports[name])
                D_V[own] = bundle.block.D if wave is None else wave_feedthrough(wave.b, world.common.period)
        self.environment = environment_core(world, D_V, tuple(self._ports[name] for name in self.couplings))

    def _driver(self, bundle: DeviceBundle) -> Driver:
        try:
            return driver_of(bundle)
        except ValueError:
            self.close()  # those that were made before it
            raise

    def close(self) -> None:
        """Close the drivers; call this where a driver is of another package."""
        for device in self.devices.values():
            device.driver.close()

    @property
    def ledgers(self) -> dict[str, Ledger]:
        """Every party's energy ledger by node, a coupling's since it last started; without those that keep none."""
        all_ = {**self.devices, **self.couplings, ENVIRONMENT: self.environment}
        return {name: ledger for name, party in all_.items() if (ledger := party.ledger) is not None}

    def traces(self, ticks: int) -> Traces:
        """Empty traces for what all nodes report in a run of ``ticks`` ticks; pass them to :meth:`run`."""
        return Traces(self._prepared, self.ledgers, ticks)

    def run(
        self,
        ticks: int,
        progress: Callable[[int], None] | None = None,
        faults: Sequence[Silence] = (),
        traces: Traces | None = None,
    ) -> Recording:
        """Run ``ticks`` ticks.

        Args:
            ticks: number of ticks.
            progress: called every 1000 ticks with the number of ticks that are done.
            faults: which couplings fall silent, and when; ticks count from the beginning of this run.
            traces: filled with what each node would report of its ticks.

        Returns:
            x and f_v of every port at every tick.

        Raises:
            ModelFailure: the environment's model gave no usable forces, which would also end its process.
            ValueError: a fault names no coupling, ends before it begins, or overlaps another of the same coupling.
        """
        begins, ends = _by_tick(faults, tuple(self.couplings))
        session = self._prepared.session
        m = len(session.ports)
        x, f_v, tool = np.zeros((ticks, m)), np.zeros((ticks, m)), np.zeros(m)
        ways = {name: self._way(name) for name in self.couplings}  # of those that are not silent
        for k in range(ticks):
            for name in ends.get(k, ()):
                ways[name] = self._come_back(name)
            for name in begins.get(k, ()):
                del ways[name]
                self._fall_silent(name)
            x[k], f_v[k] = self._tick(k, ways, tool)
            if traces is not None:
                self._keep(traces, k, ways)
            if progress is not None and (k + 1) % _PROGRESS_TICKS == 0:
                progress(k + 1)
        return Recording(
            session.name, self._prepared.id, session.period, session.ports, x, f_v, turning=session.turning
        )

    def _tick(self, k: int, ways: Mapping[str, Sequence[TwoPort]], tool: Array) -> tuple[Array, Array]:
        """Motion goes up, the environment answers, and force comes down.

        Args:
            k: the tick.
            ways: the two-ports from the devices to the world, through each coupling that is not silent.
            tool: p of the couplings as the environment receives it, m; changed in place.

        Returns:
            The displacements of the devices, m, and the forces that they exert, N.

        Raises:
            ModelFailure: the environment's model gave no usable forces.
        """
        now, due = Instant(k * self._period), Instant((k + 1) * self._period)
        ports, environment = self._ports, self.environment
        x, sent = np.empty_like(tool), np.empty_like(tool)
        for name, device in self.devices.items():
            sent[ports[name]], x[ports[name]] = device.sample(k, now), device.x
            if device.changed:
                self._note(name, k, device.buttons, device.changed)
        for name, way in ways.items():
            if name in self.links:
                self.links[name].user.buttons = self._pressed(name)
                self.links[name].user.riders = tuple(n for of in self._riding[name] for n in self.devices[of].rides)
            p: Floats = sent[ports[name]].tolist()
            for port in way:
                p = port.up(p)
            tool[ports[name]] = p
        if self.buttons.names:
            self._press(k, ways)
        f, came = self._respond(k, tool, ways)
        if environment.failure is not None:
            raise ModelFailure(environment.failure)
        environment.settle()
        for name, way in ways.items():
            force: Floats = f[ports[name]].tolist()
            if name in self.links:
                self.links[name].world.riders = tuple(n for of in self._riding[name] for n in came[of])
            for port in reversed(way):
                force = port.down(force)
                port.book()
            f[ports[name]] = force
            if name in self.links:
                came |= _by_hand(self._riding[name], self.links[name].user.rides)
        for name, device in self.devices.items():
            f[ports[name]] = device.exert(f[ports[name]].tolist(), now, came=came.get(name, NO_RIDER))
            device.book()
            device.driver.idle(due)
        return x, f

    def _respond(self, k: int, tool: Array, ways: Iterable[str]) -> tuple[Array, dict[str, Sequence[float]]]:
        """The forces of the environment, N, and by device what it says with them for its orientation."""
        heard: dict[str, Sequence[float]] = {}
        for way in ways:
            if way in self.links:
                heard |= _by_hand(self._riding[way], self.links[way].world.rides)
            else:
                heard |= {name: self.devices[name].rides for name in self._riding[way]}
        riders = [n for name in self._hands for n in heard.get(name, NO_RIDER)]
        answer = respond(self.environment, tool.tolist() + riders, k)
        m = len(tool)
        told = [answer[at : at + RIDER] for at in range(m, len(answer), RIDER)]
        return np.array(answer[:m]), {name: own for name, own in zip(self._hands, told, strict=True) if name in heard}

    def _pressed(self, name: str) -> int:
        """The buttons that are held down of the devices of a coupling, among all, or of one device."""
        return sum(
            1 << self.buttons.names.index(button)
            for device in self.devices.values()
            for i, button in enumerate(device.buttons.names)
            if button in self._buttons_of[name] and device.buttons.state >> i & 1
        )

    def _press(self, k: int, ways: Iterable[str]) -> None:
        """The environment learns which buttons are held down behind the couplings that are not silent."""
        pressed = 0
        for name in ways:
            pressed |= self.links[name].world.pressed if name in self.links else self._pressed(name)
        if changed := self.buttons.take(k, pressed):
            self._note(ENVIRONMENT, k, self.buttons, changed)
            self.environment.press(self.buttons.state)

    def _note(self, node: str, k: int, buttons: Buttons, changed: int) -> None:
        """Keep what a node would record of its buttons in the tick."""
        for button, held_down in buttons.changes(changed):
            self.events[node].press(k, button, held_down)

    def _keep(self, traces: Traces, k: int, couplings: Iterable[str]) -> None:
        """Keep what each node would report of the tick; of the couplings these alone."""
        ends = [link.at_world for link in self.links.values()]
        traces.keep(ENVIRONMENT, k, (*row_of(self.environment), *world_row(ends)))
        for name, device in self.devices.items():
            traces.keep(name, k, device.row())
        for name in couplings:
            end = self.links[name].at_user if name in self.links else None
            traces.keep(name, k, (*self.couplings[name].row(), *user_row(end)))

    def _way(self, name: str) -> tuple[TwoPort, ...]:
        """The two-ports of a coupling, from its devices to the world."""
        coupling = self.couplings[name]
        return (coupling, self.links[name]) if name in self.links else (coupling,)

    def _come_back(self, name: str) -> tuple[TwoPort, ...]:
        """Begin a coupling anew, at rest; returns its two-ports."""
        self.environment.clutches.engage([*self.couplings].index(name))
        self.couplings[name] = CouplingPort(self._bundles[name])
        if name in self.links:
            self.links[name].come_back()
        return self._way(name)

    def _fall_silent(self, name: str) -> None:
        """A coupling sends nothing from now on."""
        self.environment.clutches.freeze([*self.couplings].index(name))
        if name in self.links:
            self.links[name].fall_silent()


def simulate(
    prepared: Prepared,
    ticks: int,
    silences: Sequence[Silence] = (),
    progress: Callable[[int], None] | None = None,
) -> RecordedRun:
    """Simulate a session from rest, and keep what a recording of its processes under the simulated clock would hold.

    Args:
        prepared: the session with its coupling and certificate.
        ticks: number of ticks.
        silences: which couplings fall silent, and when.
        progress: called every 1000 ticks with the number of ticks that are done.

    Raises:
        ModelFailure: the environment's model gave no usable forces.
        ValueError: a silence makes no sense, or a site has a period of its own.
    """
    require_one_period(prepared.session)
    simulation = Simulation(prepared)
    traces = simulation.traces(ticks)
    simulation.run(ticks, progress, silences, traces)
    kept = {(node, one.topic.name): one for node, own in traces.by_node.items() for one in own}
    figures = {node: [(ticks, Figures(events.take(0, ticks)))] for node, events in simulation.events.items()}
    return RecordedRun(recorded_of(prepared, SIMULATED), kept, figures, attachments=kept_files(prepared))


def require_one_period(session: Session) -> None:
    """Refuse a session with a site of another period, which one loop in one process cannot run.

    Raises:
        ValueError: a wave link has a period of its own.
    """
    for name in session.wave_links:
        if session.period_of(name) != session.period:
            raise ValueError(
                f"couplings.{name}.wave_link.period: found {session.period_of(name):g} s; expected the session's "
                f"{session.period:g} s for a simulation in one process; launch --clock simulated runs it as it is"
            )


def _by_tick(
    faults: Sequence[Silence], couplings: tuple[str, ...]
) -> tuple[dict[int, list[str]], dict[int, list[str]]]:
    """The couplings that fall silent and those that return, by tick.

    Raises:
        ValueError: see :meth:`Simulation.run`.
    """
    begins: dict[int, list[str]] = {}
    ends: dict[int, list[str]] = {}
    for fault in faults:
        if fault.coupling not in couplings:
            raise ValueError(f"found a silence of {fault.coupling!r}; expected one of {', '.join(couplings)}")
        if fault.begin < 0 or (fault.end is not None and fault.end <= fault.begin):
            raise ValueError(
                f"found a silence of {fault.coupling} from tick {fault.begin} to {fault.end}; expected it to begin at "
                "0 or later, and to end after that"
            )
        begins.setdefault(fault.begin, []).append(fault.coupling)
        if fault.end is not None:
            ends.setdefault(fault.end, []).append(fault.coupling)
    for before, after in pairwise(sorted(faults, key=lambda fault: (fault.coupling, fault.begin))):
        if before.coupling == after.coupling and (before.end is None or after.begin <= before.end):
            raise ValueError(
                f"found silences of {before.coupling} from tick {before.begin} and from {after.begin}; expected the "
                "first to end before the second begins"
            )
    return begins, ends
