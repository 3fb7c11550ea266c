"""A block of the coupling: V_hat is Delta_V-OSP, by a storage matrix or by a closed form.

**A linear block** V = (A, B, C, D), with the differentiator of V_hat divided out. V_hat = (z-1)/(Tz) (V - K),
y = (v - v- - K phi)/T with v = V f and phi = f - f- (- marks the tick before), has the state (zeta, f-) with
zeta = (xi - xi-)/T. For every constant force, its storage [zeta; f-]' Pi [zeta; f-] must equal the energy that the
supply f'y has brought. This forces

    Pi = [ P  P12 ; P12'  P22 ],    P12 = (A - I)^-T C'/2,    P22 = (V(1) - K)/(2T),
    V(1) = D + C (I - A)^-1 B = V(1)',

With next = (A zeta + B phi/T, phi) and y = C zeta + (D - K) phi/T, a quadratic form in (zeta, phi) without f- remains,

    M_V = next' Pi next - zeta' P zeta - phi' y + y' Delta_V y <= 0,      Pi > 0.

This is Lemma 1 of [Bianchini2010]_ for the realisation (12) on the complement of its neutral directions. M_V < 0 and
P > 0 give A' P A - P < 0: V is stable.

V(1) and its symmetry are always decided in rationals, even if the rest is done in balls
(:mod:`manyhands.design.proof.statics`).

**A block of the spring-damper class.** Let Lambda = Delta_D/(2 kappa), so that the loop gain is K = (T/2) Lambda^-1,
and J = Lambda - (T/2) K_s for the stiffness K_s and damping B of V = (K_s + B (z-1)/(Tz))^-1. If K_s > 0, J > 0,
J - B >= 0 and

    Delta_V <= Delta_V* = Lambda J^-1 (J + B) J^-1 Lambda - Lambda,    Delta_V > 0,

then V is stable and V_hat is Delta_V-OSP. To see this, let d be the deflection, u = (d - d-)/T, g = u - u- (- marks the
tick before), f the force and y = u - K (f - f-)/T. Then f - f- = 2 (Lambda - J) u + B g, y = Lambda^-1 (J u - B g/2),
and multiplied out

    f'y - y' Delta_V* y = S - S- + (1/4) g' B J^-1 (J - B) J^-1 B g,   S = (d'K_s d - f'K f)/(2T) + (1/2) u' B J^-1 B u.

S >= 0 because blockdiag((Lambda - J)^-1, 2 J^-1) >= [I I]' Lambda^-1 [I I], which follows from
(Lambda - J) + J/2 <= Lambda. Delta_V* > 0 means J + B > J Lambda^-1 J, that is B + (T/2) K_s > (T/2)^2 K_s Lambda^-1
K_s >= 0. So every pole of V, an eigenvalue of the pencil (B, T K_s + B), is between -1 and 1.
"""

from __future__ import annotations

from flint import arb_mat, fmpq, fmpq_mat

from manyhands.design.proof import rational, statics
from manyhands.design.proof.claim import Linear, StatedSpringDamper
from manyhands.design.proof.exact import StatedMatrix
from manyhands.design.proof.finding import Verdict, weakest
from manyhands.design.proof.rational import Kind, assembled, diagonal_blocks, identity, zeros

_SPRING_DAMPER_EXACT_ROWS = 32
_BALLS_FIRST = 4  # rows above which balls are quicker
_EXACT_BITS = 300  # numbers of unusual length go to balls, which carry a fixed number of bits


