"""The environment's best level Phi_E for given levels of everybody else: exact, for a hundred ports and more.

With H(w) the Hermitian part of E_hat(e^jw), condition (10) of [Bianchini2010]_ and the environment's promise ask for

    [ Delta_G - Phi_E      -Phi_E        ]
    [     -Phi_E       Delta_V - Phi_E   ]  >= t I    and    H(w) + Phi_E >= 0 for all w.

Nothing has to be searched for in the matrix Phi_E. Of all that satisfy the first inequality there is a *greatest*, the
parallel sum [Anderson1969]_ of X = Delta_G - t I and Y = Delta_V - t I,

    Phi(t) = X (X + Y)^{-1} Y,        s^T Phi(t) s = min over a + b = s of (a^T X a + b^T Y b),

and the second inequality only gains from a greater Phi_E. Delta_G and Delta_V have the structure of V, hence so has
Phi(t): each block can be told its own part, and structure costs nothing. What is left is a search over the frequency,

    t* = min over w of lambda_min [ Delta_G + H(w)      H(w)         ]
                                  [     H(w)        Delta_V + H(w)   ],

a passivity index. It is found from above by a level-set method [Boyd1990]_: every frequency is a bound on t*, and the
imaginary eigenvalues of a Hamiltonian matrix tell between which frequencies a bound is still violated, off any grid.

The same search gives the least multiple of a matrix Delta that is admissible as Phi_E; the loop can be certified by
*some* coupling when less than all of Delta_G is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from manyhands.design.cayley import gaps
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.frequency import Dissipation, crossings
from manyhands.design.partition import Partition
from manyhands.design.split import Split
from manyhands.design.statespace import Matrix, symmetric_part

Progress = Callable[[str], None]

_TOLERANCE = 1e-8  # between t* and the bound found, of t* or of _LEAST_SCALE times the levels
_LEAST_SCALE = 1e-3  # a margin below this part of Delta_G is measured against it, not against itself
_MOST_TESTS = 40  # each at least halves what is open, most do far better
_ROUNDING = 1e-10  # relative differences of eigenvalues that mean nothing
_BRACKET = 1e-7  # relative width to which a minimum's frequency is searched: its value is flat there


@dataclass(frozen=True, eq=False)
class LevelFound:
    """The environment's level and the margin it leaves.

    Attributes:
        t: least eigenvalue of (10) at Phi_E, recomputed from it, N*s/m.
        best: the greatest t that any Phi_E allows, N*s/m.
        Phi_E: m x m with the wanted structure, N*s/m; H(w) + Phi_E > 0 strictly.
        frequency: where the environment limits t, rad/s.
        tests: number of Hamiltonian tests that were made.
        margins: the levels that were searched.
    """

    t: float
    best: float
    Phi_E: Matrix
    frequency: float
    tests: int
    margins: LoopMargins

    def eased(self, reserve: float) -> LevelFound:
        """The level that gives up another part of the best t; nothing has to be searched again."""
        Phi_E = self.margins.level((1.0 - reserve) * self.best)
        return replace(self, Phi_E=Phi_E, t=self.margins.margin(Phi_E))


@dataclass(frozen=True)
class LackOfPassivity:
    """How much of a level Delta an environment needs.

    Attributes:
        multiple: the least s for which s Delta is admissible as Phi_E; below zero for a strictly passive environment.
        frequency: where it is needed, rad/s.
    """

    multiple: float
    frequency: float


def best_level(
    split: Split,
    T: float,
    Delta_G: Matrix,
    Delta_V: Matrix,
    partition: Partition | None = None,
    reserve: float = 1e-6,
    progress: Progress | None = None,
) -> LevelFound:
    """Find the Phi_E that leaves condition (10) the greatest margin t.

    Args:
        split: E_hat, m ports.
        T: period, s.
        Delta_G: level of the devices behind the transformation, m x m, N*s/m.
        Delta_V: level of V_hat, m x m, N*s/m.
        partition: structure that Phi_E is to have; Delta_G and Delta_V must have it. None: Phi_E may be full.
        reserve: part of the best t that is given up so that E_hat's inequality is strict by at least half of that: a
            storage function that can be verified needs some room.
        progress: told about every Hamiltonian test.

    Raises:
        Infeasible: no Phi_E leaves a positive margin; with the figure and the frequency.
        SolverFailure: a mode that does not decay; or the search did not end, which rounding alone could cause.
        ValueError: a level of wrong shape, unsymmetric, not positive definite, or without the structure.
    """
    m = split.rest.inputs
    partition = partition or Partition(("all",), (tuple(range(m)),))
    for name, level in (("Delta_G", Delta_G), ("Delta_V", Delta_V)):
        _require_level(name, level, m)
        if not partition.admits(level):
            raise ValueError(f"expected {name} to have the structure {partition.blocks}")
    margins = LoopMargins(Delta_G, Delta_V, partition)
    floor = _LEAST_SCALE * float(np.linalg.eigvalsh(Delta_G)[0])
    best, frequency, tests = _lowest(Dissipation(split, T), margins, floor, progress)
    given_up = reserve * max(best, floor)
    if best <= given_up:
        raise Infeasible(
            f"condition (10) fails: the environment lacks passivity at {frequency / T:.4g} rad/s, where no Phi_E "
            f"leaves a greater margin than {best:.4g} N*s/m, expected more than {given_up:.3g}",
            (
                "use devices with more damping (a greater osp)",
                "soften the environment or give it more damping",
                "shorten the period, or the environment's delay",
            ),
        )
    Phi_E = margins.level(best - given_up)
    return LevelFound(margins.margin(Phi_E), best, Phi_E, frequency / T, tests, margins)


def lack_of_passivity(split: Split, T: float, Delta: Matrix, progress: Progress | None = None) -> LackOfPassivity:
    """Find the least s for which Phi_E = s Delta is admissible: H(w) + s Delta >= 0 for all w.

    Args:
        split: E_hat, m ports.
        T: period, s.
        Delta: m x m symmetric positive definite, N*s/m; with Delta = Delta_G some coupling can be certified iff s < 1.
        progress: told about every Hamiltonian test.

    Raises:
        SolverFailure: as for :func:`best_level`.
        ValueError: Delta is not such a matrix.
    """
    _require_level("Delta", Delta, split.rest.inputs)
    found, frequency, _ = _lowest(Dissipation(split, T), _Multiples(Delta), 1.0, progress)
    return LackOfPassivity(-found, frequency / T)


def _require_level(name: str, level: Matrix, m: int) -> None:
    if level.shape != (m, m) or np.any(level != level.T):
        raise ValueError(f"expected {name} to be a symmetric {m} x {m} matrix, found shape {level.shape}")
    if not (np.all(np.isfinite(level)) and np.linalg.eigvalsh(level)[0] > 0.0):
        raise ValueError(f"expected {name} to be finite and positive definite")


class _Family(Protocol):
    """Levels Phi(t), decreasing in t: the greatest admissible t is sought."""

    def limit(self, H: NDArray[np.complex128]) -> float:
        """The greatest t with H + Phi(t) >= 0, for one frequency's m x m Hermitian H."""

    def level(self, t: float) -> Matrix:
        """Phi(t)."""


