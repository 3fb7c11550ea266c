"""A linear block V = (A, B, C, D): V_hat is Delta_V-OSP, with its differentiator divided out.

V_hat = (z-1)/(Tz) (V - K), y = (v - v- - K phi)/T with v = V f and phi = f - f- (- marks the tick before), has the
state (zeta, f-) with zeta = (xi - xi-)/T. Its storage [zeta; f-]' Pi [zeta; f-] must, for every constant force, be
what the supply f'y has brought, which forces

    Pi = [ P  P12 ; P12'  P22 ],    P12 = (A - I)^-T C'/2,    P22 = (V(1) - K)/(2T),
    V(1) = D + C (I - A)^-1 B = V(1)',

and with next = (A zeta + B phi/T, phi), y = C zeta + (D - K) phi/T leaves, free of f-, the quadratic form in (zeta,
phi)

    M_V = next' Pi next - zeta' P zeta - phi' y + y' Delta_V y <= 0,      Pi > 0.

This is Lemma 1 of [Bianchini2010]_ for the realisation (12) on the complement of its neutral directions. M_V < 0 and
P > 0 give A' P A - P < 0: V is stable.

V(1) is computed, and its symmetry decided, in rationals, also where the rest is done in balls
(:mod:`manyhands.design.proof.statics`).
"""

from __future__ import annotations

from flint import arb_mat, fmpq, fmpq_mat

from manyhands.design.proof import balls, rational, statics
from manyhands.design.proof.balls import Kind, assembled, diagonal_blocks, identity, zeros
from manyhands.design.proof.claim import Linear
from manyhands.design.proof.finding import Verdict, weakest
from manyhands.design.proof.reading import Table
from manyhands.design.proof.spring_damper import exactly_quick

_EXACT_ROWS = 12
_DISSIPATION = "M_V <= 0"


def linear(V: Linear, Delta_D: Table, Delta_V: Table, kappa: fmpq, T: fmpq) -> Verdict:
    """Whether V is stable and V_hat Delta_V-OSP, given Delta_V > 0, kappa > 0, T > 0."""
    n, m = V.A.rows, V.C.rows
    try:
        V_1 = statics.of_system(V.A, V.B, V.C, V.D, V.static, discrete=True)
        D = statics.feedthrough(V.A, V.B, V.C, V.D, V.static, discrete=True)
    except statics.Undecided as error:
        return Verdict(False, float("nan"), str(error))
    unequal = statics.asymmetry(V_1)
    if unequal:
        return Verdict(False, float("nan"), f"V(1) is not symmetric: {unequal}")
    stated = V.static if V.D is None else V.D
    assert stated is not None  # noqa: S101  # for the type checker: a reader takes one of the two
    if n + m <= _EXACT_ROWS and exactly_quick(V.A, V.B, V.C, stated, V.P, Delta_D, Delta_V):
        A, B, C, P, D_D, D_V = (table.rational() for table in (V.A, V.B, V.C, V.P, Delta_D, Delta_V))
        try:
            found = _conditions(fmpq_mat, A, B, C, D, V_1, P, D_D, D_V, kappa, T)
        except ZeroDivisionError:
            return Verdict(False, float("nan"), "Delta_D is singular")
        # without states there is nothing that might be unstable, and <= is enough
        strict = {name: n > 0 or name != _DISSIPATION for name in found}
        return weakest({name: rational.definite(M, strict[name]) for name, M in found.items()})

    def by_balls() -> Verdict:
        A, B, C, D_D, D_V = (table.balls() for table in (V.A, V.B, V.C, Delta_D, Delta_V))
        found = _conditions(arb_mat, A, B, C, arb_mat(D), arb_mat(V_1), V.P.witness(), D_D, D_V, kappa, T)
        return weakest({name: balls.definite(balls.symmetrised(M)) for name, M in found.items()})

    return balls.decided(n + m, by_balls)


def _conditions(
    kind: type[Kind],
    A: Kind,
    B: Kind,
    C: Kind,
    D: Kind,
    V_1: Kind,
    P: Kind,
    Delta_D: Kind,
    Delta_V: Kind,
    kappa: fmpq,
    T: fmpq,
) -> dict[str, Kind]:
    """Pi and -M_V, for V(1) = V(1)^T."""
    n, m = A.nrows(), D.nrows()
    P = (P + P.transpose()) / 2
    K = Delta_D.inv() * (kappa * T)
    P_12 = (A.transpose() - identity(kind, n)).solve(C.transpose()) / 2 if n else zeros(kind, 0, m)
    P_22 = (V_1 - K) / (2 * T)
    Pi = assembled(kind, [[P, P_12], [P_12.transpose(), P_22]])
    phi = assembled(kind, [[zeros(kind, m, n), identity(kind, m)]])
    following = assembled(kind, [[A, B / T], [zeros(kind, m, n), identity(kind, m)]])
    y = assembled(kind, [[C, (D - K) / T]])
    stored = diagonal_blocks(kind, [P, zeros(kind, m, m)])
    supply = phi.transpose() * y
    M = following.transpose() * Pi * following - stored + y.transpose() * Delta_V * y
    return {"Pi > 0": Pi, _DISSIPATION: (supply + supply.transpose()) / 2 - M}
