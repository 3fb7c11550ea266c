"""Delays inside the tick and longer periods: closed forms against a solver, exact arithmetic, and simulated devices."""

from __future__ import annotations

from fractions import Fraction

import cvxpy as cp
import numpy as np
import pytest
from flint import fmpq
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from manyhands.design.levels.contract import DeviceShare
from manyhands.design.levels.device import (
    PIECES,
    Share,
    device_share,
    gain_for_share,
    greatest_share,
    least_gain,
    pieces_hold,
)
from manyhands.design.models.statespace import Matrix
from manyhands.design.proof.device import device_form

DELAYS = st.floats(0.0, 1.0)
TOLERANCES = st.one_of(st.sampled_from([0.0, 0.1, 1.0]), st.floats(0.0, 1.0))
ABOVE = st.floats(1e-3, 10.0)  # of kappa, above the least gain


def four_by_four(t: float, kappa: float, share: float, c: float) -> Matrix:
    """The form before its minimisation, over (alpha, beta, g, g-), T = Delta = 1, 0 < t < 1."""
    out = np.zeros((4, 4))
    out[0, 0], out[1, 1] = 1.0 / t, 1.0 / (1.0 - t)
    out[0, 2] = out[2, 0] = out[1, 2] = out[2, 1] = 0.5
    out[0, 3] = out[3, 0] = 0.5
    out[2, 2], out[3, 3] = kappa / 2.0 - c, c
    y = np.array([1.0, 1.0, kappa, 0.0])
    return out - share * np.outer(y, y)


def proved(kappa: float, claim: Share, tau_hat: float, rho: float = 0.0) -> bool:
    """Whether the exact proof, which has the form in closed form of its own, finds the claim true."""
    numbers = (kappa, claim.share, claim.c, tau_hat, 1 + Fraction(rho))
    return device_form(*(fmpq(*Fraction(v).as_integer_ratio()) for v in numbers)).holds


def limit_share(kappa: float, tau_hat: float) -> Share:
    """Equation (*) of the module, with its c: the limit of infinitely many pieces, for one constant delay."""
    v = 2.0 * kappa - 1.0 - 3.0 * tau_hat
    share = v / (v**2 + (1.0 + 4.0 * tau_hat) * v + 4.0 * tau_hat**2) if tau_hat else 0.5 / kappa
    p, q, a = tau_hat / 2.0, tau_hat * (1.0 - tau_hat) / 4.0, 0.5 - share * kappa
    b = kappa * a
    return Share(share, q + (b - q) * p / (a + p) if p else 0.0)


@pytest.mark.parametrize(
    ("kappa", "tau_hat", "share"),
    [(0.9, 0.1, 0.505), (1.75, 0.5, 0.200), (0.5, 0.0, 1.0), (1.0, 0.0, 0.5)],
)
def test_reference_values(kappa: float, tau_hat: float, share: float) -> None:
    assert limit_share(kappa, tau_hat).share == pytest.approx(share, abs=5e-4)
    assert device_share(kappa, tau_hat).share == pytest.approx(share, abs=5e-4)


def test_the_papers_case_is_exact() -> None:
    assert device_share(0.5, 0.0) == Share(1.0, 0.0)
    assert pieces_hold(0.5, 0.0, Share(1.0, 0.0))
    assert not pieces_hold(0.5, 0.0, Share(1.0, 1e-300))


@pytest.mark.parametrize("tau_hat", [0.02, 0.3, 0.5, 0.8, 0.99])
@pytest.mark.parametrize("above", [0.05, 0.7, 5.0])
def test_a_solver_finds_the_same_share(tau_hat: float, above: float) -> None:
    """The greatest share for which some c makes the 4 x 4 form >= 0: an LMI in (share, c)."""
    kappa = least_gain(tau_hat) + above
    share, c = cp.Variable(), cp.Variable(nonneg=True)
    weight = np.diag([0.0, 0.0, -1.0, 1.0])
    y = np.array([1.0, 1.0, kappa, 0.0])
    form = four_by_four(tau_hat, kappa, 0.0, 0.0) + c * weight - share * np.outer(y, y)
    S = np.diag([np.sqrt(tau_hat), np.sqrt(1.0 - tau_hat), 1.0, 1.0])  # so that the solver sees a unit diagonal
    cp.Problem(cp.Maximize(share), [S @ form @ S >> 0]).solve(solver="CLARABEL")
    # Clarabel's gap is 1e-8 of numbers of order 10
    assert limit_share(kappa, tau_hat).share == pytest.approx(float(share.value), abs=1e-6)


