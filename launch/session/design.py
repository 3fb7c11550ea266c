"""What a session asks of the design: the class of couplings, the objective, and couplings that are given."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, Literal, Self, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, model_validator

from manyhands.launch.session.error import listed, one_of
from manyhands.launch.session.fields import (
    Choice,
    Items,
    NamedParts,
    Problem,
    Quantity,
    Rows,
    SessionModel,
    optional,
    part_name,
    refuse,
    unsymmetric,
)
from manyhands.launch.session.limits import MAX_COUPLINGS, MAX_ORDER, MAX_PORTS

Array: TypeAlias = npt.NDArray[np.float64]
OneOrMany: TypeAlias = float | tuple[float, ...] | Rows
"""A number for all ports, one for each port, or a matrix."""

_ENTRY: Final = Quantity("an entry: a number")


def _one_or_many(what: Quantity) -> Any:
    def check(value: object) -> object:
        if not isinstance(value, list | tuple):
            return what(value)
        if any(isinstance(row, list | tuple) for row in value):
            return Items(f"rows of {what.what}", MAX_PORTS, Items("entries of a row", MAX_PORTS, what))(value)
        return Items("numbers, one for each port", MAX_PORTS, what)(value)

    return BeforeValidator(optional(check))


def _rows(value: object) -> Rows:
    rows: Rows = Items("rows", MAX_ORDER, Items("entries of a row", MAX_ORDER, _ENTRY, least=0), least=0)(value)
    if len({len(row) for row in rows}) > 1:
        raise refuse("rows of different lengths", "rows that are all of the same length")
    return rows


_Rows: TypeAlias = Annotated[Rows, BeforeValidator(_rows)]


class BlockMatrices(SessionModel):
    """A given coupling block V in discrete time: xi+ = A xi + B f_v, tool displacement = C xi + D f_v.

    With n states and m ports, A is n x n, B is n x m, C is m x n and D is m x m, in m and N. A static block has
    no states: ``A: [], B: [], C: []``.
    """

    A: _Rows = Field(description="the n x n matrix A, as rows")
    B: _Rows = Field(description="the n x m matrix B, as rows")
    C: _Rows = Field(description="the m x n matrix C, as rows")
    D: _Rows = Field(description="the m x m matrix D, as rows")

    def problems(self, ports: int) -> Iterator[Problem]:
        """Which matrices have not the size that a block of ``ports`` ports needs."""
        n = len(self.A)
        for name, rows, height, width in (
            ("A", self.A, n, n),
            ("B", self.B, n, ports),
            ("C", self.C, ports, n),
            ("D", self.D, ports, ports),
        ):
            found = (len(rows), len(rows[0]) if rows else width)
            if found != (height, width) and not (n == 0 and not any(rows) and name == "C"):
                size = f"{len(rows)} x {len(rows[0]) if rows else 0}"
                yield Problem((name,), f"a matrix of {size}", f"{height} x {width}, with {n} states and {ports} ports")

    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C and D, each in its full shape also without states."""
        n, m = len(self.A), len(self.D)
        shapes = ((self.A, (n, n)), (self.B, (n, m)), (self.C, (m, n)), (self.D, (m, m)))
        A, B, C, D = (np.array(rows, dtype=np.float64).reshape(shape) for rows, shape in shapes)
        return A, B, C, D


class Design(SessionModel):
    """Which virtual coupling the session runs with, and by which aim it is chosen."""

    coupling: Annotated[
        Literal["spring-damper", "given", "none"],
        BeforeValidator(Choice(("spring-damper", "given", "none"), absent=("linear",))),
    ] = Field(description="the class of the coupling: spring-damper, given or none")
    objective: Annotated[
        Literal["feasible"], BeforeValidator(Choice(("feasible",), absent=("loop-shaping", "closed-loop")))
    ] = Field(default="feasible", description="what the design aims at: feasible")
    stiffness: Annotated[OneOrMany | None, _one_or_many(Quantity("a stiffness", "N/m"))] = Field(
        default=None, description="the given stiffness K in N/m: a number, one for each port, or a matrix"
    )
    damping: Annotated[OneOrMany | None, _one_or_many(Quantity("a damping", "N·s/m"))] = Field(
        default=None, description="the given damping B in N·s/m: a number, one for each port, or a matrix"
    )
    matrices: Annotated[
        dict[str, BlockMatrices] | None,
        BeforeValidator(optional(NamedParts(part_name("a coupling name"), MAX_COUPLINGS))),
    ] = Field(default=None, description="the given matrices A, B, C, D of every coupling")

    @model_validator(mode="after")
    def _given_where_it_belongs(self) -> Self:
        given = [name for name in ("stiffness", "damping", "matrices") if getattr(self, name) is not None]
        if self.coupling != "given" and given:
            found = f"{given[0]} with 'coupling: {self.coupling}'"
            raise refuse(found, f"'coupling: given', or no {given[0]}", at=(given[0],))
        if self.coupling == "given" and self.matrices is None and self.stiffness is None:
            found = "damping without stiffness" if given else "'coupling: given' without anything given"
            raise refuse(found, "stiffness (and damping), or matrices")
        if self.matrices is not None and len(given) > 1:
            raise refuse(f"matrices besides {given[0]}", "either stiffness and damping, or matrices", at=("matrices",))
        return self

    def problems(self, ports: tuple[str, ...], blocks: Mapping[str, tuple[str, ...]]) -> Iterator[Problem]:
        """What does not fit a session with these ports and these ports of each coupling."""
        block_of = {port: name for name, block in blocks.items() for port in block}
        for field in ("stiffness", "damping"):
            value: OneOrMany | None = getattr(self, field)
            if value is not None:
                for problem in _given_problems(value, ports, block_of, definite=field == "stiffness"):
                    yield problem._replace(at=(field, *problem.at))
        if self.matrices is None:
            return
        for name in self.matrices:
            if name not in blocks:
                yield Problem(("matrices", name), f"the unknown coupling {name!r}", one_of(blocks, name))
        for name, block in blocks.items():
            if name not in self.matrices:
                yield Problem(("matrices",), f"no matrices for {name!r}", f"matrices for {listed(blocks)}")
                continue
            for problem in self.matrices[name].problems(len(block)):
                yield problem._replace(at=("matrices", name, *problem.at))


def _given_problems(
    value: OneOrMany, ports: tuple[str, ...], block_of: Mapping[str, str], definite: bool
) -> Iterator[Problem]:
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
