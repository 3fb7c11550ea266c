"""Exact numbers from plain JSON data, and sparse symmetric matrices of them.

Each value is read together with the path of its key, so that every refusal names its place. A number is the decimal in
the file: 0.1 is one tenth, and not the binary float next to it. The decimal is what an author can read and compare, and
json writes a float as the shortest decimal that leads back to it. Sizes are bounded before anything is built from them.

A symmetric matrix that joins no index of one group with an index of a different group is definite exactly when its part
on every group is definite. So a thousand ports become a thousand small proofs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal

from flint import arb_mat, fmpq, fmpq_mat

from manyhands.design.proof import rational
from manyhands.design.proof.finding import ProofInputError, Verdict, weakest

Number = int | float
"""A number of the file; it stands for the decimal that json writes for it, exactly."""

MAX_PORTS = 10_000
MAX_LINKS = 100_000
MAX_DENSE = 1_200  # rows of a dense matrix: a product of two takes about 5 s in balls
MAX_STATIC = 512  # states up to which a static gain is computed in rationals, in about a minute
MAX_DEGREE = 32  # of a transfer function or a weight
_MAX_BITS = 1023  # of a whole number: greater ones do not fit into a float
_MAX_TEXT = 1_000


def exact_decimal(number: Number | fmpq) -> fmpq:
    """The exact value of the shortest decimal of ``number``; a rational, which is exact, as it is."""
    return number if isinstance(number, fmpq) else fmpq(*_ratio(number))


def _ratio(number: Number) -> tuple[int, int]:
    return (number, 1) if isinstance(number, int) else Decimal(float.__repr__(number)).as_integer_ratio()


@dataclass(frozen=True, eq=False)
class StatedMatrix:
    """A matrix of the file.

    Attributes:
        rows: its number of rows; stored, because JSON has no shape for a matrix without rows or columns.
        columns: its number of columns.
        values: the entries, row by row.
    """

    rows: int
    columns: int
    values: list[list[Number]]

    def rational(self) -> fmpq_mat:
        """The matrix, exactly."""
        return fmpq_mat(self.rows, self.columns, [exact_decimal(value) for row in self.values for value in row])

    def balls(self) -> arb_mat:
        """Balls around the matrix, at the present precision."""
        return arb_mat(self.rational())

    def witness(self) -> arb_mat:
        """The matrix's floats, as balls of radius zero; only for storage matrices.

        A proof only needs that some storage matrix exists. So these floats serve as well as the decimals, and faster.
        """
        return arb_mat(self.rows, self.columns, [value for row in self.values for value in row])

    def bits(self) -> int:
        """The longest numerator or denominator, in bits; it determines the cost of exact arithmetic."""
        pairs = (_ratio(value) for row in self.values for value in row)
        return max((max(abs(p).bit_length(), q.bit_length()) for p, q in pairs), default=0)


class StatedDifferences(StatedMatrix):
    """A storage matrix in differences of the states of rational functions (:mod:`manyhands.design.proof.system`)."""


@dataclass(frozen=True)
class Item:
    """A value of the data and its place.

    Attributes:
        value: as json.load returns it.
        path: its keys, joined by dots.
    """

    value: object
    path: str

    def refusal(self, expected: str) -> ProofInputError:
        """The error that names this place, what was found and what would be right."""
        return ProofInputError(f"{self.path or 'certificate'}: found {_shown(self.value)}; expected {expected}")

    def fields(self, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, Item]:
        """The values of an object with exactly these keys."""
        found = self.entries(len(required) + len(optional) + 16)
        missing = [key for key in required if key not in found]
        unknown = [key for key in found if key not in required and key not in optional]
        if missing or unknown:
            raise ProofInputError(
                f"{self.path or 'certificate'}: missing keys {missing}, unknown keys {[_shown(k) for k in unknown]}; "
                f"expected {sorted(required)}"
            )
        return found

    def entries(self, most: int) -> dict[str, Item]:
        """The values of an object with free names, at most ``most`` of them."""
        if not isinstance(self.value, Mapping):
            raise self.refusal("an object")
        if len(self.value) > most:
            raise ProofInputError(
                f"{self.path or 'certificate'}: found {len(self.value)} keys; expected at most {most}"
            )
        for key in self.value:
            if not isinstance(key, str) or len(key) > _MAX_TEXT:
                raise ProofInputError(
                    f"{self.path or 'certificate'}: found the key {_shown(key)}; expected a short text"
                )
        return {key: Item(value, f"{self.path}.{key}" if self.path else key) for key, value in self.value.items()}

    def items(self, most: int, exactly: int | None = None) -> list[Item]:
        """The values of a list, at most ``most``, or ``exactly`` so many."""
        if not isinstance(self.value, list | tuple):
            raise self.refusal("a list")
        if exactly is not None and len(self.value) != exactly:
            raise ProofInputError(f"{self.path}: found {len(self.value)} entries; expected {exactly}")
        if len(self.value) > most:
            raise ProofInputError(f"{self.path}: found {len(self.value)} entries; expected at most {most}")
        return [Item(value, f"{self.path}[{i}]") for i, value in enumerate(self.value)]

    def text(self, *allowed: str) -> str:
        """A text of bounded length; one of ``allowed`` if any are given."""
        if not isinstance(self.value, str) or len(self.value) > _MAX_TEXT or (allowed and self.value not in allowed):
            raise self.refusal(f"one of {list(allowed)}" if allowed else f"a text of at most {_MAX_TEXT} characters")
        return self.value

    def number(self) -> Number:
        """A finite number."""
        if not _is_number(self.value):
            raise self.refusal("a finite number")
        assert isinstance(self.value, int | float)  # noqa: S101  # for the type checker: _is_number has checked it
        return self.value

    def whole(self, low: int, high: int) -> int:
        """A whole number from ``low`` to ``high``."""
        if not isinstance(self.value, int) or isinstance(self.value, bool) or not low <= self.value <= high:
            raise self.refusal(f"a whole number from {low} to {high}")
        return self.value

    def span(self) -> tuple[Number, Number]:
        """A number, or an interval [low, high]: its two ends."""
        if not isinstance(self.value, list | tuple):
            number = self.number()
            return number, number
        low, high = (item.number() for item in self.items(2, exactly=2))
        if low > high:
            raise self.refusal("the lower end first")
        return low, high

    def table(self, rows: int, columns: int) -> StatedMatrix:
        """A matrix of this shape; a matrix without rows or columns may be written as [] or as empty rows."""
        if not isinstance(self.value, list | tuple):
            raise self.refusal("a list of rows")
        lines = list(self.value)
        if not lines and (rows == 0 or columns == 0):
            return StatedMatrix(rows, columns, [[] for _ in range(rows)])
        if len(lines) != rows:
            raise ProofInputError(f"{self.path}: found {len(lines)} rows; expected {rows}")
        values: list[list[Number]] = []
        for i, line in enumerate(lines):
            if not isinstance(line, list | tuple):
                raise Item(line, f"{self.path}[{i}]").refusal(f"a row of {columns} numbers")
            if len(line) != columns:
                raise ProofInputError(f"{self.path}[{i}]: found {len(line)} entries; expected {columns}")
            for j, value in enumerate(line):
                if not _is_number(value):
                    raise Item(value, f"{self.path}[{i}][{j}]").refusal("a finite number")
            values.append(list(line))
        return StatedMatrix(rows, columns, values)

    def symmetric(self, size: int) -> StatedMatrix:
        """A symmetric matrix of this size, to the last bit, as every level and stiffness is."""
        table = self.table(size, size)
        for i, row in enumerate(table.values):
            for j in range(i):
                if row[j] != table.values[j][i]:
                    raise ProofInputError(
                        f"{self.path}: found {row[j]!r} in [{i}][{j}] and {table.values[j][i]!r} in [{j}][{i}], "
                        "expected a symmetric matrix"
                    )
        return table

    def length(self) -> int:
        """Number of entries of a list."""
        if not isinstance(self.value, list | tuple):
            raise self.refusal("a list")
        return len(self.value)


def _is_number(value: object) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, int) and not isinstance(value, bool) and value.bit_length() <= _MAX_BITS


def _shown(value: object) -> str:
    """A short text for a message, independent of the value's size."""
    if isinstance(value, Mapping):
        return f"an object of {len(value)} keys"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)} entries"
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > _MAX_BITS:
        return f"a whole number of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


