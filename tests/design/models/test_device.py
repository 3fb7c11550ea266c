"""Simulated devices are exact between samples and account for all work of the hand's intention."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import cumulative_simpson
from scipy.signal import cont2discrete

from manyhands.design.models.device import HeldDevice, held_device, zero_order_hold
from manyhands.design.models.statespace import StateSpace
from manyhands.design.passivity.operators import RationalMatrix
from tests.support.exponential import errors

FINE = 400  # substeps of a tick, for integrals by Simpson's rule


@st.composite
def held(draw: st.DrawFn, problems) -> HeldDevice:
    m = draw(st.integers(1, 2))
    entries = [[((0.0,), (1.0,))] * m for _ in range(m)]
    for i in range(m):
        entries[i][i] = draw(problems.passive_entries())
    each = lambda low, high: draw(st.lists(st.floats(low, high), min_size=m, max_size=m))  # noqa: E731
    operator = RationalMatrix(tuple(map(tuple, entries))).realisation()
    return held_device(each(0.05, 2.0), each(0.0, 3.0), operator, each(0.0, 2.0), each(0.0, 300.0))


@given(st.data(), st.sampled_from([1e-3, 5e-3]))
def test_the_sampling_is_exact(problems, data: st.DataObject, T: float) -> None:
    device = data.draw(held(problems))
    continuous, found = device.continuous(), device.sampled(T)
    A, B, C, D, _ = cont2discrete((continuous.A, continuous.B, continuous.C, continuous.D), T, "zoh")
    for mine, scipys in ((found.A, A), (found.B, B), (found.C, C), (found.D, D)):
        np.testing.assert_allclose(mine, scipys, rtol=1e-10, atol=1e-12)
    halves = zero_order_hold(continuous, T / 2.0)
    np.testing.assert_allclose(halves.A @ halves.A, found.A, rtol=1e-9, atol=1e-11)


@given(st.data(), st.sampled_from([1e-9, 1e-5, 1e-3, 5e-3]))
@settings(max_examples=40)
def test_the_exponential_is_exact_to_the_last_digit(problems, data: st.DataObject, T: float) -> None:
    device = data.draw(held(problems))
    system = device.continuous()
    below = np.zeros((system.inputs, system.order + system.inputs))
    found = errors(np.vstack([np.hstack([system.A, system.B]), below]) * T)
    assert found.ours <= 4.0 * np.finfo(float).eps


@pytest.mark.parametrize("norm", [1.0, 10.0, 100.0, 1000.0])
def test_the_exponential_of_a_stiff_system_is_as_exact_as_scipys(norm: float) -> None:
    """Modes that die within a period, beside slow ones: there a squaring costs digits, and ours has more of them."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        n = int(rng.integers(2, 10))
        damped, turning = rng.normal(size=(2, n, n))
        A = 3.0 * (turning - turning.T) - damped @ damped.T
        A *= norm / np.abs(A).sum(axis=0).max()
        ours, scipys = errors(np.block([[A, norm * rng.normal(size=(n, 2))], [np.zeros((2, n + 2))]]))
        assert ours <= max(2.0 * scipys, 8.0 * np.finfo(float).eps)


