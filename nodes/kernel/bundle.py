"""The bundle that one node is started with: its own part of the session, and nothing of the others'.

A bundle is one JSON file. The launcher writes it from the session and its certificate, and only its node may read it.
A device's bundle holds no block of V, and a coupling's only its own block. The environment's bundle holds none: D_V of
rung 0 comes with the handshakes, and the bundle has only the D_V of the ladder's further rungs.

A bundle names the node, its peers and its limits (:class:`Common`, :class:`Peer`, :class:`Limits`), and the rungs of
the ladder. A device's bundle also has the source of its motion (:data:`Source`): a simulated hand, a recorded motion,
a person who feels no force, or the driver of another package. A field is declared once, with its annotation: the form
that it has in the file, and what is refused there, follow from it (:mod:`manyhands.protocol.plain`).
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, TypeAlias, TypeVar

import numpy as np

from manyhands.design.files import open_new, read_regular
from manyhands.design.levels.contract import DeviceShare
from manyhands.design.levels.dry_friction import DryFriction
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.levels.mechanism import promised_level
from manyhands.design.models.axis import AxisKind, kinds_of
from manyhands.design.models.coupling import loop_gain
from manyhands.design.models.scene import ContactScene, scene_of
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.buttons import Script
from manyhands.nodes.kernel.driver_statement import NO_DELAY, DeviceTiming
from manyhands.nodes.kernel.energy_budget import EnergyBudget
from manyhands.nodes.kernel.factory import FactoryName
from manyhands.nodes.kernel.friction_curve import FRICTION_FORM, FrictionCurve
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.nodes.kernel.orientation import RIDER
from manyhands.nodes.kernel.simulated_way import SimulatedWay
from manyhands.nodes.kernel.site_bounds import SiteBounds
from manyhands.protocol.clock import from_seconds
from manyhands.protocol.limits import MAX_BUTTONS
from manyhands.protocol.messages import Role, Start
from manyhands.protocol.plain import Added, PlainForm, Requirement, Unfit, by_kind, read, written

MOST_RUNGS = 8
"""The most rungs of a ladder besides rung 0, as many as a session file may state."""

MAX_FILE_BYTES = 256 * 2**20

SIMULATED = "simulated"
REALTIME = "realtime"
CLOCKS = (REALTIME, SIMULATED)

WALL = "wall"
"""The time of a device that goes on by the wall clock, as a real device does."""

OWN = "own"
"""The time of a device that goes on by one period from sample to sample, however long that took."""

TIMES = (WALL, OWN)

TELEMETRY_PERIOD = 0.1
"""The usual time between two telemetry messages, s: ten a second, the rate in the channel table."""

MAX_TELEMETRY_TICKS = 1000
"""The most ticks between two telemetry messages: a node keeps the traces of all of them."""

_TIME: Final = Requirement(lambda t: 0.0 <= t < 1e9, "0 s to 1e9 s")
_SPAN: Final = Requirement(lambda t: 0.0 < t < 1e9, "more than 0, and less than 1e9")
_TICKS: Final = Requirement(lambda ticks: 0 < ticks <= MAX_TELEMETRY_TICKS, f"1 to {MAX_TELEMETRY_TICKS}")
_PART: Final = Requirement(lambda part: 0.0 <= part < 1.0, "at least 0, below 1")
_SPEED: Final = Requirement(lambda speed: speed > 0.0, "more than 0 m/s")
_CLOCK: Final = Requirement(CLOCKS.__contains__, f"one of {', '.join(CLOCKS)}")


@dataclass(frozen=True)
class Peer:
    """A node at the other end of one of this node's links.

    Attributes:
        name: the peer's name.
        role: the peer's role.
        ports: the ports that the link carries, in order.
        binds: whether *this* node binds the link's endpoint.
        address: the address that this node binds (tcp), host:port; empty for any port of the loopback.
        certificate: the id that the two ends of the link share; empty where it is the node's own.
        buttons: where those buttons begin among the node's own whose state the link carries, and how many they are.
        riding: the devices of which an orientation rides with the link's signals, in order.

    Raises:
        ValueError: they are no buttons, or more than a signal carries.
    """

    name: str
    role: Role
    ports: tuple[str, ...]
    binds: bool
    address: str = ""
    certificate: str = ""
    buttons: Added[tuple[int, int]] = (0, 0)
    riding: Added[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        first, count = self.buttons
        if not (first >= 0 and 0 <= count <= MAX_BUTTONS):
            raise ValueError(f"found the buttons {self.buttons}; expected the first, and 0 to {MAX_BUTTONS} of them")

    @property
    def width(self) -> int:
        """The number of values of the link's signals: one a port, and what rides with them."""
        return len(self.ports) + RIDER * len(self.riding)