Sparse = dict[tuple[int, int], fmpq]
"""The entries that are not zero, both triangles."""

MOST_EXACT = 64  # rows up to which balls may be followed by the exact test


def add(into: Sparse, indices: Sequence[int], table: StatedMatrix) -> None:
    """Add the entries of ``table`` at these indices."""
    for i, row in zip(indices, table.values, strict=True):
        for j, value in zip(indices, row, strict=True):
            if value:
                add_entry(into, i, j, exact_decimal(value))


def block_diagonal(blocks: Sequence[Sequence[int]], tables: Sequence[StatedMatrix]) -> Sparse:
    """The matrix that has each table on the indices of its block, and zeros elsewhere; blocks that overlap add up."""
    out: Sparse = {}
    for indices, table in zip(blocks, tables, strict=True):
        add(out, indices, table)
    return out


def add_entry(into: Sparse, i: int, j: int, value: fmpq) -> None:
    """Add to one entry, and remove it if it becomes zero."""
    total = into.get((i, j), fmpq(0)) + value
    if total == 0:
        into.pop((i, j), None)
    else:
        into[i, j] = total


def difference(left: Sparse, right: Sparse) -> Sparse:
    """The matrix left - right."""
    out = dict(left)
    for (i, j), value in right.items():
        add_entry(out, i, j, -value)
    return out


