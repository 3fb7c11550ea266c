"""Sets of damping by motion from turn to turn: the truth is in each, whatever the inertia, the pose and the errors."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from manyhands.design.closed_motion import (
    ON_THE_WAY,
    Along,
    Damped,
    damped,
    even_lines,
    identified_by_turns,
    measured_along,
    unsure,
)
from manyhands.design.identification import Doubt, Line, MeasuredMotion, NotOfThisClass, TooLittle, lines

Array = NDArray[np.float64]
T = 2e-3
TRAVEL = 0.03
SPEEDS = (0.02, 0.05, 0.12, 0.25)
FINE = Doubt(1e-7)

Burns = Callable[[Array], Array]
"""Speed along a line (m/s) -> force, N, of friction and drag."""


def coulomb(c: float) -> Burns:
    return lambda v: c * np.sign(v)


NOTHING = coulomb(0.0)


def motion(
    level: int,
    u: Array,
    M: Callable[[Array], tuple[Array, Array]],
    B: Array,
    burns: Burns = NOTHING,
    pull: float = 0.0,
) -> MeasuredMotion:
    """A smooth motion to and fro along u with the force that it takes, in closed form.

    M gives the inertia's matrix at each place s of the line, and its slope; both are samples x axes x axes.
    """
    omega = SPEEDS[level] / TRAVEL
    t = np.arange(0.0, 3.9 * 2.0 * np.pi / omega, T)
    middle = t + 0.5 * T  # a force is held: that of the middle of its tick
    s, v = TRAVEL * np.sin(omega * middle), SPEEDS[level] * np.cos(omega * middle)
    inertia, slope = M(s)
    a = -(omega**2) * s
    f = np.einsum("k,kij,j->ki", a, inertia, u) + 0.5 * np.einsum("k,kij,j->ki", v**2, slope, u)
    f += np.outer(v, B @ u) + np.outer(burns(v) + pull * s, u)
    turns = np.flatnonzero(np.diff(np.floor(omega * t / np.pi + 0.5)))
    x = np.outer(TRAVEL * np.sin(omega * t), u)
    return MeasuredMotion(t, x, t, f, level, tuple(int(turn) + 1 for turn in turns))


def constant(M: Array) -> Callable[[Array], tuple[Array, Array]]:
    return lambda s: (np.broadcast_to(M, (len(s), *M.shape)), np.zeros((len(s), *M.shape)))


def along(u: Array, B: Array, doubt: Doubt = FINE, M: Array | None = None, burns: Burns = NOTHING) -> Along:
    u = u / np.sqrt(u @ u)
    inertia = constant(0.2 * np.eye(len(u)) if M is None else M)
    return measured_along([motion(level, u, inertia, B, burns) for level in range(len(SPEEDS))], u, doubt)


def found(B: Array, also: Sequence[Array] = (), **given: object) -> Damped:
    return damped([along(u, B, **given) for u in [*lines(len(B)), *also]])  # type: ignore[arg-type]


def turned(values: Sequence[float], angle: float) -> Array:
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return R @ np.diag(values) @ R.T


@pytest.mark.parametrize("angle", [0.0, 0.4, 0.8])
def test_the_least_eigenvalue_is_found_wherever_it_points(angle: float) -> None:
    B = turned((0.2, 0.5), angle)
    least = found(B, M=turned((0.1, 0.6), angle + 0.5)).least
    assert 0.14 < least.low <= 0.2 <= least.high


def test_lines_that_are_evenly_damped_tell_more_of_a_weak_direction() -> None:
    """Which is at no axis: of a linkage the damping may be twenty times as much across it."""
    B = turned((0.1, 2.0), 0.5)
    chosen = even_lines(B)
    assert abs(chosen[0] @ chosen[1]) < 1e-9
    assert chosen[2] @ B @ chosen[2] == pytest.approx(chosen[3] @ B @ chosen[3])
    doubt = Doubt(3e-5)
    without, with_them = found(B, doubt=doubt).least, found(B, chosen, doubt=doubt).least
    assert without.low < 0.6 * with_them.low
    assert 0.03 < with_them.low <= 0.1


def test_axes_are_enough_where_the_damping_is_even() -> None:
    assert even_lines(turned((0.2, 0.7), 0.3)) == []
    assert len(even_lines(np.diag([0.1, 0.2, 3.0]))) == 7


def test_three_axes() -> None:
    B = np.array([[0.5, 0.1, 0.0], [0.1, 0.4, 0.05], [0.0, 0.05, 0.6]])
    least = found(B).least
    truth = float(np.linalg.eigvalsh(B)[0])
    assert 0.7 * truth < least.low <= truth <= least.high


def test_what_is_stated_of_a_linkage_is_left_at_each_place_of_its_ways() -> None:
    every = [along(u, np.diag([0.3, 0.4])) for u in lines(2)]
    stated = identified_by_turns([Line(one.u, (), ((), ())) for one in every], every)
    assert stated.damping.low == ON_THE_WAY * damped(every).least.low > 0.0
    assert stated.by_axis == (0.0, 0.0)  # without windows nothing is known of friction's places


@settings(max_examples=8, deadline=None)
@given(
    values=st.tuples(st.floats(0.05, 1.0), st.floats(0.05, 1.0)),
    angle=st.floats(0.0, 1.5),
    c=st.floats(0.0, 0.1),
    delta=st.sampled_from([1e-6, 1e-5]),
    seed=st.integers(0, 2**31),
)
def test_the_truth_is_in_the_set_whatever_the_errors_within_their_bound(
    values: tuple[float, float], angle: float, c: float, delta: float, seed: int
) -> None:
    random, B = np.random.default_rng(seed), turned(values, angle)
    every = []
    for u in lines(2):
        u = u / np.sqrt(u @ u)
        motions = []
        for level in range(len(SPEEDS)):
            one = motion(level, u, constant(turned((0.1, 0.4), angle - 0.7)), B, coulomb(c))
            # the worst for a work turns round with the force
            way = np.sign(one.f @ u)[:, None] * u if seed % 2 else random.choice([-0.7, 0.7], one.x.shape)
            motions.append(dataclasses.replace(one, x=one.x + delta * way))
        every.append(measured_along(motions, u, Doubt(delta)))
    identified = damped(every)
    assert identified.least.low <= min(values) <= identified.least.high * (1.0 + 1e-9)
    for line, between in zip(every, identified.by_line, strict=True):
        assert between.low <= line.u @ B @ line.u <= between.high


def test_neither_inertia_that_changes_with_the_place_nor_a_spring_matters() -> None:
    """Windows need to know the inertia; here it is five times as much at one end of the way as at the other."""
    u, B = np.ones(1), np.array([[0.1]])

    def steep(s: Array) -> tuple[Array, Array]:
        return (0.3 + 0.2 * s / TRAVEL)[:, None, None], np.full((len(s), 1, 1), 0.2 / TRAVEL)

    motions = [motion(level, u, steep, B, coulomb(0.02), pull=5.0) for level in range(len(SPEEDS))]
    least = damped([measured_along(motions, u, FINE)]).least
    assert 0.09 < least.low <= 0.1 <= least.high


@pytest.mark.parametrize("power", [1.5, 2.0, 3.0])
def test_drag_is_no_damping(power: float) -> None:
    drag = 0.2 / SPEEDS[-1] ** (power - 1.0)
    only = found(np.zeros((1, 1)), burns=lambda v: drag * np.sign(v) * np.abs(v) ** power)
    assert only.least.low < 1e-3
    beside = found(np.array([[0.1]]), burns=lambda v: drag * np.sign(v) * np.abs(v) ** power)
    assert 0.0 < beside.least.low <= 0.1


@pytest.mark.parametrize(("stribeck", "more"), [(0.001, 0.05), (0.01, 0.05), (0.05, -1.0)])
def test_friction_at_rest_is_no_damping(stribeck: float, more: float) -> None:
    """It is met at every turn."""
    least = found(
        np.array([[0.1]]), burns=lambda v: np.sign(v) * (0.05 + 0.05 * np.exp(-np.minimum((v / stribeck) ** 2, 700.0)))
    ).least
    assert more < least.low <= 0.1


def test_something_that_gives_energy_is_not_of_the_class() -> None:
    with pytest.raises(NotOfThisClass, match="something else acts on it"):
        found(turned((-0.3, -0.2), 0.3))


def test_a_gap_costs_the_times_that_it_is_in_and_no_more() -> None:
    u, B = np.ones(1), np.array([[0.1]])
    motions = [motion(level, u, constant(0.2 * np.eye(1)), B) for level in range(len(SPEEDS))]
    whole = measured_along(motions, u, FINE)
    for at, one in enumerate(motions):
        kept = np.ones(len(one.applied), bool)
        late = one.turns[1] + 5
        kept[late : late + 30] = False  # 60 ms without a tick
        turns = tuple(turn - 30 * (turn > late) for turn in one.turns)
        motions[at] = dataclasses.replace(
            one, sampled=one.sampled[kept], x=one.x[kept], applied=one.applied[kept], f=one.f[kept], turns=turns
        )
    parts = measured_along(motions, u, FINE)
    assert [one.level for one in parts.rounds] == [one.level for one in whole.rounds]
    assert all(some.R < one.R for some, one in zip(parts.rounds, whole.rounds, strict=True))
    assert 0.08 < damped([parts]).least.low <= 0.1


def test_times_in_which_the_servo_learned_are_left_out() -> None:
    u, B = np.ones(1), np.array([[0.1]])
    motions = [motion(level, u, constant(0.2 * np.eye(1)), B) for level in range(len(SPEEDS))]
    settled = [dataclasses.replace(one, settled=3) for one in motions]
    some, every = (measured_along(of, u, FINE).rounds[0].R for of in (settled, motions))
    assert some == pytest.approx(every - 4.0 * TRAVEL, rel=1e-3)


def test_one_speed_does_not_tell_damping_from_friction() -> None:
    u = np.ones(1)
    with pytest.raises(TooLittle, match="expected two or more"):
        measured_along([motion(1, u, constant(0.2 * np.eye(1)), np.array([[0.1]]))], u, FINE)


@given(seed=st.integers(0, 2**31), m=st.integers(2, 3))
def test_what_an_error_of_a_velocity_counts_with_is_bounded(seed: int, m: int) -> None:
    """u^T B e for errors of at most 1 along the line, and on each axis aside; ``about`` may be anything."""
    random = np.random.default_rng(seed)
    root, other = random.normal(size=(m, m)), random.normal(size=(m, m))
    B, about = root @ root.T, other @ other.T + 1e-3 * np.eye(m)
    u = random.normal(size=m)
    u /= np.sqrt(u @ u)
    basis = np.linalg.qr(np.column_stack([u, random.normal(size=(m, m - 1))]))[0]
    e = basis @ random.choice([-1.0, 1.0], m)
    assert abs(u @ B @ e) <= np.sum(B * unsure(u, about)) * (1.0 + 1e-9)
