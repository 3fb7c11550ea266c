"""Matrices and rational functions of s in a session file, and the checks of their sizes.

State-space matrices are lists of rows, whose sizes must fit one another and the ports. Rational functions are given by
their coefficients; hands, environments and weights use them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import dropwhile
from typing import Annotated, Final, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from manyhands.design.errors import Infeasible
from manyhands.design.models.statespace import StateSpace
from manyhands.launch.session.errors import one_of, show
from manyhands.launch.session.fields import (
    Described,
    Items,
    Problem,
    Quantity,
    Rows,
    SessionModel,
    ValueCheck,
    each_named,
    refuse,
)
from manyhands.launch.session.forms import JsonSchema, either, mapping_of, one_key_of
from manyhands.launch.session.limits import MAX_COEFFICIENT, MAX_DEGREE, MAX_PORTS

Array: TypeAlias = npt.NDArray[np.float64]

_ENTRY: Final = Quantity("an entry: a number")
_ROWS: Final = Items("rows", MAX_PORTS, Items("entries of a row", MAX_PORTS, _ENTRY, least=0), least=0)


def _rows(value: object) -> Rows:
    rows: Rows = _ROWS(value)
    if len({len(row) for row in rows}) > 1:
        raise refuse("rows of different lengths", "rows that are all of the same length")
    return rows


MatrixRows: TypeAlias = Annotated[Rows, Described(_rows, _ROWS.json_schema)]
"""Any rectangular matrix, which may be empty."""

OptionalRows: TypeAlias = Annotated[Rows | None, Described(_rows, _ROWS.json_schema)]
"""Any rectangular matrix, or None."""


STATIC_MEANING: Final = "the static gain, m x m, as rows, in place of D, which then is what the gain leaves"


D_OR_STATIC: Final = one_key_of("D", "static")
"""The JSON schema of what :func:`one_of_two` asks for."""


def one_of_two(D: Rows | None, static: Rows | None) -> Rows:
    """D or the static gain: a system must state exactly one of them.

    Raises:
        PydanticCustomError: the system states both, or neither.
    """
    if D is None and static is None:
        raise refuse("no key 'D'", "the m x m matrix D, as rows, or static, the static gain in its place")
    if D is not None and static is not None:
        raise refuse("both 'D' and 'static'", "one of them: the other follows from it", at=("static",))
    stated = static if D is None else D
    assert stated is not None  # noqa: S101  # for the type checker: not both are None
    return stated


def size_problems(
    A: Rows, B: Rows, C: Rows, D: Rows | None, static: Rows | None, ports: int, most: int
) -> Iterator[Problem]:
    """A problem for each matrix whose size does not fit ``ports`` ports and the states of A, at most ``most``."""
    n = len(A)
    if n > most:
        yield Problem(("A",), f"{n} states", f"at most {most}")
        return
    for name, rows, height, width in (
        ("A", A, n, n),
        ("B", B, n, ports),
        ("C", C, ports, n),
        ("static", static, ports, ports) if D is None else ("D", D, ports, ports),
    ):
        assert rows is not None  # noqa: S101  # for the type checker: one_of_two has made sure of it
        found = (len(rows), len(rows[0]) if rows else width)
        if found != (height, width) and not (n == 0 and not any(rows) and name == "C"):
            size = f"{len(rows)} x {len(rows[0]) if rows else 0}"
            yield Problem((name,), f"a matrix of {size}", f"{height} x {width}, with {n} states and {ports} ports")


class StatedMatrices(Protocol):
    """The keys of a system that states D, or the static gain in its place."""

    A: Rows
    B: Rows
    C: Rows
    D: Rows | None
    static: Rows | None


def stated_system(given: StatedMatrices, what: str, *, continuous: bool) -> StateSpace:
    """The system, with D as stated, or computed from the static gain that is stated in its place.

    Args:
        given: the matrices, of sizes that fit one another.
        what: the system's name in the message.
        continuous: whether the static gain is that at s = 0 rather than at z = 1.

    Raises:
        Infeasible: a static gain is stated, but a pole at s = 0 or z = 1 permits none.
    """
    last = one_of_two(given.D, given.static)
    n, m = len(given.A), len(last)
    shapes = ((given.A, (n, n)), (given.B, (n, m)), (given.C, (m, n)), (last, (m, m)))
    A, B, C, D = (np.array(rows, dtype=np.float64).reshape(shape) for rows, shape in shapes)
    if given.static is None:
        return StateSpace(A, B, C, D)
    try:
        return StateSpace.with_static_gain(A, B, C, D, continuous=continuous)
    except ValueError as error:
        raise Infeasible(f"{what}: {error}; expected D in its place, or a spring that holds every mode") from error


COEFFICIENTS: Final = Items(
    "coefficients, the highest power of s first",
    MAX_DEGREE + 1,
    Quantity("a coefficient: a number", smallest=1.0 / MAX_COEFFICIENT, magnitude=MAX_COEFFICIENT),
)


class Rational(SessionModel):
    """A rational function of s: numerator and denominator, the highest power of s first."""

    num: tuple[float, ...]
    den: tuple[float, ...]

    @property
    def degrees(self) -> tuple[int, int]:
        """Degrees of numerator and denominator without leading zeros; the zero polynomial has degree -1."""
        return len(trimmed(self.num)) - 1, len(trimmed(self.den)) - 1

    @property
    def proper(self) -> bool:
        """Whether the degree of the numerator is at most that of the denominator."""
        num, den = self.degrees
        return num <= den


@dataclass(frozen=True, slots=True)
class Entry(ValueCheck):
    """One entry of a rational matrix: a number, or ``{num: [...], den: [...]}``.

    Attributes:
        unit: unit of an entry that is a plain number.
    """

    unit: str

    @property
    def _gain(self) -> Quantity:
        # a number may be as small as a coefficient: sessions are written back with num and den
        return Quantity("an entry: a number", self.unit, smallest=1.0 / MAX_COEFFICIENT)

    @property
    def json_schema(self) -> JsonSchema:
        """A number, or the coefficients."""
        coefficients = COEFFICIENTS.json_schema
        return either(self._gain.json_schema, mapping_of({"num": coefficients, "den": coefficients}))

    def __call__(self, value: object) -> Rational:
        """The entry as a rational function."""
        if isinstance(value, Rational):
            return value
        if not isinstance(value, Mapping):
            if isinstance(value, list | tuple):
                raise refuse(show(value), f"one entry there: a number in {self.unit} or {{num: [...], den: [...]}}")
            return Rational(num=(self._gain(value),), den=(1.0,))
        for key in value:
            if key not in ("num", "den"):
                raise refuse(f"the unknown key {show(key)}", one_of(("num", "den"), key), at=(key,))
        for key in ("num", "den"):
            if key not in value:
                raise refuse(f"no key {key!r}", f"both num and den, or a plain number in {self.unit}")
        checked = each_named(COEFFICIENTS, {key: value[key] for key in ("num", "den")})
        return Rational(num=checked["num"], den=checked["den"])


def trimmed(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """The coefficients without leading zeros."""
    return tuple(dropwhile(lambda c: c == 0.0, coefficients))


def is_hurwitz(coefficients: Sequence[float]) -> bool:
    """Whether every root has a negative real part: Routh's test in exact arithmetic, which leaves no borderline case.

    Args:
        coefficients: a polynomial of s other than 0, the highest power first.
    """
    exact = [Fraction(c) for c in dropwhile(lambda c: c == 0, coefficients)]
    above, row = exact[0::2], exact[1::2]
    while row:
        if row[0] * exact[0] <= 0:
            return False
        ratio = above[0] / row[0]
        longer = [*row[1:], *[Fraction(0)] * (len(above) - len(row))]
        above, row = row, [a - ratio * b for a, b in zip(above[1:], longer, strict=True)]
    return True
