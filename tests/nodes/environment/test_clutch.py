"""Clutches in the environment's core: lossless at every tick, free of steps, and equal to the whole loop's forces."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.network import Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.environment import core as core_module
from manyhands.nodes.environment.clutch import LET_GO, NEXT, SLOWEST, WORK_OFF, Clutch, ClutchEvent, ClutchPhase
from manyhands.nodes.environment.core import EnvironmentCore
from manyhands.nodes.kernel.energy_budget import EnergyBudget
from manyhands.nodes.kernel.timeouts import RAMP

from ...support.cases import cases
from ...support.reaction import react

T = 1e-3
EPS = float(np.finfo(np.float64).eps)
Deed = Literal["freeze", "engage", "disengage", "hold"]


class ClutchedLoop:
    """A random environment and coupling; the parties behind the ports move as they like."""

    def __init__(self, seed: int, blocks: list[list[int]], ramp: int = 20, budget: float = 0.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.m = sum(map(len, blocks))
        self.blocks, self.ramp = blocks, ramp
        ports = tuple(f"p{i}" for i in range(self.m))
        ends = [*ports, "a", "b", "ground"]
        links = [
            NetworkLink((port, "a"), float(self.rng.uniform(10, 5000)), float(self.rng.uniform(0, 2))) for port in ports
        ]
        for _ in range(4):
            one, two = self.rng.permutation(ends)[:2]
            links.append(
                NetworkLink((str(one), str(two)), float(self.rng.uniform(0, 3000)), float(self.rng.uniform(0, 2)))
            )
        links.append(NetworkLink(("a", "ground"), 500.0, 0.2))
        masses = (("a", float(self.rng.uniform(0.1, 3.0))), ("b", float(self.rng.uniform(0.1, 3.0))))
        self.E = Network(ports, masses, tuple(links)).environment(T)
        self.D_V = np.zeros((self.m, self.m))
        for block in blocks:
            self.D_V[np.ix_(block, block)] = self.feedthrough(len(block))
        budgets = [EnergyBudget(budget, budget, budget)] * len(blocks) if budget else None
        self.core = EnvironmentCore(self.E, self.D_V, np.zeros((self.m, self.m)), T, blocks, ramp, budgets=budgets)

    def feedthrough(self, size: int) -> np.ndarray:
        """D_V of a block of springs and dampers."""
        Q = self.rng.normal(size=(size, size))
        K = 700.0 * (np.eye(size) + 0.15 * (Q @ Q.T + (Q @ Q.T).T) / size)
        return SpringDamper(K, 0.1 * np.eye(size)).realisation(T).D


class Oracle:
    """The loop of all ports solved as a whole at every tick, from the ratios that the core reports."""

    def __init__(self, world: ClutchedLoop) -> None:
        self.E, self.D_V, self.blocks = world.E, world.D_V.copy(), world.blocks
        m = world.m
        self.eta = np.zeros(world.E.order)
        self.x_e, self.x_c = np.zeros(m), np.zeros(m)
        self.given_up = 0.0  # J, by the clutches in this tick

    def step(
        self, p: np.ndarray, core: EnvironmentCore, before: list[tuple[float, bool]], held: Sequence[int] = ()
    ) -> np.ndarray:
        """f_c(k); ``before``: ratio and settled of each block before the tick; ``held``: the blocks held in it."""
        m = len(p)
        S, r = np.ones(m), np.zeros(m)
        for i, block in enumerate(self.blocks):
            s = core.clutches.all[i].ratio
            S[block] = s
            if s == 0.0:
                r[block] = self.x_e[block]
            elif core.clutches.all[i].settled and not before[i][1]:
                r[block] = p[block]
            else:
                r[block] = self.x_e[block] + s * (p[block] - self.x_c[block])
        D = S[:, None] * self.D_V * S
        f_e = -np.linalg.solve(np.eye(m) + self.E.D @ D, self.E.C @ self.eta + self.E.D @ r)
        f_c = S * f_e
        x_e, x_c = r + D @ f_e, p + self.D_V @ f_c
        for i in held:
            x_c[self.blocks[i]] = self.x_c[self.blocks[i]]
        moved = np.where(S > 0.0, x_c - self.x_c, 0.0)  # a frozen or joining block is not followed
        out_of, into = f_c * moved, f_e * (x_e - self.x_e)
        self.given_up = float(np.sum(into) - np.sum(out_of))
        self.rounding = 64.0 * EPS * float(np.sum(np.abs(f_e) * (np.abs(x_e) + np.abs(x_c) + np.abs(self.x_c))))
        self.f_e = f_e
        self.eta = self.E.A @ self.eta + self.E.B @ x_e
        self.x_e, self.x_c = x_e, x_c
        return f_c


def tools(core: EnvironmentCore) -> np.ndarray:
    """x_e(k), m, of the tick that is decided."""
    later = copy.deepcopy(core)
    later.settle()
    return np.array(later.tools)


def states(core: EnvironmentCore, count: int) -> list[tuple[float, bool]]:
    return [(core.clutches.all[i].ratio, core.clutches.all[i].settled) for i in range(count)]


partitions = st.sampled_from([[[0], [1], [2]], [[0, 2], [1]], [[2, 0, 1]], [[3, 1], [0, 4], [2]], [[0]]])
DEEDS = ("freeze", "engage", "disengage", "hold")
deeds = st.lists(st.tuples(st.integers(0, 25), st.integers(0, 9), st.sampled_from(DEEDS)))


# --- the phases


def test_every_phase_has_its_allowed_events() -> None:
    told = (ClutchEvent.FREEZE, ClutchEvent.ENGAGE, ClutchEvent.DISENGAGE)
    own = {(ClutchPhase.LEAVING, ClutchEvent.FALLEN), (ClutchPhase.JOINING, ClutchEvent.REFERRED)}
    assert set(NEXT) == {(phase, event) for phase in ClutchPhase for event in told} | own
    assert all(NEXT[phase, ClutchEvent.FREEZE] is ClutchPhase.FROZEN for phase in ClutchPhase)
    # back from the frost only by way of a reference
    assert NEXT[ClutchPhase.FROZEN, ClutchEvent.ENGAGE] is ClutchPhase.JOINING
    assert {phase for (phase, _), after in NEXT.items() if after is ClutchPhase.COUPLED} == {
        ClutchPhase.COUPLED,
        ClutchPhase.LEAVING,
        ClutchPhase.JOINING,
    }


@pytest.mark.parametrize("ramp", [1, 7, RAMP])
def test_a_ramp_takes_its_ticks_and_keeps_its_greatest_rate(ramp: int) -> None:
    world = ClutchedLoop(1, [[0], [1]], ramp)
    core, p = world.core, np.zeros(2)
    core.clutches.freeze(0)
    ratios = [core.clutches.all[0].ratio]
    for k in range(3 * ramp + 6):
        if k == 2:
            core.clutches.engage(0)
        if k == ramp + 3:
            assert core.clutches.all[0].ratio == 1.0
            core.clutches.disengage(0)
        if k == 2 * ramp + 4:
            assert core.clutches.all[0].ratio == 0.0
        react(core, p)
        core.settle()
        ratios.append(core.clutches.all[0].ratio)
    assert ratios[:4] == [0.0] * 4  # frozen, and the tick that takes the reference
    assert ratios[-1] == 0.0
    steps = np.abs(np.diff(ratios))
    assert np.max(steps) <= math.pi / (2.0 * ramp) + 1e-12
    assert core.clutches.all[1].ratio == 1.0


def test_who_leaves_may_turn_round() -> None:
    core, p = ClutchedLoop(2, [[0], [1]], 20).core, np.zeros(2)
    core.clutches.disengage(0)
    for _ in range(8):
        react(core, p)
        core.settle()
    turned = core.clutches.all[0].ratio
    assert 0.0 < turned < 1.0
    core.clutches.engage(0)
    react(core, p)
    assert turned < core.clutches.all[0].ratio <= turned + math.pi / 40.0


def test_freezing_begins_with_the_next_react() -> None:
    """Between react and settle the tick is decided: the tool rests where this tick has left it."""
    world = ClutchedLoop(3, [[0], [1]])
    core, other = world.core, copy.deepcopy(world.core)
    p = np.array([1e-3, -2e-3])
    for which, early in ((core, True), (other, False)):
        f = react(which, p).copy()
        if early:
            which.clutches.freeze(0)
        which.settle()
        which.clutches.freeze(0)
        assert f[0] != 0.0
        assert which.clutches.all[0].ratio == 0.0
    np.testing.assert_array_equal(react(core, p * 2), react(other, p * 2))
    core.settle()
    assert core.ledger is not None
    assert other.ledger is not None
    other.settle()
    assert core.ledger.total == other.ledger.total


# --- the whole loop


@settings(max_examples=cases(30, 60))
@given(
    seed=st.integers(0, 2**32 - 1),
    blocks=partitions,
    plan=deeds,
    pause=st.integers(0, 2),
    budget=st.sampled_from([0.0, 1e-3, 1e-4, 1e-5]),
)
def test_no_energy_is_made_and_the_forces_are_the_whole_loops(
    seed: int, blocks: list[list[int]], plan: list[tuple[int, int, Deed]], pause: int, budget: float
) -> None:
    """For any freezing, leaving and joining, and with any party held to an energy budget."""
    world = ClutchedLoop(seed, blocks, budget=budget)
    core, oracle, rng = world.core, Oracle(world), world.rng
    at: dict[int, list[tuple[int, Deed]]] = {}
    tick = 0
    for wait, block, deed in plan:
        tick += wait
        at.setdefault(tick, []).append((block % len(blocks), deed))
    p, v = np.zeros(world.m), np.zeros(world.m)
    scale, given_up = 0.0, 0.0
    ratios, were = [1.0] * len(blocks), []
    for k in range(tick + 60):
        for block, deed in at.get(k, ()):
            getattr(core.clutches, deed)(block)
        v = 0.97 * v + rng.normal(0.0, 2e-5, world.m)
        p = p + v
        told = p.copy()
        held = [i for i in range(len(blocks)) if core.clutches.all[i].held]
        ratios = [ratios[i] if i in were else ratio for i, (ratio, _) in enumerate(states(core, len(blocks)))]
        before = [(ratio, settled) for ratio, (_, settled) in zip(ratios, states(core, len(blocks)), strict=True)]
        for i in held:  # its own force, whenever its p comes, holds its end
            block = blocks[i]
            force = np.array(core.holding_force(i, p[block].tolist()))
            if core.clutches.all[i].phase is not ClutchPhase.JOINING:
                end = p[block] + world.D_V[np.ix_(block, block)] @ force
                np.testing.assert_allclose(end, oracle.x_c[block], rtol=0, atol=1e-14)
        allowed = [core.energy.ratio(i) for i in range(len(blocks))]
        for i, block in enumerate(blocks):
            if pause and (i in held or core.clutches.all[i].phase is ClutchPhase.FROZEN):
                told[block] = np.nan if pause == 1 else 1e9
        found = react(core, told).copy()
        expected = oracle.step(p, core, before, held)
        scale = max(scale, float(np.max(np.abs(expected))))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * scale + 1e-12)
        core.settle()
        np.testing.assert_allclose(core.tools, oracle.x_e, rtol=0, atol=1e-12)
        given_up += oracle.given_up
        newly = [i for i in range(len(blocks)) if core.clutches.all[i].settled and not before[i][1]]
        assert len(newly) <= 1
        if not newly:
            assert abs(oracle.given_up) <= oracle.rounding + 1e-18
        else:  # lossy by what was let go, and never the other way
            block = blocks[newly[0]]
            assert -oracle.rounding - 1e-18 <= oracle.given_up
            assert oracle.given_up <= LET_GO * float(np.linalg.norm(oracle.f_e[block])) + oracle.rounding
        for i in range(len(blocks)):
            # rounded at most once on either side
            if i in held:
                assert core.clutches.all[i].ratio == 0.0
                continue
            moved = abs(core.clutches.all[i].ratio - before[i][0])
            assert core.clutches.all[i].ratio <= allowed[i] + 1e-12
            # a restraint is obeyed at once
            assert moved <= math.pi / (2.0 * world.ramp) + 1e-12 or core.clutches.all[i].ratio in (
                0.0,
                pytest.approx(allowed[i]),
            )
        were = held
    assert core.ledger is not None
    assert core.ledger.minimum >= 0.0
    assert core.ill_posed == 0


@pytest.mark.parametrize("blocks", [[[0], [1], [2]], [[2, 0], [1]]])
def test_without_events_nothing_differs_by_a_bit(blocks: list[list[int]]) -> None:
    world = ClutchedLoop(5, blocks)
    plain = EnvironmentCore(world.E, world.D_V, np.zeros((3, 3)), T)
    for _ in range(200):
        p = world.rng.normal(0.0, 1e-3, 3)
        np.testing.assert_array_equal(react(world.core, p), react(plain, p))
        world.core.settle()
        plain.settle()
    assert world.core.ledger is not None
    assert plain.ledger is not None
    assert world.core.ledger.total == plain.ledger.total


@pytest.mark.parametrize("blocks", [[[0], [1], [2], [3], [4], [5]], [[1, 0], [2], [4, 3], [5]]])
def test_equations_as_arrays_and_in_python_agree_to_the_last_bit(
    blocks: list[list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def forces(few: int) -> np.ndarray:
        monkeypatch.setattr(core_module, "FEW", few)
        world, found = ClutchedLoop(11, blocks), []
        for k in range(120):
            if k == 10:
                for block in range(len(blocks)):
                    world.core.clutches.freeze(block)
                    world.core.clutches.engage(block)
            found.append(react(world.core, np.sin(0.1 * k + np.arange(6.0)) * 1e-3))
            world.core.settle()
        assert world.core.ill_posed == 0
        return np.array(found)

    np.testing.assert_array_equal(forces(few=1), forces(few=6))


def test_all_may_be_frozen_and_come_back() -> None:
    world = ClutchedLoop(8, [[0], [2, 1]])
    core, p = world.core, np.array([2e-3, -1e-3, 1e-3])
    for _ in range(50):
        react(core, p)
        core.settle()
    for block in range(2):
        core.clutches.freeze(block)
    for _ in range(30):
        assert react(core, np.full(3, np.nan)).tolist() == [0.0, 0.0, 0.0]
        core.settle()
    for block in range(2):
        core.clutches.engage(block)
    for _ in range(world.ramp + 1):
        f = react(core, p)
        core.settle()
    assert core.clutches.all[0].ratio == core.clutches.all[1].ratio == 1.0
    assert np.all(f != 0.0)


# --- no step


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), blocks=st.sampled_from([[[0], [1], [2]], [[0, 2], [1]], [[3, 1], [0, 4], [2]]]))
def test_others_feel_at_most_one_ticks_motion_of_the_frozen_tool(seed: int, blocks: list[list[int]]) -> None:
    """At the freezing tick, at the engaging one, and at the first of the ramp, whatever the forces were.

    With the same history, f_j differs from what it were else by (I + D_jj D_V,j)^-1 D_ji times the difference of the
    tool's motion in that tick: not by any force that was or was not there.
    """
    world = ClutchedLoop(seed, blocks)
    core, rng = world.core, world.rng
    p, v = np.zeros(world.m), np.zeros(world.m)
    frozen, others = blocks[0], sorted(port for block in blocks[1:] for port in block)
    D_E = world.E.D
    loop = np.eye(len(others)) + D_E[np.ix_(others, others)] @ world.D_V[np.ix_(others, others)]
    gain = np.linalg.norm(np.linalg.solve(loop, D_E[np.ix_(others, frozen)]), 2)

    def compare(deed: Callable[[EnvironmentCore], None]) -> float:
        """The tick with and without ``deed``: how much the others' forces differ; and how much they may."""
        without = copy.deepcopy(core)
        rest = np.array(core.tools)[frozen]
        deed(core)
        found, expected = react(core, p).copy(), react(without, p).copy()
        moved = [tools(which)[frozen] - rest for which in (core, without)]
        difference = float(np.linalg.norm(found[others] - expected[others]))
        size = float(np.max(np.abs(expected))) + 1.0
        assert difference <= gain * np.linalg.norm(moved[0] - moved[1]) + 1e-9 * size
        return difference

    for k in range(90):
        v = 0.97 * v + rng.normal(0.0, 2e-5, world.m)
        p = p + v
        match k:
            case 40:
                compare(lambda core: core.clutches.freeze(0))
            case 60:
                assert compare(lambda core: core.clutches.engage(0)) == 0.0
            case _:
                react(core, p)
        core.settle()


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), blocks=partitions)
def test_who_returns_feels_the_force_rise_with_the_ramp(seed: int, blocks: list[list[int]]) -> None:
    """|f_c(k) - f_c(k-1)| <= |f_e(k) - f_e(k-1)| + pi/(2 RAMP) |f_e(k-1)| at every port that comes back."""
    world = ClutchedLoop(seed, blocks, RAMP)
    core, rng = world.core, world.rng
    p, v = np.zeros(world.m), np.zeros(world.m)
    f_c, f_e = np.zeros(world.m), np.zeros(world.m)
    for k in range(300):
        v = 0.97 * v + rng.normal(0.0, 2e-5, world.m)
        p = p + v
        if k == 80:
            core.clutches.freeze(0)
        if k == 100:
            core.clutches.engage(0)
            p[blocks[0]] += 0.05  # the hand has gone elsewhere meanwhile
        before_c, before_e = f_c, f_e
        f_c = react(core, p).copy()
        f_e = np.array(core._f)
        core.settle()
        if k > 80:
            allowed = np.abs(f_e - before_e) + math.pi / (2.0 * RAMP) * np.abs(before_e)
            at = blocks[0]
            assert np.all(np.abs(f_c - before_c)[at] <= allowed[at] + 1e-12)
        if k == 100:
            assert np.all(f_c[blocks[0]] == 0.0)


