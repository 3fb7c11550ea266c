"""Statics are decided exactly: no allowance, however small, beside entries however large."""

from __future__ import annotations

import copy
import json
import random
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from manyhands.design.certificate import content, identity
from manyhands.design.errors import Infeasible
from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import StateSpace, read_system
from manyhands.design.problem import DeviceLevel, HapticLoop, LinearGiven, SpringDamperWanted, Wish
from manyhands.design.proof import prove
from manyhands.design.synthesis import design

from ..support.cases import cases

CASES = cases(70, 200)  # of each side
Exact = list[list[Decimal]]


def loop(environment: Environment, T: float, joined: bool = False) -> HapticLoop:
    ports = environment.ports
    m = len(ports)
    devices = tuple(DeviceLevel(f"d{i}", (i,), np.array([[1.37]])) for i in range(m))
    partition = (
        Partition(("c",), (tuple(range(m)),))
        if joined
        else Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m)))
    )
    return HapticLoop("statics", T, ports, devices, partition, environment)


# --- random statics: exactly semidefinite, or exactly not, over 27 decades


def decimal(choose: random.Random, low: int, high: int) -> Decimal:
    """A few digits at any size."""
    return Decimal(choose.randint(1, 999)) * Decimal(10) ** choose.randint(low, high)


def semidefinite(choose: random.Random, m: int) -> Exact:
    """Sum of v v^T, short decimals: singular where there are fewer than m of them; also zero, and beside 1e15."""
    out = [[Decimal(0)] * m for _ in range(m)]
    sizes = [choose.randint(-6, 6) for _ in range(m)]
    for _ in range(choose.randint(0, m - 1)):
        v = [Decimal(choose.randint(-9, 9)) * Decimal(10) ** size for size in sizes]
        for i in range(m):
            for j in range(m):
                out[i][j] += v[i] * v[j]
    i = choose.randrange(m)
    if choose.random() < 0.5:  # one port by itself, as large or as small as can be
        for j in range(m):
            out[i][j] = out[j][i] = Decimal(0)
        out[i][i] = choose.choice((Decimal("-0.0"), decimal(choose, -12, -3), decimal(choose, 0, 12)))
    return out


def spoilt(choose: random.Random, true: Exact) -> Exact:
    """A hair off: one diagonal entry too small for what stands beside it, or a skew part."""
    m = len(true)
    out = [list(row) for row in true]
    size, least = Decimal(10) ** choose.randint(-14, -3), Decimal("1e-14")  # a float keeps 15 digits
    if m > 1 and choose.random() < 0.5:
        i, j = choose.sample(range(m), 2)
        out[i][j] += max(size, least * abs(out[i][j]))
    else:
        i = choose.randrange(m)
        pivot = least_pivot(true, i)
        if pivot > 0:
            out[i][i] -= Decimal(pivot.numerator) / Decimal(pivot.denominator)
        out[i][i] -= max(size * abs(out[i][i]), least * abs(true[i][i])) or size
    return out


def least_pivot(M: Exact, k: int) -> Fraction:
    """What is left of entry (k, k) beside the others: zero in a singular direction that has it."""
    m = len(M)
    order = [i for i in range(m) if i != k] + [k]
    rest = [[Fraction(M[i][j]) for j in order] for i in order]
    for p in range(m - 1):
        if rest[p][p] == 0:
            continue
        for i in range(p + 1, m):
            ratio = rest[i][p] / rest[p][p]
            rest[i] = [a - ratio * b for a, b in zip(rest[i], rest[p], strict=True)]
    return rest[-1][-1]


