"""Theorem 4 of [Bianchini2010]_ for linear couplings of any given order per block.

Every block V_i has n_i states and m_i ports, and all of

    A_V,i (n_i x n_i),   B_V,i (n_i x m_i),   C_V,i (m_i x n_i),   D_V,i (m_i x m_i)

is free: the transformed coupling (12) is linear in them, so (15), (16) are linear matrix inequalities as they
stand. An order of 0 is a static compliance.

What this finds is *a* coupling of the set. Without any further aim that is mostly a spring without dynamics (A_V, B_V,
C_V near zero), the middle of a set that is large; orders pay where something is asked beyond stability.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from manyhands.design.complementarity import MOST_ITERATIONS, Convergence
from manyhands.design.errors import TooLarge
from manyhands.design.problem import HapticLoop
from manyhands.design.solver import value
from manyhands.design.statespace import StateSpace, symmetric_part
from manyhands.design.theorem4 import BlockUnknowns, solve_theorem_4

MOST_STATES = 24  # n_i + m_i of one block: (15) has 2 n_i + 4 m_i rows, and its program grows with their sixth power
ROOM = 1e-3  # of (15), in scaled ports: what W Z = I up to 1e-4 leaves of it is enough for a proof
_ROUNDING = 1e-8  # of V/T in scaled ports, which is of order one: far below what W Z = I up to 1e-4 means


@dataclass(frozen=True, eq=False)
class LinearCoupling:
    """A coupling as Theorem 4 finds it, with static compliances made symmetric.

    V_hat,i can only be output strictly passive where V_i(1) is symmetric. (15) implies it in the limit, where W Z = I
    exactly; before that, what is left of the skew part is taken off: V_i(1) is stated, and D_V,i follows from it.

    Attributes:
        blocks: V_i in the partition's order, of the wanted orders, stable, from force (N) to displacement (m).
        skew: the largest of ||V_i(1) - V_i(1)^T|| / (2 ||V_i(1)||) that was taken off; spectral norms.
    """

    blocks: tuple[StateSpace, ...]
    skew: float


def design_linear(
    loop: HapticLoop,
    orders: Sequence[int],
    progress: Callable[[str], None] | None = None,
    *,
    kappa: float = 0.5,
    share: float = 1.0,
    iterations: int = MOST_ITERATIONS,
) -> tuple[LinearCoupling, Convergence]:
    """Find a stabilising linear coupling with the loop's block structure.

    ``orders`` has n_i >= 0 for each block, in the partition's order. All other arguments, the pair that is returned
    and the errors are those of :func:`manyhands.design.theorem4.design_spring_damper`, with two errors more.

    Raises:
        TooLarge: a block of more than :data:`MOST_STATES` states and ports.
        ValueError: not one order >= 0 for each block.
    """
    partition = loop.partition
    if len(orders) != len(partition.blocks) or min(orders) < 0:
        raise ValueError(
            f"found orders {list(orders)}, expected one >= 0 for each of the {len(partition.blocks)} blocks of V"
        )
    for name, n, ports in zip(partition.names, orders, partition.blocks, strict=True):
        if n + len(ports) > MOST_STATES:
            raise TooLarge(
                f"coupling {name}: found {n} states and {len(ports)} ports, expected at most {MOST_STATES} together; "
                "lower its order, or divide it"
            )
    blocks = [linear_unknowns(n, len(ports)) for n, ports in zip(orders, partition.blocks, strict=True)]
    return solve_theorem_4(
        loop,
        blocks,
        lambda: recover_linear(loop, blocks),
        kappa=kappa,
        share=share,
        room=ROOM,
        iterations=iterations,
        progress=progress,
    )


def recover_linear(loop: HapticLoop, blocks: Sequence[BlockUnknowns]) -> LinearCoupling | None:
    """The coupling in the unknowns' present values, in physical ports; None where a block is not stable.

    With scaled forces S^{-1} f, and B_V/T, D_V/T for unknowns, V = S V_scaled S. Dynamics that are nothing but rounding
    become zeros; the states stay, for the order is part of the wish.
    """
    found, skew, T = [], 0.0, loop.period
    for block, S_i in zip(blocks, loop.partition.restrict(loop.scaling), strict=True):
        D = value(block.D)
        scaled = StateSpace.static(D)
        if block.A is not None:
            scaled = StateSpace(value(block.A), value(block.B), value(block.C), D)
            if np.max(np.abs(np.linalg.eigvals(scaled.A))) >= 1.0:
                return None
            scaled = _without_rounding(scaled)
        V = StateSpace(scaled.A, T * scaled.B @ S_i, S_i @ scaled.C, T * S_i @ scaled.D @ S_i)
        compliance = V.response(1.0).real
        left = (compliance - compliance.T) / 2.0
        skew = max(skew, float(np.linalg.norm(left, 2)) / max(float(np.linalg.norm(compliance, 2)), 1e-300))
        found.append(StateSpace.with_static_gain(V.A, V.B, V.C, symmetric_part(compliance)))
    return LinearCoupling(tuple(found), skew)


def _without_rounding(system: StateSpace) -> StateSpace:
    """The system, with A, B, C zero where ||C (zI - A)^{-1} B|| <= ||C|| ||B|| / (1 - ||A||) is next to nothing."""
    A, B, C = (float(np.linalg.norm(M, 2)) for M in (system.A, system.B, system.C))
    if B * C >= _ROUNDING * (1.0 - A):
        return system
    return StateSpace(np.zeros_like(system.A), np.zeros_like(system.B), np.zeros_like(system.C), system.D)


def linear_unknowns(n: int, m: int) -> BlockUnknowns:
    """All matrices of a block of order n >= 0 with m ports."""
    D = cp.Variable((m, m))
    if n == 0:
        return BlockUnknowns.of(None, None, None, D, 0)
    return BlockUnknowns.of(cp.Variable((n, n)), cp.Variable((n, m)), cp.Variable((m, n)), D, n)