# --- the offset


def returned(
    world: ClutchedLoop, p: Callable[[int], np.ndarray], offset: np.ndarray, ticks: int
) -> tuple[np.ndarray, np.ndarray]:
    """Freeze block 0, and return with the end displaced by -offset and moved by p, until it is settled.

    Returns:
        x_e - x_c and f_e of the block at each tick.
    """
    core, block = world.core, world.blocks[0]
    react(core, p(0))
    core.settle()
    core.clutches.freeze(0)
    react(core, p(0))
    core.settle()
    core.clutches.engage(0)
    shift = np.zeros(world.m)
    shift[block] = -offset
    offsets, forces = [], []
    for k in range(ticks):
        react(core, p(k) + shift)
        core.settle()
        offsets.append(core.clutches.all[0].offset)
        forces.append(np.array(core._f)[block])
        if core.clutches.all[0].settled:
            break
    return np.array(offsets), np.array(forces)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("push", [-1.0, 0.0, 1.0])
def test_an_offset_is_worked_off_to_nothing(sign: float, push: float) -> None:
    """Whichever way the environment pushes, even if it never pushes the other: the last is let go on that side."""
    world = ClutchedLoop(11, [[0], [1]])

    def hand(k: int) -> np.ndarray:
        # to and fro by 3 mm, 1.6 times a second; with a push, both tools are off the rest to one side
        return np.array([0.003 * math.sin(0.01 * k) - 0.02 * push, -0.02 * push])

    core = world.core
    for _ in range(4000):  # what swings has come to rest
        react(core, hand(0))
        core.settle()
    offsets, forces = returned(world, hand, np.array([sign * 8e-4]), 40_000)
    if push:
        assert np.all(push * forces > 0.0)
    offsets = np.abs(offsets[:, 0])
    assert core.clutches.all[0].settled
    assert core.clutches.all[0].ratio == core.clutches.all[1].ratio == 1.0
    assert offsets[-1] == 0.0
    assert 0.0 < offsets[-2] <= LET_GO
    # D_V f of another user's making may move the end against p for a while, and no more than that
    after = offsets[world.ramp + 1 :]
    assert np.max(after) <= 1.5 * after[0]


