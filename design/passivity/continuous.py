"""Continuous time: Definition 1, Lemma 3 and Theorem 1 of [Bianchini2010]_, for linear devices and hands.

A linear system d psi/dt = A psi + B u, y = C psi + D u has the levels Delta and Phi with storage psi^T P psi iff

    N(P) = [ A^T P + P A + C^T Delta C    P B - C^T/2 + C^T Delta D              ]
           [ .                            -(D + D^T)/2 + D^T Delta D + Phi       ]  <= 0,    P > 0.

A device goes from force (N) to velocity (m/s); its Delta is a damping in N*s/m: a mass with a damper b is b-OSP.

**Lemma 3.** A Delta_D-OSP device D in feedback with a passive hand H,

    v = D (f - f_h),    f_h = H v,

is Delta_D-OSP, with the storage of both: along its motions N of the whole is the sum

    N_D at (psi_D, f - f_h)  +  N_H at (psi_H, v)  <=  0,

since the two supplies v^T (f - f_h) - v^T Delta_D v and f_h^T v add to v^T f - v^T Delta_D v.

**Theorem 1.** Devices side by side are blockdiag(Delta_D1, ...)-OSP, again with the sum of the storages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.statespace import (
    Matrix,
    StateSpace,
    block_diagonal,
    matrix,
    parallel_blocks,
    require_state_space,
    symmetric_part,
)
from manyhands.design.passivity.best_level import ProvedLevel, Shape, greatest_output_level
from manyhands.design.passivity.lemma1 import analyse, checked_levels

_ROUNDING = 1e-8  # of its largest term, in states where P = I: allowed excess of an inequality that contains equalities


@dataclass(frozen=True, eq=False)
class Dissipative:
    """A continuous system with a storage matrix that proves its output level (Definition 1).

    Attributes:
        system: (A, B, C, D), force to velocity for a device, velocity to force for a hand.
        P: n x n positive definite.
        Delta: m x m output level; zero for a system that is only passive.

    Raises:
        ValueError: P or Delta has the wrong shape, P is not positive definite, or N(P) <= 0 fails.

    Example:
        >>> from manyhands import passivity
        >>> passivity.mass_with_damping([[0.2]], [[1.37]])
        Dissipative(system=StateSpace(A=-6.85, B=5, C=1, D=0), P=0.1, Delta=1.37)
    """

    system: StateSpace
    P: Matrix
    Delta: Matrix

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        n = self.system.order
        Delta, _ = checked_levels(self.system, self.Delta, None)
        object.__setattr__(self, "Delta", Delta)
        object.__setattr__(self, "P", matrix(symmetric_part(matrix(self.P, n, n)), n, n))
        excess = self.excess()
        if not excess <= _ROUNDING:
            raise ValueError(f"P does not prove the output level: N(P) has the relative eigenvalue {excess:.3g} > 0")

    def excess(self) -> float:
        """The greatest eigenvalue of N(P) in states where P = I, relative to its largest term."""
        try:
            X = np.linalg.cholesky(self.P).T if self.system.order else self.P
        except np.linalg.LinAlgError:
            raise ValueError("expected a positive definite storage matrix P") from None
        inverse = np.linalg.inv(X)
        own = StateSpace(X @ self.system.A @ inverse, X @ self.system.B, self.system.C @ inverse, self.system.D)
        N = continuous_storage_inequality(own, np.eye(own.order), self.Delta)
        largest = max(float(np.max(np.abs(M), initial=0.0)) for M in (own.A, own.B, own.C, own.D, N))
        return float(np.linalg.eigvalsh(symmetric_part(N))[-1]) / max(largest, 1e-300)


def continuous_storage_inequality(
    system: StateSpace, P: Matrix, Delta: Matrix | None = None, Phi: Matrix | None = None
) -> Matrix:
    """The matrix N(P), (n+m) x (n+m); Delta and Phi default to zero (passivity).

    Args:
        system: (A, B, C, D) in continuous time, m x m.
        P: n x n symmetric.
        Delta: m x m, output level.
        Phi: m x m, input level.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> device = passivity.mass_with_damping([[0.2]], [[1.37]])
        >>> passivity.continuous_storage_inequality(device.system, device.P, device.Delta).round(12).tolist()
        [[0.0, 0.0], [0.0, 0.0]]
    """
    Delta, Phi = checked_levels(system, Delta, Phi)
    A, B, C, D = system.A, system.B, system.C, system.D
    off = P @ B - C.T / 2.0 + C.T @ Delta @ D
    return np.block(
        [
            [A.T @ P + P @ A + C.T @ Delta @ C, off],
            [off.T, -(D + D.T) / 2.0 + D.T @ Delta @ D + Phi],
        ]
    )


def device_level(system: StateSpace, shape: Shape = "matrix") -> ProvedLevel:
    """The greatest Delta_D with which a linear device is OSP (Definition 1), greatest trace unless "scalar".

    Args:
        system: the device alone, force (N) to velocity (m/s).
        shape: which Delta_D are allowed.

    Raises:
        Infeasible: no level of this shape exists.
        SolverFailure: the solver gave no usable answer.

    Example:
        >>> from manyhands import passivity
        >>> device = passivity.mass_with_damping([[0.2]], [[1.37]])
        >>> print(f"{passivity.device_level(device.system).value:.3f} N*s/m")
        1.370 N*s/m
    """
    return greatest_output_level(system, shape, time="continuous")


def mass_with_damping(mass: Matrix, damping: Matrix) -> Dissipative:
    """M dv/dt = f - b v, from force to velocity: b-OSP with the kinetic energy v^T M v / 2, exactly.

    Args:
        mass: M, m x m symmetric positive definite, kg.
        damping: b, m x m symmetric, N*s/m.

    Raises:
        ValueError: wrong shapes, or M not symmetric positive definite.

    Example:
        >>> from manyhands import passivity
        >>> passivity.mass_with_damping(mass=[[0.2]], damping=[[1.37]]).Delta.tolist()
        [[1.37]]
    """
    M = matrix(mass)
    m = M.shape[0]
    M, b = matrix(M, m, m), matrix(damping, m, m)
    if np.any(M != M.T) or np.linalg.eigvalsh(M)[0] <= 0.0:
        raise ValueError("expected a symmetric positive definite mass matrix")
    inverse: Matrix = np.asarray(np.linalg.inv(M), dtype=np.float64)
    return Dissipative(StateSpace(-inverse @ b, inverse, np.eye(m), np.zeros((m, m))), M / 2.0, b)


def passive_operator(system: StateSpace) -> Dissipative:
    """A hand, velocity to force, with a storage matrix that proves it passive: Assumption 1(b).

    Raises:
        Infeasible: the hand is not passive.
        SolverFailure: the hand is too near to the edge for a decision.

    Example:
        >>> from manyhands import passivity
        >>> hand = passivity.StateSpace([[-10.0]], [[1.0]], [[20.0]], [[1.0]])      # a damper behind a spring
        >>> passivity.passive_operator(hand).Delta.tolist()
        [[0.0]]
    """
    require_state_space(system)
    return _proved(system, np.zeros((system.inputs, system.inputs)), "the hand is not a passive operator")


def device_with_level(system: StateSpace, Delta_D: Matrix) -> Dissipative:
    """A device, force to velocity, with a storage matrix that proves it Delta_D-OSP: Assumption 1(a).

    Raises:
        Infeasible: the device is not Delta_D-OSP.
        SolverFailure: the device is too near to the edge for a decision.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> system = passivity.mass_with_damping([[0.2]], [[1.37]]).system
        >>> passivity.device_with_level(system, np.array([[1.0]])).Delta.tolist()
        [[1.0]]
    """
    return _proved(system, Delta_D, "the device is not output strictly passive with this level")


def _proved(system: StateSpace, Delta: Matrix, otherwise: str) -> Dissipative:
    finding = analyse(system, Delta, time="continuous")
    if finding.P is None:
        raise Infeasible(f"Assumption 1: {otherwise}: {finding.reason}")
    try:
        return Dissipative(system, finding.P, Delta)
    except ValueError as error:  # proved in discrete time, but lost by rounding on the way back to continuous time
        raise SolverFailure(f"Assumption 1: the storage matrix found does not survive its check ({error})") from error


def feedback_with_passive(device: StateSpace, operator: StateSpace) -> StateSpace:
    """The feedback interconnection of Fig. 2: v = D (f - f_h), f_h = H v; states (psi_D, psi_H), from f to v.

    Args:
        device: D, force (N) to velocity (m/s), m x m, continuous.
        operator: H, velocity to force, m x m, continuous.

    Raises:
        ValueError: sizes differ, or the algebraic loop I + D_D D_H is singular.

    Example:
        >>> from manyhands import passivity
        >>> hand = passivity.StateSpace([[-10.0]], [[1.0]], [[20.0]], [[1.0]])
        >>> device = passivity.mass_with_damping([[0.2]], [[1.37]]).system
        >>> passivity.feedback_with_passive(device, hand)
        StateSpace(A=[2 x 2], B=[2 x 1], C=[1 x 2], D=0)
    """
    m = device.inputs
    if {device.outputs, operator.inputs, operator.outputs} != {m}:
        raise ValueError(f"found a device of {m} ports and an operator of {operator.inputs} inputs; expected one size")
    loop = np.eye(m) + device.D @ operator.D
    if np.linalg.cond(loop) > 1e12:
        raise ValueError("the interconnection is not well posed: I + D_D D_H is singular")
    # v and the net force u = f - f_h as rows over (psi_D, psi_H, f)
    outputs = np.hstack([device.C, -device.D @ operator.C, device.D])
    v: Matrix = np.asarray(np.linalg.solve(loop, outputs), dtype=np.float64)
    u = np.hstack([np.zeros((m, device.order)), -operator.C, np.eye(m)]) - operator.D @ v
    n_D, n_H = device.order, operator.order
    motion = np.vstack(
        [
            np.hstack([device.A, np.zeros((n_D, n_H + m))]) + device.B @ u,
            np.hstack([np.zeros((n_H, n_D)), operator.A, np.zeros((n_H, m))]) + operator.B @ v,
        ]
    )
    n = n_D + n_H
    return StateSpace(motion[:, :n], motion[:, n:], v[:, :n], v[:, n:])


def lemma3(device: Dissipative, operator: Dissipative) -> Dissipative:
    """The device held by the hand is Delta_D-OSP with the storage P_D (+) P_H, which is checked.

    The hand may have an output level of its own; only its passivity is used.

    Raises:
        ValueError: sizes differ, the loop is not well posed, or the hand's level is not >= 0.

    Example:
        >>> from manyhands import passivity
        >>> hand = passivity.StateSpace([[-10.0]], [[1.0]], [[20.0]], [[1.0]])
        >>> device = passivity.mass_with_damping([[0.2]], [[1.37]])
        >>> passivity.lemma3(device, passivity.passive_operator(hand)).Delta.tolist()
        [[1.37]]
    """
    if float(np.linalg.eigvalsh(operator.Delta)[0]) < 0.0:
        raise ValueError("found a hand with a negative output level; expected a passive hand")
    whole = feedback_with_passive(device.system, operator.system)
    return Dissipative(whole, block_diagonal([device.P, operator.P]), device.Delta)


def theorem1(devices: Sequence[Dissipative]) -> Dissipative:
    """Devices (held or not) side by side: blockdiag(Delta_Di)-OSP (6), with the sum of their storages, checked.

    Example:
        >>> from manyhands import passivity
        >>> two = [passivity.mass_with_damping([[0.2]], [[b]]) for b in (1.37, 2.0)]
        >>> passivity.theorem1(two).Delta.tolist()
        [[1.37, 0.0], [0.0, 2.0]]
    """
    return Dissipative(
        parallel_blocks([device.system for device in devices]),
        block_diagonal([device.P for device in devices]),
        block_diagonal([device.Delta for device in devices]),
    )
