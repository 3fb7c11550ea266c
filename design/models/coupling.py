"""Virtual couplings V, from force f_v (N) to the displacement between hand and tool (m): a compliance.

**Spring-damper class** (20) of [Bianchini2010]_. The coupling

    V(z) = [K + B (z-1)/(Tz)]^{-1},    K stiffness (N/m), B damping (N*s/m), both symmetric,

is realised with xi+ = A_V xi + B_V f, y = C_V xi + D_V f, one state per port, by

    C_V = (T K + B)^{-1},   A_V = B C_V,   B_V = T A_V,   D_V = T C_V,        (21), corrected
    K = (I - A_V) C_V^{-1} / T,   B = A_V C_V^{-1}.                           (22)

The order in A_V = B C_V matters. The reverse order makes V(1) unsymmetric if K and B do not commute, and no such V can
be output strictly passive after the transformation (7).

**Block structure** BD(m; m_1, ..., m_N). It states which ports belong to which block of V. Blocks need not be
contiguous, nor follow the devices ([Bianchini2010]_, Remark 4). A matrix *has the structure* when every entry between
ports of different blocks is exactly zero.

**Loop transformation** (7)-(9) of [Bianchini2010]_. With a constant K (m x m, m/N), the haptic loop of G (device with
hand, sampled), V and E becomes a loop of

    G_hat = (z-1)/(Tz) [G + K],   V_hat = (z-1)/(Tz) [V - K],   E_hat = Tz/(z-1) E,

from force to velocity, force to velocity, velocity to force. The forces f_v of both loops are the same. The choice
K = T/2 Delta_D^{-1} (8) makes G_hat Delta_D-OSP (9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from manyhands.design.models.brief import brief_repr
from manyhands.design.models.statespace import Matrix, StateSpace, matrix, symmetric_part


@dataclass(frozen=True)
class Partition:
    """A partition of the ports 0 ... m-1 into named blocks.

    Attributes:
        names: one name for each block.
        blocks: the ports of each block, in the block's own order.

    Raises:
        ValueError: a port in no block or in two, an empty block, or two blocks of one name.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> blocks = passivity.Partition(("left", "right"), ((0, 2), (1,)))
        >>> [part.tolist() for part in blocks.restrict(np.diag([1.0, 2.0, 3.0]))]
        [[[1.0, 0.0], [0.0, 3.0]], [[2.0]]]
    """

    names: tuple[str, ...]
    blocks: tuple[tuple[int, ...], ...]

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        ports = sorted(port for block in self.blocks for port in block)
        if ports != list(range(len(ports))) or not all(self.blocks):
            raise ValueError(f"found the blocks {self.blocks}; expected every port in exactly one")
        if len(set(self.names)) != len(self.names) or len(self.names) != len(self.blocks):
            raise ValueError(f"found the names {self.names}; expected one of its own for each block")

    @property
    def size(self) -> int:
        """Number m of ports."""
        return sum(len(block) for block in self.blocks)

    def mask(self) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
        """A matrix, m x m, true where an entry joins two ports of the same block."""
        out = np.zeros((self.size, self.size), dtype=np.bool_)
        for block in self.blocks:
            out[np.ix_(block, block)] = True
        return out

    def admits(self, M: Matrix) -> bool:
        """Whether the m x m matrix M has the structure, exactly."""
        return not np.any(M[~self.mask()])

    def selections(self) -> tuple[Matrix, ...]:
        """S_i (m x m_i) for each block: S_i^T y are the block's entries of y."""
        return tuple(np.eye(self.size)[:, list(block)] for block in self.blocks)

    def restrict(self, M: Matrix) -> tuple[Matrix, ...]:
        """The diagonal blocks S_i^T M S_i of an m x m matrix."""
        return tuple(M[np.ix_(block, block)] for block in self.blocks)

    def embed(self, parts: Sequence[Matrix]) -> Matrix:
        """The m x m matrix with the structure whose blocks are ``parts``."""
        out = np.zeros((self.size, self.size))
        for block, part in zip(self.blocks, parts, strict=True):
            out[np.ix_(block, block)] = part
        return out

    def join(self, systems: Sequence[StateSpace]) -> StateSpace:
        """The system with the structure whose blocks are ``systems``, states stacked by block."""
        order = sum(s.order for s in systems)
        A, B = np.zeros((order, order)), np.zeros((order, self.size))
        C, D = np.zeros((self.size, order)), np.zeros((self.size, self.size))
        at = 0
        for block, s in zip(self.blocks, systems, strict=True):
            states, ports = range(at, at + s.order), list(block)
            A[np.ix_(states, states)], B[np.ix_(states, ports)] = s.A, s.B
            C[np.ix_(ports, states)], D[np.ix_(ports, ports)] = s.C, s.D
            at += s.order
        return StateSpace(A, B, C, D)


