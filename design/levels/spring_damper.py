"""The spring-damper class without iteration: its greatest level in closed form, and synthesis as one exact program.

Let Lambda = Delta_D / (2 kappa), which is Delta_D itself without delay, so that the loop gain is K = T/2 Lambda^{-1}.
For a coupling of stiffness K_s and damping B (symmetric) let

    J = Lambda - (T/2) K_s.

V_hat is OSP at some level iff K_s > 0, J > 0 and J - B >= 0, and then its greatest level is

    Delta_V* = Lambda J^{-1} (J + B) J^{-1} Lambda - Lambda.

Sufficiency: with the deflection d, u = (d - d_)/T and g = u - u_ (an underscore marks the tick before), the storage

    (d^T K_s d - f^T K f)/(2T) + u^T B J^{-1} B u / 2 >= 0

grows by exactly f^T y - y^T Delta_V* y - g^T B J^{-1} (J - B) J^{-1} B g / 4 a tick. In (10), with
share Delta_D = a Lambda, the level disappears by congruence, which leaves

    [ a Lambda - Phi_E    -a J       0            ]
    [      .              J + B      sqrt(1-a) J  ]  > 0,        linear in (K_s, B, Phi_E),        (*)
    [      .                .        Lambda       ]

Without delay (a = 1) the last row and column decouple. Feasibility, the stiffest coupling and any convex aim over the
class are each one small exact program. The blocks are separate programs if Phi_E has their structure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from manyhands.design import convex as cp
from manyhands.design.errors import Infeasible
from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.statespace import Matrix, symmetric_part
from manyhands.design.solver import ProgramInfeasible, solve, symmetric, value

ROOM = 1e-4  # of Lambda: the distance of an aim to the strict conditions; K_s stays below its limit by the same part


@dataclass(frozen=True, eq=False)
class ClassConditions:
    """The class's unknowns for one block and the conditions on them, in ports where Lambda = I.

    Attributes:
        J: m_i x m_i symmetric variable, T/2 K_s = I - J.
        B: m_i x m_i symmetric variable.
        constraints: K_s > 0, J > 0, J - B > 0, B > -I, with ``ROOM``.
    """

    J: Any
    B: Any
    constraints: list[cp.Constraint]

    @classmethod
    def of(cls, m: int) -> ClassConditions:
        """Fresh unknowns for a block of m ports."""
        J, B = cp.Variable((m, m), symmetric=True), cp.Variable((m, m), symmetric=True)
        I = np.eye(m)
        return cls(J, B, [J >> ROOM * I, J - B >> ROOM * I, J << (1.0 - ROOM) * I])

    def loop_condition(self, part: float, Phi: Matrix) -> Any:
        """The left-hand side of (*) in these ports: a = ``part``, Phi_E there = ``Phi``."""
        I = np.eye(self.J.shape[0])
        if part >= 1.0:
            return symmetric(cp.bmat([[I - Phi, -self.J], [-self.J, self.J + self.B]]))
        zero, root = np.zeros_like(I), np.sqrt(1.0 - part)
        return symmetric(
            cp.bmat(
                [
                    [part * I - Phi, -part * self.J, zero],
                    [-part * self.J, self.J + self.B, root * self.J],
                    [zero, root * self.J, I],
                ]
            )
        )


def greatest_level(coupling: SpringDamper, Lambda: Matrix, T: float) -> Matrix:
    """Delta_V* of the module's head, m x m, N*s/m; the caller has to ensure J > 0."""
    J = Lambda - T / 2.0 * coupling.stiffness
    X = np.linalg.solve(J, Lambda)
    return symmetric_part(X.T @ (J + coupling.damping) @ X - Lambda)


@dataclass(frozen=True, eq=False)
class ClassMember:
    """A coupling of one block.

    Attributes:
        coupling: K_s and B.
        distance: the least slack in the conditions of the class and in (*), in ports where Lambda = I.
    """

    coupling: SpringDamper
    distance: float


def centred(Lambda: Matrix, Phi_E: Matrix, part: float, T: float, name: str) -> ClassMember:
    """The coupling of one block with the greatest distance to every condition of the class and of (*).

    Maximises s with J, J - B, I - J and (*) all >= s in ports where Lambda = I.

    Args:
        Lambda: m_i x m_i, N*s/m.
        Phi_E: the environment's level at the block's ports, m_i x m_i, N*s/m.
        part: a = 2 kappa share in (0, 1].
        T: period, s.
        name: of the block, for messages.

    Raises:
        Infeasible: no coupling satisfies the conditions, because Phi_E is not below a Lambda.
    """
    return _member(Lambda, Phi_E, part, T, name, stiff=False)


