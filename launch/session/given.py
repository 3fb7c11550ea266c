"""Couplings that are given: K and B by number, list or matrix, or a state space for each block."""

from collections.abc import Iterator, Mapping
from typing import Any, Self, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from manyhands.launch.session.error import listed
from manyhands.launch.session.fields import Items, Problem, Quantity, Rows, SessionModel, optional, unsymmetric
from manyhands.launch.session.limits import MAX_ORDER, MAX_PORTS
from manyhands.launch.session.matrices import (
    STATIC_MEANING,
    Array,
    MatrixRows,
    OptionalRows,
    full_arrays,
    one_of_two,
    size_problems,
)

OneOrMany: TypeAlias = float | tuple[float, ...] | Rows
"""A number for all ports, one for each port, or a matrix."""


def one_or_many(what: Quantity) -> Any:
    """The validator of a value that may be a number, a list or a matrix of ``what``, or absent."""

    def check(value: object) -> object:
        if not isinstance(value, list | tuple):
            return what(value)
        if any(isinstance(row, list | tuple) for row in value):
            return Items(f"rows of {what.what}", MAX_PORTS, Items("entries of a row", MAX_PORTS, what))(value)
        return Items("numbers, one for each port", MAX_PORTS, what)(value)

    return BeforeValidator(optional(check))


class BlockMatrices(SessionModel):
    """A given coupling block V in discrete time: xi+ = A xi + B f_v, tool displacement = C xi + D f_v.

    With n states and m ports, A is n x n, B is n x m, C is m x n and D is m x m, in m and N. A static block has
    no states: ``A: [], B: [], C: []``.
    """

    A: MatrixRows = Field(description="the n x n matrix A, as rows")
    B: MatrixRows = Field(description="the n x m matrix B, as rows")
    C: MatrixRows = Field(description="the m x n matrix C, as rows")
    D: OptionalRows = Field(default=None, description="the m x m matrix D, as rows")
    static: OptionalRows = Field(default=None, description=STATIC_MEANING)

    def problems(self, ports: int) -> Iterator[Problem]:
        """Which matrices have not the size that a block of ``ports`` ports needs."""
        return size_problems(self.A, self.B, self.C, self.D, self.static, ports, MAX_ORDER)

    @model_validator(mode="after")
    def _d_or_static(self) -> Self:
        one_of_two(self.D, self.static)
        return self

    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C and D, or the static gain in its place, each in its full shape also without states."""
        return full_arrays(self.A, self.B, self.C, one_of_two(self.D, self.static))


def given_problems(
    value: OneOrMany, ports: tuple[str, ...], block_of: Mapping[str, str], definite: bool
) -> Iterator[Problem]:
    """What does not fit these ports and their couplings; a ``definite`` value must be positive definite."""
    m = len(ports)
    rows = value if isinstance(value, tuple) else (value,) * m
    if len(rows) != m or any(isinstance(row, tuple) and len(row) != m for row in rows):
        expected = f"a number, {m} numbers, or {m} rows of {m}, for the ports {listed(ports)}"
        yield Problem((), f"{len(rows)} {'rows' if isinstance(rows[0], tuple) else 'numbers'}", expected)
        return
    if isinstance(rows[0], tuple):
        matrix: Any = rows
        if problem := unsymmetric(matrix):
            yield problem
        array = np.array(matrix)
        for i, j in zip(*np.nonzero(np.triu((array != 0.0) | (array.T != 0.0), 1)), strict=True):
            a, b = ports[i], ports[j]
            if block_of[a] != block_of[b]:
                where = f"between {a!r} of coupling {block_of[a]!r} and {b!r} of coupling {block_of[b]!r}"
                expected = "0 between ports of different couplings, or one coupling with both ports"
                yield Problem((int(i), int(j)), f"{array[i, j] or array[j, i]:g} {where}", expected)
    least = float(np.linalg.eigvalsh(full_matrix(value, m))[0]) if isinstance(rows[0], tuple) else min(rows)
    if definite and least <= 0.0:
        yield Problem((), f"a stiffness with the eigenvalue {least:.3g}", "a positive definite stiffness in N/m")


def full_matrix(value: OneOrMany, ports: int) -> Array:
    """A number, a list or a matrix as a matrix, ``ports`` x ``ports``."""
    array = np.array(value, dtype=np.float64)
    return array if array.ndim == 2 else np.diag(np.broadcast_to(array, (ports,)))
