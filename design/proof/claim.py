"""The claim of a certificate, read from its plain data: every name is resolved, every number is exact, none is trusted.

The format is version 3 of the certificate file. Version 4 has a period tolerance, version 5 the parts of the world's
links that are counted in series, and version 6 more of a device's mechanism than its level. Matrices keep the paper's
letters. Indices count ports from 0 in the certificate's order, and masses after them.

An environment's physical data are a network, a state space, or rational functions of s. A declared environment has
none: only the level that a controller enforces at run time is stated. A scene has its level by its kind, 0, and the
data that the theorem about it needs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flint import fmpq, fmpq_mat

from manyhands.design.proof.exact import (
    MAX_DEGREE,
    MAX_DENSE,
    MAX_LINKS,
    MAX_PORTS,
    Item,
    Number,
    Sparse,
    StatedDifferences,
    StatedMatrix,
    block_diagonal,
    exact_decimal,
)
from manyhands.design.proof.finding import ProofInputError
from manyhands.design.proof.linkage import LinkageData, read_linkage

GROUND = "ground"
_MAX_DELAY = 1_000  # ticks

Span = tuple[Number | fmpq, Number | fmpq]
"""A parameter's lower and upper end; both are equal for a known parameter. Rationals are computed from the file's."""


@dataclass(frozen=True)
class LinkData:
    """A spring and a damper, in parallel, between two ends.

    Attributes:
        ends: indices of ports and masses; None is the ground.
        stiffness: N/m.
        damping: N*s/m.
        arms: > 0, by how much the link's length changes with each end: the lever arm of one that turns, m/rad, or 1.
    """

    ends: tuple[int | None, int | None]
    stiffness: Span
    damping: Span
    arms: tuple[fmpq, fmpq] = (fmpq(1), fmpq(1))


@dataclass(frozen=True)
class NetworkData:
    """Masses, springs and dampers.

    Attributes:
        ports: number m of ports, indices 0 ... m-1.
        masses: of the n masses, indices m ... m+n-1, kg.
        links: the links.
        delay: whole ticks by which its forces are late.
    """

    ports: int
    masses: tuple[Span, ...]
    links: tuple[LinkData, ...]
    delay: int

    @property
    def uncertain(self) -> bool:
        """Whether any parameter is an interval."""
        spans = [*self.masses, *(s for link in self.links for s in (link.stiffness, link.damping))]
        return any(low != high for low, high in spans)


@dataclass(frozen=True, eq=False)
class Realisation:
    """A state space of n states and m ports, as it is stated.

    Attributes:
        A, B, C: n x n, n x m, m x n.
        D: m x m; None if the static gain is stated instead.
        static: the response at z = 1 (s = 0 in continuous time), m x m; None if D is stated.
    """

    A: StatedMatrix
    B: StatedMatrix
    C: StatedMatrix
    D: StatedMatrix | None
    static: StatedMatrix | None


@dataclass(frozen=True, eq=False)
class SystemData(Realisation):
    """A state space from displacement (m) to force (N).

    Attributes:
        method: how the continuous system is discretised; None for a discrete system.
        delay: whole ticks by which its forces are late.
    """

    method: str | None
    delay: int


@dataclass(frozen=True)
class TransferData:
    """Rational functions of s.

    Attributes:
        entries: m rows of m (numerator, denominator), descending powers of s.
        method: "backward-euler" or "tustin".
        delay: whole ticks by which its forces are late.
    """

    entries: tuple[tuple[tuple[tuple[Number, ...], tuple[Number, ...]], ...], ...]
    method: str
    delay: int


@dataclass(frozen=True, eq=False)
class StiffenedData:
    """E' = E (I - C E)^-1, what is left of E without the compliance C that is counted in series; no file states it.

    Attributes:
        world: E, without delay.
        compliance: C, m x m diagonal, m/N.
        delay: 0.
    """

    world: SystemData | TransferData
    compliance: fmpq_mat
    delay: int = 0


@dataclass(frozen=True, eq=False)
class DeclaredData:
    """An environment of which only the level is stated.

    Attributes:
        level: Phi_E as declared, m x m, N*s/m.
    """

    level: StatedMatrix


@dataclass(frozen=True, eq=False)
class ProxyData(DeclaredData):
    """Springs to proxies, under the proxy test.

    Attributes:
        stiffness: K, m x m, N/m.
        tank: what the world may give out beyond what it has received, J.
    """

    stiffness: StatedMatrix
    tank: Number


@dataclass(frozen=True, eq=False)
class WaveLinkData(DeclaredData):
    """The user's face of a wave link; its level is diag(theta).

    Attributes:
        id: the stated SHA-256 of the wave link's terms.
        b: wave impedance, m x m, N*s/m.
        tank: E_0, J.
        harvest: theta, one number for each port, N*s/m.
        round_trip: R that the link is designed for, s; None if it is not stated.
        mass: the felt mass allowed, m x m, kg; None if it is not stated.
    """

    id: str
    b: StatedMatrix
    tank: Number
    harvest: tuple[Number, ...]
    round_trip: Number | None
    mass: StatedMatrix | None


@dataclass(frozen=True, eq=False)
class PromiseData(DeclaredData):
    """The level that the certificate of a world proves at the ports of the users in the tick.

    Attributes:
        id: the stated SHA-256 of the contract's terms.
    """

    id: str


@dataclass(frozen=True)
class ObstacleData:
    """A thing that stands still.

    Attributes:
        shape: "wall", "room", "box", "sphere" or "capsule".
        points: a point and a normal; two corners; a centre; or two ends.
        radius: m.
    """

    shape: str
    points: tuple[tuple[Number, ...], ...]
    radius: Number


@dataclass(frozen=True, eq=False)
class SceneData(DeclaredData):
    """A scene of tools, bodies, obstacles, springs and contacts; its level is 0.

    Attributes:
        moved: for each port and axis of a tool: the port's index, the tool's, the axis.
        masses: of the bodies by name, kg.
        amounts: all radii, sides of bodies, stiffnesses, dampings and coefficients of friction.
        obstacles: by name.
        links: by ends: the stiffness, N/m.
        touching: by ends: the stiffness of a contact that is not that of all others, N/m.
        stiffness: of all other contacts, N/m.
        gravity: m/s^2.
        tank: what the driven bodies may give out, J.
        holds: the number of springs that buttons set and take away.
    """

    moved: tuple[tuple[int, int, int], ...]
    masses: dict[str, Number]
    amounts: tuple[Number, ...]
    obstacles: dict[str, ObstacleData]
    links: tuple[tuple[frozenset[str], Number], ...]
    touching: dict[frozenset[str], Number]
    stiffness: Number
    gravity: tuple[Number, ...]
    tank: Number
    holds: int


DynamicsData = NetworkData | SystemData | TransferData | StiffenedData
EnvironmentData = DynamicsData | DeclaredData


def read_environment(item: Item, ports: tuple[str, ...]) -> EnvironmentData:
    """The environment of a certificate with these ports.

    Raises:
        ProofInputError: the data are not of the format.
    """
    found = item.entries(16)
    if "type" not in found:
        raise ProofInputError(f"{item.path}: the key type is missing")
    match found["type"].text(
        "network", "scene", "state-space", "transfer-function", "declared", "proxy", "wave-link", "world"
    ):
        case "declared":
            return DeclaredData(item.fields(("type", "level"))["level"].symmetric(len(ports)))
        case "proxy":
            parts = item.fields(("type", "level", "stiffness"), optional=("content", "tank"))
            if "content" in parts:
                parts["content"].text()  # which mesh it is: nothing of it is proved
            tank = parts["tank"].number() if "tank" in parts else 0
            level, stiffness = (parts[name].symmetric(len(ports)) for name in ("level", "stiffness"))
            return ProxyData(level, stiffness, tank)
        case "wave-link":
            return _wave_link(item, len(ports))
        case "world":
            parts = item.fields(("type", "id", "level"))
            return PromiseData(parts["level"].symmetric(len(ports)), parts["id"].text())
        case "network":
            return _network(item, ports)
        case "scene":
            return _scene(item, ports)
        case "state-space":
            return _system(item, len(ports))
        case _:
            return _transfer(item, len(ports))


_ONES = (fmpq(1), fmpq(1))


def _consistent(links: Sequence[LinkData]) -> bool:
    """Whether, in coordinates that are multiples of the given ones, every link has arms of 1: exactly, in rationals.

    What is said of groups that springs join (:func:`manyhands.design.proof.environment.carriers`) is true then alone.
    """
    beside: dict[int, list[tuple[int, fmpq]]] = {}
    for link in links:
        a, b = link.ends
        if a is not None and b is not None:
            beside.setdefault(a, []).append((b, link.arms[1] / link.arms[0]))
            beside.setdefault(b, []).append((a, link.arms[0] / link.arms[1]))
    found: dict[int, fmpq] = {}
    for start in beside:
        if start in found:
            continue
        found[start] = fmpq(1)
        waiting = [start]
        while waiting:
            end = waiting.pop()
            for other, ratio in beside[end]:
                if other not in found:
                    found[other] = ratio * found[end]
                    waiting.append(other)
                elif found[other] != ratio * found[end]:
                    return False
    return True


def _network(item: Item, ports: tuple[str, ...]) -> NetworkData:
    parts = item.fields(("type", "masses", "links", "delay"))
    masses = parts["masses"].entries(MAX_LINKS)
    index: dict[str, int | None] = {name: i for i, name in enumerate([*ports, *masses])}
    if len(index) != len(ports) + len(masses) or GROUND in index:
        raise parts["masses"].refusal(f"names that differ from those of the ports and from {GROUND!r}")
    index[GROUND] = None
    links = []
    for entry in parts["links"].items(MAX_LINKS):
        link = entry.fields(("between", "stiffness", "damping"), ("arms",))
        names = [end.text() for end in link["between"].items(2, exactly=2)]
        if names[0] == names[1] or not all(name in index for name in names):
            raise link["between"].refusal("two different names of ports, masses or the ground")
        arms = (
            _ONES
            if "arms" not in link
            else tuple(exact_decimal(arm.number()) for arm in link["arms"].items(2, exactly=2))
        )
        if not all(arm > 0 for arm in arms):
            raise link["arms"].refusal("two numbers greater than 0")
        ends = index[names[0]], index[names[1]]
        links.append(LinkData(ends, link["stiffness"].span(), link["damping"].span(), (arms[0], arms[1])))
    if any(link.arms != _ONES for link in links) and not _consistent(links):
        raise parts["links"].refusal("lever arms with which two ways between two ends multiply motions equally")
    return NetworkData(
        len(ports),
        tuple(mass.span() for mass in masses.values()),
        tuple(links),
        parts["delay"].whole(0, _MAX_DELAY),
    )


_MOST_THINGS = 100  # tools, bodies or obstacles
_POINTS = {"wall": 2, "room": 2, "box": 2, "sphere": 1, "capsule": 2}


def _scene(item: Item, ports: tuple[str, ...]) -> SceneData:
    keys_of_all = ("type", "gravity", "tools", "bodies", "obstacles", "links", "contact", "contacts")
    parts = item.fields(keys_of_all, ("tank", "holds"))
    tools, bodies, things = (parts[key].entries(_MOST_THINGS) for key in ("tools", "bodies", "obstacles"))
    names = [*tools, *bodies, *things, GROUND]
    if len(set(names)) != len(names):
        raise item.refusal(f"distinct names, none of them {GROUND!r}")
    index = {name: i for i, name in enumerate(ports)}
    moved: list[tuple[int, int, int]] = []
    amounts: list[Number] = []
    for number, tool in enumerate(tools.values()):
        fields = tool.fields(("ports", "axes", "at", "radius"))
        _vector(fields["at"])
        amounts.append(fields["radius"].number())
        its = indices(fields["ports"], index)
        axes = ["xyz".index(axis.text("x", "y", "z")) for axis in fields["axes"].items(len(its), exactly=len(its))]
        moved += [(port, number, axis) for port, axis in zip(its, axes, strict=True)]
    masses: dict[str, Number] = {}
    for name, body in bodies.items():
        fields = body.fields(("mass", "at", "radius"), ("shape", "half", "motion"))
        _vector(fields["at"])
        half = _vector(fields["half"]) if "half" in fields else (0, 0, 0)
        # a segment reaches to both sides, whatever its direction
        amounts += half if "shape" in fields and fields["shape"].text("capsule", "box") == "box" else ()
        mass = fields["mass"].number()
        if "motion" in fields:  # whatever it is: the theorem has no condition on it
            fields["motion"].items(3, exactly=3)
        else:
            masses[name] = mass
        amounts.append(fields["radius"].number())
    obstacles: dict[str, ObstacleData] = {}
    for name, thing in things.items():
        fields = thing.fields(("shape", "points", "radius"))
        shape = fields["shape"].text(*_POINTS)
        points = tuple(map(_vector, fields["points"].items(_POINTS[shape], exactly=_POINTS[shape])))
        obstacles[name] = ObstacleData(shape, points, fields["radius"].number())
        amounts.append(obstacles[name].radius)
    links = []
    for link in parts["links"].items(MAX_LINKS):
        fields = link.fields(("between", "stiffness", "damping", "rest"))
        _vector(fields["rest"])
        links.append((_two_of(fields["between"], [*tools, *bodies, GROUND]), fields["stiffness"].number()))
        amounts += [fields[key].number() for key in ("stiffness", "damping")]
    keys = ("stiffness", "damping", "friction")
    tank = parts["tank"].number() if "tank" in parts else 0
    amounts.append(tank)
    everywhere = parts["contact"].fields(keys)
    amounts += [everywhere[key].number() for key in keys]
    holds = parts["holds"].items(MAX_LINKS) if "holds" in parts else []
    for hold in holds:
        fields = hold.fields(("tool", "button", "stiffness", "damping", "within"))
        fields["button"].text()  # the theorem has no condition on when a spring begins and ends
        fields["tool"].text(*tools)
        amounts += [fields[key].number() for key in ("stiffness", "damping", "within")]
    touching: dict[frozenset[str], Number] = {}
    for contact in parts["contacts"].items(MAX_LINKS):
        fields = contact.fields(("between", *keys))
        amounts += [fields[key].number() for key in keys]
        # the first statement about a pair is the one that holds
        touching.setdefault(_two_of(fields["between"], names[:-1]), fields["stiffness"].number())
    return SceneData(
        StatedMatrix(len(ports), len(ports), [[0] * len(ports) for _ in ports]),
        tuple(moved),
        masses,
        tuple(amounts),
        obstacles,
        tuple(links),
        touching,
        everywhere["stiffness"].number(),
        _vector(parts["gravity"]),
        tank,
        len(holds),
    )


def _vector(item: Item) -> tuple[Number, ...]:
    return tuple(entry.number() for entry in item.items(3, exactly=3))


def _two_of(item: Item, names: list[str]) -> frozenset[str]:
    found = frozenset(entry.text() for entry in item.items(2, exactly=2))
    if len(found) != 2 or not found <= set(names):
        raise item.refusal("two different names of the scene")
    return found


def _wave_link(item: Item, m: int) -> WaveLinkData:
    parts = item.fields(("type", "id", "b", "tank", "harvest", "round_trip", "mass"))
    harvest = tuple(item.number() for item in parts["harvest"].items(m, exactly=m))
    level = StatedMatrix(m, m, [[theta if i == j else 0 for j in range(m)] for i, theta in enumerate(harvest)])
    stated = {name: parts[name] for name in ("round_trip", "mass") if parts[name].value is not None}
    if "mass" in stated and "round_trip" not in stated:
        raise parts["round_trip"].refusal("the round trip for which the felt mass is allowed")
    return WaveLinkData(
        level,
        parts["id"].text(),
        parts["b"].symmetric(m),
        parts["tank"].number(),
        harvest,
        stated["round_trip"].number() if "round_trip" in stated else None,
        stated["mass"].symmetric(m) if "mass" in stated else None,
    )


def _system(item: Item, m: int) -> SystemData:
    parts = item.fields(("type", "A", "B", "C", "time", "delay"), ("method", "D", "static"))
    n = parts["A"].length()
    if n + m > MAX_DENSE:
        raise ProofInputError(f"{item.path}.A: found {n} states and {m} ports; expected at most {MAX_DENSE} together")
    method = None
    if parts["time"].text("discrete", "continuous") == "continuous":
        if "method" not in parts:
            raise ProofInputError(f"{item.path}: the key method is missing")
        method = parts["method"].text("backward-euler", "tustin", "zoh")
    elif "method" in parts and parts["method"].value is not None:
        raise parts["method"].refusal("no method for a discrete system")
    return SystemData(*realisation(item, parts, n, m), method, parts["delay"].whole(0, _MAX_DELAY))


def realisation(
    item: Item, parts: dict[str, Item], n: int, m: int
) -> tuple[StatedMatrix, StatedMatrix, StatedMatrix, StatedMatrix | None, StatedMatrix | None]:
    """The entries (A, B, C, D, static) of a :class:`Realisation` from the fields of ``item``; D or static is None.

    Raises:
        ProofInputError: a matrix has the wrong shape, or not exactly one of D and static is stated.
    """
    A, B, C = parts["A"].table(n, n), parts["B"].table(n, m), parts["C"].table(m, n)
    if ("D" in parts) == ("static" in parts):
        found = "both" if "D" in parts else "neither"
        raise ProofInputError(f"{item.path}: found {found} of the keys D and static; expected one of them")
    D, static = (parts[key].table(m, m) if key in parts else None for key in ("D", "static"))
    return A, B, C, D, static


def _transfer(item: Item, m: int) -> TransferData:
    parts = item.fields(("type", "entries", "method", "delay"))
    if m > MAX_DENSE:
        raise ProofInputError(f"{item.path}: found {m} ports; expected at most {MAX_DENSE}")
    rows = []
    for row in parts["entries"].items(m, exactly=m):
        rows.append(tuple(_rational(entry) for entry in row.items(m, exactly=m)))
    return TransferData(
        tuple(rows), parts["method"].text("backward-euler", "tustin"), parts["delay"].whole(0, _MAX_DELAY)
    )


def _rational(item: Item) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
    parts = item.fields(("num", "den"))
    num, den = (_trimmed(tuple(c.number() for c in parts[name].items(MAX_DEGREE + 1))) for name in ("num", "den"))
    if not any(den):
        raise parts["den"].refusal("coefficients, one of them not zero")
    return num, den


def _trimmed(coefficients: tuple[Number, ...]) -> tuple[Number, ...]:
    """The coefficients without leading zeros; the zero polynomial keeps one."""
    for i, c in enumerate(coefficients):
        if c:
            return coefficients[i:]
    return (0,)


FORMAT = "manyhands-certificate"
WITH_MECHANISM = 6
WITH_SERIES = 5
WITH_TOLERANCE = 4
VERSION = 3
_ASKED = "asked"
_KEYS: tuple[str, ...] = (
    "id",
    "format",
    "version",
    "session",
    "period",
    "tau",
    "ports",
    "devices",
    "structure",
    "environment",
)
_KEYS += (_ASKED, "coupling", "levels", "storage", "transparency", "margins", "method")
_HELD, _STEP, _FRICTION, _TURNING, _ORIENTATION = _MECHANISM = ("held", "step", "friction", "turning", "orientation")
_ENCODER = "encoder"
_SPEED = "speed"
_TOLERANCE = "period_tolerance"
_SERIES = "series"
_MOST_ASKED = 50_000  # values in ``asked``: an order for each of MAX_PORTS blocks, and room for the rest
_DEEPEST_ASKED = 8


@dataclass(frozen=True)
class PortGroup:
    """A named group of ports: those of a device or of a block of V.

    Attributes:
        name: of the device or block.
        ports: indices of its ports, in its own order.
    """

    name: str
    ports: tuple[int, ...]


@dataclass(frozen=True)
class OrientationData:
    """The orientation of a device.

    Attributes:
        osp: b, N*m*s/rad; None where it is sensed, and no torque acts on the hand.
        stiffness: k, N*m/rad.
    """

    osp: fmpq | None
    stiffness: fmpq


@dataclass(frozen=True)
class HeldTorqueData:
    """How a device holds its force: as torques of a linkage.

    Attributes:
        kappa: 1/m, how much its tip's path bends where the joints move evenly.
        force: F, N.
        speed: v, m/s.
        linkage: the kinematics that prove kappa; None where kappa is believed.
        length: L, m/rad, by which turns count where the torque of an orientation is held as well; None elsewhere.
        stated: the plain data of kappa and kinematics, by which equal ones are proved once.
    """

    kappa: fmpq
    force: fmpq
    speed: fmpq
    linkage: LinkageData | None
    length: fmpq | None
    stated: str


@dataclass(frozen=True)
class EncoderData:
    """What is claimed about the steps of the devices' encoders.

    Attributes:
        force: w by port, N; None where nothing is bounded.
        covered: whether dry friction is claimed to cover it.
    """

    force: tuple[fmpq, ...] | None
    covered: bool


@dataclass(frozen=True, eq=False)
class StatedSpringDamper:
    """A block of the class V = (K + B (z-1)/(Tz))^-1.

    Attributes:
        stiffness: K, N/m.
        damping: B, N*s/m.
    """

    stiffness: StatedMatrix
    damping: StatedMatrix


@dataclass(frozen=True, eq=False)
class Linear(Realisation):
    """A block of m_i ports, discrete, from force (N) to displacement (m), and its storage matrix.

    Attributes:
        P: n x n, the storage matrix.
    """

    P: StatedMatrix


@dataclass(frozen=True)
class StatedFilter:
    """A scalar filter num(z)/den(z), descending powers of z."""

    num: tuple[Number, ...]
    den: tuple[Number, ...]


@dataclass(frozen=True, eq=False)
class StatedTransparency:
    """The claim that ||W1 E V W2|| (loop-shaping) or ||W1 (F - E) W2|| (closed-loop) is below gamma.

    Attributes:
        objective: "loop-shaping" or "closed-loop".
        W1, W2: the weights, one scalar filter for all ports.
        gamma: the level, N/m over m/N: dimensionless for loop shaping, N/m for the closed loop.
        P: the storage matrix of the bounded real lemma.
    """

    objective: str
    W1: StatedFilter
    W2: StatedFilter
    gamma: Number
    P: StatedMatrix


@dataclass(frozen=True, eq=False)
class Claim:
    """The claim of a certificate.

    Attributes:
        data: the plain data, for the id.
        id: the stated SHA-256.
        period: T, s.
        tau: greatest delay inside the tick, s.
        period_tolerance: rho; the periods are at most (1 + rho) T; dimensionless.
        ports: names of the m ports.
        devices: name and ports of each device.
        osp: the promised level of each device, N*s/m.
        held: how each device holds its force; None for the force itself.
        step: the steps of each device's encoder by its ports, m; None where none are stated.
        friction: the least dry friction of each device by its ports, N; None where none is stated.
        orientation: that of each device; None where it is no port.
        encoder: what is claimed about the steps; None where nothing is.
        speed: v*, m/s, below which dry friction counts as damping; None where it does not.
        blocks: name and ports of each block of V.
        environment: the physical data of E.
        series: by port, what of the world's compliance V contains: the part of that of a network's own link, or a
            compliance of its own, m/N; 0 for all others.
        coupling: the blocks of V, in order.
        kappa, share, c: the loop gain K = kappa T Delta_D^-1, the part of the device's level that remains, and the
            storage's weight that proves it.
        Delta_D, Delta_V: by block, N*s/m.
        Phi_E: m x m, N*s/m.
        P_E: the storage matrix of Rest; None if the storage is the mechanical energy, or the level is declared.
        transparency: None if no level of transparency is claimed.
        margins: by name.
    """

    data: Mapping[str, Any]
    id: str
    period: fmpq
    tau: fmpq
    period_tolerance: fmpq
    ports: tuple[str, ...]
    devices: tuple[PortGroup, ...]
    osp: tuple[StatedMatrix, ...]
    held: tuple[HeldTorqueData | None, ...]
    step: tuple[tuple[fmpq, ...] | None, ...]
    friction: tuple[tuple[fmpq, ...] | None, ...]
    orientation: tuple[OrientationData | None, ...]
    encoder: EncoderData | None
    speed: fmpq | None
    blocks: tuple[PortGroup, ...]
    environment: EnvironmentData
    series: Mapping[int, fmpq]
    coupling: tuple[StatedSpringDamper | Linear, ...]
    kappa: fmpq
    share: fmpq
    c: fmpq
    Delta_D: tuple[StatedMatrix, ...]
    Delta_V: tuple[StatedMatrix, ...]
    Phi_E: Sparse
    P_E: StatedMatrix | None
    transparency: StatedTransparency | None
    margins: dict[str, fmpq]


def read(data: Mapping[str, Any]) -> Claim:
    """Read the claim from a certificate's plain data.

    Raises:
        ProofInputError: a key is missing or unknown, or its value has the wrong type, shape or size.
    """
    fields = Item(data, "").fields(_KEYS, (_TOLERANCE, _SERIES, _ENCODER, _SPEED))
    fields["format"].text(FORMAT)
    version = fields["version"].whole(VERSION, WITH_MECHANISM)
    _require_plain(fields[_ASKED])
    if (_TOLERANCE in fields) != (version == WITH_TOLERANCE) and version not in (WITH_SERIES, WITH_MECHANISM):
        where = f"in version {WITH_TOLERANCE}, and in no other except {WITH_SERIES} and {WITH_MECHANISM}"
        raise ProofInputError(f"{_TOLERANCE}: expected it {where}")
    if (_SERIES in fields) != (version == WITH_SERIES) and version != WITH_MECHANISM:
        raise ProofInputError(f"{_SERIES}: expected it in version {WITH_SERIES}, and in {WITH_MECHANISM} where needed")
    fields["session"].text()
    for item in fields["method"].entries(1_000).values():
        if not isinstance(item.value, str):
            item.whole(-(2**63), 2**63)
        elif len(item.value) > 100_000:
            raise item.refusal("a shorter text")
    ports = tuple(item.text() for item in fields["ports"].items(MAX_PORTS))
    if len(set(ports)) != len(ports) or not ports:
        raise fields["ports"].refusal("one distinct name for each port, and at least one port")
    index = {name: i for i, name in enumerate(ports)}
    for key in (_ENCODER, _SPEED):
        if key in fields and version != WITH_MECHANISM:
            raise ProofInputError(f"{key}: expected it in version {WITH_MECHANISM} alone")
    devices, osp, held, step, friction, turning, orientation = [], [], [], [], [], [], []
    for name, item in fields["devices"].entries(MAX_PORTS).items():
        device = item.fields(("ports", "osp"), _MECHANISM if version == WITH_MECHANISM else ())
        devices.append(PortGroup(name, indices(device["ports"], index)))
        m = len(devices[-1].ports)
        osp.append(device["osp"].symmetric(m))
        held.append(_held(device[_HELD], m) if _HELD in device else None)
        step.append(_of_axes(device[_STEP], m) if _STEP in device else None)
        friction.append(_of_axes(device[_FRICTION], m) if _FRICTION in device else None)
        orientation.append(_orientation(device[_ORIENTATION], m) if _ORIENTATION in device else None)
        if _TURNING in device:  # decides the units of the other numbers, and so nothing that is proved
            turning.append(indices(device[_TURNING], index))
            if not {*turning[-1]} <= {*devices[-1].ports}:
                raise device[_TURNING].refusal("some of the device's own ports")
    if version == WITH_MECHANISM and not any((*held, *step, *friction, *turning, *orientation)):
        raise fields["version"].refusal(f"{VERSION} to {WITH_SERIES}, for no device has any of {', '.join(_MECHANISM)}")
    blocks = tuple(
        PortGroup(name, indices(item, index)) for name, item in fields["structure"].entries(MAX_PORTS).items()
    )
    levels = fields["levels"].fields(("kappa", "share", "c", "Delta_D", "Delta_V", "Phi_E"))
    storage = fields["storage"].fields(("E_hat", "V_hat"))
    environment = read_environment(fields["environment"], ports)
    return Claim(
        data=data,
        id=fields["id"].text(),
        period=exact_decimal(fields["period"].number()),
        tau=exact_decimal(fields["tau"].number()),
        period_tolerance=exact_decimal(fields[_TOLERANCE].number()) if _TOLERANCE in fields else fmpq(0),
        ports=ports,
        devices=tuple(devices),
        osp=tuple(osp),
        held=tuple(held),
        step=tuple(step),
        friction=tuple(friction),
        orientation=tuple(orientation),
        encoder=_encoder(fields[_ENCODER], len(ports)) if _ENCODER in fields else None,
        speed=exact_decimal(fields[_SPEED].number()) if _SPEED in fields else None,
        blocks=blocks,
        environment=environment,
        series=_series(fields[_SERIES], index, environment) if _SERIES in fields else {},
        coupling=_coupling(fields["coupling"], storage["V_hat"], blocks),
        kappa=exact_decimal(levels["kappa"].number()),
        share=exact_decimal(levels["share"].number()),
        c=exact_decimal(levels["c"].number()),
        Delta_D=_by_block(levels["Delta_D"], blocks),
        Delta_V=_by_block(levels["Delta_V"], blocks),
        Phi_E=input_level(levels["Phi_E"], blocks, len(ports)),
        P_E=storage_matrix(storage["E_hat"], "enforced" if isinstance(environment, DeclaredData) else "energy"),
        transparency=_transparency(fields["transparency"]),
        margins={name: exact_decimal(item.number()) for name, item in fields["margins"].entries(100).items()},
    )


def _held(item: Item, m: int) -> HeldTorqueData:
    fields = item.fields(("kappa", "force", "speed"), ("linkage", "length"))
    kappa, force, speed = (exact_decimal(fields[key].number()) for key in ("kappa", "force", "speed"))
    linkage = read_linkage(fields["linkage"]) if "linkage" in fields else None
    if linkage is not None and len(linkage.low) != m:
        raise fields["linkage"].refusal(f"a linkage whose tip has the {m} axes of its device")
    length = exact_decimal(fields["length"].number()) if "length" in fields else None
    if linkage is not None and length is not None:
        raise fields["linkage"].refusal("none beside a length: no kinematics of six axes are known")
    stated = json.dumps([fields["kappa"].value, fields["linkage"].value]) if linkage is not None else ""
    return HeldTorqueData(kappa, force, speed, linkage, length, stated)


def _orientation(item: Item, m: int) -> OrientationData:
    if m != 3:
        raise item.refusal("none beside another number of ports than three")
    fields = item.fields(("stiffness",), ("osp", "sensed"))
    stiffness = exact_decimal(fields["stiffness"].number())
    if "osp" in fields and "sensed" not in fields:
        return OrientationData(exact_decimal(fields["osp"].number()), stiffness)
    if "osp" in fields or "sensed" not in fields or fields["sensed"].value is not True:
        raise item.refusal("an osp, or sensed: true, which has none")
    return OrientationData(None, stiffness)


def _of_axes(item: Item, m: int) -> tuple[fmpq, ...]:
    """A number of 0 or more for each of the m ports of a device."""
    found = tuple(exact_decimal(entry.number()) for entry in item.items(m, exactly=m))
    if not all(value >= 0 for value in found) or not any(found):
        raise item.refusal("numbers of 0 or more, and one greater than 0")
    return found


def _encoder(item: Item, m: int) -> EncoderData:
    fields = item.fields(("force", "covered"))
    covered, force = fields["covered"], fields["force"]
    if not isinstance(covered.value, bool):
        raise covered.refusal("true or false")
    if force.value is None:
        return EncoderData(None, covered.value)
    return EncoderData(tuple(exact_decimal(w.number()) for w in force.items(m, exactly=m)), covered.value)


def _series(item: Item, index: dict[str, int], environment: EnvironmentData) -> dict[int, fmpq]:
    """What is counted, by port: a compliance where the environment has no links, and else a part of a link."""
    found = item.entries(MAX_PORTS)
    if not found or not set(found) <= set(index):
        raise item.refusal("an entry for at least one of the certificate's ports, and for no other name")
    if isinstance(environment, SystemData | TransferData):
        found = {port: entry.fields(("compliance",))["compliance"] for port, entry in found.items()}
    return {index[port]: exact_decimal(part.number()) for port, part in found.items()}


def _require_plain(item: Item) -> None:
    """Refuse a value that is not an object of plain data of bounded size; as it claims nothing, no more is checked."""
    item.entries(_MOST_ASKED)
    count, level = 0, [item.value]
    for _ in range(_DEEPEST_ASKED):
        count += len(level)
        if count > _MOST_ASKED:
            raise ProofInputError(f"{item.path}: found more than {_MOST_ASKED} values; expected at most {_MOST_ASKED}")
        deeper: list[object] = []
        for value in level:
            here = Item(value, item.path)
            if isinstance(value, Mapping):
                deeper += [inner.value for inner in here.entries(_MOST_ASKED).values()]
            elif isinstance(value, list | tuple):
                deeper += value
            elif isinstance(value, str):
                here.text()
            elif value is not None and not isinstance(value, bool):
                here.number()
        level = deeper
    if level:
        raise ProofInputError(f"{item.path}: found objects or lists deeper than {_DEEPEST_ASKED} levels; expected none")


def indices(item: Item, index: dict[str, int]) -> tuple[int, ...]:
    """The indices of a list of ports, each once and at least one.

    Raises:
        ProofInputError: an entry is not a port of ``index``, or a port stands twice.
    """
    found = []
    for entry in item.items(MAX_PORTS):
        name = entry.text()
        if name not in index:
            raise entry.refusal("one of the certificate's ports")
        found.append(index[name])
    if not found:
        raise item.refusal("at least one port")
    if len(set(found)) != len(found):
        raise item.refusal("every port once")
    return tuple(found)


def _same_names(item: Item, blocks: tuple[PortGroup, ...]) -> dict[str, Item]:
    found = item.entries(len(blocks) + 16)
    if set(found) != {block.name for block in blocks}:
        raise ProofInputError(f"{item.path}: expected one entry for each block of structure, under its name")
    return found


def _by_block(item: Item, blocks: tuple[PortGroup, ...]) -> tuple[StatedMatrix, ...]:
    found = _same_names(item, blocks)
    return tuple(found[block.name].symmetric(len(block.ports)) for block in blocks)


def input_level(item: Item, blocks: tuple[PortGroup, ...], m: int) -> Sparse:
    """Phi_E, m x m, N*s/m, stated whole or by block.

    Raises:
        ProofInputError: a block is missing, or a matrix has the wrong shape or is not symmetric.
    """
    if isinstance(item.value, Mapping):
        return block_diagonal([block.ports for block in blocks], _by_block(item, blocks))
    return block_diagonal([range(m)], [item.symmetric(m)])


def storage_matrix(item: Item, word: str) -> StatedMatrix | None:
    """E_hat's storage matrix; None if the file has ``word`` in its place, as it must without a matrix.

    Raises:
        ProofInputError: there is neither the word nor a square matrix of bounded size, in either form.
    """
    if isinstance(item.value, str) or word == "enforced":
        item.text(word)
        return None
    return _storage(item)


def _storage(item: Item) -> StatedMatrix:
    """A storage matrix that states of E belong to: in those states, or as {"differences": rows} in their differences.

    A reader that does not know the second form finds no list, and refuses the file.
    """
    if not isinstance(item.value, Mapping):
        return _square(item)
    found = _square(item.fields(("differences",))["differences"])
    return StatedDifferences(found.rows, found.columns, found.values)


def _square(item: Item) -> StatedMatrix:
    """A square matrix of bounded size."""
    n = item.length()
    if n > MAX_DENSE:
        raise ProofInputError(f"{item.path}: found {n} rows; expected at most {MAX_DENSE}")
    return item.table(n, n)


def _coupling(item: Item, storage: Item, blocks: tuple[PortGroup, ...]) -> tuple[StatedSpringDamper | Linear, ...]:
    fields = item.fields(("class", "blocks"))
    kind = fields["class"].text("spring-damper", "linear")
    found = _same_names(fields["blocks"], blocks)
    if kind == "spring-damper":
        storage.fields(())
        out: list[StatedSpringDamper | Linear] = []
        for block in blocks:
            parts = found[block.name].fields(("stiffness", "damping"))
            m = len(block.ports)
            out.append(StatedSpringDamper(parts["stiffness"].symmetric(m), parts["damping"].symmetric(m)))
        return tuple(out)
    storages = _same_names(storage, blocks)
    return tuple(_linear(found[block.name], storages[block.name], len(block.ports)) for block in blocks)


def _linear(item: Item, storage: Item, m: int) -> Linear:
    parts = item.fields(("A", "B", "C"), ("D", "static"))
    n = parts["A"].length()
    if n > MAX_DENSE:
        raise ProofInputError(f"{item.path}.A: found {n} rows; expected at most {MAX_DENSE}")
    return Linear(*realisation(item, parts, n, m), storage.table(n, n))


def _transparency(item: Item) -> StatedTransparency | None:
    if item.value is None:
        return None
    parts = item.fields(("objective", "W1", "W2", "gamma", "P"))
    return StatedTransparency(
        parts["objective"].text("loop-shaping", "closed-loop"),
        _filter(parts["W1"]),
        _filter(parts["W2"]),
        parts["gamma"].number(),
        _storage(parts["P"]),
    )


def _filter(item: Item) -> StatedFilter:
    """A proper filter, without leading zeros in its denominator."""
    parts = item.fields(("num", "den"))
    num, den = (tuple(entry.number() for entry in parts[name].items(MAX_DEGREE + 1)) for name in ("num", "den"))
    if not den or not den[0]:
        raise parts["den"].refusal("coefficients of which the first is not zero")
    if not num or len(num) > len(den):
        raise parts["num"].refusal("at most as many coefficients as the denominator has")
    return StatedFilter(num, den)
