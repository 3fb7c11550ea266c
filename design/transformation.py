"""The loop transformation (7)-(9) of [Bianchini2010]_.

With a constant K (m x m, m/N) the haptic loop of G (device with hand, sampled), V and E becomes one of

    G_hat = (z-1)/(Tz) [G + K],   V_hat = (z-1)/(Tz) [V - K],   E_hat = Tz/(z-1) E,

from force to velocity, force to velocity, velocity to force. The signals f_v are those of the original
loop. The choice K = T/2 Delta_D^{-1} (8) makes G_hat Delta_D-OSP (9).
"""

from __future__ import annotations

import numpy as np

from manyhands.design.statespace import Matrix, StateSpace, symmetric_part


def loop_gain(Delta_D: Matrix, T: float) -> Matrix:
    """K = T/2 Delta_D^{-1} of (8), m x m, m/N; Delta_D in N*s/m, T in s."""
    return symmetric_part(T / 2.0 * np.linalg.inv(Delta_D))


def transformed_device(G: StateSpace, K: Matrix, T: float) -> StateSpace:
    """G_hat = (z-1)/(Tz) [G + K], from force (N) to velocity (m/s)."""
    return _difference(StateSpace(G.A, G.B, G.C, G.D + K), T)


def transformed_coupling(V: StateSpace, K: Matrix, T: float) -> StateSpace:
    """V_hat = (z-1)/(Tz) [V - K], from force (N) to velocity (m/s), in the realisation (12).

    The state is (xi, u_{k-1}): that of V, then the force of the tick before.
    """
    return _difference(StateSpace(V.A, V.B, V.C, V.D - K), T)


def transformed_environment(E: StateSpace, T: float) -> StateSpace:
    """E_hat = Tz/(z-1) E, from velocity (m/s) to force (N), with the state (eta, x_e of the tick before).

    General, but not minimal where E itself remembers x_e; a network has a minimal one of its own,
    :meth:`manyhands.design.network.Network.transformed_environment`.
    """
    n, m = E.order, E.inputs
    return StateSpace(
        np.block([[E.A, E.B], [np.zeros((m, n)), np.eye(m)]]),
        T * np.vstack([E.B, np.eye(m)]),
        np.hstack([E.C, E.D]),
        T * E.D,
    )


def _difference(S: StateSpace, T: float) -> StateSpace:
    """(z-1)/(Tz) S, with the input of the tick before as additional states, as in (12).

    With zeta_k = (xi_k - xi_{k-1})/T for the state xi of S, from rest,

        zeta_{k+1} = A zeta_k + B (u_k - u_{k-1})/T,    y_k = C zeta_k + D (u_k - u_{k-1})/T.
    """
    n, p = S.order, S.inputs
    return StateSpace(
        np.block([[S.A, -S.B / T], [np.zeros((p, n + p))]]),
        np.vstack([S.B / T, np.eye(p)]),
        np.hstack([S.C, -S.D / T]),
        S.D / T,
    )