def stiffest(Lambda: Matrix, Phi_E: Matrix, part: float, T: float, name: str) -> ClassMember:
    """The stiffest certified coupling of one block: the greatest trace of T/2 K_s Lambda^{-1}, ``ROOM`` inside.

    Arguments and errors are those of :func:`centred`.
    """
    return _member(Lambda, Phi_E, part, T, name, stiff=True)


def _member(Lambda: Matrix, Phi_E: Matrix, part: float, T: float, name: str, stiff: bool) -> ClassMember:
    S = _inverse_root(Lambda)
    m = len(S)
    Phi = symmetric_part(S @ Phi_E @ S)
    headroom = float(np.linalg.eigvalsh(part * np.eye(m) - Phi)[0])
    if headroom <= 0.0:
        raise Infeasible(
            f"coupling {name}: no spring-damper satisfies Theorem 3, because the environment lacks passivity: "
            f"Phi_E exceeds the device's level by {-headroom / part:.3g} of it"
        )
    found = _scalar(part, float(Phi[0, 0]), stiff) if m == 1 else _program(part, Phi, stiff, name)
    if found is None:
        raise Infeasible(f"coupling {name}: no spring-damper satisfies Theorem 3 with room to prove it")
    J, B, distance = found
    inverse = np.linalg.inv(S)
    coupling = SpringDamper(
        symmetric_part(2.0 / T * inverse @ (np.eye(m) - J) @ inverse), symmetric_part(inverse @ B @ inverse)
    )
    return ClassMember(coupling, distance)


def _program(part: float, Phi: Matrix, stiff: bool, name: str) -> tuple[Matrix, Matrix, float] | None:
    m = len(Phi)
    unknown = ClassConditions.of(m)
    condition = unknown.loop_condition(part, Phi)
    I, s = np.eye(m), cp.Variable()
    if stiff:
        constraints = [*unknown.constraints, condition >> ROOM * np.eye(condition.shape[0])]
        program = cp.Problem(cp.Minimize(cp.trace(unknown.J)), constraints)
    else:
        constraints = [
            unknown.J >> s * I,
            unknown.J - unknown.B >> s * I,
            unknown.J << (1.0 - s) * I,
            condition >> s * np.eye(condition.shape[0]),
        ]
        program = cp.Problem(cp.Maximize(s), constraints)
    try:
        best = solve(program, f"spring-damper class, coupling {name}")
    except ProgramInfeasible:
        return None
    if not stiff and best <= 0.0:
        return None
    return symmetric_part(value(unknown.J)), symmetric_part(value(unknown.B)), ROOM if stiff else best


def _scalar(part: float, phi: float, stiff: bool) -> tuple[Matrix, Matrix, float] | None:
    """The program of one port in closed form: J, B and distance in ports where Lambda = 1; None without a solution.

    The best damping is B = J - s. By Schur complements (*) >= s is then 2 J - 2 s >= q J^2 with
    q = a^2/(a - phi - s) + (1 - a)/(1 - s): J is the least root for the stiffest, 1/q for the greatest s.
    """

    def q(s: float) -> float:
        if s >= 1.0 or s >= part - phi:
            return np.inf
        return part**2 / (part - phi - s) + (1.0 - part) / (1.0 - s)

    def best_J(s: float) -> float | None:
        J = min(max(1.0 / q(s), s), 1.0 - s)
        return J if J > 0.0 and 2.0 * J - 2.0 * s - q(s) * J * J >= 0.0 else None

    if stiff:
        root = 1.0 - 2.0 * ROOM * q(ROOM)
        if not root > 0.0:
            return None
        J = 2.0 * ROOM / (1.0 + np.sqrt(root)) * (1.0 + 1e-9)
        return np.array([[J]]), np.array([[J - ROOM]]), ROOM
    low, high = 0.0, min(0.5, part - phi)
    for _ in range(60):  # to double precision
        middle = (low + high) / 2.0
        low, high = (middle, high) if best_J(middle) is not None else (low, middle)
    J_low = best_J(low)
    if J_low is None or low <= 0.0:
        return None
    return np.array([[J_low]]), np.array([[J_low - low]]), low


def _inverse_root(Lambda: Matrix) -> Matrix:
    """Lambda^{-1/2}, symmetric."""
    values, vectors = np.linalg.eigh(Lambda)
    return symmetric_part(vectors @ np.diag(values**-0.5) @ vectors.T)