def test_an_offset_of_several_axes_shrinks_by_motion_in_all() -> None:
    world = ClutchedLoop(12, [[0, 2, 1]])

    def hand(k: int) -> np.ndarray:
        return 0.03 * np.array([math.sin(0.01 * k), math.sin(0.0173 * k), math.cos(0.0127 * k)])

    offsets, _ = returned(world, hand, np.array([4e-3, -6e-3, 2e-3]), 60_000)
    assert world.core.clutches.all[0].settled
    assert np.all(offsets[-1] == 0.0)
    assert 0.0 < np.linalg.norm(offsets[-2]) <= LET_GO


def test_an_offset_is_kept_under_a_force_that_has_turned() -> None:
    """The force of the tick itself decides, by trial; the force of the tick before only shows whether to try."""
    k, o = 1000.0, 5e-7
    core = EnvironmentCore(StateSpace.static([[k]]), np.zeros((1, 1)), None, T, None, 1)
    core.clutches.freeze(0)
    react(core, np.zeros(1))
    core.settle()
    core.clutches.engage(0)
    forces = []
    s = 1.0 - (o + 0.5 * LET_GO) / WORK_OFF
    for p in (-o, -1e-3, 1e-3, 2e-3):  # the reference; the force turns against it; no try, but a lag; let go
        forces.append(react(core, np.array([p]))[0])
        core.settle()
        assert core.clutches.all[0].settled == (p == 2e-3)
    assert forces == pytest.approx([0.0, k * (1e-3 - o), k * s * (1e-3 - o - s * 2e-3), -k * 2e-3], rel=1e-12)


