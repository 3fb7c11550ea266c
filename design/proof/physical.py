"""The physical data of an environment as a certificate states them: network, state space, rational functions, or none.

Of a declared environment only the level is stated, that is enforced at run time.
"""

from __future__ import annotations

from dataclasses import dataclass

from manyhands.design.proof.finding import ProofInputError
from manyhands.design.proof.reading import MAX_DEGREE, MAX_DENSE, MAX_LINKS, Item, Number, Table

GROUND = "ground"
_MAX_DELAY = 1_000  # ticks

Span = tuple[Number, Number]
"""A parameter's lower and upper end; equal when it is known."""


@dataclass(frozen=True)
class Link:
    """A spring and a damper, in parallel, between two ends.

    Attributes:
        ends: indices of ports and masses; None is the ground.
        stiffness: N/m.
        damping: N*s/m.
    """

    ends: tuple[int | None, int | None]
    stiffness: Span
    damping: Span


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
    links: tuple[Link, ...]
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
        D: m x m; None where the static gain is stated instead.
        static: the response at z = 1 (s = 0 in continuous time), m x m; None where D is stated.
    """

    A: Table
    B: Table
    C: Table
    D: Table | None
    static: Table | None


@dataclass(frozen=True, eq=False)
class SystemData(Realisation):
    """A state space from displacement (m) to force (N).

    Attributes:
        method: how the continuous system is discretised; None for one that is discrete.
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
class DeclaredData:
    """An environment of which nothing but its level is stated.

    Attributes:
        level: Phi_E as declared, m x m, N*s/m.
    """

    level: Table


DynamicsData = NetworkData | SystemData | TransferData
EnvironmentData = DynamicsData | DeclaredData


def read_environment(item: Item, ports: tuple[str, ...]) -> EnvironmentData:
    """The environment of a certificate with these ports.

    Raises:
        ProofInputError: it is not of the format.
    """
    found = item.entries(16)
    if "type" not in found:
        raise ProofInputError(f"{item.path}: the key type is missing")
    match found["type"].text("network", "state-space", "transfer-function", "declared"):
        case "declared":
            return DeclaredData(item.fields(("type", "level"))["level"].symmetric(len(ports)))
        case "network":
            return _network(item, ports)
        case "state-space":
            return _system(item, len(ports))
        case _:
            return _transfer(item, len(ports))


def _network(item: Item, ports: tuple[str, ...]) -> NetworkData:
    parts = item.fields(("type", "masses", "links", "delay"))
    masses = parts["masses"].entries(MAX_LINKS)
    index: dict[str, int | None] = {name: i for i, name in enumerate([*ports, *masses])}
    if len(index) != len(ports) + len(masses) or GROUND in index:
        raise parts["masses"].refusal(f"names that are none of the ports' and not {GROUND!r}")
    index[GROUND] = None
    links = []
    for entry in parts["links"].items(MAX_LINKS):
        link = entry.fields(("between", "stiffness", "damping"))
        names = [end.text() for end in link["between"].items(2, exactly=2)]
        if names[0] == names[1] or not all(name in index for name in names):
            raise link["between"].refusal("two different ones of the ports, the masses and the ground")
        links.append(Link((index[names[0]], index[names[1]]), link["stiffness"].span(), link["damping"].span()))
    return NetworkData(
        len(ports),
        tuple(mass.span() for mass in masses.values()),
        tuple(links),
        parts["delay"].whole(0, _MAX_DELAY),
    )


def _system(item: Item, m: int) -> SystemData:
    parts = item.fields(("type", "A", "B", "C", "time", "delay"), ("method", "D", "static"))
    n = parts["A"].length()
    if n + m > MAX_DENSE:
        raise ProofInputError(f"{item.path}.A: found {n} states and {m} ports, expected at most {MAX_DENSE} together")
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
) -> tuple[Table, Table, Table, Table | None, Table | None]:
    """The entries of a :class:`Realisation` from the fields of ``item``, of which D or static is stated.

    Raises:
        ProofInputError: a matrix of another shape, both of D and static, or neither.
    """
    A, B, C = parts["A"].table(n, n), parts["B"].table(n, m), parts["C"].table(m, n)
    if ("D" in parts) == ("static" in parts):
        found = "both" if "D" in parts else "neither"
        raise ProofInputError(f"{item.path}: found {found} of the keys D and static, expected one of them")
    D, static = (parts[key].table(m, m) if key in parts else None for key in ("D", "static"))
    return A, B, C, D, static


def _transfer(item: Item, m: int) -> TransferData:
    parts = item.fields(("type", "entries", "method", "delay"))
    if m > MAX_DENSE:
        raise ProofInputError(f"{item.path}: found {m} ports, expected at most {MAX_DENSE}")
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
    """Without leading zeros; the zero polynomial keeps one."""
    for i, c in enumerate(coefficients):
        if c:
            return coefficients[i:]
    return (0,)
