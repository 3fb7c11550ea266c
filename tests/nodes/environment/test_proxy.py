"""Springs to proxies: no proposal of any model breaks the promise, and honest proxies are never held."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.nodes.environment.enforced import BlackBox, EnforcedCore
from manyhands.nodes.environment.model import MOST_POSITION, AskedModel
from manyhands.nodes.environment.proxy import ProxyLaw
from manyhands.nodes.kernel.passivity import greatest_part

from ...support.cases import EXAMPLES, WIDE_EXAMPLES, cases
from ...support.reaction import react

T = 1e-3
PORTS = ("p", "q", "r")
BLOCKS = ([0, 2], [1])  # not contiguous
D_V = np.array([[1 / 700, 0, 1e-4], [0, 1 / 900, 0], [2e-4, 0, 1 / 1000]])  # m/N
K_JOINED = np.array([[2000.0, 300.0, 0.0], [300.0, 900.0, -100.0], [0.0, -100.0, 5e4]])  # joins ports of both blocks
Answer = Callable[[np.ndarray, int], Any]


class Model:
    """A model whose proxies are a function of the tools and the tick."""

    def __init__(self, answer: Answer) -> None:
        self._answer = answer

    def proxy(self, x: np.ndarray, k: int) -> Any:
        return self._answer(x, k)

    def react(self, x_e: np.ndarray, k: int) -> Any:
        return -1000.0 * (x_e - self._answer(x_e, k))


def core_of(
    answer: Answer, K: np.ndarray | float = 1000.0, level: np.ndarray | None = None, enforce: bool = False
) -> EnforcedCore:
    """A core with ramps of 20 ticks; without a controller, so that the test alone keeps the ledger."""
    m = len(PORTS)
    K, Phi = np.zeros((m, m)) + K * np.eye(m) if np.isscalar(K) else K, np.zeros((m, m)) if level is None else level
    law = ProxyLaw(AskedModel("some:model", Model(answer), PORTS), np.asarray(K), Phi, T, BLOCKS)
    return EnforcedCore(law, D_V, Phi, T, enforce, BLOCKS, 20)


def hands(rng: np.random.Generator, ticks: int) -> np.ndarray:
    """Free tool positions that wander, jump and rest."""
    steps = rng.normal(0.0, 1e-4, (ticks, 3)) * (rng.random((ticks, 1)) < 0.7)
    steps[rng.random(ticks) < 0.02] *= 100.0
    return np.cumsum(steps, axis=0)


def hostile(kind: str, rng: np.random.Generator) -> Answer:
    """Proxies that would pull energy out of nothing wherever they can."""
    last = np.zeros(3)

    def ahead(x: np.ndarray, k: int) -> np.ndarray:
        nonlocal last
        v, last = x - last, x
        return x + 50.0 * v

    def jumps(x: np.ndarray, k: int) -> np.ndarray:
        return 10.0 ** rng.uniform(-4.0, 2.9) * rng.uniform(-1.0, 1.0, 3)

    def shaker(x: np.ndarray, k: int) -> np.ndarray:
        return np.full(3, 0.1 * (-1.0) ** k)

    def runaway(x: np.ndarray, k: int) -> np.ndarray:
        return x + 1e-3 * k

    def discs(x: np.ndarray, k: int) -> np.ndarray:
        """The nearest point outside overlapping discs: a projection that is not continuous."""
        q = np.array(x)
        for centre in ((0.002, 0.001), (-0.001, 0.002), (0.0, -0.002)):
            away = q[:2] - centre
            distance = float(np.hypot(*away))
            if distance < 0.003:
                q[:2] = centre + (away / distance if distance > 0.0 else np.array([1.0, 0.0])) * 0.003
        return q

    return {"ahead": ahead, "jumps": jumps, "shaker": shaker, "runaway": runaway, "discs": discs}[kind]


@settings(max_examples=cases(20, 4 * WIDE_EXAMPLES))
@given(
    kind=st.sampled_from(["ahead", "jumps", "shaker", "runaway", "discs"]),
    joined=st.booleans(),
    stiffness=st.sampled_from([10.0, 1000.0, 5e4, 1e7]),
    level=st.sampled_from([0.0, 0.3]),
    seed=st.integers(0, 2**32 - 1),
    clutched=st.booleans(),
)
def test_no_proposal_breaks_the_promise(
    kind: str, joined: bool, stiffness: float, level: float, seed: int, clutched: bool
) -> None:
    """The ledger, less the springs' energy, stays above zero while blocks freeze, ramp and come back."""
    rng = np.random.default_rng(seed)
    K = K_JOINED if joined else stiffness * np.diag([1.0, 2.0, 0.5])
    core = core_of(hostile(kind, rng), K, level * (np.eye(3) + 0.1))
    assert core.ledger is not None
    clutches, passed = core.clutches, 0.0
    events = {60: clutches.freeze, 90: clutches.engage, 150: clutches.disengage, 200: clutches.engage}
    x_e = np.zeros(3)
    for k, p in enumerate(hands(rng, 300)):
        if clutched and k in events:
            events[k](k % 2)
        if clutched and k % 17 == 5:
            clutches.hold(k % 2)
        f = react(core, p)
        assert np.all(np.isfinite(f))
        core.settle()
        tools = np.array(core.tools)
        passed += float(np.abs(tools - x_e) @ np.abs(f)) + 1e-12 * float(np.abs(tools) @ np.abs(f))
        x_e = tools
        assert core.ledger.minimum >= -1e-9 * passed
    if kind in ("ahead", "shaker", "jumps"):
        assert sum(core.held) > 0