def test_a_hand_that_rests_keeps_its_offset_and_full_coupling() -> None:
    world = ClutchedLoop(13, [[0], [1]])
    offsets, _ = returned(world, lambda _: np.zeros(2), np.array([5e-3]), 400)
    assert world.core.clutches.all[0].ratio == 1.0
    assert not world.core.clutches.all[0].settled
    assert np.all(offsets[world.ramp + 1 :] == pytest.approx(5e-3, rel=0.2))


def test_the_lag_fades_with_the_offset_and_is_bounded() -> None:
    """Far away the ratio sinks to SLOWEST; near, 1 - s is the offset over WORK_OFF; away from the tool it is 1."""

    def ratio_at(offset: float, step: float) -> float:
        clutch = Clutch([0], 20)
        clutch.handle(ClutchEvent.FREEZE)
        clutch.seize([0.0])
        clutch.handle(ClutchEvent.ENGAGE)
        for k in range(200):
            clutch.advance([step * k], [0.0])
            clutch.conclude([0.0])
            clutch._x_e = [clutch._x_c[0] + offset]  # held, whatever the lag does
        return clutch.ratio

    assert ratio_at(0.02, 1e-4) == pytest.approx(SLOWEST, abs=1e-12)
    assert ratio_at(0.02, -1e-4) == 1.0
    assert ratio_at(-0.02, -1e-4) == pytest.approx(SLOWEST, abs=1e-12)
    assert ratio_at(0.02, 0.0) == 1.0
    assert 1.0 - ratio_at(1e-4, 1e-5) == pytest.approx(1e-4 / WORK_OFF, rel=1e-9)
    assert ratio_at(0.02, 1e-300) == pytest.approx(SLOWEST, abs=1e-12)  # however small the motion is