@given(DELAYS, ABOVE, st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8))
def test_one_c_serves_every_delay_up_to_the_longest(tau_hat: float, above: float, parts: list[float]) -> None:
    assume(tau_hat > 1e-6)
    kappa = least_gain(tau_hat) + above
    found = device_share(kappa, tau_hat)
    limit = limit_share(kappa, tau_hat)
    assert 0.0 < found.share < limit.share <= greatest_share(tau_hat) * (1.0 + 1e-12)
    for part in parts:
        t = min(max(part * tau_hat, 1e-9), 1.0 - 1e-9)
        for claim in (found, limit):
            form = four_by_four(t, kappa, claim.share, claim.c)
            scaled = form / np.sqrt(np.outer(np.diag(form) + kappa, np.diag(form) + kappa))
            # entries of order 1 with rounding of 1e-16 each, and what t was moved by
            assert np.linalg.eigvalsh(scaled)[0] >= -1e-8


@given(st.one_of(DELAYS, st.floats(1e-12, 1e-3)), st.one_of(ABOVE, st.floats(1e-7, 1e-3)))
def test_pieces_prove_it_in_exact_arithmetic(tau_hat: float, above: float) -> None:
    kappa = least_gain(tau_hat) + above
    assume(above > 1.01 * (tau_hat / PIECES) ** 2 / 8.0)
    found = device_share(kappa, tau_hat)
    assert pieces_hold(kappa, tau_hat, found)
    assert proved(kappa, found, tau_hat)
    too_much = Share(min(1.0, limit_share(kappa, tau_hat).share * (1.0 + 1e-6)), found.c)
    assume(too_much.share < 1.0)
    assert not pieces_hold(kappa, tau_hat, too_much)


@given(st.floats(1e-4, 1e-2), st.floats(0.0, 1.0), ABOVE)
def test_a_quotient_that_is_rounded_leaves_the_claim_true(T: float, part: float, above: float) -> None:
    """A proof divides tau by T exactly."""
    tau = part * T
    exact = Fraction(tau) / Fraction(T)
    kappa = least_gain(tau / T) + above
    assert pieces_hold(kappa, exact, device_share(kappa, tau / T))


@given(st.floats(0.01, 1.0), st.floats(0.0, 1.0), st.floats(0.01, 1.0), st.floats(0.0, 1.0))
def test_the_longest_period_is_the_last_that_the_form_allows(
    tau_hat: float, rho: float, above: float, part: float
) -> None:
    """One nanosecond in a second longer, and some motion contradicts the form with the certificate's own c."""
    kappa, t = least_gain(tau_hat, rho) + above, part * tau_hat
    found = device_share(kappa, tau_hat, period_tolerance=rho)
    share, c = found.share, found.c
    most = DeviceShare(kappa, share, c).longest_period(t)
    assert most >= (1.0 + rho) * (1.0 - 1e-12)

    def least(period: float) -> Fraction:
        """The determinant of the form's matrix over (sigma, g, g-), whose other minors stay positive."""
        K, s, w, d, p = (Fraction(number) for number in (kappa, share, c, t, period))
        x, y, z = 1 / p - s, K / 2 - w - s * K**2, w - d * (p - d) / (4 * p)
        cross, late = Fraction(1, 2) - s * K, d / (2 * p)
        assert min(x, y, z) > 0
        return x * y * z - cross**2 * z - late**2 * y

    assert least(most * (1.0 - 1e-9)) > 0
    assert least(most * (1.0 + 1e-9)) < 0


