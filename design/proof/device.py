"""The device behind a delay inside the tick and a longer period: the form F_t >= 0, exactly, for 0 <= t <= tau/T.

The force of tick k reaches the device tau_k late, t = tau_k/T, and no later than the next sample. A period lasts at
most lambda T, lambda = 1 + rho. The device moves by alpha under the old force and by beta under the new force, and
dissipates at least Delta_D (alpha^2/tau_k + beta^2/(lambda T - tau_k)) [Miller2004]_, in a shorter period more. With
T = Delta_D = 1, sigma = alpha + beta, g and g- the last two steps of the force, and the best split of sigma,
alpha = t sigma/lambda - t(lambda - t) g-/(2 lambda), one tick leaves

    F_t = sigma^2/lambda + (t/lambda) sigma g- - t(lambda - t)/(4 lambda) g-^2 + g sigma + (kappa/2 - c) g^2 + c g-^2
          - share (sigma + kappa g)^2.

F_t >= 0 for every t that occurs, with one c >= 0, makes G_hat with K = kappa T Delta_D^-1 (share Delta_D)-OSP: the
storage is the device's own, f^T K f/2 and c g^T (T Delta_D^-1) g. F_t is linear in t except for + t^2 g-^2/(4 lambda),
which is convex and lies above its tangent at any point. On a piece of [0, tau/T] with middle mu, t^2 is replaced by
2 mu t - mu^2. This makes the form linear in t, so that it is nonnegative on the piece if it is at both ends. A piece
that fails is halved.
"""

from __future__ import annotations

from itertools import combinations

from flint import fmpq, fmpq_mat

from manyhands.design.proof.finding import Finding
from manyhands.design.proof.rational import least_eigenvalue, rounded

_PIECES = 16
_MOST_TESTS = 4_000


def device_form(kappa: fmpq, share: fmpq, c: fmpq, tau_hat: fmpq, stretch: fmpq) -> Finding:
    """F_t >= 0 for every t in [0, tau_hat].

    Args:
        kappa: the loop gain, K = kappa T Delta_D^-1.
        share: part of Delta_D that G_hat keeps.
        c: weight of the force's last step in the storage.
        tau_hat: tau/T, 0 ... 1.
        stretch: lambda = 1 + rho, at least 1; periods are at most lambda T.
    """
    condition = "the device keeps its share: F_t >= 0 for 0 <= t <= tau/T"
    if stretch != 1:
        condition += " and periods up to (1 + rho) T"
    ends = [fmpq(0)] if tau_hat == 0 else [tau_hat * i / _PIECES for i in range(_PIECES + 1)]
    least = min(least_eigenvalue(_form(kappa, share, c, t, t * t, stretch)) for t in ends)
    if tau_hat == 0:
        holds, argument = _semidefinite(_form(kappa, share, c, fmpq(0), fmpq(0), stretch)), "exactly, in rationals"
    else:
        holds, argument = _by_pieces(kappa, share, c, tau_hat, stretch)
    return Finding(condition, holds, max(least, 0.0) if holds else least, 0.0, argument=argument)


def _by_pieces(kappa: fmpq, share: fmpq, c: fmpq, tau_hat: fmpq, stretch: fmpq) -> tuple[bool, str]:
    pieces = [(tau_hat * i / _PIECES, tau_hat * (i + 1) / _PIECES) for i in range(_PIECES)]
    tests = proved = 0
    while pieces:
        low, high = pieces.pop()
        tests += 1
        middle = (low + high) / 2
        if all(_semidefinite(_form(kappa, share, c, t, 2 * middle * t - middle**2, stretch)) for t in (low, high)):
            proved += 1
            continue
        for t in (low, middle, high):
            if not _semidefinite(_form(kappa, share, c, t, t * t, stretch)):
                return False, f"F_t is negative for some motion at t = {rounded(t):.6g}"
        if tests > _MOST_TESTS:
            return False, f"not decided with {tests} pieces: F_t is too close to 0"
        pieces += [(low, middle), (middle, high)]
    return True, f"exactly, in rationals, by tangents on {proved} pieces; the delay may vary from tick to tick"


def _form(kappa: fmpq, share: fmpq, c: fmpq, t: fmpq, square: fmpq, stretch: fmpq) -> fmpq_mat:
    """The 3 x 3 matrix of F_t over (sigma, g, g-), with ``square`` for t^2."""
    half = fmpq(1, 2)
    cross = half - share * kappa
    return fmpq_mat(
        [
            [1 / stretch - share, cross, t / (2 * stretch)],
            [cross, kappa / 2 - c - share * kappa**2, fmpq(0)],
            [t / (2 * stretch), fmpq(0), c - (t - square / stretch) / 4],
        ]
    )


def _semidefinite(M: fmpq_mat) -> bool:
    """Whether M >= 0, by every principal minor."""
    n = M.nrows()
    for size in range(1, n + 1):
        for rows in combinations(range(n), size):
            if fmpq_mat(size, size, [M[i, j] for i in rows for j in rows]).det() < 0:
                return False
    return True
