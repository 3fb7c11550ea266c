"""The spring-damper class in closed form: its level, its emptiness, the centred and the stiffest member."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from manyhands.design.errors import Infeasible
from manyhands.design.levels.contract import margin_of
from manyhands.design.levels.spring_damper import ROOM, centred, greatest_level, stiffest
from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.statespace import Matrix, symmetric_part

T = 1e-3


def random_symmetric(rng: np.random.Generator, m: int, low: float, high: float) -> Matrix:
    Q, _ = np.linalg.qr(rng.normal(size=(m, m)))
    return symmetric_part(Q @ np.diag(rng.uniform(low, high, m)) @ Q.T)


def V_hat(coupling: SpringDamper, Lambda: Matrix, z: complex) -> np.ndarray:
    """(z-1)/(Tz) (V - K), from the physics."""
    s = (z - 1.0) / (T * z)
    return s * (np.linalg.inv(coupling.stiffness + coupling.damping * s) - T / 2.0 * np.linalg.inv(Lambda))


@given(st.integers(1, 3), st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_the_greatest_level_is_admissible_and_tight(m: int, seed: int) -> None:
    """He V_hat - V_hat^* Delta V_hat >= 0 on the circle at Delta_V*, and not a little above it, where z -> 1."""
    rng = np.random.default_rng(seed)
    Lambda = random_symmetric(rng, m, 0.5, 3.0)
    root = np.linalg.cholesky(Lambda)
    J = symmetric_part(root @ random_symmetric(rng, m, 0.1, 0.9) @ root.T)
    B = symmetric_part(J - root @ random_symmetric(rng, m, 0.02, 0.6) @ root.T)
    coupling = SpringDamper(symmetric_part(2.0 / T * (Lambda - J)), B)
    level = greatest_level(coupling, Lambda, T)
    angles = np.concatenate([np.logspace(-6, -1, 30), np.linspace(0.1, np.pi, 60)])
    for angle in angles:
        H = V_hat(coupling, Lambda, np.exp(1j * angle))
        X = np.linalg.inv(H)  # He(H) >= H^* D H is He(H^{-1}) >= D
        least = np.linalg.eigvalsh((X + X.conj().T) / 2.0 - level)[0]
        # V - K is a difference of near ones of size K; the inverse of H has the size 1/(angle J)
        assert least > -1e-9 * np.linalg.norm(X) - 1e-9 * np.linalg.norm(level), (angle, least)
    X = np.linalg.inv(V_hat(coupling, Lambda, np.exp(1e-4j)))
    tight = np.linalg.eigvalsh((X + X.conj().T) / 2.0 - level)
    assert np.abs(tight).max() < 1e-3 * (1.0 + np.linalg.norm(level) + np.linalg.norm(Lambda))


@given(st.data())
@settings(max_examples=40, phases=[Phase.generate])
def test_a_member_satisfies_10_with_its_greatest_level(data: st.DataObject) -> None:
    m = data.draw(st.integers(1, 3))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    Delta_D = random_symmetric(rng, m, 0.5, 3.0)
    kappa = data.draw(st.sampled_from([0.5, 0.7, 1.1]))
    share = 1.0 if kappa == 0.5 else data.draw(st.floats(0.3, 0.9)) / (2.0 * kappa)
    Lambda, part = symmetric_part(Delta_D / (2.0 * kappa)), 2.0 * kappa * share
    need = data.draw(st.floats(-0.5, 0.9)) * share
    Phi_E = symmetric_part(need * Delta_D)
    for find in (centred, stiffest):
        try:
            member = find(Lambda, Phi_E, part, T, "c")
        except Infeasible:
            assert need > 0.8 * share  # so near to what the device gives that no room is left
            continue
        level = greatest_level(member.coupling, Lambda, T)
        assert margin_of(share * Delta_D, level, Phi_E) > 0.0
        J = Lambda - T / 2.0 * member.coupling.stiffness
        S = np.linalg.inv(np.linalg.cholesky(Lambda))
        for X in (J, J - member.coupling.damping, member.coupling.stiffness * T / 2.0):
            assert np.linalg.eigvalsh(S @ X @ S.T)[0] > 0.5 * ROOM
        assert member.distance > 0.0


@pytest.mark.parametrize("find", [centred, stiffest])
@pytest.mark.parametrize("part", [1.0, 0.7])
@pytest.mark.parametrize("phi", [-0.5, 0.0, 0.4])
def test_one_port_by_hand_is_one_port_by_program(find, part: float, phi: float) -> None:
    """The curve that one port is solved on against the same port twice in a program: a 2 x 2 block."""
    one = find(np.array([[1.37]]), np.array([[phi]]), part, T, "c")
    two = find(1.37 * np.eye(2), phi * np.eye(2), part, T, "c")
    # Clarabel's accuracy on the optimum; where the optimum is flat, its argument has the root of that
    np.testing.assert_allclose(np.diag(two.coupling.stiffness), one.coupling.stiffness[0, 0], rtol=1e-3)
    assert two.distance == pytest.approx(one.distance, rel=1e-5)


def test_an_environment_needing_more_than_the_device_has_empties_the_class() -> None:
    with pytest.raises(Infeasible, match=r"coupling c: .* exceeds the device's level by 0\.46 of it"):
        centred(np.array([[1.37]]), np.array([[2.0]]), 1.0, T, "c")
    with pytest.raises(Infeasible, match="coupling c"):
        stiffest(1.37 * np.eye(2), 1.3699 * np.eye(2), 1.0, T, "c")


def test_the_stiffest_is_the_limit_less_its_room() -> None:
    found = stiffest(np.array([[1.37]]), np.array([[0.0]]), 1.0, T, "c")
    assert found.coupling.stiffness[0, 0] == pytest.approx(2740.0 * (1.0 - ROOM), rel=1e-6)


def test_nothing_in_the_class_is_further_inside_than_the_centred() -> None:
    """A search at random over (J, B) for one port never gets further than the centre."""
    rng = np.random.default_rng(3)
    part, phi = 0.8, 0.2
    best = centred(np.eye(1), np.array([[phi]]), part, T, "c").distance
    for _ in range(4000):
        J, B = rng.uniform(0.0, 1.0), rng.uniform(-1.0, 1.0)
        form = np.array([[part - phi, -part * J, 0.0], [-part * J, J + B, np.sqrt(1 - part) * J], [0.0, 0.0, 1.0]])
        form[2, 1] = form[1, 2]
        assert min(J, J - B, 1.0 - J, np.linalg.eigvalsh(form)[0]) <= best + 1e-12
