"""Cone complementarity finds inverses if there are any, and reports how far it got if it stops short."""

import re

import cvxpy as cp
import numpy as np
import pytest

from manyhands.design import theorem4
from manyhands.design.errors import NotConverged, SolverFailure
from manyhands.design.models.statespace import Matrix
from manyhands.design.solver import ProgramInfeasible, value
from manyhands.design.theorem4 import TOLERANCE, Interrupted, Pair, Relaxed, StoppedShort, complement


def output_feedback(A: Matrix, B: Matrix, C: Matrix, radius: float = 1.0) -> Relaxed[Matrix]:
    """Find F such that A + B F C has its eigenvalues within ``radius``: the problem the method was published for."""
    n = len(A)
    F = cp.Variable((B.shape[1], C.shape[0]))
    pair = Pair(cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True))
    closed = (A + B @ F @ C) / radius
    stable = cp.bmat([[pair.Z, closed.T], [closed, pair.W]]) >> 1e-2 * np.eye(2 * n)
    # in the size of the storage there is no scale of its own
    return Relaxed([stable, pair.W << 1e2 * np.eye(n)], [pair], lambda: value(F), "output feedback")


def stabilisable(seed: int) -> tuple[Matrix, Matrix, Matrix]:
    """An unstable system of order 3 that some F makes stable; only this function knows F."""
    rng = np.random.default_rng(seed)
    closed, B, C = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(2, 3))
    closed *= 0.7 / np.max(np.abs(np.linalg.eigvals(closed)))
    while True:
        A = closed - B @ rng.normal(size=(2, 2)) @ C
        if np.max(np.abs(np.linalg.eigvals(A))) > 1.2:
            return A, B, C


@pytest.mark.parametrize("seed", range(8))
def test_static_output_feedback(seed: int) -> None:
    A, B, C = stabilisable(seed)
    told: list[str] = []
    F, convergence = complement(output_feedback(A, B, C), progress=told.append)
    assert np.max(np.abs(np.linalg.eigvals(A + B @ F @ C))) < 1.0
    assert convergence.residuals[-1] < TOLERANCE
    assert convergence.iterations == len(convergence.residuals) - 1
    assert told == [f"iteration {i}, |WZ - I| = {r:.1e}" for i, r in enumerate(convergence.residuals)]


def test_the_residual_is_the_spectral_norm() -> None:
    pair = Pair(cp.Variable((2, 2), symmetric=True), cp.Variable((2, 2), symmetric=True))
    pair.W.value, pair.Z.value = np.diag([2.0, 1.0]), np.diag([0.5, 4.0])
    assert pair.residual() == pytest.approx(3.0, rel=1e-14)
    assert float(np.max(pair.cone().violation())) < 1e-12
    pair.Z.value = np.diag([0.4, 4.0])  # Z < W^-1
    assert float(np.max(pair.cone().violation())) > 0.01


def hopeless() -> Relaxed[Matrix]:
    """A double integrator with its position fed back: the relaxed program has a solution, the program none."""
    A, B, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    return output_feedback(A, B, C)


def test_a_program_without_solution_does_not_converge_and_reports_its_residual() -> None:
    with pytest.raises(
        StoppedShort, match=r"output feedback: stopped after 12 iterations at .*, wanted < 1e-04"
    ) as error:
        complement(hopeless(), iterations=12)
    residuals = error.value.convergence.residuals
    assert error.value.convergence.iterations == 12
    assert min(residuals) > 100 * TOLERANCE
    assert isinstance(error.value, NotConverged)


def test_the_best_iterate_is_kept_not_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    relaxed = hopeless()
    F: list[Matrix] = []
    residuals = iter([3.0, 0.5, 0.01, 0.2, 7.0])
    monkeypatch.setattr(Pair, "residual", lambda _: next(residuals))

    def recover() -> Matrix:
        F.append(relaxed.recover())
        return F[-1]

    with pytest.raises(StoppedShort) as error:
        complement(Relaxed(relaxed.constraints, relaxed.pairs, recover, "x"), iterations=4)
    assert error.value.best is F[2]
    assert error.value.convergence.residuals == (3.0, 0.5, 0.01, 0.2, 7.0)


def test_what_is_infeasible_before_any_iteration() -> None:
    relaxed = hopeless()
    wrong = relaxed.pairs[0].W << -np.eye(2)
    with pytest.raises(ProgramInfeasible):
        complement(Relaxed([*relaxed.constraints, wrong], relaxed.pairs, relaxed.recover, "x"))


@pytest.mark.parametrize("at", [0, 1, 3])
def test_ctrl_c_keeps_the_best(at: int) -> None:
    relaxed = hopeless()
    found: list[Matrix] = []

    def recover() -> Matrix:
        found.append(relaxed.recover())
        return found[-1]

    def progress(text: str) -> None:
        if text.startswith(f"iteration {at},"):
            raise KeyboardInterrupt

    with pytest.raises(Interrupted, match=f"interrupted after {at} iterations") as error:
        complement(Relaxed(relaxed.constraints, relaxed.pairs, recover, "x"), progress=progress)
    residuals = error.value.convergence.residuals
    assert len(residuals) == at + 1
    assert error.value.best is found[int(np.argmin(residuals))]


def test_ctrl_c_before_anything_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_problem: object, _what: str) -> float:
        raise KeyboardInterrupt

    monkeypatch.setattr(theorem4, "solve", interrupted)
    with pytest.raises(Interrupted, match="before the first feasible point") as error:
        complement(hopeless())
    assert error.value.best is None
    assert error.value.convergence.iterations == 0


def test_an_exit_passes_through() -> None:
    def leave(_text: str) -> None:
        raise SystemExit(3)

    with pytest.raises(SystemExit):
        complement(hopeless(), progress=leave)


@pytest.mark.parametrize("failure", [SolverFailure("gave up"), ProgramInfeasible("x")])
def test_a_solver_that_stumbles_on_the_way(monkeypatch: pytest.MonkeyPatch, failure: Exception) -> None:
    honest = theorem4.solve

    def stumbling(problem: cp.Problem, what: str) -> float:
        if what.endswith("iteration 2"):
            raise failure
        return honest(problem, what)

    monkeypatch.setattr(theorem4, "solve", stumbling)
    with pytest.raises(StoppedShort, match=re.escape("no solution in iteration 2, after 1 iterations")) as error:
        complement(hopeless())
    assert error.value.best is not None
    assert error.value.__cause__ is failure


def test_an_iterate_without_an_answer() -> None:
    """Where the last iterate cannot be read, an earlier one may be."""
    A, B, C = stabilisable(0)
    relaxed = output_feedback(A, B, C)
    seen: list[Matrix] = []

    def recover() -> Matrix | None:
        seen.append(relaxed.recover())
        return seen[0] if len(seen) == 1 else None

    with pytest.raises(StoppedShort, match="the last iterate gives no coupling") as error:
        complement(Relaxed(relaxed.constraints, relaxed.pairs, recover, "x"))
    assert error.value.best is seen[0]


def test_a_negative_cap_is_the_callers_mistake() -> None:
    with pytest.raises(ValueError, match="cap of -1 iterations"):
        complement(hopeless(), iterations=-1)