# --- exchange, and what is refused


def test_a_frozen_block_may_change_its_feedthrough() -> None:
    """Afterwards the core is one that was made with the new one."""
    world = ClutchedLoop(21, [[0, 2], [1]])
    core, oracle, rng = world.core, Oracle(world), world.rng
    fresh = world.feedthrough(2)
    p, v = np.zeros(3), np.zeros(3)
    for k in range(120):
        v = 0.97 * v + rng.normal(0.0, 2e-5, 3)
        p = p + v
        if k == 20:
            core.clutches.disengage(0)
        if k == 50:
            core.exchange(0, fresh)
            oracle.D_V[np.ix_([0, 2], [0, 2])] = fresh
            core.clutches.engage(0)
        before = states(core, 2)
        found = react(core, p).copy()
        expected = oracle.step(p, core, before)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * (1.0 + np.max(np.abs(expected))))
        assert abs(oracle.given_up) <= oracle.rounding + LET_GO * float(np.linalg.norm(oracle.f_e)) * any(
            core.clutches.all[i].settled and not before[i][1] for i in range(2)
        )
        core.settle()
    assert core.clutches.all[0].ratio > 0.99 * SLOWEST


def test_a_feedthrough_exchanged_within_a_tick_acts_in_the_next() -> None:
    """Forces are found, then a block changes its rung, then the tick ends: as it would have without that."""
    within, behind = ClutchedLoop(23, [[0, 2], [1]]), ClutchedLoop(23, [[0, 2], [1]])
    fresh = within.feedthrough(2)
    p, v = np.zeros(3), np.zeros(3)
    for k in range(120):
        v = 0.97 * v + within.rng.normal(0.0, 2e-5, 3)
        p = p + v
        found = []
        for world in (within, behind):
            core = world.core
            if k == 20:
                core.clutches.disengage(0)
            found.append(react(core, p).tolist())
            if k == 50 and world is within:
                core.exchange(0, fresh)
                core.clutches.engage(0)
            core.settle()
            if k == 50 and world is behind:
                core.exchange(0, fresh)
                core.clutches.engage(0)
            found.append(core.tools)
        assert found[:2] == found[2:], k
    assert within.core.clutches.all[0].ratio > 0.99 * SLOWEST


