"""The sampled-data loop of a session in one process: the cores of the nodes without their processes.

The simulation starts from the same bundles and takes the same steps in the same order as the processes. A run of the
processes under the simulated clock therefore has the same numbers, bit for bit.

A list of faults states when a coupling falls silent. The environment then freezes the coupling's ports and sends them
no force, and the devices' hands go on without a force. A coupling that returns starts at rest, as a new process would.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.recorded import Traces, recorded_of
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.recordings.run import RecordedRun
from manyhands.launch.run.directory import kept_files
from manyhands.launch.session import Session
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.device.core import DeviceCore, Guard
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.environment.core import environment_core
from manyhands.nodes.environment.model import ModelFailure
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import SIMULATED, CouplingBundle, DeviceBundle, EnvironmentBundle
from manyhands.nodes.kernel.passivity import Ledger
from manyhands.nodes.link.join import WaveRow
from manyhands.nodes.wave_link.ends import turns, user_face, world_face
from manyhands.nodes.wave_link.faces import UserFace, WorldFace, wave_feedthrough
from manyhands.nodes.wave_link.rows import WorldRows, wave_traces
from manyhands.protocol.clock import Instant, from_seconds

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


@dataclass(eq=False)
class _Run:
    """The signals of one run, and which couplings take part in the tick that it is in.

    Attributes:
        x: of all devices, ticks x m, m.
        f_v: ticks x m, N: within a tick those of the environment first, in the end those that the devices exert.
        reported: the displacements that the devices report to their couplings, m.
        p: of the couplings, m.
        tool: p of the couplings as the environment receives them, m; over a wave link that of the world's face.
        couplings: those that are not silent, each with its ports.
        linked: both faces of the wave links of these, each with its ports.
        at_world: the last row of each world's face, by coupling.
        traces: filled with what each node would report; None for nothing.
        at_user: the last row of each user's face, by coupling.
        through_waves: the force that each user's face exerts, N, by coupling.
        world_rows: the rows of the world's faces, as the environment reports them.
        silent: the couplings that are.
    """

    x: NDArray[np.float64]
    f_v: NDArray[np.float64]
    reported: NDArray[np.float64]
    p: NDArray[np.float64]
    tool: NDArray[np.float64]
    couplings: list[tuple[str, CouplingCore, NDArray[np.intp]]]
    linked: list[tuple[str, UserFace, WorldFace, NDArray[np.intp]]]
    at_world: dict[str, WaveRow]
    traces: Traces | None
    at_user: dict[str, WaveRow] = field(default_factory=dict)
    through_waves: dict[str, Floats] = field(default_factory=dict)
    world_rows: WorldRows = field(default_factory=WorldRows)
    silent: set[str] = field(default_factory=set)


class Simulation:
    """A session's cores, wired directly.

    Attributes:
        devices: the devices' cores by name.
        guards: the guards of the devices' limits, by name.
        couplings: the blocks' cores by name; a coupling that returns from silence has a new core.
        environment: the environment's core; its blocks are ``couplings``, in this order.
        user_faces: the faces of wave links at the couplings, by coupling.
        world_faces: the faces of wave links at the environment, by coupling.
        ledgers: every party's energy ledger by node, a coupling's since it last started; parties without a promised
            level are absent.
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
        session = prepared.session
        self._prepared = prepared
        bundles = cut(prepared, RunPlan(SIMULATED, None, ""))
        index = {port: i for i, port in enumerate(session.ports)}
        T, m = session.period, len(session.ports)
        self._drivers: dict[str, Driver] = {}
        self._device_ports: dict[str, NDArray[np.intp]] = {}
        self._coupling_ports: dict[str, NDArray[np.intp]] = {}
        self._coupling_bundles: dict[str, CouplingBundle] = {}
        self.devices: dict[str, DeviceCore] = {}
        self.guards: dict[str, Guard] = {}
        self.couplings: dict[str, CouplingCore] = {}
        self.user_faces: dict[str, UserFace] = {}
        self.world_faces: dict[str, WorldFace] = {}
        self.ledgers: dict[str, Ledger] = {}
        D_V = np.zeros((m, m))
        environment: EnvironmentBundle | None = None
        for name, bundle in bundles.items():
            ports = np.array([index[port] for port in bundle.common.ports])
            match bundle:
                case DeviceBundle():
                    device = DeviceCore(*bundle.promises[0], T)
                    self._drivers[name] = given[name] if name in given else self._driver(bundle)
                    self._device_ports[name] = ports
                    self.devices[name] = device
                    self.guards[name] = Guard(bundle.limits, T, bundle.common.ports)
                    self.ledgers[name] = device.ledger
                case CouplingBundle():
                    self._coupling_bundles[name], self._coupling_ports[name] = bundle, ports
                    self._start_coupling(name)
                    wave = bundle.wave
                    D_V[np.ix_(ports, ports)] = bundle.block.D if wave is None else wave_feedthrough(wave.b, T)
                case EnvironmentBundle():
                    environment = bundle
        if environment is None:
            raise AssertionError("every session has an environment")
        blocks = tuple(self._coupling_ports.values())
        self.environment = environment_core(environment, D_V, blocks)
        self.world_faces = {name: world_face(environment.common, wave) for name, wave in environment.waves.items()}
        self._turns = {name: turns(wave) for name, wave in environment.waves.items()}  # of the world, and of the user
        if self.environment.ledger is not None:
            self.ledgers[ENVIRONMENT] = self.environment.ledger

    def _driver(self, bundle: DeviceBundle) -> Driver:
        try:
            return driver_of(bundle)
        except ValueError:
            self.close()  # those that were made before it
            raise

    def close(self) -> None:
        """Close the drivers; call this where a driver is of another package."""
        for driver in self._drivers.values():
            driver.close()

    def _start_coupling(self, name: str) -> None:
        """Start a coupling at rest, with a new core and ledger."""
        bundle = self._coupling_bundles[name]
        coupling = CouplingCore(bundle.block, bundle.K, bundle.level, bundle.common.period, bundle.limits.force)
        self.couplings[name] = coupling
        if bundle.wave is not None:
            came_back = name in self.user_faces
            self.user_faces[name] = user_face(bundle.common, bundle.wave, bundle.block.D)
            if came_back:
                self.user_faces[name].tank.level = 0.0
                self.world_faces[name].renew(0)
        if coupling.ledger is not None:
            self.ledgers[name] = coupling.ledger

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
        m, period = len(session.ports), from_seconds(session.period)
        run = _Run(
            x=np.zeros((ticks, m)),
            f_v=np.zeros((ticks, m)),
            reported=np.zeros(m),
            p=np.zeros(m),
            tool=np.zeros(m),
            couplings=self._active(()),
            linked=self._linked(()),
            at_world={name: _world_row(world) for name, world in self.world_faces.items()},
            traces=traces,
        )
        for k in range(ticks):
            now, due = Instant(k * period), Instant((k + 1) * period)
            if k in begins or k in ends:
                self._silence(run, begins.get(k, ()), ends.get(k, ()))
            self._sample(run, k, now)
            self._to_the_world(run)
            self._react(run, k)
            self._from_the_world(run, k)
            self._hand_on(run, k)
            self._exert(run, k, now, due)
            if progress is not None and (k + 1) % _PROGRESS_TICKS == 0:
                progress(k + 1)
        return Recording(session.name, self._prepared.id, session.period, session.ports, run.x, run.f_v)

    def _silence(self, run: _Run, begins: Sequence[str], ends: Sequence[str]) -> None:
        """Couplings come back at rest, and others fall silent."""
        blocks = {name: block for block, name in enumerate(self.couplings)}
        for name in ends:
            run.silent.discard(name)
            self._start_coupling(name)
            self.environment.clutches.engage(blocks[name])
        for name in begins:
            run.silent.add(name)
            self.environment.clutches.freeze(blocks[name])
            if name in run.at_world:
                nothing = [0.0] * len(self._coupling_ports[name])
                row = run.at_world[name]
                run.at_world[name] = WaveRow(nothing, row.tank, self.world_faces[name].x, nothing)
        run.couplings, run.linked = self._active(run.silent), self._linked(run.silent)

    def _sample(self, run: _Run, k: int, now: Instant) -> None:
        """The devices are sampled, and the couplings answer by p."""
        for name, driver in self._drivers.items():
            ports, displacement = self._device_ports[name], list(map(float, driver.sample(k, now)))
            self.devices[name].sample(displacement)
            run.x[k, ports] = displacement
            run.reported[ports] = self.guards[name].report(displacement)
        for _, coupling, ports in run.couplings:
            run.p[ports] = run.tool[ports] = coupling.free_position(run.reported[ports].tolist())

    def _to_the_world(self, run: _Run) -> None:
        """The users' faces of wave links answer their couplings, and send waves."""
        for name, user, world, ports in run.linked:
            run.through_waves[name] = user.step(run.p[ports].tolist())
            if self._turns[name][1].sends(user.n):
                wave = user.message()
                world.hear(wave.n, wave.U, wave.G)
            run.tool[ports] = world.tool()

    def _react(self, run: _Run, k: int) -> None:
        """The environment answers by its forces.

        Raises:
            ModelFailure: its model gave no usable forces.
        """
        environment = self.environment
        run.f_v[k] = environment.react(run.tool.tolist())
        if environment.failure is not None:
            raise ModelFailure(environment.failure)
        environment.settle()
        if run.traces is not None:
            run.traces.keep(ENVIRONMENT, k, environment.tools, environment.masses)

    def _from_the_world(self, run: _Run, k: int) -> None:
        """The world's faces of wave links take in the forces, and send waves; the couplings feel their users' faces."""
        for name, user, world, ports in run.linked:
            world.step(run.f_v[k, ports].tolist())
            run.at_user[name] = WaveRow(user.wave, user.tank.row())
            run.at_world[name] = _world_row(world)
            if self._turns[name][0].sends(world.n):
                wave = world.message()
                user.hear(wave.n, wave.U, wave.G)
            run.f_v[k, ports] = run.through_waves[name]
        if run.traces is not None and run.at_world:
            run.world_rows.add([*run.at_world.values()])
            run.traces.keep_waves(ENVIRONMENT, k, run.world_rows.take())

    def _hand_on(self, run: _Run, k: int) -> None:
        """The couplings limit the forces, absorb them and hand them on."""
        for name, coupling, ports in run.couplings:
            run.f_v[k, ports] = applied = coupling.limited(run.f_v[k, ports].tolist())
            coupling.absorb(applied)
            if run.traces is not None:
                run.traces.keep(name, k, run.p[ports].tolist(), applied)
                if name in run.at_user:
                    run.traces.keep_waves(name, k, wave_traces([run.at_user[name]]))

    def _exert(self, run: _Run, k: int, now: Instant, due: Instant) -> None:
        """The devices exert the forces within their limits, until the next tick is due."""
        for name, driver in self._drivers.items():
            ports = self._device_ports[name]
            run.f_v[k, ports] = force = self.guards[name].clip(run.f_v[k, ports].tolist())
            driver.apply(force, now)
            driver.idle(due)
            self.devices[name].apply(force, driver.intended_work())
            if run.traces is not None:
                run.traces.keep(name, k, run.x[k, ports].tolist(), force)

    def _active(self, silent: Collection[str]) -> list[tuple[str, CouplingCore, NDArray[np.intp]]]:
        """The couplings that are not silent, with their ports."""
        return [(name, core, self._coupling_ports[name]) for name, core in self.couplings.items() if name not in silent]

    def _linked(self, silent: Collection[str]) -> list[tuple[str, UserFace, WorldFace, NDArray[np.intp]]]:
        """Both faces of each wave link whose coupling is not silent, with its ports."""
        return [
            (name, user, self.world_faces[name], self._coupling_ports[name])
            for name, user in self.user_faces.items()
            if name not in silent
        ]


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
    return RecordedRun(recorded_of(prepared, SIMULATED), kept, attachments=kept_files(prepared))


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


def _world_row(world: WorldFace) -> WaveRow:
    return WaveRow(world.wave, world.tank.row(), *world.signals)


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
