"""Virtual environments E, from tool displacement x_e (m) to the force that the tools must exert (N).

All kinds have one interface, :class:`Environment`. It gives E as a discrete system, which the environment's process
runs, and E_hat without its integrators (:mod:`manyhands.design.models.integrators`), which the design needs. A network
of masses, springs and dampers is proved passive by its physics: its energy is a storage function whatever its
parameters are.

A declared environment, such as a physics engine or a neural simulator, has no matrices to prove anything about. Only
its level is known, and a passivity controller at its ports enforces that level at run time. Condition (10) of
[Bianchini2010]_ needs no more: with E_hat (-Phi_E)-ISP, by proof or by a controller, Theorem 3 holds. Its passivity
argument needs neither linearity nor time invariance. The certificate of such a loop is conditional, and states so.

Springs to proxies are declared environments too, whatever proposes the proxies. A test in every tick keeps their level
(docs/decisions/0042-proxies.md), and no controller is needed for it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NoReturn, Protocol

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.integrators import Split, delayed_split, delayed_system, split_system
from manyhands.design.models.network import Method, Network, NetworkLink, discretise
from manyhands.design.models.scene import MOST_DRIVE, ContactScene
from manyhands.design.models.statespace import Matrix, Rational, StateSpace, matrix
from manyhands.design.models.transfer import realise


class Environment(Protocol):
    """An environment with m ports, as the design and the environment's process use it."""

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports, in order."""

    @property
    def passive_network(self) -> Network | None:
        """The network whose energy proves this environment passive; None if physics proves nothing."""

    @property
    def order(self) -> int:
        """The order of Rest, or slightly more: the size that a storage matrix would have."""

    def environment(self, T: float) -> StateSpace:
        """E, discrete with period T (s)."""

    def split(self, T: float) -> Split:
        """E_hat without its integrators; raises Infeasible if E_hat is passive at no level."""


class WithoutEnergy:
    """An environment whose passivity no energy proves: its forces are late, or it is not given by its physics."""

    @property
    def passive_network(self) -> None:
        """None: there is no network whose energy is a storage function."""
        return None


class _Discretised(WithoutEnergy, ABC):
    """An environment that is discretised first and then delayed."""

    delay: int

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


@dataclass(frozen=True)
class NetworkBox:
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

    def __post_init__(self) -> None:
        low, high = self.low, self.high
        same = (
            low.ports == high.ports
            and [name for name, _ in low.masses] == [name for name, _ in high.masses]
            and [link.ends for link in low.links] == [link.ends for link in high.links]
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
                NetworkLink(a.ends, (a.stiffness + b.stiffness) / 2.0, (a.damping + b.damping) / 2.0)
                for a, b in zip(low.links, high.links, strict=True)
            ),
        )

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
class DelayedNetwork(WithoutEnergy):
    """A network whose forces come a whole number of ticks late, E z^-d: not passive in general.

    Attributes:
        network: E.
        delay: d > 0, ticks.
    """

    network: Network
    delay: int

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        if self.delay < 1:
            raise ValueError(f"expected a delay of a tick or more, found {self.delay}")

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports."""
        return self.network.ports

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
class StateSpaceEnvironment(_Discretised):
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
            raise ValueError(f"expected {m} inputs and outputs, found {self.system.inputs} and {self.system.outputs}")

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
    def order(self) -> int:
        """Of Rest."""
        return self.system.order + self.delay * len(self.ports)

    def discrete(self, T: float) -> StateSpace:
        """E without its delay."""
        return self.system if self.method is None else discretise(self.system, self.method, T)


@dataclass(frozen=True)
class TransferEnvironment(_Discretised):
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

    world: StateSpaceEnvironment | TransferEnvironment
    compliance: tuple[float, ...]
    delay: int = field(init=False, default=0)

    __repr__ = brief_repr

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports."""
        return self.world.ports

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
            raise Infeasible("I - D_E C is singular for the compliance that is counted in series", ()) from None
        leaving = N @ E.C  # the states stay those of the world
        return StateSpace(E.A + E.B @ C @ leaving, E.B @ (np.eye(len(C)) + C @ N @ E.D), leaving, N @ E.D)

    def units(self, T: float) -> Matrix | None:
        """Those of the world's states."""
        return self.world.units(T)


