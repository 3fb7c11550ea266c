"""Cone complementarity linearisation [ElGhaoui1997]_, step 1 to 4 of section 4.1 in [Bianchini2010]_.

A program is linear in its unknowns but for pairs of symmetric ones that must be inverses of each other,

    W_i Z_i = I,    W_i, Z_i of the same size, in whatever units make them of order one.

Relaxed to the cone [W_i I; I Z_i] >= 0 (18), it is solved once for a feasible point, and then

    minimise sum_i trace(W_i^j Z_i + Z_i^j W_i)    around the last iterate W^j, Z^j

again and again: on the cone trace(W Z) is least, the size of W, exactly where W Z = I. The objective never grows, but
nothing promises that it gets there. So there is a cap on iterations, and what was reached is told and handed on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import cvxpy as cp
import numpy as np

from manyhands.design.errors import DesignError, NotConverged, SolverFailure
from manyhands.design.solver import ProgramInfeasible, solve, value
from manyhands.design.statespace import symmetric_part

TOLERANCE = 1e-4  # on ||W Z - I||, spectral norm
MOST_ITERATIONS = 200

Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class Convergence:
    """How the iteration went.

    Attributes:
        residuals: ||W Z - I|| after each iteration, the first one being step 2's; empty before that.
    """

    residuals: tuple[float, ...]

    @property
    def iterations(self) -> int:
        """Number of linearised programs solved after the first feasible point."""
        return max(len(self.residuals) - 1, 0)


class Interrupted(DesignError):
    """Somebody ended the iteration with Ctrl-C.

    Attributes:
        best: what the best iterate so far gave, or None; not proved to be anything.
        convergence: how far it got.
    """

    def __init__(self, message: str, best: Any, convergence: Convergence) -> None:
        self.best = best
        self.convergence = convergence
        super().__init__(message)


class StoppedShort(NotConverged):
    """The iteration ended before W Z = I.

    Attributes:
        best: what the best iterate gave, or None; :func:`manyhands.design.theorem3.certify_given` may prove it yet.
        convergence: how far it got.
    """

    def __init__(self, message: str, best: Any, convergence: Convergence) -> None:
        self.best = best
        self.convergence = convergence
        super().__init__(message)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two symmetric unknowns, r x r each, that are to become inverses of each other (17).

    Attributes:
        W: one of them, e.g. Sigma or Q.
        Z: the other one, e.g. Delta_V or Y.
    """

    W: cp.Variable
    Z: cp.Variable

    def cone(self) -> cp.Constraint:
        """[W I; I Z] >= 0 (18): W > 0 and Z >= W^{-1}."""
        I = np.eye(self.W.shape[0])
        return cp.bmat([[self.W, I], [I, self.Z]]) >> 0

    def residual(self) -> float:
        """||W Z - I||, spectral norm, of the values last found."""
        return float(np.linalg.norm(value(self.W) @ value(self.Z) - np.eye(self.W.shape[0]), 2))


@dataclass(frozen=True, eq=False)
class Relaxed(Generic[Found]):
    """A program whose pairs are relaxed to their cones, and what to take from its solution.

    Attributes:
        constraints: everything but (18).
        pairs: the pairs of (17).
        recover: the answer in the unknowns' present values; None where they give none (a singular C_V, say).
        what: for messages, e.g. "Theorem 4".
    """

    constraints: Sequence[cp.Constraint]
    pairs: Sequence[Pair]
    recover: Callable[[], Found | None]
    what: str


