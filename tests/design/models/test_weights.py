"""Weights: the backward-Euler form of a filter, the meaning of a band, and the errors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.weights import MOST_DEGREE, Filter

ANGLES = np.linspace(0.0, np.pi, 50)
Z = np.exp(1j * ANGLES)


@given(st.lists(st.floats(1.0, 500.0), max_size=2), st.floats(-3.0, 3.0), st.sampled_from([2.5e-4, 1e-3, 1e-2]))
def test_backward_euler_is_the_continuous_filter_at_s(corners: list[float], gain: float, T: float) -> None:
    den = tuple(float(c) for c in np.atleast_1d(np.poly([-c for c in corners])))
    num = (gain, 7.0)[: len(den)]
    s = (Z - 1.0) / (T * Z)
    w = Filter.from_continuous(num, den, T)
    # two poles of 1 rad/s at 0.25 ms: (w T)^2 = 6e-8, of which rounding takes 1e-16
    np.testing.assert_allclose(w.response(Z), np.polyval(num, s) / np.polyval(den, s), rtol=1e-7)


@given(st.lists(st.floats(-0.95, 0.95), min_size=0, max_size=4), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_the_realisation_is_the_filter_at_every_port(poles: list[float], ports: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    w = Filter(tuple(rng.normal(size=rng.integers(1, len(poles) + 2))), tuple(3.0 * np.atleast_1d(np.poly(poles))))
    system = w.realisation(ports)
    assert system.order == len(poles) * ports
    for z in Z[::10]:
        np.testing.assert_allclose(system.response(z), w.response(np.array(z)) * np.eye(ports), rtol=1e-7, atol=1e-9)


def test_example_2_emphasises_0_to_20_hertz() -> None:
    """125 rad/s is 19.9 Hz."""
    paper = Filter.from_continuous((1.0,), (1.0 / 125.0, 1.0), 1e-3)
    band = Filter.emphasise(0.0, 125.0 / (2.0 * np.pi), 1e-3)
    np.testing.assert_allclose(band.response(Z), paper.response(Z), rtol=1e-12)
    assert abs(paper.response(np.array(1.0 + 0j)) - 1.0) < 1e-12


def test_a_band_is_flat_inside_and_falls_on_both_sides() -> None:
    T = 1e-4
    w = Filter.emphasise(2.0, 200.0, T)
    gain = abs(w.response(np.exp(2j * np.pi * T * np.array([0.0, 0.2, 2.0, 20.0, 200.0, 2000.0]))))
    assert gain[0] < 1e-12
    np.testing.assert_allclose(gain[[1, 2, 3, 4]], [0.1, np.sqrt(0.5), 1.0, np.sqrt(0.5)], rtol=0.07)
    assert gain[5] < 0.2


@pytest.mark.parametrize(
    ("num", "den", "message"),
    [
        ((1.0,), (0.0, 0.0), "denominator: found zero"),
        ((1.0,), (), "denominator: found 0 coefficients"),
        ((1.0, 0.0), (2.0,), "numerator of degree 1 over a denominator of degree 0"),
        ((1.0,), (1.0, -1.0), "pole of modulus 1; expected a stable weight"),
        ((1.0,), (1.0, 2.0), "pole of modulus 2"),
        ((float("nan"),), (1.0,), "numerator: .* expected finite"),
        ((1.0,), (1.0,) * (MOST_DEGREE + 2), "denominator: found 18 coefficients; expected 1 to 17"),
    ],
)
def test_refused(num: tuple[float, ...], den: tuple[float, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Filter(num, den)


def test_refused_in_continuous_time() -> None:
    with pytest.raises(ValueError, match="pole of modulus"):
        Filter.from_continuous((1.0,), (1.0, 0.0), 1e-3)  # an integrator
    with pytest.raises(ValueError, match=r"found a static gain of 16\.\d+ after rounding; expected 16: several poles"):
        Filter.from_continuous((1.0,), tuple(np.poly([-0.5] * 4)), 1e-3)
    with pytest.raises(ValueError, match="period: found 0"):
        Filter.from_continuous((1.0,), (1.0,), 0.0)
    with pytest.raises(ValueError, match="found 20 to 10 Hz; expected 0 <= low < high < 500 Hz"):
        Filter.emphasise(20, 10, 1e-3)
    with pytest.raises(ValueError, match="found 0 to 600 Hz"):
        Filter.emphasise(0, 600, 1e-3)


def test_leading_zeros_do_not_count() -> None:
    w = Filter((0.0, 0.0, 2.0), (0.0, 4.0, 1.0))
    assert w == Filter((0.5,), (1.0, 0.25))
    assert Filter((0.0,), (1.0,)).num == (0.0,)