def test_without_the_test_the_same_proxies_break_it() -> None:
    """What the property above is worth: the same proxies, asked explicitly and only watched."""
    rng = np.random.default_rng(5)
    law = BlackBox(AskedModel("some:model", Model(hostile("ahead", rng)), PORTS))
    core = EnforcedCore(law, D_V, np.zeros((3, 3)), T, False, BLOCKS)
    for p in hands(rng, 50):
        react(core, p)
        core.settle()
    assert core.ledger is not None
    assert core.ledger.minimum < -1e-3


def test_a_held_proxy_takes_the_greatest_part_that_keeps_the_budget() -> None:
    """A proxy that jumps against an empty budget stays; with energy in the spring it moves until that is used up."""
    core = core_of(lambda x, k: np.full(3, 0.01 * (k == 0)))
    for _ in range(3):
        react(core, np.zeros(3))
        core.settle()
    np.testing.assert_array_equal(core.tools, np.zeros(3))  # nothing was moved, and nothing may be put out
    # a press of 10 mm at a held proxy, and then a proxy that runs ahead of it
    core = core_of(lambda x, k: np.zeros(3) if k < 20 else np.full(3, -1.0))
    totals = []
    for k in range(60):
        react(core, np.full(3, 1e-3 * min(k, 10)))
        core.settle()
        assert core.ledger is not None
        totals.append(core.ledger.total)
    stored = max(totals)
    assert stored > 1e-3
    assert 0.0 <= totals[-1] < stored  # given back, and no more than that
    assert list(core.held) != [0, 0]


@pytest.mark.parametrize("stiffness", [300.0, 1000.0, 5000.0, 5e4, 1e6])
def test_a_wall_is_the_implicit_one_and_never_held(stiffness: float) -> None:
    """For a convex wall the nearest point of r is that of x: f solves f = -K max(x - c, 0) at the tick's end."""
    core = core_of(lambda x, k: np.minimum(x, 1e-3), stiffness)
    forces = []
    for k in range(400):
        p = np.full(3, 5e-3 * np.sin(0.01 * k))
        f = react(core, p)
        core.settle()
        x = np.array(core.tools)
        expected = -stiffness * np.maximum(x - 1e-3, 0.0)
        np.testing.assert_allclose(f[1], expected[1], atol=1e-9 * stiffness)  # D_V joins the other two ports
        forces.append(f[1])
    steps = np.diff(forces)
    assert np.count_nonzero(steps[1:] * steps[:-1] < 0.0) <= 1  # in and out, without a chatter
    assert list(core.held) == [0, 0]


def test_a_free_tool_feels_nothing() -> None:
    core = core_of(lambda x, k: x, 5e4)
    for p in hands(np.random.default_rng(1), 200):
        np.testing.assert_array_equal(react(core, p), np.zeros(3))
        core.settle()
        np.testing.assert_allclose(core.tools, p, rtol=0.0, atol=1e-17)


def test_only_the_party_that_overdraws_is_held() -> None:
    """The proxies of one coupling run ahead of its tools; the other coupling's tool stays free, and is not named."""

    def answer(x: np.ndarray, k: int) -> np.ndarray:
        return np.array([0.01 * (-1.0) ** k, x[1], 0.0])

    core = core_of(answer)
    for k, p in enumerate(hands(np.random.default_rng(3), 200)):
        f = react(core, p)
        core.settle()
        assert f[1] == 0.0, k
    assert core.held[0] > 50
    assert core.held[1] == 0


def test_energy_goes_from_one_tool_to_the_other() -> None:
    """A rod between two tools: what one user puts in the other gets, which one budget for both permits."""

    def rod(x: np.ndarray, k: int) -> np.ndarray:
        middle = 0.5 * (x[0] + x[1])
        return np.array([middle, middle, x[2]])

    core = core_of(rod)
    given = 0.0
    for k in range(200):
        p = np.array([5e-3 * np.sin(0.02 * k), 0.0, 0.0])
        before = np.array(core.tools)
        f = react(core, p)
        core.settle()
        given += float(f[1] * (core.tools[1] - before[1]))
        assert core.ledger is not None
        assert core.ledger.minimum >= 0.0
    assert given > 0.0


