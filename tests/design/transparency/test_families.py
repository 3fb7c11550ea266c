"""The parts of the transparency programs: weighted loops, bases, families and their derivatives, small programs."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.coupling import Partition
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.design.models.weights import Filter, Transparency, WeightedLoop, weighted
from manyhands.design.passivity.hinfinity import hinf_norm
from manyhands.design.solver import LinearMatrixProgram, ProgramInfeasible, coefficients
from manyhands.design.transparency.families import (
    FixedPoleBlock,
    FixedPoleFamily,
    NormalisedLoop,
    PoleBasis,
    SpringDamperFamily,
    symmetric_units,
)
from manyhands.design.transparency.free_poles import FreePoleFamily, PoleShape, fitted, section
from manyhands.design.transparency.minimax import Family, peaks

ANGLES = np.array([0.0, 0.003, 0.05, 0.4, 1.7, 3.1])
W1 = Filter.from_continuous((1.0,), (1.0 / 125.0, 1.0), 1e-3)
W2 = Filter((0.5, 0.3), (1.0, -0.4))
DELTA_D = np.array([[1.5, 0.0, 0.3], [0.0, 0.7, 0.0], [0.3, 0.0, 2.2]])
PARTITION = Partition(("outer", "inner"), ((2, 0), (1,)))


def normalised(problems: Any, objective: Any) -> NormalisedLoop:
    E = problems.network.environment(problems.T)
    return NormalisedLoop(E, DELTA_D, 0.7, problems.T, PARTITION, Transparency(objective, W1, W2))


# --- the weighted loop


@pytest.mark.parametrize("objective", ["loop-shaping", "closed-loop"])
def test_the_weighted_system_is_the_equation(problems: Any, objective: Any) -> None:
    E, V = problems.network.environment(problems.T), problems.C27.realisation(problems.T)
    aim = Transparency(objective, W1, W2)
    system = weighted(E, V, aim)
    for angle in ANGLES:
        z = np.exp(1j * angle)
        e, v, w = E.response(z), V.response(z), W1.response(np.array(z)) * W2.response(np.array(z))
        F = np.linalg.solve(np.eye(3) + e @ v, e)
        expected = w * e @ v if objective == "loop-shaping" else w * (F - e)
        np.testing.assert_allclose(system.response(z), expected, rtol=1e-7, atol=1e-9 * np.max(np.abs(expected)))
        found = WeightedLoop(E, aim).factors(v[None], np.array([angle]))[0][0]
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9 * np.max(np.abs(expected)))


def test_states_pass_in_the_order_of_the_signal(problems: Any) -> None:
    E, V = problems.network.environment(problems.T), problems.C26.realisation(problems.T)
    A = weighted(E, V, Transparency("loop-shaping", W1, W2)).A
    edges = np.cumsum([0, 3, V.order, E.order, 3])
    blocks = [A[a:b, a:b] for a, b in pairwise(edges)]
    for block, expected in zip(blocks, [W2.realisation(3).A, V.A, E.A, W1.realisation(3).A], strict=True):
        np.testing.assert_array_equal(block, expected)
    assert not np.any(np.triu(A, 1)[:3, 3:])
    A = weighted(E, V, Transparency("closed-loop", W1, W2)).A
    np.testing.assert_array_equal(A[3 : 3 + E.order, 3 : 3 + E.order], E.A)
    assert len(A) == 3 + 2 * E.order + V.order + 3


def test_what_does_not_fit_is_refused(problems: Any) -> None:
    E = problems.network.environment(problems.T)
    aim = Transparency("closed-loop", W1, W2)
    with pytest.raises(ValueError, match="found 'loopshaping'; expected 'loop-shaping' or 'closed-loop'"):
        Transparency("loopshaping", W1, W2)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="found E of 3 outputs and V of 2 x 2; expected 3 ports"):
        weighted(E, StateSpace.static(np.eye(2)), aim)
    with pytest.raises(ValueError, match=r"I \+ D_E D_V is singular"):
        weighted(E, StateSpace.static(-np.linalg.inv(E.D)), aim)
    with pytest.raises(ValueError, match="joins no ports of different blocks"):
        NormalisedLoop(E, DELTA_D, 0.5, 1e-3, problems.decentralised)
    with pytest.raises(ValueError, match="coupling outer: found a least eigenvalue -1"):
        NormalisedLoop(E, np.diag([1.0, 1.0, -1.0]), 0.5, 1e-3, PARTITION)
    with pytest.raises(ValueError, match="found E of 3 x 3 and Delta_D of 2 x 2"):
        NormalisedLoop(E, np.eye(2), 0.5, 1e-3, PARTITION)
    with pytest.raises(ValueError, match=r"found the period 0\.001 and kappa 0"):
        NormalisedLoop(E, np.eye(3), 0.0, 1e-3, PARTITION)
    floating = StateSpace(np.eye(1), np.ones((1, 3)), np.ones((3, 1)), np.eye(3))
    with pytest.raises(ValueError, match="environment: found a pole of modulus 1; expected a stable E"):
        NormalisedLoop(floating, DELTA_D, 0.5, 1e-3, PARTITION)


# --- bases


@st.composite
def bases(draw: st.DrawFn) -> PoleBasis:
    poles: list[complex] = [complex(p) for p in draw(st.lists(st.floats(-0.9, 0.999), max_size=3))]
    for radius, angle in draw(st.lists(st.tuples(st.floats(0.1, 0.9999), st.floats(0.01, 3.0)), max_size=3)):
        p = complex(radius * np.exp(1j * angle))
        poles += [p, p.conjugate()]
    if poles and draw(st.booleans()):
        poles += poles  # every one twice
    return PoleBasis(tuple(poles))


@given(bases())
def test_a_basis_is_orthonormal_and_has_its_poles(basis: PoleBasis) -> None:
    a, b = basis.realisation
    np.testing.assert_allclose(a @ a.T + b @ b.T, np.eye(basis.order), atol=1e-7)
    for z in (1.3, -1.1 + 0.2j):  # the characteristic polynomial: eigenvalues of multiple poles are not to be compared
        expected = np.prod([z - p for p in basis.poles])
        assert abs(np.linalg.det(z * np.eye(basis.order) - a) - expected) <= 1e-7 * abs(expected) + 1e-9
    np.testing.assert_allclose(
        basis.functions(ANGLES[1:2])[0],
        np.linalg.solve(np.exp(1j * ANGLES[1]) * np.eye(basis.order) - a, b)[:, 0],
        atol=1e-9 * np.max(np.abs(basis.functions(ANGLES[1:2])), initial=1.0),
    )


@pytest.mark.parametrize(
    ("poles", "message"),
    [
        ((1.0 + 0j,), "expected one inside the unit circle"),
        ((0.5 + 0.1j,), "found none; expected its conjugate next"),
        ((0.5 + 0.1j, 0.5 + 0.1j), "expected its conjugate next"),
        ((complex("nan"),), "expected one inside"),
    ],
)
def test_poles_that_are_no_basis(poles: tuple[complex, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PoleBasis(poles)


def osp_slack(block: StateSpace, K: Matrix, Delta: Matrix, T: float) -> float:
    """Least eigenvalue of He V_hat - V_hat^* Delta V_hat over the unit circle, part by part of |z - 1|^2."""
    worst = np.inf
    for angle in np.concatenate([np.geomspace(1e-4, np.pi, 400), np.linspace(0.02, 0.2, 200)]):
        z = np.exp(1j * angle)
        V_hat = (z - 1.0) / (T * z) * (block.response(z) - K)
        slack = (V_hat + V_hat.conj().T) / 2.0 - V_hat.conj().T @ Delta @ V_hat
        worst = min(worst, float(np.linalg.eigvalsh(slack)[0]) / abs(z - 1.0) ** 2)
    return worst


@settings(max_examples=30)
@given(bases(), st.integers(1, 2), st.integers(0, 2**32 - 1))
def test_conditions_are_lemma_1_of_v_hat(basis: PoleBasis, ports: int, seed: int) -> None:
    """Whatever the unknowns, Pi and M are those of f^T y - y^T Delta y >= storage difference along trajectories."""
    rng = np.random.default_rng(seed)
    level = np.diag(rng.uniform(0.1, 1.0, ports))
    block = FixedPoleBlock(basis, ports, 0.6, level)
    x = rng.normal(size=block.size)
    C, D, P = block.unpack(x)
    np.testing.assert_array_equal(block.pack(C, D, P), x)
    v = block.realisation(x)
    static = v.D + v.C @ np.linalg.solve(np.eye(v.order) - v.A, v.B)
    np.testing.assert_allclose(static, static.T, rtol=1e-9, atol=1e-9)
    n = v.order
    P_12 = np.linalg.solve((v.A - np.eye(n)).T, v.C.T / 2.0)
    Pi = np.block([[P, P_12], [P_12.T, (static - 0.6 * np.eye(ports)) / 2.0]])
    f = rng.normal(size=(6, ports))  # from rest
    states = [np.zeros(n)]
    for u in f:
        states.append(v.A @ states[-1] + v.B @ u)
    supply = block._supply(x)
    M, side = supply[: n + ports, : n + ports], supply[: n + ports, n + ports :]
    size = np.max(np.abs(Pi)) * np.max(np.abs(states), initial=1.0) ** 2
    for k in range(1, 5):
        zeta, ahead = states[k] - states[k - 1], states[k + 1] - states[k]
        phi = f[k] - f[k - 1]
        y = v.C @ zeta + (v.D - 0.6 * np.eye(ports)) @ phi
        before, after = np.concatenate([zeta, f[k - 1]]), np.concatenate([ahead, f[k]])
        growth = after @ Pi @ after - before @ Pi @ before
        w = np.concatenate([zeta, phi])
        assert abs(f[k] @ y - growth - w @ M @ w) <= 1e-8 * size
        assert y @ level @ y == pytest.approx(w @ side @ side.T @ w, rel=1e-7, abs=1e-9)


# --- families


def families(problems: Any, objective: Any) -> list[tuple[Family, Matrix]]:
    rng = np.random.default_rng(1)
    basis = PoleBasis((0.9 + 0.1j, 0.9 - 0.1j, 0.3 + 0j))
    here = normalised(problems, objective)
    fixed = FixedPoleFamily(
        here, (FixedPoleBlock(basis, 2, 0.7, np.eye(2)), FixedPoleBlock(PoleBasis(()), 1, 0.7, np.eye(1))), 1e-6
    )
    free = FreePoleFamily(here, (PoleShape(1, True, 2), PoleShape(2, False, 1)), (0.1 * np.eye(2), 0.2 * np.eye(1)))
    spring = SpringDamperFamily(here, np.diag([0.1, -0.2, 0.3]), 0.6)
    return [(family, rng.normal(size=family.size)) for family in (fixed, free, spring)]


@pytest.mark.parametrize("objective", ["loop-shaping", "closed-loop"])
def test_derivatives(problems: Any, objective: Any) -> None:
    h = 1e-6
    for family, x in families(problems, objective):
        slopes = family.derivatives(x, ANGLES)
        for k, unit in enumerate(np.eye(family.size)):
            numeric = (family.responses(x + h * unit, ANGLES) - family.responses(x - h * unit, ANGLES)) / (2.0 * h)
            analytic = slopes[:, k] if k < slopes.shape[1] else np.zeros_like(numeric)
            scale = max(float(np.max(np.abs(slopes))), 1.0)
            np.testing.assert_allclose(numeric, analytic, atol=1e-6 * scale, rtol=1e-4)


def test_derivatives_of_the_passivity_of_free_poles(problems: Any) -> None:
    (_, _), (family, x), _ = families(problems, "loop-shaping")
    assert isinstance(family, FreePoleFamily)
    h = 1e-6
    for i, part in enumerate(family.parts(x)):
        _, slopes = family.passivity(i, part, ANGLES[1:])
        for k, unit in enumerate(np.eye(len(part))):
            up, down = (family.passivity(i, part + sign * h * unit, ANGLES[1:])[0] for sign in (1.0, -1.0))
            np.testing.assert_allclose(
                (up - down) / (2.0 * h), slopes[:, k], rtol=1e-4, atol=1e-5 * np.max(np.abs(slopes))
            )


def test_passivity_of_free_poles_is_that_of_v_hat(problems: Any) -> None:
    (_, _), (family, x), _ = families(problems, "loop-shaping")
    assert isinstance(family, FreePoleFamily)
    for i, part in enumerate(family.parts(x)):
        value, _ = family.passivity(i, part, ANGLES[1:])
        v, _ = family.block(i, part, ANGLES[1:])
        for angle, found, response in zip(ANGLES[1:], value, v, strict=True):
            V_hat = (1.0 - np.exp(-1j * angle)) * (response - 0.7 * np.eye(len(response)))
            slack = (V_hat + V_hat.conj().T) / 2.0 - V_hat.conj().T @ family.levels[i] @ V_hat
            np.testing.assert_allclose(found * abs(np.exp(1j * angle) - 1.0) ** 2, slack, rtol=1e-6, atol=1e-9)


def test_restored_couplings_are_passive(problems: Any) -> None:
    """D pays for what is missing; what cannot be repaired is given up."""
    shapes, levels = (PoleShape(1, True, 2), PoleShape(2, False, 1)), (1e-3 * np.eye(2), 1e-3 * np.eye(1))
    family = FreePoleFamily(normalised(problems, "loop-shaping"), shapes, levels)
    rng = np.random.default_rng(2)
    repaired = 0
    for _ in range(20):
        x = np.concatenate(
            [0.7 * np.ones(n) + 0.15 * rng.normal(size=n) for n in (shape.size for shape in family.shapes)]
        )
        for part, shape in zip(family.parts(x), family.shapes, strict=True):
            part[: shape.poles] -= 3.0  # slow poles
        assert min(family.tightest(i, part)[1][0] for i, part in enumerate(family.parts(x))) < 0.0
        x = family.restored(x)
        if x is not None:
            repaired += 1
            assert all(family.tightest(i, part)[1][0] >= 0.0 for i, part in enumerate(family.parts(x)))
    assert repaired >= 10


def test_free_and_fixed_poles_meet_in_the_same_coupling() -> None:
    shape = PoleShape(1, True, 2)
    logs = np.concatenate([section(0.05, 0.1), [-1.0]])
    basis = shape.basis(np.concatenate([logs, np.zeros(shape.size - 3)]))
    block = FixedPoleBlock(basis, 2, 0.5, np.eye(2))
    x = np.random.default_rng(0).normal(size=block.size)
    angles = np.geomspace(1e-3, 3.0, 60)
    v = np.tensordot(block.derivatives(angles), x[: block.gains], axes=((1,), (0,)))
    np.testing.assert_allclose(v, np.stack([block.realisation(x).response(np.exp(1j * a)) for a in angles]), rtol=1e-8)
    y = fitted(shape, logs, v, angles)
    f, _ = shape.functions(y, angles)
    gains = np.tensordot(y[3:].reshape(4, -1), symmetric_units(2), axes=1)
    np.testing.assert_allclose(np.tensordot(f, gains, axes=1), v, rtol=1e-6, atol=1e-7)


def test_the_class_of_spring_dampers_is_its_closed_form(problems: Any) -> None:
    """(*) is (10) at the greatest level Delta_V*, here with delay (share and kappa of their own)."""
    (_, _), (_, _), (family, _) = families(problems, "loop-shaping")
    assert isinstance(family, SpringDamperFamily)
    rng = np.random.default_rng(4)
    Lambda, T = DELTA_D / 1.4, problems.T
    S = PARTITION.embed(family.loop.scaling)
    Phi_E = np.linalg.inv(S) @ family.Phi @ np.linalg.inv(S)
    seen = set()
    for _ in range(3000):
        coupling = family.coupling(rng.normal(size=family.size) * 0.3 + 0.4)
        x = family_unknowns(family, coupling, T)
        J = Lambda - T / 2.0 * coupling.stiffness
        if min(np.linalg.eigvalsh(M)[0] for M in (coupling.stiffness, J, J - coupling.damping)) <= 1e-3:
            continue
        X = np.linalg.solve(J, Lambda)
        Delta_V = X.T @ (J + coupling.damping) @ X - Lambda
        condition = np.block([[0.6 * DELTA_D - Phi_E, -Phi_E], [-Phi_E, Delta_V - Phi_E]])
        holds = np.linalg.eigvalsh(condition)[0]
        ours = np.linalg.eigvalsh(family.conditions(x)[-1])[0]
        if abs(ours) > 1e-4:  # the room that the conditions keep is 7e-6
            assert (ours > 0.0) == (holds > 0.0)
            seen.add(ours > 0.0)
    assert seen == {True, False}


def family_unknowns(family: SpringDamperFamily, coupling: Any, T: float) -> Matrix:
    parts = []
    for K, B, S in zip(
        PARTITION.restrict(coupling.stiffness), PARTITION.restrict(coupling.damping), family.loop.scaling, strict=True
    ):
        rows, columns = np.tril_indices(len(S))
        parts += [(T * S @ K @ S)[rows, columns], (S @ B @ S)[rows, columns]]
    return np.concatenate(parts)


@pytest.mark.parametrize("objective", ["loop-shaping", "closed-loop"])
def test_no_peak_is_missed(problems: Any, objective: Any) -> None:
    """Also not those of the closed loop, whose poles are neither E's nor V's."""
    links = (NetworkLink(("p", "m"), 3000.0, 0.002), NetworkLink(("m", GROUND), 2000.0, 0.002))
    E = Network(("p",), (("m", 20.0),), links).environment(1e-4)
    aim, one = Transparency(objective, Filter.one(), Filter.one()), Partition(("c",), ((0,),))
    here = NormalisedLoop(E, np.eye(1), 0.5, 1e-4, one, aim)
    springs = SpringDamperFamily(here, np.zeros((1, 1)), 1.0)
    block = FixedPoleBlock(PoleBasis((0.5 + 0j,)), 1, 0.5, np.eye(1))
    fixed = FixedPoleFamily(here, (block,), 1e-6)
    for k in np.geomspace(0.001, 1.9, 12):
        x = np.array([k, 1e-5])
        gamma, _ = hinf_norm(weighted(E, springs.coupling(x).realisation(1e-4), aim))
        assert peaks(springs, x)[1][0] == pytest.approx(gamma, rel=1e-4)
        y = fixed.joined([block.pack(np.zeros((1, 1)), np.array([[1.0 / k]]), np.eye(1))])
        gamma, _ = hinf_norm(weighted(E, fixed.coupling(y), aim))
        assert peaks(fixed, y)[1][0] == pytest.approx(gamma, rel=1e-4)


# --- programs given as numbers


def test_a_program_with_every_kind_of_constraint() -> None:
    """max x + y: x <= 1 (linear), |(x, y)| <= sqrt 2 (cone), Hermitian [1, i y; -i y, 1] >= 0 (|y| <= 1)."""
    program = LinearMatrixProgram(2)
    program.nonnegative(np.array([1.0]), np.array([[-1.0, 0.0]]))
    program.second_order(np.array([np.sqrt(2.0), 0.0, 0.0]), np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    imaginary = np.array([[0.0, 1j], [-1j, 0.0]])
    program.hermitian(np.eye(2, dtype=complex), np.stack([np.zeros((2, 2)), imaginary]).astype(complex))
    x = program.solve(np.array([-1.0, -1.0]), "test")
    np.testing.assert_allclose(x, [1.0, 1.0], atol=1e-4)
    program.positive(np.array([[-2.0]]), np.ones((2, 1, 1)) * 0.5)
    with pytest.raises(ProgramInfeasible, match="test"):
        program.solve(np.array([-1.0, -1.0]), "test")


def test_coefficients_of_an_affine_function() -> None:
    constant, linear = coefficients(lambda x: np.array([[1.0 + x[0], 2.0 * x[1]], [2.0 * x[1], 3.0]]), 2)
    np.testing.assert_array_equal(constant, [[1.0, 0.0], [0.0, 3.0]])
    np.testing.assert_array_equal(linear, [[[1.0, 0.0], [0.0, 0.0]], [[0.0, 2.0], [2.0, 0.0]]])