def environments(choose: random.Random, E1: Exact) -> Environment:
    """One that has these statics: a constant, with springs' masses beside it, or with states that add nothing to it."""
    m = len(E1)
    ports = tuple(f"p{i}" for i in range(m))
    floats = [[float(entry) for entry in row] for row in E1]
    kind = choose.choice(("static", "transfer", "states", "discrete"))
    if kind == "static":
        return StateSpaceEnvironment(ports, StateSpace.static(floats))
    if kind == "transfer":
        entries = [[((value,), (1.0,)) for value in row] for row in floats]
        for i in range(m):  # a mass and a damper at every port: M/T^2 is large beside E1
            M, b = choose.choice((0.05, 0.5, 100.0)), choose.choice((0.1, 2.0))
            entries[i][i] = ((M, b, floats[i][i]), (1.0,))
        return TransferEnvironment(ports, tuple(tuple(row) for row in entries))
    A = -np.diag(np.arange(1.0, m + 1.0)) if kind == "states" else np.diag(0.5 / np.arange(1.0, m + 1.0))
    # Maxwell elements: they yield, so that E1 is what is stated and D is stiffer by 3 N/m at every port
    inner = StateSpace.with_static_gain(A, np.eye(m), 0.0 * A, floats, continuous=kind == "states")
    C = -3.0 * (-A if kind == "states" else np.eye(m) - A)
    yielding = StateSpace.with_static_gain(inner.A, inner.B, C, floats, continuous=kind == "states")
    return StateSpaceEnvironment(ports, yielding, "backward-euler" if kind == "states" else None)


def problem(choose: random.Random, E1: Exact) -> HapticLoop:
    return loop(environments(choose, E1), choose.choice((1e-5, 2.5e-4, 1e-3, 1e-2)))


@pytest.fixture(scope="module")
def certified() -> list[tuple[int, Exact, dict[str, object]]]:
    """Certificates of the true side, with the seed of each."""
    out = []
    for seed in range(CASES):
        choose = random.Random(seed)
        true = semidefinite(choose, choose.randint(1, 3))
        proved = design(problem(choose, true), SpringDamperWanted(Wish())).certificate
        out.append((seed, true, json.loads(json.dumps(content(proved)))))
    return out


@pytest.mark.wide
def test_what_is_semidefinite_is_certified(certified) -> None:
    """Singular, -0.0, entries from 1e-12 to 1e15 in one matrix: nothing of it is in the way."""
    for seed, _, data in certified:
        data["id"] = identity(data)
        assert all(finding.holds for finding in prove(data)), seed
    greatest = [max(abs(entry) for row in E1 for entry in row) for _, E1, _ in certified]
    assert max(greatest) > Decimal("1e12")
    assert sum(least_pivot(E1, 0) == 0 for _, E1, _ in certified) > CASES // 4


@pytest.mark.wide
def test_design_and_proof_refuse_statics_that_are_off_by_a_hair(certified) -> None:
    """The design refuses the session; the proof refuses its forged certificate: the one of the true neighbour."""
    for seed, true, data in certified:
        choose = random.Random(f"spoilt {seed}")
        false = spoilt(choose, true)
        again = random.Random(seed)
        semidefinite(again, again.randint(1, 3))  # the same kind of environment as the true one's
        session = problem(again, false)
        with pytest.raises(Infeasible) as refused:
            design(session, SpringDamperWanted(Wish()))
        reason = str(refused.value)
        assert "E(1) is not symmetric" in reason or "E(1) is not positive semidefinite" in reason, (seed, reason)
        assert "expected" in reason, (seed, reason)
        forged = copy.deepcopy(data)
        forged["environment"] = environment_data(session, data)
        forged["id"] = identity(forged)
        failed = [finding for finding in prove(forged) if not finding.holds]
        assert failed, seed
        assert failed[0].condition.startswith("the static stiffness E1"), (seed, failed)


def environment_data(session: HapticLoop, like: dict[str, object]) -> object:
    return json.loads(json.dumps(session.environment.terms()))


# --- the couplings' side


def test_a_small_static_block_beside_a_soft_one_must_be_symmetric() -> None:
    """A skew part of 2e-3 m/N is the whole of its own entry, whatever the compliance beside it is."""
    walls = StateSpaceEnvironment(("a", "b", "c"), StateSpace.static(5000.0 * np.eye(3)))
    V = StateSpace.static([[2e-3, 2e-3, 0.0], [-2e-3, 2e-3, 0.0], [0.0, 0.0, 2.1e9]])
    with pytest.raises(Infeasible, match=r"V\(1\) is not symmetric.*\(a, b\) is 0.002.*\(b, a\) is -0.002"):
        design(loop(walls, 1e-3, joined=True), LinearGiven((V,)))


