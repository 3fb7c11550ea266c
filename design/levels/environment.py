"""The environment's best level Phi_E for given levels of all other parties, exact, for a hundred ports and more.

With H(w) the Hermitian part of E_hat(e^jw), condition (10) of [Bianchini2010]_ and the environment's promise require

    [ Delta_G - Phi_E      -Phi_E        ]
    [     -Phi_E       Delta_V - Phi_E   ]  >= t I    and    H(w) + Phi_E >= 0 for all w.

No search over the matrix Phi_E is necessary. Among all Phi_E that satisfy the first inequality there is a *greatest*,
the parallel sum [Anderson1969]_ of X = Delta_G - t I and Y = Delta_V - t I,

    Phi(t) = X (X + Y)^{-1} Y,        s^T Phi(t) s = min over a + b = s of (a^T X a + b^T Y b),

and a greater Phi_E only helps the second inequality. Delta_G and Delta_V have the structure of V, hence Phi(t) has it
too: each block can receive its own part alone, and structure costs nothing. What remains is a search over the
frequency,

    t* = min over w of lambda_min [ Delta_G + H(w)      H(w)         ]
                                  [     H(w)        Delta_V + H(w)   ],

a passivity index. A level-set method [Boyd1990]_ finds it from above. The value at any frequency is a bound on t*, and
the imaginary eigenvalues of a Hamiltonian matrix show between which frequencies a bound is still violated, without any
grid. The same search gives the least multiple of a matrix Delta that is admissible as Phi_E. *Some* coupling certifies
the loop if the environment needs less than all of Delta_G.

**Evaluation.** The Hermitian part of E_hat on the unit circle is

    H(w) = He(E_hat(e^jwT)) = He(Rest(e^jwT)) - T/2 E1                    (:mod:`manyhands.design.models.integrators`)

A is brought into complex Schur form once; after that a frequency costs one triangular solve. The test for all
frequencies finds where H + Phi is singular, by the imaginary eigenvalues of a Hamiltonian matrix [Boyd1989]_;
:mod:`manyhands.design.models.statespace` explains it.

**Storage.** One discrete Riccati equation gives the storage function of a large environment, instead of a semidefinite
program. E_hat is (-Phi_E)-ISP when some P > 0 has (:mod:`manyhands.design.models.integrators`, Rest = (A, B, C, D))

    M(P) = [A B]^T P [A B] - [ P      C^T/2 ]  <= 0,        R = He(D) + Phi_E - T/2 E1.
                             [ C/2    R     ]

The least such P is the available storage [Willems1972]_. It solves a Riccati equation with equality in n of the n + m
directions, so that it lies on the edge and serves no proof. Therefore the equation of a *tighter* problem is solved,
that of

    A / sqrt(1 - eps),   B / sqrt(1 - eps),   and a loss eps |psi|^2 a tick on states scaled to be reached equally.

Then P = (tight P)/(1 - eps) has M(P) <= -eps blockdiag(P + I, 0). This is room in every direction of the state; the
solution of the tight equation is strict in the inputs already. Doubling [Chu2004]_ solves the equation. Its k-th
iterate is the energy that can be drawn in 2^k ticks: it grows, and it converges exactly when the tight problem has a
solution.

Room is a question of coordinates. In states that nearly agree, such as those of poles beside each other, every P is
near to singular, and rounding hides the room that it has. Where the given states show none, the equation is solved
again in states that are as controllable as observable. P is then brought to the given states in long arithmetic and
rounded to floats, and *that* P has to show its room in the balanced ones. Where it shows none, the loss is spent on
states that hardly move while the inputs dissipate something. With P the inputs that dissipate one unit at every
frequency are known, w = n - K psi for white n; the next states are those that such inputs reach equally.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from flint import arb_mat, ctx
from numpy.typing import NDArray
from scipy.linalg import LinAlgWarning, schur, solve_triangular

from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.models.coupling import Partition
from manyhands.design.models.integrators import Split
from manyhands.design.models.statespace import (
    Matrix,
    StateSpace,
    axis_image,
    crossing_angles,
    gaps,
    symmetric_part,
)
from manyhands.design.models.transfer import InDifferences
from manyhands.design.solver import balancing, reachability

Angles = NDArray[np.float64]

# The Hermitian part of E_hat over frequency

_SMALL = 64  # up to so many states a general solver is no slower; a triangular one may stall in the threads it starts
_GRID = 48  # angles from _LOWEST to pi, in a geometric series; poles are added
_LOWEST = 1e-5  # rad a tick: 0.01 rad/s at 1 kHz
_APART = 0.01  # poles whose angles differ by less, relatively, share a point of the grid
_NEAR_AXIS = 1e-4  # |Re s| / |s| below which an eigenvalue counts as imaginary; a false one costs one evaluation
_HAMILTONIAN_ROUNDING = 1e-13  # the same for eigenvalues near 0, relative to the Hamiltonian's norm


class Dissipation:
    """H(w) as a function of the angle w T in [0, pi].

    Args:
        split: E_hat, m ports, order n of Rest.
        T: period, s.

    Raises:
        SolverFailure: Rest has a mode that does not decay, for which no strict inequality holds.
    """

    def __init__(self, split: Split, T: float) -> None:
        self.split, self.T = split, T
        rest = split.rest
        self._constant = symmetric_part(rest.D) - T / 2.0 * split.stiffness
        if rest.order:
            triangle, basis = schur(rest.A, output="complex")
        else:
            triangle, basis = np.zeros((0, 0)), np.zeros((0, 0))
        self._triangle = np.asarray(triangle, dtype=np.complex128)
        self._B = basis.conj().T @ rest.B
        self._C = rest.C @ basis
        self.poles = np.diag(self._triangle)
        radius = float(np.max(np.abs(self.poles), initial=0.0))
        if not radius < 1.0:
            raise SolverFailure(
                f"the environment has a mode that does not decay (a pole of modulus {radius:.9g}, such as a mass that "
                "nothing holds), so that no matrix proves it strictly passive"
            )

    def __call__(self, angle: float) -> NDArray[np.complex128]:
        """H, m x m Hermitian, N*s/m, at e^{j angle}."""
        if not len(self.poles):
            return np.asarray(self._constant, dtype=np.complex128)
        shifted = -self._triangle
        shifted[np.diag_indices_from(shifted)] += np.exp(1j * angle)
        if len(shifted) <= _SMALL:
            states = np.linalg.solve(shifted, self._B)
        else:
            states = solve_triangular(shifted, self._B, check_finite=False)
        gain = self._C @ states
        return np.asarray((gain + gain.conj().T) / 2.0 + self._constant)

    def angles(self) -> Angles:
        """Angles at which the search starts: 0, pi, a geometric series, and the angles of the poles."""
        poles = np.abs(np.angle(self.poles))
        poles = np.sort(poles[(poles > _LOWEST) & (np.abs(self.poles) > 0.5)])  # poles nearer to 0 make no peak
        kept: list[float] = []
        for angle in poles:
            if not kept or angle > kept[-1] * (1.0 + _APART):
                kept.append(float(angle))
        return np.unique(np.concatenate([[0.0], np.geomspace(_LOWEST, np.pi, _GRID), kept]))


def crossings(dissipation: Dissipation, Phi: Matrix) -> Angles:
    """All angles in [0, pi] at which H + Phi may be singular, in ascending order.

    With (A, B, C, D) the image of Rest on the imaginary axis and R = He(D) + Phi - T/2 E1 (H + Phi at z = -1),
    they belong to the imaginary eigenvalues s = j tan(wT/2) of

        [ A - B R^{-1} C / 2         -B R^{-1} B^T            ]
        [ C^T R^{-1} C / 4       -A^T + C^T R^{-1} B^T / 2    ].

    Args:
        dissipation: H.
        Phi: m x m symmetric, N*s/m.

    Returns:
        Every crossing up to rounding, and possibly some false ones.
    """
    if dissipation.split.rest.order == 0:
        return np.zeros(0)
    image = axis_image(dissipation.split.rest)
    A, B, C = image.A, image.B, image.C
    R = symmetric_part(image.D) + Phi - dissipation.T / 2.0 * dissipation.split.stiffness
    RC, RB = np.linalg.solve(R, C), np.linalg.solve(R, B.T)
    hamiltonian = np.block([[A - B @ RC / 2.0, -B @ RB], [C.T @ RC / 4.0, C.T @ RB / 2.0 - A.T]])
    return crossing_angles(hamiltonian, _NEAR_AXIS, _HAMILTONIAN_ROUNDING * float(np.linalg.norm(hamiltonian)))


# The best level

Progress = Callable[[str], None]

_TOLERANCE = 1e-8  # between t* and the bound found, relative to t*, or to _LEAST_SCALE times the levels if greater
_LEAST_SCALE = 1e-3  # for a margin below this part of Delta_G, the tolerance is relative to that part
_MOST_TESTS = 40  # each at least halves the open interval; most tests do far better
_EIGENVALUE_ROUNDING = 1e-10  # relative differences of eigenvalues below this are rounding
_BRACKET = 1e-7  # relative width to which a minimum's frequency is searched: the value is flat there


@dataclass(frozen=True, eq=False)
class LevelFound:
    """The environment's level and the margin it leaves.

    Attributes:
        t: least eigenvalue of (10) at Phi_E, recomputed from it, N*s/m.
        best: the greatest t that any Phi_E allows, N*s/m.
        Phi_E: m x m with the wanted structure, N*s/m; H(w) + Phi_E > 0 strictly.
        frequency: where the environment limits t, rad/s.
        tests: number of Hamiltonian tests that were made.
        margins: the family Phi(t) that was searched.
    """

    t: float
    best: float
    Phi_E: Matrix
    frequency: float
    tests: int
    margins: LoopMargins

    def eased(self, reserve: float) -> LevelFound:
        """The level that gives up the part ``reserve`` of the best t instead; no new search is necessary."""
        Phi_E = self.margins.level((1.0 - reserve) * self.best)
        return replace(self, Phi_E=Phi_E, t=self.margins.margin(Phi_E))


@dataclass(frozen=True)
class LackOfPassivity:
    """The multiple of a level Delta that an environment needs.

    Attributes:
        multiple: the least s for which s Delta is admissible as Phi_E; below zero for a strictly passive environment.
        frequency: where the environment needs it, rad/s.
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
        reserve: part of the best t that is given up, so that E_hat's inequality is strict by at least half of it: a
            storage function that can be verified needs some room.
        progress: called with a line of text for every Hamiltonian test.

    Raises:
        Infeasible: no Phi_E leaves a positive margin; the message has the figure and the frequency.
        SolverFailure: a mode does not decay; or the search did not end, which only rounding could cause.
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
            f"leaves a greater margin than {best:.4g} N·s/m; expected more than {given_up:.3g}"
        )
    Phi_E = margins.level(best - given_up)
    return LevelFound(margins.margin(Phi_E), best, Phi_E, frequency / T, tests, margins)


