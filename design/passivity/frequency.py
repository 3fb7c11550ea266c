"""Supply over frequency, exactly: the least value on the unit circle by level sets, without a grid.

A *pair* (psi, w) at z, |z| = 1, has A psi + B w = z psi: after a tick, the state is the same up to a phase. For every
P its storage does not change. Of the inequality (2) in Lemma 1 of [Bianchini2010]_, only this remains:

    w^* y - y^* Delta y - w^* Phi w = x^* Q x >= 0,    x = (psi, w),  y = C psi + D w,

    Q = -M(0) = [ -C^T Delta C        C^T/2 - C^T Delta D                  ]
                [  .                  (D + D^T)/2 - D^T Delta D - Phi      ].

A pair with x^* Q x < 0 therefore refutes every P at once, and a pair with x^* Q x = 0 is *neutral*. This holds at
poles on the circle too, where a frequency response is not defined.

The least of x^* Q x / |R x|^2 over all pairs, for rows R, is found in the same way as H-infinity norms ([Boyd1990]_,
[Bruinsma1990]_). The points of the circle where Q - g R^T R is singular on the pairs are generalised eigenvalues.
Between two neighbouring points, the ratio is below g or above g throughout.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig

from manyhands.design.errors import SolverFailure
from manyhands.design.models.statespace import (
    Matrix,
    StateSpace,
    Time,
    frequency_of,
    gaps,
    in_discrete_time,
    storage_inequality,
)

Complex = NDArray[np.complex128]

_ON_CIRCLE = 1e-6  # relative distance of a crossing from |z| = 1; a false crossing only costs one more evaluation
_LEVEL_STEP = 1e-12  # of the forms' scale: the next level lies this far below the least value found
_ROUNDS = 60  # level sets; convergence is quadratic, and fewer than ten are usual
_RANK = 1e-12  # of the largest: smaller singular values count as zero; they belong to modes that no input reaches
_SILENT = 1e-13  # of R's norm: directions in which R x counts as zero
_SILENT_AT = 1e-11  # of R's norm: at such a point of the circle, R counts as silent
_NEAR_SILENT = 1e-4  # distance from a silent point that is left out: nearer, the ratio is rounding / 1e-8
_PROBES = 7  # generic points that are tried before any level set
_POLE_ON_CIRCLE = 1e-8


@dataclass(frozen=True, eq=False)
class LeastRatio:
    """The least of x^* Q x / |R x|^2 over the pairs of the unit circle.

    Attributes:
        value: the least ratio.
        angle: where it is reached, z = e^{j angle} with 0 <= angle <= pi.
        pair: the pair x = (psi, w) that reaches it, n+m complex entries; a check can evaluate the ratio on it.
    """

    value: float
    angle: float
    pair: Complex


def supply_form(system: StateSpace, Delta: Matrix | None = None, Phi: Matrix | None = None) -> Matrix:
    """Q of the module's head, (n+m) x (n+m): the supply y^T u - y^T Delta y - u^T Phi u as a form of (psi, u)."""
    return -storage_inequality(system, np.zeros((system.order, system.order)), Delta, Phi)


def output_rows(system: StateSpace) -> Matrix:
    """[C, D]: y as rows over (psi, u)."""
    return np.hstack([system.C, system.D])


def input_rows(system: StateSpace) -> Matrix:
    """[0, I]: u as rows over (psi, u)."""
    return np.hstack([np.zeros((system.inputs, system.order)), np.eye(system.inputs)])


def pairs_at(system: StateSpace, z: complex) -> Complex:
    """An orthonormal basis, (n+m) x d with d >= m, of the pairs at z."""
    n, m = system.order, system.inputs
    rows = np.hstack([system.A - z * np.eye(n), system.B.astype(np.complex128)])
    if n == 0:
        return np.eye(m, dtype=np.complex128)
    _, values, right = np.linalg.svd(rows)
    rank = int(np.sum(values > _RANK * float(values[0])))
    return np.asarray(right[rank:].conj().T)


def special_points(system: StateSpace) -> list[complex]:
    """Points of the upper half circle where a system may be neutral by structure: 1, -1, poles and zeros."""
    n, m = system.order, system.inputs
    points = [1.0 + 0.0j, -1.0 + 0.0j]
    candidates = [complex(z) for z in np.linalg.eigvals(system.A)]
    pencil = np.block([[system.A, system.B], [system.C, system.D]])
    candidates += _ratios(pencil, np.diag(np.concatenate([np.ones(n), np.zeros(m)])))
    for z in candidates:
        if abs(abs(z) - 1.0) < _POLE_ON_CIRCLE and z.imag >= 0.0 and min(abs(z - p) for p in points) > _POLE_ON_CIRCLE:
            points.append(z / abs(z))
    return points


def generic_points(count: int) -> list[complex]:
    """``count`` points of the open upper half circle at which no system has a special structure by design."""
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    return [complex(np.exp(1j * np.pi * ((k * golden + 0.237) % 1.0))) for k in range(1, count + 1)]


