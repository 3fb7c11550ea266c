"""Bodies that turn and touch give out no energy by the scheme of decision 55, and do by its neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.deterministic.turned import HostileHand
from tests.deterministic.turned_in_a_scene import CalmHand, pooled, scene, together, under_the_tests
from tests.support.turning_bodies import (
    THINGS,
    Arms,
    Array,
    Kind,
    Normals,
    Scheme,
    T,
    World,
    after,
    cayley,
    hostile,
    pivots,
    solve,
    step,
)
from tests.support.turning_scene import Balls, TurningScene, quaternion

ROUNDING = 1e-12
PROVED = pytest.mark.parametrize("scheme", [Scheme(), Scheme(carried=True)], ids=["plain", "carried"])
TURNING = pytest.mark.parametrize("kind", [Kind.PLANE, Kind.FACE, Kind.EDGE])


def test_a_cayley_step_moves_each_point_by_the_turn_times_its_mean_arm() -> None:
    rng = np.random.default_rng(1)
    W, a = rng.normal(size=(100, 3)) * 10.0, rng.normal(size=(100, 3))
    turned = np.einsum("bij,bj->bi", cayley(W), a)
    assert np.allclose(turned - a, np.cross(W, (turned + a) / 2.0), rtol=0.0, atol=1e-13)
    assert np.allclose(np.linalg.norm(turned, axis=1), np.linalg.norm(a, axis=1), rtol=1e-13)


@PROVED
def test_no_step_whatever_gives_out_energy(scheme: Scheme) -> None:
    rng = np.random.default_rng(2)
    for _ in range(3):
        taken = step(*hostile(rng, 2000), scheme)
        assert (taken.given_out / taken.scale).max() <= ROUNDING
        assert (taken.lead / taken.scale).min() >= -ROUNDING


@PROVED
@TURNING
def test_a_pivot_neither_gains_nor_loses(scheme: Scheme, kind: Kind) -> None:
    taken = step(*pivots(np.random.default_rng(3), 2000, kind), scheme)
    assert np.abs(taken.given_out / taken.scale).max() <= ROUNDING


@pytest.mark.parametrize(
    "scheme",
    [Scheme(arms=Arms.START), Scheme(arms=Arms.END), Scheme(middle=True), Scheme(normals=Normals.START)],
    ids=["arms of the start", "arms of the end", "forces of the middle", "normals of the start"],
)
def test_the_neighbours_give_out_energy(scheme: Scheme) -> None:
    rng = np.random.default_rng(4)
    taken = step(*hostile(rng, 4000), scheme)
    assert (taken.given_out / taken.scale).max() > 0.05


def test_a_solved_step_needs_nothing_from_outside_and_gives_nothing_out() -> None:
    rng = np.random.default_rng(5)
    world, s, _ = hostile(rng, 40, 0.1)
    laws = tuple(replace(law, stiffness=np.minimum(law.stiffness, 1e3)) for law in world.laws)
    world = replace(world, laws=laws)
    found = solve(world, np.broadcast_to(1e-4 * np.eye(3), (40, 3, 3)), s[:, 0], Scheme())
    ended = found.off < 1e-9
    assert ended.mean() > 0.3
    assert (found.taken.given_out / found.taken.scale)[ended].max() <= 1e-9
    following = after(world, found.s, found.W, found.taken)
    assert np.allclose(following.c[:, :THINGS], world.c[:, :THINGS] + found.s)


def spun(carried: bool, speed: tuple[float, float, float], ticks: int) -> tuple[float, Array]:
    """What is left of the energy of a free body, as a part, and its orientation; its inertia is as 1 to 2 to 2.5."""
    second = np.broadcast_to(np.diag([1.75, 0.75, 0.25]) * 1e-5, (1, THINGS, 3, 3))
    turn = cayley(np.broadcast_to(np.array(speed) * T, (1, THINGS, 3)))
    none = np.zeros((1, THINGS, 3))
    R = np.broadcast_to(np.eye(3), (1, THINGS + 1, 3, 3))
    chord = R[:, :THINGS] - np.swapaxes(turn, -1, -2)
    world = World(
        np.zeros((1, THINGS + 1, 3)), R, none, chord, turn, np.ones((1, THINGS)), second,
        R[:, 0], np.array([1e-12]), none[:, 0], (),
    )  # fmt: skip
    energies = []
    for _ in range(ticks):
        found = solve(world, np.zeros((1, 3, 3)), none[:, 0], Scheme(carried=carried))
        world = after(world, found.s, found.W, found.taken)
        energies.append(float((world.chord[0, 1] @ second[0, 1] * world.chord[0, 1]).sum()))
    return energies[-1] / energies[0], world.R[0, 1]


def exactly(speed: tuple[float, float, float], lasts: float) -> Array:
    """The orientation of that body after ``lasts``, s, by Euler's equations in small steps."""
    inertia, w, R, steps = np.array([1.0, 2.0, 2.5]), np.array(speed), np.eye(3), 4000
    h = lasts / steps
    for _ in range(steps):
        middle = w - h / 2.0 * np.cross(w, inertia * w) / inertia
        R = R @ cayley(h * middle[None])[0]
        w = w - h * np.cross(middle, inertia * middle) / inertia
    return R