def lack_of_passivity(split: Split, T: float, Delta: Matrix, progress: Progress | None = None) -> LackOfPassivity:
    """Find the least s for which Phi_E = s Delta is admissible: H(w) + s Delta >= 0 for all w.

    Args:
        split: E_hat, m ports.
        T: period, s.
        Delta: m x m symmetric positive definite, N*s/m; with Delta = Delta_G some coupling can be certified iff s < 1.
        progress: called with a line of text for every Hamiltonian test.

    Raises:
        SolverFailure: as for :func:`best_level`.
        ValueError: Delta is not such a matrix.
    """
    _require_level("Delta", Delta, split.rest.inputs)
    found, frequency, _ = _lowest(Dissipation(split, T), _Multiples(Delta), 1.0, progress)
    return LackOfPassivity(-found, frequency / T)


def _require_level(name: str, level: Matrix, m: int) -> None:
    if level.shape != (m, m) or np.any(level != level.T):
        raise ValueError(f"{name}: found the shape {level.shape}; expected a symmetric {m} x {m} matrix")
    if not (np.all(np.isfinite(level)) and np.linalg.eigvalsh(level)[0] > 0.0):
        raise ValueError(f"expected {name} to be finite and positive definite")


class _Family(Protocol):
    """Levels Phi(t), decreasing in t; the search finds the greatest admissible t."""

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
        # X + Y > 0 limits t as well: the devices may move against V_hat without moving the environment
        self._most = (1.0 - _EIGENVALUE_ROUNDING) * float(np.linalg.eigvalsh((Delta_G + Delta_V) / 2.0)[0])

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
    """The multiples Phi(t) = -t Delta of one level."""

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
    """The least of ``family.limit`` over all frequencies, its angle w T, and the number of tests made.

    A Hamiltonian test at t returns the angles where the bound may be crossed. Between two of them the bound holds or is
    violated throughout, so that one angle in each gap decides, and lowers t if it is violated there.
    """

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
        f"the search for the environment's level did not end within {_MOST_TESTS} tests, "
        f"at {t:.6g} and {worst / dissipation.T:.4g} rad/s"
    )


