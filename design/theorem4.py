"""Theorem 4 of [Bianchini2010]_: a stabilising coupling of given structure, by cone complementarity linearisation.

Unknown at once: V with the wanted structure, the levels Delta_V and Phi_E, and the storage functions. The
conditions (13)-(16) are linear matrix inequalities in

    P, Phi_E, Delta_V, Sigma, Q, Y, A_V, B_V, C_V, D_V

but for Sigma = Delta_V^{-1}, Y = Q^{-1} (17), which :mod:`manyhands.design.complementarity` takes care of. Q, Y, Sigma
and Delta_V have the structure of V, one small cone for each block. Here stands what every class of V has in common,
and the spring-damper class (20)-(22), B_V = T A_V, D_V = T C_V; :mod:`manyhands.design.theorem4_linear` has the
general one.

Ports are scaled by S = Delta_D^{-1/2}, where Delta_D = I and K = kappa T I; with B_V/T and D_V/T for unknowns, all of
(12) is then of order one and T is gone from it. (14) is asked of E_hat without its integrators
(:mod:`manyhands.design.split`), which leave it no interior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from manyhands.design.complementarity import MOST_ITERATIONS, Convergence, Found, Pair, Relaxed, complement
from manyhands.design.coordinates import balancing, change_states, scale_ports
from manyhands.design.coupling import SpringDamper
from manyhands.design.declared import DeclaredEnvironment
from manyhands.design.errors import Infeasible
from manyhands.design.problem import HapticLoop
from manyhands.design.solver import (
    ProgramInfeasible,
    positive,
    storage_inequality_expression,
    symmetric,
    value,
)
from manyhands.design.statespace import symmetric_part

_STRICT = 1e-6  # what ">" means to the solver, in scaled coordinates of order one
_STRICT_E = 1e-9  # the same for (14): a mode of frequency omega without a damper dissipates (omega T)^2 at most


@dataclass(frozen=True, eq=False)
class BlockUnknowns:
    """What is searched for one block of V, of n states and m ports, in scaled ports.

    Attributes:
        A: A_V, n x n.
        B: B_V/T, n x m.
        C: C_V, m x n.
        D: D_V/T, m x m.
        levels: Sigma and Delta_V of the block, m x m.
        storage: Q and Y, (n+m) x (n+m), in the coordinates (xi, u of the tick before) of (12).
    """

    A: Any
    B: Any
    C: Any
    D: Any
    levels: Pair
    storage: Pair

    @classmethod
    def of(cls, A: Any, B: Any, C: Any, D: Any, n: int) -> BlockUnknowns:
        """Unknowns for the realisation (A, B, C, D), expressions or, without states, None."""
        m = D.shape[0]
        return cls(A, B, C, D, Pair(_symmetric(m), _symmetric(m)), Pair(_symmetric(n + m), _symmetric(n + m)))

    @classmethod
    def spring_damper(cls, m: int) -> BlockUnknowns:
        """Of the class (20): B_V = T A_V, D_V = T C_V (21), C_V symmetric."""
        A, C = cp.Variable((m, m)), _symmetric(m)
        return cls.of(A, A, C, C, m)

    @property
    def pairs(self) -> tuple[Pair, Pair]:
        """The diagonal blocks of W and Z (19)."""
        return self.levels, self.storage

    def constraints(self, kappa: float, room: float = 0.0) -> list[cp.Constraint]:
        """(15), (16) for this block, with K = kappa T.

        A constant force u is neutral: deflected by V(1) u, V_hat stands still and gives nothing, whatever V is. In
        (15) it is the vector (0, u; u; *, *; 0), so the matrix there cannot be definite. ``room`` asks for

            [Y R^T; R S] >= room * N,    N = the squares of xi, of u - u-, and of Delta_V y,

        which all neutral vectors fulfil with equality: strictness on a complement of them.
        """
        I, O = np.eye(self.D.shape[0]), np.zeros(self.D.shape)
        D = self.D - kappa * I
        if self.A is None:
            A, B, C, n = O, I, -D, 0
        else:
            n = self.A.shape[0]
            A = cp.bmat([[self.A, -self.B], [np.zeros((len(I), n)), O]])
            B = cp.bmat([[self.B], [I]])
            C = cp.bmat([[self.C, -D]])
        (Sigma, Delta), (Q, Y) = ((pair.W, pair.Z) for pair in self.pairs)
        between = np.zeros((n + len(I), len(I)))
        M = cp.bmat(
            [
                [Y, C.T / 2, A.T, C.T],
                [C / 2, symmetric(D), B.T, D.T],
                [A, B, Q, between],
                [C, D, between.T, Sigma],
            ]
        )
        N = np.zeros(M.shape)
        N[:n, :n] = np.eye(n)
        forces = slice(n, n + 2 * len(I))  # u of the tick before, u
        N[forces, forces] = np.block([[I, -I], [-I, I]]) / 2.0
        N[-len(I) :, -len(I) :] = I
        return [
            symmetric(M) - room * N >> 0,
            Delta >> _STRICT * I,
            Q >> _STRICT * np.eye(n + len(I)),
        ]


def solve_theorem_4(
    loop: HapticLoop,
    blocks: Sequence[BlockUnknowns],
    recover: Callable[[], Found | None],
    *,
    kappa: float,
    share: float,
    room: float,
    iterations: int,
    progress: Callable[[str], None] | None,
) -> tuple[Found, Convergence]:
    """Solve (13)-(17) for the given unknowns of each block.

    Args:
        loop: the haptic loop; its E_hat, structure and Delta_D are used.
        blocks: unknowns, in the partition's order.
        recover: the coupling in their present values, or None.
        kappa: K = kappa T Delta_D^{-1}, dimensionless.
        share: G_hat is (share Delta_D)-OSP, dimensionless, > 0.
        room: see :meth:`BlockUnknowns.constraints`.
        iterations: cap, see :func:`manyhands.design.complementarity.complement`.
        progress: see there.

    Raises:
        Infeasible: step 2 has no solution.
        StoppedShort, Interrupted, SolverFailure: see there.
        ValueError: kappa or share is not positive.
    """
    if not (0.0 < kappa < np.inf and 0.0 < share < np.inf):
        raise ValueError(f"found kappa = {kappa}, share = {share}, expected finite ones > 0")
    m = len(loop.ports)
    Phi, constraints = _environment(loop)
    Delta = sum(
        (select @ block.levels.Z @ select.T for select, block in zip(loop.partition.selections(), blocks, strict=True)),
        start=cp.Constant(np.zeros((m, m))),
    )
    condition_10 = cp.bmat([[share * np.eye(m) - Phi, -Phi], [-Phi, Delta - Phi]])
    constraints.append(symmetric(condition_10) >> _STRICT * np.eye(2 * m))
    for block in blocks:
        constraints += block.constraints(kappa, room)
    pairs = [pair for block in blocks for pair in block.pairs]
    try:
        return complement(Relaxed(constraints, pairs, recover, "Theorem 4"), iterations=iterations, progress=progress)
    except ProgramInfeasible as error:
        raise Infeasible(
            "no coupling of this structure satisfies Theorem 4: E_hat + Delta_D is not passive"
            + (f", with {share:.3g} of Delta_D left by the delay" if share != 1.0 else ""),
            ("use devices with more damping (a greater osp)", "shorten the period", "soften the environment"),
        ) from error


def design_spring_damper(
    loop: HapticLoop,
    progress: Callable[[str], None] | None = None,
    *,
    kappa: float = 0.5,
    share: float = 1.0,
    iterations: int = MOST_ITERATIONS,
) -> tuple[SpringDamper, Convergence]:
    """Find a stabilising spring-damper coupling with the loop's block structure.

    Args:
        loop: the haptic loop.
        progress: called with a line of text after each iteration.
        kappa: of the loop gain K = kappa T Delta_D^{-1}; 1/2 without delay.
        share: G_hat is (share Delta_D)-OSP; 1 without delay.
        iterations: cap on the iterations.

    Returns:
        The coupling (symmetric parts of K and B, exactly zero outside the blocks) and the convergence. That it
        stabilises the loop is for :func:`manyhands.design.theorem3.certify_given` to prove.

    Raises:
        Infeasible: step 2 has no solution.
        StoppedShort: the cap on iterations was reached; ``best`` is the best iterate's coupling, or None.
        Interrupted: KeyboardInterrupt arrived; ``best`` likewise.
        SolverFailure: the solver gave no usable answer.
        ValueError: kappa or share is not positive, or the cap is negative.
    """
    blocks = [BlockUnknowns.spring_damper(len(ports)) for ports in loop.partition.blocks]
    return solve_theorem_4(
        loop,
        blocks,
        lambda: _spring_damper(loop, blocks),
        kappa=kappa,
        share=share,
        room=0.0,
        iterations=iterations,
        progress=progress,
    )


def _environment(loop: HapticLoop) -> tuple[cp.Expression, list[cp.Constraint]]:
    """Phi_E in scaled ports, and (14) for it, on what is left of E_hat without its integrators.

    A declared environment has its level for Phi_E, and nothing else.
    """
    m, S, T = len(loop.ports), loop.scaling, loop.period
    if isinstance(loop.environment, DeclaredEnvironment):
        return cp.Constant(S @ loop.environment.promised() @ S), []
    split = loop.split
    rest = scale_ports(split.rest, S, S)
    rest = change_states(rest, balancing(rest))
    P, Phi = _symmetric(rest.order) if rest.order else cp.Constant(np.zeros((0, 0))), _symmetric(m)
    M = storage_inequality_expression(rest, P, Phi=T / 2.0 * S @ split.stiffness @ S - Phi)
    return Phi, [*positive(P, _STRICT), symmetric(M) << -_STRICT_E * np.eye(M.shape[0])]


def _spring_damper(loop: HapticLoop, blocks: Sequence[BlockUnknowns]) -> SpringDamper | None:
    """K and B by (22), block by block, back in physical ports; None where C_V is singular."""
    parts = []
    for block, S_i in zip(blocks, loop.partition.restrict(loop.scaling), strict=True):
        try:
            scaled = SpringDamper.from_realisation(value(block.A), value(block.C), loop.period)
        except np.linalg.LinAlgError:
            return None
        parts.append(scaled.scaled(symmetric_part(np.linalg.inv(S_i))))
    return SpringDamper(
        loop.partition.embed([p.stiffness for p in parts]), loop.partition.embed([p.damping for p in parts])
    )


def _symmetric(m: int) -> cp.Variable:
    return cp.Variable((m, m), symmetric=True)
