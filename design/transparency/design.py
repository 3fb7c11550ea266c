"""Transparent couplings: the H-infinity problems (23), (24) of [Bianchini2010]_ over certified couplings.

Every returned coupling satisfies the conditions of Theorem 3 with a little room. The level gamma is the H-infinity norm
of the weighted loop. It is computed from the coupling itself and is not the program's own bound.

Spring-damper couplings are found by sequential convex programs over the exact conditions of the class. For linear
couplings over fixed poles, loop shaping is one convex program with a global optimum. The closed loop is not convex;
sequential convex programs lower it from the loop-shaping optimum. :mod:`manyhands.design.transparency.pole_search`
searches the poles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.statespace import Matrix, StateSpace, symmetric_part
from manyhands.design.models.weights import Transparency, weighted
from manyhands.design.passivity.hinfinity import hinf_norm
from manyhands.design.solver import ProgramInfeasible
from manyhands.design.transparency.families import (
    FixedPoleBlock,
    FixedPoleFamily,
    NormalisedLoop,
    PoleBasis,
    SpringDamperFamily,
)
from manyhands.design.transparency.minimax import Minimum, minimise_peak

__all__ = [
    "LinearDesign",
    "SpringDamperDesign",
    "Transparency",
    "design_fixed_poles",
    "design_spring_damper",
    "hinf_norm",
    "weighted",
]

Progress = Callable[[str], None]
StaticAim = Literal["feasible", "stiffest"]

# least eigenvalue of a linear block's conditions, where Delta_D = I: ten digits above rounding, and 3e-5 of gamma
ROOM = 1e-6
FEASIBLE_COMPLIANCE = 4.0  # "feasible" allows v(1) up to this times K: a quarter of the greatest stiffness
BACK_OFF = (1e-5, 1e-4, 1e-3, 1e-2)  # parts of the way to the roomiest coupling, for an answer just outside


@dataclass(frozen=True, eq=False)
class SpringDamperDesign:
    """A spring-damper coupling and its level.

    Attributes:
        coupling: K and B with the structure of the partition.
        gamma: H-infinity norm of the weighted loop.
        frequency: where it is reached, rad/s.
        history: gamma of the stiffest coupling, then gamma after each step that lowered it.
        interrupted: whether Ctrl-C ended the search; the coupling satisfies the conditions nevertheless.
    """

    coupling: SpringDamper
    gamma: float
    frequency: float
    history: tuple[float, ...]
    interrupted: bool


@dataclass(frozen=True, eq=False)
class LinearDesign:
    """A linear coupling, the storage matrices that prove its levels, and its level of transparency.

    Attributes:
        blocks: realisation of each block, order n_i m_i, with symmetric C_j and D
            (:mod:`manyhands.design.transparency.families`).
        storages: P of each block, for (zeta, phi) with zeta = (xi - xi_)/T: V_hat,i is (least level)-OSP.
        gamma: H-infinity norm of the weighted loop; None if the search did not minimise it.
        frequency: where gamma is reached, rad/s; None with gamma.
        bound: no coupling over the same poles, with the same room, is below this (loop shaping); else 0.
        poles: of each block, in the z plane; every port of the block has each of them.
        history: gamma after each step that lowered it.
        interrupted: whether Ctrl-C ended the search; the coupling satisfies the conditions nevertheless.
    """

    blocks: tuple[StateSpace, ...]
    storages: tuple[Matrix, ...]
    gamma: float | None
    frequency: float | None
    bound: float
    poles: tuple[tuple[complex, ...], ...]
    history: tuple[float, ...]
    interrupted: bool


def design_spring_damper(
    loop: NormalisedLoop,
    Phi_E: Matrix,
    share: float = 1.0,
    progress: Progress | None = None,
) -> SpringDamperDesign:
    """Minimise the weighted loop over the spring-damper class, all blocks at once.

    Args:
        loop: the normalised loop, with the aim.
        Phi_E: m x m, N*s/m: E_hat is (-Phi_E)-ISP.
        share: G_hat is (share Delta_D)-OSP.
        progress: called with a line of text whenever the level falls.

    Raises:
        Infeasible: no coupling of the class satisfies (10) with this Phi_E.
        SolverFailure: the solver gave no usable answer.
    """
    S = loop.partition.embed(loop.scaling)
    family = SpringDamperFamily(loop, symmetric_part(S @ Phi_E @ S), share)
    history: list[float] = []
    try:
        start = family.stiffest()
    except ProgramInfeasible as error:
        raise Infeasible(
            "no spring-damper coupling satisfies (10) with this Phi_E: E_hat + Delta_D is not passive enough"
        ) from error
    found = minimise_peak(family, start, "spring-damper transparency", _noting(progress, history))
    coupling = family.coupling(found.x)
    if min(np.linalg.eigvalsh(M)[0] for M in family.conditions(found.x)) < -1e-6:
        raise SolverFailure("spring-damper transparency: the answer does not survive a check of its conditions")
    gamma, frequency = hinf_norm(weighted(loop.E, loop.own(coupling.realisation(loop.T)), loop.aim), loop.T)
    return SpringDamperDesign(coupling, gamma, frequency, tuple(history), found.interrupted)


def design_fixed_poles(
    loop: NormalisedLoop,
    poles: tuple[tuple[complex, ...], ...],
    least_levels: tuple[Matrix, ...],
    progress: Progress | None = None,
    static: StaticAim | None = None,
    room: float = ROOM,
) -> LinearDesign:
    """The best coupling over given poles.

    Args:
        loop: the normalised loop; its aim is minimised unless ``static`` asks for something else.
        poles: of each block in the z plane, each complex pole followed by its conjugate; a block without poles is a
            static spring.
        least_levels: Delta_V,i that each block must have, m_i x m_i, positive definite, N*s/m.
        progress: called with a line of text whenever the level falls.
        static: "stiffest", the least trace of S^{-1} V(1) S^{-1}; or "feasible", the coupling with the most room among
            those at most :data:`FEASIBLE_COMPLIANCE` times as compliant as the loop gain K; None for the loop's aim.
        room: least eigenvalue kept in the conditions, in ports where Delta_D = I.

    Raises:
        Infeasible: no coupling over these poles has these levels.
        SolverFailure: the solver gave no usable answer.
        ValueError: not one set of poles and one level for each block, or a level that is not positive definite.
    """
    family = fixed_pole_family(loop, tuple(PoleBasis(block) for block in poles), least_levels, room)
    history: list[float] = []
    try:
        if static is None:
            found = minimised(family, None, _noting(progress, history))
        else:
            x = family.stiffest() if static == "stiffest" else family.roomiest(FEASIBLE_COMPLIANCE)
            found = Minimum(x, np.inf, 0.0, 1)
    except ProgramInfeasible as error:
        raise Infeasible(
            "no linear coupling over these poles has the least levels asked for; (10) needs "
            "Delta_V > Phi_E + Phi_E (Delta_G - Phi_E)^{-1} Phi_E"
        ) from error
    design = recovered(family, found, tuple(history))
    return design if static is None else replace(design, gamma=None, frequency=None)


def fixed_pole_family(
    loop: NormalisedLoop, bases: tuple[PoleBasis, ...], least_levels: tuple[Matrix, ...], room: float
) -> FixedPoleFamily:
    """The couplings over ``bases`` with the least levels (N*s/m) of each block.

    Raises:
        ValueError: not one basis and one level for each block, or a level that is not positive definite.
    """
    count = len(loop.partition.blocks)
    if len(bases) != count or len(least_levels) != count:
        raise ValueError(f"found {len(bases)} poles and {len(least_levels)} levels of blocks; expected {count}")
    blocks = []
    for basis, ports, level, S, name in zip(
        bases, loop.partition.blocks, least_levels, loop.scaling, loop.partition.names, strict=True
    ):
        if level.shape != S.shape or not np.linalg.eigvalsh(level)[0] > 0.0:
            raise ValueError(f"coupling {name}: expected a positive definite {len(ports)} x {len(ports)} level")
        blocks.append(FixedPoleBlock(basis, len(ports), loop.kappa, symmetric_part(S @ level @ S)))
    return FixedPoleFamily(loop, tuple(blocks), room)


def minimised(
    family: FixedPoleFamily,
    start: Matrix | None,
    progress: Callable[[float], None] | None = None,
    most_steps: int = 60,
) -> Minimum:
    """The optimum over fixed poles: global for loop shaping, local from ``start`` for the closed loop.

    Args:
        family: the couplings.
        start: gains (C, D) to start from; the loop-shaping optimum by default.
        progress: called with the level whenever the level falls.
        most_steps: cap on the programs.
    """
    what = "transparency over fixed poles"
    if family.affine:
        return minimise_peak(family, _plain(family), what, progress, most_steps=most_steps)
    if start is None:
        loop = replace(family.loop, aim=replace(family.loop.aim, objective="loop-shaping"))
        shaped = replace(family, loop=loop)
        start = shaped.gains(minimise_peak(shaped, _plain(shaped), what).x)
    return minimise_peak(family, family.nearest(start), what, progress, most_steps=most_steps)


def recovered(family: FixedPoleFamily, found: Minimum, history: tuple[float, ...]) -> LinearDesign:
    """The design in physical units; its conditions and its level are computed again from it.

    Raises:
        SolverFailure: the numbers do not satisfy the conditions.
    """
    loop = family.loop
    blocks, storages = [], []
    for i, (block, x) in enumerate(zip(family.blocks, family.parts(_inside(family, found.x)), strict=True)):
        if min(block.margins(x)) <= 0.0:
            raise SolverFailure(
                f"coupling {loop.partition.names[i]}: the answer does not survive a check: least eigenvalues "
                f"{block.margins(x)[0]:.3g} of the storage and {block.margins(x)[1]:.3g} of the supply"
            )
        blocks.append(loop.physical(block.realisation(x), i))
        storages.append(loop.storage(block.unpack(x)[2], i))
    gamma, frequency = hinf_norm(weighted(loop.E, loop.own(loop.partition.join(blocks)), loop.aim), loop.T)
    return LinearDesign(
        tuple(blocks),
        tuple(storages),
        gamma,
        frequency,
        found.bound,
        tuple(block.basis.poles for block in family.blocks),
        history,
        found.interrupted,
    )


def _inside(family: FixedPoleFamily, x: Matrix) -> Matrix:
    """``x``, or the first of the points between it and the roomiest member that satisfies the conditions.

    A solver ends within its tolerance of the boundary, now and then outside: by 1e-6 on some processors. The conditions
    are matrix inequalities in x, hence every point of the line from a member to ``x`` gains their room in proportion.
    """

    def least(point: Matrix) -> float:
        return min(min(b.margins(part)) for b, part in zip(family.blocks, family.parts(point), strict=True))

    if least(x) > 0.0:
        return x
    middle = family.roomiest(FEASIBLE_COMPLIANCE)
    points = (x + part * (middle - x) for part in BACK_OFF)
    return next((point for point in points if least(point) > 0.0), x)


def _plain(family: FixedPoleFamily) -> Matrix:
    """Static springs slightly softer than 1/K, for the loop gain K: they set the scale of the first program."""
    parts = []
    for block in family.blocks:
        states = block.basis.order * block.ports
        C, P = np.zeros((block.ports, states)), np.zeros((states, states))
        parts.append(block.pack(C, 1.2 * block.kappa * np.eye(block.ports), P))
    return family.joined(parts)


def _noting(progress: Progress | None, history: list[float]) -> Callable[[float], None]:
    """A function that adds a level to the history and reports it."""

    def note(level: float) -> None:
        history.append(level)
        if progress is not None:
            progress(f"gamma = {level:.5g}")

    return note
