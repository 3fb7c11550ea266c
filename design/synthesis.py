"""From a loop and a wish to a certificate: synthesise, certify, verify, each distrusting the one before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cvxpy
import numpy as np

from manyhands.design.certificate import Certificate, content, seal
from manyhands.design.coupling import SpringDamper
from manyhands.design.errors import Infeasible, SolverFailure, TooLarge
from manyhands.design.problem import (
    CouplingRequest,
    HapticLoop,
    LinearGiven,
    NoCoupling,
    SpringDamperGiven,
)
from manyhands.design.solver import SOLVER
from manyhands.design.statespace import StateSpace
from manyhands.design.theorem3 import certify_given
from manyhands.design.theorem4 import design_spring_damper
from manyhands.design.verification import margins, verify

ASSUMED_DELAY = 0.0  # s; Theorem 2 assumes that f_v(k) is applied at the instant of x(k)


MOST_STATES = 48  # ports and masses; about a minute and a gigabyte


def design(
    loop: HapticLoop, wanted: CouplingRequest, progress: Callable[[int, float], None] | None = None
) -> Certificate:
    """Find or take a coupling, prove it, and return the verified, sealed certificate.

    Args:
        loop: the haptic loop.
        wanted: what is asked of the coupling.
        progress: called with the iteration's number and its ||W Z - I||.

    Raises:
        Infeasible: no coupling of that class, or not the given one, can be certified.
        NotConverged: the synthesis stopped at its cap.
        SolverFailure: the solver's answer does not survive verification.
        TooLarge: more states than :data:`MOST_STATES`.
        ValueError: a given coupling has not the loop's ports or blocks.
    """
    _require_size(loop)
    coupling, blocks, method = _find(loop, wanted, progress)
    _well_posed(loop, blocks)
    levels = certify_given(loop, blocks)
    draft = Certificate(loop, ASSUMED_DELAY, coupling, blocks, levels, {}, method)
    certificate = seal(replace(draft, margins=margins(draft)))
    failing = [f for f in verify(certificate, content(certificate)) if not f.holds]
    if failing:
        worst = failing[0]
        raise SolverFailure(
            f"the solver's answer does not survive verification: {worst.condition}: found {worst.value:.3g}, "
            f"bound {worst.bound:.3g}"
        )
    return certificate


def _require_size(loop: HapticLoop) -> None:
    """Storage matrices are dense here, and their programs grow with the fourth power of the states."""
    m, n = len(loop.ports), len(loop.network.masses)
    if m + n > MOST_STATES:
        raise TooLarge(
            f"found {m} ports and {n} masses, up to {m + n} states of the environment; expected at most {MOST_STATES}; "
            "divide the session, or leave out what is far from the hands"
        )


def _find(
    loop: HapticLoop, wanted: CouplingRequest, progress: Callable[[int, float], None] | None
) -> tuple[SpringDamper | None, tuple[StateSpace, ...], dict[str, str | int]]:
    """The coupling, its blocks, and how it was found."""
    tools: dict[str, str | int] = {
        "solver": SOLVER.lower(),
        "cvxpy": cvxpy.__version__,
        "numpy": np.__version__,
    }
    match wanted:
        case NoCoupling():
            raise Infeasible(
                "there is no coupling: f_v = -E x leaves V_hat = -(z-1)/(Tz) K, output strictly passive at no level",
                ("use 'design: {coupling: spring-damper}'",),
            )
        case LinearGiven(blocks):
            found = [(block.outputs, block.inputs) for block in blocks]
            sizes = [(len(ports), len(ports)) for ports in loop.partition.blocks]
            if found != sizes:
                raise ValueError(f"expected blocks of V with {sizes} outputs and inputs, found {found}")
            return None, blocks, {"algorithm": "given", **tools}
        case SpringDamperGiven(coupling):
            method: dict[str, str | int] = {"algorithm": "given", **tools}
        case _:
            coupling, convergence = design_spring_damper(loop, progress)
            method = {
                "algorithm": "Theorem 4, cone complementarity linearisation",
                "iterations": convergence.iterations,
                **tools,
            }
    m = len(loop.ports)
    if coupling.stiffness.shape != (m, m):
        raise ValueError(f"expected a coupling of {m} ports, found {len(coupling.stiffness)}")
    parts = coupling.restrict(loop.partition)
    try:
        blocks = tuple(part.realisation(loop.period) for part in parts)
    except ValueError as error:
        raise Infeasible(f"the coupling cannot be realised: {error}", ("make K and B positive definite",)) from error
    return coupling, blocks, method


def _well_posed(loop: HapticLoop, blocks: tuple[StateSpace, ...]) -> None:
    """The algebraic loop of D_E and D_V has one solution a tick."""
    D_E = loop.network.environment(loop.period).D
    D_V = loop.partition.embed([block.D for block in blocks])
    if not np.linalg.cond(np.eye(len(loop.ports)) + D_E @ D_V) < 1e12:
        raise Infeasible(
            "I + D_E D_V is singular: force and tool position have no unique solution in a tick",
            ("change the coupling's direct feedthrough D",),
        )
