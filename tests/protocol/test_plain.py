"""Data classes and plain data: exact both ways, and whatever else stands there is refused by its place."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any, TypeAlias, TypeVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from manyhands.protocol.plain import Added, PlainForm, Requirement, Unfit, by_kind, form_of, read, written


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Ball:
    radius: float

    def __post_init__(self) -> None:
        if self.radius < 0.0:
            raise ValueError(f"found the radius {self.radius}; expected at least 0")


@dataclass(frozen=True)
class Box:
    sides: tuple[float, float]


Thing: TypeAlias = Annotated[Ball | Box, by_kind(ball=Ball, box=Box)]


@dataclass(frozen=True)
class Whole:
    name: str
    count: Annotated[int, Requirement(lambda count: 0 < count < 10, "1 to 9")]
    flag: bool
    colour: Colour
    amount: float
    limit: float | None
    names: tuple[str, ...]
    by_name: Mapping[str, tuple[float, ...]]
    thing: Thing
    parameters: Mapping[str, Any]
    text: Annotated[bytes, PlainForm(bytes.decode, str.encode)]
    later: Annotated[Added[float], Requirement(math.isfinite, "a number")] = 1.5
    balls: tuple[Ball, ...] = field(default=())


@dataclass(frozen=True, eq=False)
class Matrices:
    M: NDArray[np.float64]
    N: NDArray[np.float64] | None = None


WHOLE = Whole(
    "n",
    3,
    True,
    Colour.BLUE,
    0.1,
    None,
    ("a", "b"),
    {"x": (1.0, 2.0)},
    Box((1.0, 2.0)),
    {"k": [1]},
    b"t",
    2.5,
    (Ball(1.0),),
)
PLAIN = {
    "name": "n", "count": 3, "flag": True, "colour": "blue", "amount": 0.1, "limit": None, "names": ["a", "b"],
    "by_name": {"x": [1.0, 2.0]}, "thing": {"kind": "box", "sides": [1.0, 2.0]}, "parameters": {"k": [1]}, "text": "t",
    "later": 2.5, "balls": [{"radius": 1.0}],
}  # fmt: skip


def test_fields_are_written_in_their_order_and_read_back() -> None:
    assert json.dumps(written(WHOLE)) == json.dumps(PLAIN)
    assert read(Whole, PLAIN) == WHOLE
    assert read(Whole, {key: value for key, value in PLAIN.items() if key != "later"}).later == 1.5


@given(st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**53), 2**53))
def test_numbers_are_exact_and_floats(number: float) -> None:
    found = read(Ball, json.loads(json.dumps({"radius": abs(number)}))).radius
    assert (type(found), found) == (float, abs(number))


@given(st.lists(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=2)))
def test_matrices_keep_shape_and_every_bit_and_are_read_only(rows: list[list[float]]) -> None:
    M = np.array(rows).reshape(-1, 2)
    found = read(Matrices, json.loads(json.dumps(written(Matrices(M)))))
    assert (found.M.shape, found.M.tobytes(), found.N) == (M.shape, M.tobytes(), None)
    assert not found.M.flags.writeable


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "a text in place of an object": ({"by_name": "x"}, "by_name: found 'x'; expected an object"),
    "a number as a text": ({"name": 3}, "name: found 3; expected a text"),
    "a flag as a number": ({"count": True}, "count: found True; expected a whole number"),
    "a number as a flag": ({"flag": 1}, "flag: found 1; expected true or false"),
    "beyond the requirement": ({"count": 10}, "count: found 10; expected 1 to 9"),
    "no member": ({"colour": "green"}, "colour: found 'green'; expected one of red, blue"),
    "a member in a list": ({"colour": ["red"]}, "colour: found ['red']; expected a text"),
    "not a number": ({"amount": math.nan}, "amount: found nan; expected a finite number"),
    "infinite": ({"by_name": {"a b": [0.0, math.inf]}}, "by_name['a b'][1]: found inf; expected a finite number"),
    "beyond all floats": ({"limit": 10**400}, f"limit: found 1{'0' * 119}; expected a finite number"),
    "a long text": ({"amount": "x" * 50}, "amount: found str of length 50; expected a finite number"),
    "an object in place of a list": ({"names": {}}, "names: found {}; expected a list"),
    "three sides": ({"thing": {"kind": "box", "sides": [1.0] * 3}}, "thing.sides: found 3 entries; expected 2"),
    "no kind": ({"thing": {"sides": [1.0, 2.0]}}, "thing.kind: found None; expected one of ball, box"),
    "an unknown kind": ({"thing": {"kind": ["box"]}}, "thing.kind: found ['box']; expected one of ball, box"),
    "what the class refuses": ({"balls": [{"radius": -1}]}, "balls[0]: found the radius -1.0; expected at least 0"),
    "a key too few": ({"balls": [{}]}, "balls[0]: found no radius; expected radius"),
    "a key too many": ({"balls": [{"radius": 1, "r": 1}]}, "balls[0]: found the unknown key 'r'; expected radius"),
    "what another form cannot use": ({"text": 3}, "text: "),
}


@pytest.mark.parametrize(("change", "text"), REFUSED.values(), ids=REFUSED)
def test_what_is_wrong_is_named_with_its_place(change: dict[str, Any], text: str) -> None:
    with pytest.raises(Unfit) as caught:
        read(Whole, {**PLAIN, **change})
    assert str(caught.value).startswith(text)


@pytest.mark.parametrize(
    ("matrix", "text"),
    [
        ({"shape": [2, 2], "entries": [1.0]}, "M: found 1 entries; expected 2 x 2"),
        ({"shape": [-1, -1], "entries": [1.0]}, "M: found 1 entries; expected -1 x -1"),
        ({"shape": [1], "entries": [1.0]}, "M.shape: found 1 entries; expected 2"),
        ({"shape": [1, 1], "entries": ["1"]}, "M.entries[0]: found '1'; expected a finite number"),
        ({"shape": [1, 1], "entries": [None]}, "M.entries[0]: found None; expected a finite number"),
        ([[1.0]], "M: found [[1.0]]; expected an object"),
    ],
)
def test_what_is_no_matrix_is_refused(matrix: Any, text: str) -> None:
    with pytest.raises(Unfit) as caught:
        read(Matrices, {"M": matrix, "N": None})
    assert str(caught.value) == text


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats()
        | st.text(max_size=3)
        | st.sampled_from(["ball", "box"]),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from([*PLAIN, "kind", "radius", "sides", "?"]), inner, max_size=4)
        ),
        max_leaves=8,
    ),
    st.sampled_from([*PLAIN, None]),
)
def test_whatever_comes_it_is_read_or_refused(data: Any, key: str | None) -> None:
    try:
        whole = read(Whole, data if key is None else {**PLAIN, key: data})
    except Unfit:
        return
    assert written(read(Whole, written(whole))) == written(whole)


@pytest.mark.parametrize("annotation", [int | str, set[int], complex, list[int]])
def test_what_has_no_form_is_said_at_once(annotation: Any) -> None:
    with pytest.raises(TypeError, match="expected one that has a form in plain data"):
        form_of(annotation)


def test_a_matrix_under_the_name_of_a_type_statement_is_a_matrix() -> None:
    """As numpy 2.5 states NDArray, where Python has such statements: 3.12 and later."""
    scalar = TypeVar("scalar", bound=np.generic)
    shape = tuple[int, ...]
    named = TypeAliasType("named", np.ndarray[shape, np.dtype[scalar]], type_params=(scalar,))
    M = np.array([[1.0, 2.0], [3.0, 4.0]])
    for annotation in (named[np.float64], named):
        form = form_of(annotation)
        assert np.array_equal(form.read(form.write(M)), M)