@dataclass(frozen=True)
class Common:
    """The part of a bundle that every node needs, to find its peers and to be recognised by them.

    Attributes:
        session: the session's name.
        name: the node's name.
        role: the node's role.
        certificate: id of the certificate (or of the uncertified session) that all nodes must share; at the site of a
            wave link, the id of its part (:func:`manyhands.launch.plan.bundles.part_id`).
        period: T, s.
        clock: :data:`REALTIME` or :data:`SIMULATED`.
        transport: "ipc" or "tcp".
        public: the public keys of this node, its peers and the supervisor; empty for a session without keys.
        private: the file of this node's private key; empty for a session without keys, or where the user names it.
        directory: the session's directory, mode 0700; empty for a node on another machine.
        control: endpoint of the supervisor's hub.
        ports: the node's ports, in order.
        peers: the node at the other end of each link.
        telemetry_ticks: ticks between two telemetry messages.
        telemetry_first: ticks before the first one, at most as many; they differ, so that the nodes of a session do not
            all send telemetry in the same tick.
        rate: ticks of the node in one of the session's; not 1 at a wave link's site with a period of its own.
        phase: when its tick 0 is, after the session's, s. Sites and their world need no common instant, so they take
            turns at the processors.
        turning: those of its ports that turn.
        buttons: those of its devices, or of the device itself, each after its device's name.
        riding: the devices of which an orientation passes through it, in order.

    Raises:
        ValueError: the first telemetry has more ticks than the others, whose number a node has room for.
    """

    session: str
    name: str
    role: Role
    certificate: str
    period: Annotated[float, _SPAN]
    clock: Annotated[str, _CLOCK]
    transport: str
    public: Mapping[str, str]
    private: str
    directory: str
    control: str
    ports: tuple[str, ...]
    peers: tuple[Peer, ...]
    telemetry_ticks: Annotated[int, _TICKS]
    telemetry_first: Annotated[int, _TICKS]
    rate: Annotated[Added[float], _SPAN] = 1.0
    phase: Annotated[Added[float], _TIME] = 0.0
    turning: Added[tuple[str, ...]] = ()
    buttons: Added[tuple[str, ...]] = ()
    riding: Added[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        if self.telemetry_first > self.telemetry_ticks:
            raise ValueError(
                f"found {self.telemetry_first} ticks to the first telemetry; expected at most {self.telemetry_ticks}, "
                "as to every other"
            )

    @property
    def width(self) -> int:
        """The number of values that the node keeps of a signal: one a port, and what rides with them."""
        return len(self.ports) + RIDER * len(self.riding)

    def riders(self, riding: Sequence[str]) -> list[int]:
        """Where among those values is what rides of these devices."""
        own = self.riding
        return [len(self.ports) + RIDER * own.index(device) + i for device in riding for i in range(RIDER)]

    @property
    def kinds(self) -> tuple[AxisKind, ...]:
        """What the axis of each port does."""
        return kinds_of(self.ports, self.turning)

    @property
    def folder(self) -> Path | None:
        """The session's directory; None for a node on another machine."""
        return Path(self.directory) if self.directory else None


@dataclass(frozen=True)
class Limits:
    """The limits of the devices at a node's ports, in either direction; one entry for each port of the node.

    Attributes:
        force: N.
        displacement: m.
        speed: m/s.

    Raises:
        ValueError: a limit is not a finite number greater than 0.
    """

    force: tuple[float, ...]
    displacement: tuple[float, ...]
    speed: tuple[float, ...]

    def __post_init__(self) -> None:
        for limit in (*self.force, *self.displacement, *self.speed):
            if not 0.0 < limit < math.inf:
                raise ValueError(f"found the limit {limit}; expected a finite number greater than 0")


@dataclass(frozen=True)
class DeviceRung:
    """What every device promises at one rung of the ladder, and under which assumptions on its timing.

    Attributes:
        tau: the longest delay from a sample to its force, s.
        period_tolerance: rho; the time between two samples is at most (1 + rho) T; dimensionless, 0 ... 1.
        share: kappa, share and c; G_hat is (share Delta_D)-OSP with K = kappa T Delta_D^{-1}, and its storage has the
            weight c of the last force step. An uncertified session has the paper's values without delay.
        turning: k of the spring at the device's orientation, N*m/rad; None where no torque acts there.

    Raises:
        ValueError: a number is out of its range.
    """

    tau: Annotated[float, _TIME]
    period_tolerance: float
    share: DeviceShare
    turning: Added[float | None] = None

    def __post_init__(self) -> None:
        if self.turning is not None and not 0.0 < self.turning < math.inf:
            raise ValueError(f"found the stiffness {self.turning} of an orientation; expected a finite positive number")
        if not 0.0 <= self.period_tolerance <= 1.0:
            raise ValueError(f"found the period tolerance {self.period_tolerance}; expected 0 ... 1")
        if not (0.0 < self.share.kappa < math.inf and 0.0 < self.share.share <= 1.0 and 0.0 <= self.share.c < math.inf):
            raise ValueError(f"found {self.share}; expected finite numbers with kappa > 0, 0 < share <= 1 and c >= 0")


class DevicePromise(NamedTuple):
    """The numbers of a device's promise: G_hat is ``level``-OSP, with this K.

    Attributes:
        level: share Delta, m_i x m_i, N*s/m, with Delta of :attr:`DeviceBundle.levels`.
        K: kappa T Delta^{-1}, m_i x m_i, m/N.
    """

    level: Matrix
    K: Matrix


@dataclass(frozen=True, eq=False)
class CouplingRung:
    """One block of V at one rung of the ladder.

    Attributes:
        block: V_i.
        K: K_i, m_i x m_i, m/N.
        level: Delta_V,i, m_i x m_i, N*s/m; None for an uncertified session.
    """

    block: StateSpace
    K: Matrix
    level: Matrix | None


def _require_few_rungs(rungs: Sequence[object]) -> None:
    if len(rungs) > 1 + MOST_RUNGS:
        raise ValueError(f"found {len(rungs)} rungs; expected at most {1 + MOST_RUNGS}")


@dataclass(frozen=True, eq=False)
class SimulatedHand:
    """The physics of a simulated device and its hand, one entry for each axis.

    Attributes:
        mass: of device and hand together, kg.
        damping: of the device, N*s/m.
        operator: H in continuous time, the operator's dynamics.
        hand_damping: N*s/m.
        hand_stiffness: N/m.
        force: intended force (N): a number, a formula in t, or {"times", "values"}.
        motion: intended motion (m), in the same forms.
        linkage: the kinematics of the joints whose motors hold torques, as plain data
            (:func:`manyhands.nodes.device.mechanism.joints_of`), with the ``friction`` of its joints, N*m, where they
            have any; None where the force itself is held.
        friction: its dry friction, N, or how that changes with place and speed; None for none.

    Raises:
        ValueError: the entries are not of one number of axes, a friction is not positive and finite, or it has a
            linkage as well.
    """

    mass: tuple[float, ...]
    damping: tuple[float, ...]
    operator: StateSpace
    hand_damping: tuple[float, ...]
    hand_stiffness: tuple[float, ...]
    force: tuple[Any, ...]
    motion: tuple[Any, ...]
    linkage: Added[Mapping[str, Any] | None] = None
    friction: Annotated[Added[tuple[float, ...] | FrictionCurve | None], FRICTION_FORM] = None

    def __post_init__(self) -> None:
        vectors = [self.mass, self.damping, self.hand_damping, self.hand_stiffness, self.force, self.motion]
        if self.friction is not None:
            least = self.friction.least if isinstance(self.friction, FrictionCurve) else self.friction
            vectors.append(least)
            if not all(0.0 < c < math.inf for c in least):
                raise ValueError(f"found the friction {least} N; expected finite numbers greater than 0")
            if self.linkage is not None:
                raise ValueError("found dry friction behind a linkage; expected one of both")
        _require_one_number({len(vector) for vector in vectors} | {self.operator.inputs})

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.mass)


