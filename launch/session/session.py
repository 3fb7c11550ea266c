"""A session: devices, couplings, environment, design, faults and observers, as one validated and frozen object.

The session file is the only place where the structure of a session is written, and this module derives it once. The
LMIs, the processes, the sockets and the keys all start from :attr:`Session.ports`, :attr:`Session.blocks` and
:meth:`Session.osp_level`. Values are normalised: one number for all axes has become a tuple by axis. A ``Session``
object satisfies everything that docs/session-file.md requires.

References between devices and couplings can only be checked over the whole session. :func:`structure_problems` finds
all wrong names at once, so that the message says how many are left to correct.

:class:`Faults` states how often a node is restarted, and what follows a breach. A breach is an assumption of the
certificate that a device has measured not to hold. Neither changes what is certified. Restarts are bounded, so that a
node that cannot run does not disturb the others with endless new starts.

An :class:`Observer` reads the channels that its session lists and nothing else, and it writes nothing. The channels
that it may list follow from the channel table: the telemetry of every node, and each signal under the name of the end
that is nearer to the hand. That end is a device (``dx/sample``, ``dx/force``) or a coupling (``cx/tool``,
``cx/reaction``).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, Self, TypeAlias

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationError, model_validator

from manyhands.design.levels.orientation import stiffest
from manyhands.design.models.axis import AxisKind, Units, kinds_of, units_of
from manyhands.design.models.brief import brief_names
from manyhands.design.models.contacts import GROUND
from manyhands.launch.session.design import AUTO, TRANSPARENCY, Design, full_matrix
from manyhands.launch.session.device import Device
from manyhands.launch.session.device_file import parts_to_begin, with_device_files
from manyhands.launch.session.environment import Environment, environment_of_its_type
from manyhands.launch.session.errors import SessionError, listed, one_of, show
from manyhands.launch.session.fields import (
    Described,
    Items,
    NamedParts,
    Period,
    Problem,
    Quantity,
    SessionModel,
    SessionName,
    Text,
    Whole,
    first_error,
    nulls_in,
    part_name,
    problems_in,
    refusal,
    refuse,
)
from manyhands.launch.session.forms import either, mapping_of, one_key_of
from manyhands.launch.session.limits import (
    DEFAULT_RESTARTS,
    DEFAULT_TANK,
    DEFAULT_TANK_POWER,
    DEFAULT_WINDOW,
    LARGEST_TANK,
    LARGEST_TANK_POWER,
    LONGEST_WINDOW,
    MAX_COUPLINGS,
    MAX_DEVICES,
    MAX_OBSERVERS,
    MAX_PORTS,
    MAX_PROBLEMS,
    MAX_READS,
    MAX_RESTARTS,
    MIN_POSITIVE,
    MOST_BUTTONS_IN_ALL,
)
from manyhands.launch.session.matrices import Array
from manyhands.launch.session.motion import motion_problems, with_own_names
from manyhands.launch.session.objects import plain_value, tree_of
from manyhands.launch.session.wave_link import WaveLink
from manyhands.launch.session.yaml import SessionTree, apply_overrides, read_tree, replaced
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import REALTIME, WALL
from manyhands.nodes.kernel.factory import FactoryName
from manyhands.protocol.channels import CHANNELS, Channel, Rate
from manyhands.protocol.limits import MAX_BUTTONS
from manyhands.protocol.messages import Role

ENVIRONMENT: Final = "environment"
"""The name of the environment's node."""

SUPERVISOR: Final = "supervisor"
"""The name of the process that starts, watches and ends a session."""

RESERVED: Final = (ENVIRONMENT, SUPERVISOR, GROUND)
"""Names that no device, coupling or observer may have: other processes of a session, and the fixed end of links."""

PortsOf: TypeAlias = Mapping[str, tuple[str, ...]]
"""The ports of each device, or of each coupling, in order."""


_NAME: Final = Text("a name there")
_DEVICES: Final = Items("device names", MAX_DEVICES, _NAME)
_PORTS: Final = Items("port names", MAX_PORTS, _NAME)


class CouplingBlock(SessionModel):
    """One block of V, which is one process: the devices that it couples, or the ports."""

    model_config = ConfigDict(json_schema_extra=one_key_of("devices", "ports"))

    devices: Annotated[tuple[str, ...] | None, _DEVICES] = Field(
        default=None, description="the devices of which it couples every port"
    )
    ports: Annotated[tuple[str, ...] | None, _PORTS] = Field(default=None, description="the ports that it couples")
    wave_link: WaveLink | None = Field(
        default=None, description="the wave link to the environment; without it the loop closes inside the tick"
    )

    @model_validator(mode="after")
    def _devices_or_ports(self) -> Self:
        if (self.devices is None) == (self.ports is None):
            found = "neither devices nor ports" if self.ports is None else "both devices and ports"
            raise refuse(found, "one of the two: devices: [...] or ports: [...]")
        return self


def structure_problems(devices: PortsOf, couplings: Mapping[str, CouplingBlock]) -> Iterator[Problem]:
    """All problems of the names of devices and couplings; ``devices`` gives the ports of each."""
    ports = tuple(port for own in devices.values() for port in own)
    if len(ports) > MAX_PORTS:
        yield Problem(("devices",), f"{len(ports)} ports", f"at most {MAX_PORTS}")
    yield from _name_problems(devices, couplings)
    yield from _coupling_problems(devices, ports, couplings)


