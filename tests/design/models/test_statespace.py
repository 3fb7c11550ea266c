"""Systems in state space: shapes are checked, and no array is silently reshaped."""

from types import SimpleNamespace

import control
import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from manyhands import passivity
from manyhands.design.models.statespace import StateSpace, block_diagonal, matrix, parallel_blocks


def random_system(seed: int, n: int, p: int, m: int) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= 0.9 / max(1.0, float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0)))
    return StateSpace(A, rng.normal(size=(n, p)), rng.normal(size=(m, n)), rng.normal(size=(m, p)))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ([1.0, 2.0], "1 dimension"),
        ([[1.0, np.nan]], "finite"),
        ([[1.0], [2.0]], "found 2 x 1; expected a 1 x 1 matrix"),
    ],
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
    with pytest.raises(ValueError, match="found 3 x 2; expected a 2 x 3 matrix"):
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


def test_a_transfer_matrix_of_another_library_becomes_a_system() -> None:
    """python-control's has rows of polynomials, SciPy's one entry alone."""
    both = control.tf([[[1.0], [2.0, 1.0]], [[0.0], [3.0]]], [[[0.2, 1.37], [1.0, 5.0]], [[1.0], [1.0]]])
    of_scipy = scipy.signal.TransferFunction([1.0], [0.2, 1.37])
    for s in (0.0, 2.0j, 0.5 + 1.0j):
        np.testing.assert_allclose(StateSpace.of(both).response(s), both(s, squeeze=False), rtol=1e-12)
        np.testing.assert_allclose(StateSpace.of(of_scipy).response(s), [[1.0 / (0.2 * s + 1.37)]], rtol=1e-12)
    device = control.tf([1.0], [0.2, 1.37])
    assert passivity.device_level(StateSpace.of(device)).value == pytest.approx(1.37, rel=1e-6)


@pytest.mark.parametrize(
    ("num", "den", "said"),
    [
        ([[[1.0, 0.0]]], [[[2.0]]], r"entry \(1, 1\): improper, the numerator's degree 1 exceeds the denominator's 0"),
        ([[[1.0]]], [[[0.0]]], r"entry \(1, 1\): the denominator is zero"),
        ([[[1.0]], [[1.0], [1.0]]], [[[1.0]], [[1.0], [1.0]]], r"found rows of \[1, 2\] entries"),
    ],
)
def test_a_transfer_matrix_that_is_no_system_is_refused(num: object, den: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        StateSpace.of(SimpleNamespace(num=num, den=den))  # type: ignore[arg-type]


def test_what_is_no_linear_system_is_refused() -> None:
    with pytest.raises(ValueError, match="found int; expected a linear system, with A, B, C and D or with num and den"):
        StateSpace.of(3)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["analyse", "greatest_output_level", "device_level", "passive_operator"])
def test_the_lemmas_say_how_to_convert_another_librarys_system(name: str) -> None:
    with pytest.raises(
        ValueError, match=r"found TransferFunction; expected a StateSpace: mh\.passivity\.StateSpace\.of"
    ):
        getattr(passivity, name)(control.tf([1.0], [1.0, 1.0]))


def test_the_transformations_take_another_librarys_system_in_z() -> None:
    K, own = passivity.loop_gain([[1.37]], 1e-3), StateSpace([[0.5]], [[1.0]], [[1e-3]], [[0.0]])
    found = passivity.transformed_coupling(control.tf([1e-3], [1.0, -0.5], 1e-3), K, 1e-3)
    wanted = passivity.transformed_coupling(own, K, 1e-3)
    np.testing.assert_allclose(found.response(0.3j), wanted.response(0.3j), rtol=1e-12)
    with pytest.raises(ValueError, match="found a system in continuous time, dt = 0"):
        passivity.transformed_coupling(control.tf([1e-3], [1.0, 0.5]), K, 1e-3)
