"""The normalised loop, in which the families of couplings are searched: scaled ports, scaled time.

Ports are scaled by S = Delta_D^{-1/2} and time by the period T. A coupling is V = T S v S with v of order one, and the
loop gain K = kappa T Delta_D^{-1} becomes kappa I.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from manyhands.design.hinfinity import frequency_grid
from manyhands.design.partition import Partition
from manyhands.design.statespace import Matrix, StateSpace, symmetric_part
from manyhands.design.weighted_loop import Transparency, WeightedLoop
from manyhands.design.weights import Filter

ComplexArray = NDArray[np.complex128]

UNWEIGHTED = Transparency("loop-shaping", Filter.one(), Filter.one())


@dataclass(frozen=True, eq=False)
class NormalisedLoop:
    """The data of a transparency problem, and the way from normalised blocks v to the weighted loop.

    Attributes:
        E: the environment, discrete and stable, displacement (m) to force (N), m x m.
        Delta_D: the level of the devices, m x m, N*s/m, symmetric positive definite, with the partition's structure.
        kappa: positive; the loop gain is K = kappa T Delta_D^{-1} (m/N), and kappa is 1/2 without delay.
        T: period, s.
        partition: which of the m ports each block of the coupling V has.
        aim: objective and weights of the transparency problem; left out where only levels are asked for.
        scaling: S_i = Delta_D,i^{-1/2} of each block, m_i x m_i, symmetric, (N*s/m)^{-1/2}; computed from Delta_D.

    Raises:
        ValueError: sizes that differ, an unstable E, Delta_D without the structure or not positive definite, kappa or
            T not positive.
    """

    E: StateSpace
    Delta_D: Matrix
    kappa: float
    T: float
    partition: Partition
    aim: Transparency = UNWEIGHTED
    scaling: tuple[Matrix, ...] = field(init=False)

    def __post_init__(self) -> None:
        m, E, Delta_D = self.partition.size, self.E, self.Delta_D
        if E.inputs != m or E.outputs != m or Delta_D.shape != (m, m):
            raise ValueError(
                f"expected E and Delta_D of {m} ports, found {E.outputs} x {E.inputs} and "
                f"{Delta_D.shape[0]} x {Delta_D.shape[1]}"
            )
        radius = float(np.max(np.abs(np.linalg.eigvals(E.A)), initial=0.0))
        if not radius < 1.0:
            raise ValueError(
                f"environment: found a pole of modulus {radius:.9g}, expected a stable E; a mass that no link holds "
                "cannot be felt and may be left out"
            )
        if not (self.T > 0.0 and self.kappa > 0.0):
            raise ValueError(f"expected a positive period and kappa, found {self.T} and {self.kappa}")
        if not self.partition.admits(Delta_D) or np.any(Delta_D != Delta_D.T):
            raise ValueError("expected a symmetric Delta_D that joins no ports of different blocks")
        scaling = []
        for name, part in zip(self.partition.names, self.partition.restrict(Delta_D), strict=True):
            values, vectors = np.linalg.eigh(part)
            if not values[0] > 0.0:
                raise ValueError(f"coupling {name}: found a least eigenvalue {values[0]:.3g} of Delta_D, expected > 0")
            scaling.append(symmetric_part(vectors @ np.diag(values**-0.5) @ vectors.T))
        object.__setattr__(self, "scaling", tuple(scaling))

    @cached_property
    def weighted(self) -> WeightedLoop:
        """E with the weights."""
        return WeightedLoop(self.E, self.aim)

    def grid(self, V: StateSpace) -> Matrix:
        """Angles that separate the peaks of the weighted loop with the coupling V (physical units)."""
        return frequency_grid(np.concatenate([self.weighted.poles(), self.weighted.poles_with(V)]))

    def coupling(self, v: Sequence[ComplexArray], count: int) -> ComplexArray:
        """V from the responses v of the blocks, angles x m x m."""
        out = np.zeros((count, self.partition.size, self.partition.size), dtype=np.complex128)
        for ports, S, block in zip(self.partition.blocks, self.scaling, v, strict=True):
            out[:, np.array(ports)[:, None], np.array(ports)] = self.T * S @ block @ S
        return out

    def derivatives(self, v: Sequence[ComplexArray], slopes: Sequence[ComplexArray], angles: Matrix) -> ComplexArray:
        """DG for derivatives dv of the blocks (angles x unknowns of the block x m_i x m_i), unknowns block by block."""
        _, L, R = self.weighted.factors(self.coupling(v, len(angles)), angles)
        parts = []
        for ports, S, slope in zip(self.partition.blocks, self.scaling, slopes, strict=True):
            left = self.T * L[:, :, list(ports)] @ S
            right = S @ R[:, list(ports), :]
            parts.append(left[:, None] @ slope @ right[:, None])
        return np.concatenate(parts, axis=1)

    def physical(self, v: StateSpace, block: int) -> StateSpace:
        """T S v S for a block with B = b kron I: C_j and D stay symmetric, exactly."""
        S, m = self.scaling[block], v.inputs
        parts = [symmetric_part(self.T * S @ v.C[:, j : j + m] @ S) for j in range(0, v.order, m)]
        C = np.concatenate([*parts, np.zeros((m, 0))], axis=1)
        return StateSpace(v.A, v.B, C, symmetric_part(self.T * S @ v.D @ S))

    def storage(self, P: Matrix, block: int) -> Matrix:
        """T^2 (I kron S) P (I kron S): the block's P in physical units, for zeta = (xi - xi_)/T."""
        S = self.scaling[block]
        wide = np.kron(np.eye(len(P) // len(S)), S)
        return symmetric_part(self.T**2 * wide @ P @ wide)
