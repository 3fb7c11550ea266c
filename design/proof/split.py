"""The transformed environment E_hat = Tz/(z-1) E with its integrators split off, in balls.

With E1 = E(1), the static stiffness, and E = (A, B, C, D) stable,

    E_hat = T/(z-1) E1 + Rest,        Rest = (A, -T A (I - A)^-1 B, C, T D),

T/(z-1) E1 with E1 = E1' >= 0 is lossless but for -T/2 E1, so that E_hat is (-Phi_E)-ISP when, for Rest = (A, B, C, D),

    M_E = [ A'PA - P   A'PB - C'/2                                ]
          [ .          B'PB - (D + D')/2 - Phi_E + (T/2) E1       ]  < 0,     P > 0,     E1 >= 0.

A delay of d ticks makes it E_hat z^-d = T/(z-1) E1 + [z^-d Rest - T E1 (z^-1 + ... + z^-d)].

Whether E1 is symmetric and >= 0 is decided apart, exactly (:mod:`manyhands.design.proof.statics`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from flint import arb_mat, fmpq

from manyhands.design.proof import balls
from manyhands.design.proof.balls import assembled, diagonal_blocks, identity


@dataclass(frozen=True, eq=False)
class Split:
    """E_hat = T/(z-1) E1 + Rest, with balls that enclose every entry.

    Attributes:
        stiffness: E1, m x m symmetric, N/m.
        A, B, C, D: Rest, from velocity (m/s) to force (N).
    """

    stiffness: arb_mat
    A: arb_mat
    B: arb_mat
    C: arb_mat
    D: arb_mat


def split_system(A: arb_mat, B: arb_mat, C: arb_mat, D: arb_mat, E1: arb_mat, T: fmpq) -> Split:
    """The split of a discrete E = (A, B, C, D) with the static stiffness E1 = E1'.

    Raises:
        ZeroDivisionError: A is not proved to have no eigenvalue 1.
    """
    n = A.nrows()
    steady = (identity(arb_mat, n) - A).solve(B) if n else B
    return Split(E1, A, -(A * steady) * T, C, D * T)


def delayed(rest: Split, ticks: int, T: fmpq) -> Split:
    """The split of E_hat z^-d; the states are those of Rest, then w_{k-1}, ..., w_{k-d}."""
    if ticks == 0:
        return rest
    n, m, d = rest.A.nrows(), rest.D.nrows(), ticks
    chain = n + m * (d - 1)  # where w_{k-d} stands
    A, B = arb_mat(n + m * d, n + m * d), arb_mat(n + m * d, m)
    balls.place(A, rest.A, 0, 0)
    balls.place(A, rest.B, 0, chain)
    balls.place(B, identity(arb_mat, m), n, 0)
    balls.place(A, identity(arb_mat, m * (d - 1)), n + m, n)
    late = -rest.stiffness * T
    C = assembled(arb_mat, [[rest.C, *([late] * (d - 1)), late + rest.D]])
    return replace(rest, A=A, B=B, C=C, D=arb_mat(m, m))


def dissipation(rest: Split, P: arb_mat, Phi_E: arb_mat, T: fmpq) -> arb_mat:
    """-M_E, (n+m) x (n+m), symmetric."""
    n = rest.A.nrows()
    G = assembled(arb_mat, [[rest.A, rest.B]])
    supply = assembled(arb_mat, [[arb_mat(n, n), rest.C.transpose() / 2], [rest.C / 2, balls.symmetrised(rest.D)]])
    level = Phi_E - rest.stiffness * (T / 2)
    kept = diagonal_blocks(arb_mat, [P, level])
    return balls.symmetrised(supply + kept - G.transpose() * P * G)


def environment(rest: Split, T: fmpq) -> tuple[arb_mat, arb_mat, arb_mat, arb_mat]:
    """E itself from its split, with the state (eta, u-): eta of Rest, u- the displacement of the tick before.

    eta+ = A eta + B (u - u-)/T,    u-+ = u,    f = E1 u- + C eta + D (u - u-)/T.
    """
    n, m = rest.A.nrows(), rest.D.nrows()
    B, D = rest.B / T, rest.D / T
    return (
        assembled(arb_mat, [[rest.A, -B], [arb_mat(m, n), arb_mat(m, m)]]),
        assembled(arb_mat, [[B], [identity(arb_mat, m)]]),
        assembled(arb_mat, [[rest.C, rest.stiffness - D]]),
        D,
    )