def spring_damper(V: StatedSpringDamper, Delta_D: StatedMatrix, Delta_V: StatedMatrix, kappa: fmpq, T: fmpq) -> Verdict:
    """Whether V_hat of the block is Delta_V-OSP, given Delta_V > 0, kappa > 0, T > 0.

    Small blocks are decided exactly in rationals, where equality is allowed. Larger blocks are first tried in balls,
    which are quicker and need room in the inequalities.
    """
    K_s, B, D, level = V.stiffness, V.damping, Delta_D, Delta_V

    def by_balls() -> Verdict:
        found = _spring_damper_conditions(K_s.balls(), B.balls(), D.balls(), level.balls(), kappa, T)
        return weakest({name: rational.definite_in_balls(rational.symmetrised(M)) for name, (M, _) in found.items()})

    quick = exactly_quick(K_s, B, D, level, scalars=(kappa, T))
    if D.rows > _BALLS_FIRST or not quick:
        verdict = rational.decided(D.rows, by_balls)
        if verdict.holds or not quick:
            return verdict
    try:
        found = _spring_damper_conditions(K_s.rational(), B.rational(), D.rational(), level.rational(), kappa, T)
    except ZeroDivisionError:
        return Verdict(False, 0.0, "J is singular")
    return weakest({name: rational.definite(M, strict) for name, (M, strict) in found.items()})


def exactly_quick(*tables: StatedMatrix, scalars: tuple[fmpq, ...] = ()) -> bool:
    """Whether exact inverses of matrices like these, times such scalars, are quick."""
    if max(t.rows for t in tables) > _SPRING_DAMPER_EXACT_ROWS:
        return False
    return max(*(t.bits() for t in tables), *(int(x.height_bits()) for x in scalars)) <= _EXACT_BITS


def loop_stiffness_limit(V: StatedSpringDamper, Delta_D: StatedMatrix, kappa: fmpq, T: fmpq) -> fmpq_mat:
    """J = Lambda - (T/2) K_s, N*s/m: the distance of the stiffness to the loop's limit."""
    return Delta_D.rational() / (2 * kappa) - V.stiffness.rational() * (T / 2)


def _spring_damper_conditions(
    K_s: Kind, B: Kind, Delta_D: Kind, Delta_V: Kind, kappa: fmpq, T: fmpq
) -> dict[str, tuple[Kind, bool]]:
    """The matrices that must be positive, by name, and whether strictly."""
    Lambda = Delta_D / (2 * kappa)
    J = Lambda - K_s * (T / 2)
    X = J.inv() * Lambda
    return {
        "K > 0": (K_s, True),
        "J = Delta_D/(2 kappa) - (T/2) K > 0": (J, True),
        "J - B >= 0": (J - B, False),
        "Delta_V <= Delta_V*": (X.transpose() * (J + B) * X - Lambda - Delta_V, False),
    }


_LINEAR_EXACT_ROWS = 12
_DISSIPATION = "M_V <= 0"


def linear(V: Linear, Delta_D: StatedMatrix, Delta_V: StatedMatrix, kappa: fmpq, T: fmpq) -> Verdict:
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

    def by_balls() -> Verdict:
        A, B, C, D_D, D_V = (table.balls() for table in (V.A, V.B, V.C, Delta_D, Delta_V))
        found = _linear_conditions(arb_mat, A, B, C, arb_mat(D), arb_mat(V_1), V.P.witness(), D_D, D_V, kappa, T)
        return weakest({name: rational.definite_in_balls(rational.symmetrised(M)) for name, M in found.items()})

    tables = (V.A, V.B, V.C, stated, V.P, Delta_D, Delta_V)
    quick = n + m <= _LINEAR_EXACT_ROWS and exactly_quick(*tables, scalars=(kappa, T))
    if n + m > _BALLS_FIRST or not quick:
        verdict = rational.decided(n + m, by_balls)
        if verdict.holds or not quick:
            return verdict
    A, B, C, P, D_D, D_V = (table.rational() for table in (V.A, V.B, V.C, V.P, Delta_D, Delta_V))
    try:
        found = _linear_conditions(fmpq_mat, A, B, C, D, V_1, P, D_D, D_V, kappa, T)
    except ZeroDivisionError:
        return Verdict(False, float("nan"), "Delta_D is singular")
    # a block without states cannot be unstable, so <= is enough
    strict = {name: n > 0 or name != _DISSIPATION for name in found}
    return weakest({name: rational.definite(M, strict[name]) for name, M in found.items()})


def _linear_conditions(
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
