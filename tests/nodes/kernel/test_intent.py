"""Intended forces and motions: which formulas are allowed, their values, and traces."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.nodes.kernel.intent import (
    MAX_FORMULA_DEPTH,
    MAX_FORMULA_LENGTH,
    Constant,
    Formula,
    FormulaError,
    IntentError,
    SampledSignal,
    intent_from,
)

from ...support.cases import cases


@pytest.mark.parametrize(
    ("text", "t", "value"),
    [
        ("2*pulse(t, 0.1, 0.2)", 0.1, 2.0),
        ("2*pulse(t, 0.1, 0.2)", 0.2, 0.0),
        ("-1.5*pulse(t, 0.15, 0.25)", 0.15, -1.5),
        ("step(t - 1)", 1.0, 1.0),
        ("step(t - 1)", 0.999, 0.0),
        ("sin(2*pi*t)", 0.25, 1.0),
        ("2**-1 + t", 1.0, 1.5),
        ("-t**2", 3.0, -9.0),
        ("+t - -t", 3.0, 6.0),
        ("7 - 2 - 1", 0.0, 4.0),
        ("1/4/2", 0.0, 0.125),
        ("1 if t < 1 else 2", 0.5, 1.0),
        ("1 if t < 1 else 2", 1.0, 2.0),
        ("0 if t == 0 else 1/t", 0.0, 0.0),
        ("1 < t <= 2", 2.0, 1.0),
        ("1 < t <= 2", 1.0, 0.0),
        ("3*(t != 1)", 1.0, 0.0),
        ("t >= 1 and t < 2", 1.5, 1.0),
        ("t < 1 or t > 2", 1.5, 0.0),
        ("t > 0 and 1/t > 1", 0.0, 0.0),
        ("not t", 0.0, 1.0),
        ("min(3, t, 2) + max(1, t)", 5.0, 7.0),
        ("floor(-t)", 1.5, -2.0),
        ("abs(-t) + sqrt(4) + exp(0) + cos(0) + tan(0)", 1.0, 5.0),
        ("  1 +\n\t t ", 1.0, 2.0),
        ("9**9**0.5", 0.0, 729.0),
    ],
)
def test_formulas(text: str, t: float, value: float) -> None:
    found = Formula(text)(t)
    assert type(found) is float
    assert found == pytest.approx(value, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "problem", "position"),
    [
        ("", "no formula", None),
        ("2*x", "the unknown name 'x'", 3),
        ("  2*x", "the unknown name 'x'", 5),
        ("2*(t", "not a formula", 3),
        ("t t", "not a formula", None),
        ("t = 1", "not a formula", None),
        ("1if t else 2", "not a formula", None),
        ("t.real", "attribute is not allowed", 1),
        ("1 + [t][0]", "subscript is not allowed", 5),
        ("lambda: t", "lambda is not allowed", 1),
        ("(t for t in t)", "generatorexp is not allowed", 1),
        ("(x := t)", "namedexpr is not allowed", 2),
        ("'a'", "'a' is not a real number", 1),
        ("2j", "2j is not a real number", 1),
        ("True", "True is not a real number", 1),
        ("1e999", "a number too large", 1),
        ("1" + "0" * 400, "a number too large", 1),
        ("t % 2", "the operator mod is not allowed", 1),
        ("t // 2", "the operator floordiv is not allowed", 1),
        ("~t", "the operator invert is not allowed", 1),
        ("t is t", "the comparison is is not allowed", 1),
        ("t in (1, 2)", "the comparison in is not allowed", 1),
        ("eval(t)", "the unknown function 'eval'", 1),
        ("__import__('os')", "the unknown function '__import__'", 1),
        ("sin.__call__(t)", "the unknown function 'sin.__call__'", 1),
        ("t(1)", "the unknown function 't'", 1),
        ("sin", "the unknown name 'sin'", 1),
        ("sin(t, 1)", "sin takes 1 plain arguments", 1),
        ("pulse(t, 1)", "pulse takes 3 plain arguments", 1),
        ("max(t)", "max takes 2 to 16 plain arguments", 1),
        ("max(t, key=t)", "max takes 2 to 16 plain arguments", 1),
        ("min(*t, t)", "starred is not allowed", 5),
        ("t**1000", "an exponent beyond 100", 4),
        ("t**-1000", "an exponent beyond 100", 4),
        ("9**9**9**9**999", "an exponent beyond 100", 13),
        ("t + µ", "the character 'µ'", 5),
        ("t\0", "the character '\\x00'", 2),
    ],
)
def test_formulas_that_are_not_allowed(text: str, problem: str, position: int | None) -> None:
    with pytest.raises(FormulaError) as caught:
        Formula(text)
    error = caught.value
    assert problem in error.problem
    if position is not None:
        assert error.position == position
        assert f"at position {position}" in str(error)
    assert "pulse(t, a, b)" in str(error)  # every error lists what is allowed


def test_formulas_are_bounded() -> None:
    assert Formula("t" + " " * (MAX_FORMULA_LENGTH - 1))(1.0) == 1.0
    with pytest.raises(FormulaError, match="501 characters"):
        Formula("t" + " " * MAX_FORMULA_LENGTH)
    assert Formula("-" * (MAX_FORMULA_DEPTH - 1) + "t")(1.0) == -1.0
    for deep in (
        "-" * MAX_FORMULA_DEPTH + "t",
        "-" * 499 + "t",
        "(" * 249 + "t" + ")" * 249,
        "1+" * 249 + "1",
        "(" * 500,
    ):
        with pytest.raises(FormulaError):
            Formula(deep)


@pytest.mark.parametrize(
    ("text", "t", "problem"),
    [
        ("1/t", 0.0, "division by zero at t = 0.0 s"),
        ("0**-t", 1.0, "no real value at t = 1.0 s"),
        ("exp(t)", 1e3, "a number too large at t = 1000.0 s"),
        ("10**t", 400.0, "a number too large at t = 400.0 s"),
        ("1e308*t", 10.0, "no finite value at t = 10.0 s"),
        ("1e308*t - 1e308*t", 10.0, "no finite value at t = 10.0 s"),
        ("floor(1e308*t)", 10.0, "a number too large at t = 10.0 s"),
        ("sqrt(-t)", 1.0, "no real value at t = 1.0 s"),
        ("(-t)**0.5", 1.0, "no real value at t = 1.0 s"),
    ],
)
def test_values_that_are_none_name_their_time(text: str, t: float, problem: str) -> None:
    formula = Formula(text)
    with pytest.raises(FormulaError) as caught:
        formula(t)
    assert caught.value.problem == problem


characters = st.sampled_from("t10+-*/(),<.[=:'\\\nxµ#{")
words = st.sampled_from(
    ["pi", "2.5", "1e300", "**", "==", " if ", " else ", " and ", " not ", "sin(", "exp(", "floor(", "pulse(", "min("]
)
pieces = characters | words


@settings(deadline=None, max_examples=cases(100, 400))
@given(text=st.lists(pieces, max_size=12).map("".join) | st.text(max_size=20), t=st.floats(0.0, 100.0))
def test_any_text_gives_a_finite_number_or_a_formula_error(text: str, t: float) -> None:
    try:
        value = Formula(text)(t)
    except FormulaError:
        return
    assert type(value) is float
    assert math.isfinite(value)


@settings(deadline=None, max_examples=cases(50, 100))
@given(a=st.floats(-1e6, 1e6), b=st.floats(-1e6, 1e6), t=st.floats(0.0, 100.0))
def test_formulas_agree_with_floating_point_arithmetic(a: float, b: float, t: float) -> None:
    assert Formula(f"({a!r})*t - ({b!r})")(t) == a * t - b
    assert Formula(f"({a!r}) if t <= ({b!r}) else max(t, {a!r})")(t) == (a if t <= b else max(t, a))


def test_a_trace_is_linear_and_holds_its_last_value() -> None:
    trace = SampledSignal([0.0, 1.0, 3.0], [0.0, 2.0, -2.0])
    assert [trace(t) for t in (-1.0, 0.0, 0.25, 1.0, 2.0, 3.0, 99.0)] == [0.0, 0.0, 0.5, 2.0, 0.0, -2.0, -2.0]
    assert type(trace(0.25)) is float
    assert SampledSignal([0.0], [7.0])(5.0) == 7.0


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [
        ([], [], "0 samples"),
        ([0.0, 1.0], [0.0], "2 times and 1 values"),
        ([0.1, 1.0], [0.0, 1.0], "the first time is 0.1 s; expected 0"),
        ([0.0, 1.0, 1.0], [0.0, 1.0, 2.0], "sample 3 is at 1 s, after 1 s"),
        ([0.0, 1.0, 0.5], [0.0, 1.0, 2.0], "sample 3 is at 0.5 s, after 1 s"),
        ([0.0, math.inf], [0.0, 1.0], "sample 2 is not finite"),
        ([0.0, 1.0], [math.nan, 1.0], "sample 1 is not finite"),
    ],
)
def test_traces_that_are_none(times: list[float], values: list[float], message: str) -> None:
    with pytest.raises(IntentError, match=message):
        SampledSignal(times, values)


def test_a_trace_keeps_its_own_numbers() -> None:
    values = np.array([0.0, 2.0])
    trace = SampledSignal([0.0, 1.0], values)  # type: ignore[arg-type]  # an array is what might be shared
    values[1] = 100.0
    assert trace(1.0) == 2.0


def test_every_form_of_intent() -> None:
    assert intent_from(2)(9.0) == 2.0
    assert intent_from(-0.5)(9.0) == -0.5
    assert intent_from("2*t")(9.0) == 18.0
    assert intent_from({"times": [0.0, 2.0], "values": [0.0, 1.0]})(1.0) == 0.5


@pytest.mark.parametrize("data", [True, None, [1.0], {}, {"times": [0.0]}, {"trace": "file.csv"}, math.nan, math.inf])
def test_what_is_no_intent(data: Any) -> None:
    with pytest.raises(IntentError):
        intent_from(data)
    if isinstance(data, float):
        with pytest.raises(IntentError):
            Constant(data)
