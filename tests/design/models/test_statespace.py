"""Systems in state space: shapes are checked, and no array is silently reshaped."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.statespace import StateSpace, block_diagonal, matrix, parallel_blocks


def random_system(seed: int, n: int, p: int, m: int) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= 0.9 / max(1.0, float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0)))
    return StateSpace(A, rng.normal(size=(n, p)), rng.normal(size=(m, n)), rng.normal(size=(m, p)))


@pytest.mark.parametrize(
    ("data", "words"),
    [([1.0, 2.0], "1 dimension"), ([[1.0, np.nan]], "finite"), ([[1.0], [2.0]], "1 x 1 matrix, found 2 x 1")],
)
def test_a_matrix_is_refused(data: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        matrix(data, 1, 1) if "1 x 1" in words else matrix(data)


def test_a_matrix_is_a_read_only_copy() -> None:
    source = np.eye(2)
    out = matrix(source)
    source[0, 0] = 5.0
    assert out[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        out[0, 0] = 2.0


def test_a_transposed_input_matrix_is_refused() -> None:
    with pytest.raises(ValueError, match="expected a 2 x 3 matrix, found 3 x 2"):
        StateSpace(np.eye(2), np.ones((3, 2)), np.ones((3, 2)), np.zeros((3, 3)))


@given(st.integers(0, 10**6), st.integers(0, 4), st.integers(1, 3), st.integers(1, 3))
def test_a_sinusoid_settles_to_the_response(seed: int, n: int, p: int, m: int) -> None:
    system = random_system(seed, n, p, m)
    z = np.exp(0.7j)
    u = np.arange(1.0, p + 1.0)
    k = np.arange(400)
    found = system.simulate(np.real(z ** k[:, None] * u))
    expected = np.real(z ** k[:, None] * (system.response(z) @ u))
    np.testing.assert_allclose(found[-50:], expected[-50:], atol=1e-9 * (1.0 + np.abs(found).max()))


def test_a_gain_has_no_states() -> None:
    system = StateSpace.static([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    assert (system.order, system.inputs, system.outputs) == (0, 2, 3)
    np.testing.assert_array_equal(system.response(0.3 + 1j), system.D)
    np.testing.assert_array_equal(system.simulate(np.array([[1.0, -1.0]])), [[-1.0, -1.0, -1.0]])


def test_blocks_in_parallel_do_not_meet() -> None:
    parts = [random_system(1, 2, 1, 1), StateSpace.static([[3.0]]), random_system(2, 3, 2, 2)]
    joined = parallel_blocks(parts)
    z = 0.5 + 1.1j
    expected = block_diagonal([part.response(z).real for part in parts])
    np.testing.assert_allclose(joined.response(z).real, expected, rtol=1e-12, atol=1e-12)
    assert joined.order == 5