@dataclass(frozen=True)
class RateMotion:
    """A device without motors by whose deflection a person moves a goal (:mod:`manyhands.nodes.device.rate_goal`).

    Attributes:
        source: its kind (:data:`manyhands.nodes.device.motion_sources.MOTION_SOURCES`).
        device: the path of its file; empty for the one that is plugged in.
        axes: by port, the name of the source's axis, after a minus where it points the other way.
        speed: of the goal at full deflection, m/s.
        dead_zone: the part of the full deflection up to which nothing moves.
    """

    source: str
    device: str
    axes: tuple[str, ...]
    speed: Annotated[float, _SPEED]
    dead_zone: Annotated[float, _PART]


@dataclass(frozen=True, eq=False)
class PersonHand:
    """The physics of a device that a person holds without feeling it; by itself the hand has no intention.

    Attributes:
        physics: the device, and the hand that joins it to the goal that the person moves.
        rate: what moves the goal by its deflection; None for the pointer of a browser.

    Raises:
        ValueError: the device has a linkage or dry friction, which a goal does not move, or not one axis of the source
            for each of its own.
    """

    physics: SimulatedHand
    rate: Added[RateMotion | None] = None

    def __post_init__(self) -> None:
        if self.physics.linkage is not None:
            raise ValueError("found a linkage of a device that a pointer moves; expected none, or a simulated hand")
        if self.physics.friction is not None:
            raise ValueError("found friction of a device that a pointer moves; expected none, or a simulated hand")
        if self.rate is not None:
            _require_one_number({self.physics.axes, len(self.rate.axes)})

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self.physics.axes


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """A recorded motion, which moves the device whatever force acts on it.

    Attributes:
        damping: Delta_D of the device, m x m, N*s/m.
        times: the times of the samples, s, increasing from 0.
        values: by axis, one value for each time, m.

    Raises:
        ValueError: an axis has not one value for each time, or the damping is not m x m.
    """

    damping: Matrix
    times: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        if any(len(axis) != len(self.times) for axis in self.values):
            raise ValueError(f"found an axis without {len(self.times)} samples; expected one at each time")
        _require_one_number({len(self.values), *self.damping.shape})

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.values)


