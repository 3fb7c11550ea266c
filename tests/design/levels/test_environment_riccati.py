"""Storage functions from a Riccati equation: by eigenvalues, along trajectories, and against an independent solver."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, solve_discrete_are

from manyhands.design.errors import SolverFailure
from manyhands.design.levels import environment
from manyhands.design.levels.environment import best_level, lack_of_passivity, level_and_storage, room, storage
from manyhands.design.models.coupling import Partition
from manyhands.design.models.integrators import Split, delayed_split
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace

T = 1e-3


def change(split: Split, X: Matrix) -> Split:
    """The same system in the states X psi."""
    rest, back = split.rest, np.linalg.inv(X)
    return Split(split.stiffness, StateSpace(X @ rest.A @ back, X @ rest.B, rest.C @ back, rest.D))


def proved(split: Split, Phi_E: Matrix, P: Matrix, T: float = T) -> bool:
    """P > 0 and M(P) < 0, by eigenvalues of matrices scaled to unit diagonal."""

    def least(M: Matrix) -> float:
        if not len(M):
            return np.inf
        d = 1.0 / np.sqrt(np.diag(M))
        return float(np.linalg.eigvalsh(d[:, None] * M * d)[0])

    A, B, C, D = split.rest.A, split.rest.B, split.rest.C, split.rest.D
    right = np.block([[P, C.T / 2.0], [C / 2.0, (D + D.T) / 2.0 + Phi_E - T / 2.0 * split.stiffness]])
    M = np.hstack([A, B]).T @ P @ np.hstack([A, B]) - right
    return least(P) > 1e-12 and least(-M) > 1e-11


@pytest.fixture
def late(problems) -> Split:
    return delayed_split(problems.network.split(T), 1, T)


@settings(max_examples=40)
@given(data=st.data())
def test_random_networks_late_or_not(problems, data: st.DataObject) -> None:
    T = data.draw(st.sampled_from([2.5e-4, 1e-3, 4e-3]))
    network = data.draw(problems.networks(tied=True))
    m = len(network.ports)
    split = delayed_split(network.split(T), data.draw(st.integers(0, 3)), T)
    radius = float(np.max(np.abs(np.linalg.eigvals(split.rest.A)), initial=0.0))
    assume(radius < 1.0 - 1e-8)  # a mode that loses less in a tick has no room: see the test below
    lack = lack_of_passivity(split, T, np.eye(m))
    spare = data.draw(st.sampled_from([1e-4, 1e-2, 1.0])) * max(abs(lack.multiple), 0.1)
    Phi_E = (lack.multiple + spare) * np.eye(m)
    P = storage(split, T, Phi_E, frequency=data.draw(st.sampled_from([None, lack.frequency])))
    assert proved(split, Phi_E, P, T)


def test_the_best_level_of_example_1_late_by_a_tick(problems, late: Split) -> None:
    found = best_level(late, T, 3.0 * np.eye(3), 20.0 * np.eye(3))
    P = storage(late, T, found.Phi_E, frequency=found.frequency)
    assert proved(late, found.Phi_E, P)
    assert room(late, T, found.Phi_E, P) >= 1e-10


def test_it_lies_above_the_available_storage(problems, late: Split) -> None:
    """scipy solves the untightened equation with an ordered Schur form: the least of all storage functions."""
    Phi_E = 2.1 * np.eye(3)
    rest = late.rest
    R = (rest.D + rest.D.T) / 2.0 + Phi_E - T / 2.0 * late.stiffness
    n = rest.order
    least = -solve_discrete_are(rest.A, rest.B, np.zeros((n, n)), R, s=rest.C.T / 2.0)
    P = storage(late, T, Phi_E)
    assert np.linalg.eigvalsh(P - least)[0] > -1e-9 * np.abs(P).max()
    assert np.linalg.eigvalsh(P - least)[-1] < 0.5 * np.linalg.eigvalsh(least)[-1]


def test_energy_along_a_trajectory(problems, late: Split) -> None:
    """Supply, summed, never falls below the stored energy; the force is that of E itself, held back for a tick."""
    rng = np.random.default_rng(3)
    E = problems.network.environment(T)
    found = best_level(late, T, 3.0 * np.eye(3), 20.0 * np.eye(3))
    P = storage(late, T, found.Phi_E)
    w = rng.normal(size=(400, 3)) * np.cos(np.arange(400)[:, None] * 3.0)
    x = T * np.cumsum(w, axis=0)
    f = np.vstack([np.zeros((1, 3)), E.simulate(x)[:-1]])
    supplied = np.cumsum(np.einsum("ki,ki->k", w, f + w @ found.Phi_E))
    state, held = np.zeros(late.rest.order), []
    for velocity, position in zip(w, x, strict=True):
        state = late.rest.A @ state + late.rest.B @ velocity
        held.append(state @ P @ state + position @ late.stiffness @ position / (2.0 * T))
    assert np.all(supplied >= np.array(held) - 1e-9 * np.abs(supplied).max())
    assert np.max(held) > 0.0


def test_too_little_is_refused(problems, late: Split) -> None:
    needed = lack_of_passivity(late, T, np.eye(3)).multiple
    with pytest.raises(SolverFailure, match=r"too close|less than the environment needs"):
        storage(late, T, 0.999 * needed * np.eye(3))
    with pytest.raises(SolverFailure, match="less than the environment needs"):
        storage(late, T, -10.0 * np.eye(3))
    assert proved(late, 1.001 * needed * np.eye(3), storage(late, T, 1.001 * needed * np.eye(3)))


def test_a_level_that_fails_between_zero_and_pi_is_refused() -> None:
    """R > 0, and H + Phi_E > 0 at 0 and pi; negative at a resonance only."""
    z = 0.99 * np.exp(0.7j)
    rest = StateSpace([[z.real, z.imag], [-z.imag, z.real]], [[1.0], [0.0]], [[-0.03, 0.0]], [[1.0]])
    with pytest.raises(SolverFailure, match="too close"):
        storage(Split(np.zeros((1, 1)), rest), T, np.zeros((1, 1)))


@pytest.mark.parametrize("spread", [1.0, 1e6])
def test_units_of_the_states_do_not_matter(problems, late: Split, spread: float) -> None:
    X = np.diag(np.geomspace(1.0 / spread, spread, late.rest.order))
    other = change(late, X)
    Phi_E = 2.01 * np.eye(3)
    assert proved(other, Phi_E, storage(other, T, Phi_E))


@pytest.mark.parametrize("hidden", ["unreached", "unseen", "both"])
def test_states_that_no_input_reaches_or_no_output_sees(problems, late: Split, hidden: str) -> None:
    rng = np.random.default_rng(4)
    rest = late.rest
    A = block_diag(rest.A, 0.9 * np.eye(2))
    B = np.vstack([rest.B, np.zeros((2, 3)) if hidden != "unseen" else rng.normal(size=(2, 3))])
    C = np.hstack([rest.C, np.zeros((3, 2)) if hidden != "unreached" else rng.normal(size=(3, 2))])
    split = Split(late.stiffness, StateSpace(A, B, C, rest.D))
    Phi_E = 2.05 * np.eye(3)
    assert proved(split, Phi_E, storage(split, T, Phi_E))


def test_a_mode_that_does_not_decay_is_refused() -> None:
    split = Split(np.eye(1), StateSpace([[1.0]], [[0.0]], [[0.0]], [[1.0]]))
    with pytest.raises(SolverFailure, match="does not decay"):
        storage(split, T, np.eye(1))


@settings(max_examples=60)
@given(data=st.data())
def test_whatever_has_a_level_has_a_storage_function(problems, data: st.DataObject) -> None:
    T = data.draw(st.sampled_from([2.5e-4, 1e-3, 4e-3]))
    network = data.draw(problems.networks(tied=True))
    m = len(network.ports)
    split = delayed_split(network.split(T), data.draw(st.integers(0, 2)), T)
    assume(np.max(np.abs(np.linalg.eigvals(split.rest.A)), initial=0.0) < 1.0 - 1e-12)
    lack = max(lack_of_passivity(split, T, np.eye(m)).multiple, 0.02)
    Delta_G, Delta_V = (lack * np.diag(data.draw(st.lists(st.floats(2.1, 60.0), min_size=m, max_size=m))) for _ in "GV")
    found, P = level_and_storage(
        split, T, Delta_G, Delta_V, Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m)))
    )
    assert proved(split, found.Phi_E, P, T)
    matrix = np.block([[Delta_G - found.Phi_E, -found.Phi_E], [-found.Phi_E, Delta_V - found.Phi_E]])
    assert np.linalg.eigvalsh(matrix)[0] == pytest.approx(found.t, rel=1e-6)
    assert found.best * (1.0 - 1e-2) <= found.t <= found.best


def test_more_is_given_up_where_modes_are_slow() -> None:
    """A heavy mass on a soft spring loses 1e-7 of its energy in a tick."""
    network = Network(("p",), (("m", 10.0),), (NetworkLink(("p", "m"), 1.0, 0.0), NetworkLink(("m", GROUND), 0.5, 0.0)))
    split, told = delayed_split(network.split(2.5e-4), 1, 2.5e-4), []
    found, P = level_and_storage(split, 2.5e-4, np.eye(1), np.eye(1), progress=told.append)
    assert proved(split, found.Phi_E, P, 2.5e-4)
    assert found.t < found.best


def test_progress_names_the_tightening(problems, late: Split) -> None:
    told: list[str] = []
    storage(late, T, 2.1 * np.eye(3), told.append)
    assert told
    assert all("tightened by" in text for text in told)


def test_a_storage_function_without_room_is_not_returned(late: Split, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "ENOUGH_ROOM", 0.5)
    monkeypatch.setattr(environment, "ENOUGH_LONG_ROOM", 0.5)
    with pytest.raises(SolverFailure, match="with room to verify it"):
        storage(late, T, 2.1 * np.eye(3))
