"""Virtual couplings V, from force f_v (N) to the displacement between hand and tool (m): a compliance.

The spring-damper class (20) of [Bianchini2010]_,

    V(z) = [K + B (z-1)/(Tz)]^{-1},    K stiffness (N/m), B damping (N*s/m), both symmetric,

is realised with xi+ = A_V xi + B_V f, y = C_V xi + D_V f, one state a port, by

    C_V = (T K + B)^{-1},   A_V = B C_V,   B_V = T A_V,   D_V = T C_V,        (21), mended
    K = (I - A_V) C_V^{-1} / T,   B = A_V C_V^{-1}.                           (22)

A_V = B C_V in this order: the other one makes V(1) unsymmetric for noncommuting K and B, and no such V
can be output strictly passive after the transformation (7).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manyhands.design.partition import Partition
from manyhands.design.statespace import Matrix, StateSpace, matrix, symmetric_part


@dataclass(frozen=True, eq=False)
class SpringDamper:
    """A spring-damper coupling.

    Attributes:
        stiffness: K, m x m symmetric, N/m.
        damping: B, m x m symmetric, N*s/m; may be slightly negative in a certified coupling.

    Raises:
        ValueError: unequal shapes, not symmetric.
    """

    stiffness: Matrix
    damping: Matrix

    def __post_init__(self) -> None:
        K = matrix(self.stiffness)
        object.__setattr__(self, "stiffness", matrix(K, K.shape[0], K.shape[0]))
        object.__setattr__(self, "damping", matrix(self.damping, K.shape[0], K.shape[0]))
        if np.any(self.stiffness != self.stiffness.T) or np.any(self.damping != self.damping.T):
            raise ValueError("expected symmetric stiffness and damping")

    def realisation(self, T: float) -> StateSpace:
        """(A_V, B_V, C_V, D_V) of (21) for period T (s).

        Raises:
            ValueError: T K + B is singular, so that V does not exist.
        """
        impedance = T * self.stiffness + self.damping
        if not np.linalg.cond(impedance) < 1e12:
            raise ValueError("T K + B is singular: a coupling needs a positive stiffness or damping in every direction")
        C = symmetric_part(np.linalg.inv(impedance))
        A = self.damping @ C
        return StateSpace(A, T * A, C, T * C)

    @classmethod
    def from_realisation(cls, A_V: Matrix, C_V: Matrix, T: float) -> SpringDamper:
        """K and B by (22), their symmetric parts."""
        inverse = np.linalg.inv(C_V)
        m = A_V.shape[0]
        return cls(symmetric_part((np.eye(m) - A_V) @ inverse / T), symmetric_part(A_V @ inverse))

    def scaled(self, S: Matrix) -> SpringDamper:
        """The coupling seen from ports scaled by the symmetric S (f = S^{-1} f_s, x = S x_s): S K S, S B S."""
        return SpringDamper(symmetric_part(S @ self.stiffness @ S), symmetric_part(S @ self.damping @ S))

    def restrict(self, partition: Partition) -> tuple[SpringDamper, ...]:
        """The coupling's blocks.

        Raises:
            ValueError: the coupling does not have the structure.
        """
        if not (partition.admits(self.stiffness) and partition.admits(self.damping)):
            raise ValueError("the coupling joins ports of different blocks")
        return tuple(
            SpringDamper(K, B)
            for K, B in zip(partition.restrict(self.stiffness), partition.restrict(self.damping), strict=True)
        )


CouplingBlock = SpringDamper | StateSpace
"""One block of V: springs and dampers, or a discrete linear system from force (N) to displacement (m)."""


def realisations(coupling: tuple[CouplingBlock, ...], T: float) -> tuple[StateSpace, ...]:
    """The blocks of V as discrete systems, for period T (s).

    Raises:
        ValueError: a block of springs and dampers has T K + B singular.
    """
    return tuple(part.realisation(T) if isinstance(part, SpringDamper) else part for part in coupling)