@dataclass(frozen=True)
class PluginDevice:
    """A device that a driver of another package moves (:mod:`manyhands.nodes.device.plugin`).

    Attributes:
        driver: the driver's factory.
        axes: number of axes.
        axis_map: by port, the name of the driver's axis, after a minus where it points the other way; empty for the
            driver's axes in their order.
        scale: by which displacements grow from the driver to the ports, and forces shrink; dimensionless.
        timing: the age of its samples and the delay of its forces, as the session promises them.
        step: likewise the step to which its displacements are measured at the ports, m; None where none is stated.

    Raises:
        ValueError: there is not one step for each axis, or one is negative or not finite.
    """

    driver: FactoryName
    axes: int
    axis_map: tuple[str, ...] = ()
    scale: float = 1.0
    timing: DeviceTiming = NO_DELAY
    step: Added[tuple[float, ...] | None] = None

    def __post_init__(self) -> None:
        if self.step is not None and (len(self.step) != self.axes or not all(0.0 <= q < math.inf for q in self.step)):
            raise ValueError(
                f"found the steps {self.step} m; expected {self.axes} finite ones of at least 0, one an axis"
            )


Source: TypeAlias = Annotated[
    SimulatedHand | PersonHand | RecordedMotion | PluginDevice,
    by_kind(simulated=SimulatedHand, browser=PersonHand, trace=RecordedMotion, plugin=PluginDevice),
]
"""The source of a device's motion; ``browser`` is what bundles called the hand of a person before it had a rate."""


def _require_one_number(numbers: set[int]) -> None:
    if len(numbers) != 1:
        raise ValueError(f"found entries of {sorted(numbers)} axes in a device's source; expected one number of axes")


@dataclass(frozen=True)
class TurnedHand:
    """The physics of a simulated device that a hand turns, the same about every axis.

    Attributes:
        inertia: of device and hand together, kg*m^2.
        damping: of the device, N*m*s/rad.
        torque: what the hand intends about each of the world's axes, N*m: a number, a formula in t, or {"times",
            "values"}.

    Raises:
        ValueError: inertia or damping is not finite and positive, or there are not three torques.
    """

    inertia: float
    damping: float
    torque: tuple[Any, ...]

    def __post_init__(self) -> None:
        if not (0.0 < self.inertia < math.inf and 0.0 < self.damping < math.inf) or len(self.torque) != 3:
            raise ValueError(
                f"found an inertia of {self.inertia} kg·m², a damping of {self.damping} N·m·s/rad and "
                f"{len(self.torque)} torques; expected positive ones, and three"
            )


@dataclass(frozen=True)
class OrientationPart:
    """What a device has of its orientation (:mod:`manyhands.nodes.device.orientation`).

    Attributes:
        osp: b, what it burns at least at a turning of 1 rad/s, N*m*s/rad.
        stiffness: k of the spring to its proxy, N*m/rad.
        torque: its greatest torque, N*m.
        speed: its greatest angular velocity, rad/s.
        source: what turns it; None where the driver of another package tells the orientation.

    Raises:
        ValueError: a number is not finite and positive.
    """

    osp: float
    stiffness: float
    torque: float
    speed: float
    source: TurnedHand | None

    def __post_init__(self) -> None:
        for found in (self.osp, self.stiffness, self.torque, self.speed):
            if not 0.0 < found < math.inf:
                raise ValueError(f"found the number {found} of an orientation; expected finite positive ones")

    def stiffness_at(self, rung: DeviceRung) -> float:
        """K at a rung of the ladder, N*m/rad."""
        return self.stiffness if rung.turning is None else rung.turning

    def power(self, period: float) -> float:
        """The most that a hand can put in within one period of so many seconds, J."""
        turn = self.speed * period
        return self.torque * turn + 0.5 * self.stiffness * turn * turn


@dataclass(frozen=True)
class SensedPart:
    """The same of a device that only senses its orientation: no torque acts on its hand, and it has no account.

    Attributes:
        stiffness: k of the spring by which the tool's avatar follows it, N*m/rad.
        source: what turns it; None where the driver of another package tells the orientation.

    Raises:
        ValueError: the stiffness is not finite and positive.
    """

    stiffness: float
    source: TurnedHand | None

    def __post_init__(self) -> None:
        if not 0.0 < self.stiffness < math.inf:
            raise ValueError(f"found the stiffness {self.stiffness} of an orientation; expected a finite positive one")


OrientationOf: TypeAlias = Annotated[OrientationPart | SensedPart, by_kind(felt=OrientationPart, sensed=SensedPart)]
"""What a device has of its orientation: with the torque that its hand feels, or sensed alone."""


@dataclass(frozen=True)
class OrientedTool:
    """A tool that a hand turns, as the environment knows it.

    Attributes:
        device: the hand's device.
        stiffness: k of the spring between hand and avatar, N*m/rad.
        torque: the device's greatest torque, N*m; None where the orientation is sensed and no torque acts.
        power: the most that its hand can put in within a tick, J; None likewise, for such a hand has no account.

    Raises:
        ValueError: a number is not finite and positive.
    """

    device: str
    stiffness: float
    torque: float | None
    power: float | None

    def __post_init__(self) -> None:
        if (self.torque is None) != (self.power is None):
            raise ValueError(f"found a torque of {self.torque} with a power of {self.power}; expected both, or neither")
        for found in (self.stiffness, self.torque, self.power):
            if found is not None and not 0.0 < found < math.inf:
                raise ValueError(f"found the number {found} of a tool that turns; expected finite positive ones")

    @property
    def sensed(self) -> bool:
        """Whether no torque acts on its hand."""
        return self.torque is None