def _name_problems(devices: PortsOf, couplings: Mapping[str, CouplingBlock]) -> Iterator[Problem]:
    for kind, names in (("devices", devices), ("couplings", couplings)):
        for name in names:
            if name in RESERVED:
                yield Problem((kind, name), f"the reserved name {name!r}", f"a name other than {', '.join(RESERVED)}")
    for name in couplings:
        if name in devices:
            yield Problem(("couplings", name), f"the name {name!r} of a device", "a name that no device has")


def _coupling_problems(
    devices: PortsOf, ports: tuple[str, ...], couplings: Mapping[str, CouplingBlock]
) -> Iterator[Problem]:
    owner: dict[str, str] = {}
    dangling = False
    valid = frozenset(ports)
    for name, block in couplings.items():
        kind: Literal["devices", "ports"] = "devices" if block.devices is not None else "ports"
        known = devices if kind == "devices" else valid
        for index, entry in enumerate(block.devices or block.ports or ()):
            place = ("couplings", name, kind, index)
            if entry not in known:
                dangling = True
                names = devices if kind == "devices" else ports
                yield Problem(place, f"the unknown {kind[:-1]} {show(entry)}", one_of(names, entry))
                continue
            for port in devices[entry] if kind == "devices" else (entry,):
                if port in owner:
                    also = "this coupling" if owner[port] == name else f"the coupling {owner[port]!r}"
                    yield Problem(
                        place, f"the port {port!r}, which is also in {also}", "each port in one coupling, once"
                    )
                owner.setdefault(port, name)
    for port in ports:
        if port not in owner and not dangling:  # a misspelt entry, already reported, often leaves a port without one
            yield Problem(("couplings",), f"no coupling for the port {port!r}", "every port in exactly one coupling")


def ports_of_block(block: CouplingBlock, devices: PortsOf) -> tuple[str, ...]:
    """The ports of a coupling, in the order in which it lists them or their devices."""
    if block.ports is not None:
        return block.ports
    return tuple(port for device in block.devices or () for port in devices[device])


def with_single_ports(value: object) -> object:
    """Raw data of a session in which ``d.0`` is replaced by the port of ``d``, wherever ``d`` has a single axis.

    The rest is handed on as it is: whatever is wrong with it is reported by the checks of its own part.
    """
    devices = value.get("devices") if isinstance(value, Mapping) else None
    if not isinstance(value, Mapping) or not isinstance(devices, Mapping):
        return value
    single: dict[object, str] = {}
    for name, device in devices.items():
        if isinstance(device, Mapping) and device.get("dof") == 1:
            axes = device.get("axes")
            has_name = isinstance(axes, list | tuple | Mapping) and len(axes) == 1
            single[f"{name}.0"] = ".".join([str(name), *map(str, axes)]) if axes and has_name else str(name)

    def renamed(part: object, key: str) -> object:
        ports = part.get(key) if isinstance(part, Mapping) else None
        if not isinstance(part, Mapping) or not isinstance(ports, list | tuple):
            return part
        return {**part, key: [single.get(port, port) if isinstance(port, str) else port for port in ports]}

    def link_of(part: object) -> object:
        part = renamed(part, "between")
        lever = part.get("lever") if isinstance(part, Mapping) else None
        if not isinstance(part, Mapping) or not isinstance(lever, Mapping):
            return part
        named = {single.get(end, end): arm for end, arm in lever.items()}
        return {**part, "lever": named} if len(named) == len(lever) else part  # else one is refused

    out, couplings, environment = dict(value), value.get("couplings"), value.get("environment")
    if single and isinstance(couplings, Mapping):
        out["couplings"] = {name: renamed(block, "ports") for name, block in couplings.items()}
    if single and isinstance(environment, Mapping) and isinstance(environment.get("links"), list | tuple):
        out["environment"] = {**environment, "links": [link_of(link) for link in environment["links"]]}
    return out


_RESTARTS: Final = Whole("restarts", 0, MAX_RESTARTS)
_TANK: Final = Quantity("a tank", "J", least=0.0, most=LARGEST_TANK)
_TANK_POWER: Final = Quantity("a power", "W", least=0.0, most=LARGEST_TANK_POWER)
_WINDOW: Final = Quantity("a window", "s", above=0.0, most=LONGEST_WINDOW, smallest=MIN_POSITIVE)


def _allowance(value: object) -> object:
    """A tank: E_0 alone, or energy and power."""
    if isinstance(value, LatenessAllowance):
        return value
    if not isinstance(value, Mapping):
        return LatenessAllowance(_TANK(value))
    if set(value) != {"energy", "power"}:
        raise refuse(f"a mapping with {listed(value)}", "{energy: ..., power: ...} in J and W, or a number in J")
    return LatenessAllowance(_TANK(value["energy"]), _TANK_POWER(value["power"]))


def _plain_allowance(tank: LatenessAllowance) -> object:
    return {"energy": tank.energy, "power": tank.power} if tank.power else tank.energy


_TANK_FORM: Final = either(
    _TANK.json_schema, mapping_of({"energy": _TANK.json_schema, "power": _TANK_POWER.json_schema})
)


