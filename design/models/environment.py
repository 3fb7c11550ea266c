"""Virtual environments E, from tool displacement x_e (m) to the force that the tools must exert (N).

All kinds have one interface, :class:`.Environment`. It gives E as a discrete system, which the environment's process
runs, and E_hat without its integrators (:mod:`manyhands.design.models.integrators`), which the design needs. A network
of masses, springs and dampers is proved passive by its physics: its energy is a storage function whatever its
parameters are. A function for each kind that a certificate has a name for reads what its ``terms`` wrote.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.integrators import Split, delayed_split, delayed_system, split_system
from manyhands.design.models.kind import Counts, Environment
from manyhands.design.models.network import METHODS, Method, Network, NetworkLink, discretise, network_terms
from manyhands.design.models.statespace import (
    Matrix,
    Rational,
    StateSpace,
    rational_values,
    read_rational,
    read_system,
    system_values,
)
from manyhands.design.models.transfer import realise

MOST_DELAY = 64
"""The most ticks by which the forces of an environment in a certificate are late: its order grows with them."""


class _Discretised(Environment):
    """An environment that is discretised first and then delayed."""

    delay: int

    @property
    def late(self) -> bool:
        """By its delay."""
        return self.delay > 0

    @abstractmethod
    def discrete(self, T: float) -> StateSpace:
        """E without its delay, discrete with period T (s)."""

    def units(self, T: float) -> Matrix | None:
        """The units of :meth:`discrete`'s states, where these are differences (:class:`.Split`); else None."""
        return None

    def environment(self, T: float) -> StateSpace:
        """E z^-d, discrete with period T (s)."""
        return delayed_system(self.discrete(T), self.delay)

    def split(self, T: float) -> Split:
        """E_hat z^-d without its integrators."""
        return delayed_split(replace(split_system(self.discrete(T), T), units=self.units(T)), self.delay, T)


class _WithoutLinks(_Discretised):
    """An environment without links, of which plain springs may be counted in series as long as it has no delay."""

    @property
    def counts(self) -> Counts:
        """Compliance at each port; nothing with a delay."""
        return None if self.delay else "compliance"

    def stiffened(self, parts: Mapping[str, float]) -> StiffenedEnvironment:
        """E' = E (I - C E)^-1."""
        return StiffenedEnvironment(self, tuple(parts.get(port, 0.0) for port in self.ports))

    def counted(self, parts: Mapping[str, float], T: float) -> StateSpace:
        """C = diag(c_i), without states."""
        return StateSpace.static(np.diag([parts.get(port, 0.0) for port in self.ports]))


@dataclass(frozen=True)
class NetworkBox(Environment):
    """Every network whose parameters lie between those of two of the same structure.

    Attributes:
        low: the network with every mass, stiffness and damping at its lower end.
        high: the network with all of them at their upper ends.

    Raises:
        ValueError: the two differ in more than their parameters, or a lower end is above its upper end.
    """

    low: Network
    high: Network

    __repr__ = brief_repr
    counts: ClassVar[Counts] = "part"
    only_energy = True

    def __post_init__(self) -> None:
        low, high = self.low, self.high
        same = (
            low.ports == high.ports
            and [name for name, _ in low.masses] == [name for name, _ in high.masses]
            and [(link.ends, link.arms) for link in low.links] == [(link.ends, link.arms) for link in high.links]
        )
        if not same:
            raise ValueError("expected two networks of the same structure")
        ordered = all(a <= b for (_, a), (_, b) in zip(low.masses, high.masses, strict=True)) and all(
            a.stiffness <= b.stiffness and a.damping <= b.damping for a, b in zip(low.links, high.links, strict=True)
        )
        if not ordered:
            raise ValueError("expected every lower end at or below its upper end")

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports."""
        return self.low.ports

    @property
    def passive_network(self) -> Network:
        """The network at all lower ends: every network of the box dissipates at least as much."""
        return self.low

    @property
    def order(self) -> int:
        """The order of the networks' Rest."""
        return self.low.order

    @property
    def nominal(self) -> Network:
        """The network in the middle of all intervals; a session runs this one."""
        low, high = self.low, self.high
        return Network(
            low.ports,
            tuple((name, (a + b) / 2.0) for (name, a), (_, b) in zip(low.masses, high.masses, strict=True)),
            tuple(
                a.with_values((a.stiffness + b.stiffness) / 2.0, (a.damping + b.damping) / 2.0)
                for a, b in zip(low.links, high.links, strict=True)
            ),
        )

    def terms(self) -> dict[str, Any]:
        """Masses and links, each parameter a number or an interval."""
        return network_terms(self.low, self.high, 0)

    def contacts(self) -> dict[str, NetworkLink]:
        """:meth:`Network.contacts` at the lower ends: the softest of each port's links."""
        return self.low.contacts()

    def stiffened(self, parts: Mapping[str, float]) -> NetworkBox:
        """:meth:`Network.stiffened` at both ends."""
        return NetworkBox(self.low.stiffened(parts), self.high.stiffened(parts))

    def environment(self, T: float) -> StateSpace:
        """E of the nominal network."""
        return self.nominal.environment(T)

    def split(self, T: float) -> Split:
        """E_hat of the nominal network without its integrators: for plots only, as the energy proves the box."""
        return self.nominal.split(T)


