"""Slopes over a box: every value of every expression is where its middle and its slopes say, and in its ball."""

from __future__ import annotations

import pytest
from flint import arb, ctx
from hypothesis import assume, given
from hypothesis import strategies as st

from manyhands.design.proof.jets import Jet

Number = Jet | arb

UNARY = {
    "minus": lambda x: -x,
    "square": lambda x: x * x,
    "inverse": lambda x: x.inverse() if isinstance(x, Jet) else 1 / x,
    "root": lambda x: x.sqrt(),
    "cos": lambda x: x.cos(),
    "sin": lambda x: x.sin(),
    "half more": lambda x: x + arb("0.5"),
    "a third of": lambda x: x / arb(3),
    "twice less 1": lambda x: arb(2) * x - arb(1),
}
BINARY = {
    "+": lambda x, y: x + y,
    "-": lambda x, y: x - y,
    "*": lambda x, y: x * y,
    "/": lambda x, y: x / y,
}

expressions = st.recursive(
    st.sampled_from([0, 1]),
    lambda of: st.one_of(
        st.tuples(st.sampled_from(sorted(UNARY)), of), st.tuples(st.sampled_from(sorted(BINARY)), of, of)
    ),
    max_leaves=8,
)


def value(expression: object, at: list[Number]) -> Number:
    if isinstance(expression, int):
        return at[expression]
    name, *parts = expression  # type: ignore[misc]
    values = [value(part, at) for part in parts]
    return UNARY[name](*values) if len(values) == 1 else BINARY[name](*values)


@given(
    expressions,
    st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)),
    st.tuples(st.floats(0.0, 0.5), st.floats(0.0, 0.5)),
    st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
)
def test_every_value_over_the_box_is_where_the_slopes_say(
    expression: object, middle: tuple[float, float], half: tuple[float, float], place: tuple[float, float]
) -> None:
    jets = Jet.arguments([arb(at, by) for at, by in zip(middle, half, strict=True)])
    try:
        found = value(expression, list(jets))
    except ZeroDivisionError:
        assume(False)
    steps = [arb(by) * arb(share) for by, share in zip(half, place, strict=True)]
    true = value(expression, [jet.middle + step for jet, step in zip(jets, steps, strict=True)])
    assert found.value.overlaps(true)
    assert (found.middle + sum((s * d for s, d in zip(found.slopes, steps, strict=True)), arb(0))).overlaps(true)


@pytest.mark.parametrize("name", UNARY)
def test_each_function_has_its_slopes_up_to_the_ends_of_a_wide_box(name: str) -> None:
    middle, half = arb(1), 0.75
    (x,) = Jet.arguments([arb(middle, half)])
    found = UNARY[name](x)
    for share in (-1.0, -0.5, 0.5, 1.0):
        step = arb(share * half)
        true = UNARY[name](middle + step)
        assert found.value.overlaps(true)
        assert found.slopes[0].overlaps((true - UNARY[name](middle)) / step)


def test_what_is_added_to_the_range_falls_with_the_square_of_the_width() -> None:
    def excess(half: float) -> float:
        (x,) = Jet.arguments([arb(1, half)])
        jet = x * x / (x + arb(1)) - x.cos() * x  # balls alone would add as much as half
        ends = [(1 + d) ** 2 / (2 + d) - arb(1 + d).cos() * (1 + d) for d in (-half, half)]  # it rises
        return float(2 * jet.value.rad() - (ends[1] - ends[0]))

    assert 0.0 < excess(0.01) < 0.02 * excess(0.1)


def test_a_root_or_an_inverse_that_may_not_be_is_refused() -> None:
    (x,) = Jet.arguments([arb(0, 1)])
    for operation in (x.sqrt, x.inverse):
        with pytest.raises(ZeroDivisionError):
            operation()


def test_a_single_value_has_no_width() -> None:
    (x,) = Jet.arguments([arb(2)])
    assert (x * x - x).value.rad() <= 2.0 ** (2 - ctx.prec)
