"""Analysis and best levels against python-control's passivity functions, on random stable systems.

python-control asks CVXOPT for the same inequalities in the coordinates as given, without reduction of neutral
directions and without a look at what comes back. Every outcome is put into one of the classes below; whatever is
not agreement in a number has to be explained by something computed here from zeros or frequency responses, and the
number of each is bounded. Nothing is skipped.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import control
import numpy as np
import pytest

from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.models.statespace import StateSpace, Time
from manyhands.design.passivity.best_level import greatest_input_level, greatest_output_level
from manyhands.design.passivity.lemma1 import analyse

from ...support import cases as searches

COUNT = searches.cases(102, 204)
AGREE = (
    1e-5  # relative to the level or 1: CVXOPT's feastol 1e-7 in unscaled coordinates, and what ours gives away (1e-6)
)
RUNAWAY = -1e4  # an "optimum" below that, from data of size 1, is a solver that ran off along an unbounded ray

pytestmark = pytest.mark.wide


@dataclass(frozen=True)
class Case:
    """One system and the answers of both sides; a string is the class of a failure."""

    number: int
    system: StateSpace
    time: Time
    least: float
    holds: bool
    theirs_holds: bool
    ours: dict[str, float | str]
    theirs: dict[str, float | str]


def random_system(rng: np.random.Generator, time: Time) -> StateSpace:
    """Order 1 ... 5, 1 ... 3 ports, stable; shifted to be passive, or not, by a few percent to a half of its size.

    A quarter of the continuous ones are strictly proper instead, as devices are, and left as they fall.
    """
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A)
    if time == "discrete":
        A = A * rng.uniform(0.2, 0.95) / np.abs(poles).max()
    else:
        A = A - (poles.real.max() + rng.uniform(0.1, 1.0)) * np.eye(n)
    B, C, D = rng.normal(size=(n, m)), rng.normal(size=(m, n)), rng.normal(size=(m, m))
    least = least_on_a_grid(StateSpace(A, B, C, D), time)
    if time == "continuous" and rng.integers(0, 4) == 0:
        return StateSpace(A, B, C, np.zeros((m, m)))
    side = rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.5) * (1.0 + abs(least))
    return StateSpace(A, B, C, D + (side - least) * np.eye(m))


def responses(system: StateSpace, time: Time) -> np.ndarray:
    """G at 600 frequencies, 600 x m x m: an independent look, nothing but resolvents."""
    if time == "discrete":
        points = np.exp(1j * np.linspace(0.0, np.pi, 600))
    else:
        points = 1j * np.array([0.0, *np.logspace(-3, 4, 598), 1e9])
    resolvents = np.linalg.inv(points[:, None, None] * np.eye(system.order) - system.A)
    return system.C @ resolvents @ system.B + system.D


def least_eigenvalue(G: np.ndarray) -> float:
    return float(np.linalg.eigvalsh((G + np.conj(np.swapaxes(G, 1, 2))) / 2.0).min())


def least_on_a_grid(system: StateSpace, time: Time) -> float:
    return least_eigenvalue(responses(system, time))


def level_on_a_grid(system: StateSpace, time: Time, role: str) -> float:
    """No level of this role can be above it: He G >= d I, and He G^-1 >= d I where G is not singular."""
    G = responses(system, time)
    return least_eigenvalue(G if role == "input" else np.linalg.inv(G[np.linalg.cond(G) < 1e8]))


def has_no_output_level(system: StateSpace, time: Time) -> bool:
    """Whether output feedback of any size leaves the system short of passive: zeros decide.

    With an invertible D, greater and greater feedback moves the poles to the zeros, the eigenvalues of
    A - B D^-1 C, so that one of them on the unstable side rules out every level. Without D (continuous),
    P B = C^T/2 makes C B = 2 B^T P B symmetric and positive, and the zeros are those of the other states.
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    if np.any(D):
        zeros = np.linalg.eigvals(A - B @ np.linalg.solve(D, C))
        return bool(np.any(np.abs(zeros) > 1.0) if time == "discrete" else np.any(zeros.real > 0.0))
    high = C @ B
    if np.abs(high - high.T).max() > 1e-9 or np.linalg.eigvalsh((high + high.T) / 2.0)[0] <= 1e-9:
        return True
    silent = np.eye(len(A)) - B @ np.linalg.solve(high, C)  # the zero dynamics, along C psi = 0
    zeros = np.linalg.eigvals(silent @ A)
    return bool(np.any(zeros.real > 1e-9))


def theirs(function, system: control.StateSpace) -> float | str:
    try:
        return float(function(system))
    except (RuntimeError, ValueError) as error:
        for words, name in (("problem is infeasible", "infeasible"), ("ill conditioned", "gives up")):
            if words in str(error):
                return name
        raise