class Faults(SessionModel):
    """What follows the death of a process, and the breach of an assumption of the certificate."""

    restarts: Annotated[int, _RESTARTS] = Field(
        default=DEFAULT_RESTARTS, description="how often a node that dies is started anew; 0 ends the session"
    )
    window: Annotated[float, _WINDOW] = Field(
        default=DEFAULT_WINDOW, description="after how long a run, in s, a node's earlier deaths no longer count"
    )
    breach: Literal["warn", "soften", "stop"] = Field(
        default="soften", description="what follows a delay longer than the certificate's: warn, soften or stop"
    )
    lateness: Literal["enforce", "count"] = Field(
        default="enforce", description="what bounds the energy of lateness at a device in wall time: enforce or count"
    )
    tank: Annotated[LatenessAllowance, Described(_allowance, _TANK_FORM), PlainSerializer(_plain_allowance)] = Field(
        default=LatenessAllowance(DEFAULT_TANK, DEFAULT_TANK_POWER),
        description="with lateness: enforce, what lateness may put in through each device: {energy, power} in J and W",
    )

    @property
    def enforced_tank(self) -> LatenessAllowance | None:
        """E_0 and P; None where lateness is counted alone."""
        return self.tank if self.lateness == "enforce" else None


TELEMETRY: Final = "telemetry"
"""An entry of ``reads`` that stands for the telemetry of every node."""

_FROM_THE_HAND: Final = (Role.DEVICE, Role.COUPLING, Role.ENVIRONMENT)


_CHANNEL: Final = Text(f"{TELEMETRY}, or NODE/CHANNEL")


class Observer(SessionModel):
    """A process that reads some channels of a session and takes no part in it."""

    reads: Annotated[tuple[str, ...], Items("channels", MAX_READS, _CHANNEL)] = Field(
        description="what it may read: telemetry for that of all nodes, or single channels as NODE/CHANNEL"
    )

    def problems(self, nodes: Mapping[str, Role]) -> Iterator[Problem]:
        """A problem for each listed channel that a session with these nodes does not have, or that is listed twice."""
        seen: set[str] = set()
        for index, entry in enumerate(self.reads):
            at = ("reads", index)
            node, slash, channel = entry.partition("/")
            if entry in seen:
                yield Problem(at, f"the channel {show(entry)} twice", "each channel once")
            elif slash and node not in nodes:
                yield Problem(at, f"the unknown node {show(node)} in {show(entry)}", one_of(nodes, node))
            elif slash and channel not in (valid := observable(nodes[node])):
                own = [f"{node}/{name}" for name in valid]
                yield Problem(at, f"the channel {show(channel)} of {node!r}", one_of(own, entry))
            elif not slash and entry != TELEMETRY:
                yield Problem(at, show(entry), f"{TELEMETRY}, or NODE/CHANNEL such as {next(iter(nodes))}/{TELEMETRY}")
            seen.add(entry)


def observable(role: Role) -> tuple[str, ...]:
    """The channels of a node of this role that a session may let an observer read."""
    return tuple(channel.name for channel in CHANNELS.values() if role in _named_after(channel))


def _named_after(channel: Channel) -> tuple[Role, ...]:
    """The roles of the nodes whose names an observed channel has; none for channels that set up and end a session."""
    if channel.rate is Rate.EVERY_TICK:
        ends = {*channel.senders, *channel.receivers}
        return (next(role for role in _FROM_THE_HAND if role in ends),)
    return channel.senders if channel.name == TELEMETRY else ()


def observer_problems(observers: Mapping[str, Observer], nodes: Mapping[str, Role]) -> Iterator[Problem]:
    """All problems of the observers' names, and of the channels of these nodes that they list."""
    for name, observer in observers.items():
        at = ("observers", name)
        if name in RESERVED:
            yield Problem(at, f"the reserved name {name!r}", f"a name other than {', '.join(RESERVED)}")
        elif name in nodes:
            yield Problem(at, f"the name {name!r} of a {nodes[name]}", "a name that no device or coupling has")
        for problem in observer.problems(nodes):
            yield problem._replace(at=(*at, *problem.at))


_COLOCATE_FORM: Final = either({"type": "boolean"}, {"const": AUTO})


def _colocate(value: object) -> object:
    """Whether couplings run in their devices' processes, or the word for what a machine decides."""
    if value == AUTO or isinstance(value, bool):
        return value
    raise refuse(show(value), f"{AUTO}, true or false")


_BEGUN_BY_OVERRIDES: Final = frozenset(
    {("design", "weights"), ("design", "weights", "W1"), ("design", "weights", "W2"), ("faults",)}
)
"""Optional parts that an override may create by setting a key in them."""