@given(DELAYS, st.floats(0.0, 1.0))
def test_gain_and_share_are_inverse(tau_hat: float, part: float) -> None:
    share = part * greatest_share(tau_hat)
    kappa = gain_for_share(share, tau_hat)
    assert kappa is not None
    assert least_gain(tau_hat) <= kappa * (1.0 + 1e-15)
    if share > 1e-6 and tau_hat > 1e-6:
        # near the greatest share kappa moves with the root of the share's rounding; near none, the share is in
        # proportion to v = 2 kappa - 1 - 3 tau_hat, of which kappa's last digit is a large part for small delays
        lost = 1e-15 / (2.0 * kappa - 1.0 - 3.0 * tau_hat)
        assert limit_share(kappa, tau_hat).share == pytest.approx(share, rel=1e-6 + lost)
        assert kappa <= (0.5 + 2.5 * tau_hat) * (1.0 + 1e-7)


@given(st.floats(1e-6, 1.0), st.floats(0.0, 0.99))
def test_the_gain_knows_what_pieces_cost(tau_hat: float, part: float) -> None:
    """At the gain for 16 pieces they prove the share, except for the safety margin; a little below they do not."""
    share = part * greatest_share(tau_hat)
    kappa = gain_for_share(share, tau_hat, PIECES)
    assert kappa is not None
    assert kappa > gain_for_share(share, tau_hat)
    if share > 1e-6:
        # kappa is rounded to 1e-16, which is v = 2 kappa - 1 - 3 tau_hat to 1e-16/v, v about 4 share tau_hat^2
        assume(share * tau_hat**2 > 1e-9)
        found = device_share(kappa * (1.0 + 1e-15), tau_hat).share
        assert found == pytest.approx(share, rel=1e-5)
    with pytest.raises(ValueError, match="expected more than"):
        device_share(gain_for_share(0.0, tau_hat, PIECES) * (1.0 - 1e-12), tau_hat)