NOTHING = LatenessAllowance(0.0)


class BundleError(Exception):
    """A bundle cannot be read; the message names the file and the reason."""


@dataclass(frozen=True, eq=False)
class DeviceBundle:
    """A device's part of the session.

    Attributes:
        common: the part that every node needs.
        osp: Delta_D of the device itself, without its share, m_i x m_i, N*s/m.
        rungs: kappa, share, c and the timing at each rung; rung 0 is the session's certificate, and each further rung
            is for a longer delay.
        source: what moves the device.
        limits: the limits of the device.
        time: :data:`WALL` or :data:`OWN`, the time in which the source moves the device.
        allowance: what lateness may put into the loop; None where it is counted alone.
        inertia: what is stated of the device's mass and its hand; None where nothing is.
        held: how the motors of its linkage hold torques in place of the force; None where the force itself is held.
        friction: the dry friction that its account counts; None where it counts none.
        scripts: when each of its buttons is held down, s, where nobody presses them: those of a simulated device and of
            a recorded motion. Empty where its driver tells.
        orientation: what it has of its orientation; None where that is no port.

    Raises:
        ValueError: torques of six axes are held beside no torque of an orientation, beside friction, or leave nothing
            of what the orientation burns. Delta_D is not symmetric positive definite with a row for each port, the axes
            of the source are not the ports, those of the friction neither, friction counts on displacements that are
            measured to no known step, the rungs' delays do not grow, the time is unknown, it is wall time under the
            simulated clock, the held torques leave nothing of Delta_D at a rung, or it has an orientation and not three
            ports, or one that nothing turns.
    """

    common: Common
    osp: Matrix
    rungs: tuple[DeviceRung, ...]
    source: Source
    limits: Limits
    time: str = OWN
    allowance: Added[LatenessAllowance | None] = None
    inertia: Added[Inertia | None] = None
    held: Added[HeldTorque | None] = None
    friction: Added[DryFriction | None] = None
    scripts: Added[tuple[Script, ...]] = ()
    orientation: Added[OrientationOf | None] = None

    def __post_init__(self) -> None:
        m = len(self.common.ports)
        if self.scripts and len(self.scripts) != len(self.common.buttons):
            raise ValueError(f"found {len(self.scripts)} scripts of {len(self.common.buttons)} buttons; expected each")
        if self.orientation is not None and m != 3:
            raise ValueError(f"found an orientation beside {m} ports; expected three, which translate")
        if self.orientation is not None and (self.orientation.source is None) != isinstance(self.source, PluginDevice):
            raise ValueError(
                "found an orientation that nothing turns, or two; expected the driver's, or a simulated one"
            )
        if self.time not in TIMES or (self.time == WALL and self.common.clock == SIMULATED):
            raise ValueError(
                f"found a device in the time {self.time!r:.40} under the {self.common.clock} clock; expected {WALL} "
                f"or {OWN} under the {REALTIME} clock, {OWN} under the {SIMULATED} one"
            )
        if self.source.axes != m:
            raise ValueError(f"found a source of {self.source.axes} axes; expected {m}, one a port")
        if self.osp.shape != (m, m) or np.any(self.osp != self.osp.T) or not np.linalg.eigvalsh(self.osp)[0] > 0.0:
            raise ValueError(f"found an osp of shape {self.osp.shape}; expected {m} x {m}, symmetric positive definite")
        if self.inertia is not None and len(self.inertia.mass) != m:
            raise ValueError(f"found an inertia of {len(self.inertia.mass)} axes; expected {m}, one a port")
        if self.friction is not None and len(self.friction.least) != m:
            raise ValueError(f"found a friction of {len(self.friction.least)} axes; expected {m}, one a port")
        if self.friction is not None and isinstance(self.source, PluginDevice) and self.source.step is None:
            raise ValueError("found friction and a driver of another package without a step; expected one an axis")
        if self.twisting is not None and (
            self.friction is not None or not isinstance(self.orientation, OrientationPart)
        ):
            raise ValueError(
                "found torques of six axes; expected a torque of an orientation, and no friction that counts"
            )
        _require_few_rungs(self.rungs)
        if not self.rungs:
            raise ValueError("found no rung; expected that of the certificate")
        taus = [rung.tau for rung in self.rungs]
        if any(not a < b for a, b in pairwise(taus)):
            raise ValueError(f"found rungs for delays of {taus} s; expected them to grow")
        _ = self.levels
        if not all(self.turning_osp(rung) > 0.0 for rung in self.rungs):
            raise ValueError("found torques of six axes that leave nothing of an orientation's osp; expected a rest")

    @property
    def twisting(self) -> HeldTorque | None:
        """How its motors hold force and torque together as torques of joints; None where they do not."""
        return None if self.held is None or self.held.length is None else self.held

    def turning_osp(self, rung: DeviceRung) -> float:
        """What is left at a rung of an orientation's damping, N*m*s/rad; infinite where none exerts a torque."""
        if not isinstance(self.orientation, OrientationPart):
            return math.inf
        if self.held is None:
            return self.orientation.osp
        return self.orientation.osp - self.held.turning(self.common.period, rung.tau, rung.period_tolerance)

    @property
    def timing(self) -> DeviceTiming:
        """How late the device measures and acts, beside its loop; not at all unless a driver's hardware does."""
        return self.source.timing if isinstance(self.source, PluginDevice) else NO_DELAY

    @property
    def measured(self) -> tuple[float, ...] | None:
        """The step to which the displacements are known that friction counts on, m, by axis; None for true ones."""
        return self.source.step if self.friction is not None and isinstance(self.source, PluginDevice) else None

    @property
    def allowed(self) -> LatenessAllowance:
        """How far the device's ledger may fall below 0: in wall time by what lateness may put in."""
        return self.allowance if self.allowance is not None and self.time == WALL else NOTHING

    @cached_property
    def levels(self) -> tuple[Matrix, ...]:
        """What each rung's promise is made of, m_i x m_i, N*s/m.

        It is Delta_D, with what dry friction adds below a speed, less what held torques may give out.
        """
        T = self.common.period
        return tuple(
            promised_level(self.osp, self.held, self.friction, T, rung.tau, rung.period_tolerance)
            for rung in self.rungs
        )

    @cached_property
    def promises(self) -> tuple[DevicePromise, ...]:
        """The promise at each rung, computed once."""
        T = self.common.period
        return tuple(
            DevicePromise(rung.share.share * level, loop_gain(level, T, rung.share.kappa))
            for rung, level in zip(self.rungs, self.levels, strict=True)
        )


