"""The nodes' cores, against the transfer functions of the paper and the ledgers' promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.network import Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.environment.core import EnvironmentCore

from ..support.reaction import react

T = 1e-3
PARTITION = Partition(("a", "b"), ((0, 2), (1,)))  # blocks that are not contiguous
PORTS = ("p", "q", "r")
UNLIMITED = (np.inf,) * 3  # N


def network(stiffness: float, damping: float, mass: float) -> Network:
    links = [NetworkLink((port, "hub"), stiffness * (i + 1), damping) for i, port in enumerate(PORTS)]
    return Network(PORTS, (("hub", mass),), (*links, NetworkLink(("hub", "ground"), stiffness, damping)))


def coupling(stiffness: float, damping: float, cross: float) -> SpringDamper:
    K = stiffness * np.array([[1.0, 0, cross], [0, 1.2, 0], [cross, 0, 0.8]])
    return SpringDamper(K, damping * np.eye(3))


def closed_loop_response(E: StateSpace, V: StateSpace, x: np.ndarray) -> np.ndarray:
    """f_v = -(I + E V)^{-1} E x, by stacking E and V and solving their algebraic loop here, as one system."""
    loop = np.linalg.inv(np.eye(3) + E.D @ V.D)
    # states (eta, xi): f = -loop (C_E eta + D_E (x + C_V xi)), x_e = x + C_V xi + D_V f
    F_eta, F_xi, F_x = -loop @ E.C, -loop @ E.D @ V.C, -loop @ E.D
    A = np.block(
        [
            [E.A + E.B @ V.D @ F_eta, E.B @ (V.C + V.D @ F_xi)],
            [V.B @ F_eta, V.A + V.B @ F_xi],
        ]
    )
    B = np.vstack([E.B @ (np.eye(3) + V.D @ F_x), V.B @ F_x])
    return StateSpace(A, B, np.hstack([F_eta, F_xi]), F_x).simulate(x)


@settings(max_examples=30)
@given(
    stiffness=st.floats(10.0, 5000.0),
    damping=st.floats(0.0, 1.0),
    mass=st.floats(0.1, 5.0),
    K=st.floats(100.0, 2000.0),
    B=st.floats(0.01, 0.5),
    cross=st.floats(-0.5, 0.5),
    seed=st.integers(0, 2**16),
)
def test_split_over_parties_the_loop_is_the_papers(
    stiffness: float, damping: float, mass: float, K: float, B: float, cross: float, seed: int
) -> None:
    """The exchange p, f_v of three parties that see only their own data gives f_v = -(I + EV)^{-1} E x."""
    E = network(stiffness, damping, mass).environment(T)
    blocks = [part.realisation(T) for part in coupling(K, B, cross).restrict(PARTITION)]
    V = PARTITION.join(blocks)
    x = np.cumsum(np.random.default_rng(seed).normal(0.0, 1e-4, (200, 3)), axis=0)
    cores = [CouplingCore(block, np.zeros(block.D.shape), None, T, UNLIMITED[: len(block.D)]) for block in blocks]
    environment = EnvironmentCore(E, V.D, None, T)
    f, p = np.zeros_like(x), np.zeros(3)
    for k in range(len(x)):
        for core, ports in zip(cores, PARTITION.blocks, strict=True):
            p[list(ports)] = core.free_position(x[k, list(ports)])
        f[k] = react(environment, p)
        environment.settle()
        for core, ports in zip(cores, PARTITION.blocks, strict=True):
            core.absorb(f[k, list(ports)])
    expected = closed_loop_response(E, V, x)
    # both sum a few dozen products a tick over 200 ticks: 1e-9 leaves three digits for their different order
    np.testing.assert_allclose(f, expected, rtol=0, atol=1e-9 * np.max(np.abs(expected)))


def test_environment_refuses_a_singular_algebraic_loop() -> None:
    E = StateSpace.static(np.array([[2.0]]))
    with pytest.raises(ValueError, match="no unique solution"):
        EnvironmentCore(E, np.array([[-0.5]]), None, T)


def test_device_ledger_is_that_of_the_transformed_device() -> None:
    """T (F y - y Delta y), y = dx/T + K dF/T, K = T/(2 Delta), computed here by hand for two ticks."""
    core = DeviceCore(np.array([[2.0]]), np.array([[T / 4.0]]), T)
    K = T / 4.0
    core.sample(np.array([0.001]))
    core.apply(np.array([3.0]), 0.0)
    first = 0.001 / T + K * 3.0 / T
    core.sample(np.array([0.003]))
    core.apply(np.array([1.0]), 0.25)
    second = 0.002 / T - K * 2.0 / T
    expected = T * (3.0 * first - 2.0 * first**2) + T * (1.0 * second - 2.0 * second**2) + 0.25
    assert core.ledger.total == pytest.approx(expected, rel=1e-12)
    assert core.speed == pytest.approx(2.0)
    assert core.peak_speed == pytest.approx(2.0)


def test_a_broken_promise_shows_in_the_ledger() -> None:
    """A 'device' that moves against every force generates energy, and its ledger shows it."""
    core = DeviceCore(np.array([[1.0]]), np.array([[T / 2.0]]), T)
    for k in range(10):
        core.sample(np.array([-1e-3 * k]))
        core.apply(np.array([5.0]), 0.0)
    assert core.ledger.minimum < 0.0


def test_passive_parties_keep_their_ledgers_above_zero_for_any_signal() -> None:
    """Springs and dampers inside their level, driven by noise."""
    rng = np.random.default_rng(7)
    Delta_D, stiffness = 1.37, 700.0
    K = np.array([[T / 2.0 / Delta_D]])
    block = SpringDamper(np.array([[stiffness]]), np.array([[0.1]])).realisation(T)
    J = Delta_D - stiffness * T / 2.0
    level = Delta_D / J * (J + 0.1) / J * Delta_D - Delta_D  # the class's greatest level, a limit
    core = CouplingCore(block, K, np.array([[0.99 * level]]), T, UNLIMITED[:1])
    E = Network(("p",), (("m", 1.0),), (NetworkLink(("p", "m"), 3000.0, 0.1),)).environment(T)
    environment = EnvironmentCore(E, block.D, np.zeros((1, 1)), T)
    for _ in range(2000):
        f = np.array(environment.react(core.free_position(rng.normal(0.0, 1e-3, 1).tolist())))
        environment.settle()
        core.absorb(f)
    assert core.ledger is not None
    assert environment.ledger is not None
    assert core.ledger.minimum >= 0.0
    assert environment.ledger.minimum >= 0.0
    assert core.ledger.total > 0.0


def test_a_block_follows_the_force_that_is_applied() -> None:
    """Limited first: the state, the offset and the ledger are those of the clipped force."""
    block = SpringDamper(np.array([[700.0]]), np.array([[0.1]])).realisation(T)
    level, K = np.array([[0.5]]), np.array([[T / 2.74]])
    limited, free = (CouplingCore(block, K, level, T, (limit,)) for limit in (2.0, np.inf))
    for f, applied in ((1.5, 1.5), (9.0, 2.0), (-2.5, -2.0), (2.0, 2.0)):
        handed_on = limited.limited(np.array([f]))
        assert handed_on[0] == applied
        limited.absorb(handed_on)
        free.absorb(free.limited(np.array([applied])))
        assert limited.free_position(np.zeros(1)) == free.free_position(np.zeros(1))
    assert limited.ledger is not None
    assert free.ledger is not None
    assert limited.ledger.total == free.ledger.total
    assert (limited.saturated, free.saturated) == (2, 0)