class LoopMargins:
    """The levels Phi(t) = X (X + Y)^{-1} Y with X = Delta_G - t I, Y = Delta_V - t I, block by block."""

    def __init__(self, Delta_G: Matrix, Delta_V: Matrix, partition: Partition) -> None:
        self._Delta_G, self._Delta_V, self._partition = Delta_G, Delta_V, partition
        zero = np.zeros_like(Delta_G)
        self._levels = np.block([[Delta_G, zero], [zero, Delta_V]])
        # X + Y > 0: motions of the devices against V_hat, which the environment does not feel, limit t as well
        self._most = (1.0 - _ROUNDING) * float(np.linalg.eigvalsh((Delta_G + Delta_V) / 2.0)[0])

    def limit(self, H: NDArray[np.complex128] | Matrix) -> float:
        """The greatest t with H + Phi(t) >= 0, for H of one frequency, m x m Hermitian."""
        return float(np.linalg.eigvalsh(self._levels + np.block([[H, H], [H, H]]))[0])

    def level(self, t: float) -> Matrix:
        """Phi(t), m x m."""
        parts, t = [], min(t, self._most)
        for G, V in zip(self._partition.restrict(self._Delta_G), self._partition.restrict(self._Delta_V), strict=True):
            X, Y = G - t * np.eye(len(G)), V - t * np.eye(len(V))
            parts.append(symmetric_part(X @ np.linalg.solve(X + Y, Y)))
        return self._partition.embed(parts)

    def margin(self, Phi: Matrix) -> float:
        """Least eigenvalue of (10)."""
        blocks = zip(*(self._partition.restrict(M) for M in (self._Delta_G, self._Delta_V, Phi)), strict=True)
        return min(float(np.linalg.eigvalsh(np.block([[G - F, -F], [-F, V - F]]))[0]) for G, V, F in blocks)