@dataclass(frozen=True, eq=False)
class WaveEnd:
    """One end of the wave link between a coupling and the environment (docs/decisions/0033-wave-links.md).

    Attributes:
        b: the wave impedance, m_i x m_i, N*s/m; the same at both ends.
        theta: the level that the certificate leaves to this end, m_i x m_i, N*s/m; None for 0.
        tank: E_0, J.
        peer_period: T of the other end, s.
        depth: how far the play-out stays behind the newest wave, ticks of the other end; None where it is measured.
        every: this end sends a wave in one of so many of its ticks.
        peer_every: the other end sends a wave in one of so many of its ticks.
        turn: the link's number: links with different numbers send in different ticks where that is possible.
        bounds: what its site can do at most; None for no bounds.
        way: under the simulated clock, the network from the other end to this one; None where a wave arrives in its
            tick.

    Raises:
        ValueError: a number is out of its range, b is not symmetric positive definite, or the bounds do not fit it.
    """

    b: Matrix
    theta: Matrix | None
    tank: float
    peer_period: float
    depth: float | None = None
    every: int = 1
    peer_every: int = 1
    turn: int = 0
    bounds: SiteBounds | None = None
    way: Added[SimulatedWay | None] = None

    def __post_init__(self) -> None:
        if min(self.every, self.peer_every) < 1 or self.turn < 0:
            raise ValueError(
                f"found a wave in {self.every} and {self.peer_every} ticks and the turn {self.turn}; expected 1 or "
                "more, and a turn of at least 0"
            )
        if self.b.ndim != 2 or np.any(self.b != self.b.T) or not np.linalg.eigvalsh(self.b)[0] > 0.0:
            raise ValueError(f"found b of shape {self.b.shape}; expected it symmetric positive definite")
        if not 0.0 <= self.tank < math.inf or not 0.0 < self.peer_period < math.inf:
            raise ValueError(
                f"found a tank of {self.tank} J and a period of {self.peer_period} s; expected both finite"
            )
        if self.depth is not None and not 0.0 <= self.depth < math.inf:
            raise ValueError(f"found a depth of {self.depth} ticks; expected a finite number, at least 0")
        if self.bounds is not None and len(self.bounds.wave) != len(self.b):
            raise ValueError(f"found bounds of {len(self.bounds.wave)} ports; expected {len(self.b)}, as b has")


def own_start(common: Common, start: Start) -> Start:
    """``start`` in the node's own ticks, from its own instant of tick 0."""
    epoch = start.epoch + from_seconds(common.phase)
    return Start(epoch, round(start.ticks * common.rate), round(start.tick * common.rate))


