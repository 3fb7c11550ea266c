"""Levels that a network keeps by its physics: against dense algebra, exact arithmetic, and at a thousand ports."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.levels.environment import Dissipation, best_level
from manyhands.design.levels.network import (
    MOST_EXACT,
    diagonal_level,
    dissipation_matrix,
    link_matrices,
    physical_level,
    port_dissipation,
    structured_level,
)
from manyhands.design.models.coupling import Partition
from manyhands.design.models.integrators import Split
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace

T = 1e-3


def single(m: int) -> Partition:
    return Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m)))


def chain(m: int, grounded: bool = True) -> Network:
    """m ports, each on a mass of a ring of m masses."""
    links = [NetworkLink((f"p{i}", f"m{i}"), 1000.0, 0.1) for i in range(m)]
    links += [NetworkLink((f"m{i}", f"m{(i + 1) % m}"), 500.0, 0.2) for i in range(m if m > 2 else m - 1)]
    links += [NetworkLink((f"m{i}", GROUND), 300.0, 0.0) for i in range(0, m if grounded else 0, 10)]
    return Network(tuple(f"p{i}" for i in range(m)), tuple((f"m{i}", 0.5) for i in range(m)), tuple(links))


def padded(network: Network, Phi: Matrix, T: float) -> Matrix:
    """Z + blockdiag(Phi, 0), dense."""
    Z = network.damping_matrix() + T / 2.0 * network.stiffness_matrix()
    m = len(network.ports)
    Z[:m, :m] += Phi
    return Z


def exact_rows(network: Network, blocks: tuple[Matrix, ...], partition: Partition, y: Matrix, T: float) -> None:
    """The witness in exact rationals: y > 0, no positive entry off the diagonal, (Z - blockdiag(blocks, 0)) y >= 0."""
    names = {name: i for i, name in enumerate([*network.ports, *(name for name, _ in network.masses)])}
    entries: dict[tuple[int, int], Fraction] = {}

    def add(i: int, j: int, value: Fraction) -> None:
        entries[i, j] = entries.get((i, j), Fraction(0)) + value

    for link in network.links:
        weight = Fraction(link.damping) + Fraction(T) / 2 * Fraction(link.stiffness)
        ends = [names[end] for end in link.ends if end != GROUND]
        for i in ends:
            for j in ends:
                add(i, j, weight if i == j else -weight)
    for ports, block in zip(partition.blocks, blocks, strict=True):
        for a, i in enumerate(ports):
            for b, j in enumerate(ports):
                add(i, j, -Fraction(float(block[a, b])))
    witness = [Fraction(float(value)) for value in y]
    assert all(value > 0 for value in witness)
    assert all(value <= 0 for (i, j), value in entries.items() if i != j)
    rows = [Fraction(0)] * len(names)
    for (i, j), value in entries.items():
        rows[i] += value * witness[j]
    assert all(row >= 0 for row in rows)


@settings(max_examples=60)
@given(data=st.data())
def test_matrices_and_schur_complement(problems, data: st.DataObject) -> None:
    network = data.draw(problems.networks())
    K, B = link_matrices(network)
    m = len(network.ports)
    np.testing.assert_array_equal(K.toarray(), network.stiffness_matrix())
    np.testing.assert_array_equal(B.toarray(), network.damping_matrix())
    Z = padded(network, np.zeros((m, m)), T)
    expected = Z[:m, :m] - Z[:m, m:] @ np.linalg.pinv(Z[m:, m:], rcond=1e-13, hermitian=True) @ Z[m:, :m]
    S = port_dissipation(dissipation_matrix(network, T), m)
    np.testing.assert_allclose(S, expected, atol=1e-9 * max(float(np.abs(Z).max()), 1e-3))


@settings(max_examples=60)
@given(data=st.data())
def test_the_network_dissipates_what_is_claimed_at_every_frequency(problems, data: st.DataObject) -> None:
    T = data.draw(st.sampled_from([2.5e-4, 1e-3, 4e-3]))
    network = data.draw(problems.networks(tied=True))
    m = len(network.ports)
    S = port_dissipation(dissipation_matrix(network, T), m)
    split = network.split(T)
    for angle in (1e-3, 0.1, 0.5, 1.5, np.pi):
        response = split.rest.response(np.exp(1j * angle))
        H = (response + response.conj().T) / 2.0 - T / 2.0 * split.stiffness
        assert np.linalg.eigvalsh(H - S)[0] > -1e-9 * max(float(np.abs(H).max()), 1.0)


@settings(max_examples=60)
@given(data=st.data())
def test_the_witness_holds_in_exact_numbers(problems, data: st.DataObject) -> None:
    network = data.draw(problems.networks())
    partition = data.draw(problems.partitions(len(network.ports)))
    found = structured_level(dissipation_matrix(network, T), partition)
    exact_rows(network, found.blocks, partition, found.witness, T)
    for block in found.blocks:
        assert np.linalg.eigvalsh(block)[0] >= -1e-12 * max(float(np.abs(block).max()), 1e-300)


@settings(max_examples=60)
@given(data=st.data())
def test_the_best_level_by_energy(problems, data: st.DataObject) -> None:
    """Admissible, with the structure, and with the margin of (10) that no other level by energy beats."""
    network = data.draw(problems.networks())
    partition = data.draw(problems.partitions(len(network.ports)))
    m, rng = partition.size, np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    Delta_G = tuple(np.diag(rng.uniform(0.1, 2.0, len(block))) for block in partition.blocks)
    Delta_V = tuple(np.diag(rng.uniform(0.1, 9.0, len(block))) for block in partition.blocks)
    Phi = physical_level(network, T, Delta_G, Delta_V, partition)
    G, V = partition.embed(Delta_G), partition.embed(Delta_V)
    margin = np.linalg.eigvalsh(np.block([[G - Phi, -Phi], [-Phi, V - Phi]]))[0]
    assert partition.admits(Phi)
    assert np.linalg.eigvalsh(padded(network, Phi, T))[0] > -1e-10
    S = port_dissipation(dissipation_matrix(network, T), m)
    best = np.linalg.eigvalsh(np.block([[G + S, S], [S, V + S]]))[0]  # Phi_E = -S, without structure
    assert margin >= best * (1.0 - 1e-5)


def test_with_static_data_it_is_the_best_level(problems) -> None:
    """A network without masses dissipates S at every frequency: two ways to the same margin."""
    network = Network(("a", "b"), (), (NetworkLink(("a", "b"), 0.0, 1.0), NetworkLink(("b", GROUND), 0.0, 0.5)))
    Delta = (np.array([[1.0]]), np.array([[2.0]]))
    Phi = physical_level(network, T, Delta, Delta, single(2))
    split = Split(np.zeros((2, 2)), StateSpace.static(network.damping_matrix()))
    G = np.diag([1.0, 2.0])
    np.testing.assert_allclose(Phi, best_level(split, T, G, G, single(2)).Phi_E, atol=1e-5)


def test_example_1_by_hand(problems) -> None:
    c = np.array([0.1, 0.2, 0.3]) + T / 2.0 * np.array([3800.0, 3500.0, 3300.0])
    hub = c.sum() + 0.5 + T / 2.0 * 2600.0
    Z = dissipation_matrix(problems.network, T)
    np.testing.assert_allclose(port_dissipation(Z, 3), np.diag(c) - np.outer(c, c) / hub, rtol=1e-12)
    found = structured_level(Z, problems.decentralised)
    least = np.linalg.eigvalsh(np.diag(c) - np.outer(c, c) / hub)[0]
    np.testing.assert_allclose([block[0, 0] for block in found.blocks], least, rtol=1e-5)


def test_nothing_is_gained_where_a_network_floats() -> None:
    found = structured_level(dissipation_matrix(chain(6, grounded=False), T), single(6))
    assert all(block[0, 0] == 0.0 for block in found.blocks)


@pytest.mark.parametrize("weights", [None, np.array([1.0, 2.0, 1.0, 5.0, 1.0, 1.0, 0.2, 1.0])])
def test_levels_are_the_greatest_multiple_of_the_weights(weights: Matrix | None) -> None:
    """A hundredth more everywhere, and the inequality is lost."""
    network = chain(8)
    found = structured_level(dissipation_matrix(network, T), single(8), weights)
    level = np.diag([block[0, 0] for block in found.blocks])
    assert np.linalg.eigvalsh(padded(network, -level, T))[0] > 0.0
    assert np.linalg.eigvalsh(padded(network, -1.01 * level, T))[0] < 0.0
    wanted = np.ones(8) if weights is None else weights
    np.testing.assert_allclose(np.diag(level) / wanted, level[0, 0] / wanted[0], rtol=1e-4)


@pytest.mark.parametrize("factor", [1.0, 1.7])
def test_more_stiffness_and_damping_and_other_masses_keep_the_level(problems, factor: float) -> None:
    """The lower ends of intervals cover the box: the same Phi_E for every network in it, over frequency."""
    low, rng = problems.network, np.random.default_rng(int(factor * 10))
    Delta = tuple(np.array([[problems.osp]]) for _ in range(3))
    Phi = physical_level(low, T, Delta, Delta, problems.decentralised)
    for _ in range(20):
        links = tuple(
            NetworkLink(link.ends, link.stiffness * rng.uniform(1.0, factor), link.damping * rng.uniform(1.0, factor))
            for link in low.links
        )
        other = Network(low.ports, (("hub", float(rng.uniform(0.01, 30.0))),), links)
        dissipation = Dissipation(other.split(T), T)
        for angle in np.geomspace(1e-4, np.pi, 30):
            assert np.linalg.eigvalsh(dissipation(angle) + Phi)[0] > 0.0


def test_a_thousand_ports() -> None:
    network = chain(1000)
    partition = single(1000)
    Z = dissipation_matrix(network, T)
    found = structured_level(Z, partition)
    exact_rows(network, found.blocks, partition, found.witness, T)
    kept = np.array([block[0, 0] for block in found.blocks])
    least = np.linalg.eigvalsh(port_dissipation(Z, 1000))[0]
    np.testing.assert_allclose(kept, least, rtol=0.1)  # sixty steps of an iteration
    Delta = tuple(np.array([[1.37]]) for _ in range(1000))
    assert not np.any(physical_level(network, T, Delta, Delta, partition))  # one group, larger than MOST_EXACT


def test_small_groups_of_a_large_network_get_their_own_level() -> None:
    """Twenty copies of a chain, alone: each the level that it has by itself."""
    part = chain(4)
    size = len(part.ports) + len(part.masses)
    copies = -(-2 * MOST_EXACT // size)

    def name(end: str, i: int) -> str:
        return end if end == GROUND else f"{end}.{i}"

    network = Network(
        tuple(name(p, i) for i in range(copies) for p in part.ports),
        tuple((name(q, i), mass) for i in range(copies) for q, mass in part.masses),
        tuple(
            NetworkLink((name(link.ends[0], i), name(link.ends[1], i)), link.stiffness, link.damping)
            for i in range(copies)
            for link in part.links
        ),
    )
    Delta = tuple(np.array([[1.37]]) for _ in range(4))
    Delta_V = tuple(np.array([[2.0 + i]]) for i in range(4))
    alone = physical_level(part, T, Delta, Delta_V, single(4))
    together = physical_level(network, T, Delta * copies, Delta_V * copies, single(4 * copies))
    assert np.abs(alone).max() > 0.01
    for i in range(copies):
        np.testing.assert_allclose(together[4 * i : 4 * i + 4, 4 * i : 4 * i + 4], alone, rtol=1e-9)


@given(data=st.data())
@settings(max_examples=25)
def test_a_diagonal_level_is_the_greatest_of_its_group(problems, data: st.DataObject) -> None:
    network = data.draw(problems.networks())
    Phi = diagonal_level(network, T)
    assert np.array_equal(Phi, np.diag(np.diag(Phi)))
    assert np.all(np.diag(Phi) <= 0.0)
    Z = padded(network, Phi, T)
    assert np.linalg.eigvalsh(Z)[0] >= -1e-9 * np.abs(Z).max()
    if np.all(Phi.diagonal() < 0.0) and len({float(s) for s in Phi.diagonal()}) == 1:
        assert np.linalg.eigvalsh(padded(network, 1.00001 * Phi, T))[0] < 0.0


def test_a_diagonal_level_of_what_floats_is_zero_and_groups_are_apart() -> None:
    assert not np.any(diagonal_level(chain(4, grounded=False), T))
    assert np.all(np.diag(diagonal_level(chain(4), T)) < 0.0)
    many = chain(60)  # more than MOST_EXACT ports and masses
    kept = diagonal_level(many, T)
    assert np.all(np.diag(kept) < 0.0)
    assert np.linalg.eigvalsh(padded(many, kept, T))[0] >= 0.0
    apart = Network(("p0", "p1"), (), (NetworkLink(("p0", GROUND), 1000.0, 0.3), NetworkLink(("p1", GROUND), 0.0, 0.1)))
    assert np.diag(diagonal_level(apart, T)) == pytest.approx([-0.8, -0.1], rel=1e-5)