def groups(size: int, matrices: Iterable[Sparse]) -> list[list[int]]:
    """The indices 0 ... size-1 in groups that no entry of any of ``matrices`` joins, each ascending."""
    parent = list(range(size))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for matrix in matrices:
        for i, j in matrix:
            parent[root(i)] = root(j)
    found: dict[int, list[int]] = {}
    for i in range(size):
        found.setdefault(root(i), []).append(i)
    return list(found.values())


def dense(matrix: Sparse, indices: Sequence[int]) -> fmpq_mat:
    """The part of a matrix on ``indices``."""
    zero = fmpq(0)
    return fmpq_mat(len(indices), len(indices), [matrix.get((i, j), zero) for i in indices for j in indices])


def definite(M: fmpq_mat, strict: bool = True) -> Verdict:
    """Whether M > 0, or M >= 0: exactly if that may be quick, otherwise in balls, which can only prove M > 0."""
    n = M.nrows()
    if n <= MOST_EXACT:
        return rational.definite(M, strict)
    return _too_large(n) or rational.decided(n, lambda: rational.definite_in_balls(arb_mat(M)))


def _too_large(n: int) -> Verdict | None:
    if n <= MAX_DENSE:
        return None
    return Verdict(False, float("nan"), f"{n} rows are too many for a dense proof (at most {MAX_DENSE})")


def definite_by_groups(matrix: Sparse, size: int, strict: bool = True, name: str = "ports") -> Verdict:
    """Whether the matrix on indices 0 ... size-1 is definite, group by group.

    If semidefinite is enough, indices without entries are skipped.
    """
    parts: dict[str, Verdict] = {}
    for group in groups(size, [matrix]):
        if not strict and len(group) == 1 and (group[0], group[0]) not in matrix:
            continue
        too_large = _too_large(len(group))  # before it is written out
        parts[f"{name} {_shown_rows(group)}"] = too_large or definite(dense(matrix, group), strict)
    return weakest(parts) if parts else Verdict(True, 0.0, "exactly: the matrix is zero")


def least_eigenvalue(matrix: Sparse, size: int) -> float:
    """The least eigenvalue in floats, for the reader; nan if a group is too large for it."""
    least = float("inf")
    for group in groups(size, [matrix]):
        if len(group) == 1:
            found = rational.rounded(matrix.get((group[0], group[0]), fmpq(0)))
        elif len(group) > MAX_DENSE:
            return float("nan")
        else:
            found = rational.least_eigenvalue(dense(matrix, group))
        least = min(least, found)
    return least


def _shown_rows(group: list[int]) -> str:
    text = ", ".join(str(i + 1) for i in group[:6])
    return text + (", ..." if len(group) > 6 else "")