def test_the_model_is_asked_once_a_tick_at_the_free_positions() -> None:
    asked = []

    def answer(x: np.ndarray, k: int) -> np.ndarray:
        asked.append((k, x))
        return np.minimum(x, 0.0)

    core = core_of(answer)
    core.clutches.freeze(0)
    core.clutches.engage(0)
    for k in range(150):
        react(core, np.full(3, 1e-3 * np.sin(0.1 * k)))
        core.settle()
    assert [k for k, _ in asked] == list(range(150))
    assert asked[0][1][1] == 0.0


@pytest.mark.parametrize(
    ("answer", "found"),
    [
        (lambda x, k: x * np.nan, "a position of nan m at p"),
        (lambda x, k: np.array([0.0, 2.0 * MOST_POSITION, 0.0]), "a position of 2000 m at q"),
        (lambda x, k: x[:2], "an answer of the shape (2,)"),
        (lambda x, k: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda x, k: None, "an answer of the shape ()"),
    ],
)
def test_a_model_that_fails_is_named_and_its_proxies_rest(answer: Answer, found: str) -> None:
    core = core_of(lambda x, k: np.zeros(3) if k < 3 else answer(x, k))
    for k in range(10):
        f = react(core, np.full(3, 1e-3 * k))
        core.settle()
        assert np.all(np.isfinite(f))
        assert f[1] < 0.0 or k == 0  # the spring to the proxy that rests at 0
    assert core.failure is not None
    assert core.failure.startswith("the model some:model failed at tick 3: found")
    assert found in core.failure
    assert core.ledger is not None
    assert core.ledger.minimum >= 0.0


def test_bad_springs_and_levels_are_refused() -> None:
    asked = AskedModel("some:model", Model(lambda x, k: x), PORTS)
    for K in (np.diag([1.0, 0.0, 1.0]), np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])):
        with pytest.raises(ValueError, match="stiffness"):
            ProxyLaw(asked, K, None, T, BLOCKS)
    with pytest.raises(ValueError, match="negative eigenvalue"):
        ProxyLaw(asked, np.eye(3), -0.1 * np.eye(3), T, BLOCKS)


@settings(max_examples=cases(EXAMPLES, 4 * WIDE_EXAMPLES))
@given(a=st.floats(-10.0, 10.0), b=st.floats(-10.0, 10.0), c=st.floats(0.0, 5.0))
def test_the_greatest_part_keeps_the_quadratic_and_little_more_does_not(a: float, b: float, c: float) -> None:
    if c + a - b >= -1e-6:
        return  # the whole step keeps it
    s = greatest_part(a, b, c)
    assert 0.0 <= s <= 1.0
    assert c + a * s - b * s * s >= -1e-12
    beyond = min(1.0, s + 1e-4)
    assert c + a * beyond - b * beyond * beyond < 0.0 or beyond >= 1.0 or c < 1e-6


def test_a_compliance_that_joins_two_couplings_is_refused() -> None:
    """Point 2 of decision 42 and the clutches need D within the couplings."""
    asked = AskedModel("some:model", Model(lambda x, k: x), PORTS)
    law = ProxyLaw(asked, np.eye(3), None, T, BLOCKS)
    joined = D_V + 1e-4 * np.eye(3)[::-1] + 1e-6 * (np.eye(3)[[1, 2, 0]])
    with pytest.raises(ValueError, match="feedthrough D_V between ports of two blocks; expected one within each block"):
        EnforcedCore(law, joined, np.zeros((3, 3)), T, False, BLOCKS)


@pytest.mark.parametrize("seed", range(cases(12, 200)))
def test_a_law_whose_parties_the_compliance_joins_holds_them_all(seed: int) -> None:
    """The law by itself, under a D that no core passes on: who is held alone depends on D as well."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3))
    D = 1e-3 * (A @ A.T + (A - A.T) + 0.1 * np.eye(3))
    K = 10.0 ** rng.uniform(2.0, 4.0, 3) * np.eye(3)
    answer = hostile(("ahead", "jumps", "shaker")[seed % 3], rng)
    law = ProxyLaw(AskedModel("some:model", Model(answer), PORTS), K, None, T, [[0], [1], [2]])
    x, total, passed = np.zeros(3), 0.0, 0.0
    for r in hands(rng, 200):
        f = law.propose(r, D, r)
        after = r + D @ f
        total -= float((after - x) @ f)
        passed += float(np.abs(after - x) @ np.abs(f))
        x = after
        law.advance(x, f)
        assert total >= -1e-9 * passed