@dataclass(frozen=True, eq=False)
class SpringDamper:
    """A spring-damper coupling.

    Attributes:
        stiffness: K, m x m symmetric, N/m.
        damping: B, m x m symmetric, N*s/m; may be slightly negative in a certified coupling.

    Raises:
        ValueError: unequal shapes, not symmetric.

    Example:
        >>> from manyhands import passivity
        >>> V = passivity.SpringDamper([[1000.0]], [[0.3]]).realisation(T=0.001)
        >>> print(f"{1.0 / V.response(1.0)[0, 0].real:.0f} N/m at rest")
        1000 N/m at rest
    """

    stiffness: Matrix
    damping: Matrix

    __repr__ = brief_repr

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
        """The coupling in ports scaled by the symmetric S (f = S^{-1} f_s, x = S x_s): S K S, S B S."""
        return SpringDamper(symmetric_part(S @ self.stiffness @ S), symmetric_part(S @ self.damping @ S))

    def restrict(self, partition: Partition) -> tuple[SpringDamper, ...]:
        """The coupling's blocks, in the partition's order.

        Raises:
            ValueError: the coupling does not have the structure.
        """
        if not (partition.admits(self.stiffness) and partition.admits(self.damping)):
            raise ValueError("the coupling joins ports of different blocks")
        return tuple(
            SpringDamper(K, B)
            for K, B in zip(partition.restrict(self.stiffness), partition.restrict(self.damping), strict=True)
        )


def spring_damper_of(V: StateSpace, T: float) -> SpringDamper:
    """What a coupling is for slow motions: the K and B of V^{-1}(z) = K + B (z-1)/(Tz) + O((z-1)^2).

        K = V(1)^{-1},    B = T K C (I - A)^{-2} B_V K,    their symmetric parts

    For a coupling of springs and dampers they are its own, up to rounding.

    Args:
        V: discrete, force (N) to displacement (m), without a pole at z = 1.
        T: period, s.

    Raises:
        ValueError: V has a pole at z = 1, or V(1) is singular: no static stiffness exists.
    """
    try:
        shifted = np.linalg.solve(np.eye(V.order) - V.A, V.B)
        K = np.linalg.inv(V.C @ shifted + V.D)
        slope = V.C @ np.linalg.solve(np.eye(V.order) - V.A, shifted)
    except np.linalg.LinAlgError:
        raise ValueError("found a pole of V at z = 1, or a singular V(1); expected a static stiffness") from None
    return SpringDamper(symmetric_part(K), symmetric_part(T * K @ slope @ K))


CouplingBlock = SpringDamper | StateSpace
"""One block of V: springs and dampers, or a discrete linear system from force (N) to displacement (m)."""


def realisations(coupling: tuple[CouplingBlock, ...], T: float) -> tuple[StateSpace, ...]:
    """The blocks of V as discrete systems, for period T (s).

    Raises:
        ValueError: a block of springs and dampers has T K + B singular.
    """
    return tuple(part.realisation(T) if isinstance(part, SpringDamper) else part for part in coupling)


