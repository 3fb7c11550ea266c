"""The environment's best level: the same answer as the semidefinite program, exact off any grid, and large sizes."""

from __future__ import annotations

import re

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.levels.environment import Dissipation, best_level, crossings, lack_of_passivity, room, storage
from manyhands.design.models.coupling import Partition
from manyhands.design.models.integrators import Split, delayed_split, split_system
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.design.solver import solve, storage_inequality_expression, symmetric

T = 1e-3


def random_network(rng: np.random.Generator, m: int, n: int, stiffest: float = 1500.0) -> Network:
    """Ports on masses, a ring of masses with chords, every third mass on the ground."""

    def link(a: str, b: str) -> NetworkLink:
        return NetworkLink((a, b), float(stiffest * rng.uniform(0.1, 1.0)), float(rng.uniform(0.05, 0.6)))

    links = [link(f"p{i}", f"m{i % n}") for i in range(m)]
    links += [link(f"m{i}", f"m{i + 1}") for i in range(n - 1)]
    links += [link(f"m{i}", GROUND) for i in range(0, n, 3)]
    masses = tuple((f"m{i}", float(rng.uniform(0.2, 4.0))) for i in range(n))
    return Network(tuple(f"p{i}" for i in range(m)), masses, tuple(links))


def random_level(rng: np.random.Generator, partition: Partition, low: float, high: float) -> Matrix:
    parts = []
    for block in partition.blocks:
        Q, _ = np.linalg.qr(rng.normal(size=(len(block), len(block))))
        part = Q @ np.diag(rng.uniform(low, high, len(block))) @ Q.T
        parts.append((part + part.T) / 2.0)
    return partition.embed(parts)


def single(m: int) -> Partition:
    return Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m)))


def pairs(m: int) -> Partition:
    blocks = tuple(tuple(range(i, min(i + 2, m))) for i in range(0, m, 2))
    return Partition(tuple(f"c{i}" for i in range(len(blocks))), blocks)


def program(split: Split, Delta_G: Matrix, Delta_V: Matrix, mask: Matrix) -> float:
    """The best t by semidefinite programming over P, Phi_E (zero outside ``mask``) and t.

    States are put into coordinates in which P is near I, without which the solver's answers are not to be had.
    """
    m = len(Delta_G)
    lack = lack_of_passivity(split, T, np.eye(m)).multiple
    L = np.linalg.cholesky(storage(split, T, (lack + 0.05) * np.eye(m)))
    A, B, C, D = split.rest.A, split.rest.B, split.rest.C, split.rest.D
    back = np.linalg.inv(L.T)
    rest = StateSpace(L.T @ A @ back, L.T @ B, C @ back, D)
    P, Phi, t = cp.Variable((rest.order,) * 2, symmetric=True), cp.Variable((m, m), symmetric=True), cp.Variable()
    M = storage_inequality_expression(rest, P, Phi=T / 2.0 * split.stiffness - Phi)
    condition = cp.bmat([[Delta_G - Phi, -Phi], [-Phi, Delta_V - Phi]])
    constraints = [symmetric(M) << 0.0, symmetric(condition) >> t * np.eye(2 * m), P >> 0.0]
    constraints += [cp.multiply(~mask, Phi) == 0.0] if not mask.all() else []
    return solve(cp.Problem(cp.Maximize(t), constraints), "reference")


