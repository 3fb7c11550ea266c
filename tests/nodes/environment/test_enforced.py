"""Environments under a controller: any model's ledger, E's own forces, clutches, and models that fail."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.network import Network, NetworkLink
from manyhands.nodes.environment.core import EnvironmentCore
from manyhands.nodes.environment.enforced import BlackBox, EnforcedCore, LinearLaw
from manyhands.nodes.environment.model import MOST_FORCE, AskedModel, make_model
from manyhands.nodes.kernel.factory import FactoryError, FactoryName

from ...support.cases import cases
from ...support.reaction import react

T = 1e-3
PORTS = ("p", "q", "r")
BLOCKS = ([0, 2], [1])  # not contiguous
ROUNDING = 1e-11  # of the work that has passed
D_V = np.array([[1 / 700, 0, 1e-4], [0, 1 / 900, 0], [2e-4, 0, 1 / 1000]])  # m/N


class Model:
    """A model whose answer is a function of the tool positions and the tick."""

    def __init__(self, answer: Callable[[np.ndarray, int], Any]) -> None:
        self._answer = answer

    def react(self, x_e: np.ndarray, k: int) -> Any:
        return self._answer(x_e, k)


def core_of(
    answer: Callable[[np.ndarray, int], Any], level: np.ndarray | None, enforce: bool = True, ramp: int = 100
) -> EnforcedCore:
    law = BlackBox(AskedModel("some:model", Model(answer), PORTS))
    return EnforcedCore(law, D_V, level, T, enforce, BLOCKS, ramp)


def hands(rng: np.random.Generator, ticks: int) -> np.ndarray:
    """Free tool positions that wander, jump and rest."""
    steps = rng.normal(0.0, 1e-4, (ticks, 3)) * (rng.random((ticks, 1)) < 0.7)
    steps[rng.random(ticks) < 0.02] *= 100.0
    return np.cumsum(steps, axis=0)


def adversary(kind: str, rng: np.random.Generator) -> Callable[[np.ndarray, int], np.ndarray]:
    """Models that give energy away wherever they can."""
    last = np.zeros(3)

    def negative_damper(x_e: np.ndarray, k: int) -> np.ndarray:
        nonlocal last
        v, last = (x_e - last) / T, x_e
        return np.clip(100.0 * v, -1e6, 1e6)

    def stiff(x_e: np.ndarray, k: int) -> np.ndarray:
        return np.clip(-1e5 * x_e, -1e7, 1e7)

    def noise(x_e: np.ndarray, k: int) -> np.ndarray:
        return 10.0 ** rng.uniform(-3.0, 7.0) * rng.normal(size=3)

    def shaker(x_e: np.ndarray, k: int) -> np.ndarray:
        return np.full(3, 1e3 * (-1.0) ** k)

    return {"negative damper": negative_damper, "stiff": stiff, "noise": noise, "shaker": shaker}[kind]


@settings(max_examples=40)
@given(
    kind=st.sampled_from(["negative damper", "stiff", "noise", "shaker"]),
    level=st.sampled_from([0.0, 0.5, -0.5]),
    seed=st.integers(0, 2**32 - 1),
    clutched=st.booleans(),
)
def test_no_model_breaks_the_promise(kind: str, level: float, seed: int, clutched: bool) -> None:
    """The ledger stays above zero at every tick, while blocks freeze, ramp and come back."""
    rng = np.random.default_rng(seed)
    Phi = level * np.eye(3) + (0.1 * np.ones((3, 3)) if level > 0.0 else 0.0)
    core = core_of(adversary(kind, rng), Phi, ramp=20)
    assert core.ledger is not None
    assert core.controller is not None
    passed, rounded, x_e, own = 0.0, 0.0, np.zeros(3), 0.0
    clutches = core.clutches
    events = {
        60: clutches.freeze,
        90: clutches.engage,
        150: clutches.disengage,
        200: clutches.engage,
        230: clutches.freeze,
    }
    for k, p in enumerate(hands(rng, 300)):
        if clutched and k in events:
            events[k](k % 2)
        if clutched and k % 17 == 5:
            clutches.hold(k % 2)
        f = react(core, p)
        assert np.all(np.isfinite(f))
        if not clutched:  # an account of our own, from what is sent and received
            w = (p + D_V @ f - x_e) / T
            own += T * float(-(w @ f) + w @ Phi @ w)
            passed += T * float(np.abs(w) @ np.abs(f) + abs(w @ Phi @ w))
            # a velocity is a small difference of positions
            rounded += 1e-15 * float(
                (np.abs(p) + np.abs(D_V) @ np.abs(f) + np.abs(x_e)) @ (np.abs(f) + np.abs(Phi @ w))
            )
            x_e = p + D_V @ f
            assert own >= -1e-9 * passed - rounded
        core.settle()
        passed = max(passed, abs(core.ledger.total))
        assert core.ledger.minimum >= -ROUNDING * passed
    if kind in ("negative damper", "noise"):
        assert core.controller.ticks > 0
        assert core.controller.energy > 0.0


def test_without_a_controller_such_a_model_breaks_it() -> None:
    """What the property above is worth: the same model, its level only watched."""
    rng = np.random.default_rng(5)
    core = core_of(adversary("negative damper", rng), np.zeros((3, 3)), enforce=False)
    for p in hands(rng, 200):
        react(core, p)
        core.settle()
    assert core.ledger is not None
    assert core.ledger.minimum < -1.0


def test_a_passive_model_is_let_alone() -> None:
    """No force at all, and a soft spring that is asked a tick ahead, within its level: the controller never acts."""
    rng = np.random.default_rng(2)
    core = core_of(lambda x_e, k: np.zeros(3), np.zeros((3, 3)))
    spring = core_of(lambda x_e, k: -10.0 * x_e, 2.0 * np.eye(3))
    for p in hands(rng, 500):
        assert np.array_equal(react(core, p), np.zeros(3))
        core.settle()
        react(spring, p)
        spring.settle()
    for untouched in (core, spring):
        assert untouched.controller is not None
        assert untouched.controller.ticks == 0


def test_a_model_that_pushes_for_ever_moves_nobody() -> None:
    """A constant force from the first tick on is energy out of nothing: the tools are held, to the last bit."""
    core = core_of(lambda x_e, k: np.array([5.0, -3.0, 1.0]), np.zeros((3, 3)))
    for _ in range(100):
        f = react(core, np.zeros(3))
        core.settle()
        assert np.array_equal(f, np.zeros(3))
    assert core.ledger is not None
    assert core.ledger.total == 0.0


@settings(max_examples=cases(4, 8))
@given(
    stiffness=st.floats(10.0, 5000.0),
    damping=st.floats(0.0, 1.0),
    mass=st.floats(0.1, 5.0),
    seed=st.integers(0, 2**16),
)
def test_as_a_safety_net_it_never_acts_and_changes_nothing(
    stiffness: float, damping: float, mass: float, seed: int
) -> None:
    """E as it is proved: the same forces as without a controller, through freezes and returns."""
    links = [NetworkLink((port, "hub"), stiffness * (i + 1), damping) for i, port in enumerate(PORTS)]
    E = Network(PORTS, (("hub", mass),), (*links, NetworkLink(("hub", "ground"), stiffness, damping))).environment(T)
    plain = EnvironmentCore(E, D_V * (D_V > 0), np.zeros((3, 3)), T, BLOCKS, ramp=20)
    netted = EnforcedCore(LinearLaw(E), D_V * (D_V > 0), np.zeros((3, 3)), T, True, BLOCKS, ramp=20)
    rng = np.random.default_rng(seed)
    for k, p in enumerate(hands(rng, 600)):
        for core in (plain, netted):
            if k in (100, 400):
                core.clutches.freeze(1)
            if k in (150, 450):
                core.clutches.engage(1)
            if k == 200:
                core.clutches.disengage(0)
            if k == 260:
                core.exchange(0, np.array([[1 / 500, 0.0], [0.0, 1 / 600]]))
                core.clutches.engage(0)
        f = react(plain, p)
        # both solve the same equations, in another order
        np.testing.assert_allclose(react(netted, p), f, rtol=0, atol=1e-9 * (1.0 + np.abs(f).max()))
        plain.settle()
        netted.settle()
        ratios = [[core.clutches.all[i].ratio for i in (0, 1)] for core in (plain, netted)]
        np.testing.assert_allclose(*ratios, rtol=0, atol=1e-9)
    assert netted.controller is not None
    assert (netted.controller.ticks, netted.controller.energy) == (0, 0.0)
    assert netted.ledger is not None
    assert netted.ledger.minimum >= -1e-12


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_leaving_block_is_held_to_it_at_its_hands_side(seed: int) -> None:
    """No force of a tick but what (p, D_V) answer to: an account of the ports as the couplings see them."""
    rng = np.random.default_rng(seed)
    core = core_of(adversary("noise", rng), np.zeros((3, 3)), ramp=150)
    before, own, passed, rounded = np.zeros(3), 0.0, 0.0, 0.0
    for k, p in enumerate(hands(rng, 220)):
        if k == 20:
            core.clutches.disengage(0)
        f = react(core, p)
        core.settle()
        x_c = p + D_V @ f
        own -= float(f @ (x_c - before))
        passed += float(np.abs(f) @ np.abs(x_c - before))
        rounded += 1e-15 * float(np.abs(f) @ (np.abs(p) + np.abs(D_V) @ np.abs(f) + np.abs(before)))
        before = x_c
        assert own >= -1e-9 * passed - rounded
        # a clutch is lossless: the tools' account is the same, if they move as the forces at the ports make them
        assert core.ledger is not None
        assert abs(own - core.ledger.total) <= 1e-9 * passed + rounded
    assert core.clutches.all[0].ratio == 0.0
    assert core.controller is not None
    assert core.controller.ticks > 0


def test_a_model_is_asked_once_a_tick() -> None:
    """However often the tick is tried."""
    asked: list[int] = []

    def answer(x_e: np.ndarray, k: int) -> np.ndarray:
        asked.append(k)
        return np.full(3, float(len(asked)))

    law = BlackBox(AskedModel("some:model", Model(answer), PORTS))
    for k in (0, 1):
        first, second = (law.propose(np.zeros(3), D_V, np.full(3, x)) for x in (0.0, 1.0))
        np.testing.assert_array_equal(first, second)
        assert asked[-1] == k
        law.advance(np.zeros(3), np.zeros(3))
    assert asked == [0, 1]


def test_a_frozen_port_feels_nothing_of_the_model() -> None:
    core = core_of(lambda x_e, k: np.full(3, 4.0 * (-1.0) ** k), np.zeros((3, 3)))
    core.clutches.freeze(0)
    assert core.clutches.all[0].ratio == 0.0
    assert core.clutches.all[1].ratio != 0.0
    for k in range(10):
        f = react(core, np.full(3, 1e-4 * k))
        core.settle()
        assert np.array_equal(f[[0, 2]], [0.0, 0.0])
    with pytest.raises(ValueError, match=r"block 1 at the ratio 1; expected it frozen"):
        core.exchange(1, np.eye(1))
    with pytest.raises(ValueError, match=r"shape \(1, 1\); expected 2 x 2"):
        core.exchange(0, np.eye(1))
    with pytest.raises(ValueError, match="symmetric part is not positive definite"):
        core.exchange(0, -np.eye(2))
    core.exchange(0, 1e-3 * np.eye(2))


def test_enforcing_needs_a_level_and_a_compliant_coupling() -> None:
    with pytest.raises(ValueError, match="no level to enforce"):
        core_of(lambda x_e, k: x_e, None)
    law = BlackBox(AskedModel("some:model", Model(lambda x_e, k: x_e), PORTS))
    with pytest.raises(ValueError, match=r"symmetric part is not positive definite.*design: coupling"):
        EnforcedCore(law, np.zeros((3, 3)), np.eye(3), T, True)


def test_the_model_is_called_ahead_and_keeps_its_own_arrays() -> None:
    seen: list[tuple[int, np.ndarray]] = []
    returned = np.zeros(3)

    def answer(x_e: np.ndarray, k: int) -> np.ndarray:
        seen.append((k, x_e))
        returned[:] = -100.0 * x_e
        return returned

    core = core_of(answer, None, enforce=False)
    first = react(core, np.array([1e-3, 0.0, 0.0]))
    core.settle()
    kept = first.copy()
    react(core, np.array([2e-3, 0.0, 0.0]))
    assert [k for k, _ in seen] == [0, 1]
    np.testing.assert_array_equal(seen[0][1], [1e-3, 0.0, 0.0])
    np.testing.assert_array_equal(seen[1][1], np.array([2e-3, 0.0, 0.0]) + D_V @ kept)
    np.testing.assert_array_equal(first, kept)  # not written over by the model's next answer


def raises(error: BaseException) -> Callable[[np.ndarray, int], Any]:
    def answer(x_e: np.ndarray, k: int) -> Any:
        raise error

    return answer


class Unspeakable(Exception):
    def __str__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("answer", "found"),
    [
        (raises(ZeroDivisionError("oh")), "ZeroDivisionError: oh"),
        (raises(SystemExit(3)), "SystemExit: 3"),
        (raises(Unspeakable()), "Unspeakable: without a text"),
        (lambda x_e, k: None, "an answer of the shape ()"),
        (lambda x_e, k: "forces", "ValueError: could not convert string to float"),
        (lambda x_e, k: [1.0, 2.0], r"an answer of the shape (2,); expected 3 forces, one a port"),
        (lambda x_e, k: [[1.0, 2.0, 3.0]], "an answer of the shape (1, 3)"),
        (lambda x_e, k: [0.0, float("nan"), 0.0], "a force of nan N at q"),
        (lambda x_e, k: [0.0, 0.0, float("-inf")], "a force of -inf N at r"),
        (lambda x_e, k: [2.0 * MOST_FORCE, 0.0, 0.0], "a force of 2e+09 N at p; expected a finite number of at most"),
    ],
)
def test_a_model_that_fails_is_named_and_exerts_nothing(answer: Callable[[np.ndarray, int], Any], found: str) -> None:
    good = 3
    calls = []

    def later(x_e: np.ndarray, k: int) -> Any:
        calls.append(k)
        return -10.0 * x_e if k < good else answer(x_e, k)

    core = core_of(later, None, enforce=False)
    for k in range(6):
        f = react(core, np.full(3, 1e-3))
        core.settle()
        assert (core.failure is None) == (k < good)
        assert np.any(f) == (k < good)
    assert calls == [0, 1, 2, 3]  # not asked again
    assert core.failure is not None
    assert f"the model some:model failed at tick 3: found {found}" in core.failure
    assert core.failure.endswith("; see its code")


@pytest.fixture
def importable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module with factories, good and bad."""
    name = "factories_of_these_tests"
    (tmp_path / f"{name}.py").write_text(
        "class Spring:\n"
        "    def __init__(self, ports, period, parameters):\n"
        "        self.told = ports, period, parameters\n"
        "    def react(self, x_e, k):\n"
        "        return -self.told[2]['stiffness'] * x_e\n"
        "def nothing(ports, period, parameters):\n"
        "    return None\n"
        "def broken(ports, period, parameters):\n"
        "    raise LookupError('no such scene')\n"
        "def leaves(ports, period, parameters):\n"
        "    raise SystemExit\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.delitem(sys.modules, name, raising=False)
    return name


def test_a_factory_receives_ports_period_and_parameters(importable: str) -> None:
    parameters: Mapping[str, Any] = {"stiffness": 3.0}
    model = make_model(FactoryName(f"{importable}:Spring", parameters), PORTS, T)
    assert model.told == (PORTS, T, parameters)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(model.react(np.ones(3), 0), [-3.0, -3.0, -3.0])


@pytest.mark.parametrize(
    ("function", "found"),
    [
        ("nothing", "cannot be asked: found NoneType"),
        ("broken", "cannot be made: found LookupError: no such scene"),
        ("leaves", "cannot be made: found SystemExit"),
        ("missing", "cannot be made: found AttributeError: module"),
    ],
)
def test_a_factory_that_makes_no_model_is_named(importable: str, function: str, found: str) -> None:
    with pytest.raises(FactoryError) as caught:
        make_model(FactoryName(f"{importable}:{function}", {}), PORTS, T)
    assert f"the model {importable}:{function} {found}" in str(caught.value)


def test_a_module_that_is_not_there_is_named() -> None:
    with pytest.raises(FactoryError, match=r"nowhere\.at_all:f cannot be made: found ModuleNotFoundError"):
        make_model(FactoryName("nowhere.at_all:f", {}), PORTS, T)


@pytest.mark.parametrize("name", ["", "f", ":f", "m:", "m:f.g", "../m:f", "m:f()", "m:f\n", "m f:g", "m:f:g"])
def test_names_that_are_none(name: str) -> None:
    with pytest.raises(ValueError, match=r"expected package\.module:factory"):
        FactoryName(name, {})
