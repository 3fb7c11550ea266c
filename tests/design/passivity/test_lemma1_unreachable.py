"""Motions that no port moves or observes are separated: the rest behaves alike, and both together store energy."""

from __future__ import annotations

import numpy as np
import pytest

from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import StateSpace, storage_inequality
from manyhands.design.passivity.lemma1 import analyse, separated, storage_of_motion

T = 1e-3


def of_equal_masses(count: int, mass: float, k: float, b: float, *more: NetworkLink) -> StateSpace:
    """E_hat of equal masses on equal springs at one port, beside ``more`` links."""
    names = [f"m{i}" for i in range(count)]
    links = [NetworkLink(("p", name), k, b) for name in names]
    return Network(("p",), tuple((name, mass) for name in names), (*links, *more)).transformed_environment(T)


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("mass", [0.01, 0.1, 10.0])
@pytest.mark.parametrize("k", [1.0, 100.0, 1e4])
@pytest.mark.parametrize("b", [0.0, 1e-6, 1e-3, 1.0])
def test_equal_masses_that_swing_unseen_are_passive(count: int, mass: float, k: float, b: float) -> None:
    system = of_equal_masses(count, mass, k, b)
    finding = analyse(system)
    assert finding.holds
    assert finding.P is not None
    assert np.linalg.eigvalsh(finding.P)[0] > 0.0
    inequality = storage_inequality(system, finding.P)  # of E_hat, in whose states the energy is T/2 of a square
    assert np.linalg.eigvalsh(inequality)[-1] < 1e-9 * np.linalg.norm(inequality, 2)


@pytest.mark.parametrize(
    "more",
    [
        (NetworkLink(("m0", "m1"), 100.0, 1e-3),),
        (NetworkLink(("m0", GROUND), 100.0, 0.0), NetworkLink(("m1", GROUND), 100.0, 0.0)),
        (NetworkLink(("m0", GROUND), 100.0, 1e-6), NetworkLink(("m1", GROUND), 100.0, 2e-6)),  # coupled, but weakly
    ],
)
def test_equal_masses_that_are_joined_are_passive(more: tuple[NetworkLink, ...]) -> None:
    assert analyse(of_equal_masses(2, 0.1, 100.0, 1e-6, *more)).holds


def test_hidden_motions_make_no_system_passive() -> None:
    """The reachable part decides: a level that two masses lack is refused with the same reason as for their sum."""
    finding = analyse(of_equal_masses(2, 0.1, 100.0, 1e-3), Phi=np.array([[1.0]]))
    assert not finding.holds
    assert finding.frequency is not None


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("count", [2, 3])
def test_the_reachable_part_answers_like_the_whole(count: int, unit: float) -> None:
    system = of_equal_masses(count, 0.2, 300.0, 0.01)
    units = unit ** np.linspace(-1.0, 1.0, system.order)
    system = StateSpace(system.A * units / units[:, None], system.B / units[:, None], system.C * units, system.D)
    parts = separated(system)
    assert parts.reachable.order == 2  # a mass swings against the port, and no more
    assert len(parts.P_u) == system.order - parts.reachable.order
    for angle in (1e-3, 0.1, 3.0):
        z = np.exp(1j * angle)
        np.testing.assert_allclose(parts.reachable.response(z), system.response(z), rtol=1e-9)


def test_storage_of_the_whole_is_that_of_both() -> None:
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    A = turn @ np.diag([0.5, 0.9, -0.3]) @ turn.T
    system = StateSpace(A, turn[:, :1], turn[:, :1].T, [[0.0]])
    parts = separated(system)
    assert parts.reachable.order == 1
    P = parts.storage(np.array([[7.0]]))
    assert turn[:, 0] @ P @ turn[:, 0] == pytest.approx(7.0)
    assert np.linalg.eigvalsh(P - A.T @ P @ A)[0] > 0.0


@pytest.mark.parametrize(
    "system",
    [
        StateSpace([[0.5]], [[1.0]], [[0.0]], [[1.0]]),  # reachable, not observable
        StateSpace([[0.5]], [[0.0]], [[1.0]], [[1.0]]),  # observable, not reachable
        StateSpace([[1.1]], [[0.0]], [[0.0]], [[1.0]]),  # grows by itself
        StateSpace([[0.5, 0.1], [0.0, 0.5]], [[1.0], [0.0]], [[0.0, 1.0]], [[1.0]]),  # not side by side
        StateSpace.static([[1.0]]),
    ],
)
def test_what_cannot_be_taken_apart_is_left_whole(system: StateSpace) -> None:
    assert separated(system).reachable is system


@pytest.mark.parametrize(
    "A",
    [
        [[0.5, 0.0], [0.0, -0.9]],
        [[0.6, 0.8], [-0.8, 0.6]],  # on the circle: nothing is lost, and nothing gained
        [[0.9, 1.0], [0.0, 0.9]],  # no two eigenvectors
    ],
)
def test_a_motion_stores_less_and_less(A: list[list[float]]) -> None:
    P = storage_of_motion(np.array(A))
    assert P is not None
    assert np.linalg.eigvalsh(P)[0] > 0.0
    assert np.linalg.eigvalsh(P - np.array(A).T @ P @ np.array(A))[0] >= -1e-12 * np.linalg.norm(P)


@pytest.mark.parametrize("A", [[[1.0, 1.0], [0.0, 1.0]], [[1.01]]])
def test_a_motion_that_grows_has_no_storage(A: list[list[float]]) -> None:
    assert storage_of_motion(np.array(A)) is None