def loop_gain(Delta_D: ArrayLike, T: float, kappa: float = 0.5) -> Matrix:
    """K = kappa T Delta_D^{-1} of the loop transformation, m x m, m/N; kappa = 1/2, without delay, is (8).

    Args:
        Delta_D: symmetric positive definite, N*s/m.
        T: period, s.
        kappa: dimensionless.

    Example:
        >>> from manyhands import passivity
        >>> passivity.loop_gain([[1.37]], T=0.001).round(6).tolist()
        [[0.000365]]
    """
    return symmetric_part(kappa * T * np.linalg.inv(matrix(Delta_D)))


def transformed_device(G: StateSpace, K: Matrix, T: float) -> StateSpace:
    """G_hat = (z-1)/(Tz) [G + K], from force (N) to velocity (m/s).

    Example:
        >>> from manyhands import passivity
        >>> G = passivity.StateSpace([[0.5]], [[0.001]], [[1.0]], [[0.0]])
        >>> passivity.transformed_device(G, passivity.loop_gain([[1.37]], 0.001), T=0.001)
        StateSpace(A=[2 x 2], B=[2 x 1], C=[1 x 2], D=0.364964)
    """
    G = _in_z(G)
    return _difference(StateSpace(G.A, G.B, G.C, G.D + K), T)


def transformed_coupling(V: StateSpace, K: Matrix, T: float) -> StateSpace:
    """V_hat = (z-1)/(Tz) [V - K], from force (N) to velocity (m/s), in the realisation (12).

    The state is (xi, u_{k-1}): the state of V, then the force of the tick before.

    Example:
        >>> from manyhands import passivity
        >>> V, K = passivity.StateSpace.static([[1.0 / 1000.0]]), passivity.loop_gain([[1.37]], 0.001)
        >>> passivity.analyse(passivity.transformed_coupling(V, K, T=0.001)).holds
        True
    """
    V = _in_z(V)
    return _difference(StateSpace(V.A, V.B, V.C, V.D - K), T)


def transformed_environment(E: StateSpace, T: float) -> StateSpace:
    """E_hat = Tz/(z-1) E, from velocity (m/s) to force (N), with the state (eta, x_e of the tick before).

    This realisation is general, but not minimal if the state of E contains x_e already. A network has a minimal one,
    :meth:`manyhands.design.models.network.Network.transformed_environment`.

    Example:
        >>> from manyhands import passivity
        >>> wall = passivity.StateSpace.static([[1000.0]])
        >>> passivity.analyse(passivity.transformed_environment(wall, T=0.001)).holds
        True
    """
    E = _in_z(E)
    n, m = E.order, E.inputs
    return StateSpace(
        np.block([[E.A, E.B], [np.zeros((m, n)), np.eye(m)]]),
        T * np.vstack([E.B, np.eye(m)]),
        np.hstack([E.C, E.D]),
        T * E.D,
    )


def _in_z(system: StateSpace) -> StateSpace:
    """A system of this or of another library, in discrete time.

    Raises:
        ValueError: it is in continuous time, or no linear system.
    """
    if isinstance(system, StateSpace):
        return system
    if getattr(system, "dt", None) == 0:
        raise ValueError("found a system in continuous time, dt = 0; expected one in z, with the session's period")
    return StateSpace.of(system)


def _difference(S: StateSpace, T: float) -> StateSpace:
    """(z-1)/(Tz) S, with the input of the tick before as additional states, as in (12).

    With zeta_k = (xi_k - xi_{k-1})/T for the state xi of S, from rest,

        zeta_{k+1} = A zeta_k + B (u_k - u_{k-1})/T,    y_k = C zeta_k + D (u_k - u_{k-1})/T.
    """
    n, p = S.order, S.inputs
    return StateSpace(
        np.block([[S.A, -S.B / T], [np.zeros((p, n + p))]]),
        np.vstack([S.B / T, np.eye(p)]),
        np.hstack([S.C, -S.D / T]),
        S.D / T,
    )
