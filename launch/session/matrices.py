"""State-space matrices in a session: rows that are read, sizes that must fit one another and the ports."""

from collections.abc import Iterator
from typing import Annotated, Final, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator

from manyhands.launch.session.fields import Items, Problem, Quantity, Rows, optional, refuse
from manyhands.launch.session.limits import MAX_PORTS

Array: TypeAlias = npt.NDArray[np.float64]

_ENTRY: Final = Quantity("an entry: a number")
_ROWS: Final = Items("rows", MAX_PORTS, Items("entries of a row", MAX_PORTS, _ENTRY, least=0), least=0)


def _rows(value: object) -> Rows:
    rows: Rows = _ROWS(value)
    if len({len(row) for row in rows}) > 1:
        raise refuse("rows of different lengths", "rows that are all of the same length")
    return rows


MatrixRows: TypeAlias = Annotated[Rows, BeforeValidator(_rows)]
"""Any rectangular matrix, also an empty one."""

OptionalRows: TypeAlias = Annotated[Rows | None, BeforeValidator(optional(_rows))]
"""The same, or nothing."""


STATIC_MEANING: Final = "the static gain, m x m, as rows, in place of D, which then is what the gain leaves"


def one_of_two(D: Rows | None, static: Rows | None) -> Rows:
    """D or the static gain: a system states one of them.

    Raises:
        PydanticCustomError: it states both, or neither.
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
    """Which matrices have not the size that ``ports`` ports need, with the states of A; ``most`` is their limit."""
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
        assert rows is not None  # noqa: S101  # for the type checker: one_of_two has taken one of the two
        found = (len(rows), len(rows[0]) if rows else width)
        if found != (height, width) and not (n == 0 and not any(rows) and name == "C"):
            size = f"{len(rows)} x {len(rows[0]) if rows else 0}"
            yield Problem((name,), f"a matrix of {size}", f"{height} x {width}, with {n} states and {ports} ports")


def full_arrays(A: Rows, B: Rows, C: Rows, last: Rows) -> tuple[Array, Array, Array, Array]:
    """A, B, C and D, or the static gain in its place, each in its full shape also without states."""
    n, m = len(A), len(last)
    shapes = ((A, (n, n)), (B, (n, m)), (C, (m, n)), (last, (m, m)))
    a, b, c, d = (np.array(rows, dtype=np.float64).reshape(shape) for rows, shape in shapes)
    return a, b, c, d
