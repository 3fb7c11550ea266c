"""The H-infinity norm of a stable discrete system, its peak frequencies, and a storage function that proves a bound.

    ||S||_inf = max over theta in [0, pi] of sigma_max(S(e^{j theta}))

A fine grid finds the peaks, and each peak is narrowed down. A check without a grid then shows that no peak is hidden
between two points ([Bruinsma1990]_): gamma is a singular value of S(e^{j theta}) for some theta iff a Hamiltonian
matrix has an imaginary eigenvalue, and that eigenvalue gives theta (:mod:`manyhands.design.models.statespace`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov

from manyhands.design.errors import SolverFailure
from manyhands.design.models.statespace import (
    Matrix,
    StateSpace,
    axis_image,
    crossing_angles,
    frequency_response,
    gaps,
    symmetric_part,
)
from manyhands.design.solver import reachability

ComplexArray = NDArray[np.complex128]

_TOLERANCE = 1e-7  # relative: a peak between grid points is searched only if it is higher by this
_ON_AXIS = 1e-5  # an eigenvalue this close to the axis counts: a false one costs an evaluation, a missed one a peak
_UNREACHED = 1e-14  # of the farthest: a state that the inputs move less far is reached by rounding only
_HARDLY_REACHED = 1e-10  # of the greatest variance: directions with less are scaled as if they had this much
_SLACKS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # parts of gamma given up for strictness; the first with a solution is used
_KEPT_SLACK = 0.1  # of a slack squared: the strictness that the result must keep; the rest is for rounding
_LYAPUNOV = "bilinear"  # the direct method squares the order and the condition number
_MOST_POLICIES = 60
_MOST_ROUNDS = 20


def frequency_grid(poles: ComplexArray, per_decade: int = 40) -> Matrix:
    """Angles in [0, pi] that resolve every resonance: logarithmic, and dense around each pole's own angle.

    Args:
        poles: poles in the z plane.
        per_decade: density of the logarithmic part.
    """
    moved = np.abs(poles[np.abs(poles) > 1e-6])
    corners = np.abs(np.log(poles[np.abs(poles) > 1e-6].astype(np.complex128)))
    slowest = max(min([1e-2, *(0.05 * corners[corners > 0.0])]), 1e-9)
    base = np.logspace(np.log10(slowest), np.log10(np.pi), int(per_decade * np.log10(np.pi / slowest)) + 2)
    parts = [np.array([0.0, np.pi]), base, np.linspace(0.05, np.pi, per_decade)]
    steps = np.concatenate([-np.logspace(-1.0, 1.0, 9), np.zeros(1), np.logspace(-1.0, 1.0, 9)])
    for pole, radius in zip(poles[np.abs(poles) > 1e-6], moved, strict=True):
        parts.append(abs(np.angle(pole)) + abs(np.log(radius)) * steps)
    grid = np.concatenate(parts)
    return np.unique(np.clip(grid, 0.0, np.pi))


def refined_peaks(height: Callable[[Matrix], Matrix], grid: Matrix, passes: int = 3) -> tuple[Matrix, Matrix]:
    """Local maxima of ``height`` over [0, pi], each narrowed down: angles and heights, highest first.

    Args:
        height: values at many angles at once.
        grid: sorted angles that separate the maxima.
        passes: each divides the spacing around a maximum by 8.
    """
    values = height(grid)
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    at = np.flatnonzero(
        (values >= padded[:-2]) & (values > padded[2:]) | (values > padded[:-2]) & (values >= padded[2:])
    )
    if at.size == 0:
        at = np.array([int(np.argmax(values))])
    centre, best = grid[at], values[at]
    width = np.maximum(grid[np.minimum(at + 1, len(grid) - 1)] - centre, centre - grid[np.maximum(at - 1, 0)])
    for _ in range(passes):
        fine = np.clip(centre[:, None] + width[:, None] * np.linspace(-1.0, 1.0, 17), 0.0, np.pi)
        found = height(fine.ravel()).reshape(fine.shape)
        column = np.argmax(found, axis=1)
        rows = np.arange(len(fine))
        better = found[rows, column] > best
        centre = np.where(better, fine[rows, column], centre)
        best = np.where(better, found[rows, column], best)
        width = width / 8.0
    order = np.argsort(-best)
    return np.asarray(centre[order]), np.asarray(best[order])


def hinf_norm(system: StateSpace, T: float = 1.0) -> tuple[float, float]:
    """||S||_inf of a discrete system and the frequency of its peak.

    Args:
        system: stable.
        T: period in s; with the default, the frequency is in rad a sample.

    Returns:
        The norm, with a relative error of about 1e-7 at most, and the frequency in rad/s.

    Raises:
        ValueError: the system is not stable, so that it has no H-infinity norm.
    """
    poles = np.linalg.eigvals(system.A).astype(np.complex128) if system.order else np.zeros(0, dtype=np.complex128)
    radius = float(np.max(np.abs(poles), initial=0.0))
    if not radius < 1.0:
        raise ValueError(f"found a pole of modulus {radius:.9g}: only a stable system has an H-infinity norm")
    system = _balanced(system)

    def height(angles: Matrix) -> Matrix:
        return np.asarray(np.linalg.norm(frequency_response(system, angles), 2, axis=(1, 2)), dtype=np.float64)

    angles, heights = refined_peaks(height, frequency_grid(poles), passes=8)
    angle, gamma = float(angles[0]), float(heights[0])
    if system.order == 0 or gamma == 0.0:
        return gamma, angle / T
    for _ in range(_MOST_ROUNDS):
        crossings = _crossings(system, gamma * (1.0 + _TOLERANCE))
        if crossings.size == 0:
            break
        angles, heights = refined_peaks(height, np.unique(np.concatenate(gaps(crossings))), passes=10)
        if heights[0] <= gamma * (1.0 + _TOLERANCE):
            break
        angle, gamma = float(angles[0]), float(heights[0])
    return gamma, angle / T


def bounded_real_storage(system: StateSpace, gamma: float) -> Matrix:
    """A storage matrix P > 0 that proves ||S||_inf < gamma, in the given states.

        [A B]^T P [A B] - blockdiag(P, gamma^2 I) + [C D]^T [C D] < 0                (bounded real lemma)

    P solves the discrete Riccati equation of the worst input, for a slightly smaller gamma so that P is strict.

    Args:
        system: stable, n states.
        gamma: a number above the norm.

    Raises:
        SolverFailure: no such P was found; gamma is not above the norm, or is too close to it.
    """
    n, p = system.order, system.inputs
    scaled, X, inverse = _input_balanced(system)
    left, out = np.hstack([scaled.A, scaled.B]), np.hstack([scaled.C, scaled.D]) / gamma
    for slack in _SLACKS:
        found = _worst_input_storage(scaled, gamma, slack)
        if found is None:
            continue  # no room left for this slack
        P = symmetric_part(gamma**2 * inverse.T @ found @ inverse)
        found = symmetric_part(X.T @ P @ X) / gamma**2  # in the given states; rounding is checked next
        M = left.T @ found @ left + out.T @ out
        M[:n, :n] -= found
        M[n:, n:] -= np.eye(p)
        least = -_KEPT_SLACK * slack**2
        if np.linalg.eigvalsh(symmetric_part(M))[-1] < least and np.all(np.linalg.eigvalsh(found) > -least):
            return P
    raise SolverFailure(f"bounded real lemma: found no storage function for gamma = {gamma:.9g}; is the norm below it?")


def _worst_input_storage(system: StateSpace, gamma: float, slack: float) -> Matrix | None:
    """Solve the bounded real Riccati equation for S/gamma by policy iteration; None if an input gains without bound.

    For the input w = F psi, the storage solves a Lyapunov equation. The next F is the worst input for this storage.
    From F = 0 the storages grow to the stabilising solution if ||S||_inf < gamma, and converge quadratically. Each step
    corrects the rounding of the step before; the invariant subspace of a pencil may be lost to rounding.
    """
    A, B, C, D = system.A, system.B, system.C / gamma, system.D / gamma
    n, p = system.order, system.inputs
    F: Matrix = np.zeros((p, n))
    P: Matrix = np.zeros((n, n))
    for _ in range(_MOST_POLICIES):
        y, closed = C + D @ F, A + B @ F
        if n and not np.max(np.abs(np.linalg.eigvals(closed))) < 1.0:
            return None
        supply = y.T @ y - (1.0 - slack) * F.T @ F + slack**2 * np.eye(n)
        before, P = P, symmetric_part(solve_discrete_lyapunov(closed.T, supply, method=_LYAPUNOV)) if n else P
        room = (1.0 - slack) * np.eye(p) - D.T @ D - B.T @ P @ B
        if np.linalg.eigvalsh(symmetric_part(room))[0] <= 0.0:
            return None
        F = np.asarray(np.linalg.solve(room, B.T @ P @ A + D.T @ C), dtype=np.float64)
        if np.max(np.abs(P - before), initial=0.0) <= 1e-13 * np.max(np.abs(P), initial=1e-300):
            break
    return P


def _balanced(system: StateSpace) -> StateSpace:
    """The same system with each state scaled so that the inputs reach all states equally far."""
    scale = _units(system, reachability(system.A, system.B))
    A, B, C = system.A * scale[None, :] / scale[:, None], system.B / scale[:, None], system.C * scale[None, :]
    return StateSpace(A, B, C, system.D)


def _input_balanced(system: StateSpace) -> tuple[StateSpace, Matrix, Matrix]:
    """The system in states z, x = X z, whose reachability Gramian is about I; then X and its inverse."""
    gramian = reachability(system.A, system.B)
    unit = _units(system, gramian)
    values, vectors = np.linalg.eigh(gramian / np.outer(unit, unit))
    root = np.sqrt(np.maximum(values, _HARDLY_REACHED * max(float(np.max(values, initial=0.0)), 1e-300)))
    X = unit[:, None] * vectors * root
    inverse = (vectors / root).T / unit
    return StateSpace(inverse @ system.A @ X, inverse @ system.B, system.C @ X, system.D), X, inverse


def _units(system: StateSpace, gramian: Matrix) -> Matrix:
    """The distance that unit inputs move each state, n entries; for an unreached state, its scale at the outputs."""
    reached = np.sqrt(np.diag(gramian))
    seen = np.sqrt(np.diag(reachability(system.A.T, system.C.T)))
    most = float(np.max(reached, initial=0.0))
    gain = max(float(np.max(reached * seen, initial=0.0)), 1e-300)
    shown = np.divide(gain, seen, out=np.full_like(seen, most if most > 0.0 else 1.0), where=seen > 0.0)
    return np.where(reached > _UNREACHED * most, reached, shown)


def _crossings(system: StateSpace, gamma: float) -> Matrix:
    """Angles in [0, pi] at which gamma may be a singular value of S(e^{j theta}); if empty, gamma is none."""
    image = axis_image(system)
    A, B, C, D = image.A, image.B, image.C / gamma, image.D / gamma
    R = np.linalg.inv(D.T @ D - np.eye(system.inputs))
    S = np.linalg.inv(D @ D.T - np.eye(system.outputs))
    F = A - B @ R @ D.T @ C
    return crossing_angles(np.block([[F, -B @ R @ B.T], [C.T @ S @ C, -F.T]]), _ON_AXIS)
