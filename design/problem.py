"""What a certificate is about: the physical data of one haptic loop and what is asked of its coupling.

The certificate stores exactly this, so that a proof can start from the physical data and not from state-space matrices
that some program derived from them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.levels.contract import NO_DELAY_GAIN
from manyhands.design.levels.dry_friction import DryFriction
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.levels.mechanism import NothingLeft, promised_level
from manyhands.design.levels.orientation import OrientationLevel
from manyhands.design.models.axis import Units, units_of
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import Partition, SpringDamper, loop_gain
from manyhands.design.models.integrators import Split
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import Matrix, StateSpace, matrix, symmetric_part
from manyhands.design.models.weights import Transparency

_BELOW = 1e-12  # relative, thousands of times the rounding of an eigenvalue

MECHANISM: Final = ("held", "step", "friction")
"""What may be stated of a device besides its level: attributes of :class:`DeviceLevel`, and keys of certificates."""

STATED: Final = (*MECHANISM, "turning", "orientation")
"""Likewise, with which of its ports turn, and with its orientation: what a certificate of version 6 may have."""


@dataclass(frozen=True, eq=False)
class DeviceLevel:
    """A device (with the passive hand that holds it) and the level it promises, Assumption 1(a).

    Attributes:
        name: the device's name.
        ports: its ports, as indices into the loop's m ports.
        level: Delta_Di, m_i x m_i symmetric positive definite, N*s/m.
        held: how its motors hold a force, where they hold torques; None where they hold the force itself.
        step: of its encoder, one entry for each port, m; None where no port has one.
        friction: what it burns at least besides its level, as a force against its velocity, by port, N; None for 0.
        turning: those of its ports that turn, as indices into the loop's ports: their units are of
            :class:`.Units`. None where none does.
        orientation: that of a tool that its hand turns in space; None where it is no port.

    Raises:
        ValueError: the level is not symmetric positive definite, or a step or a friction is negative, not finite, or
            not one for each port, or another port turns.
    """

    name: str
    ports: tuple[int, ...]
    level: Matrix
    held: HeldTorque | None = None
    step: tuple[float, ...] | None = None
    friction: tuple[float, ...] | None = None
    turning: tuple[int, ...] | None = None
    orientation: OrientationLevel | None = None

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        m = len(self.ports)
        if self.turning is not None and (not self.turning or not {*self.turning} <= {*self.ports}):
            raise ValueError(f"{self.name}: turning: found {self.turning}; expected some of {self.ports}")
        object.__setattr__(self, "level", matrix(self.level, m, m))
        if np.any(self.level != self.level.T) or np.linalg.eigvalsh(self.level)[0] <= 0.0:
            raise ValueError(f"{self.name}: expected a symmetric positive definite OSP level")
        for what, stated in (("step", self.step), ("friction", self.friction)):
            if stated is not None and not (len(stated) == m and all(0.0 <= x < np.inf for x in stated) and any(stated)):
                expected = f"{m} finite numbers, none negative and one greater than 0"
                raise ValueError(f"{self.name}: {what}: found {stated}; expected {expected}")

    @property
    def of_mechanism(self) -> bool:
        """Whether more than a level is stated: one of :data:`STATED`."""
        return any(getattr(self, stated) is not None for stated in STATED)

    @property
    def units(self) -> Units:
        """The units of its ports together."""
        return units_of(self.ports, self.turning or ())


Objective = Literal["feasible", "stiffest", "loop-shaping", "closed-loop"]
Algorithm = Literal["convex", "complementarity"]
MOST_ITERATIONS = 200


@dataclass(frozen=True)
class Wish:
    """The criteria by which a search chooses a coupling.

    Attributes:
        objective: "feasible" (well inside every condition), "stiffest", or a transparency problem.
        aim: the transparency problem; None for "feasible" and "stiffest".
        algorithm: "convex"; or "complementarity", the paper's own, only with "feasible".
        iterations: cap on the iterations of "complementarity".
    """

    objective: Objective = "feasible"
    aim: Transparency | None = None
    algorithm: Algorithm = "convex"
    iterations: int = MOST_ITERATIONS

    def __post_init__(self) -> None:
        wanted = None if self.objective in ("feasible", "stiffest") else self.objective
        if (None if self.aim is None else self.aim.objective) != wanted:
            raise ValueError(
                f"objective {self.objective!r}: expected weights for a transparency problem, and only there"
            )
        if self.algorithm == "complementarity" and self.objective != "feasible":
            raise ValueError("complementarity: expected objective 'feasible'")


@dataclass(frozen=True)
class SpringDamperWanted:
    """Find a coupling of the spring-damper class (20) with the loop's block structure."""

    wish: Wish = Wish()