@pytest.mark.parametrize(("carried", "lost", "off"), [(False, 0.05, 2.0), (True, 1e-5, 0.1)])
def test_a_free_body_turns_as_euler_says_and_loses_little_where_velocities_are_carried(
    carried: bool, lost: float, off: float
) -> None:
    left, R = spun(carried, (0.2, 0.1, 10.0), 200)
    assert lost / 10.0 < 1.0 - left < lost
    angle = np.degrees(np.arccos(np.clip((np.trace(R @ exactly((0.2, 0.1, 10.0), 0.2).T) - 1.0) / 2.0, -1.0, 1.0)))
    assert off / 100.0 < angle < off


def tumbled(share: float) -> tuple[float, TurningScene]:
    """The most that a tick of two smooth bars, thrown about a room, stores beyond what came in, J; and the room."""
    bar = [(x, 0.0, 0.0) for x in (-0.03, 0.0, 0.03)]
    masses, rng = (0.04, 0.02, 0.04), np.random.default_rng(6)
    bodies = [Balls((0.0, 0.04 * i, 0.0), bar, 0.012, masses) for i in (-1, 1)]
    world, most = TurningScene(bodies, T, 1e4, 0.0, 0.0, share=share), -np.inf
    for tick in range(300):
        if tick % 50 == 0:
            world.push(rng.normal(scale=2.0, size=(2, 3)))
            world.twist(rng.normal(scale=0.3, size=(2, 3)))
        before = world.energy
        world.tick()
        most = max(most, world.energy - before - world.came - world.missing)
        assert abs(world.missing) < 1e-9
    return float(most), world


def test_a_scene_that_tumbles_never_stores_more_than_came_in() -> None:
    most, world = tumbled(0.5)
    assert most <= ROUNDING
    assert world.most_turned > 0.3
    assert world.unfinished == 0


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_with_arms_of_one_end_it_does(share: float) -> None:
    assert tumbled(share)[0] > 1e-3


def test_what_hands_put_in_by_moving_and_turning_covers_what_a_scene_stores_without_any_test() -> None:
    told = together(scene(ends=True, loss=0.0), 350, 1)
    assert told.touching > 100
    assert told.turning < -0.01  # the wrists alone give out what moving has put in
    assert told.least >= -ROUNDING * told.work
    assert together(scene(ends=False, loss=0.0), 350, 1).least < -1e-4  # springs held for a tick


@pytest.mark.parametrize("ends", [True, False])
def test_both_tests_keep_a_scene_whose_tools_turn(ends: bool) -> None:
    told, world = under_the_tests(ends, calm=False, ticks=250, seed=1)
    assert told.holds, told
    assert told.touching > 30
    assert told.held > 10
    assert world.unfinished == 0


def test_one_budget_for_moving_and_turning_cuts_nothing_of_calm_hands() -> None:
    told, _ = under_the_tests(ends=True, calm=True, ticks=500, seed=1)
    assert told.held > 20
    for both_ways in (True, False):
        one = pooled(scene(ends=True), 500, 1, CalmHand, both_ways)
        assert (one.held, one.stayed) == (0, 0)
        assert one.least >= -ROUNDING * one.work
        rough = pooled(scene(ends=True), 250, 1, HostileHand, both_ways)
        assert rough.least >= -ROUNDING * rough.work
        assert both_ways or rough.moving >= -ROUNDING * rough.work


def test_a_quaternion_is_that_of_its_rotation() -> None:
    rng = np.random.default_rng(7)
    for angle in (0.0, 1.0, 3.0, 3.14159):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        found = np.array(quaternion(cayley(2.0 * np.tan(angle / 2.0) * axis[None])[0]))
        wanted = np.array([np.cos(angle / 2.0), *np.sin(angle / 2.0) * axis])
        assert min(np.abs(found - wanted).max(), np.abs(found + wanted).max()) < 1e-9  # q and -q are one rotation
