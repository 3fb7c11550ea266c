"""Symmetric rational matrices of which most entries are zero, and the groups of indices that they join.

A matrix that joins no index of one group with one of another is definite exactly when its part on every group is:
this is what makes a thousand ports a thousand small proofs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from flint import arb_mat, fmpq, fmpq_mat

from manyhands.design.proof import balls, rational
from manyhands.design.proof.finding import Verdict, weakest
from manyhands.design.proof.reading import MAX_DENSE, Table, exact

Sparse = dict[tuple[int, int], fmpq]
"""The entries that are not zero, both triangles."""

MOST_EXACT = 64  # rows for which the exact test is quicker than balls
_MOST_BITS = 2_000  # of an entry: numbers of unusual length go to balls, which carry a fixed number of bits


def add(into: Sparse, indices: Sequence[int], table: Table) -> None:
    """Add a matrix on some of the indices."""
    for i, row in zip(indices, table.values, strict=True):
        for j, value in zip(indices, row, strict=True):
            if value:
                add_entry(into, i, j, exact(value))


def block_diagonal(blocks: Sequence[Sequence[int]], tables: Sequence[Table]) -> Sparse:
    """The matrix that has each table on the indices of its block, and zeros elsewhere; blocks that overlap add up."""
    out: Sparse = {}
    for indices, table in zip(blocks, tables, strict=True):
        add(out, indices, table)
    return out


def add_entry(into: Sparse, i: int, j: int, value: fmpq) -> None:
    """Add to one entry, and forget it where it becomes zero."""
    total = into.get((i, j), fmpq(0)) + value
    if total == 0:
        into.pop((i, j), None)
    else:
        into[i, j] = total


def difference(left: Sparse, right: Sparse) -> Sparse:
    """Left - right."""
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
    """Whether M > 0, or M >= 0: exactly where that is quick, in balls (which prove M > 0 alone) where it is not."""
    n = M.nrows()
    if n <= MOST_EXACT and (n <= 2 or _bits(M) <= _MOST_BITS):
        return rational.definite(M, strict)
    if n > MAX_DENSE:
        return Verdict(False, float("nan"), f"{n} rows are too many for a dense proof (at most {MAX_DENSE})")
    return balls.decided(n, lambda: balls.definite(arb_mat(M)))


def definite_by_groups(matrix: Sparse, size: int, strict: bool = True, name: str = "ports") -> Verdict:
    """Whether the matrix on indices 0 ... size-1 is definite, group by group.

    Where semidefinite is enough, only indices with entries are looked at.
    """
    parts: dict[str, Verdict] = {}
    for group in groups(size, [matrix]):
        if not strict and len(group) == 1 and (group[0], group[0]) not in matrix:
            continue
        parts[f"{name} {_shown(group)}"] = definite(dense(matrix, group), strict)
    return weakest(parts) if parts else Verdict(True, 0.0, "exactly: the matrix is zero")


def least_eigenvalue(matrix: Sparse, size: int) -> float:
    """The least eigenvalue in floats, for the reader; nan where a group is too large to be looked at."""
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


def _bits(M: fmpq_mat) -> int:
    return max((int(entry.height_bits()) for entry in M.entries()), default=0)


def _shown(group: list[int]) -> str:
    text = ", ".join(str(i + 1) for i in group[:6])
    return text + (", ..." if len(group) > 6 else "")
