"""Definition 1, Lemma 3 and Theorem 1: devices and hands in continuous time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.errors import Infeasible
from manyhands.design.models.device import held_device
from manyhands.design.models.statespace import StateSpace
from manyhands.design.passivity.continuous import (
    Dissipative,
    continuous_storage_inequality,
    device_level,
    device_with_level,
    feedback_with_passive,
    lemma3,
    mass_with_damping,
    passive_operator,
    theorem1,
)
from manyhands.design.passivity.operators import RationalMatrix

seeds = st.integers(0, 2**32 - 1)


def definite(rng: np.random.Generator, n: int, low: float, high: float) -> np.ndarray:
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    M = Q @ np.diag(rng.uniform(low, high, n)) @ Q.T
    return (M + M.T) / 2.0


def any_system(rng: np.random.Generator, n: int, m: int) -> StateSpace:
    return StateSpace(*(rng.normal(size=shape) for shape in ((n, n), (n, m), (m, n), (m, m))))


@given(seeds, st.integers(0, 4), st.integers(1, 3))
def test_the_inequality_is_definition_1(seed: int, n: int, m: int) -> None:
    """dV/dt - y^T u + y^T Delta y + u^T Phi u, term by term."""
    rng = np.random.default_rng(seed)
    system = any_system(rng, n, m)
    P, Delta, Phi = (X + X.T for X in (rng.normal(size=(k, k)) for k in (n, m, m)))
    psi, u = rng.normal(size=n), rng.normal(size=m)
    rate, y = system.A @ psi + system.B @ u, system.C @ psi + system.D @ u
    expected = 2.0 * psi @ P @ rate - y @ u + y @ Delta @ y + u @ Phi @ u
    both = np.concatenate([psi, u])
    N = continuous_storage_inequality(system, P, Delta, Phi)
    assert both @ N @ both == pytest.approx(expected, rel=1e-9, abs=1e-9 * (1.0 + np.abs(N).max() * (both @ both)))


@given(seeds, st.integers(1, 3), st.integers(0, 3), st.integers(1, 2))
def test_lemma_3_is_a_sum_of_two_inequalities(seed: int, n: int, h: int, m: int) -> None:
    """N of the whole = N_D at (psi_D, f - f_h) + N_H at (psi_H, v), for any two systems and any P."""
    rng = np.random.default_rng(seed)
    device, hand = any_system(rng, n, m), any_system(rng, h, m)
    if np.linalg.cond(np.eye(m) + device.D @ hand.D) > 1e3:
        return
    P_D, P_H, Delta = (X + X.T for X in (rng.normal(size=(k, k)) for k in (n, h, m)))
    whole = feedback_with_passive(device, hand)
    psi_D, psi_H, f = rng.normal(size=n), rng.normal(size=h), rng.normal(size=m)
    v = whole.C @ np.concatenate([psi_D, psi_H]) + whole.D @ f
    f_h = hand.C @ psi_H + hand.D @ v
    np.testing.assert_allclose(v, device.C @ psi_D + device.D @ (f - f_h), atol=1e-8 * (1 + np.abs(v).max()))

    def form(N: np.ndarray, *parts: np.ndarray) -> float:
        x = np.concatenate(parts)
        return float(x @ N @ x)

    P = np.block([[P_D, np.zeros((n, h))], [np.zeros((h, n)), P_H]])
    left = form(continuous_storage_inequality(whole, P, Delta), psi_D, psi_H, f)
    right = form(continuous_storage_inequality(device, P_D, Delta), psi_D, f - f_h)
    right += form(continuous_storage_inequality(hand, P_H), psi_H, v)
    scale = 1.0 + abs(left) + float(np.sum(f_h**2) + np.sum(v**2) + np.abs(P).max()) * 1e2
    assert left == pytest.approx(right, abs=1e-9 * scale)


@given(seeds, st.integers(1, 3))
def test_a_mass_with_damping_is_as_dissipative_as_its_dampers(seed: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    mass, b = definite(rng, m, 0.05, 2.0), definite(rng, m, 0.1, 3.0)
    device = mass_with_damping(mass, b)
    assert device.excess() < 1e-12
    with pytest.raises(ValueError, match="does not prove the output level"):
        Dissipative(device.system, device.P, b + 1e-3 * np.eye(m))


@given(seeds)
@settings(max_examples=10)
def test_the_level_of_a_device_is_its_damping(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mass, b = definite(rng, 2, 0.05, 2.0), definite(rng, 2, 0.1, 3.0)
    found = device_level(mass_with_damping(mass, b).system)
    assert found.value == pytest.approx(np.trace(b), rel=1e-5)
    np.testing.assert_allclose(found.matrix, b, atol=1e-4)
    assert device_level(mass_with_damping(mass, b).system, "scalar").value == pytest.approx(
        np.linalg.eigvalsh(b)[0], rel=1e-5
    )


@given(st.data())
@settings(max_examples=15)
def test_a_device_held_by_a_passive_hand_keeps_its_level(problems, data: st.DataObject) -> None:
    b, mass = data.draw(st.floats(0.1, 3.0)), data.draw(st.floats(0.05, 2.0))
    device = mass_with_damping(np.array([[mass]]), np.array([[b]]))
    entry = data.draw(problems.passive_entries())
    hand = passive_operator(RationalMatrix(((entry,),)).realisation())
    held = lemma3(device, hand)
    np.testing.assert_array_equal(held.Delta, device.Delta)
    # the frequency response shows it, too: He Y - Y^* b Y >= 0
    for w in np.logspace(-2, 4, 60):
        Y = held.system.response(1j * w)[0, 0]
        assert Y.real - b * abs(Y) ** 2 >= -1e-9 * abs(Y)


def test_example_1_as_a_whole(problems) -> None:
    """Three devices of 0.2 kg and 1.37 N s/m held by one operator: Delta_D = 1.37 I, Theorem 1 and Lemma 3."""
    one = mass_with_damping(np.array([[0.2]]), np.array([[1.37]]))
    devices = theorem1([one] * 3)
    np.testing.assert_array_equal(devices.Delta, 1.37 * np.eye(3))
    held = lemma3(devices, passive_operator(problems.operator(0.01).realisation()))
    # H's own least Hermitian eigenvalue is damping that the device gains
    assert device_level(held.system, "scalar").value == pytest.approx(1.37 + 4.6e-5, abs=1e-6)
    with pytest.raises(Infeasible, match=r"hand is not a passive operator: energy is drawn"):
        passive_operator(problems.operator(0.1).realisation())


def test_it_is_the_device_that_is_simulated(problems) -> None:
    hand = RationalMatrix(((problems.h,),)).realisation()
    plant = held_device([0.2], [1.37], hand, [0.0], [0.0]).continuous()
    held = feedback_with_passive(mass_with_damping(np.array([[0.2]]), np.array([[1.37]])).system, hand)
    for w in (0.1, 3.0, 20.9, 500.0):
        np.testing.assert_allclose(held.response(1j * w)[0, 0], plant.response(1j * w)[1, 0], rtol=1e-9)


def test_theorem_1_stacks_levels_and_storages() -> None:
    rng = np.random.default_rng(3)
    parts = [mass_with_damping(definite(rng, m, 0.1, 1.0), definite(rng, m, 0.1, 1.0)) for m in (1, 2)]
    whole = theorem1(parts)
    np.testing.assert_array_equal(whole.Delta[1:, 1:], parts[1].Delta)
    assert not whole.Delta[0, 1:].any()
    assert whole.system.order == 3


def test_assumption_1a_can_fail() -> None:
    system = mass_with_damping(np.array([[0.2]]), np.array([[1.37]])).system
    np.testing.assert_allclose(device_with_level(system, np.array([[1.37]])).P, [[0.1]], rtol=1e-8)
    with pytest.raises(Infeasible, match="the device is not output strictly passive"):
        device_with_level(system, np.array([[1.38]]))


def test_what_cannot_be_interconnected_is_refused() -> None:
    gyrator = StateSpace.static([[0.0, 1.0], [-1.0, 0.0]])
    with pytest.raises(ValueError, match="not well posed"):
        feedback_with_passive(gyrator, gyrator)
    with pytest.raises(ValueError, match="one size"):
        feedback_with_passive(gyrator, StateSpace.static([[1.0]]))
    lacking = Dissipative(StateSpace.static([[-1.0]]), np.zeros((0, 0)), np.array([[-1.0]]))
    with pytest.raises(ValueError, match="passive hand"):
        lemma3(mass_with_damping(np.eye(1), np.eye(1)), lacking)


@pytest.mark.parametrize("mass", [[[0.0]], [[1.0, 0.5], [0.0, 1.0]], [[-1.0]]])
def test_what_is_no_mass_is_refused(mass: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="symmetric positive definite mass"):
        mass_with_damping(np.array(mass), np.eye(len(mass)))


def test_a_storage_that_is_not_positive_is_refused() -> None:
    system = mass_with_damping(np.eye(1), np.eye(1)).system
    with pytest.raises(ValueError, match="positive definite storage"):
        Dissipative(system, -np.eye(1), np.eye(1))
