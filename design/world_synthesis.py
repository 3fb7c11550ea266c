"""From an environment and its contracts to the certificate of a world: find Phi_E with what proves it, and prove (A).

The level is Phi_E <= 0, since at the port of a wave link nobody pays for more (:mod:`manyhands.design.world`): by the
energy of a network, by the greatest multiple of the identity that an environment of matrices keeps, or as declared.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np

from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.levels.contract import ENERGY, ENFORCED, Storage
from manyhands.design.levels.environment import RESERVES, lack_of_passivity, storage
from manyhands.design.levels.floats import within_floats
from manyhands.design.levels.network import diagonal_level
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import Matrix
from manyhands.design.proof import prove_world
from manyhands.design.statics import check_environment
from manyhands.design.world import CONDITION_A, World, WorldTerms, world_content

Progress = Callable[[str], None]

_ROUNDING = 1e-12  # of the level: (A) need not be strict, and the proof decides it exactly


def design_world(terms: WorldTerms, progress: Progress | None = None) -> World:
    """Find a level with which the world keeps its contracts, and prove it.

    Args:
        terms: what is asked of the world.
        progress: called with a line of text for each step.

    Raises:
        Infeasible: the environment lacks passivity where a wave link meets it.
        SolverFailure: the level does not survive the proof.
    """
    check_environment(terms.environment)
    with within_floats(terms.environment):
        Phi_E, P_E, method = _level(terms.environment, terms.period, progress)
    try:
        return _proved(terms, Phi_E, P_E, method, progress)
    except SolverFailure:
        if terms.environment.passive_network is None or not np.any(Phi_E):
            raise
        return _proved(terms, np.zeros_like(Phi_E), ENERGY, method, progress)  # which needs no arithmetic


def _proved(terms: WorldTerms, Phi_E: Matrix, P_E: Storage, method: str, progress: Progress | None) -> World:
    """The world with this level, proved."""
    margin = float(np.linalg.eigvalsh(terms.promised() - Phi_E)[0])
    if margin < -_ROUNDING * float(np.max(np.abs(Phi_E))):
        raise _lacking(-margin, "so its declared level says")
    found = terms.kept(Phi_E, P_E, {CONDITION_A: max(margin, 0.0)}, {"algorithm": method, "numpy": np.__version__})
    if progress is not None:
        progress("proving the world")
    data = {"id": found.id, **world_content(found)}
    failing = [finding for finding in prove_world(data) if not finding.holds]
    if failing:
        raise SolverFailure(
            f"the world's level does not survive the proof: {failing[0].condition} ({failing[0].argument})"
        )
    return found


def _level(environment: Environment, T: float, progress: Progress | None) -> tuple[Matrix, Storage, str]:
    """Phi_E <= 0 with what proves it, and the method; or the declared level."""
    promised = environment.promised()
    if promised is not None:
        return promised, ENFORCED, "declared"
    if environment.passive_network is not None:
        return diagonal_level(environment.passive_network, T), ENERGY, "mechanical energy"
    split = environment.split(T)
    I = np.eye(split.rest.inputs)
    found = lack_of_passivity(split, T, I, progress)
    if found.multiple >= 0.0:
        raise _lacking(found.multiple, f"it lacks passivity at {found.frequency:.4g} rad/s")
    for reserve in RESERVES:
        Phi_E = (1.0 - reserve) * found.multiple * I
        with contextlib.suppress(SolverFailure):  # the next level leaves its storage function more room
            P = storage(split, T, Phi_E, progress, found.frequency)
            return Phi_E, split.stated(P), "greatest multiple of the identity"
    raise SolverFailure("the environment is passive, but no storage function with room for a proof was found")


def _lacking(lack: float, where: str) -> Infeasible:
    return Infeasible(
        f"condition (A) fails: the environment needs {lack:.4g} N·s/m at the ports of wave links, where nobody pays "
        f"for it: {where}"
    )
