"""The cost of a delay inside the tick and of a longer period: the loop transformation's gain, and the device's share.

The force computed from the sample at kT acts from kT + tau_k on, 0 <= tau_k <= tau <= T, and tau_k may differ from tick
to tick. Over the tick before kT the device moves by alpha while f_{k-2} still acts, and by beta while f_{k-1} acts. It
dissipates at least Delta (alpha^2/tau_k + beta^2/(T - tau_k)). With K = kappa T Delta_D^-1 in the transformation (7)
of [Bianchini2010]_,

    y_k = (x_k - x_{k-1} + K g_k)/T,    g_k = f_k - f_{k-1},

take the device's storage plus f^T K f/2 + c g^T (T Delta_D^-1) g, and the best split of sigma = alpha + beta. A tick
leaves (in units with T = Delta_D = 1, t = tau_k/T, g- the force step before g; matrices by congruence with Delta_D^1/2)

    F_t = sigma^2 + t sigma g- - t(1-t)/4 g-^2 + g sigma + (kappa/2 - c) g^2 + c g-^2 - share (sigma + kappa g)^2.

If F_t >= 0 for every t in [0, tau_hat], tau_hat = tau/T, and one c >= 0, then G_hat is (share Delta_D)-OSP (f to y).

**Solved in closed form.** With a = 1/2 - share kappa, b = kappa a, p = t/2, q = t(1-t)/4, Schur complements give

    F_t >= 0  <=>  a^2/(b - c) + p^2/(c - q) <= 1 - share,    q <= c <= b,

so a >= 0, and the left side is least, (a + p)^2/(b - q), at c = q + (b - q) p/(a + p). The rest is linear in share:

    share <= v / (v^2 + (1 + 4t) v + 4 t^2),    v = 2 kappa - 1 - 3t.                                           (*)

**A varying delay costs no more than its longest value.** The c at t = tau_hat is c >= q + p(a + p) >= tau_hat/4. Then

    p^2/(c - q) = t^2/(4c - t + t^2)

grows over all of [0, tau_hat], because its derivative in t is t (8c - t)/(4c - t + t^2)^2. So share > 0 requires
kappa > 1/2 + 3/2 tau_hat. The greatest share is 1/(1 + 8 tau_hat), at kappa = 1/2 + 5/2 tau_hat. Without a delay
share = 1/(2 kappa), which is the paper's (8)-(9) at kappa = 1/2.

**A period that is longer than T.** A loop that wakes late samples at s_k = kT + w_k, so that a period is lambda_k T.
Let lambda_k <= lambda = 1 + rho, with rho the period tolerance, and let a force act no later than the next sample. The
device then dissipates at least Delta (alpha^2/tau_k + beta^2/(lambda_k T - tau_k)), which is least at the longest
period. So only lambda_k = lambda counts, and every shorter period is covered. The best split of sigma leaves

    F_t = sigma^2/lambda + (t/lambda) sigma g- - t(lambda - t)/(4 lambda) g-^2 + g sigma
          + (kappa/2 - c) g^2 + c g-^2 - share (sigma + kappa g)^2.

With sigma = lambda s and t = lambda t' this is lambda times F_t' above, with kappa/lambda, lambda share and c/lambda in
place of kappa, share and c. So (kappa, share, c, tau) holds for all periods up to lambda T exactly if
(kappa/lambda, lambda share, c/lambda) holds for tau/(lambda T) and a period of 1. Every function here takes rho and
applies this scaling. Then kappa > lambda/2 + 3/2 tau_hat is needed, and the greatest share is
1/(lambda + 8 tau_hat). Every device has delays and periods of its own. Without a delay Delta_D may still join devices:
the form then needs no more than sigma^T Delta_D sigma/lambda, which the devices dissipate together.

The condition is not far from necessary. A heavy mass on its damper, behind a constant delay, needs
kappa >= (1 + tau_hat)^2/2 for G_hat to be passive. This is the same bound at tau_hat = 0 and 1, and less by
tau_hat (1 - tau_hat)/2 between.

**In pieces.** A proof does not need this closed form. It can cut [0, tau_hat] into pieces, replace t^2 in F_t by its
tangent at a piece's middle, and test the ends of every piece. With pieces of length h this costs at most h^2/16 of
g-^2. :func:`device_share` returns the share that :data:`PIECES` pieces prove, checked in exact rational arithmetic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

from manyhands.design.levels.rounding import rounded_down

PIECES = 16  # of [0, tau_hat]: the least gain rises by tau_hat^2/2048, 0.025 % at a whole tick

_SAFETY = Fraction(1, 10**9)  # part of the share given up, so that rounding share, c and tau/T leaves the claim true

Real = float | Fraction
"""A number that is taken exactly: a float stands for its binary value."""


@dataclass(frozen=True)
class Share:
    """The part of its level that a device keeps behind a delay.

    Attributes:
        share: G_hat is (share Delta_D)-OSP; in (0, 1].
        c: the weight of the last force step in the storage, c g^T (T Delta_D^-1) g; dimensionless, >= 0.
    """

    share: float
    c: float


def least_gain(tau_hat: float, period_tolerance: float = 0.0) -> float:
    """The kappa, (1 + rho)/2 + 3/2 tau_hat, above which a device keeps a positive share; G_hat is passive at it.

    Args:
        tau_hat: tau/T, the longest delay in ticks, 0 ... 1.
        period_tolerance: rho; periods are at most (1 + rho) T; 0 ... 1.

    Raises:
        ValueError: an argument is outside its range.
    """
    return float(_stretch(period_tolerance) / 2 + Fraction(3, 2) * _tick_fraction(tau_hat))


def greatest_share(tau_hat: float, period_tolerance: float = 0.0) -> float:
    """1/(1 + rho + 8 tau_hat), rounded down: the most that any kappa leaves, at kappa = (1 + rho)/2 + 5/2 tau_hat.

    Raises:
        ValueError: an argument is outside its range, as for :func:`least_gain`.
    """
    return rounded_down(1 / (_stretch(period_tolerance) + 8 * _tick_fraction(tau_hat)))


def gain_for_share(
    share: float, tau_hat: float, pieces: int | None = None, period_tolerance: float = 0.0
) -> float | None:
    """The least kappa that leaves ``share`` of the device's level: the smaller root of (*) for v.

    Args:
        share: 0 ... 1; 0 gives :func:`least_gain`, which is a limit and not reached.
        tau_hat: tau/T, 0 ... 1.
        pieces: number of the proof's pieces; None for the limit of infinitely many. With pieces and
            e = (tau_hat/pieces)^2/4, (*) reads share = (v - e)/(v^2 + (1 + 4t) v + 4t^2 - e).
        period_tolerance: rho; periods are at most (1 + rho) T; 0 ... 1.

    Returns:
        kappa, or None if no kappa leaves ``share``.

    Raises:
        ValueError: an argument is outside its range.
    """
    stretch = _stretch(period_tolerance)
    t = float(_tick_fraction(tau_hat) / stretch)
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"share: found {share}; expected 0 ... 1")
    if share > greatest_share(tau_hat, period_tolerance):
        return None
    if t == 0.0:
        return float(stretch / 2)
    share *= float(stretch)
    # s v^2 - (1 - s(1 + 4t)) v + 4 s t^2 + (1 - s) e = 0; this form of the discriminant loses no digits
    e = 4.0 * float(_lost(Fraction(t), pieces)) if pieces is not None else 0.0
    half = 1.0 - share * (1.0 + 4.0 * t)
    discriminant = (1.0 - share) * (1.0 - share * (1.0 + 8.0 * t) - 4.0 * share * e)
    if discriminant < 0.0 and pieces is not None:
        return None
    root = math.sqrt(max(discriminant, 0.0))  # 0 at the greatest share, up to rounding
    v = 2.0 * (4.0 * share * t**2 + (1.0 - share) * e) / (half + root)
    return float(stretch) * (1.0 + 3.0 * t + v) / 2.0


def device_share(kappa: Real, tau_hat: Real, pieces: int = PIECES, period_tolerance: Real = 0.0) -> Share:
    """The greatest share that ``pieces`` equal pieces of [0, tau_hat] prove for every delay up to tau_hat.

    The returned share is smaller by a relative 1e-9, so that every end of every piece is strictly inside. Without a
    delay and with kappa = 1/2, the paper's case, it is exactly share 1 and c 0.

    Args:
        kappa: K = kappa T Delta_D^-1; dimensionless.
        tau_hat: tau/T, 0 ... 1. A Fraction avoids the rounding of the quotient.
        pieces: number of the proof's pieces.
        period_tolerance: rho; periods are at most (1 + rho) T; 0 ... 1.

    Raises:
        ValueError: no positive share exists, because kappa does not exceed :func:`least_gain` by the cost of the
            pieces, (tau_hat/pieces)^2/(8 (1 + rho)); or pieces is not positive.
    """
    stretch = _stretch(period_tolerance)
    gain, t = _gain(kappa) / stretch, _tick_fraction(tau_hat) / stretch
    lost = _lost(t, pieces)
    if t == 0 and gain == Fraction(1, 2) and stretch == 1:
        return Share(1.0, 0.0)
    limit = _exact_share(gain, t, lost, stretch)
    safety = _SAFETY
    while safety < Fraction(1, 1000):
        share = float(limit / stretch * (1 - safety))
        c = float(stretch * _exact_weight(gain, t, lost, stretch * Fraction(share)))
        if share > 0.0 and pieces_hold(kappa, tau_hat, Share(share, c), pieces, period_tolerance):
            return Share(share, c)
        safety *= 100
    least = least_gain(float(tau_hat), float(period_tolerance))
    raise ValueError(
        f"kappa: found {float(kappa)!r}, so little above {least!r} that double precision does not "
        f"resolve the share, {float(limit / stretch):.3g}; expected more"
    )


def pieces_hold(kappa: Real, tau_hat: Real, claim: Share, pieces: int = PIECES, period_tolerance: Real = 0.0) -> bool:
    """Whether F_t, with t^2 replaced by its tangents, is >= 0 at both ends of every piece; decided in exact rationals.

    Args:
        kappa: K = kappa T Delta_D^-1.
        tau_hat: tau/T.
        claim: share and c.
        pieces: number of equal pieces; without a delay there is one point to test.
        period_tolerance: rho; periods are at most (1 + rho) T.
    """
    stretch = _stretch(period_tolerance)
    gain, t = _gain(kappa) / stretch, _tick_fraction(tau_hat) / stretch
    share, c = stretch * Fraction(claim.share), Fraction(claim.c) / stretch
    if c < 0:
        return False
    if t == 0:
        return _holds_at(gain, share, c, Fraction(0), Fraction(0))
    h = t / pieces
    for i in range(pieces):
        middle = (2 * i + 1) * h / 2
        for end in (i * h, (i + 1) * h):
            square = 2 * middle * end - middle**2
            if not _holds_at(gain, share, c, end, (end - square) / 4):
                return False
    return True


def _holds_at(kappa: Fraction, share: Fraction, c: Fraction, t: Fraction, q: Fraction) -> bool:
    """F_t >= 0 with t(1-t)/4 given as ``q``: every principal minor of its 3 x 3 matrix over (sigma, g, g-) is >= 0.

    [[x, a, p], [a, y, 0], [p, 0, w]] with x = 1 - share, a and p as above, y = b - c, w = c - q.
    """
    x, a, p = 1 - share, Fraction(1, 2) - share * kappa, t / 2
    y, w = kappa / 2 - share * kappa**2 - c, c - q
    first = min(x, y, w) >= 0
    second = x * y >= a**2 and x * w >= p**2
    return first and second and x * y * w - a**2 * w - p**2 * y >= 0


def _lost(t: Fraction, pieces: int) -> Fraction:
    """The part of c that tangents lose at the ends of pieces of length h: h^2/16."""
    if pieces < 1:
        raise ValueError(f"pieces: found {pieces}; expected 1 or more")
    return (t / pieces) ** 2 / 16


def _exact_share(kappa: Fraction, t: Fraction, lost: Fraction, stretch: Fraction) -> Fraction:
    """The greatest share, (*) with q = t(1-t)/4 + lost; all but ``stretch`` scaled to a period of 1."""
    v = 2 * kappa - 1 - 3 * t
    if v - 4 * lost <= 0 and not (t == 0 and v == 0):
        least = float(stretch / 2 + Fraction(3, 2) * stretch * t)
        half = "1/2" if stretch == 1 else f"{float(stretch):.6g}/2"
        raise ValueError(
            f"kappa: found {float(stretch * kappa)!r} with tau/T = {float(stretch * t):.6g}; expected more than "
            f"{half} + 3/2 tau/T = {least!r}" + (f" by {float(2 * stretch * lost):.3g}" if lost else "")
        )
    if t == 0:
        return 1 / (2 * kappa)
    return (v - 4 * lost) / (v**2 + (1 + 4 * t) * v + 4 * t**2 - 4 * lost)


def _exact_weight(kappa: Fraction, t: Fraction, lost: Fraction, share: Fraction) -> Fraction:
    """The c that leaves the most room at t, with q = t(1-t)/4 + lost."""
    if t == 0:
        return Fraction(0)
    a, p, q = Fraction(1, 2) - share * kappa, t / 2, t * (1 - t) / 4 + lost
    b = kappa / 2 - share * kappa**2
    return q + (b - q) * p / (a + p)


def _gain(kappa: Real) -> Fraction:
    if not 0.0 < kappa < math.inf:
        raise ValueError(f"kappa: found {float(kappa)!r}; expected a finite positive number")
    return Fraction(kappa)


def _stretch(period_tolerance: Real) -> Fraction:
    """The longest period in units of T, lambda = 1 + rho."""
    if not 0.0 <= period_tolerance <= 1.0:
        raise ValueError(f"period tolerance: found {float(period_tolerance)!r}; expected 0 ... 1")
    return 1 + Fraction(period_tolerance)


def _tick_fraction(tau_hat: Real) -> Fraction:
    if not 0.0 <= tau_hat <= 1.0:
        raise ValueError(f"tau/T: found {float(tau_hat)!r}; expected 0 ... 1: a delay inside the tick")
    return Fraction(tau_hat)