def least_ratio(system: StateSpace, Q: Matrix, R: Matrix) -> LeastRatio:
    """The least of x^* Q x / |R x|^2 over all pairs x of a discrete system; see the module's head.

    Args:
        system: (A, B, C, D), n states, m inputs.
        Q: symmetric form of (psi, w), (n+m) x (n+m).
        R: k x (n+m). Silent pairs, R x = 0, are left out with all points within 1e-4 of theirs on the circle, because
            the ratio is 0/0 there. The argument is R and not R^T R: beside a sharp resonance w is so much smaller than
            psi that its square would be lost.

    Raises:
        ValueError: every pair is silent.
    """
    size = max(_norm(R), 1e-150)
    N = R.T @ R
    scale = _norm(Q) / size**2
    special = special_points(system)
    silent = [z for z in special if _smallest(system, R, z) <= _SILENT_AT * size]
    start = [*special, *generic_points(_PROBES)]
    start += [_circle(float(np.angle(z))) for z in np.linalg.eigvals(system.A) if z != 0.0]
    best = _least_of(system, Q, R, start, silent)
    if best is None:
        raise ValueError("every pair is silent: there is nothing to compare the supply with")
    # A level slightly below the best value is crossed only if a lower value exists. Between two crossings the ratio is
    # above or below this level throughout, so that one point in each gap shows where it is lower.
    for _ in range(_ROUNDS):
        step = _LEVEL_STEP * max(scale, abs(best.value))
        angles = _crossings(system, Q - (best.value - step) * N)
        found = _least_of(system, Q, R, map(_circle, [*angles, *gaps(angles)[1]]), silent)
        if found is None or found.value >= best.value:
            return best
        if found.value >= best.value - step:
            return found
        best = found
    return best


def least_hermitian_eigenvalue(system: StateSpace, time: Time = "discrete") -> tuple[float, float]:
    """The least eigenvalue of (G + G^*)/2 over all frequencies, and its frequency.

    A stable system is (phi I)-ISP for every phi up to this eigenvalue.

    Args:
        system: (A, B, C, D), m x m, without poles on the circle (in continuous time, on the imaginary axis).
        time: how ``system`` is read.

    Returns:
        The eigenvalue, in the response's unit, and the frequency in rad a tick or rad/s (inf where it is the limit).
    """
    discrete, rate = in_discrete_time(system, time)
    least = least_ratio(discrete, supply_form(discrete), input_rows(discrete))
    return least.value, frequency_of(least.angle, time, rate)


def _smallest(system: StateSpace, R: Matrix, z: complex) -> float:
    """The least |R x| over the unit pairs x at z."""
    X = pairs_at(system, z)
    return float(np.linalg.svd(R @ X, compute_uv=False)[-1]) if X.shape[1] <= len(R) else 0.0


def _least_of(
    system: StateSpace, Q: Matrix, R: Matrix, points: Iterable[complex], silent: list[complex]
) -> LeastRatio | None:
    """The least ratio over the pairs at ``points`` with R x not zero; points too near ``silent`` ones are left out."""
    best: LeastRatio | None = None
    unseen = _SILENT * _norm(R)
    for z in points:
        if any(abs(z - p) < _NEAR_SILENT for p in silent):
            continue
        X = pairs_at(system, z)
        _, seen, vectors = np.linalg.svd(R @ X, full_matrices=False)
        keep = seen > unseen
        if not np.any(keep):
            continue
        Y = X @ (vectors[keep].conj().T / seen[keep])
        values, directions = np.linalg.eigh(Y.conj().T @ Q @ Y)
        if best is None or values[0] < best.value:
            best = LeastRatio(float(values[0]), float(abs(np.angle(z))), np.asarray(Y @ directions[:, 0]))
    return best


def _crossings(system: StateSpace, F: Matrix) -> list[float]:
    """Angles in [0, pi], sorted, where the form F may be singular on the pairs.

    With the costate q = z (A^T q + F_xx psi + F_xu w), F is singular on the pairs at z iff

        z [ I     0    0    ]   [ psi ]   [ A     0    B    ] [ psi ]
          [ F_xx  A^T  F_xu ] * [  q  ] = [ 0     I    0    ] [  q  ]
          [ 0     0    0    ]   [  w  ]   [ F_ux  B^T  F_uu ] [  w  ].
    """
    n, m = system.order, system.inputs
    A, B = system.A, system.B
    F_xx, F_xu, F_uu = F[:n, :n], F[:n, n:], F[n:, n:]
    zero, I = np.zeros((n, n)), np.eye(n)
    left = np.block([[A, zero, B], [zero, I, np.zeros((n, m))], [F_xu.T, B.T, F_uu]])
    right = np.block([[I, np.zeros((n, n + m))], [F_xx, A.T, F_xu], [np.zeros((m, 2 * n + m))]])
    return sorted(abs(float(np.angle(z))) for z in _ratios(left, right) if abs(abs(z) - 1.0) < _ON_CIRCLE)


def _ratios(left: Matrix, right: Matrix) -> list[complex]:
    """Finite generalised eigenvalues of the pencil left - z right.

    Raises:
        SolverFailure: the eigenvalue iteration did not converge.
    """
    if left.size == 0:
        return []
    try:
        alpha, beta = eig(left, right, right=False, homogeneous_eigvals=True)
    except np.linalg.LinAlgError as error:
        raise SolverFailure(f"level sets: {error}. State the system in better units") from error
    finite = np.abs(beta) > 1e-12 * (np.abs(alpha) + np.abs(beta))
    return [complex(z) for z in alpha[finite] / beta[finite]]


def _circle(angle: float) -> complex:
    return complex(np.exp(1j * angle))


def _norm(F: Matrix) -> float:
    return float(np.linalg.norm(F, 2)) if F.size else 0.0
