"""A simulated device held by a simulated hand: a mass with damping, and a passive operator with an intention.

    M x'' = f_v + f_int - b x' - f_h,
    f_h   = H(s) w + b_h w + k_h d,     d' = w = x' - v_m,

Here M is the mass of device and hand (kg), b the device's damping (N*s/m, at least its OSP level), H the hand's passive
operator, b_h and k_h its damper and spring, f_int the intended force (N) and v_m the intended velocity (m/s). f_v,
f_int and v_m are held over a tick, so that the sampled system is exact.

The hand is passive except for its intention. The work W that the intention does over a tick,

    W = f_int dx - v_m * integral of f_h dt,    integral of f_h dt = (f_v + f_int) T - b dx - M dv,

follows from the momentum balance without approximation. A ledger adds up W, so that the passivity of the rest is
checked separately from the intention.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from manyhands.design.models.statespace import Matrix, StateSpace, matrix


@dataclass(frozen=True, eq=False)
class HeldDevice:
    """The physical data of one simulated device with m axes and of the hand that holds it.

    Attributes:
        mass: m entries, kg, device and hand together.
        damping: b, m entries, N*s/m.
        operator: H in continuous time, velocity (m/s) to force (N), m x m.
        hand_damping: b_h, m entries, N*s/m.
        hand_stiffness: k_h, m entries, N/m.
    """

    mass: Matrix
    damping: Matrix
    operator: StateSpace
    hand_damping: Matrix
    hand_stiffness: Matrix

    @property
    def axes(self) -> int:
        """Number m of axes."""
        return int(self.mass.shape[0])

    def continuous(self) -> StateSpace:
        """The system from (force f_v + f_int, intended velocity v_m) to (x, x'); 2m inputs, 2m outputs.

        The states are (x, x', the operator's states, d).
        """
        m, h = self.axes, self.operator.order
        inverse_mass = np.diag(1.0 / self.mass)
        D_h = self.operator.D + np.diag(self.hand_damping)
        zero, I = np.zeros((m, m)), np.eye(m)
        A = np.block(
            [
                [zero, I, np.zeros((m, h)), zero],
                [
                    zero,
                    -inverse_mass @ (np.diag(self.damping) + D_h),
                    -inverse_mass @ self.operator.C,
                    -inverse_mass @ np.diag(self.hand_stiffness),
                ],
                [np.zeros((h, m)), self.operator.B, self.operator.A, np.zeros((h, m))],
                [zero, I, np.zeros((m, h)), zero],
            ]
        )
        B = np.block(
            [
                [zero, zero],
                [inverse_mass, inverse_mass @ D_h],
                [np.zeros((h, m)), -self.operator.B],
                [zero, -I],
            ]
        )
        C = np.hstack([np.eye(2 * m), np.zeros((2 * m, h + m))])
        return StateSpace(A, B, C, np.zeros((2 * m, 2 * m)))

    def sampled(self, T: float) -> StateSpace:
        """The exact discretisation for inputs held over a period T (s)."""
        return zero_order_hold(self.continuous(), T)


def zero_order_hold(system: StateSpace, T: float) -> StateSpace:
    """The discrete system that equals the continuous ``system`` at kT for inputs held over each period.

    exp([A B; 0 0] T) = [A_d B_d; 0 I].
    """
    n, p = system.order, system.inputs
    step = exponential_less_identity(np.block([[system.A, system.B], [np.zeros((p, n + p))]]) * T)[:n]
    return StateSpace(step[:, :n] + np.eye(n), step[:, n:], system.C, system.D)


def exponential_less_identity(X: Matrix) -> Matrix:
    """exp(X) - I, with an error that is small against X: Taylor's series of X 2^-s, and s doublings.

    With Q(t) = exp(X t) - I, a doubling is Q(2t) = 2 Q(t) + Q(t) Q(t). For small t, exp(X t) itself would hold X in the
    last digits of numbers near 1 only, and each squaring would double their error.
    """
    norm = float(np.abs(X).sum(axis=0).max(initial=0.0))
    halvings = max(0, math.frexp(norm)[1] + 6)  # to a norm below 2^-6, where nine terms suffice
    X = X * 0.5**halvings
    Q = X
    for k in range(9, 1, -1):
        Q = X + X @ Q / k
    for _ in range(halvings):
        Q = 2.0 * Q + Q @ Q
    return Q


def held_device(
    mass: list[float],
    damping: list[float],
    operator: StateSpace,
    hand_damping: list[float],
    hand_stiffness: list[float],
) -> HeldDevice:
    """A :class:`HeldDevice` from plain lists, shapes checked.

    Raises:
        ValueError: lengths differ, a mass is not positive, or the operator is not m x m.
    """
    m = len(mass)
    vectors = [matrix([v], 1, m)[0] for v in (mass, damping, hand_damping, hand_stiffness)]
    if np.any(vectors[0] <= 0.0) or operator.inputs != m or operator.outputs != m:
        raise ValueError(f"expected {m} positive masses and an operator of {m} x {m}")
    return HeldDevice(vectors[0], vectors[1], operator, vectors[2], vectors[3])