def _least_of(
    dissipation: Dissipation, family: _Family, angles: Iterable[float], t: float, worst: float
) -> tuple[float, float]:
    """The least of t and the limits at ``angles``, with its angle; for most angles a Cholesky test is enough."""
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
    """The least of t and the minimum that a bounded search finds between two angles, with its angle."""
    if not low < high:
        return t, worst
    from scipy.optimize import minimize_scalar  # it is slow to import, and only this function needs it

    result = minimize_scalar(limit, bounds=(low, high), method="bounded", options={"xatol": _BRACKET * high})
    better = result.fun < t - _EIGENVALUE_ROUNDING * abs(t)  # at 0 and pi the ends of the interval are the minima
    return (float(result.fun), float(result.x)) if better else (t, worst)


# The storage function

MOST_TIGHTENED = 5e-4  # the first eps
LEAST_TIGHTENED = 1e-12  # the last eps: below it, rounding is as large
ENOUGH_ROOM = 1e-10  # least eigenvalue of -M and of P, scaled to unit diagonal: a million times double precision's
ENOUGH_LONG_ROOM = 1e-12  # the same where they are computed in long arithmetic: ten thousand times double precision's
RESERVES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1)  # parts of the best margin given up; the first that leaves enough room
_STEP = 0.3  # factor from one eps to the next
_MOST_DOUBLINGS = 60  # 2^60 ticks
_CONVERGED = 1e-14  # relative change of the storage in one doubling
_CHANGES = 2  # of states: balanced, then evenly reached; further ones gain nothing, as they grow worse conditioned
MOST_CHANGED = 100  # states of Rest: long arithmetic then takes a second for each eps and each level
_HARDLY = 1e-8  # of the largest variance: what a direction counts as reached at least, which bounds X's condition
_LONG = 256  # bits, for a P in states that are 1e20 times better reached in some directions than in others
_UNREACHED = 1e-12  # of the largest variance: a state that the inputs reach less is scaled as if they reached it so far