def complement(
    relaxed: Relaxed[Found], *, iterations: int = MOST_ITERATIONS, progress: Callable[[str], None] | None = None
) -> tuple[Found, Convergence]:
    """Iterate until ||W Z - I|| < :data:`TOLERANCE` for every pair.

    Args:
        relaxed: the program.
        iterations: cap on the linearised programs solved after the first feasible point, >= 0.
        progress: called after each program, with a line such as ``iteration 3, |WZ - I| = 1.2e-03``.

    Returns:
        What ``recover`` makes of the last iterate, and the convergence. Up to the tolerance it satisfies the program:
        the caller has to prove it by other means.

    Raises:
        ProgramInfeasible: the relaxed program has no solution, hence the program has none (step 2).
        StoppedShort: the cap was reached, or a solver stumbled on the way; ``best`` is what ``recover`` made
            of the iterate with the least residual, or None.
        Interrupted: KeyboardInterrupt arrived; ``best`` likewise.
        SolverFailure: the solver gave no usable first point.
        ValueError: a negative cap.
    """
    if iterations < 0:
        raise ValueError(f"found a cap of {iterations} iterations, expected one >= 0")
    path: _Path[Found] = _Path(relaxed, progress)
    try:
        return path.follow(iterations)
    except KeyboardInterrupt as error:
        message = f"{relaxed.what}: interrupted {path.reached()}"
        raise Interrupted(message, path.best, path.convergence()) from error


class _Path(Generic[Found]):
    """The iterates so far: residuals, and what the best of them gave."""

    def __init__(self, relaxed: Relaxed[Found], progress: Callable[[str], None] | None) -> None:
        self.relaxed = relaxed
        self.progress = progress
        self.residuals: list[float] = []
        self.least = np.inf
        self.best: Found | None = None

    def follow(self, iterations: int) -> tuple[Found, Convergence]:
        """Step 2, then step 3 until step 4 is content."""
        pairs, what = self.relaxed.pairs, self.relaxed.what
        constraints = [*self.relaxed.constraints, *(pair.cone() for pair in pairs)]
        solve(cp.Problem(cp.Minimize(0), constraints), f"{what}, first feasible point")
        found = self.arrive()
        around = [(_parameter(pair.W), _parameter(pair.Z)) for pair in pairs]
        objective = sum(
            cp.trace(W_j @ pair.Z) + cp.trace(Z_j @ pair.W) for pair, (W_j, Z_j) in zip(pairs, around, strict=True)
        )
        linearised = cp.Problem(cp.Minimize(objective), constraints)
        while not self.residuals[-1] < TOLERANCE:
            iteration = len(self.residuals)
            if iteration > iterations:
                raise self.short(f"stopped after {iterations} iterations at ||W Z - I|| = {self.residuals[-1]:.2e}")
            for pair, (W_j, Z_j) in zip(pairs, around, strict=True):
                W_j.value, Z_j.value = symmetric_part(value(pair.W)), symmetric_part(value(pair.Z))
            try:
                solve(linearised, f"{what}, iteration {iteration}")
            except (ProgramInfeasible, SolverFailure) as error:  # it had a solution a moment ago
                raise self.short(f"the solver found no solution in iteration {iteration}, {self.reached()}") from error
            found = self.arrive()
        if found is None:
            raise self.short(f"the last iterate gives no coupling, {self.reached()}")
        return found, self.convergence()

    def short(self, why: str) -> StoppedShort:
        """The error that says ``why`` the iteration ends here."""
        message = f"{self.relaxed.what}: {why}, wanted < {TOLERANCE:.0e}"
        return StoppedShort(message, self.best, self.convergence())

    def convergence(self) -> Convergence:
        """The residuals so far."""
        return Convergence(tuple(self.residuals))

    def arrive(self) -> Found | None:
        """Take note of the values that a solver has just left in the unknowns."""
        residual = max((pair.residual() for pair in self.relaxed.pairs), default=0.0)
        found = self.relaxed.recover()
        if found is not None and residual < self.least:
            self.least, self.best = residual, found
        self.residuals.append(residual)
        if self.progress is not None:
            self.progress(f"iteration {len(self.residuals) - 1}, |WZ - I| = {residual:.1e}")
        return found

    def reached(self) -> str:
        """How far it got, for messages."""
        if not self.residuals:
            return "before the first feasible point"
        return f"after {len(self.residuals) - 1} iterations at ||W Z - I|| = {self.residuals[-1]:.2e}"


def _parameter(variable: Any) -> cp.Parameter:
    return cp.Parameter(variable.shape, symmetric=True)
