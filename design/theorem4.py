"""Theorem 4 of [Bianchini2010]_ for spring-damper couplings, by cone complementarity linearisation (4.1).

Unknown at once: V with the wanted structure, the levels Delta_V and Phi_E, and the storage functions. The
conditions are linear matrix inequalities in

    P, Phi_E, Delta_V, Sigma, Q, Y, A_V, C_V    (B_V = T A_V, D_V = T C_V: the class (20)-(22))

but for Sigma = Delta_V^{-1}, Y = Q^{-1} (17). Cone complementarity linearisation [ElGhaoui1997]_ relaxes these to
[W I; I Z] >= 0 with W = blockdiag(Sigma, Q), Z = blockdiag(Delta_V, Y), and then minimises
trace(W_j Z + Z_j W) around the last iterate until W Z = I. Q, Y, Sigma and Delta_V have the structure of V, one small
cone for each block.

As in :mod:`manyhands.design.theorem3`, ports are scaled by S = Delta_D^{-1/2}, which keeps T K + B and so
A_V, C_V at order one; (14) is put on its face, for E_hat's integrators leave it no interior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from manyhands.design.coupling import SpringDamper
from manyhands.design.errors import Infeasible, NotConverged
from manyhands.design.passivity import storage_face
from manyhands.design.problem import HapticLoop
from manyhands.design.solver import (
    ProgramInfeasible,
    positive,
    solve,
    storage_inequality_expression,
    storage_on,
    symmetric,
    value,
)
from manyhands.design.statespace import Matrix, StateSpace, symmetric_part
from manyhands.design.theorem3 import scale_ports

TOLERANCE = 1e-4  # on ||W Z - I||, spectral norm
MOST_ITERATIONS = 200
_STRICT = 1e-6  # what ">" means to the solver, in scaled coordinates of order one
_STRICT_E = 1e-9  # the same for (14): a mode of frequency omega without a damper dissipates (omega T)^2 at most


@dataclass(frozen=True, eq=False)
class Convergence:
    """How the iteration went.

    Attributes:
        residuals: ||W Z - I|| after each iteration, the first one being step 2's.
    """

    residuals: tuple[float, ...]

    @property
    def iterations(self) -> int:
        """Number of linearised programs solved after the first feasible point."""
        return len(self.residuals) - 1


@dataclass(frozen=True, eq=False)
class _Block:
    """Unknowns of one block of V, in scaled ports; m_i ports, 2 m_i states of V_hat."""

    A_V: cp.Variable
    C_V: cp.Variable
    Delta: cp.Variable
    Sigma: cp.Variable
    Q: cp.Variable
    Y: cp.Variable

    @classmethod
    def of(cls, m: int) -> _Block:
        return cls(
            cp.Variable((m, m)),
            cp.Variable((m, m), symmetric=True),
            cp.Variable((m, m), symmetric=True),
            cp.Variable((m, m), symmetric=True),
            cp.Variable((2 * m, 2 * m), symmetric=True),
            cp.Variable((2 * m, 2 * m), symmetric=True),
        )

    def constraints(self, K: Matrix, T: float) -> list[cp.Constraint]:
        """(15), (16) and (18) for this block."""
        m = K.shape[0]
        I, zero = np.eye(m), np.zeros((m, m))
        # (12) with B_V = T A_V, D_V = T C_V
        A = cp.bmat([[self.A_V, -self.A_V], [zero, zero]])
        B = cp.bmat([[self.A_V], [I]])
        D = self.C_V - K / T
        C = cp.bmat([[self.C_V, -D]])
        R = cp.bmat([[C / 2], [A], [C]])
        S = cp.bmat(
            [
                [symmetric(D), B.T, D.T],
                [B, self.Q, np.zeros((2 * m, m))],
                [D, np.zeros((m, 2 * m)), self.Sigma],
            ]
        )
        return [
            symmetric(cp.bmat([[self.Y, R.T], [R, S]])) >> 0,
            cp.bmat([[self.Sigma, I], [I, self.Delta]]) >> 0,
            cp.bmat([[self.Q, np.eye(2 * m)], [np.eye(2 * m), self.Y]]) >> 0,
            self.Delta >> _STRICT * I,
            self.Q >> _STRICT * np.eye(2 * m),
        ]

    def pairs(self) -> tuple[tuple[cp.Variable, cp.Variable], ...]:
        """The diagonal blocks of W and Z that are to become inverses of each other (17)."""
        return (self.Sigma, self.Delta), (self.Q, self.Y)

    def residual(self) -> float:
        """||W Z - I|| of this block."""
        return max(float(np.linalg.norm(value(w) @ value(z) - np.eye(w.shape[0]), 2)) for w, z in self.pairs())


def design_spring_damper(
    loop: HapticLoop, progress: Callable[[int, float], None] | None = None
) -> tuple[SpringDamper, Convergence]:
    """Find a stabilising spring-damper coupling with the loop's block structure.

    Args:
        loop: the haptic loop.
        progress: called with the iteration's number and its ||W Z - I||.

    Returns:
        The coupling (symmetric parts of K and B, exactly zero outside the blocks) and the convergence. That it
        stabilises the loop is for :func:`manyhands.design.theorem3.certify_given` to prove.

    Raises:
        Infeasible: step 2 has no solution.
        NotConverged: the cap on iterations was reached.
        SolverFailure: the solver gave no usable answer.
    """
    m, T, partition = len(loop.ports), loop.period, loop.partition
    S = loop.scaling
    inverse = np.linalg.inv(S)
    K = symmetric_part(inverse @ loop.K @ inverse)  # T/2 I, up to rounding
    E_hat: StateSpace = scale_ports(loop.E_hat, S, S)
    face = storage_face(E_hat, "input")
    if face is None:
        raise Infeasible("the environment's static stiffness is not symmetric: E_hat cannot be passive", ())
    P, Phi = storage_on(face), cp.Variable((m, m), symmetric=True)
    blocks = [_Block.of(len(ports)) for ports in partition.blocks]
    Delta = sum(
        (select @ b.Delta @ select.T for select, b in zip(partition.selections(), blocks, strict=True)),
        start=cp.Constant(np.zeros((m, m))),
    )
    M = storage_inequality_expression(E_hat, P, Phi=-Phi)
    W = face.complement
    constraints = [
        *positive(P, _STRICT),
        symmetric(W.T @ M @ W) << -_STRICT_E * np.eye(W.shape[1]),
        symmetric(cp.bmat([[np.eye(m) - Phi, -Phi], [-Phi, Delta - Phi]])) >> _STRICT * np.eye(2 * m),
    ]
    for b, K_i in zip(blocks, partition.restrict(K), strict=True):
        constraints += b.constraints(K_i, T)

    try:
        solve(cp.Problem(cp.Minimize(0), constraints), "Theorem 4, first feasible point")
    except ProgramInfeasible as error:
        raise Infeasible(
            "no spring-damper coupling of this structure satisfies Theorem 4: E_hat + Delta_D is not passive",
            ("use devices with more damping (a greater osp)", "shorten the period", "soften the environment"),
        ) from error
    pairs = [pair for b in blocks for pair in b.pairs()]
    last = [(cp.Parameter(w.shape, symmetric=True), cp.Parameter(z.shape, symmetric=True)) for w, z in pairs]
    objective = sum(cp.trace(w_j @ z) + cp.trace(z_j @ w) for (w, z), (w_j, z_j) in zip(pairs, last, strict=True))
    linearised = cp.Problem(cp.Minimize(objective), constraints)
    residuals = [max(b.residual() for b in blocks)]
    while residuals[-1] >= TOLERANCE:
        if progress is not None:
            progress(len(residuals) - 1, residuals[-1])
        if len(residuals) > MOST_ITERATIONS:
            raise NotConverged(
                f"stopped after {MOST_ITERATIONS} iterations at ||W Z - I|| = {residuals[-1]:.2e}: "
                f"wanted < {TOLERANCE:.0e}; give a soft spring by 'coupling: given', which needs no iteration"
            )
        for (w, z), (w_j, z_j) in zip(pairs, last, strict=True):
            w_j.value, z_j.value = symmetric_part(value(w)), symmetric_part(value(z))
        try:
            solve(linearised, f"Theorem 4, iteration {len(residuals)}")
        except ProgramInfeasible as error:  # feasible a moment ago
            raise NotConverged(f"iteration {len(residuals)} was called infeasible after a feasible one") from error
        residuals.append(max(b.residual() for b in blocks))
    if progress is not None:
        progress(len(residuals) - 1, residuals[-1])
    return _recover(loop, blocks), Convergence(tuple(residuals))


def _recover(loop: HapticLoop, blocks: list[_Block]) -> SpringDamper:
    """K and B by (22), block by block, back in physical ports."""
    parts = []
    for b, S_i in zip(blocks, loop.partition.restrict(loop.scaling), strict=True):
        scaled = SpringDamper.from_realisation(value(b.A_V), value(b.C_V), loop.period)
        parts.append(scaled.scaled(symmetric_part(np.linalg.inv(S_i))))
    return SpringDamper(
        loop.partition.embed([p.stiffness for p in parts]), loop.partition.embed([p.damping for p in parts])
    )
