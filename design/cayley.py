"""Continuous and discrete time are one matter: the Cayley transform keeps storage functions and supply rates.

For a rate a > 0 (1/s), with s = a (z - 1)/(z + 1) and R = (a I - A)^{-1},

    A_d = (a I + A) R,    B_d = sqrt(2a) R B,    C_d = sqrt(2a) C R,    D_d = D + C R B

has at z the response that (A, B, C, D) has at s. Along psi = (psi_d+ + psi_d)/sqrt(2a), with u and y the
same in both, d psi/dt = sqrt(a/2) (psi_d+ - psi_d), so that

    2 psi^T P d psi/dt = psi_d+^T P psi_d+ - psi_d^T P psi_d :

the continuous storage inequality with P is a congruence of the discrete one with the same P. Unlike Tustin's
rule, whose rate is 2/T, nothing is approximated: the rate is free, and only decides which frequency comes to the
middle of the circle.

The other way, at the rate 1, z = (1 + s)/(1 - s) takes the circle to the imaginary axis, where the frequencies at which
a level is crossed are the imaginary eigenvalues of a Hamiltonian matrix ([Boyd1989]_, [Bruinsma1990]_). Between two of
them the level is kept or violated throughout, so that one frequency in each gap decides: the searches for a norm
(:mod:`manyhands.design.hinfinity`), for the environment's level (:mod:`manyhands.design.environment_level`) and for a
supply ratio (:mod:`manyhands.design.level_sets`) need no grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from manyhands.design.statespace import Matrix, StateSpace

Time = Literal["discrete", "continuous"]
"""How a :class:`StateSpace` is read: psi+ = A psi + B u, or d psi/dt = A psi + B u."""

_FASTEST_RATIO = 1e-8  # eigenvalues below this part of the largest are integrators and say nothing about the rate


def natural_rate(system: StateSpace) -> float:
    """A rate a (1/s) in the middle of a continuous system's poles: the geometric mean of their distances from 0."""
    sizes = np.abs(np.linalg.eigvals(system.A))
    largest = float(np.max(sizes, initial=0.0))
    if largest == 0.0:
        return 1.0
    return float(np.exp(np.mean(np.log(sizes[sizes > _FASTEST_RATIO * largest]))))


def cayley(system: StateSpace, rate: float) -> StateSpace:
    """The discrete system with the same storage matrices as the continuous ``system``; see the module.

    Args:
        system: (A, B, C, D) in continuous time, m x m.
        rate: a, 1/s, positive and not an eigenvalue of A.

    Raises:
        ValueError: ``rate`` is not positive, or an eigenvalue of A.
    """
    if not 0.0 < rate < np.inf:
        raise ValueError(f"expected a positive rate in 1/s, found {rate}")
    n = system.order
    shifted: Matrix = rate * np.eye(n) - system.A
    try:
        R = np.linalg.inv(shifted)
    except np.linalg.LinAlgError:
        raise ValueError(f"expected a rate that is no eigenvalue of A, found {rate}") from None
    root = float(np.sqrt(2.0 * rate))
    return StateSpace(
        (rate * np.eye(n) + system.A) @ R,
        root * R @ system.B,
        root * system.C @ R,
        system.D + system.C @ R @ system.B,
    )


def axis_image(system: StateSpace) -> StateSpace:
    """The continuous system that has at s the response that a discrete one has at z = (1 + s)/(1 - s).

    It is the inverse of :func:`cayley` at the rate 1. With R = (A + I)^{-1} it reads

        (R (A - I),    sqrt(2) R B,    sqrt(2) C R,    D - C R B).

    Args:
        system: discrete, without a pole at -1; inputs and outputs may differ in number.

    Raises:
        numpy.linalg.LinAlgError: A has the eigenvalue -1.
    """
    I = np.eye(system.order)
    R = np.linalg.inv(system.A + I)
    root = np.sqrt(2.0)
    return StateSpace(R @ (system.A - I), root * R @ system.B, root * system.C @ R, system.D - system.C @ R @ system.B)


def crossing_angles(hamiltonian: Matrix, relative: float, absolute: float = 0.0) -> Matrix:
    """The angles 2 atan |s| of the imaginary eigenvalues s of a Hamiltonian matrix, ascending, in [0, pi].

    Args:
        hamiltonian: 2n x 2n, in the coordinates of :func:`axis_image`.
        relative: an eigenvalue counts as imaginary up to |Re s| = relative |s| + absolute. A false crossing costs an
            evaluation, a missed one the result, so that generous figures are right.
        absolute: the same for eigenvalues near 0, for rounding.
    """
    values = np.linalg.eigvals(hamiltonian)
    near = np.abs(values.real) <= relative * np.abs(values) + absolute
    return np.unique(2.0 * np.arctan(np.abs(values[near].imag)))


def gaps(crossings: Sequence[float] | Matrix) -> tuple[Matrix, Matrix]:
    """The gaps that crossings leave on the upper half circle: their ends, 0 and pi among them, and their middles.

    Args:
        crossings: angles in [0, pi], in any order.
    """
    ends = np.unique(np.concatenate([[0.0], crossings, [np.pi]]))
    return ends, np.asarray((ends[1:] + ends[:-1]) / 2.0)


def in_discrete_time(system: StateSpace, time: Time) -> tuple[StateSpace, float]:
    """``system`` as a discrete one, and the rate a (1/s) that took it there; 1 for one that was discrete."""
    if time == "discrete":
        return system, 1.0
    rate = natural_rate(system)
    if np.any(np.abs(np.linalg.eigvals(system.A) - rate) < 1e-3 * rate):  # an unstable pole may sit on the rate
        rate *= np.sqrt(2.0)
    return cayley(system, float(rate)), float(rate)


def frequency_of(angle: float, time: Time, rate: float) -> float:
    """The frequency at z = e^{j angle}, 0 <= angle <= pi: rad a tick, or w = a tan(angle/2) in rad/s."""
    if time == "discrete":
        return angle
    return float("inf") if angle >= np.pi else rate * float(np.tan(angle / 2.0))