@dataclass(frozen=True, eq=False)
class DeclaredEnvironment(WithoutEnergy):
    """An environment of which only its declared level is known.

    Attributes:
        ports: names of the m ports.
        level: Phi_E, m x m symmetric, N*s/m; 0 for a passive environment, above 0 for one that lacks passivity.
        enforced: whether a passivity controller enforces that level at run time.

    Raises:
        ValueError: the level is not symmetric, or not m x m.
    """

    ports: tuple[str, ...]
    level: Matrix
    enforced: bool = True

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        m = len(self.ports)
        object.__setattr__(self, "level", matrix(self.level, m, m))
        if np.any(self.level != self.level.T):
            raise ValueError("environment.level: expected a symmetric matrix")

    def __eq__(self, other: object) -> bool:
        """Equal when every number is."""
        if not isinstance(other, DeclaredEnvironment):
            return NotImplemented
        same = (self.ports, self.enforced) == (other.ports, other.enforced)
        return same and np.array_equal(self.level, other.level)

    __hash__ = None  # type: ignore[assignment]  # matrices have none

    @property
    def order(self) -> int:
        """0: there is no Rest."""
        return 0

    def promised(self) -> Matrix:
        """The level that a design may count on.

        Raises:
            Infeasible: no controller enforces it.
        """
        if not self.enforced:
            raise Infeasible(
                "nothing is proved about the environment's model, and its level is not enforced",
                ("set 'enforce: true' in environment",),
            )
        return self.level

    def environment(self, T: float) -> StateSpace:
        """Refused: E is not known.

        Raises:
            Infeasible: always.
        """
        self._refuse()

    def split(self, T: float) -> Split:
        """Refused: E_hat is not known.

        Raises:
            Infeasible: always.
        """
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise Infeasible(
            "this needs the dynamics of the environment, but only the declared level of its model is known",
            (
                "use an objective that does not need the environment's dynamics: feasible or stiffest",
                "give the environment as a network or as matrices",
            ),
        )


@dataclass(frozen=True, eq=False)
class DeclaredScene(DeclaredEnvironment):
    """A scene, of which the design uses the level 0: that of an exact solution of its ticks, kept by a controller.

    Attributes:
        scene: the tools, bodies and obstacles.
    """

    ports: tuple[str, ...] = field(init=False)
    level: Matrix = field(init=False)
    enforced: bool = field(init=False, default=True)
    scene: ContactScene

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        m = len(self.scene.ports)
        object.__setattr__(self, "ports", self.scene.ports)
        object.__setattr__(self, "level", np.zeros((m, m)))
        super().__post_init__()

    def __eq__(self, other: object) -> bool:
        """Equal when the scenes are."""
        return isinstance(other, DeclaredScene) and self.scene == other.scene

    __hash__ = None  # matrices have none


@dataclass(frozen=True, eq=False)
class ProxyEnvironment(DeclaredEnvironment):
    """Springs from the tools to proxies, f = -K (x_e - q), whose level the proxy test keeps at every tick.

    Attributes:
        stiffness: K, m x m symmetric positive definite, N/m.
        content: the digest of what proposes the proxies, where it is data, as of a mesh; None for code. Nothing is
            proved of it; it makes the certificate of another mesh another one.
        tank: what the world may give out beyond what it has received, J. It counts as stored at the start.

    Raises:
        ValueError: K is not symmetric positive definite, the level has a negative eigenvalue, or the tank is negative.
    """

    enforced: bool = field(init=False, default=True)
    stiffness: Matrix = field(default_factory=lambda: np.zeros((0, 0)))
    content: str | None = None
    tank: float = 0.0

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        super().__post_init__()
        m = len(self.ports)
        object.__setattr__(self, "stiffness", matrix(self.stiffness, m, m))
        if np.any(self.stiffness != self.stiffness.T) or not np.linalg.eigvalsh(self.stiffness)[0] > 0.0:
            raise ValueError("environment.stiffness: expected a symmetric positive definite matrix")
        values = np.linalg.eigvalsh(self.level)
        if values[0] < -1e-12 * max(abs(values[-1]), 1.0):
            raise ValueError("environment.level: expected no negative eigenvalue, for a held proxy costs no energy")
        if not 0.0 <= self.tank <= MOST_DRIVE:
            raise ValueError(f"environment.tank: found {self.tank} J; expected 0 to {MOST_DRIVE:g} J")

    def __eq__(self, other: object) -> bool:
        """Equal when every number is."""
        if not isinstance(other, ProxyEnvironment):
            return NotImplemented
        same = super().__eq__(other) and (self.content, self.tank) == (other.content, other.tank)
        return same and np.array_equal(self.stiffness, other.stiffness)

    __hash__ = None  # matrices have none
