"""Lemma 1 as an analysis: yes with a storage matrix, no with a reason, never by the solver's status alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.errors import SolverFailure
from manyhands.design.models.coupling import transformed_coupling
from manyhands.design.models.statespace import StateSpace, storage_inequality
from manyhands.design.passivity import frequency, lemma1
from manyhands.design.passivity.frequency import least_hermitian_eigenvalue
from manyhands.design.passivity.lemma1 import analyse, verified_margin

seeds = st.integers(0, 2**32 - 1)


def random_stable(seed: int, n: int, m: int) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.2, 0.95) / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(m, n)), rng.normal(size=(m, m)))


@given(seeds, st.integers(1, 5), st.integers(1, 3), st.sampled_from([-0.3, -1e-3, 1e-3, 0.3]))
@settings(max_examples=40)
def test_input_levels_are_those_of_the_frequency_response(seed: int, n: int, m: int, above: float) -> None:
    """A stable system is Phi I-ISP just below the least Hermitian eigenvalue, and not above it."""
    system = random_stable(seed, n, m)
    value, _ = least_hermitian_eigenvalue(system)
    Phi = (value + above * max(1.0, abs(value))) * np.eye(m)
    finding = analyse(system, Phi=Phi)
    assert finding.holds == (above < 0.0)
    if finding.P is None:
        assert "energy is drawn at" in finding.reason
        assert finding.frequency is not None
        assert finding.margin < 0.0
        found = system.response(np.exp(1j * finding.frequency))
        assert np.linalg.eigvalsh((found + found.conj().T) / 2.0 - Phi)[0] < 0.0
    else:
        assert np.linalg.eigvalsh(finding.P)[0] > 0.0
        M = storage_inequality(system, finding.P, Phi=Phi)
        assert np.linalg.eigvalsh(M)[-1] < 0.0
        assert finding.margin > 0.0


@given(seeds, st.integers(1, 3), st.floats(0.1, 100.0), st.sampled_from([1e-6, 1.0, 1e6]), st.booleans())
@settings(max_examples=25)
def test_nothing_depends_on_units(seed: int, m: int, port: float, state: float, passive: bool) -> None:
    system = random_stable(seed, 3, m)
    value, _ = least_hermitian_eigenvalue(system)
    shifted = system.D + (0.2 - value if passive else -0.2 - value) * np.eye(m)
    units = np.array([state, 1.0, 1.0 / state])
    rescaled = StateSpace(
        system.A * units[:, None] / units, system.B * units[:, None] * port, port * system.C / units, shifted * port**2
    )
    assert analyse(rescaled).holds is passive


@given(st.data())
@settings(max_examples=20)
def test_a_network_is_passive_through_its_integrators(problems, data: st.DataObject) -> None:
    network = data.draw(problems.networks(tied=True))
    assert analyse(network.transformed_environment(1e-3)).holds


def test_example_1s_environment_has_a_little_to_spare(problems) -> None:
    E_hat = problems.network.transformed_environment(problems.T)
    assert analyse(E_hat, Phi=0.463 * np.eye(3)).holds
    refused = analyse(E_hat, Phi=0.4633 * np.eye(3))
    assert not refused.holds
    assert refused.frequency is not None


@pytest.mark.parametrize("name", ["C26", "C27", "C28"])
def test_the_couplings_of_the_paper_up_to_their_greatest_level(problems, name: str) -> None:
    coupling, loop = getattr(problems, name), problems.example_1(problems.centralised)
    V_hat = transformed_coupling(coupling.realisation(loop.period), loop.K, loop.period)
    _, _, greatest = problems.greatest_level(loop.Delta_D, coupling, loop.period)
    below = analyse(V_hat, 0.9999 * greatest)
    assert below.P is not None
    assert verified_margin(V_hat, below.P, 0.9999 * greatest, np.zeros((3, 3))) == pytest.approx(below.margin)
    assert not analyse(V_hat, 1.0001 * greatest).holds


def test_a_damped_mass_is_exactly_as_dissipative_as_its_damper() -> None:
    mass, b = 0.2, 1.37
    device = StateSpace([[-b / mass]], [[1.0 / mass]], [[1.0]], [[0.0]])
    finding = analyse(device, np.array([[b]]), time="continuous")
    assert finding.P is not None
    assert finding.P[0, 0] == pytest.approx(mass / 2.0, rel=1e-9)  # the kinetic energy, and nothing else
    assert finding.margin == 0.0
    refused = analyse(device, np.array([[1.000001 * b]]), time="continuous")
    assert not refused.holds
    assert refused.frequency == 0.0


def test_the_lossless_is_passive_and_no_more() -> None:
    """A mass on a spring: neutral at every frequency."""
    oscillator = StateSpace([[0.0, 1.0], [-4.0, 0.0]], [[0.0], [1.0]], [[0.0, 1.0]], [[0.0]])
    finding = analyse(oscillator, time="continuous")
    assert finding.P is not None
    np.testing.assert_allclose(finding.P, np.diag([2.0, 0.5]), rtol=1e-8, atol=1e-9)
    assert not analyse(oscillator, np.array([[1e-3]]), time="continuous").holds
    assert analyse(oscillator, np.array([[-1e-3]]), time="continuous").holds


def test_an_unstable_system_has_no_storage_although_its_frequencies_are_fine() -> None:
    """He G > 0 over the circle, but the pole at 1.1 is outside: only the sign of P shows it."""
    system = StateSpace([[1.1]], [[1.0]], [[-0.1]], [[5.0]])
    assert least_hermitian_eigenvalue(system)[0] > 0.0
    finding = analyse(system)
    assert not finding.holds
    assert "no positive definite storage" in finding.reason
    assert finding.frequency is None
    # and an unstable one that a negative level makes good
    assert analyse(StateSpace([[1.1]], [[1.0]], [[1.0]], [[5.0]]), np.array([[-1.0]])).holds


def test_what_is_counted_but_not_seen_has_no_positive_storage() -> None:
    finding = analyse(StateSpace([[1.0]], [[1.0]], [[0.0]], [[5.0]]))
    assert not finding.holds
    assert "vanishes in some state" in finding.reason
    assert analyse(StateSpace([[1.0]], [[0.0]], [[0.0]], [[5.0]])).holds


def test_an_unsymmetric_static_stiffness_admits_no_storage() -> None:
    k = np.array([[2.0, 1.0], [0.0, 2.0]])
    finding = analyse(StateSpace(np.eye(2), 1e-3 * np.eye(2), k, 1e-3 * k))
    assert not finding.holds


@pytest.mark.parametrize(
    ("gain", "holds"),
    [([[1.0, 2.0], [-2.0, 0.0]], True), ([[0.0]], True), ([[-1.0]], False), ([[0.0, 1.0]] * 2, False)],
)
def test_gains(gain: list[list[float]], holds: bool) -> None:
    assert analyse(StateSpace.static(gain)).holds is holds


@pytest.mark.parametrize(
    ("Delta", "words"),
    [
        (np.eye(3), "Delta: found 3 x 3; expected a 2 x 2 matrix"),
        (np.array([[1.0, 1.0], [0.0, 1.0]]), "Delta: expected a symmetric matrix"),
        (np.full((2, 2), np.nan), "Delta: expected finite"),
    ],
)
def test_bad_levels_are_refused(Delta: np.ndarray, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        analyse(StateSpace.static(np.eye(2)), Delta)


def test_an_unsquare_system_is_refused() -> None:
    with pytest.raises(ValueError, match="as many of both"):
        analyse(StateSpace.static([[1.0, 2.0]]))


def test_a_storage_matrix_that_does_not_prove_is_not_believed() -> None:
    system, zero = StateSpace([[0.5]], [[1.0]], [[0.2]], [[1.0]]), np.zeros((1, 1))
    finding = analyse(system)
    assert finding.P is not None
    assert verified_margin(system, finding.P, zero, zero) == pytest.approx(finding.margin)
    for wrong in (100.0 * finding.P, 1e-4 * finding.P, -finding.P, np.array([[np.nan]])):
        assert verified_margin(system, wrong, zero, zero) is None


def test_a_lying_solver_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever comes back as P is put into the inequality."""
    system = random_stable(1, 3, 2)
    value, _ = least_hermitian_eigenvalue(system)
    monkeypatch.setattr(lemma1, "_strictest", lambda units, face, Q: (np.diag([1e3, 1.0, 1e-3]), None))
    with pytest.raises(SolverFailure, match="too near the edge"):
        analyse(system, Phi=(value - 0.1) * np.eye(2))


def test_eigenvalues_that_are_not_found_are_a_failure_of_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_matrices: object, **_options: object) -> None:
        raise np.linalg.LinAlgError("ggev did not converge")

    monkeypatch.setattr(frequency, "eig", lost)
    with pytest.raises(SolverFailure, match="did not converge"):
        analyse(random_stable(1, 3, 2))
