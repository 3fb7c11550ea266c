"""Environments: backward Euler of the physical network, passive with the physical energy as storage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.network import GROUND, Network, NetworkLink, full_rank_factor
from manyhands.design.models.statespace import storage_inequality

PERIODS = st.sampled_from([2.5e-4, 1e-3, 1e-2])
ANGLES = (0.05, 0.5, 1.5, 3.0)


@given(st.data(), PERIODS)
def test_E_is_the_impedance_at_backward_euler(problems, data: st.DataObject, T: float) -> None:
    network = data.draw(problems.networks())
    E, E_hat = network.environment(T), network.transformed_environment(T)
    m = len(network.ports)
    assert (E.inputs, E.outputs) == (E_hat.inputs, E_hat.outputs) == (m, m)
    for angle in ANGLES:
        z = np.exp(1j * angle)
        s = (z - 1.0) / (T * z)
        expected = problems.impedance(network, s)
        scale = max(float(np.abs(expected).max()), float(np.abs(E.D).max()), 1e-300)
        # |s|^2 M against K: the cancellation in the inverse is worst at low angles, by (1/angle)^2
        np.testing.assert_allclose(E.response(z), expected, atol=1e-9 * scale)
        np.testing.assert_allclose(E_hat.response(z), expected / s, atol=1e-9 * scale / abs(s))


@given(st.data(), PERIODS)
def test_the_physical_energy_is_a_storage_function(problems, data: st.DataObject, T: float) -> None:
    """Lemma 1 with P = I, whatever the topology: free masses, dampers alone, nothing at all."""
    E_hat = data.draw(problems.networks()).transformed_environment(T)
    M = storage_inequality(E_hat, np.eye(E_hat.order))
    assert np.linalg.eigvalsh(M)[-1] <= 1e-12 * max(1.0, np.abs(E_hat.D).max())


@given(st.data())
def test_energy_coordinates_mean_energy(problems, data: st.DataObject) -> None:
    """T psi^T psi is the energy of springs and masses after a random motion of the tools."""
    T, network = 1e-3, data.draw(problems.networks(tied=True))
    m, n = len(network.ports), len(network.masses)
    E, E_hat = network.environment(T), network.transformed_environment(T)
    rng = np.random.default_rng(m + 10 * n)
    x = np.cumsum(rng.normal(size=(40, m)) * 1e-3, axis=0)
    eta, psi = np.zeros(E.order), np.zeros(E_hat.order)
    for now, before in zip(x, np.vstack([np.zeros((1, m)), x[:-1]]), strict=True):
        eta = E.A @ eta + E.B @ now
        psi = E_hat.A @ psi + E_hat.B @ ((now - before) / T)
    position = dict(zip([*network.ports, *(name for name, _ in network.masses)], eta[: m + n], strict=True))
    position[GROUND] = 0.0
    stretches = [(link.stiffness, position[link.ends[0]] - position[link.ends[1]]) for link in network.links]
    energy = sum(0.5 * k * stretch**2 for k, stretch in stretches)
    energy += sum(0.5 * mass * v**2 for (_, mass), v in zip(network.masses, eta[m + n :], strict=True))
    assert T * psi @ psi == pytest.approx(energy, rel=1e-6)


def test_example_1_in_closed_form(problems) -> None:
    T = problems.T
    E = problems.network.environment(T)
    for angle in ANGLES:
        z = np.exp(1j * angle)
        s = (z - 1.0) / (T * z)
        c = np.array([3800.0 + 0.1 * s, 3500.0 + 0.2 * s, 3300.0 + 0.3 * s])
        expected = np.diag(c) - np.outer(c, c) / (3.0 * s**2 + c.sum() + 2600.0 + 0.5 * s)
        np.testing.assert_allclose(E.response(z), expected, rtol=1e-9)


def test_example_1_has_the_reference_poles(problems) -> None:
    poles = np.linalg.eigvals(problems.network.transformed_environment(problems.T).A)
    poles = poles[np.argsort(np.abs(poles - 1.0))]
    assert len(poles) == 5
    np.testing.assert_allclose(poles[:3], 1.0, atol=1e-9)
    assert sorted(np.round(poles[3:], 4), key=np.imag) == pytest.approx([0.99544 - 0.066j, 0.99544 + 0.066j], abs=6e-5)


def test_example_1_is_passive_with_0463_to_spare(problems) -> None:
    E_hat = problems.network.transformed_environment(problems.T)
    least = np.inf
    for angle in np.logspace(-4, np.log10(np.pi), 4000):
        response = E_hat.response(np.exp(1j * angle))
        least = min(least, np.linalg.eigvalsh((response + response.conj().T) / 2.0)[0])
    assert least == pytest.approx(0.463, abs=1e-3)


@given(st.data())
def test_a_mass_that_no_port_moves_is_left_out(problems, data: st.DataObject) -> None:
    """Without the masses that no chain of links joins to a port, E is the same."""
    network = data.draw(problems.networks())
    reachable = network.reachable()
    assert reachable.reachable() == reachable
    assert set(reachable.masses) <= set(network.masses)
    for angle in ANGLES:
        s = (1.0 - np.exp(-1j * angle)) / 1e-3
        expected = problems.impedance(network, s)
        np.testing.assert_allclose(
            problems.impedance(reachable, s), expected, atol=1e-9 * max(np.abs(expected).max(), 1.0)
        )


def test_a_far_mass_is_left_out() -> None:
    links = (
        NetworkLink(("p", "near"), 1.0, 0.0),
        NetworkLink(("far", GROUND), 1.0, 1.0),
        NetworkLink(("far", "near"), 0.0, 0.0),
    )
    reachable = Network(("p",), (("near", 1.0), ("far", 2.0)), links).reachable()
    assert reachable.masses == (("near", 1.0),)
    assert reachable.links == links[:1]


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(0, 6))
def test_the_factor_has_the_rank_and_gives_the_matrix(seed: int, size: int, rank: int) -> None:
    rank = min(rank, size)
    G = np.random.default_rng(seed).normal(size=(size, rank))
    L = full_rank_factor(G @ G.T)
    assert L.shape == (size, rank)
    np.testing.assert_allclose(L @ L.T, G @ G.T, atol=1e-12 * max(1.0, np.abs(G).max(initial=0.0) ** 2))


def test_an_indefinite_matrix_has_no_factor() -> None:
    with pytest.raises(ValueError, match="semidefinite"):
        full_rank_factor(np.array([[1.0, 2.0], [2.0, 1.0]]))


@pytest.mark.parametrize(
    ("ports", "masses", "links", "words"),
    [
        (("p",), (), (NetworkLink(("p", "q"), 1.0, 0.0),), r"\('p', 'q'\): expected two different ones of"),
        (("p",), (), (NetworkLink(("p", "p"), 1.0, 0.0),), "two different"),
        (("p",), (), (NetworkLink(("p", GROUND), -1.0, 0.0),), "found stiffness -1.0"),
        (("p",), (), (NetworkLink(("p", GROUND), 1.0, float("nan")),), "damping nan"),
        (("p",), (), (NetworkLink(("p", GROUND), float("inf"), 0.0),), "stiffness inf"),
        (("p",), (("m", 0.0),), (), "mass m: found 0.0 kg"),
        (("p",), (("m", float("nan")),), (), "mass m: found nan kg"),
        (("p",), (("m", float("inf")),), (), "mass m: found inf kg"),
        (("p",), (("p", 1.0),), (), "expected distinct ones"),
        (("p",), ((GROUND, 1.0),), (), "expected distinct ones"),
    ],
)
def test_what_is_no_network_is_refused(ports, masses, links, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Network(ports, masses, links)