def test_a_certificate_of_such_a_block_is_not_proved() -> None:
    walls = StateSpaceEnvironment(("a", "b", "c"), StateSpace.static(5000.0 * np.eye(3)))
    V = StateSpace.static(np.diag([2e-3, 2e-3, 1.0]))
    data = json.loads(json.dumps(content(design(loop(walls, 1e-3, joined=True), LinearGiven((V,))).certificate)))
    data["id"] = identity(data)
    assert all(finding.holds for finding in prove(data))
    D = data["coupling"]["blocks"]["c"]["D"]
    for skew in (2e-3, 1e-12, 1e-30):
        D[0][1], D[1][0] = skew, -skew
        data["id"] = identity(data)
        assert any("not symmetric" in finding.argument for finding in prove(data) if not finding.holds), skew


def test_a_static_gain_without_end_can_be_stated() -> None:
    """D = K - C (I - A)^-1 B has no end here; E(1) has one, and is what the session means."""
    A, B, C = np.diag([0.7, 0.9]), np.eye(2), np.array([[-9.0, -3.0], [-3.0, -7.0]])
    E1 = [[100.0, -20.0], [-20.0, 80.0]]
    stated = StateSpaceEnvironment(("a", "b"), StateSpace.with_static_gain(A, B, C, E1))
    assert design(loop(stated, 1e-3), SpringDamperWanted(Wish())).certificate.id
    floats = StateSpaceEnvironment(("a", "b"), StateSpace(A, B, C, stated.system.D))
    assert np.allclose(floats.system.response(1.0).real, E1)
    with pytest.raises(
        Infeasible, match=r"not symmetric by its own decimals.*expected the same twice, .*the key static"
    ):
        design(loop(floats, 1e-3), SpringDamperWanted(Wish()))


def test_a_pole_at_rest_has_no_static_gain() -> None:
    with pytest.raises(ValueError, match="found a pole at z = 1"):
        StateSpace.with_static_gain([[1.0]], [[1.0]], [[1.0]], [[1.0]])
    rotor = TransferEnvironment(("p",), ((((1.0,), (1.0, 0.0)),),))
    with pytest.raises(
        Infeasible, match=r"entry \(p, p\) has a pole at s = 0.*velocity to force is to be multiplied by s"
    ):
        design(loop(rotor, 1e-3), SpringDamperWanted(Wish()))
    held = StateSpaceEnvironment(("p",), StateSpace([[1.0]], [[1.0]], [[1.0]], [[1.0]]))
    with pytest.raises(
        Infeasible,
        match=r"has a pole at z = 1.*one from velocity to force is to be multiplied by s, or by \(z - 1\)/\(T z\)",
    ):
        design(loop(held, 1e-3), SpringDamperWanted(Wish()))


def test_numbers_are_the_decimals_that_are_written() -> None:
    """det [[0.1, 0.07], [0.07, 0.049]] is zero as it is written, and below zero in the binary floats next to it."""
    singular = [[0.1, 0.07], [0.07, 0.049]]
    assert Fraction(0.1) * Fraction(0.049) - Fraction(0.07) ** 2 < 0
    E = StateSpaceEnvironment(("a", "b"), StateSpace.static(singular))
    assert design(loop(E, 1e-3), SpringDamperWanted(Wish())).certificate.id
    less = [[0.1, 0.07], [0.07, 0.0489999999999999]]
    with pytest.raises(Infeasible, match=r"less than the other entries need: expected at least 0\.049 N/m"):
        design(loop(StateSpaceEnvironment(("a", "b"), StateSpace.static(less)), 1e-3), SpringDamperWanted(Wish()))


def test_a_stated_static_gain_leaves_no_entries_without_states() -> None:
    """They would be dropped in silence, and the file would not be the certificate any more."""
    data = {"A": [], "B": [[1.0]], "C": [[1.0]], "static": [[100.0]]}
    with pytest.raises(ValueError, match="expected B and C without entries where A has none"):
        read_system(data)
    assert read_system({**data, "B": [], "C": [[]]}).D.tolist() == [[100.0]]
