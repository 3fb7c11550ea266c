"""The best levels: closed forms, frequency bounds, and every storage matrix put back."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.errors import Infeasible
from manyhands.design.models.coupling import Partition, transformed_coupling
from manyhands.design.models.statespace import StateSpace
from manyhands.design.passivity.best_level import greatest_input_level, greatest_output_level
from manyhands.design.passivity.lemma1 import analyse, verified_margin

seeds = st.integers(0, 2**32 - 1)
SHARP = 2e-6  # what is given away for a checked storage matrix, relative to the level or 1


def passive(seed: int, n: int, m: int) -> StateSpace:
    """Stable, D large enough for He G > 0."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.2, 0.9) / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-9)
    B, C = rng.normal(size=(n, m)), rng.normal(size=(m, n))
    radius = sum(np.linalg.norm(C @ np.linalg.matrix_power(A, k) @ B, 2) for k in range(200))
    skew = rng.normal(size=(m, m))
    return StateSpace(A, B, C, (1.1 * radius + 0.1) * np.eye(m) + skew - skew.T)


@pytest.mark.parametrize("name", ["C26", "C27", "C28"])
def test_the_closed_form_of_the_spring_damper_class(problems, name: str) -> None:
    coupling, loop = getattr(problems, name), problems.example_1(problems.centralised)
    V_hat = transformed_coupling(coupling.realisation(loop.period), loop.K, loop.period)
    _, _, greatest = problems.greatest_level(loop.Delta_D, coupling, loop.period)
    scalar, matrix = greatest_output_level(V_hat), greatest_output_level(V_hat, "matrix")
    least = np.linalg.eigvalsh(greatest)[0]
    assert scalar.value == pytest.approx(least, rel=1e-6)
    assert scalar.bound == pytest.approx(least, rel=1e-6)
    assert matrix.value == pytest.approx(np.trace(greatest), rel=2e-6)
    assert matrix.value <= np.trace(greatest) * (1.0 + 1e-9)
    np.testing.assert_allclose(matrix.matrix, greatest, atol=2e-5 * np.trace(greatest))
    # its differentiator lets no input level be positive, and none is lacking
    assert greatest_input_level(V_hat).value == 0.0


def test_example_1s_environment(problems) -> None:
    E_hat = problems.network.transformed_environment(problems.T)
    level = greatest_input_level(E_hat)
    assert level.value == pytest.approx(0.463, abs=5e-4)
    assert level.bound == pytest.approx(level.value, rel=5e-5)
    richer = [greatest_input_level(E_hat, shape).value for shape in ("scalar", "diagonal", "matrix")]
    assert 3.0 * richer[0] <= richer[1] < richer[2]
    # its integrators let no output level be positive
    assert greatest_output_level(E_hat, "matrix").value == 0.0


@given(seeds, st.integers(0, 4), st.integers(1, 3), st.sampled_from(["output", "input"]))
@settings(max_examples=20)
def test_the_scalar_level_meets_its_bound(seed: int, n: int, m: int, role: str) -> None:
    system = passive(seed, n, m)
    level = greatest_output_level(system) if role == "output" else greatest_input_level(system)
    assert level.bound is not None
    assert level.bound - SHARP * max(1.0, abs(level.bound)) <= level.value <= level.bound * (1.0 + 1e-9)
    zero = np.zeros((m, m))
    levels = (level.matrix, zero) if role == "output" else (zero, level.matrix)
    assert verified_margin(system, level.P, *levels) is not None
    beyond = (level.bound + 1e-5 * max(1.0, abs(level.bound))) * np.eye(m)
    assert not (analyse(system, beyond) if role == "output" else analyse(system, Phi=beyond)).holds


