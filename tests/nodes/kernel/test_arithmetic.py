"""Every way to compute a product gives the same number."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.kernel.arithmetic import FEW, NARROW, dot, linear_map, solve

ENTRIES = st.floats(-1e6, 1e6)


@pytest.mark.parametrize("columns", [1, 2, 5, NARROW // 4, NARROW // 4 + 1, NARROW])
def test_a_map_is_its_matrix(columns: int) -> None:
    rng = np.random.default_rng(columns)
    matrix, v = rng.normal(size=(4, columns)), rng.normal(size=columns)
    found = linear_map(matrix)(v.tolist())
    assert all(type(entry) is float for entry in found)
    np.testing.assert_allclose(found, [math.fsum(row * v) for row in matrix], rtol=0.0, atol=1e-13)


def test_a_map_of_nothing_is_nothing() -> None:
    assert linear_map(np.zeros((0, 0)))([]) == []
    assert linear_map(np.zeros((2, 0)))([]) == [0.0, 0.0]


def test_a_matrix_that_is_changed_later_changes_no_map() -> None:
    for matrix in (np.eye(2), np.eye(NARROW)):
        mapped, v = linear_map(matrix), [1.0] * len(matrix)
        matrix *= 2.0
        assert mapped(v) == v


@given(st.lists(st.tuples(ENTRIES, ENTRIES), max_size=6))
def test_a_dot_product_is_a_sum_of_products(pairs: list[tuple[float, float]]) -> None:
    found = dot([a for a, _ in pairs], [b for _, b in pairs])
    exact = math.fsum(a * b for a, b in pairs)
    assert abs(found - exact) <= 1e-15 * len(pairs) * sum(abs(a * b) for a, b in pairs)


@pytest.mark.parametrize("unknowns", [1, 2, FEW, FEW + 1, 12])
def test_equations_are_solved_and_singular_ones_are_reported(unknowns: int) -> None:
    rng = np.random.default_rng(unknowns)
    A, b = np.eye(unknowns) + 0.2 * rng.normal(size=(unknowns, unknowns)), rng.normal(size=unknowns)
    found = solve(A.tolist(), b.tolist(), 1e-9)
    assert found is not None
    assert all(type(entry) is float for entry in found)
    np.testing.assert_allclose(A @ found, b, rtol=0.0, atol=1e-12)  # of size 1, and well conditioned
    A[-1] = 2.0 * A[0] if unknowns > 1 else 0.0
    assert solve(A.tolist(), b.tolist(), 1e-9) is None