def test_only_a_frozen_block_may() -> None:
    world = ClutchedLoop(22, [[0, 2], [1]])
    core, fresh = world.core, 2.0 * np.eye(2)
    for _ in range(3):
        with pytest.raises(ValueError, match=r"found block 0 at the ratio .*expected it frozen"):
            core.exchange(0, fresh)
        core.clutches.disengage(0)
        react(core, np.zeros(3))
        core.settle()
    core.clutches.freeze(0)
    with pytest.raises(ValueError, match=r"found a feedthrough of shape \(3, 3\); expected 2 x 2"):
        core.exchange(0, np.eye(3))
    singular = EnvironmentCore(StateSpace.static(np.diag([2.0, 1.0])), np.zeros((2, 2)), None, T, [[0], [1]])
    singular.clutches.freeze(0)
    with pytest.raises(ValueError, match="no unique solution"):
        singular.exchange(0, np.array([[-0.5]]))
    singular.clutches.engage(0)
    for k in range(RAMP + 2):  # with the feedthrough that it had
        f = react(singular, np.array([0.0 if k == 0 else 1.0, 1.0]))
        singular.settle()
    s = math.sin(0.5 * math.pi / RAMP) ** 2
    assert f == pytest.approx([-2.0 * s, -1.0], rel=1e-12)