@dataclass(frozen=True)
class PolePair:
    """A pair of poles of a coupling: s^2 + 2 damping frequency s + frequency^2.

    Attributes:
        frequency: rad/s, > 0.
        damping: damping ratio in (0, 1]; 1 makes a double real pole.
    """

    frequency: float
    damping: float = 1.0


@dataclass(frozen=True)
class LinearWanted:
    """Find a linear coupling of given order with the loop's block structure.

    Attributes:
        orders: states per port, for each block.
        wish: the criteria of the search.
        poles: fixed pairs of poles, the same for every block; None lets the design choose them.
    """

    orders: tuple[int, ...]
    wish: Wish = Wish()
    poles: tuple[PolePair, ...] | None = None


@dataclass(frozen=True, eq=False)
class SpringDamperGiven:
    """Certify this spring-damper coupling, and its transparency where an aim is stated."""

    coupling: SpringDamper
    aim: Transparency | None = None

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class LinearGiven:
    """Certify this linear coupling, one system for each block in the partition's order, with its aim if it has one."""

    blocks: tuple[StateSpace, ...]
    aim: Transparency | None = None

    __repr__ = brief_repr


@dataclass(frozen=True)
class NoCoupling:
    """f_v = -E x: V = 0. This cannot be certified, because V_hat = -(z-1)/(Tz) K is not OSP."""


CouplingRequest = SpringDamperWanted | LinearWanted | SpringDamperGiven | LinearGiven | NoCoupling


_SERIES = {"part": ("a number from 0 to less than 1", 1.0), "compliance": ("a compliance of 0 or more", np.inf)}
"""What may be counted in series at a port, in words, and what it is less than."""


