"""Stiffness against latency: the closed forms against condition (10), and Colgate's limit against its definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from manyhands.design.budget import (
    colgate_limit,
    environment_share,
    felt_over,
    needed_share,
    stiffest,
    stiffest_below,
)
from manyhands.design.errors import DesignError
from manyhands.design.levels.contract import loop_inequality
from manyhands.design.levels.device import device_share, greatest_share, least_gain
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.environment import DelayedNetwork, NetworkBox, StateSpaceEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperGiven
from manyhands.design.synthesis import design

T = 1e-3
DELAYS = st.floats(0.0, 1.0)


@pytest.mark.parametrize(
    ("tau", "certified", "colgate"), [(0.0, 2740.0, 2740.0), (0.25e-3, 1566.0, 1826.7), (1e-3, 685.0, 913.3)]
)
def test_reference_values(tau: float, certified: float, colgate: float) -> None:
    found = stiffest(np.array([[1.37]]), T, tau)
    assert found.certified == pytest.approx(certified, abs=0.5)
    assert found.colgate == pytest.approx(colgate, abs=0.05)
    assert found.kappa == pytest.approx(least_gain(tau / T))


def random_level(rng: np.random.Generator, m: int, low: float = 0.5, high: float = 5.0) -> Matrix:
    Q, _ = np.linalg.qr(rng.normal(size=(m, m)))
    M = Q @ np.diag(rng.uniform(low, high, m)) @ Q.T
    return (M + M.T) / 2.0


@given(st.integers(1, 4), DELAYS, st.floats(0.0, 0.95), st.integers(0, 2**32 - 1))
def test_just_below_the_limit_there_is_a_certified_coupling(m: int, tau_hat: float, part: float, seed: int) -> None:
    """K_s a little below Delta_D/(kappa T) in every direction, B below J: J, J - B > 0 and (10) hold."""
    rng = np.random.default_rng(seed)
    Delta_D = random_level(rng, m)
    values, vectors = np.linalg.eigh(Delta_D)
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    wanted = part * greatest_share(tau_hat)
    Phi = root @ (wanted * np.eye(m) - random_level(rng, m, 0.0, 1.5)) @ root
    Phi = (Phi + Phi.T) / 2.0
    share = needed_share(Delta_D, Phi)
    found = stiffest(Delta_D, T, tau_hat * T, share)
    assert found.kappa is not None
    kappa = found.kappa * 1.002  # inside by more than what 16 pieces cost, 1/4000
    left = device_share(kappa, tau_hat).share
    assume(left > share * 1.001)  # near the greatest share it turns back within those 0.2 %
    Lambda = Delta_D / (2.0 * kappa)
    J = 1e-6 * Lambda
    stiffness, B = 2.0 / T * (Lambda - J), 0.9 * J
    X = np.linalg.solve(J, Lambda)
    Delta_V = X.T @ (J + B) @ X - Lambda
    assert found.certified * 0.997 < np.linalg.eigvalsh(stiffness)[0] < found.certified
    assert np.linalg.eigvalsh(loop_inequality(left * Delta_D, (Delta_V + Delta_V.T) / 2.0, Phi))[0] > 0.0


@given(DELAYS, st.floats(0.0, 0.999), st.floats(0.0, 1.0))
def test_above_the_limit_there_is_none(tau_hat: float, part: float, place: float) -> None:
    """One port: for every kappa, either J < 0 or the environment takes more than the device keeps."""
    share = part * greatest_share(tau_hat)
    limit = stiffest(np.array([[2.0]]), T, tau_hat * T, share).certified
    kappa = least_gain(tau_hat) * (1.0 + 1e-3) * 10.0**place
    J = 2.0 / (2.0 * kappa) - T / 2.0 * limit * 1.002
    assert J < 0.0 or device_share(kappa, tau_hat).share <= share * (1.0 + 1e-9)


def test_what_an_environment_takes_costs_stiffness() -> None:
    level = np.array([[1.37]])
    limits = [stiffest(level, T, 0.3e-3, share).certified for share in (0.0, 0.1, 0.2, greatest_share(0.3), 0.5, 1.0)]
    assert limits[0] > limits[1] > limits[2] > 0.0
    assert limits[3:] == [0.0, 0.0, 0.0]
    assert stiffest(level, T, 0.3e-3, 0.5).kappa is None


@given(st.floats(0.0, 1.0), st.floats(1e-4, 1e-2), st.floats(0.1, 10.0))
@settings(max_examples=40)
def test_colgates_limit_is_where_his_condition_ends(tau_hat: float, T: float, b: float) -> None:
    """b = sup_w T/2 / (1 - cos wT) Re{(1 - e^-jwT) H}, H = k e^-jw tau, on a grid."""
    k = colgate_limit(b, T, tau_hat * T)
    w = np.pi / T * np.concatenate([np.logspace(-3.0, -1.0, 100), np.linspace(0.1, 1.0, 4000)])
    H = k * np.exp(-1j * w * tau_hat * T)
    # 1 - cos wT without cancellation; at the grid's low end the supremum, a limit, is missed by (w T)^2
    found = np.max(T / 2.0 / (2.0 * np.sin(w * T / 2.0) ** 2) * ((1.0 - np.exp(-1j * w * T)) * H).real)
    assert found == pytest.approx(b, rel=1e-5)
    assert found <= b * (1.0 + 1e-9)


@pytest.mark.parametrize("tau_hat", [0.0, 0.2, 0.6, 1.0])
def test_a_coupling_at_the_limit_is_stable_behind_the_delay(tau_hat: float) -> None:
    """A mass on its damper against a rigid world, held by springs of any stiffness: eigenvalues inside the circle."""
    b = 1.37
    k = 0.999 * stiffest(np.array([[b]]), T, tau_hat * T).certified
    for mass in b * T * np.logspace(-1.0, 4.0, 11):
        for hand in (0.0, 1.0, 1e3):
            A = np.array([[0.0, 1.0, 0.0], [-hand / mass, -b / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
            first, second = expm(A * tau_hat * T), expm(A * (1.0 - tau_hat) * T)
            # state (x, v, force of the tick before); f = -k x acts after tau
            old, new = np.diag([1.0, 1.0, 1.0]), np.array([[1.0, 0, 0], [0, 1.0, 0], [-k, 0, 0]])
            moved = first @ old
            closed = second @ np.vstack([moved[:2], new[2]])
            closed[2] = new[2]
            assert np.max(np.abs(np.linalg.eigvals(closed))) < 1.0


# --- what the environment takes


def test_needed_share_is_a_generalised_eigenvalue() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        Delta_D, Phi = random_level(rng, 3), random_level(rng, 3, -2.0, 2.0)
        s = needed_share(Delta_D, Phi)
        values = np.linalg.eigvalsh(s * Delta_D - Phi)
        assert values[0] == pytest.approx(0.0, abs=1e-12) or (s == 0.0 and values[0] > 0.0)
    assert needed_share(np.eye(2), -np.eye(2)) == 0.0


def test_a_network_takes_nothing(problems) -> None:
    assert environment_share(problems.network, 1.37 * np.eye(3), T) == 0.0


@pytest.mark.parametrize(("delay", "level"), [(1, 1.999), (2, 5.61)])
def test_example_1_late(problems, delay: int, level: float) -> None:
    """The Phi_E that Example 1 needs one and two ticks late, for equal devices."""
    share = environment_share(DelayedNetwork(problems.network, delay), 1.37 * np.eye(3), T)
    assert share * 1.37 == pytest.approx(level, abs=5e-3)
    assert stiffest(np.array([[1.37]]), T, 0.0, min(share, 1.0)).certified == 0.0


@pytest.mark.parametrize("width", [1e-6, 1e-4, 1e-2])
def test_a_narrow_peak_is_not_missed(width: float) -> None:
    """A resonance at the angle 0.7 that three ticks of delay turn over, against a fine search around it."""
    A = (1.0 - width) * np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    system = StateSpace(A, np.array([[1.0], [0.0]]), np.array([[1.0, 0.3]]), np.array([[100.0]]))
    environment = StateSpaceEnvironment(("p",), system, delay=3)
    found = environment_share(environment, np.array([[2.0]]), T)
    z = np.exp(1j * np.concatenate([0.7 + width * np.linspace(-3.0, 3.0, 6001), np.linspace(1e-4, np.pi, 3000)]))
    E_hat = T * z / (z - 1.0) * np.array([system.response(point)[0, 0] for point in z]) / z**3
    # between two points of the grid a smooth peak loses 1e-6 of its height
    assert found == pytest.approx(-np.min(E_hat.real) / 2.0, rel=1e-5)


def test_an_environment_that_is_passive_at_no_level() -> None:
    unsymmetric = StateSpaceEnvironment(("a", "b"), StateSpace.static([[2.0, 1.0], [0.0, 2.0]]))
    assert environment_share(unsymmetric, np.eye(2), T) == float("inf")


def test_a_mode_that_never_decays_takes_everything() -> None:
    """A free mass behind a damper, a tick late."""
    free = Network(
        ("p",), (("m", 1.0), ("n", 1.0)), (NetworkLink(("p", "m"), 50.0, 1.0), NetworkLink(("n", GROUND), 0.0, 0.0))
    )
    assert environment_share(free, np.eye(1), T) == 0.0
    rotor = StateSpace(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.ones((2, 1)), np.ones((1, 2)), np.array([[5.0]]))
    assert environment_share(StateSpaceEnvironment(("p",), rotor), np.eye(1), T) == float("inf")
    assert environment_share(DelayedNetwork(free, 1), np.eye(1), T) > 0.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.eye(1), 0.0, 0.0), "T: found 0.0 s"),
        ((np.eye(1), float("nan"), 0.0), "T: found nan s"),
        ((np.eye(1), T, 1.1 * T), "tau: found 0.0011"),
        ((np.eye(1), T, -1e-9), "tau: found -1e-09 s"),
        ((np.eye(1), T, 0.0, -0.1), "share: found -0.1"),
        ((np.eye(1), T, 0.0, float("inf")), "share: found inf"),
        ((np.diag([1.0, 0.0]), T, 0.0), "level: found the eigenvalue 0"),
    ],
)
def test_what_is_refused(arguments: tuple, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        stiffest(*arguments)


@given(st.integers(1, 3), st.floats(1e-3, 0.5), st.floats(1.0, 100.0), st.integers(0, 2**32 - 1))
def test_what_is_felt_over_a_wave_link(m: int, round_trip: float, scale: float, seed: int) -> None:
    """K and 2 b/R in series, M = b R/2; as stiff as this no linear passive link is lighter than K R^2/4."""
    rng = np.random.default_rng(seed)
    level, b = random_level(rng, m), random_level(rng, m, scale, 2.0 * scale)
    found = felt_over(level, T, 0.25e-3, b, round_trip)
    site = stiffest(level, T, 0.25e-3)
    assert found.coupling == site.certified
    assert 1.0 / found.felt == pytest.approx(1.0 / site.certified + round_trip / 2.0 / np.linalg.eigvalsh(b)[0])
    assert found.mass == pytest.approx(np.linalg.eigvalsh(b)[-1] * round_trip / 2.0)
    assert found.least_mass < found.mass
    assert found.naive == colgate_limit(float(np.linalg.eigvalsh(level)[0]), T, 0.25e-3 + round_trip)
    harvested = felt_over(level, T, 0.25e-3, b, round_trip, harvest=0.05 * np.eye(m))
    assert 0.0 < harvested.felt < found.felt  # what refills the tank is not there for stiffness
    assert felt_over(level, T, 0.25e-3, b, round_trip, harvest=100.0 * np.eye(m)).felt == 0.0


def test_a_round_trip_is_positive() -> None:
    with pytest.raises(ValueError, match=r"round trip: found 0\.0 s; expected a finite"):
        felt_over(np.eye(1), T, 0.0, np.eye(1), 0.0)


# --- dry friction as damping below a speed

WALL = Network(("a",), (), (NetworkLink(("a", GROUND), 50_000.0, 0.0),))
PAIR = Network(
    ("a", "b"),
    (("body", 0.3),),
    (
        NetworkLink(("a", "body"), 2000.0, 1.0),
        NetworkLink(("b", "body"), 500.0, 2.0),
        NetworkLink(("body", GROUND), 300.0, 4.0),
    ),
)
TORQUES = HeldTorque(8.2, 10.0, 1.0)


def with_friction(
    world: Environment, step: float, friction: tuple[float, ...], tau: float = 0.0, held: HeldTorque | None = None
) -> HapticLoop:
    """A device of 0.1 N*s/m at each port, a coupling each."""
    m = len(world.ports)
    devices = tuple(
        DeviceLevel(port, (i,), np.array([[0.1]]), held, (step,) if step else None, (c,) if c else None)
        for i, (port, c) in enumerate(zip(world.ports, friction, strict=True))
    )
    return HapticLoop("s", T, world.ports, devices, Partition(world.ports, tuple((i,) for i in range(m))), world, tau)


@pytest.mark.parametrize("tau", [0.0, 0.4e-3])
@pytest.mark.parametrize("speed", [0.02, 0.1])
def test_without_steps_friction_is_a_damping_of_c_by_the_speed(speed: float, tau: float) -> None:
    (limit,) = stiffest_below(with_friction(WALL, 0.0, (0.05,), tau), speed)
    assert limit.certified == pytest.approx((0.1 + 0.05 / speed) / (T / 2.0 + 1.5 * tau))
    a, b = stiffest_below(with_friction(PAIR, 0.0, (0.05, 0.0), tau), speed)
    assert a.certified == pytest.approx(limit.certified)
    assert b.certified == pytest.approx(0.1 / (T / 2.0 + 1.5 * tau))


@pytest.mark.parametrize(
    ("world", "step", "friction", "tau", "held"),
    [
        (WALL, 0.0, (0.05,), 0.2e-3, None),
        (WALL, 1e-5, (0.05,), 0.2e-3, TORQUES),
        (WALL, 6e-5, (0.1,), 0.1e-3, None),
        (PAIR, 1e-5, (0.05, 0.08), 0.2e-3, None),
        (DelayedNetwork(Network(("a",), (), (NetworkLink(("a", GROUND), 60.0, 0.0),)), 1), 0.0, (0.05,), 0.2e-3, None),
    ],
    ids=["exact", "torques", "coarse", "two devices", "a late world"],
)
@pytest.mark.parametrize("speed", [0.05, 0.5])
def test_below_a_speed_the_limit_is_the_greatest_that_is_proved(
    world: Environment, step: float, friction: tuple[float, ...], tau: float, held: HeldTorque | None, speed: float
) -> None:
    """Springs a little softer are certified with the friction kept that their steps ask for; stiffer ones are not."""
    loop = with_friction(world, step, friction, tau, held)
    limit = np.diag([row.certified for row in stiffest_below(loop, speed)])
    below = replace(loop, speed=speed)
    found = design(below, SpringDamperGiven(SpringDamper(0.96 * limit, 0.0 * limit))).certificate
    assert found.loop.speed == speed
    with pytest.raises(DesignError):
        design(below, SpringDamperGiven(SpringDamper(1.02 * limit, 0.0 * limit)))


def test_nothing_holds_below_a_speed_where_friction_does_not_pay_for_the_steps() -> None:
    for world, friction in (
        (WALL, (1e-4,)),  # less than K q/2 of the softest spring that there is reason for
        (PAIR, (0.05, 0.0)),  # the steps of each reach the other
        (NetworkBox(PAIR, PAIR), (0.05, 0.05)),  # no bound is proved over worlds
    ):
        limits = stiffest_below(with_friction(world, 6e-5, friction, 0.2e-3), 0.1)
        assert [row.certified for row in limits] == [0.0] * len(friction)
