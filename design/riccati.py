"""The storage function of a large environment from one discrete Riccati equation, instead of a semidefinite program.

E_hat is (-Phi_E)-ISP when some P > 0 has (:mod:`manyhands.design.split`, Rest = (A, B, C, D))

    M(P) = [A B]^T P [A B] - [ P      C^T/2 ]  <= 0,        R = He(D) + Phi_E - T/2 E1.
                             [ C/2    R     ]

The least such P is the available storage [Willems1972]_, solution of a Riccati equation with equality in n of the
n + m directions: at the edge, of no use for a proof. So the equation of a *tighter* problem is solved, that of

    A / sqrt(1 - eps),   B / sqrt(1 - eps),   and a loss eps |psi|^2 a tick on states scaled to be reached equally,

and P = (tight P)/(1 - eps) has M(P) <= -eps blockdiag(P + I, 0): room in every direction of the state, as the solution
of the tight equation is strict in the inputs. The equation is solved by doubling [Chu2004]_, whose k-th iterate is the
energy that can be drawn in 2^k ticks: it grows, and it converges exactly when the tight problem has a solution.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manyhands.design.coordinates import reachability
from manyhands.design.environment_level import LevelFound, best_level
from manyhands.design.errors import SolverFailure
from manyhands.design.frequency import Dissipation
from manyhands.design.partition import Partition
from manyhands.design.split import Split
from manyhands.design.statespace import Matrix, symmetric_part

MOST_TIGHTENED = 5e-4  # eps to begin with
LEAST_TIGHTENED = 1e-12  # below, rounding is as large
ENOUGH_ROOM = 1e-10  # least eigenvalue of -M and of P, scaled to unit diagonal: a million times double precision's
RESERVES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1)  # parts of the best margin given up for room, the first that is enough
_STEP = 0.3  # from one eps to the next
_MOST_DOUBLINGS = 60  # 2^60 ticks
_CONVERGED = 1e-14  # relative change of the storage in one doubling
_UNREACHED = 1e-12  # of the largest variance: a state that inputs reach less is scaled as if they reached it as much


def level_and_storage(
    split: Split,
    T: float,
    Delta_G: Matrix,
    Delta_V: Matrix,
    partition: Partition | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[LevelFound, Matrix]:
    """The environment's best level with a storage function that proves it: as little given up as leaves enough room.

    Slow modes of large environments dissipate so little in a tick that a level at the very edge of what is possible
    cannot be told from one beyond it.

    Arguments and errors as for :func:`manyhands.design.environment_level.best_level`.

    Returns:
        The level, and P in the coordinates of Rest.
    """
    best = best_level(split, T, Delta_G, Delta_V, partition, RESERVES[0], progress)
    for reserve in RESERVES[:-1]:
        found = best.eased(reserve)
        try:
            return found, storage(split, T, found.Phi_E, progress, found.frequency)
        except SolverFailure as error:
            if progress is not None:
                progress(f"environment: {error}; giving up more of the margin")
    found = best.eased(RESERVES[-1])
    return found, storage(split, T, found.Phi_E, progress, found.frequency)


def storage(
    split: Split,
    T: float,
    Phi_E: Matrix,
    progress: Callable[[str], None] | None = None,
    frequency: float | None = None,
) -> Matrix:
    """Find P > 0 with M(P) < 0, with room for a proof in floating point or ball arithmetic.

    Args:
        split: E_hat, m ports, order n of Rest, stable.
        T: period, s.
        Phi_E: m x m symmetric, N*s/m; strictly admissible, as :func:`manyhands.design.environment_level.best_level`
            returns it.
        progress: told about every eps tried.
        frequency: where Phi_E is needed most, rad/s, as the same function returns it: a hint, with which eps to begin;
            without it the frequencies are searched for the place.

    Returns:
        P, n x n, in the coordinates of Rest (energy over T: N*s/m times the square of what the states count).

    Raises:
        SolverFailure: there is none, or none with room.
    """
    rest, n = split.rest, split.rest.order
    R = symmetric_part(rest.D) + Phi_E - T / 2.0 * split.stiffness
    values, vectors = np.linalg.eigh(R)
    if not values[0] > 0.0:
        raise SolverFailure("Phi_E is less than the environment needs: He(D) + Phi_E - T/2 E1 is not positive definite")
    if n == 0:
        return np.zeros((0, 0))
    ports = vectors / np.sqrt(values)  # w = ports @ (scaled w): there R is the identity
    A, B, C = rest.A, rest.B @ ports, ports.T @ rest.C
    radius = float(np.max(np.abs(np.linalg.eigvals(A))))
    if not radius < 1.0:
        raise SolverFailure(f"the environment has a mode that does not decay: a pole of modulus {radius:.9g}")
    reached = np.diag(reachability(A, B))
    most = float(np.max(reached, initial=0.0))
    unit = np.sqrt(np.where(reached > _UNREACHED * most, reached, most if most > 0.0 else 1.0))
    A, B, C = A / unit[:, None] * unit, B / unit[:, None], C * unit
    angle = _tightest_angle(split, T, Phi_E, ports) if frequency is None else frequency * T
    eps = _first_tightened(A, B, C, np.exp(1j * angle), min(MOST_TIGHTENED, (1.0 - radius**2) / 4.0))
    while eps >= LEAST_TIGHTENED:
        if progress is not None:
            progress(f"storage function of the environment: tightened by {eps:.2g}")
        P = _available_storage(A / np.sqrt(1.0 - eps), B / np.sqrt(1.0 - eps), C, eps)
        if P is not None:
            P = symmetric_part(P / (1.0 - eps) / unit[:, None] / unit)
            if room(split, T, Phi_E, P) >= ENOUGH_ROOM:
                return P
            break  # a smaller eps leaves less room
        eps *= _STEP
    raise SolverFailure(
        "no storage function with room to verify it: Phi_E is too close to what the environment needs, or below"
    )


def _tightest_angle(split: Split, T: float, Phi_E: Matrix, ports: Matrix) -> float:
    """The angle of a grid at which H + Phi_E is least, in scaled ports."""
    dissipation = Dissipation(split, T)
    angles = dissipation.angles()
    least = [np.linalg.eigvalsh(ports.T @ (dissipation(angle) + Phi_E) @ ports)[0] for angle in angles]
    return float(angles[int(np.argmin(least))])


def _first_tightened(A: Matrix, B: Matrix, C: Matrix, point: complex, eps: float) -> float:
    """The first eps, downwards from ``eps``, that leaves half of what the environment dissipates at ``point``."""

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
    """Least eigenvalue of -M(P) and of P, each scaled to a unit diagonal; negative or zero: not proved."""
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
    """The least P with [A B]^T P [A B] - [P - loss I, C^T/2; C/2, I] <= 0; None when there is none.

    With X = -P this is X = F^T X (I + G X)^{-1} F + Q for F = A - B C/2, G = B B^T, Q = -(C^T C/4 + loss I).
    """
    n, m = B.shape
    F, G, X = A - B @ C / 2.0, B @ B.T, -(C.T @ C / 4.0 + loss * np.eye(n))
    for _ in range(_MOST_DOUBLINGS):
        # what is drawn in 2^k ticks must cost the inputs something: I - B^T P B > 0
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