@given(DELAYS)
def test_the_ends_of_the_curve(tau_hat: float) -> None:
    assert gain_for_share(0.0, tau_hat) == pytest.approx(least_gain(tau_hat), rel=1e-15)
    assert gain_for_share(min(1.0, greatest_share(tau_hat) * 1.0001), tau_hat) is None or tau_hat == 0.0
    best = 0.5 + 2.5 * tau_hat
    assume(tau_hat > 1e-9)  # without a delay the greatest share is only approached
    assert limit_share(best, tau_hat).share == pytest.approx(greatest_share(tau_hat), rel=1e-6)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: device_share(0.9, 1.5), "tau/T: found 1.5"),
        (lambda: device_share(0.9, float("nan")), "tau/T: found nan"),
        (lambda: device_share(float("inf"), 0.1), "kappa: found inf"),
        (lambda: device_share(0.65, 0.1), r"expected more than 1/2 \+ 3/2 tau/T = 0.65"),
        (lambda: device_share(0.4, 0.0), "expected more than"),
        (lambda: device_share(0.6, 0.1), "expected more than"),
        (lambda: device_share(0.9, 0.1, pieces=0), "pieces: found 0"),
        (lambda: gain_for_share(0.1, 0.1, pieces=0), "pieces: found 0"),
        (lambda: gain_for_share(-0.1, 0.1), "share: found -0.1"),
        (lambda: gain_for_share(1.1, 0.1), "share: found 1.1"),
        (lambda: least_gain(-0.1), "tau/T: found -0.1"),
        (lambda: greatest_share(2.0), "tau/T: found 2.0"),
        (lambda: greatest_share(0.0, -0.1), "period tolerance: found -0.1"),
        (lambda: device_share(0.9, 0.1, period_tolerance=1.1), "period tolerance: found 1.1"),
        (lambda: device_share(0.6, 0.0, period_tolerance=0.25), r"expected more than 1.25/2 \+ 3/2 tau/T = 0.625"),
    ],
)
def test_what_is_refused(call, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()


# --- devices


def ledger_form(
    mass: float, b: float, spring: float, T: float, delays: Matrix, kappa: float, share: float, periods: Matrix
) -> Matrix:
    """Q with f^T Q f = sum_k T (f_k y_k - share b y_k^2) for forces f_0 ... f_{N-1} on a device from rest.

    mass x'' + b x' + spring x = force; f_k acts from delays[k] after sample k on, and periods[k] later is sample k + 1.
    """
    N = len(delays)
    A = np.array([[0.0, 1.0], [-spring / mass, -b / mass]])
    augmented = np.zeros((3, 3))
    augmented[:2, :2], augmented[1, 2] = A, 1.0 / mass
    state = np.zeros((2, N))  # (x, x') as a linear map of f
    step = np.eye(N)
    x, force = [state[0].copy()], [np.zeros(N), *step]
    for k in range(N - 1):
        for span, acting in ((delays[k], force[k]), (periods[k] - delays[k], force[k + 1])):
            E = expm(augmented * span)
            state = E[:2, :2] @ state + np.outer(E[:2, 2], acting)
        x.append(state[0].copy())
    K = kappa * T / b
    Q = np.zeros((N, N))
    for k in range(N):
        moved = x[k] - x[k - 1] if k else x[0]
        y = (moved + K * (force[k + 1] - force[k])) / T
        Q += T * (np.outer(force[k + 1], y) - share * b * np.outer(y, y))
    return (Q + Q.T) / 2.0


@st.composite
def held_devices(draw: st.DrawFn) -> tuple[float, float, float, float]:
    """Mass (kg), damping (N*s/m), spring (N/m) and period (s)."""
    b, T = draw(st.floats(0.1, 10.0)), draw(st.sampled_from([2.5e-4, 1e-3, 4e-3]))
    # time constants from far below a tick to far above, natural frequencies up to near the sampling frequency
    return b * T * 10.0 ** draw(st.floats(-2.0, 3.0)), b, b / T * 10.0 ** draw(st.floats(-4.0, 1.0)), T


@given(held_devices(), DELAYS, TOLERANCES, ABOVE, st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_a_late_device_keeps_its_share_against_every_force(
    device: tuple[float, float, float, float], tau_hat: float, rho: float, above: float, seed: int
) -> None:
    """From rest the ledger is never negative, whatever the forces: its quadratic form is positive semidefinite.

    Delays are up to tau, periods from the delay itself up to (1 + rho) T.
    """
    mass, b, spring, T = device
    rng = np.random.default_rng(seed)
    N = 24

    def parts(kind: int) -> Matrix:
        return {0: rng.uniform(size=N), 1: rng.integers(0, 2, N).astype(float), 2: np.ones(N)}[kind]

    delays = parts(seed % 3) * tau_hat * T
    periods = delays + parts(seed // 3 % 3) * ((1.0 + rho) * T - delays)
    kappa = least_gain(tau_hat, rho) + above
    share = device_share(kappa, tau_hat, period_tolerance=rho).share
    Q = ledger_form(mass, b, spring, T, delays, kappa, share, periods)
    for ticks in (1, 2, 5, N):
        values = np.linalg.eigvalsh(Q[:ticks, :ticks])  # the forces after these ticks do not act on them
        assert values[0] >= -1e-11 * np.max(np.abs(Q))  # 24 x 24 sums, each with rounding of 1e-16


def test_the_undelayed_claim_fails_behind_a_delay() -> None:
    """A device with little mass moves while the old force still acts."""
    T, b, tau_hat = 1e-3, 1.37, 0.5
    Q = ledger_form(b * T * 0.01, b, 0.0, T, np.full(24, tau_hat * T), 0.5, 1.0, np.full(24, T))
    assert np.linalg.eigvalsh(Q)[0] < -1e-3 * np.max(np.abs(Q))


Claim = tuple[float, float, float]
"""Kappa, share and c."""


def storage_form(device: tuple[float, float, float, float], delay: float, period: float, claim: Claim) -> Matrix:
    """The ledger's growth in one period less the storage's, a form in (x, v) at its sample and three forces.

    The form is of (x, v, f_{k-2}, f_{k-1}, f_k), with the mechanical energy, K f^2/2 and c (T/b) g^2 as the storage.
    Its coordinates are scaled to the size of what is subtracted, of which a millionth is 1.
    """
    mass, b, spring, T = device
    kappa, share, c = claim
    augmented = np.zeros((3, 3))
    augmented[0, 1], augmented[1] = 1.0, np.array([-spring, -b, 1.0]) / mass
    state, before, last, force = np.split(np.eye(5), [2, 3, 4])
    after = state
    for span, acting in ((delay, before), (period - delay, last)):
        E = expm(augmented * span)
        after = E[:2, :2] @ after + np.outer(E[:2, 2], acting)
    K, new, old = kappa * T / b, force - last, last - before
    y = (after[:1] - state[:1] + K * new) / T
    supply = T * (force.T @ y - share * b * y.T @ y)
    energy = np.diag([spring, mass]) / 2.0
    stored = after.T @ energy @ after + K / 2.0 * force.T @ force + c * T / b * new.T @ new
    there = state.T @ energy @ state + K / 2.0 * last.T @ last + c * T / b * old.T @ old
    out = (supply + supply.T) / 2.0 - stored + there
    size = np.sqrt(np.abs(np.diag(out)) + 1e-6 * np.diag(stored + there))
    size[size == 0.0] = 1.0  # a force that has no effect
    return out / np.outer(size, size)


def claim_of(kappa: float, tau_hat: float, rho: float) -> Claim:
    found = device_share(kappa, tau_hat, period_tolerance=rho)
    return kappa, found.share, found.c


@given(held_devices(), DELAYS, TOLERANCES, ABOVE, st.lists(st.tuples(DELAYS, DELAYS), min_size=1, max_size=6))
def test_a_period_stores_no_more_than_the_ledger_grows(
    device: tuple[float, float, float, float],
    tau_hat: float,
    rho: float,
    above: float,
    timings: list[tuple[float, float]],
) -> None:
    """From every state and for every force, at every delay up to tau and period up to (1 + rho) T."""
    T, claim = device[3], claim_of(least_gain(tau_hat, rho) + above, tau_hat, rho)
    for late, long in [*timings, (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)]:
        delay = late * tau_hat * T
        period = delay + long * ((1.0 + rho) * T - delay)
        assert np.linalg.eigvalsh(storage_form(device, delay, period, claim))[0] >= -1e-8


@given(DELAYS, TOLERANCES)
def test_a_longer_period_than_is_covered_breaks_the_claim(tau_hat: float, rho: float) -> None:
    """The share that is claimed is the greatest: in a period of 1.01 (1 + rho) T some motion contradicts it.

    The motion is the slowest that takes the device from sample to sample, under a force that changes once.
    """
    kappa = least_gain(tau_hat, rho) + 1e-3 + tau_hat  # the greatest share, with room above the least gain
    _, share, c = claim_of(kappa, tau_hat, rho)
    for longer, holds in ((1.0, True), (1.01, False)):
        stretch = longer * (1.0 + rho)
        out = np.array(
            [
                [1.0 / stretch - share, 0.5 - share * kappa, tau_hat / (2.0 * stretch)],
                [0.5 - share * kappa, kappa / 2.0 - c - share * kappa**2, 0.0],
                [tau_hat / (2.0 * stretch), 0.0, c - tau_hat * (stretch - tau_hat) / (4.0 * stretch)],
            ]
        )
        assert (np.linalg.eigvalsh(out)[0] >= -1e-9) == holds


def test_longer_periods_than_are_covered_drain_a_ledger() -> None:
    """In time: a mass on a damper, without delay, from rest; covered up to 1.1 T, it keeps its share, at 1.2 T not."""
    T, b, rho = 1e-3, 1.37, 0.1
    kappa, share, _ = claim_of(least_gain(0.0, rho) * (1.0 + 1e-12), 0.0, rho)
    least = {}
    for stretch in (1.0, 1.1, 1.2):
        Q = ledger_form(10.0 * b * T, b, 0.0, T, np.zeros(48), kappa, share, np.full(48, stretch * T))
        least[stretch] = np.linalg.eigvalsh(Q)[0] / np.max(np.abs(Q))
    assert least[1.0] >= -1e-11
    assert least[1.1] >= -1e-11
    assert least[1.2] < -1e-3


@given(DELAYS, TOLERANCES, ABOVE)
def test_a_tolerance_scales_the_claim(tau_hat: float, rho: float, above: float) -> None:
    """(kappa, share, c, tau) holds up to lambda T exactly if (kappa/lambda, lambda share, c/lambda) does up to T."""
    stretch = 1 + Fraction(rho)
    kappa = least_gain(tau_hat, rho) + above
    found = device_share(kappa, tau_hat, period_tolerance=rho)
    scaled = limit_share(float(kappa / stretch), float(tau_hat / stretch))
    assert found.share * float(stretch) < scaled.share
    assert proved(kappa, found, tau_hat, rho)
    assert not proved(kappa, Share(scaled.share / float(stretch) * (1.0 + 1e-6), found.c), tau_hat, rho)
    assert greatest_share(tau_hat, rho) == pytest.approx(1.0 / float(stretch + 8 * Fraction(tau_hat)), rel=1e-15)
    wanted = 0.9 * greatest_share(tau_hat, rho)
    gain = gain_for_share(wanted, tau_hat, PIECES, rho)
    assert gain is not None
    assert device_share(gain * (1.0 + 1e-12), tau_hat, period_tolerance=rho).share >= wanted * (1.0 - 1e-6)


def needed_gain(mass: float, tau_hat: float, stretch: float = 1.0) -> float:
    """The least kappa that makes G_hat of a mass with damping passive behind a constant delay; T = b = 1.

    Re (1 - 1/z)(G + kappa) >= 0 for z on the unit circle, G exact for forces held between kT + tau and (k+1)T + tau,
    with a period of ``stretch`` instead of T.
    """
    augmented = np.array([[0.0, 1.0, 0.0], [0.0, -1.0 / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
    first, second = expm(augmented * tau_hat), expm(augmented * (stretch - tau_hat))
    A = second[:2, :2] @ first[:2, :2]
    old, new = second[:2, :2] @ first[:2, 2], second[:2, 2]
    worst = -np.inf
    for z in np.exp(1j * np.pi * np.logspace(-3.0, 0.0, 400)):
        G = np.linalg.solve(z * np.eye(2) - A, old / z + new)[0]
        difference = 1.0 - 1.0 / z
        worst = max(worst, -(difference * G).real / difference.real)
    return float(worst)


@pytest.mark.parametrize("tau_hat", [0.0, 0.1, 0.25, 0.5, 0.75, 1.0])
def test_the_least_gain_is_near_what_a_heavy_mass_needs(tau_hat: float) -> None:
    """(1 + tau_hat)^2/2 is needed, 1/2 + 3/2 tau_hat suffices: the same without a delay and with a whole tick."""
    needed = needed_gain(1e4, tau_hat)
    assert needed == pytest.approx((1.0 + tau_hat) ** 2 / 2.0, rel=1e-3)  # a mass of 1e4 is not infinite
    assert needed <= least_gain(tau_hat) <= needed * 1.13  # their greatest ratio is 9/8, at tau_hat = 1/3
    assert needed_gain(1.0, tau_hat) <= least_gain(tau_hat)


@pytest.mark.parametrize("tau_hat", [0.0, 0.25, 1.0])
@pytest.mark.parametrize("rho", [0.1, 0.5, 1.0])
def test_a_longer_period_needs_its_gain(tau_hat: float, rho: float) -> None:
    """A constant period of lambda T needs (lambda + tau_hat)^2/(2 lambda); lambda/2 + 3/2 tau_hat suffices."""
    needed = needed_gain(1e4, tau_hat, 1.0 + rho)
    assert needed == pytest.approx((1.0 + rho + tau_hat) ** 2 / (2.0 * (1.0 + rho)), rel=1e-3)
    assert needed <= least_gain(tau_hat, rho) <= needed * 1.13