@pytest.mark.parametrize(
    ("blocks", "D_V", "words"),
    [
        ([[0], [1]], np.array([[1e-3, 1e-5], [1e-5, 1e-3]]), "between ports of two blocks"),
        ([[0], [0, 1]], np.eye(2), "expected each of 2 ports in one"),
        ([[0]], np.eye(2), "expected each of 2 ports in one"),
        ([[0], [1], [2]], np.eye(2), "expected each of 2 ports in one"),
        ([[0, 1], []], np.eye(2), "expected each of 2 ports in one"),
    ],
)
def test_blocks_that_are_none_are_refused(blocks: list[list[int]], D_V: np.ndarray, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        EnvironmentCore(StateSpace.static(np.eye(2)), D_V, None, T, blocks)


def test_a_ramp_takes_a_tick_at_least() -> None:
    with pytest.raises(ValueError, match="found a ramp of 0 ticks; expected 1 or more"):
        EnvironmentCore(StateSpace.static(np.eye(1)), np.eye(1), None, T, None, 0)


def test_blocks_may_be_slices_and_arrays() -> None:
    E = StateSpace.static(np.eye(3))
    core = EnvironmentCore(E, np.zeros((3, 3)), None, T, [slice(0, 2), np.array([2])])
    core.clutches.freeze(0)
    assert react(core, np.ones(3)).tolist() == [0.0, 0.0, -1.0]


def test_a_ratio_without_a_unique_solution_keeps_the_block_frozen() -> None:
    """Without a certificate some s on the way may have none: D_E D_V s^2 = -1 at the tenth tick of this ramp."""
    s = math.sin(0.5 * math.pi * 10 / 20) ** 2
    E = StateSpace.static(np.diag([2.0, 1.0]))
    core = EnvironmentCore(E, np.diag([-0.5 / s**2, 0.0]), None, T, [[0], [1]], 20)
    core.clutches.freeze(0)
    react(core, np.zeros(2))
    core.settle()
    core.clutches.engage(0)
    for k in range(40):
        f = react(core, np.array([1e-3 * k, 1.0]))
        core.settle()
        assert np.all(np.isfinite(f))
        assert f[1] == -1.0
        assert core.clutches.all[0].ratio < s
    assert core.ill_posed == 1
    assert core.clutches.all[0].ratio == 0.0
    assert core.clutches.all[1].ratio == 1.0