class Session(SessionModel):
    """A whole session: the content of one session file."""

    name: SessionName = Field(alias="session", description="the session's name")
    period: Period = Field(description="the length T of a tick in s")
    devices: Annotated[
        dict[str, Device],
        BeforeValidator(with_own_names),
        NamedParts(part_name("a device name"), MAX_DEVICES),
    ] = Field(description="the devices by name")
    couplings: Annotated[dict[str, CouplingBlock], NamedParts(part_name("a coupling name"), MAX_COUPLINGS)] = Field(
        description="the blocks of the virtual coupling V by name"
    )
    environment: Annotated[Environment, BeforeValidator(environment_of_its_type)] = Field(
        description="the virtual environment"
    )
    design: Design = Field(description="what the coupling is, or how it is found")
    observers: Annotated[dict[str, Observer], NamedParts(part_name("an observer name"), MAX_OBSERVERS, least=0)] = (
        Field(default={}, description="the observers by name, and the channels that each may read")
    )
    colocate: Annotated[bool | Literal["auto"], Described(_colocate, _COLOCATE_FORM)] = Field(
        default=AUTO, description="whether each coupling runs in its device's process; auto: as the machine needs it"
    )
    faults: Faults = Field(default=Faults(), description="what follows deaths of processes and breaches of delay")

    @model_validator(mode="before")
    @classmethod
    def _ports_by_number(cls, value: object) -> object:
        """Understand ``d.0`` as the port of a device of one axis, which is ``d``, or ``d.x`` with ``axes: [x]``."""
        return with_single_ports(value)

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        device_ports = {name: device.ports(name) for name, device in self.devices.items()}
        problems = list(islice(structure_problems(device_ports, self.couplings), MAX_PROBLEMS))
        for problem in islice(self.environment.problems(self.ports), MAX_PROBLEMS):
            problems.append(problem._replace(at=("environment", *problem.at)))
        if not problems:
            for problem in islice(self.environment.turning_problems(self.ports, self.turning_ports), MAX_PROBLEMS):
                problems.append(problem._replace(at=("environment", *problem.at)))
        problems += islice(observer_problems(self.observers, self.roles), MAX_PROBLEMS)
        motions = {name: (d.trace, d.limits) for name, d in self.devices.items() if d.trace is not None}
        problems += islice(motion_problems(motions, self.period), MAX_PROBLEMS)
        if not problems:
            problems += islice(self._button_problems(), MAX_PROBLEMS)
            problems += islice(self._orientation_problems(), MAX_PROBLEMS)
        if not problems and self.colocated:
            problems += islice(self._colocation_problems(), MAX_PROBLEMS)
        if not problems:
            problems += islice(self._wave_link_problems(), MAX_PROBLEMS)
            problems += islice(self._series_problems(), MAX_PROBLEMS)
            problems += self._speed_problems()
        if not problems:
            problems += islice(self._delay_problems(), MAX_PROBLEMS)
        if not problems:
            found = self.design.problems(self.ports, self.blocks_by_name, self.period)
            for problem in islice(found, MAX_PROBLEMS):
                problems.append(problem._replace(at=("design", *problem.at)))
        if problems:
            raise refusal(*problems)
        return self

    @cached_property
    def ports(self) -> tuple[str, ...]:
        """The m ports, in the order of devices, then of axes: the order of x, p and f_v."""
        return tuple(port for name in self.devices for port in self.ports_of(name))

    @cached_property
    def turning_ports(self) -> tuple[str, ...]:
        """The ports that turn, in the session's order."""
        return tuple(port for name, device in self.devices.items() for port in device.turning(name))

    @cached_property
    def turning(self) -> tuple[str, ...]:
        """The ports that turn, and then what else turns in the environment.

        Their units are N·m, rad and what follows from them.
        """
        return self.turning_ports + self.environment.turning

    def kinds_of(self, coupling: str) -> tuple[AxisKind, ...]:
        """What the axes of a coupling's ports do; nothing where all axes of the session translate."""
        return kinds_of(self.blocks_by_name[coupling], self.turning) if self.turning else ()

    def units(self, *ports: str) -> Units:
        """The units of what is said of these ports together; of all of them, if none is named."""
        return units_of(ports or self.ports, self.turning)

    @cached_property
    def roles(self) -> Mapping[str, Role]:
        """Every node's name and role: devices first, then couplings, then the environment."""
        return {
            **dict.fromkeys(self.devices, Role.DEVICE),
            **dict.fromkeys(self.couplings, Role.COUPLING),
            ENVIRONMENT: Role.ENVIRONMENT,
        }

    @cached_property
    def hands(self) -> tuple[str, ...]:
        """The devices whose orientation is a port, in the session's order."""
        return tuple(name for name, device in self.devices.items() if device.orientation is not None)

    @cached_property
    def sensed_hands(self) -> tuple[str, ...]:
        """Those of them whose orientation is sensed alone: no torque acts on them."""
        return tuple(name for name in self.hands if (of := self.devices[name].orientation) is not None and of.sensed)

    @property
    def stiffest_orientations(self) -> dict[str, float]:
        """By device whose orientation is a port, the greatest k that its spring can have, N·m/rad."""
        return {name: self.orientation_stiffness(name, 0.0, 0.0) for name in self.hands}

    def orientation_stiffness(self, name: str, tau: float, period_tolerance: float) -> float:
        """K of the spring at the orientation of a device, N·m/rad: as stated, or the stiffest that is proved.

        Args:
            name: of the device.
            tau: the longest delay that is certified, s.
            period_tolerance: rho; periods are at most (1 + rho) T.
        """
        own = self.devices[name].orientation
        if own is None:
            raise AssertionError(f"the orientation of {name} is no port")
        if own.stiffness is not None or own.osp is None:
            return own.stiffness or 0.0  # which a sensed orientation states always
        times = self.period_of(name), tau, period_tolerance
        taken = self.taken_of_orientation(name, tau, period_tolerance)
        # where torques of joints leave nothing, a design says so
        return stiffest(own.osp, *times, taken=taken) or stiffest(own.osp, *times)

    def taken_of_orientation(self, name: str, tau: float, period_tolerance: float) -> float:
        """What torques of a device's joints take of the damping of its orientation, N·m·s/rad; 0 where none are held.

        Args:
            name: of the device.
            tau: the longest delay that is certified, s.
            period_tolerance: rho; periods are at most (1 + rho) T.
        """
        held = self.devices[name].held_torque
        return 0.0 if held is None else held.turning(self.period_of(name), tau, period_tolerance)

    def _orientation_problems(self) -> Iterator[Problem]:
        """A problem for each orientation that nothing turns, and for what it does not go with."""
        turned = self.environment.turned
        for name in turned:
            if name not in self.hands:
                expected = f"a device with an orientation: {listed(self.hands) or 'here none'}"
                yield Problem(("environment", "avatars", name), show(name), expected)
        for name in self.hands:
            at = ("devices", name, "orientation")
            if self.environment.type != "engine":
                expected = "an engine with an avatar for its tool: no other world turns tools in space yet"
                yield Problem(at, f"an orientation in an environment of the type {self.environment.type}", expected)
            elif name not in turned:
                yield Problem(
                    at, f"an orientation, and no avatar for {name}", f"environment.avatars: {{{name}: JOINT}}"
                )
            osp, taken = getattr(self.devices[name].orientation, "osp", None), self.taken_of_orientation(name, 0.0, 0.0)
            if osp is not None and not taken < osp:
                found = f"{osp:g} N·m·s/rad"
                if not math.isfinite(taken):
                    yield Problem(at, found, "lower speeds: the tip may turn too far while torques are held")
                else:
                    expected = (
                        f"more than the {taken:.4g} N·m·s/rad that torques of its joints may give out without any "
                        "delay, or a lower greatest force or torque"
                    )
                    yield Problem((*at, "osp"), found, expected)

    def _colocation_problems(self) -> Iterator[Problem]:
        """A problem for each coupling of several devices: it receives the motion of all, so no device may run it."""
        for name in self.shared_couplings:
            found = f"true, with the coupling {name!r} of the devices {listed(self.devices_of(name))}"
            yield Problem(("colocate",), found, "couplings of one device each, or false")

    def _series_problems(self) -> Iterator[Problem]:
        """A problem where compliance of a world that has none to be counted is to be counted in series."""
        if self.design.counted is None:
            return
        at, fault = ("design", "series"), self.environment.without_series
        if fault:
            expected = (
                "an environment of type network, state-space or transfer-function without delay, or series: false"
            )
            yield Problem(at, f"{show(self.design.series)} with {fault}", expected)
        elif self.wave_links:
            found = f"{show(self.design.series)} with the wave link of {next(iter(self.wave_links))!r}"
            yield Problem(at, found, "no wave link, or series: false: the spring of a world is not there across a link")

    def _speed_problems(self) -> Iterator[Problem]:
        """A problem where no dry friction may count below a speed."""
        if self.design.speed is None:
            return
        at, found = ("design", "speed"), show(self.design.speed)
        if all(device.friction is None for device in self.devices.values()):
            yield Problem(at, f"{found} without any friction", "the friction of a device, or no speed")
        if self.wave_links:
            expected = "no wave link, or no speed: the certificates of parts count no dry friction"
            yield Problem(at, f"{found} with the wave link of {next(iter(self.wave_links))!r}", expected)

    def _wave_link_problems(self) -> Iterator[Problem]:
        """A problem for each wave link that fits neither its coupling nor the design."""
        stated = self.design.stated_tau
        tau = self.latency if stated is None else stated
        for name, link in self.wave_links.items():
            at: tuple[str, ...] = ("couplings", name, "wave_link")
            for problem in link.problems(self.blocks_by_name[name], self.period, tau):
                yield problem._replace(at=(*at, *problem.at))
            own = set(self.blocks_by_name[name])
            for device in self.devices_of(name):
                if not own.issuperset(self.ports_of(device)):
                    found = f"a wave link, with only some of the ports of the device {device!r}"
                    yield Problem(at, found, "a coupling of whole devices: a site is certified with its devices alone")
        if self.wave_links and self.design.coupling == "none":
            found = f"'coupling: none' with the wave link of {next(iter(self.wave_links))!r}"
            yield Problem(("design", "coupling"), found, "a coupling, or no wave link")
        if self.design.ladder and len(self.wave_links) == len(self.couplings):
            expected = "no ladder, or a user in the tick: a site has one coupling and never softens"
            yield Problem(("design", "ladder"), "delays with a wave link at every coupling", expected)
        if self.wave_links and self.design.objective in TRANSPARENCY:
            found = f"{self.design.objective} with the wave link of {next(iter(self.wave_links))!r}"
            expected = "feasible or stiffest: the site of a wave link does not know the environment"
            yield Problem(("design", "objective"), found, expected)

    def _delay_problems(self) -> Iterator[Problem]:
        """A problem for each delay to certify that is shorter than a device states its own to be."""
        for name, device in self.devices.items():
            latency, site = device.timing.latency, self.sites.get(name)
            own = f"{latency:g} s, the sample_age and the actuation_delay of {name!r}"
            if latency > self.period_of(name):
                found = f"{latency:g} s of sample_age and actuation_delay"
                expected = f"at most the period of {self.period_of(name):g} s: no certificate covers more"
                yield Problem(("devices", name), found, expected)
                continue
            tau: tuple[str, ...] = ("design", "tau")
            stated = self.design.stated_tau
            if site is not None and (of_site := self.wave_links[site].tau) is not None:
                tau, stated = ("couplings", site, "wave_link", "tau"), of_site
            if stated is not None and stated < latency:
                yield Problem(tau, f"{show(stated)}", f"at least {own}")

    @cached_property
    def latencies(self) -> dict[str, float]:
        """By device, the delay that it has beside its loop, s."""
        return {name: device.timing.latency for name, device in self.devices.items()}

    @property
    def latency(self) -> float:
        """The greatest delay that a device has beside its loop, s; every delay to certify is at least this."""
        return max(self.latencies.values())

    @property  # not kept: the design changes in a copy (`with_delay`), and a copy has what is kept
    def period_tolerance(self) -> float:
        """Rho to certify: what the design states, and at least what the age of any device's samples varies by."""
        return max(self.design.period_tolerance, min(1.0, self.greatest_jitter))

    @cached_property
    def greatest_jitter(self) -> float:
        """The greatest part of its period by which the age of a device's samples varies."""
        return max(device.timing.jitter / self.period_of(name) for name, device in self.devices.items())

    @cached_property
    def folder(self) -> str:
        """The folder in which the session's code is looked for; empty for none (:meth:`with_code_in`).

        It is no field: two sessions are the same wherever their files are, and no record of a run has it.
        """
        return ""

    def with_code_in(self, folder: Path) -> Self:
        """This session, whose code is looked for in ``folder`` as well.

        Only for a file that the user has named: a recording from elsewhere must not bring its code along.
        """
        copied = self.model_copy()
        copied.__dict__["folder"] = str(folder.resolve())  # where the cached property keeps it
        return copied

    @property
    def foreign_code(self) -> dict[str, FactoryName]:
        """The code of other packages that a run imports and executes, by the key that names it."""
        found = {
            f"devices.{name}.driver": FactoryName(device.factory, device.parameters or {}, self.folder)
            for name, device in self.devices.items()
            if device.factory is not None
        }
        if (code := self.environment.code(self.ports, self.turning_ports, self.stiffest_orientations)) is not None:
            found["environment.model"] = FactoryName(*code, self.folder)
        return found

    @cached_property
    def wave_links(self) -> Mapping[str, WaveLink]:
        """The wave link of each coupling that has one, in the order of the couplings."""
        return {name: block.wave_link for name, block in self.couplings.items() if block.wave_link is not None}

    @cached_property
    def sites(self) -> Mapping[str, str]:
        """By node at the site of a wave link, a device or the coupling itself: that coupling."""
        return {node: name for name in self.wave_links for node in (*self.devices_of(name), name)}

    def period_of(self, node: str) -> float:
        """T of a node, s: that of its site where a wave link has one of its own, else the session's."""
        site = self.sites.get(node)
        return self.period if site is None else self.wave_links[site].period_in(self.period)

    def impedance_of(self, node: str) -> tuple[float, float] | None:
        """The least and the greatest eigenvalue of b, N·s/m, of a coupling with a wave link; None for another node."""
        link = self.wave_links.get(node)
        if link is None:
            return None
        eigenvalues = np.linalg.eigvalsh(link.impedance(len(self.blocks_by_name[node])))
        return float(eigenvalues[0]), float(eigenvalues[-1])

    @cached_property
    def own_periods(self) -> Mapping[str, float]:
        """T of the nodes whose period is not the session's, s."""
        return {node: period for node in self.sites if (period := self.period_of(node)) != self.period}

    @property
    def device_period(self) -> float:
        """T of the devices whose delays a design is for, s: the session's; where all users have wave links, the
        shortest of their sites.
        """
        if len(self.wave_links) < len(self.couplings):
            return self.period
        return min(link.period_in(self.period) for link in self.wave_links.values())

    @property
    def own_rates(self) -> dict[str, float]:
        """Ticks in one of the session's, of the nodes whose period is not the session's."""
        return {node: self.period / period for node, period in self.own_periods.items()}

    def devices_of(self, coupling: str) -> tuple[str, ...]:
        """The devices that have a port in a coupling, in the session's order."""
        own = {self.device_at[port] for port in self.blocks_by_name[coupling]}
        return tuple(device for device in self.devices if device in own)

    @cached_property
    def device_at(self) -> Mapping[str, str]:
        """The device of each port."""
        return {port: device for device in self.devices for port in self.ports_of(device)}

    @property
    def colocated(self) -> bool:
        """Whether each coupling runs in its device's process; false where the session leaves it to the machine.

        :func:`manyhands.launch.doctor.colocation.settle_colocation` settles that before a run is planned.
        """
        return self.colocate is True

    def with_colocation(self, colocate: bool) -> Self:
        """This session with its couplings in their devices' processes, or with a process for each."""
        return self.model_copy(update={"colocate": colocate})

    @cached_property
    def shared_couplings(self) -> tuple[str, ...]:
        """The couplings of several devices, which no device's process may run."""
        return tuple(name for name in self.couplings if len(self.devices_of(name)) > 1)

    @property  # not kept: a copy has what is kept (`with_colocation`)
    def carriers(self) -> Mapping[str, str]:
        """The device of each coupling that runs in a device's process; empty where none does."""
        return self._own_devices if self.colocated else {}

    @cached_property
    def _own_devices(self) -> Mapping[str, str]:
        """The first device of each coupling, which is its only one where couplings are co-located."""
        return {name: self.devices_of(name)[0] for name in self.couplings}

    @cached_property
    def blocks_by_name(self) -> Mapping[str, tuple[str, ...]]:
        """The ports of each coupling."""
        device_ports = {name: device.ports(name) for name, device in self.devices.items()}
        return {name: ports_of_block(block, device_ports) for name, block in self.couplings.items()}

    @property
    def blocks(self) -> tuple[tuple[str, ...], ...]:
        """The ports of each coupling, in the order of the couplings: the block structure of V."""
        return tuple(self.blocks_by_name.values())

    def _button_problems(self) -> Iterator[Problem]:
        for where, device, button in self.environment.buttons:
            own = tuple((self.devices[device].buttons or {}) if device in self.devices else ())
            if button not in own:
                expected = one_of(own, button) if own else f"buttons: [{button}] at the device {device}"
                yield Problem(("environment", *where), f"the button {button!r} of {device}", expected)
        at = self.buttons_at
        if len(at[ENVIRONMENT]) > MOST_BUTTONS_IN_ALL:
            yield Problem(("devices",), f"{len(at[ENVIRONMENT])} buttons", f"at most {MOST_BUTTONS_IN_ALL} in all")
        for name in self.couplings:
            if len(at[name]) > MAX_BUTTONS:
                expected = f"at most {MAX_BUTTONS} in one coupling: divide it into more couplings"
                yield Problem(("couplings", name), f"devices with {len(at[name])} buttons", expected)

    @cached_property
    def buttons_at(self) -> Mapping[str, tuple[str, ...]]:
        """The buttons at each node, in order: of a device its own; of a coupling those of the devices whose first port
        it has, so that each is known by one way alone; of the environment all.
        """
        devices = {name: device.buttons_of(name) for name, device in self.devices.items()}
        couplings = {
            name: tuple(
                button
                for device in self.devices_of(name)
                if self.ports_of(device)[0] in own
                for button in devices[device]
            )
            for name, own in self.blocks_by_name.items()
        }
        return {**devices, **couplings, ENVIRONMENT: tuple(button for own in couplings.values() for button in own)}

    def ports_of(self, device: str) -> tuple[str, ...]:
        """The ports of a device, in the order of its axes."""
        return self.devices[device].ports(device)

    def in_wall_time(self, node: str, clock: str) -> bool:
        """Whether a node is a device in wall time under ``clock``: under the simulated one every device has its own."""
        return clock == REALTIME and node in self.devices and self.devices[node].time == WALL

    def holds_torques(self, node: str) -> bool:
        """Whether a node is a device whose motors hold torques from tick to tick, in place of the force."""
        return node in self.devices and self.devices[node].holds_torques

    def tells_work(self, node: str) -> bool:
        """Whether a node is a device that reports the work of its motors, where its time is the wall's."""
        return node in self.devices and self.devices[node].tells_work

    def osp_level(self, device: str) -> Array:
        """Delta_D of a device, m_i x m_i, in N·s/m: the lower end, where the session gives an interval."""
        return np.array(self.devices[device].osp_low, dtype=np.float64)

    @property
    def orders(self) -> tuple[int, ...]:
        """States of a linear coupling for each port, by block in the order of the couplings; 0 without one."""
        return tuple(self.design.order_of(name) for name in self.couplings)

    @property
    def given_stiffness(self) -> Array | None:
        """The given K, m x m in the order of :attr:`ports`, in N/m; ``None`` if no stiffness is given."""
        return None if self.design.stiffness is None else full_matrix(self.design.stiffness, len(self.ports))

    @property
    def given_damping(self) -> Array | None:
        """The given B, m x m in N·s/m: 0 if only a stiffness is given, ``None`` if neither is."""
        if self.design.stiffness is None:
            return None
        return full_matrix(self.design.damping or 0.0, len(self.ports))

    def with_delay(
        self, tau: float, period_tolerance: float = 0.0, sites: Mapping[str, float] = MappingProxyType({})
    ) -> Self:
        """This session with ``tau`` (s, at most the period) in place of a delay that it leaves open.

        It gets the period tolerance as well, where it does not state a greater one. Delays of its ladder that are not
        above ``tau`` have no use any more, and are left out. ``sites`` has by coupling the delays of wave links that
        have one of their own and do not state it, s.
        """
        ladder = self.design.ladder
        longer = None if ladder is None else tuple(delay for delay in ladder if delay > tau)
        tolerance = max(period_tolerance, self.design.period_tolerance)
        settled = {"tau": tau, "period_tolerance": tolerance, "ladder": longer}
        couplings = dict(self.couplings)
        for name, own in sites.items():
            link = self.wave_links[name]
            if link.tau is None:
                couplings[name] = couplings[name].model_copy(update={"wave_link": link.model_copy(update={"tau": own})})
        design = self.design.model_copy(update=settled)
        copied = self.model_copy(update={"design": design, "couplings": couplings})
        copied.__dict__.pop("wave_links", None)  # a copy has what is kept
        return copied

    def as_plain(self) -> dict[str, Any]:
        """The session as plain data in the form of a session file; reading the data gives an equal session."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True)

    def to_dict(self) -> dict[str, Any]:
        """What the session states, as plain data in the form of a session file, without what it leaves to defaults.

        Example:
            >>> import manyhands as mh
            >>> mh.load("example1").to_dict()["design"]
            {'coupling': 'spring-damper', 'objective': 'feasible'}
        """
        return self.model_dump(mode="json", by_alias=True, exclude_none=True, exclude_unset=True)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Session":
        """A session from Python data in the form of a session file (docs/session-file.md).

        Values may be numpy arrays, and linear systems and transfer functions of python-control or SciPy
        (:mod:`manyhands.launch.session.objects`). Relative paths are those of the working directory.

        Raises:
            SessionError: the data make no session; the message has the first problem in the order of the data.

        Example:
            >>> import manyhands as mh
            >>> session = mh.Session.from_dict({
            ...     "session": "wall",
            ...     "period": 0.001,                                                              # s
            ...     "devices": {"d": {"dof": 1, "osp": 1.37, "driver": "simulated", "mass": 0.2}},   # N·s/m, kg
            ...     "couplings": {"c": {"devices": ["d"]}},
            ...     "environment": {"type": "network", "links": [{"between": ["d", "ground"], "stiffness": 5000}]},
            ...     "design": {"coupling": "spring-damper", "objective": "stiffest"},
            ... })
            >>> session
            Session(wall: T = 0.001 s, devices d, couplings c, environment network)
        """
        return _session_of(tree_of(data, "session"), Path())

    def replace(self, changes: Mapping[str, Any]) -> "Session":
        """This session with other values, checked like a new one.

        Args:
            changes: by path of keys, as ``--set`` takes them: ``{"design.tau": 0.0005}``. A value may be any that
                :meth:`from_dict` takes.

        Raises:
            SessionError: a path leads to nothing, or a value is wrong.

        Example:
            >>> import manyhands as mh
            >>> session = mh.load("example1").replace({"design.objective": "stiffest", "devices.dx.mass": 0.3})
            >>> session.devices["dx"].mass
            (0.3,)
        """
        changed = _session_of(with_changes(tree_of(self.to_dict(), self.name), changes), Path())
        return changed.with_code_in(Path(self.folder)) if self.folder else changed

    def __repr__(self) -> str:
        return (
            f"Session({self.name}: T = {self.period:g} s, devices {brief_names(tuple(self.devices))}, "
            f"couplings {brief_names(tuple(self.couplings))}, environment {self.environment.type})"
        )

    __str__ = __repr__


def load_session(path: Path, overrides: Sequence[str] = ()) -> Session:
    """Read and check a session file.

    Args:
        path: the file.
        overrides: ``KEY.PATH=VALUE`` each, checked like the file itself.

    Raises:
        SessionError: the file or an override is wrong; the message has the first problem in the order of the file.
    """
    tree = read_tree(path)
    return _session_of(apply_overrides(tree, overrides, _BEGUN_BY_OVERRIDES | parts_to_begin(tree)), path.parent)


def with_changes(tree: SessionTree, changes: Mapping[str, Any]) -> SessionTree:
    """A new tree, in which each value of ``changes`` has replaced the one at its path of keys, in order.

    Raises:
        SessionError: a path leads to nothing, or no session file can state a value there.
    """
    for dotted, value in changes.items():
        steps = dotted.split(".") if isinstance(dotted, str) else []
        if not steps or not all(steps):
            found, expected = f"the path {show(dotted)}", "keys joined by dots, such as devices.dx.mass"
            raise SessionError(tree.source, None, "", found, expected)
        begun = _BEGUN_BY_OVERRIDES | parts_to_begin(tree)
        tree = replaced(tree, steps, tree.source, begun, partial(plain_value, value, tree=tree))
    return tree


def _session_of(tree: SessionTree, folder: Path) -> Session:
    """The checked session of a tree; relative paths in it are below ``folder``.

    Raises:
        SessionError: see :func:`load_session`.
    """
    tree = with_device_files(tree, folder)
    problems: list[Problem] = []
    session: Session | None = None
    try:
        session = Session.model_validate(tree.data, context={"folder": folder})
    except ValidationError as error:
        problems += problems_in(error, Session)
    reported = {tree.locate(problem.at)[0] for problem in problems}
    problems += [problem for problem in nulls_in(tree.data) if problem.at not in reported]
    if session is None or problems:
        raise first_error(tree, problems)
    return session


MOST_KEPT_VALUES: Final = 100_000_000
"""Ticks x ports of a run that is kept in memory: 1.6 GB."""


def whole_ticks(session: Session, duration: float, *, kept: bool = False) -> int:
    """The number of ticks in a duration.

    Args:
        session: the session, of which the period and the ports count.
        duration: s.
        kept: whether every value of the run is kept in memory.

    Raises:
        ValueError: it is shorter than a period, or too long.
    """
    if not session.period <= duration <= 1e9:
        raise ValueError(f"found {duration:g} s; expected from one period, {session.period:g} s, to 1e9 s")
    ticks, ports = round(duration / session.period), len(session.ports)
    if kept and ticks * ports > MOST_KEPT_VALUES:
        raise ValueError(
            f"found {duration:g} s, {ticks} ticks of {ports} ports; expected at most {MOST_KEPT_VALUES // ports} ticks"
        )
    return ticks