def ours(function, system: StateSpace, time: Time) -> float | str:
    try:
        level = function(system, time=time)
    except Infeasible:
        return "infeasible"
    except SolverFailure:
        return "undecided"
    return float(level.value)


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    rng = np.random.default_rng(20100401)
    out = []
    for number in range(COUNT):
        time: Time = "discrete" if number % 2 else "continuous"
        system = random_system(rng, time)
        sample = (1.0,) if time == "discrete" else ()
        other = control.ss(system.A, system.B, system.C, system.D, *sample)
        out.append(
            Case(
                number,
                system,
                time,
                least_on_a_grid(system, time),
                analyse(system, time=time).holds,
                bool(control.ispassive(other)),
                {
                    "input": ours(greatest_input_level, system, time),
                    "output": ours(greatest_output_level, system, time),
                },
                {
                    "input": theirs(control.get_input_ff_index, other),
                    "output": theirs(control.get_output_fb_index, other),
                },
            )
        )
    return out


def test_both_call_the_same_systems_passive(cases: list[Case]) -> None:
    """Where the two differ, the frequency response decides which is right."""
    disagree = [case for case in cases if case.holds != case.theirs_holds]
    for case in cases:
        assert case.holds == (case.least >= 0.0), case.number  # shifted by percents, so that a grid can tell
    assert len(disagree) <= COUNT // 50, [case.number for case in disagree]
    passive = sum(case.holds for case in cases)
    assert COUNT // 4 <= passive <= 3 * COUNT // 4


def classify(case: Case, role: str) -> str:
    """The class of one pair of answers; fails on what has no explanation."""
    mine, other = case.ours[role], case.theirs[role]
    ran_off = isinstance(other, float) and other < RUNAWAY
    if isinstance(mine, float):
        ceiling = level_on_a_grid(case.system, case.time, role)
        scale = max(1.0, abs(mine))
        assert mine <= ceiling + 1e-9 * scale, (case.number, mine, ceiling)
        if isinstance(other, float) and abs(mine - other) <= AGREE * scale:
            return "agree"
        # ours is proved by its storage matrix and touches what frequencies allow: the other figure is the wrong one
        assert mine == pytest.approx(ceiling, abs=1e-2 * scale), (case.number, mine, other, ceiling)
        if isinstance(other, str):
            return f"python-control: {other}"
        return (
            "python-control: above what frequencies allow" if other > ceiling else "python-control: short of the best"
        )
    assert role == "output", case.number  # a stable system always has an input level
    if mine == "infeasible":
        assert has_no_output_level(case.system, case.time), case.number
        if other == "infeasible":
            return "agree that there is none"
        assert isinstance(other, float) or other == "gives up", (case.number, other)
        # a processor of another kind rounds otherwise, so that a solver that runs off may stop early, too
        names_one = "ran off" if ran_off else "names one"
        return "none exists; python-control " + (names_one if isinstance(other, float) else other)
    return "ours undecided"


@pytest.mark.parametrize("role", ["input", "output"])
def test_the_levels_agree_or_the_difference_is_explained(cases: list[Case], role: str) -> None:
    counts = Counter(classify(case, role) for case in cases)
    agreed = counts["agree"] + counts["agree that there is none"]
    unfinished = sum(counts[name] for name in counts if name.startswith("none exists"))
    assert agreed + unfinished >= 0.97 * COUNT, counts
    assert counts["agree"] >= (0.97 if role == "input" else 0.5) * COUNT, counts
    assert counts["ours undecided"] <= 0.01 * COUNT, counts
    # where no level exists and python-control does not say so: a fifth at most
    assert unfinished <= 0.2 * COUNT, counts


def test_levels_exist_exactly_where_the_zeros_say_so(cases: list[Case]) -> None:
    for case in cases:
        if isinstance(case.ours["output"], float):
            assert not has_no_output_level(case.system, case.time), case.number


def test_at_a_given_level_too(cases: list[Case]) -> None:
    """ispassive with an index, a little below and above ours."""
    wrong = []
    checked = 0
    for case in cases[::4]:
        level = case.ours["input"]
        assert isinstance(level, float)
        sample = (1.0,) if case.time == "discrete" else ()
        system = case.system
        other = control.ss(system.A, system.B, system.C, system.D, *sample)
        for step, holds in ((-0.05, True), (0.05, False)):
            at = level + step * max(1.0, abs(level))
            mine = analyse(system, Phi=at * np.eye(system.inputs), time=case.time).holds
            assert mine is holds, case.number
            checked += 1
            if bool(control.ispassive(other, ifp_index=at)) is not holds:
                wrong.append(case.number)
    assert len(wrong) <= checked // 50, wrong