class _Multiples:
    """Phi(t) = -t Delta."""

    def __init__(self, Delta: Matrix) -> None:
        self._Delta = Delta
        self._scaling = np.linalg.inv(np.linalg.cholesky(Delta))

    def limit(self, H: NDArray[np.complex128]) -> float:
        return float(np.linalg.eigvalsh(self._scaling @ H @ self._scaling.T)[0])

    def level(self, t: float) -> Matrix:
        return -t * self._Delta


def _lowest(
    dissipation: Dissipation, family: _Family, floor: float, progress: Progress | None
) -> tuple[float, float, int]:
    """The least of ``family.limit`` over all frequencies, its angle w T, and the number of tests made."""

    def limit(angle: float) -> float:
        return family.limit(dissipation(angle))

    grid = dissipation.angles()
    t, worst = _least_of(dissipation, family, grid, np.inf, 0.0)
    i = int(np.searchsorted(grid, worst))
    t, worst = _refined(limit, grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)], t, worst)
    for tests in range(1, _MOST_TESTS + 1):
        probe = t - _TOLERANCE * max(abs(t), floor)
        if progress is not None:
            progress(f"environment's level: at most {t:.6g} (at {worst / dissipation.T:.4g} rad/s), test {tests}")
        ends, middles = gaps(crossings(dissipation, family.level(probe)))
        inside, angle = _least_of(dissipation, family, middles, probe, worst)
        if inside >= probe:
            return t, worst, tests
        t, worst = inside, angle
        i = int(np.searchsorted(ends, worst))
        t, worst = _refined(limit, ends[max(i - 1, 0)], ends[min(i + 1, len(ends) - 1)], t, worst)
    raise SolverFailure(
        f"the environment's level is still open after {_MOST_TESTS} tests, "
        f"at {t:.6g} and {worst / dissipation.T:.4g} rad/s"
    )


def _least_of(
    dissipation: Dissipation, family: _Family, angles: Iterable[float], t: float, worst: float
) -> tuple[float, float]:
    """The least of t and the limits at ``angles``; a Cholesky test spares most of them their eigenvalues."""
    Phi = family.level(t) if np.isfinite(t) else None
    for angle in angles:
        H = dissipation(angle)
        if Phi is not None and _positive(H + Phi):
            continue
        found = family.limit(H)
        if found < t:
            t, worst = found, float(angle)
            Phi = family.level(t)
    return t, worst


def _positive(M: NDArray[np.complex128]) -> bool:
    try:
        np.linalg.cholesky(M)
    except np.linalg.LinAlgError:
        return False
    return True


def _refined(limit: Callable[[float], float], low: float, high: float, t: float, worst: float) -> tuple[float, float]:
    """The least of t and what a bounded search between two angles finds."""
    if not low < high:
        return t, worst
    result = minimize_scalar(limit, bounds=(low, high), method="bounded", options={"xatol": _BRACKET * high})
    better = result.fun < t - _ROUNDING * abs(t)  # at 0 and pi the ends of the interval are the minima
    return (float(result.fun), float(result.x)) if better else (t, worst)