@dataclass(frozen=True, eq=False)
class CouplingBundle:
    """A coupling block's part of the session.

    Attributes:
        common: the part that every node needs.
        block: V_i.
        K: K_i, m_i x m_i, m/N.
        level: Delta_V,i, m_i x m_i, N*s/m; None for an uncertified session.
        limits: the limits of its devices.
        softer: the block at rungs 1, 2, ... of the ladder.
        wave: its end of its wave link; None where its loop closes inside the tick.

    Raises:
        ValueError: there are too many rungs, a matrix has not the shape that it has at rung 0, or a further rung has no
            level.
    """

    common: Common
    block: StateSpace
    K: Matrix
    level: Matrix | None
    limits: Limits
    softer: tuple[CouplingRung, ...] = ()
    wave: WaveEnd | None = None

    def __post_init__(self) -> None:
        _require_few_rungs(self.rungs)
        wanted = self.K.shape
        for number, rung in enumerate(self.softer, 1):
            if rung.level is None:
                raise ValueError(f"rung {number}: found no level; expected that of the block")
            shapes = (rung.K.shape, rung.level.shape, rung.block.D.shape)
            if wrong := [shape for shape in shapes if shape != wanted]:
                raise ValueError(
                    f"rung {number}: found a matrix of shape {wrong[0]}; expected {wanted}, that of rung 0"
                )

    @property
    def rungs(self) -> tuple[CouplingRung, ...]:
        """The block at each rung; rung 0 is the session's certificate."""
        return (CouplingRung(self.block, self.K, self.level), *self.softer)


_SCENE: Final = PlainForm(
    lambda scene: {"ports": list(scene.ports), "terms": scene.terms()},
    lambda data: scene_of(data["terms"], tuple(data["ports"])),
)
"""A scene in the form that a certificate has it, with its ports."""


@dataclass(frozen=True, eq=False)
class EnvironmentBundle:
    """The environment's part of the session.

    Attributes:
        common: the part that every node needs.
        E: the environment, tool displacement (m) to force (N); None for a model and for a scene.
        Phi_E: its passivity level, m x m, N*s/m; None where none is promised.
        tool_magnitude: by port, the greatest |p| that honest devices and couplings can send, m; None for no bound.
        tool_step: by port, the greatest |p(k) - p(k-1)|, m; None for no bound.
        feedthrough: by coupling, the digest of the D_V that its hello must have
            (:func:`manyhands.nodes.kernel.arithmetic.feedthrough_digest`).
        feedthrough_rungs: by coupling, its D_V (m/N) at rungs 1, 2, ... of the ladder; the same number for
            each in the tick, none behind a wave link.
        independent: whether each coupling may change its rung by itself; otherwise all change in one tick.
        enforce: whether a controller keeps Phi_E.
        model: the model in place of E; None for E.
        scene: the scene in place of E; None for E.
        stiffness: K of the springs to the model's proxies, m x m, N/m; None for a model that is asked for forces.
        tank: what a model with proxies may give out beyond what it has received, J; 0 for other kinds.
        masses: the masses whose positions are entries of E's state, from the m-th on, or the bodies of a scene or an
            engine, one for each coordinate; none for other kinds.
        longest_tau: the longest delay that the session can cover, s: that of the ladder's last rung where a breach
            softens couplings, else the certificate's; 0 where no delay is covered.
        budgets: the energy that each coupling may put into the others, in the order of the peers.
        storage: P with the energy 1/2 eta^T P eta, J, that E stores in the state eta; None where it is not known.
        waves: its ends of wave links, by coupling.
        oriented: the bodies of an engine whose orientations are reported, as a unit quaternion.
        oriented_tools: the tools that hands turn, in the order in which their orientations ride with signals.

    Raises:
        ValueError: there is not exactly one of E, a model and a scene, or budgets, storage or rungs do not fit. A model
            with a level needs its controller or proxies, and a scene its controller, for the certificate rests on them.
            Or tools are turned without proxies, or are not those whose orientations ride.
    """

    common: Common
    E: StateSpace | None
    Phi_E: Matrix | None
    tool_magnitude: tuple[float | None, ...]
    tool_step: tuple[float | None, ...]
    feedthrough: Mapping[str, str]
    feedthrough_rungs: Mapping[str, tuple[Matrix, ...]] = field(default_factory=dict)
    independent: bool = True
    enforce: bool = False
    model: FactoryName | None = None
    scene: Annotated[ContactScene, _SCENE] | None = None
    stiffness: Matrix | None = None
    masses: tuple[str, ...] = ()
    longest_tau: Annotated[float, _TIME] = 0.0
    budgets: tuple[EnergyBudget, ...] = ()
    storage: Matrix | None = None
    waves: Mapping[str, WaveEnd] = field(default_factory=dict)
    tank: Added[float] = 0.0
    oriented: Added[tuple[str, ...]] = ()
    oriented_tools: Added[tuple[OrientedTool, ...]] = ()

    @property
    def energy_at_start(self) -> float:
        """What the environment may give out from its start on, J, with which its ledger begins."""
        return self.tank if self.scene is None else self.scene.energy_at_start

    def __post_init__(self) -> None:
        kinds = sum(kind is not None for kind in (self.E, self.model, self.scene))
        if kinds != 1:
            raise ValueError(f"found {kinds} of an environment's matrices, model and scene; expected one of them")
        turned = tuple(of.device for of in self.oriented_tools)
        if turned != self.common.riding or (turned and self.stiffness is None):
            raise ValueError(
                f"found the tools of {turned} turned, and the orientations of {self.common.riding} riding; expected "
                "the same, and proxies where there are any"
            )
        if self.stiffness is not None and (self.model is None or self.stiffness.shape != (len(self.common.ports),) * 2):
            raise ValueError(f"found a stiffness of shape {self.stiffness.shape}; expected m x m, and a model")
        if not (0.0 <= self.tank < math.inf) or (self.tank and self.stiffness is None):
            raise ValueError(f"found a tank of {self.tank} J; expected at least 0, and above 0 only with proxies")
        needs = self.E is None and self.stiffness is None
        if self.enforce != (self.Phi_E is not None) and (self.enforce or needs):
            raise ValueError(
                f"found enforce {self.enforce} {'with' if self.Phi_E is not None else 'without'} a level; expected a "
                "model's level to be enforced or kept by proxies, and a level wherever one is"
            )
        if len(self.budgets) != len(self.feedthrough):
            raise ValueError(f"found {len(self.budgets)} budgets; expected {len(self.feedthrough)}, one a coupling")
        if self.storage is not None and (self.E is None or self.storage.shape != self.E.A.shape):
            raise ValueError(f"found a storage of shape {self.storage.shape}; expected that of E's matrix A")
        # a site has one coupling for good
        numbers = {len(rungs) for name, rungs in self.feedthrough_rungs.items() if rungs or name not in self.waves}
        if not self.feedthrough_rungs:
            return
        if len(numbers) > 1 or self.feedthrough_rungs.keys() != self.feedthrough.keys():
            raise ValueError("found a ladder for some couplings; expected the same rungs for each of them")
        if max(numbers, default=0) > MOST_RUNGS:
            raise ValueError(f"found {1 + max(numbers)} rungs; expected at most {1 + MOST_RUNGS}")