def level_and_storage(
    split: Split,
    T: float,
    Delta_G: Matrix,
    Delta_V: Matrix,
    partition: Partition | None = None,
    progress: Callable[[str], None] | None = None,
    changed: bool = True,
) -> tuple[LevelFound, Matrix | InDifferences]:
    """The environment's best level with a storage function that proves it; it gives up as little margin as it can.

    Slow modes of large environments dissipate very little in a tick. Floating point cannot distinguish a level on the
    very edge of what is possible from a level beyond it.

    Arguments and errors are those of :func:`best_level` and :func:`storage`.

    Returns:
        The level, and P as a certificate states it (:meth:`.Split.stated`).
    """
    best = best_level(split, T, Delta_G, Delta_V, partition, RESERVES[0], progress)
    for reserve in RESERVES[:-1]:
        found = best.eased(reserve)
        try:
            return found, split.stated(storage(split, T, found.Phi_E, progress, found.frequency, changed))
        except SolverFailure as error:
            if progress is not None:
                progress(f"environment: {error}; giving up more of the margin")
    found = best.eased(RESERVES[-1])
    return found, split.stated(storage(split, T, found.Phi_E, progress, found.frequency, changed))


def storage(
    split: Split,
    T: float,
    Phi_E: Matrix,
    progress: Callable[[str], None] | None = None,
    frequency: float | None = None,
    changed: bool = True,
) -> Matrix:
    """Find P > 0 with M(P) < 0, with room for a proof in floating point or ball arithmetic.

    Args:
        split: E_hat, m ports, order n of Rest, stable.
        T: period, s.
        Phi_E: m x m symmetric, N*s/m; strictly admissible, as :func:`best_level` returns it.
        progress: called with a line of text for every eps tried.
        frequency: where the environment needs Phi_E most, rad/s, as :func:`best_level` returns it: a hint for the first
            eps. Without it a grid of frequencies is searched.
        changed: whether other states are tried where the given ones show no room.

    Returns:
        P, n x n, in the coordinates of Rest. psi^T P psi is an energy over T; the entries are N*s/m over the squares
        of the states' units.

    Raises:
        SolverFailure: no storage function exists, or none with room.
    """
    rest, n = split.rest, split.rest.order
    R = symmetric_part(rest.D) + Phi_E - T / 2.0 * split.stiffness
    values, vectors = np.linalg.eigh(R)
    if not values[0] > 0.0:
        raise SolverFailure("Phi_E is less than the environment needs: He(D) + Phi_E - T/2 E1 is not positive definite")
    if n == 0:
        return np.zeros((0, 0))
    ports = vectors / np.sqrt(values)  # w = ports @ (scaled w): in scaled ports R is the identity
    A, B, C = rest.A, rest.B @ ports, ports.T @ rest.C
    radius = float(np.max(np.abs(np.linalg.eigvals(A))))
    if not radius < 1.0:
        raise SolverFailure(f"the environment has a mode that does not decay: a pole of modulus {radius:.9g}")
    reached = np.diag(reachability(A, B))
    most = float(np.max(reached, initial=0.0))
    unit = np.sqrt(np.where(reached > _UNREACHED * most, reached, most if most > 0.0 else 1.0))
    angle = _tightest_angle(split, T, Phi_E, ports) if frequency is None else frequency * T
    point, most = np.exp(1j * angle), min(MOST_TIGHTENED, (1.0 - radius**2) / 4.0)
    P = _tight_storage(A / unit[:, None] * unit, B / unit[:, None], C * unit, point, most, progress)
    if P is not None:
        P = symmetric_part(P / unit[:, None] / unit)
        if room(split, T, Phi_E, P) >= ENOUGH_ROOM:
            return P
    # numbers for which there are no such states
    nowhere = contextlib.suppress(np.linalg.LinAlgError, LinAlgWarning, ZeroDivisionError)
    with nowhere, warnings.catch_warnings():
        warnings.simplefilter("error", LinAlgWarning)
        X = balancing(StateSpace(A, B, C, np.zeros((len(values), len(values)))))
        for _ in range(_CHANGES if changed and n <= MOST_CHANGED else 0):
            back = np.linalg.inv(X)
            system = X @ A @ back, X @ B, C @ back
            P = _tight_storage(*system, point, most, progress)
            if P is None or not np.all(np.isfinite(P)):
                break
            given, least = _in_given_states(split, T, Phi_E, P, X)
            if least >= ENOUGH_LONG_ROOM:
                return given
            X = _evenly_reached(*system, P) @ X
    raise SolverFailure(
        "no storage function with room to verify it: Phi_E is too close to what the environment needs, or below"
    )


