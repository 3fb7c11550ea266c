"""Environments of every kind: frequency response, split, and the passivity that each method keeps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.errors import Infeasible
from manyhands.design.models.environment import DelayedNetwork, NetworkBox, StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.integrators import split_system
from manyhands.design.models.network import GROUND, METHODS, Network, NetworkLink, discretise
from manyhands.design.models.statespace import StateSpace, matrix

T = 1e-3
CIRCLE = np.exp(1j * np.array([0.003, 0.05, 0.4, 1.3, 2.7, 3.1]))


def transformed(environment, z: complex) -> np.ndarray:
    """E_hat = Tz/(z-1) E, from E itself."""
    return T * z / (z - 1.0) * environment.environment(T).response(z)


def from_split(environment, z: complex) -> np.ndarray:
    split = environment.split(T)
    return T / (z - 1.0) * split.stiffness + split.rest.response(z)


def one_port(k: float = 100.0, b: float = 1.0, mass: float = 0.5) -> TransferEnvironment:
    return TransferEnvironment(("a",), (((((mass, b, k)), (1.0,)),),))


@given(st.data())
def test_a_network_is_its_split_at_every_frequency(problems, data: st.DataObject) -> None:
    network = data.draw(problems.networks())
    delay = data.draw(st.integers(0, 3))
    environment = DelayedNetwork(network, delay) if delay else network
    split = environment.split(T)
    assert split.rest.order <= environment.order
    assert np.abs(np.linalg.eigvals(split.rest.A)).max(initial=0.0) < 1.0
    # what is compared has the size of stiffness over |z - 1|; near z = 1 that is where digits go
    scale = max(np.abs(network.stiffness_matrix()).max(initial=0.0), 1.0)
    for z in CIRCLE:
        allowed = 1e-9 * scale * T / abs(z - 1.0) + 1e-9
        np.testing.assert_allclose(from_split(environment, z), transformed(environment, z), rtol=1e-7, atol=allowed)


@given(st.data())
def test_matrices_split_as_the_network_they_come_from(problems, data: st.DataObject) -> None:
    network = data.draw(problems.networks(tied=True))
    if np.abs(np.linalg.eigvals(network.environment(T).A)).max(initial=0.0) > 1.0 - 1e-9:
        return  # masses that drift freely have a pole at 1, which matrices may not have
    given_ = StateSpaceEnvironment(network.ports, network.environment(T))
    stiffness, other = network.split(T).stiffness, given_.split(T).stiffness
    scale = max(np.abs(network.stiffness_matrix()).max(), 1.0)
    np.testing.assert_allclose(other, stiffness, atol=1e-6 * scale)
    for z in CIRCLE:
        np.testing.assert_allclose(
            from_split(given_, z), transformed(network, z), rtol=1e-6, atol=1e-6 * scale * T / abs(z - 1.0)
        )


def test_transfer_functions_are_the_network_that_they_describe() -> None:
    """k + b s + M s^2 by backward Euler: a mass on a spring at the port, link by link."""
    environment = one_port()
    for z in CIRCLE:
        s = (z - 1.0) / (T * z)
        np.testing.assert_allclose(environment.environment(T).response(z), [[100.0 + s + 0.5 * s * s]], rtol=1e-9)
    assert environment.split(T).stiffness == pytest.approx(100.0)


@pytest.mark.parametrize("method", METHODS)
def test_each_method_keeps_its_definition(method: str) -> None:
    A = np.array([[0.0, 1.0], [-900.0, -8.0]])
    system = StateSpace(A, np.array([[0.0], [1.0]]), np.array([[200.0, 3.0]]), np.array([[50.0]]))
    discrete = StateSpaceEnvironment(("a",), system, method).environment(T)
    for z in CIRCLE[:3]:
        if method == "zoh":
            # held inputs: the poles are exp(pole T), and the static gain is kept
            np.testing.assert_allclose(
                np.sort(np.linalg.eigvals(discrete.A)), np.sort(np.exp(np.linalg.eigvals(A) * T)), rtol=1e-9
            )
            np.testing.assert_allclose(discrete.response(1.0), system.response(0.0), rtol=1e-9)
        else:
            s = (z - 1.0) / (T * z) if method == "backward-euler" else 2.0 / T * (z - 1.0) / (z + 1.0)
            np.testing.assert_allclose(discrete.response(z), system.response(s), rtol=1e-9)


@pytest.mark.parametrize(("method", "passive"), [("backward-euler", True), ("tustin", False), ("zoh", True)])
def test_the_passivity_that_a_method_keeps_or_loses(method: str, passive: bool) -> None:
    """A mass on a spring behind the port, hardly damped: E = k M s^2 / (M s^2 + b s + k)."""
    k, b, M = 5000.0, 0.01, 0.02
    A = np.array([[0.0, 1.0], [-k / M, -b / M]])
    C = np.array([[-k * k / M, -k * b / M]])
    system = StateSpace(A, np.array([[0.0], [1.0]]), C, np.array([[k]]))
    environment = StateSpaceEnvironment(("a",), system, method)
    angles = np.linspace(0.01, np.pi - 0.01, 800)
    least = min(transformed(environment, np.exp(1j * angle)).real.min() for angle in angles)
    assert (least > -1e-9) == passive, least


def test_improper_entries_need_backward_euler() -> None:
    environment = TransferEnvironment(("a",), one_port().entries, "tustin")
    with pytest.raises(Infeasible, match="pole of modulus 1"):
        environment.split(T)


def test_what_is_passive_at_no_level_is_refused() -> None:
    unstable = StateSpace(np.array([[1.01]]), np.eye(1), np.eye(1), np.zeros((1, 1)))
    with pytest.raises(Infeasible, match=r"not stable: it has a pole of modulus 1\.01"):
        split_system(unstable, T)
    with pytest.raises(Infeasible, match=r"static stiffness E\(1\) is not symmetric"):
        split_system(StateSpace.static([[1.0, 2.0], [0.0, 1.0]]), T)
    with pytest.raises(Infeasible, match=r"negative eigenvalue -3 N/m"):
        split_system(StateSpace.static([[-3.0]]), T)


def test_a_box_has_ends_in_order_and_runs_its_middle() -> None:
    def network(k: float, b: float, mass: float) -> Network:
        return Network(("a",), (("m", mass),), (NetworkLink(("a", "m"), k, b), NetworkLink(("m", GROUND), 10.0, 0.0)))

    low, high = network(80.0, 0.5, 1.0), network(120.0, 1.5, 3.0)
    box = NetworkBox(low, high)
    assert box.nominal == network(100.0, 1.0, 2.0)
    assert box.passive_network == low
    np.testing.assert_array_equal(box.environment(T).D, network(100.0, 1.0, 2.0).environment(T).D)
    with pytest.raises(ValueError, match="lower end"):
        NetworkBox(high, low)
    with pytest.raises(ValueError, match="same structure"):
        NetworkBox(low, Network(("a",), (), (NetworkLink(("a", GROUND), 500.0, 2.0),)))


def test_a_delay_is_the_same_force_later() -> None:
    network = Network(("a", "b"), (), (NetworkLink(("a", "b"), 100.0, 1.0), NetworkLink(("b", GROUND), 50.0, 0.0)))
    inputs = matrix(np.random.default_rng(1).normal(size=(20, 2)))
    on_time = network.environment(T).simulate(inputs)
    late = DelayedNetwork(network, 3).environment(T).simulate(inputs)
    np.testing.assert_allclose(late[3:], on_time[:-3], rtol=1e-12)
    assert not np.any(late[:3])


def test_discretise_refuses_a_period_that_its_poles_forbid() -> None:
    system = StateSpace(np.array([[1.0 / T]]), np.eye(1), np.eye(1), np.zeros((1, 1)))
    with pytest.raises(Infeasible, match=r"backward-euler: I - 0\.001 A is singular"):
        discretise(system, "backward-euler", T)
