"""A linear block V = (A, B, C, D): V_hat is Delta_V-OSP, with its differentiator divided out.

V_hat = (z-1)/(Tz) (V - K), y = (v - v- - K phi)/T with v = V f and phi = f - f- (- marks the tick before), has the
state (zeta, f-) with zeta = (xi - xi-)/T. Its storage [zeta; f-]' Pi [zeta; f-] must, for every constant force, be
what the supply f'y has brought, which forces

    Pi = [ P  P12 ; P12'  P22 ],    P12 = (A - I)^-T C'/2,    P22 = (V(1) - K)/(2T),
    V(1) = D + C (I - A)^-1 B symmetric,

and with next = (A zeta + B phi/T, phi), y = C zeta + (D - K) phi/T leaves, free of f-, the quadratic form in (zeta,
phi)

    M_V = next' Pi next - zeta' P zeta - phi' y + y' Delta_V y <= 0,      Pi > 0.

This is Lemma 1 of [Bianchini2010]_ for the realisation (12) on the complement of its neutral directions. M_V < 0 and
P > 0 give A' P A - P < 0: V is stable.

V(1) of a realisation in floats is symmetric up to rounding only. Where its skew part is below 1e-12 of its greatest
entry, V is proved with D less that skew part: a change below the rounding of the arithmetic that runs V.
"""

from __future__ import annotations

from collections.abc import Callable

from flint import arb_mat, fmpq, fmpq_mat

from manyhands.design.proof import balls, rational
from manyhands.design.proof.balls import ROUNDING, Kind, assembled, diagonal_blocks, identity, zeros
from manyhands.design.proof.claim import Linear
from manyhands.design.proof.finding import Verdict, weakest
from manyhands.design.proof.reading import Table
from manyhands.design.proof.spring_damper import exactly_quick

_EXACT_ROWS = 12
_DISSIPATION = "M_V <= 0"


def linear(V: Linear, Delta_D: Table, Delta_V: Table, kappa: fmpq, T: fmpq) -> Verdict:
    """Whether V is stable and V_hat Delta_V-OSP, given Delta_V > 0, kappa > 0, T > 0."""
    n, m = V.A.rows, V.D.rows
    if n + m <= _EXACT_ROWS and exactly_quick(V.A, V.B, V.C, V.D, V.P, Delta_D, Delta_V):
        try:
            V_1 = _static_compliance(Table.rational, V)
            found = _conditions(fmpq_mat, Table.rational, V, V_1, Delta_D, Delta_V, kappa, T)
        except ZeroDivisionError:
            return Verdict(False, float("nan"), "A - I or Delta_D is singular")
        worst = max(abs(entry) for entry in (V_1 - V_1.transpose()).entries())
        if worst > 2 * ROUNDING * max(abs(entry) for entry in V_1.entries()):
            return Verdict(False, -rational.rounded(worst), "V(1) is not symmetric")
        # without states there is nothing that might be unstable, and <= is enough
        strict = {name: n > 0 or name != _DISSIPATION for name in found}
        return _told(weakest({name: rational.definite(M, strict[name]) for name, M in found.items()}), worst != 0)

    def by_balls() -> Verdict:
        V_1 = _static_compliance(Table.balls, V)
        found = _conditions(arb_mat, Table.balls, V, V_1, Delta_D, Delta_V, kappa, T)
        worst = balls.greatest(V_1 - V_1.transpose())
        if not worst <= balls.at_least(V_1) * (2 * ROUNDING):
            return Verdict(False, -float(worst), "V(1) is not proved symmetric")
        verdict = weakest({name: balls.definite(balls.symmetrised(M)) for name, M in found.items()})
        return _told(verdict, m > 1)

    return balls.decided(n + m, by_balls)


def _static_compliance(read: Callable[[Table], Kind], V: Linear) -> Kind:
    """V(1) = D + C (I - A)^-1 B, m/N."""
    D = read(V.D)
    if V.A.rows == 0:
        return D
    A = read(V.A)
    return D + read(V.C) * (identity(type(A), V.A.rows) - A).solve(read(V.B))


def _conditions(
    kind: type[Kind],
    read: Callable[[Table], Kind],
    V: Linear,
    V_1: Kind,
    Delta_D: Table,
    Delta_V: Table,
    kappa: fmpq,
    T: fmpq,
) -> dict[str, Kind]:
    """Pi and -M_V, with D less the skew part of V(1)."""
    n, m = V.A.rows, V.D.rows
    A, B, C, P, level = read(V.A), read(V.B), read(V.C), read(V.P), read(Delta_V)
    D = read(V.D) - (V_1 - V_1.transpose()) / 2
    P = (P + P.transpose()) / 2
    K = read(Delta_D).inv() * (kappa * T)
    P_12 = (A.transpose() - identity(kind, n)).solve(C.transpose()) / 2 if n else zeros(kind, 0, m)
    P_22 = ((V_1 + V_1.transpose()) / 2 - K) / (2 * T)
    Pi = assembled(kind, [[P, P_12], [P_12.transpose(), P_22]])
    phi = assembled(kind, [[zeros(kind, m, n), identity(kind, m)]])
    following = assembled(kind, [[A, B / T], [zeros(kind, m, n), identity(kind, m)]])
    y = assembled(kind, [[C, (D - K) / T]])
    stored = diagonal_blocks(kind, [P, zeros(kind, m, m)])
    supply = phi.transpose() * y
    M = following.transpose() * Pi * following - stored + y.transpose() * level * y
    return {"Pi > 0": Pi, _DISSIPATION: (supply + supply.transpose()) / 2 - M}


def _told(verdict: Verdict, corrected: bool) -> Verdict:
    text = "; with D less the skew part of V(1), below 1e-12 of it: rounding" if corrected else ""
    return Verdict(verdict.holds, verdict.least, verdict.argument + text)
