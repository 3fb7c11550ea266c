"""Human operators: passive ones are accepted, and others refused with the frequency where they are not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.passivity.operators import RationalMatrix

ZERO = ((0.0,), (1.0,))


def scalar(num: tuple[float, ...], den: tuple[float, ...]) -> RationalMatrix:
    return RationalMatrix((((num, den),),))


def test_the_printed_operator_of_example_1_is_refused(problems) -> None:
    finding = problems.operator(0.1).passivity()
    assert not finding.passive
    assert finding.smallest == pytest.approx(-0.090, abs=5e-4)
    assert finding.frequency == pytest.approx(20.9, abs=0.05)
    assert "operator not passive at 20.9 rad/s" in finding.reason


def test_with_001_it_is_just_passive(problems) -> None:
    finding = problems.operator(0.01).passivity()
    assert finding.passive
    assert finding.smallest == pytest.approx(4.6e-5, abs=5e-7)
    assert scalar(*problems.h).passivity().smallest == pytest.approx(0.010046, abs=1e-6)
    assert not problems.operator(0.0101).passivity().passive  # it lacks 5e-5


@given(st.data())
def test_what_is_built_of_masses_springs_and_dampers_is_passive(problems, data: st.DataObject) -> None:
    H = scalar(*data.draw(problems.passive_entries()))
    assert H.passivity().passive, H.passivity().reason


@given(st.data(), st.floats(1e-3, 0.5))
def test_less_than_its_least_damping_is_not(problems, data: st.DataObject, below: float) -> None:
    num, den = data.draw(problems.passive_entries())
    least = scalar(num, den).passivity().smallest
    lowered = tuple(n - (least + below) * d for n, d in zip(num, den, strict=True))
    finding = scalar(lowered, den).passivity()
    assert not finding.passive
    assert finding.smallest == pytest.approx(-below, rel=1e-3)


@pytest.mark.parametrize("ratio", [1e-2, 1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("frequency", [20.0, 37.1])
def test_a_resonance_of_any_width_is_seen(ratio: float, frequency: float) -> None:
    """1 - 2 (2 zeta w s) / (s^2 + 2 zeta w s + w^2) is -1 at w, and +1 as soon as a few zeta w away."""
    width = 2.0 * ratio * frequency
    narrow = ((1.0, -width, frequency**2), (1.0, width, frequency**2))
    H = RationalMatrix(((narrow, ZERO), (ZERO, ((1.0,), (1.0, 3.1234)))))  # the other pole moves the grid off w
    finding = H.passivity()
    assert not finding.passive
    assert finding.frequency == pytest.approx(frequency, rel=1e-3)
    assert finding.smallest == pytest.approx(-1.0, rel=1e-3)


def test_the_unstable_is_refused_with_its_pole() -> None:
    assert "a pole at 1" in scalar((5.0,), (1.0, -1.0)).passivity().reason
    assert "give a spring as the hand's stiffness" in scalar((5.0,), (1.0, 0.0)).passivity().reason
    assert not scalar((5.0,), (1.0, 0.0)).passivity().passive


def test_a_negative_gain_far_beyond_the_poles_is_seen() -> None:
    assert not scalar((-1e-6, 1.0), (1.0, 1.0)).passivity().passive


def test_a_gain_that_joins_axes_far_beyond_the_poles_is_seen() -> None:
    """diag(1/(s+1) + d) + e off the diagonal, e just above d: not passive above some 3000 rad/s."""
    d, e = 1e-3, ((1.0001e-3,), (1.0,))
    damped = ((d, 1.0 + d), (1.0, 1.0))
    finding = RationalMatrix(((damped, e), (e, damped))).passivity()
    assert not finding.passive
    assert finding.frequency > 3000.0


def test_a_limit_below_zero_is_named_as_one() -> None:
    """(1 - s) / (1 + s) falls to -1 only as the frequency grows."""
    finding = scalar((-1.0, 1.0), (1.0, 1.0)).passivity()
    assert finding.frequency == np.inf
    assert finding.smallest == pytest.approx(-1.0, abs=1e-12)
    assert "operator not passive at high frequencies" in finding.reason


def test_axes_that_no_entry_joins_are_judged_apart(problems) -> None:
    row = lambda *entries: tuple(entries)  # noqa: E731
    H = RationalMatrix((row(problems.h, ZERO, problems.h), row(ZERO, problems.h, ZERO), row(ZERO, ZERO, problems.h)))
    parts = H.components()
    assert [part.size for part in parts] == [2, 1]
    assert parts[0].entries == ((problems.h, problems.h), ((((), (1.0,))), problems.h))
    frequencies = [part.exactly_least() for part in parts]
    assert frequencies[1] == pytest.approx(20.9, abs=0.05)


def test_what_is_too_large_for_the_exact_test_is_still_judged(problems, monkeypatch: pytest.MonkeyPatch) -> None:
    exact = problems.operator(0.1).passivity()
    monkeypatch.setattr("manyhands.design.passivity.operators._EXACT_ORDER", 1)
    assert problems.operator(0.1).exactly_least() is None
    assert problems.operator(0.1).passivity().smallest == pytest.approx(exact.smallest, rel=1e-6)


def test_coefficients_beyond_floating_point_are_left_to_the_response() -> None:
    assert scalar((1e300, 1.0), (1e-300, 1.0)).exactly_least() is None


def test_a_skew_coupling_between_axes_costs_nothing() -> None:
    """A gyrator, H - H^T, does no work."""
    unit = ((1e-3,), (1.0,))
    H = RationalMatrix(((unit, ((5.0,), (1.0,))), (((-5.0,), (1.0,)), unit)))
    assert H.passivity().passive


@given(st.data(), st.integers(1, 3))
def test_the_realisation_has_the_response(problems, data: st.DataObject, m: int) -> None:
    entry = st.one_of(problems.passive_entries(), st.just(ZERO), st.just(((0.0, 2.0), (4.0,))))
    H = RationalMatrix(tuple(tuple(data.draw(entry) for _ in range(m)) for _ in range(m)))
    system = H.realisation()
    w = np.array([0.0, 0.7, 11.0, 400.0])
    for frequency, expected in zip(w, H.response(w), strict=True):
        found = system.response(1j * frequency)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ((), "square"),
        (((ZERO, ZERO),), "square"),
        (((((1.0,), (0.0, 0.0)),),), r"entry \(1, 1\): the denominator is zero"),
        (((ZERO, ZERO), (((1.0, 0.0), (0.0, 2.0)), ZERO)), r"entry \(2, 1\): improper.*degree 1 exceeds.*0"),
    ],
)
def test_what_is_no_operator_is_refused(entries, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        RationalMatrix(entries)
