"""A block of the spring-damper class: V_hat is Delta_V-OSP, by a closed form with proof.

Let Lambda = Delta_D/(2 kappa), so that the loop gain is K = (T/2) Lambda^-1, and J = Lambda - (T/2) K_s for the
stiffness K_s and damping B of V = (K_s + B (z-1)/(Tz))^-1. If K_s > 0, J > 0, J - B >= 0 and

    Delta_V <= Delta_V* = Lambda J^-1 (J + B) J^-1 Lambda - Lambda,    Delta_V > 0,

then V is stable and V_hat is Delta_V-OSP. For with d the deflection, u = (d - d-)/T, g = u - u- (- marks the tick
before), f the force and y = u - K (f - f-)/T, one has f - f- = 2 (Lambda - J) u + B g, y = Lambda^-1 (J u - B g/2),
and multiplied out

    f'y - y' Delta_V* y = S - S- + (1/4) g' B J^-1 (J - B) J^-1 B g,   S = (d'K_s d - f'K f)/(2T) + (1/2) u' B J^-1 B u.

S >= 0, as blockdiag((Lambda - J)^-1, 2 J^-1) >= [I I]' Lambda^-1 [I I], for (Lambda - J) + J/2 <= Lambda. And
Delta_V* > 0 is J + B > J Lambda^-1 J, that is B + (T/2) K_s > (T/2)^2 K_s Lambda^-1 K_s >= 0, so that every pole of
V, an eigenvalue of the pencil (B, T K_s + B), is between -1 and 1.
"""

from __future__ import annotations

from flint import fmpq, fmpq_mat

from manyhands.design.proof import balls, rational
from manyhands.design.proof.balls import Kind
from manyhands.design.proof.claim import SpringDamper
from manyhands.design.proof.finding import Verdict, weakest
from manyhands.design.proof.reading import Table

_EXACT_ROWS = 32
_EXACT_BITS = 300  # numbers of unusual length go to balls, which carry a fixed number of bits


def spring_damper(V: SpringDamper, Delta_D: Table, Delta_V: Table, kappa: fmpq, T: fmpq) -> Verdict:
    """Whether V_hat of the block is Delta_V-OSP, given Delta_V > 0, kappa > 0, T > 0.

    Exactly in rationals, where equality is as good as any; large blocks in balls, which need room.
    """
    K_s, B, D, level = V.stiffness, V.damping, Delta_D, Delta_V
    if exactly_quick(K_s, B, D, level):
        try:
            found = _conditions(K_s.rational(), B.rational(), D.rational(), level.rational(), kappa, T)
        except ZeroDivisionError:
            return Verdict(False, 0.0, "J is singular")
        return weakest({name: rational.definite(M, strict) for name, (M, strict) in found.items()})

    def by_balls() -> Verdict:
        found = _conditions(K_s.balls(), B.balls(), D.balls(), level.balls(), kappa, T)
        return weakest({name: balls.definite(balls.symmetrised(M)) for name, (M, _) in found.items()})

    return balls.decided(D.rows, by_balls)


def exactly_quick(*tables: Table) -> bool:
    """Whether exact inverses of matrices like these are quick."""
    return max(t.rows for t in tables) <= _EXACT_ROWS and max(t.bits() for t in tables) <= _EXACT_BITS


def loop_stiffness_limit(V: SpringDamper, Delta_D: Table, kappa: fmpq, T: fmpq) -> fmpq_mat:
    """J = Lambda - (T/2) K_s, N*s/m: what the loop leaves of its stiffness limit."""
    return Delta_D.rational() / (2 * kappa) - V.stiffness.rational() * (T / 2)


def _conditions(K_s: Kind, B: Kind, Delta_D: Kind, Delta_V: Kind, kappa: fmpq, T: fmpq) -> dict[str, tuple[Kind, bool]]:
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
