"""The loop transformation (7)-(9) leaves f_v as it is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.coupling import (
    loop_gain,
    transformed_coupling,
    transformed_device,
    transformed_environment,
)
from manyhands.design.models.device import zero_order_hold
from manyhands.design.models.statespace import Matrix, StateSpace, block_diagonal, parallel_blocks
from manyhands.design.problem import HapticLoop


def device(mass: float, damping: float, T: float) -> StateSpace:
    """Displacement of a mass with a damper, under a force held over each tick."""
    A, B = np.array([[0.0, 1.0], [0.0, -damping / mass]]), np.array([[0.0], [1.0 / mass]])
    return zero_order_hold(StateSpace(A, B, np.array([[1.0, 0.0]]), np.zeros((1, 1))), T)


def forces(G: StateSpace, V: StateSpace, E: StateSpace, r: Matrix) -> Matrix:
    """f of y = G f + V f + r, f = -E y, from rest, the algebraic loop solved each tick."""
    loop = np.linalg.inv(np.eye(E.outputs) + E.D @ (G.D + V.D))
    g, v, e = np.zeros(G.order), np.zeros(V.order), np.zeros(E.order)
    out = np.zeros((len(r), E.outputs))
    for k, r_k in enumerate(r):
        free = r_k + G.C @ g + V.C @ v
        f = -loop @ (E.C @ e + E.D @ free)
        y = free + (G.D + V.D) @ f
        g, v, e = G.A @ g + G.B @ f, V.A @ v + V.B @ f, E.A @ e + E.B @ y
        out[k] = f
    return out


def joined(loop: HapticLoop, T: float) -> StateSpace:
    """E_hat put together again from its split: T/(z-1) E1 + Rest."""
    split = loop.environment.split(T)
    E1, rest, m = split.stiffness, split.rest, len(loop.ports)
    return StateSpace(
        block_diagonal([rest.A, np.eye(m)]),
        np.vstack([rest.B, np.eye(m)]),
        np.hstack([rest.C, T * E1]),
        rest.D,
    )


@given(st.data())
@settings(max_examples=60)
def test_the_transformed_loop_has_the_same_forces(problems, data: st.DataObject) -> None:
    loop = data.draw(problems.loops())
    T, m = loop.period, len(loop.ports)
    V = data.draw(problems.couplings(loop)).realisation(T)
    masses = data.draw(st.lists(st.floats(0.05, 2.0), min_size=m, max_size=m))
    G = parallel_blocks([device(M, b, T) for M, b in zip(masses, np.diag(loop.Delta_D), strict=True)])
    E = loop.environment.environment(T)
    r = np.random.default_rng(m).normal(size=(80, m)) * 1e-3
    original = forces(G, V, E, r)
    r_hat = np.diff(r, axis=0, prepend=np.zeros((1, m))) / T
    G_hat, V_hat = transformed_device(G, loop.K, T), transformed_coupling(V, loop.K, T)
    scale = max(float(np.abs(original).max()), 1e-300)
    for E_hat in (loop.environment.transformed_environment(T), transformed_environment(E, T), joined(loop, T)):
        transformed = forces(G_hat, V_hat, E_hat, r_hat)
        # differences divide by T what the integrators multiply back: at most 1e4 roundings of the stiffest force
        np.testing.assert_allclose(transformed, original, atol=1e-8 * scale)


def test_V_hat_is_12(problems) -> None:
    T, K = problems.T, loop_gain(np.diag([1.37, 2.0]), problems.T)
    rng = np.random.default_rng(3)
    V = StateSpace(*(rng.normal(size=shape) for shape in ((3, 3), (3, 2), (2, 3), (2, 2))))
    V_hat = transformed_coupling(V, K, T)
    zero = np.zeros((2, 3))
    np.testing.assert_allclose(V_hat.A, np.block([[V.A, -V.B / T], [zero, np.zeros((2, 2))]]))
    np.testing.assert_allclose(V_hat.B, np.vstack([V.B / T, np.eye(2)]))
    np.testing.assert_allclose(V_hat.C, np.hstack([V.C, -V.D / T + K / T]))
    np.testing.assert_allclose(V_hat.D, V.D / T - K / T)


@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.integers(1, 3))
def test_each_block_is_multiplied_as_in_7(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    T, K = 1e-3, np.eye(m) * 4e-4
    S = StateSpace(0.3 * rng.normal(size=(n, n)), *(rng.normal(size=s) for s in ((n, m), (m, n), (m, m))))
    for angle in (0.1, 1.0, np.pi):
        z = np.exp(1j * angle)
        step = (z - 1.0) / (T * z)
        for found, expected in (
            (transformed_device(S, K, T), step * (S.response(z) + K)),
            (transformed_coupling(S, K, T), step * (S.response(z) - K)),
            (transformed_environment(S, T), S.response(z) / step),
        ):
            np.testing.assert_allclose(found.response(z), expected, atol=1e-9 * np.abs(expected).max())


def test_the_loop_gain_is_8() -> None:
    Delta_D = np.array([[2.0, 0.5], [0.5, 1.0]])
    np.testing.assert_allclose(loop_gain(Delta_D, 1e-3) @ Delta_D, 0.5e-3 * np.eye(2), atol=1e-18)


@pytest.mark.parametrize("mass", [0.05, 0.2, 5.0])
def test_a_device_at_its_level_is_transformed_to_osp(problems, mass: float) -> None:
    """(9): Re G_hat >= Delta_D |G_hat|^2 over frequency, for a device whose only damping is Delta_D."""
    T, b = problems.T, problems.osp
    G_hat = transformed_device(device(mass, b, T), loop_gain(np.array([[b]]), T), T)
    for angle in np.linspace(1e-3, np.pi, 500):
        response = G_hat.response(np.exp(1j * angle))[0, 0]
        assert response.real - b * abs(response) ** 2 > -1e-9


def test_blocks_are_transformed_one_by_one(problems) -> None:
    """What each coupling process can do for itself: V_hat of the whole is blockdiag of the parts' V_hat."""
    loop = problems.example_1()
    parts = problems.blocks(loop, problems.C26)
    whole = transformed_coupling(loop.partition.join(parts), loop.K, loop.period)
    z = np.exp(0.3j)
    each = [
        transformed_coupling(part, K, loop.period).response(z)
        for part, K in zip(parts, loop.partition.restrict(loop.K), strict=True)
    ]
    for f in (np.real, np.imag):
        np.testing.assert_allclose(f(whole.response(z)), block_diagonal([f(e) for e in each]), atol=1e-12)