@given(st.data(), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_the_equation_of_motion(problems, data: st.DataObject, seed: int) -> None:
    """M x'' = f - b x' - f_h with f_h = H w + b_h w + k_h d, w = x' - v_m, from the transfer function."""
    device, m = data.draw(held(problems)), None
    m = device.axes
    system = device.continuous()
    rng = np.random.default_rng(seed)
    s = complex(rng.uniform(0.1, 5.0), rng.uniform(1.0, 60.0))
    force, v_m = rng.normal(size=m), rng.normal(size=m)
    x, v = np.split(system.response(s) @ np.concatenate([force, v_m]), 2)
    w = v - v_m
    f_h = device.operator.response(s) @ w + device.hand_damping * w + device.hand_stiffness * w / s
    np.testing.assert_allclose(s * x, v, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(device.mass * s * v, force - device.damping * v - f_h, rtol=1e-7, atol=1e-9)


@given(st.data(), st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_the_work_of_the_intention(problems, data: st.DataObject, seed: int) -> None:
    """W = f_int dx - v_m ((f_v + f_int) T - b dx - M dv), against the integral of the power it is."""
    T, device = 5e-3, data.draw(held(problems))
    m, h = device.axes, device.operator.order
    fine = device.sampled(T / FINE)
    rng = np.random.default_rng(seed)
    state = rng.normal(size=fine.order)
    f_v, f_int, v_m = rng.normal(size=(3, m))
    u = np.concatenate([f_v + f_int, v_m])
    trajectory = [state]
    for _ in range(FINE):
        trajectory.append(fine.A @ trajectory[-1] + fine.B @ u)
    path = np.array(trajectory)
    x, v, xi, d = np.split(path, [m, 2 * m, 2 * m + h], axis=1)
    w = v - v_m
    f_h = xi @ device.operator.C.T + w @ device.operator.D.T + device.hand_damping * w + device.hand_stiffness * d

    def integral(power: np.ndarray) -> float:
        return float(cumulative_simpson(power, dx=T / FINE)[-1])

    intended = f_int @ (x[-1] - x[0]) - v_m @ (
        (f_v + f_int) * T - device.damping * (x[-1] - x[0]) - device.mass * (v[-1] - v[0])
    )
    scale = 1e-8 * (1.0 + np.abs(f_h).max() * np.abs(v).max())  # Simpson's rule on a smooth curve
    assert intended == pytest.approx(integral(v @ f_int - f_h @ v_m), abs=scale)
    # and with it, the energy of the mass is accounted for
    kinetic = 0.5 * device.mass @ (v[-1] ** 2 - v[0] ** 2)
    passive = integral(v @ f_v - v**2 @ device.damping - np.sum(f_h * w, axis=1))
    assert kinetic == pytest.approx(passive + intended, abs=scale)


@pytest.mark.parametrize(
    ("mass", "given_coupling", "largest"), [(0.2, False, 1.000508), (0.05, False, 1.00307), (0.2, True, 0.99885)]
)
def test_example_1_with_and_without_coupling(problems, mass: float, given_coupling: bool, largest: float) -> None:
    """theory.md's closed-loop eigenvalues; the largest except those of x and the tools at rest, which are 1."""
    T, h = problems.T, RationalMatrix((((problems.h),),)).realisation()
    device = held_device([mass] * 3, [1.37] * 3, _thrice(h), [0.0] * 3, [0.0] * 3)
    n = 2 * 3 + 3 * h.order  # without d, which an absent hand spring leaves unobserved
    sampled = device.sampled(T)
    G = StateSpace(sampled.A[:n, :n], sampled.B[:n, :3], sampled.C[:3, :n], np.zeros((3, 3)))
    V = problems.C26.realisation(T) if given_coupling else StateSpace.static(np.zeros((3, 3)))
    closed = problems.closed_loop(G, V, problems.network.environment(T))
    assert np.abs(np.linalg.eigvals(closed)).max() == pytest.approx(largest, abs=6e-6)


def _thrice(h: StateSpace) -> StateSpace:
    eye = np.eye(3)
    return StateSpace(np.kron(eye, h.A), np.kron(eye, h.B), np.kron(eye, h.C), np.kron(eye, h.D))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mass": [0.0]}, "1 positive masses"),
        ({"mass": [0.2, 0.2]}, "found 1 x 1; expected a 1 x 2 matrix"),
        ({"damping": [1.0, 2.0]}, "found 1 x 2; expected a 1 x 1 matrix"),
        ({"damping": [float("nan")]}, "finite"),
        ({"operator": StateSpace.static(np.eye(2))}, "operator of 1 x 1"),
    ],
)
def test_what_is_no_device_is_refused(change, words: str) -> None:
    plain = {
        "mass": [0.2],
        "damping": [1.0],
        "operator": StateSpace.static([[0.0]]),
        "hand_damping": [0.0],
        "hand_stiffness": [0.0],
    }
    with pytest.raises(ValueError, match=words):
        held_device(**{**plain, **change})