@dataclass(frozen=True)
class DelayedNetwork(Environment):
    """A network whose forces come a whole number of ticks late, E z^-d: not passive in general.

    Attributes:
        network: E.
        delay: d > 0, ticks.
    """

    network: Network
    delay: int

    __repr__ = brief_repr
    late = True

    def __post_init__(self) -> None:
        if self.delay < 1:
            raise ValueError(f"found {self.delay}; expected a delay of a tick or more")

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports."""
        return self.network.ports

    @property
    def stiffnesses(self) -> tuple[float, ...]:
        """Of each link."""
        return self.network.stiffnesses

    def terms(self) -> dict[str, Any]:
        """Masses and links, with the delay."""
        return network_terms(self.network, self.network, self.delay)

    @property
    def order(self) -> int:
        """The order of the network's Rest and of the chain of late velocities."""
        return self.network.order + self.delay * len(self.ports)

    def environment(self, T: float) -> StateSpace:
        """E z^-d, discrete with period T (s)."""
        return delayed_system(self.network.environment(T), self.delay)

    def split(self, T: float) -> Split:
        """E_hat z^-d without its integrators."""
        return delayed_split(self.network.split(T), self.delay, T)


@dataclass(frozen=True, eq=False)
class StateSpaceEnvironment(_WithoutLinks):
    """An environment given by its matrices.

    Attributes:
        ports: names of the m ports.
        system: (A, B, C, D), m inputs (m), m outputs (N).
        method: how the continuous system is discretised; None for a system that is discrete already.
        delay: whole ticks by which its forces are late.
    """

    ports: tuple[str, ...]
    system: StateSpace
    method: Method | None = None
    delay: int = 0

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        m = len(self.ports)
        if (self.system.outputs, self.system.inputs) != (m, m):
            raise ValueError(
                f"found {self.system.inputs} inputs and {self.system.outputs} outputs; expected {m} of each"
            )

    def __eq__(self, other: object) -> bool:
        """Equal when every number is."""
        if not isinstance(other, StateSpaceEnvironment):
            return NotImplemented
        return (self.ports, self.method, self.delay) == (other.ports, other.method, other.delay) and all(
            np.array_equal(getattr(self.system, name), getattr(other.system, name))
            for name in ("A", "B", "C", "D", "static_gain")
        )

    __hash__ = None  # type: ignore[assignment]  # matrices have none

    @property
    def at_any_period(self) -> bool:
        """False for a system that is discrete already."""
        return self.method is not None

    def terms(self) -> dict[str, Any]:
        """The matrices as they are given."""
        time = {"time": "discrete"} if self.method is None else {"time": "continuous", "method": self.method}
        return {"type": "state-space", **system_values(self.system), **time, "delay": self.delay}

    @property
    def order(self) -> int:
        """Of Rest."""
        return self.system.order + self.delay * len(self.ports)

    def discrete(self, T: float) -> StateSpace:
        """E without its delay."""
        return self.system if self.method is None else discretise(self.system, self.method, T)


@dataclass(frozen=True)
class TransferEnvironment(_WithoutLinks):
    """An environment given by rational functions of s, such as k + b s + M s^2.

    Attributes:
        ports: names of the m ports.
        entries: m rows of m (numerator, denominator), descending powers of s, N/m; may be improper.
        method: backward Euler, or Tustin for proper entries.
        delay: whole ticks by which its forces are late.
    """

    ports: tuple[str, ...]
    entries: tuple[tuple[Rational, ...], ...]
    method: Literal["backward-euler", "tustin"] = "backward-euler"
    delay: int = 0

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        m = len(self.ports)
        if len(self.entries) != m or any(len(row) != m for row in self.entries):
            raise ValueError(f"expected {m} rows of {m} entries")
        if any(not any(den) for row in self.entries for _, den in row):
            raise ValueError("expected no denominator to be zero")

    def terms(self) -> dict[str, Any]:
        """The rational functions as they are given."""
        rows = [[rational_values(entry) for entry in row] for row in self.entries]
        return {"type": "transfer-function", "entries": rows, "method": self.method, "delay": self.delay}

    @property
    def order(self) -> int:
        """The order of Rest: the degrees of all entries and the chain of the delay."""
        degrees = (max(len(num), len(den)) - 1 for row in self.entries for num, den in row)
        return sum(degrees) + self.delay * len(self.ports)

    def discrete(self, T: float) -> StateSpace:
        """E without its delay, one companion form per entry, in differences."""
        return realise(self.entries, self.method, T)[0]

    def units(self, T: float) -> Matrix:
        """The unit of each state, a power of two (:mod:`manyhands.design.models.transfer`)."""
        return realise(self.entries, self.method, T)[1]