def _tight_storage(
    A: Matrix, B: Matrix, C: Matrix, point: complex, most: float, progress: Callable[[str], None] | None
) -> Matrix | None:
    """P of the tight problem with the first eps, from ``most`` downwards, that has a solution; None if none has."""
    eps = _first_tightened(A, B, C, point, most)
    while eps >= LEAST_TIGHTENED:
        if progress is not None:
            progress(f"storage function of the environment: tightened by {eps:.2g}")
        P = _available_storage(A / np.sqrt(1.0 - eps), B / np.sqrt(1.0 - eps), C, eps)
        if P is not None:
            return P / (1.0 - eps)  # a smaller eps leaves less room
        eps *= _STEP
    return None


def _evenly_reached(A: Matrix, B: Matrix, C: Matrix, P: Matrix) -> Matrix:
    """X, n x n: in the states X psi, inputs that dissipate equally at every frequency reach all directions equally.

    With the storage P these are w = W^{-1/2} n - K psi, n white, W = I - B^T P B, K = W^{-1} (C/2 - B^T P A).
    """
    W = np.eye(B.shape[1]) - B.T @ P @ B
    held = A - B @ np.linalg.solve(W, C / 2.0 - B.T @ P @ A)
    values, vectors = np.linalg.eigh(symmetric_part(reachability(held, B @ np.linalg.inv(np.linalg.cholesky(W)).T)))
    values = np.maximum(values, _HARDLY * values[-1])
    return np.asarray((vectors / np.sqrt(values)).T)


def _in_given_states(split: Split, T: float, Phi_E: Matrix, P: Matrix, X: Matrix) -> tuple[Matrix, float]:
    """A storage matrix in the states X psi brought to psi, in floats, and the room that it has there, seen in X psi."""
    rest, m = split.rest, split.rest.inputs
    with ctx.workprec(_LONG):
        long = _balls(X)
        given = long.transpose() * _balls(P) * long
        rounded = symmetric_part(_floats(given))
        stored, moved = _balls(rounded), _balls(np.hstack([rest.A, rest.B]))
        inverse = long.inv()
        R = symmetric_part(rest.D) + Phi_E - T / 2.0 * split.stiffness
        M = _balls(np.block([[np.zeros_like(rounded), rest.C.T / 2.0], [rest.C / 2.0, R]]))
        M = M + _bordered(stored, m, 0) - moved.transpose() * stored * moved
        whole = _bordered(inverse, m, 1)
        seen = [_floats(N.transpose() * K * N) for N, K in ((inverse, stored), (whole, M))]
    return rounded, min(_scaled_least(symmetric_part(N)) for N in seen)