@dataclass(frozen=True, eq=False)
class HapticLoop:
    """The loop of Fig. 1: devices with hands, a coupling of given structure, an environment.

    Attributes:
        session: name of the session.
        period: T, s.
        ports: names of the m ports.
        devices: their levels; together they cover every port once.
        partition: the blocks of V.
        environment: the environment, with the same ports in the same order.
        tau: longest delay inside the tick to be certified, from the sample of x(k) until f_v(k) acts, s, at most T.
        period_tolerance: rho; the periods to be certified are at most (1 + rho) T; dimensionless, 0 ... 1.
        series: by port, what of the world's compliance is counted in series with the coupling; empty if nothing is
            counted (docs/decisions/0045-series-compliance.md). Of a network it is the part of the compliance of the
            port's own link, 0 ... 1; of a state space or rational functions it is a compliance, m/N.
        speed: v*, m/s: the devices' dry friction counts as damping, and the claim holds while every axis is slower;
            None for a claim about every motion.
        kept: by port, how much of the dry friction is kept for the steps of encoders, N; None while that is not
            settled, and the levels count no friction.
    """

    session: str
    period: float
    ports: tuple[str, ...]
    devices: tuple[DeviceLevel, ...]
    partition: Partition
    environment: Environment
    tau: float = 0.0
    period_tolerance: float = 0.0
    series: tuple[float, ...] = ()
    speed: float | None = None
    kept: tuple[float, ...] | None = None

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        m = len(self.ports)
        if m == 0:
            raise ValueError("expected at least one port")
        if sorted(p for d in self.devices for p in d.ports) != list(range(m)):
            raise ValueError("expected the devices to cover every port exactly once")
        if self.partition.size != m or self.environment.ports != self.ports:
            raise ValueError("expected partition and environment to have the loop's ports")
        if not 0.0 < self.period < np.inf:
            raise ValueError("expected a positive period")
        if not 0.0 <= self.tau <= self.period:
            raise ValueError(f"found a delay of {self.tau} s; expected 0 to the period")
        if not 0.0 <= self.period_tolerance <= 1.0:
            raise ValueError(f"found the period tolerance {self.period_tolerance}; expected 0 to 1")
        if self.series:
            self._check_series()
        if self.speed is not None and not 0.0 < self.speed < np.inf:
            raise ValueError(f"speed: found {self.speed}; expected a finite number greater than 0")
        if self.kept is not None and (len(self.kept) != m or not all(0.0 <= w < np.inf for w in self.kept)):
            raise ValueError(f"kept: found {self.kept}; expected {m} finite numbers of 0 or more")

    def _check_series(self) -> None:
        counts = self.environment.counts
        if counts is None:
            expected = "an environment without delay that is a network, a state space or rational functions"
            raise ValueError(f"series: expected {expected}")
        number, most = _SERIES[counts]
        if len(self.series) != len(self.ports) or not all(0.0 <= value < most for value in self.series):
            raise ValueError(f"series: found {self.series}; expected {number} for each port")
        if not any(self.series):
            raise ValueError(f"series: expected a {counts} greater than 0 for some port, or no series at all")
        contacts = self.environment.contacts()
        missing = [port for port in self.parts if counts == "part" and port not in contacts]
        if missing:
            expected = "a port that one spring joins to a mass or to ground"
            raise ValueError(f"series: found {missing[0]}; expected {expected}")

    @cached_property
    def turning(self) -> frozenset[str]:
        """The names of the ports that turn."""
        return frozenset(self.ports[port] for device in self.devices for port in device.turning or ())

    def units(self, *ports: str) -> Units:
        """The units of what is said of these ports together; of all of them, if none is named."""
        return units_of(ports or self.ports, self.turning)

    @property
    def parts(self) -> dict[str, float]:
        """``series`` by the name of the port, where it is not 0."""
        return {port: part for port, part in zip(self.ports, self.series, strict=False) if part}

    @cached_property
    def cut(self) -> HapticLoop:
        """The same loop, cut inside the world's compliance that is counted: Theorem 3 is applied to it, and it is run.

        Its environment is the world without that compliance, and its coupling contains it. It is the loop itself if
        nothing is counted.
        """
        return replace(self, environment=self.environment.stiffened(self.parts), series=()) if self.series else self

    @cached_property
    def counted(self) -> StateSpace:
        """C, what is counted of the world's compliance, from force (N) to displacement (m), m x m."""
        return self.environment.nominal.counted(self.parts, self.period)

    def without_counted(self, V: StateSpace) -> StateSpace:
        """V less :attr:`counted`: the coupling itself, of the coupling that is run; states of V, then those of C."""
        return V if not self.series else V.minus(self.counted)

    @property
    def punctual(self) -> bool:
        """Whether every force is to act at its sample and no period to exceed T, which is the paper's case."""
        return self.tau == 0.0 and self.period_tolerance == 0.0

    @cached_property
    def Delta_D_blocks(self) -> tuple[Matrix, ...]:
        """Delta_D of (6) by block of V, m_i x m_i, N*s/m: the devices' levels brought to the coupling's structure.

        Where two blocks of V split a device whose level joins their ports, the level of that device is replaced by its
        least eigenvalue times the identity. Delta-OSP implies Delta'-OSP for every Delta' <= Delta, and each block can
        then keep its promise with its own data alone. Of a device that holds torques it is what these leave. Below
        :attr:`speed` it is more by what dry friction stands for.

        Raises:
            Infeasible: held torques leave nothing of a device's level.
        """
        block_of = {port: i for i, block in enumerate(self.partition.blocks) for port in block}
        place = {port: (i, j) for i, block in enumerate(self.partition.blocks) for j, port in enumerate(block)}
        out = [np.zeros((len(block), len(block))) for block in self.partition.blocks]
        for device in self.devices:
            level = self._left(device)
            owners = np.array([block_of[p] for p in device.ports])
            if np.any(level[owners[:, None] != owners[None, :]]):
                # slightly less, so that it is below the level in exact arithmetic too
                level = np.linalg.eigvalsh(level)[0] * (1.0 - _BELOW) * np.eye(len(device.ports))
            for a, p in enumerate(device.ports):
                for b, q in enumerate(device.ports):
                    if owners[a] == owners[b]:
                        out[place[p][0]][place[p][1], place[q][1]] = level[a, b]
        return tuple(matrix(M) for M in out)

    def _left(self, device: DeviceLevel) -> Matrix:
        """The level of a device with what its friction adds, less what its held torques may give out, N*s/m."""
        friction, times = None, (self.period, self.tau, self.period_tolerance)
        if self.kept is not None and device.friction is not None:
            friction = DryFriction(device.friction, tuple(self.kept[port] for port in device.ports), self.speed)
        try:
            return promised_level(device.level, device.held, friction, *times)
        except NothingLeft as error:
            raise self._uncertifiable(device, error) from error

    def _uncertifiable(self, device: DeviceLevel, nothing: NothingLeft) -> Infeasible:
        """The error of a device of which held torques leave nothing."""
        held, d, u = device.held, nothing.taken, device.units
        if held is None:
            raise AssertionError("only held torques take of a level")
        if not np.isfinite(d):
            slower = 2.0 / (held.kappa * ((1.0 + self.period_tolerance) * self.period + self.tau))
            return Infeasible(
                f"at {held.speed:.4g} {u('m/s')} the tip of {device.name} may turn too far while its torques are held; "
                f"expected a limit of speed well below {slower:.4g} {u('m/s')}, all axes together "
                "(docs/decisions/0050-held-torques.md)"
            )
        return Infeasible(
            f"the held torques of {device.name} may give out what {d:.4g} {u('N·s/m')} of damping take up, and it has "
            f"{nothing.least:.4g} (docs/decisions/0050-held-torques.md)"
        )

    @property
    def enforced(self) -> tuple[str, ...]:
        """The parties whose level is not proved; a passivity controller enforces it at run time."""
        return ("environment",) if self.environment.controlled else ()

    @cached_property
    def split(self) -> Split:
        """E_hat without its integrators, computed once; raises Infeasible if E_hat is passive at no level."""
        return self.environment.split(self.period)

    @cached_property
    def Delta_D(self) -> Matrix:
        """Delta_D with the coupling's structure, m x m, N*s/m.

        Raises:
            Infeasible: as for :attr:`Delta_D_blocks`.
        """
        return self.partition.embed(self.Delta_D_blocks)

    def Delta_D_at(self, T: float, tau: float, period_tolerance: float | None = None) -> Matrix | None:
        """Delta_D at another period (s), delay (s) and tolerance; None where held torques leave nothing of a level."""
        if not any(device.held for device in self.devices):
            return self.Delta_D
        rho = self.period_tolerance if period_tolerance is None else period_tolerance
        try:
            return replace(self, period=T, tau=tau, period_tolerance=rho).Delta_D
        except Infeasible:
            return None

    def loop_gain(self, kappa: float) -> tuple[Matrix, ...]:
        """K = kappa T Delta_D^{-1} by block of V, m_i x m_i, m/N; kappa = 1/2 is (8)."""
        return tuple(loop_gain(Delta, self.period, kappa) for Delta in self.Delta_D_blocks)

    @cached_property
    def K(self) -> Matrix:
        """K = T/2 Delta_D^{-1} of the transformation (8), without delay, m x m, m/N."""
        return self.partition.embed(self.loop_gain(NO_DELAY_GAIN))

    @cached_property
    def scaling(self) -> Matrix:
        """S = Delta_D^{-1/2}, symmetric, with the coupling's structure: in ports scaled by S, Delta_D = I."""
        out = []
        for Delta in self.Delta_D_blocks:
            values, vectors = np.linalg.eigh(Delta)
            out.append(symmetric_part(vectors @ np.diag(values**-0.5) @ vectors.T))
        return self.partition.embed(out)