@dataclass(frozen=True, eq=False)
class ObserverBundle:
    """An observer's part: its name, its keys and its peers, and nothing of the session's mathematics."""

    common: Common


Bundle = DeviceBundle | CouplingBundle | EnvironmentBundle | ObserverBundle
_B = TypeVar("_B", DeviceBundle, CouplingBundle, EnvironmentBundle, ObserverBundle)


def foreign_code(bundle: Bundle) -> FactoryName | None:
    """The factory of another package's code that the node of this bundle runs; None for none."""
    if isinstance(bundle, EnvironmentBundle):
        return bundle.model
    if isinstance(bundle, DeviceBundle) and isinstance(bundle.source, PluginDevice):
        return bundle.source.driver
    return None


def elsewhere(bundle: Bundle) -> Any:
    """The same bundle for, or from, another machine: without a folder of this one in which code is looked for."""
    code = foreign_code(bundle)
    if code is None:
        return bundle
    code = dataclasses.replace(code, folder="")
    if isinstance(bundle, EnvironmentBundle):
        return dataclasses.replace(bundle, model=code)
    if isinstance(bundle, DeviceBundle) and isinstance(bundle.source, PluginDevice):
        return dataclasses.replace(bundle, source=dataclasses.replace(bundle.source, driver=code))
    raise AssertionError("no other bundle names code")


def save(bundle: Bundle, path: Path) -> None:
    """Write a bundle as a new file that only its owner can read (mode 0600).

    Raises:
        OSError: the path exists, or it cannot be written.
    """
    with open_new(path, mode=0o600) as file:
        file.write(encoded(bundle))


def encoded(bundle: Bundle) -> bytes:
    """The content of a bundle's file."""
    return json.dumps(written(bundle), allow_nan=False).encode()


def role_of(path: Path) -> Role:
    """The role of a bundle's node.

    Raises:
        BundleError: as :func:`load`.
    """
    data = _object_in(path)
    return decoded({"common": data.get("common")}, ObserverBundle, path).common.role


def load(path: Path, kind: type[_B]) -> _B:
    """Read a bundle of the wanted kind.

    Raises:
        BundleError: the file cannot be read, or is no bundle of that kind.
    """
    return decoded(_object_in(path), kind, path)


def decoded(data: Any, kind: type[_B], path: Path) -> _B:
    """A bundle of the wanted kind from the JSON object in the file ``path``.

    Raises:
        BundleError: the object is no bundle of that kind.
    """
    try:
        return read(kind, _of_now(data) if kind is DeviceBundle else data)
    except Unfit as error:
        raise BundleError(f"{path}: not a bundle for a {kind.__name__}: {error}") from error


def _of_now(device: Any) -> Any:
    """A device's bundle from before lateness had a power: it has the energy alone, as its tank."""
    if not isinstance(device, dict) or "tank" not in device:
        return device
    tank = device["tank"]
    own = {key: value for key, value in device.items() if key != "tank"}
    return {"allowance": None if tank is None else {"energy": tank, "power": 0.0}, **own}


def _object_in(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(read_regular(path, MAX_FILE_BYTES))
    except OSError as error:
        raise BundleError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # whose text does not quote the file
        raise BundleError(f"{path}: not a bundle: {error}") from error
    if not isinstance(data, dict):
        raise BundleError(f"{path}: not a bundle: found {type(data).__name__}; expected an object")
    return data