def _balls(M: Matrix) -> arb_mat:
    rows, columns = M.shape
    return arb_mat(rows, columns, M.ravel().tolist())


def _floats(M: arb_mat) -> Matrix:
    return np.array([float(entry) for entry in M.entries()]).reshape(M.nrows(), M.ncols())


def _bordered(M: arb_mat, m: int, corner: int) -> arb_mat:
    """blockdiag(M, corner I) with I of m rows."""
    n = M.nrows()
    out = arb_mat(n + m, n + m)
    for i in range(n):
        for j in range(n):
            out[i, j] = M[i, j]
    for i in range(n, n + m):
        out[i, i] = corner
    return out


def _tightest_angle(split: Split, T: float, Phi_E: Matrix, ports: Matrix) -> float:
    """The angle of a grid at which H + Phi_E is least, in scaled ports."""
    dissipation = Dissipation(split, T)
    angles = dissipation.angles()
    least = [np.linalg.eigvalsh(ports.T @ (dissipation(angle) + Phi_E) @ ports)[0] for angle in angles]
    return float(angles[int(np.argmin(least))])


def _first_tightened(A: Matrix, B: Matrix, C: Matrix, point: complex, eps: float) -> float:
    """The first eps, downwards from ``eps``, that leaves half of the environment's dissipation at ``point``."""

    def least(eps: float) -> float:
        root = np.sqrt(1.0 - eps)
        states = np.linalg.solve(point * np.eye(len(A)) - A / root, B.astype(np.complex128) / root)
        gain = C @ states
        left = np.eye(B.shape[1]) + (gain + gain.conj().T) / 2.0 - eps * states.conj().T @ states
        return float(np.linalg.eigvalsh(left)[0])

    whole = least(0.0)
    while eps >= LEAST_TIGHTENED and least(eps) < whole / 2.0:
        eps *= _STEP
    return eps


def room(split: Split, T: float, Phi_E: Matrix, P: Matrix) -> float:
    """Least eigenvalue of -M(P) and of P, each scaled to a unit diagonal; if it is not positive, P proves nothing."""
    return min(_scaled_least(P), _scaled_least(-split.dissipation(P, Phi_E, T)))


def _scaled_least(M: Matrix) -> float:
    diagonal = np.diag(M)
    if not len(diagonal):
        return np.inf
    if not (np.all(np.isfinite(M)) and np.all(diagonal > 0.0)):
        return -np.inf
    scale = 1.0 / np.sqrt(diagonal)
    return float(np.linalg.eigvalsh(scale[:, None] * M * scale)[0])


def _available_storage(A: Matrix, B: Matrix, C: Matrix, loss: float) -> Matrix | None:
    """The least P with [A B]^T P [A B] - [P - loss I, C^T/2; C/2, I] <= 0, by doubling; None if no P exists.

    With X = -P this is X = F^T X (I + G X)^{-1} F + Q for F = A - B C/2, G = B B^T, Q = -(C^T C/4 + loss I).
    """
    n, m = B.shape
    F, G, X = A - B @ C / 2.0, B @ B.T, -(C.T @ C / 4.0 + loss * np.eye(n))
    for _ in range(_MOST_DOUBLINGS):
        # If I - B^T P B > 0 fails, inputs draw unbounded energy in 2^k ticks, and no P exists.
        if not np.all(np.isfinite(X)) or np.linalg.eigvalsh(np.eye(m) + B.T @ X @ B)[0] <= 0.0:
            return None
        solved = np.linalg.solve(np.eye(n) + G @ X, np.hstack([F, G @ F.T]))
        drawn = symmetric_part(F.T @ X @ solved[:, :n])
        G = symmetric_part(G + F @ solved[:, n:])
        X = X + drawn
        F = F @ solved[:, :n]
        if float(np.max(np.abs(drawn))) <= _CONVERGED * float(np.max(np.abs(X))):
            return -X
    return None