@dataclass(frozen=True)
class StiffenedEnvironment(_Discretised):
    """E' = E (I - C E)^-1: the world of which the compliance C = diag(c_i) of plain springs is taken out.

    With f = -E x and x = x' - C f it is f = -E' x' (docs/decisions/0045-series-compliance.md). E' has the states of E,
    under a static feedback of its force.

    Attributes:
        world: E, without delay.
        compliance: c_i by port, m/N.
    """

    world: _WithoutLinks
    compliance: tuple[float, ...]
    delay: int = field(init=False, default=0)

    __repr__ = brief_repr

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports."""
        return self.world.ports

    @property
    def at_any_period(self) -> bool:
        """As the world is."""
        return self.world.at_any_period

    def terms(self) -> dict[str, Any]:
        """Refused: a certificate has the world, and beside it what is counted.

        Raises:
            TypeError: always.
        """
        raise TypeError("found a world without what is counted of it; expected the world itself")

    @property
    def order(self) -> int:
        """The order of the world's Rest."""
        return self.world.order

    def discrete(self, T: float) -> StateSpace:
        """E', discrete with period T (s).

        Raises:
            Infeasible: I - D_E C is singular, so that a displacement x' has no force.
        """
        E, C = self.world.discrete(T), np.diag(self.compliance)
        try:
            N = np.linalg.inv(np.eye(len(C)) - E.D @ C)
        except np.linalg.LinAlgError:
            raise Infeasible("I - D_E C is singular for the compliance that is counted in series") from None
        leaving = N @ E.C  # the states stay those of the world
        return StateSpace(E.A + E.B @ C @ leaving, E.B @ (np.eye(len(C)) + C @ N @ E.D), leaving, N @ E.D)

    def units(self, T: float) -> Matrix | None:
        """Those of the world's states."""
        return self.world.units(T)


def network_of(data: Mapping[str, Any], ports: tuple[str, ...]) -> Network | DelayedNetwork | NetworkBox:
    """The network that :func:`.network_terms` wrote (:func:`.environment_of`)."""
    delay = _delay(data)
    low, high = (_network_at(data, ports, end) for end in (0, 1))
    if low == high:
        return low if delay == 0 else DelayedNetwork(low, delay)
    if delay:
        raise ValueError("environment: found intervals and a delay; expected one of the two")
    return NetworkBox(low, high)


def _network_at(data: Mapping[str, Any], ports: tuple[str, ...], end: int) -> Network:
    """The network with every interval at its low end (``end`` 0) or high end (1)."""

    def at(value: Any) -> float:
        if isinstance(value, list) and len(value) != 2:
            raise ValueError(f"environment: found {len(value)} numbers; expected an interval [low, high]")
        return float(value[end] if isinstance(value, list) else value)

    return Network(
        ports,
        tuple((str(name), at(mass)) for name, mass in data["masses"].items()),
        tuple(
            NetworkLink((str(a), str(b)), at(link["stiffness"]), at(link["damping"]), (float(of_a), float(of_b)))
            for link in data["links"]
            for (a, b), (of_a, of_b) in [(link["between"], link.get("arms", (1.0, 1.0)))]
        ),
    )


def _delay(data: Mapping[str, Any]) -> int:
    delay = data["delay"]
    if type(delay) is not int or not 0 <= delay <= MOST_DELAY:
        raise ValueError(f"environment.delay: found {delay!r}; expected a whole number from 0 to {MOST_DELAY}")
    return delay


def state_space_of(data: Mapping[str, Any], ports: tuple[str, ...]) -> StateSpaceEnvironment:
    """The environment that :meth:`StateSpaceEnvironment.terms` wrote (:func:`.environment_of`)."""
    delay = _delay(data)
    if data["time"] not in ("continuous", "discrete"):
        raise ValueError(f"environment.time: found {data['time']!r}; expected 'continuous' or 'discrete'")
    method = data["method"] if data["time"] == "continuous" else None
    if method is not None and method not in METHODS:
        raise ValueError(f"environment.method: found {method!r}; expected one of {', '.join(METHODS)}")
    return StateSpaceEnvironment(ports, read_system(data, continuous=method is not None), method, delay)


def transfer_functions_of(data: Mapping[str, Any], ports: tuple[str, ...]) -> TransferEnvironment:
    """The environment that :meth:`TransferEnvironment.terms` wrote (:func:`.environment_of`)."""
    delay = _delay(data)
    if data["method"] not in ("backward-euler", "tustin"):
        raise ValueError(f"environment.method: found {data['method']!r}; expected 'backward-euler' or 'tustin'")
    rows = tuple(tuple(read_rational(entry) for entry in row) for row in data["entries"])
    return TransferEnvironment(ports, rows, data["method"], delay)