@given(seeds, st.integers(1, 3))
@settings(max_examples=5)
def test_richer_shapes_are_never_worse(seed: int, n: int) -> None:
    system = passive(seed, n, 3)
    partition = Partition(("a", "b"), ((0, 2), (1,)))
    for best in (greatest_output_level, greatest_input_level):
        levels = [best(system, shape) for shape in ("scalar", "diagonal", partition, "matrix")]
        traces = [float(np.trace(level.matrix)) for level in levels]
        for poorer, richer in itertools.pairwise(traces):
            assert richer >= poorer - 1e-5 * max(1.0, abs(poorer))
        assert partition.admits(levels[2].matrix)
        assert np.count_nonzero(levels[1].matrix - np.diag(np.diag(levels[1].matrix))) == 0
        # no direction of the matrix level can be raised while the others stay
        for direction in np.eye(3):
            raised = levels[3].matrix + 1e-3 * abs(traces[3]) * np.outer(direction, direction)
            assert not (analyse(system, raised) if best is greatest_output_level else analyse(system, Phi=raised)).holds


def test_gains() -> None:
    """y = D u: y^T D^-T y - y^T Delta y, so Delta* = He D^-1; u^T D u - u^T Phi u, so Phi* = He D."""
    D = np.array([[2.0, 1.5], [0.5, 3.0]])
    gain = StateSpace.static(D)
    inverse = np.linalg.inv(D)
    for level, expected in ((greatest_output_level, inverse), (greatest_input_level, D)):
        hermitian = (expected + expected.T) / 2.0
        np.testing.assert_allclose(level(gain, "matrix").matrix, hermitian, atol=1e-5)
        assert level(gain).value == pytest.approx(np.linalg.eigvalsh(hermitian)[0], abs=1e-6)


def test_one_level_costs_the_other() -> None:
    gain = StateSpace.static([[2.0]])
    for Phi in (0.0, 1.0, 1.9):  # 2 - 4 d - Phi >= 0
        assert greatest_output_level(gain, Phi=np.array([[Phi]])).value == pytest.approx((2.0 - Phi) / 4.0, abs=1e-6)
    for Delta in (0.0, 0.25, 0.5):
        found = greatest_input_level(gain, Delta=np.array([[Delta]])).value
        assert found == pytest.approx(2.0 - 4.0 * Delta, abs=1e-6)


def test_a_level_can_be_missing_and_the_storages_sign_can_bind() -> None:
    unstable = StateSpace([[1.1]], [[1.0]], [[1.0]], [[5.0]])
    level = greatest_output_level(unstable)
    assert level.value == pytest.approx(-0.2, abs=1e-6)
    with pytest.raises(Infeasible, match="no input level"):
        greatest_input_level(unstable)


def test_a_zero_outside_the_circle_rules_out_every_output_level() -> None:
    """At such a zero the output is silent while the state grows: energy from nowhere, whatever Delta."""
    with pytest.raises(Infeasible, match="no output level"):
        greatest_output_level(StateSpace([[0.5]], [[1.0]], [[-2.0]], [[1.0]]))  # zero at 2.5


def test_a_silent_output_has_every_level() -> None:
    with pytest.raises(ValueError, match="zero in some direction"):
        greatest_output_level(StateSpace.static([[0.0]]))
    with pytest.raises(ValueError, match="zero in some direction"):
        greatest_output_level(StateSpace.static(np.diag([1.0, 0.0])), "diagonal")
    assert greatest_output_level(StateSpace.static(np.diag([2.0, 0.0]))).value == pytest.approx(0.5, abs=1e-6)


def test_a_partition_must_fit() -> None:
    with pytest.raises(ValueError, match="found a partition of 1 ports; expected 2"):
        greatest_input_level(StateSpace.static(np.eye(2)), Partition(("a",), ((0,),)))


def test_continuous_time() -> None:
    """A mass and a damper: b-OSP, with no input level to spare."""
    device = StateSpace([[-1.37 / 0.2]], [[1.0 / 0.2]], [[1.0]], [[0.0]])
    assert greatest_output_level(device, time="continuous").value == pytest.approx(1.37, rel=1e-6)
    assert greatest_input_level(device, time="continuous").value == 0.0
