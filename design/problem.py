"""What a certificate is about: the physical data of one haptic loop and what is asked of its coupling.

The certificate stores exactly this, so that a check can start from the physics and not from somebody's
state-space matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manyhands.design.coupling import SpringDamper
from manyhands.design.network import Network
from manyhands.design.partition import Partition
from manyhands.design.statespace import Matrix, StateSpace, matrix, symmetric_part
from manyhands.design.transformation import loop_gain


@dataclass(frozen=True, eq=False)
class DeviceLevel:
    """A device (with the passive hand that holds it) and the level it promises, Assumption 1(a).

    Attributes:
        name: the device's name.
        ports: its ports, as indices into the loop's m ports.
        level: Delta_Di, m_i x m_i symmetric positive definite, N*s/m.
    """

    name: str
    ports: tuple[int, ...]
    level: Matrix

    def __post_init__(self) -> None:
        m = len(self.ports)
        object.__setattr__(self, "level", matrix(self.level, m, m))
        if np.any(self.level != self.level.T) or np.linalg.eigvalsh(self.level)[0] <= 0.0:
            raise ValueError(f"{self.name}: expected a symmetric positive definite OSP level")


@dataclass(frozen=True)
class SpringDamperWanted:
    """Find a coupling of the spring-damper class (20) with the loop's block structure."""


@dataclass(frozen=True, eq=False)
class SpringDamperGiven:
    """Certify this spring-damper coupling."""

    coupling: SpringDamper


@dataclass(frozen=True, eq=False)
class LinearGiven:
    """Certify this linear coupling: one system for each block, in the partition's order."""

    blocks: tuple[StateSpace, ...]


@dataclass(frozen=True)
class NoCoupling:
    """f_v = -E x: V = 0. Cannot be certified, for V_hat = -(z-1)/(Tz) K is not OSP."""


CouplingRequest = SpringDamperWanted | SpringDamperGiven | LinearGiven | NoCoupling


@dataclass(frozen=True, eq=False)
class HapticLoop:
    """The loop of Fig. 1: devices with hands, a coupling of given structure, an environment.

    Attributes:
        session: name of the session it belongs to.
        period: T, s.
        ports: names of the m ports.
        devices: their levels; together they cover every port once.
        partition: the blocks of V.
        network: the environment, with the same ports in the same order.
    """

    session: str
    period: float
    ports: tuple[str, ...]
    devices: tuple[DeviceLevel, ...]
    partition: Partition
    network: Network

    def __post_init__(self) -> None:
        m = len(self.ports)
        if m == 0:
            raise ValueError("expected at least one port")
        if sorted(p for d in self.devices for p in d.ports) != list(range(m)):
            raise ValueError("expected the devices to cover every port exactly once")
        if self.partition.size != m or self.network.ports != self.ports:
            raise ValueError("expected partition and network to have the loop's ports")
        if not 0.0 < self.period < np.inf:
            raise ValueError("expected a positive period")

    @cached_property
    def Delta_D(self) -> Matrix:
        """blockdiag(Delta_Di) of (6), m x m, N*s/m, brought to the coupling's structure.

        Where two blocks of V split a device whose level joins their ports, the level of that device is
        replaced by its least eigenvalue times the identity: Delta-OSP implies Delta'-OSP for every
        Delta' <= Delta, and each block can then keep its promise from its own data.
        """
        m = len(self.ports)
        out = np.zeros((m, m))
        mask = self.partition.mask()
        for device in self.devices:
            level = device.level
            if np.any(level[~mask[np.ix_(device.ports, device.ports)]]):
                level = np.linalg.eigvalsh(level)[0] * np.eye(len(device.ports))
            out[np.ix_(device.ports, device.ports)] = level
        return out

    @cached_property
    def K(self) -> Matrix:
        """The transformation's K = T/2 Delta_D^{-1} (8), m x m, m/N."""
        return loop_gain(self.Delta_D, self.period)

    @cached_property
    def scaling(self) -> Matrix:
        """S = Delta_D^{-1/2}, symmetric, with the coupling's structure: in ports scaled by S, Delta_D = I."""
        values, vectors = np.linalg.eigh(self.Delta_D)
        S = symmetric_part(vectors @ np.diag(values**-0.5) @ vectors.T)
        return np.where(self.partition.mask(), S, 0.0)  # exactly, not up to rounding

    @cached_property
    def E_hat(self) -> StateSpace:
        """The transformed environment in energy coordinates."""
        return self.network.transformed_environment(self.period)
