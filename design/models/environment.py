"""Virtual environments E, from tool displacement x_e (m) to the force that the tools must exert (N).

Three kinds, one interface: :class:`Environment` gives E as a discrete system, which the environment's process runs,
and E_hat split (:mod:`manyhands.design.models.integrators`), which the design needs. Networks of masses, springs and
dampers are the kind whose physics is a proof: their energy is a storage function whatever the parameters are.

An environment of which nothing is known but the level that it promises, and that somebody keeps it at run time.

A physics engine or a neural simulator has no matrices to prove anything about. Condition (10) of [Bianchini2010]_ asks
for no more than its level: a controller at its ports that keeps E_hat (-Phi_E)-ISP makes Theorem 3 hold as well as a
proof would, for the passivity argument cares neither for linearity nor for time invariance. A certificate of such a
loop is conditional, and says so.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, NoReturn, Protocol

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.models.integrators import Split, delayed_split, delayed_system, split_system
from manyhands.design.models.network import Method, Network, NetworkLink, discretise, realise, substitute
from manyhands.design.models.operators import Rational
from manyhands.design.models.statespace import Matrix, StateSpace, matrix


class Environment(Protocol):
    """What the design and the environment's process ask of an environment with m ports."""

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports, in order."""

    @property
    def passive_network(self) -> Network | None:
        """The network whose energy proves this environment passive; None where physics proves nothing."""

    @property
    def order(self) -> int:
        """The order of Rest, or a little more: what a storage matrix would have to be."""

    def environment(self, T: float) -> StateSpace:
        """E, discrete with period T (s)."""

    def split(self, T: float) -> Split:
        """E_hat without its integrators; raises Infeasible where E_hat is passive at no level."""


class WithoutEnergy:
    """An environment whose passivity no energy proves: physics arrives late in it, or is not what it is given by."""

    @property
    def passive_network(self) -> None:
        """None: there is no network whose energy is a storage function."""
        return None


class _Discretised(WithoutEnergy, ABC):
    """An environment that is discretised first and delayed then."""

    delay: int

    @abstractmethod
    def discrete(self, T: float) -> StateSpace:
        """E without its delay, discrete with period T (s)."""

    def environment(self, T: float) -> StateSpace:
        """E z^-d."""
        return delayed_system(self.discrete(T), self.delay)

    def split(self, T: float) -> Split:
        """E_hat z^-d, split."""
        return delayed_split(split_system(self.discrete(T), T), self.delay, T)


@dataclass(frozen=True)
class NetworkBox:
    """Every network whose parameters lie between those of two of the same structure.

    Attributes:
        low: every mass, stiffness and damping at its lower end.
        high: at its upper end.

    Raises:
        ValueError: the two differ in more than their parameters, or a lower end is above its upper one.
    """

    low: Network
    high: Network

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
        """The lower corner: what it dissipates, every network of the box dissipates."""
        return self.low

    @property
    def order(self) -> int:
        """Of the networks' Rest."""
        return self.low.order

    @property
    def nominal(self) -> Network:
        """The network in the middle, which a session runs."""
        low, high = self.low, self.high
        return Network(
            low.ports,
            tuple((name, (a + b) / 2.0) for (name, a), (_, b) in zip(low.masses, high.masses, strict=True)),
            tuple(
                NetworkLink(a.ends, (a.stiffness + b.stiffness) / 2.0, (a.damping + b.damping) / 2.0)
                for a, b in zip(low.links, high.links, strict=True)
            ),
        )

    def environment(self, T: float) -> StateSpace:
        """E of the nominal network."""
        return self.nominal.environment(T)

    def split(self, T: float) -> Split:
        """Of the nominal network: for pictures; what is proved for the box is proved by its energy."""
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

    def __post_init__(self) -> None:
        if self.delay < 1:
            raise ValueError(f"expected a delay of a tick or more, found {self.delay}")

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports."""
        return self.network.ports

    @property
    def order(self) -> int:
        """Of the network's Rest, and the chain of late velocities."""
        return self.network.order + self.delay * len(self.ports)

    def environment(self, T: float) -> StateSpace:
        """E z^-d."""
        return delayed_system(self.network.environment(T), self.delay)

    def split(self, T: float) -> Split:
        """E_hat z^-d, split."""
        return delayed_split(self.network.split(T), self.delay, T)


@dataclass(frozen=True, eq=False)
class StateSpaceEnvironment(_Discretised):
    """An environment given by its matrices.

    Attributes:
        ports: names of the m ports.
        system: (A, B, C, D), m inputs (m), m outputs (N).
        method: how the continuous system is discretised; None for one that is discrete already.
        delay: whole ticks by which its forces are late.
    """

    ports: tuple[str, ...]
    system: StateSpace
    method: Method | None = None
    delay: int = 0

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
    """An environment given by rational functions of s, k + b s + M s^2 and the like.

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

    def __post_init__(self) -> None:
        m = len(self.ports)
        if len(self.entries) != m or any(len(row) != m for row in self.entries):
            raise ValueError(f"expected {m} rows of {m} entries")
        if any(not any(den) for row in self.entries for _, den in row):
            raise ValueError("expected no denominator to be zero")

    @property
    def order(self) -> int:
        """Of Rest: the degree of every entry, and the delay's chain."""
        degrees = (max(len(num), len(den)) - 1 for row in self.entries for num, den in row)
        return sum(degrees) + self.delay * len(self.ports)

    def discrete(self, T: float) -> StateSpace:
        """E without its delay, one companion form an entry."""
        return realise(tuple(tuple(substitute(entry, self.method, T) for entry in row) for row in self.entries))


@dataclass(frozen=True, eq=False)
class DeclaredEnvironment(WithoutEnergy):
    """An environment known by its declared level alone.

    Attributes:
        ports: names of the m ports.
        level: Phi_E, m x m symmetric, N*s/m; 0 for a passive environment, above 0 for one that lacks passivity.
        enforced: whether a passivity controller keeps that level at run time.

    Raises:
        ValueError: the level is not symmetric, or has not the ports' size.
    """

    ports: tuple[str, ...]
    level: Matrix
    enforced: bool = True

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
            Infeasible: nobody keeps it.
        """
        if not self.enforced:
            raise Infeasible(
                "the environment is a model of which nothing is proved, and its level is not enforced",
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
            "this needs the dynamics of the environment, and of a model nothing is known but its declared level",
            (
                "use an objective that asks nothing of the environment's dynamics: feasible or stiffest",
                "give the environment as a network or as matrices",
            ),
        )