@pytest.mark.parametrize("seed", range(12))
def test_same_margin_as_the_semidefinite_program(seed: int) -> None:
    """1e-5 is asked; Clarabel itself stops at 1e-8 of the objective."""
    rng = np.random.default_rng(seed)
    m, n, delay = 1 + seed % 5, 1 + (seed * 3) % 5, seed % 3
    split = delayed_split(random_network(rng, m, n).split(T), delay, T)
    partition = [Partition(("all",), (tuple(range(m)),)), single(m), pairs(m)][(seed // 3) % 3]
    lack = max(lack_of_passivity(split, T, np.eye(m)).multiple, 0.1)
    Delta_G, Delta_V = (
        random_level(rng, partition, 3 * lack, 6 * lack),
        random_level(rng, partition, 3 * lack, 9 * lack),
    )
    found = best_level(split, T, Delta_G, Delta_V, partition)
    assert found.best == pytest.approx(program(split, Delta_G, Delta_V, partition.mask()), rel=1e-5)
    assert found.best * (1 - 1e-5) <= found.t <= found.best
    assert partition.admits(found.Phi_E)


def test_same_margin_as_the_semidefinite_program_at_twelve_ports() -> None:
    rng = np.random.default_rng(5)
    split = delayed_split(random_network(rng, 12, 6, 200.0).split(T), 1, T)
    Delta_G, Delta_V = random_level(rng, pairs(12), 1.2, 1.8), random_level(rng, pairs(12), 1.2, 3.0)
    found = best_level(split, T, Delta_G, Delta_V, pairs(12))
    assert found.best == pytest.approx(program(split, Delta_G, Delta_V, pairs(12).mask()), rel=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_same_refusal_as_the_semidefinite_program(seed: int) -> None:
    """The message's four digits."""
    rng = np.random.default_rng(50 + seed)
    split = delayed_split(random_network(rng, 4, 3, 3000.0).split(T), 1 + seed % 2, T)
    Delta_G, Delta_V = random_level(rng, pairs(4), 0.3, 0.6), random_level(rng, pairs(4), 0.3, 2.0)
    with pytest.raises(Infeasible) as told:
        best_level(split, T, Delta_G, Delta_V, pairs(4))
    figure = re.search(r"greater margin than (\S+) N", str(told.value))
    assert figure is not None
    assert float(figure[1]) == pytest.approx(program(split, Delta_G, Delta_V, pairs(4).mask()), rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_the_least_multiple_is_that_of_the_semidefinite_program(seed: int) -> None:
    """min s: with Delta_V so great that only Delta_G - Phi_E counts, margins t Delta_G have s = 1 - t."""
    rng = np.random.default_rng(100 + seed)
    m = 1 + seed
    split = delayed_split(random_network(rng, m, 3).split(T), 1 + seed % 2, T)
    Delta = random_level(rng, pairs(m), 0.5, 2.0)
    found = lack_of_passivity(split, T, Delta)
    start = np.linalg.cholesky(storage(split, T, (found.multiple + 0.1) * Delta))
    A, B, C, D = split.rest.A, split.rest.B, split.rest.C, split.rest.D
    back = np.linalg.inv(start.T)
    rest = StateSpace(start.T @ A @ back, start.T @ B, C @ back, D)
    P, s = cp.Variable((rest.order,) * 2, symmetric=True), cp.Variable()
    M = storage_inequality_expression(rest, P, Phi=T / 2.0 * split.stiffness - s * Delta)
    best = solve(cp.Problem(cp.Minimize(s), [symmetric(M) << 0.0, P >> 0.0]), "reference")
    assert found.multiple == pytest.approx(best, rel=1e-5)
    H = Dissipation(split, T)(found.frequency * T)
    assert np.linalg.eigvalsh(H + found.multiple * Delta)[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("name", "reference"), [("C26", 0.7979), ("C27", 0.9455), ("C28", 1.8329)])
def test_the_papers_couplings(problems, name: str, reference: float) -> None:
    partition = problems.centralised if name == "C27" else problems.decentralised
    Delta_D = problems.osp * np.eye(3)
    _, _, Delta_V = problems.greatest_level(Delta_D, getattr(problems, name), T)
    Delta_V = (Delta_V + Delta_V.T) / 2.0
    found = best_level(problems.network.split(T), T, Delta_D, Delta_V, partition)
    assert found.best == pytest.approx(reference, abs=5e-5)


@pytest.mark.parametrize(("delay", "reference"), [(0, -0.463), (1, 1.999), (2, 5.61)])
def test_what_example_1_needs_when_it_is_late(problems, delay: int, reference: float) -> None:
    split = delayed_split(problems.network.split(T), delay, T)
    assert lack_of_passivity(split, T, np.eye(3)).multiple == pytest.approx(reference, rel=2e-3)
    if delay:
        with pytest.raises(Infeasible, match=r"lacks passivity at [\d.]+ rad/s.*greater margin than -"):
            best_level(split, T, problems.osp * np.eye(3), 1e3 * np.eye(3))


def test_one_sample_late_is_feasible_just_above_what_it_needs(problems) -> None:
    split = delayed_split(problems.network.split(T), 1, T)
    lack = lack_of_passivity(split, T, np.eye(3)).multiple
    assert best_level(split, T, 1.000001 * lack * np.eye(3), 1e9 * np.eye(3)).best > 0.0
    with pytest.raises(Infeasible):
        best_level(split, T, 0.999999 * lack * np.eye(3), 1e9 * np.eye(3))


@settings(max_examples=25)
@given(data=st.data())
def test_no_frequency_escapes(problems, data: st.DataObject) -> None:
    """H + Phi_E > 0 on a fine grid that the search does not know, and Phi_E is not larger than needed."""
    T = data.draw(st.sampled_from([2.5e-4, 1e-3, 4e-3]))
    network = data.draw(problems.networks(tied=True))
    m = len(network.ports)
    split = delayed_split(network.split(T), data.draw(st.integers(0, 3)), T)
    partition = data.draw(problems.partitions(m))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    assume(
        np.max(np.abs(np.linalg.eigvals(split.rest.A)), initial=0.0) < 1.0
    )  # no masses that hang on each other alone
    lack = max(lack_of_passivity(split, T, np.eye(m)).multiple, 0.01)
    Delta_G = random_level(rng, partition, 2.1 * lack, 9 * lack)
    Delta_V = random_level(rng, partition, 2.1 * lack, 99 * lack)
    found = best_level(split, T, Delta_G, Delta_V, partition)
    dissipation = Dissipation(split, T)
    angles = np.concatenate([np.geomspace(1e-7, np.pi, 400), np.linspace(0.0, np.pi, 200)])
    least = min(float(np.linalg.eigvalsh(dissipation(a) + found.Phi_E)[0]) for a in angles)
    rounding = 1e-12 * max(float(np.abs(found.Phi_E).max()), lack)
    assert least > -rounding
    # at the worst frequency the levels are used up: -H itself, the least that Phi_E could be there, leaves no more
    H = dissipation(found.frequency * T)
    used_up = np.linalg.eigvalsh(np.block([[Delta_G + H, H], [H, Delta_V + H]]))[0]
    assert used_up == pytest.approx(found.best, rel=1e-9)


def needle(angle: float, width: float, depth: float) -> Split:
    """A spring-damper-like port whose passivity is lost in a resonance too narrow for any grid."""
    z = (1.0 - width) * np.exp(1j * angle)
    A = np.array([[z.real, z.imag], [-z.imag, z.real]])
    rest = StateSpace(A, [[1.0], [0.0]], [[-depth * width, 0.0]], [[1.0]])
    return Split(np.zeros((1, 1)), rest)


@pytest.mark.parametrize("width", [1e-2, 1e-5, 1e-8])
def test_a_needle_in_frequency_is_found(width: float) -> None:
    split = needle(0.7, width, 3.0)
    dissipation = Dissipation(split, T)
    truth = min(dissipation(0.7 + width * x)[0, 0].real for x in np.linspace(-2.0, 2.0, 4001))
    assert lack_of_passivity(split, T, np.eye(1)).multiple == pytest.approx(-truth, rel=1e-5)


@pytest.mark.parametrize("width", [1e-2, 1e-5])
def test_the_hamiltonian_finds_a_needle_between_the_points_of_the_grid(
    monkeypatch: pytest.MonkeyPatch, width: float
) -> None:
    split = needle(0.7, width, 3.0)
    truth = lack_of_passivity(split, T, np.eye(1)).multiple
    monkeypatch.setattr(Dissipation, "angles", lambda self: np.array([0.0, 2.0, np.pi]))
    assert lack_of_passivity(split, T, np.eye(1)).multiple == pytest.approx(truth, rel=1e-6)


def test_crossings_are_where_the_sign_changes() -> None:
    split = needle(0.7, 1e-2, 3.0)
    dissipation = Dissipation(split, T)
    found = crossings(dissipation, np.zeros((1, 1)))
    assert len(found) == 2
    for angle in found:
        assert dissipation(angle)[0, 0].real == pytest.approx(0.0, abs=1e-9)
    assert dissipation(float(found.mean()))[0, 0].real < -0.1
    assert len(crossings(dissipation, np.array([[10.0]]))) == 0


def test_an_environment_without_states() -> None:
    """A damper b: H = b, so that Phi_E = -b and (10) has the best margin by hand."""
    split = split_system(StateSpace.static([[0.0]]), T)
    split = Split(split.stiffness, StateSpace.static([[0.3]]))
    found = best_level(split, T, np.array([[1.0]]), np.array([[2.0]]))
    assert found.best == pytest.approx(np.linalg.eigvalsh([[1.3, 0.3], [0.3, 2.3]])[0], rel=1e-12)
    assert found.Phi_E[0, 0] == pytest.approx(-0.3, rel=1e-4)
    assert storage(split, T, found.Phi_E).shape == (0, 0)


def test_a_mode_that_does_not_decay_is_reported() -> None:
    split = Split(np.eye(1), StateSpace([[1.0]], [[0.0]], [[0.0]], [[1.0]]))
    with pytest.raises(SolverFailure, match="does not decay"):
        best_level(split, T, np.eye(1), np.eye(1))


@pytest.mark.parametrize(
    ("Delta_G", "Delta_V", "message"),
    [
        (np.eye(2), np.eye(3), r"Delta_G: found the shape \(2, 2\); expected a symmetric 3 x 3"),
        (np.eye(3), np.triu(np.ones((3, 3))), r"Delta_V: found the shape \(3, 3\); expected a symmetric 3 x 3"),
        (np.eye(3), -np.eye(3), "Delta_V to be finite and positive definite"),
        (np.eye(3), np.full((3, 3), 0.1) + np.eye(3), "Delta_V to have the structure"),
    ],
)
def test_levels_that_are_none(problems, Delta_G: Matrix, Delta_V: Matrix, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        best_level(problems.network.split(T), T, Delta_G, Delta_V, problems.decentralised)


def test_the_margin_is_that_of_the_matrix(problems) -> None:
    found = best_level(problems.network.split(T), T, np.diag([1.0, 2.0, 3.0]), np.diag([3.0, 1.0, 2.0]))
    matrix = np.block(
        [[np.diag([1.0, 2.0, 3.0]) - found.Phi_E, -found.Phi_E], [-found.Phi_E, np.diag([3.0, 1.0, 2.0]) - found.Phi_E]]
    )
    assert found.t == pytest.approx(np.linalg.eigvalsh(matrix)[0], rel=1e-12)
    assert found.t == pytest.approx(found.best, rel=1e-5)


def test_forty_ports_two_ticks_late_with_a_storage_function() -> None:
    """Order 200, in parts that no semidefinite program takes; progress is reported."""
    told: list[str] = []
    split = delayed_split(random_network(np.random.default_rng(1), 40, 60, 300.0).split(T), 2, T)
    Delta = 1.37 * np.eye(40)
    found = best_level(split, T, Delta, 2.0 * Delta, single(40), progress=told.append)
    P = storage(split, T, found.Phi_E, told.append, found.frequency)
    assert split.rest.order == 200
    assert any("test 1" in text for text in told)
    assert any("tightened" in text for text in told)
    assert np.linalg.eigvalsh(P)[0] > 0.0
    assert np.linalg.eigvalsh(split.dissipation(P, found.Phi_E, T))[-1] < 0.0
    assert room(split, T, found.Phi_E, P) > 1e-10
