"""The energy accounts of the environment's parties, and what their budgets admit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.nodes.environment.energy import POSTING, Energy
from manyhands.nodes.kernel.energy_budget import EnergyBudget

from ...support.cases import cases

T = 1e-3
STORE = 10.0  # J
joules = st.floats(-1.0, 1.0).map(lambda energy: 0.0 if abs(energy) < 1e-9 else energy)
ticks = st.integers(2, 4).flatmap(lambda n: st.lists(st.lists(joules, min_size=n, max_size=n), min_size=1, max_size=40))


def accounts(n: int, budgets: list[EnergyBudget] | None = None, known: bool = False) -> Energy:
    return Energy([(i,) for i in range(n)], budgets, T, known)


@settings(max_examples=cases(50, 150))
@given(supplies=ticks)
def test_every_joule_that_is_received_is_somebodys(supplies: list[list[float]]) -> None:
    n = len(supplies[0])
    energy = accounts(n)
    taken = 0.0
    for supplied in supplies:
        taken -= sum(g for g in supplied if g < 0.0)
        before = energy.unowned
        energy.supply(supplied)
        assert energy.unowned >= before
    assert sum(energy.given) == pytest.approx(sum(energy.received), abs=1e-9)
    assert sum(energy.given) + energy.unowned <= taken + 1e-9
    for i in range(n):
        assert sum(energy.moved[i]) == pytest.approx(energy.given[i], abs=1e-9)
        assert sum(row[i] for row in energy.moved) == pytest.approx(energy.received[i], abs=1e-9)
        assert energy.moved[i][i] == 0.0


def test_a_world_without_energy_that_rounds_below_zero_limits_nothing() -> None:
    energy = accounts(2)
    energy.bound(-1e-18)
    energy.supply([1.0, 0.0])
    energy.bound(-1e-18)
    energy.supply([0.0, -0.5])
    assert (energy.given, energy.unowned) == ([0.0, 0.0], 0.5)


@settings(max_examples=cases(50, 100))
@given(supplies=ticks)
def test_a_single_supplier_is_charged_with_all_that_others_receive(supplies: list[list[float]]) -> None:
    """The others take no more than there is: what they take is the supplier's, to the last joule."""
    energy, stored, taken = accounts(len(supplies[0]), known=True), 0.0, 0.0
    for first, *others in supplies:
        put, wanted = abs(first), sum(abs(g) for g in others)
        stored += put
        part = min(1.0, stored / wanted) if wanted > 0.0 else 0.0
        stored -= part * wanted
        taken += part * wanted
        energy.supply([put, *(-part * abs(g) for g in others)])
    assert energy.given[0] == pytest.approx(taken, abs=1e-6)
    assert energy.given[1:] == [0.0] * (len(supplies[0]) - 1)


@settings(max_examples=cases(50, 100))
@given(supplies=ticks)
def test_who_puts_nothing_in_is_never_charged(supplies: list[list[float]]) -> None:
    n = len(supplies[0])
    energy = accounts(n, [EnergyBudget(1e-9, 1e-9, STORE)] * n)
    for supplied in supplies:
        energy.supply([-abs(supplied[0]), *supplied[1:]])
        assert energy.given[0] == 0.0
        assert energy.ratio(0) == 1.0


@settings(max_examples=cases(50, 100))
@given(
    pushes=st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(0.0, 1.0), st.integers(0, 3)), min_size=1, max_size=60),
    known=st.booleans(),
)
def test_a_hand_that_only_gives_way_is_never_charged(pushes: list[tuple[float, float, int]], known: bool) -> None:
    """Party 1 burns, and gives back, some of what it was moved with, however late; parties 0 and 2 push."""
    energy = accounts(
        3, [EnergyBudget(1.0, 1e9, STORE), EnergyBudget(1e-9, 1e-9, STORE), EnergyBudget(1.0, 1e9, STORE)], known
    )
    stored = 0.0
    for push, part, wait in pushes:
        if push >= 0.0:  # it is moved, and stores what it can
            energy.supply([push, -push - 0.3 * part, 0.3 * part])
            stored = min(STORE, stored + part * (push + 0.3 * part))
        else:
            energy.supply([push * part, min(stored, -push), 0.0])
            stored -= min(stored, -push)
        for _ in range(wait):
            energy.supply([0.0, 0.0, 0.0])
            energy.bound(1e3 * (1.0 - part))
        assert energy.given[1] == 0.0
        assert energy.ratio(1) == 1.0


@settings(max_examples=cases(50, 100))
@given(
    supplies=st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), min_size=1, max_size=200),
    wait=st.integers(0, 50),
    burns=st.floats(0.01, 1.0),
)
def test_energy_released_later_is_still_its_suppliers(
    supplies: list[tuple[float, float]], wait: int, burns: float
) -> None:
    """What two parties have stored in a world that burns some of it comes out in proportion, however late."""
    energy = accounts(3, known=True)
    for a, b in supplies:
        energy.supply([a, b, 0.0])
    total = sum(a + b for a, b in supplies)
    left = burns * total
    energy.bound(left)
    for _ in range(wait):
        energy.supply([0.0, 0.0, 0.0])
    energy.supply([0.0, 0.0, -left])
    if left > 0.0:
        assert energy.moved[0][2] == pytest.approx(left * sum(a for a, _ in supplies) / total, abs=1e-9)
        assert energy.moved[1][2] == pytest.approx(left * sum(b for _, b in supplies) / total, abs=1e-9)
    assert energy.unowned == pytest.approx(0.0, abs=1e-9)
    energy.supply([0.0, 0.0, -1.0])
    assert energy.unowned == pytest.approx(1.0, abs=1e-6)  # nothing was left


@settings(max_examples=60)
@given(
    power=st.floats(0.1, 50.0),
    size=st.floats(0.1, 50.0),
    pushes=st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=50),
    holding=st.floats(0.0, 1.0),
    each=st.booleans(),
)
def test_over_every_window_the_others_receive_no_more_than_the_budget(
    power: float, size: float, pushes: list[float], holding: float, each: bool
) -> None:
    """The party pushes as it likes, up to half its bucket in a tick (three eighths where postings wait).

    Its ratio and its room are obeyed.
    """
    energy = accounts(2, [EnergyBudget(power, size, STORE), EnergyBudget(1.0, size, STORE)])
    received = [0.0]
    stored = 0.0
    for k in range(1000):
        push = pushes[k % len(pushes)] * size * (1.0 if each else 0.75)
        put = push if push < 0.0 else energy.ratio(0) * push
        if energy.ratio(0) < 1.0 and put > energy.room(0):
            put = 0.0
        put = max(put, -stored)
        stored += put
        taken = (1.0 - holding) * stored
        stored -= taken
        if each:
            energy.supply([put, -taken])
        else:
            energy.enter([-put, taken], [1.0, 1.0], [0.0, 0.0])
        received.append(energy.given[0])
    found = np.array(received) - power * T * np.arange(len(received))
    worst = float(np.max(found - np.minimum.accumulate(found)))
    assert worst <= size * (1.0 + 1e-9)


@settings(max_examples=60)
@given(power=st.floats(0.1, 50.0), size=st.floats(0.1, 50.0), parts=st.lists(st.floats(0.0, 1.0), min_size=1))
def test_a_party_within_its_budget_is_never_scaled(power: float, size: float, parts: list[float]) -> None:
    """It puts in at most P, and nearly half a bucket at once in the beginning; the others take it."""
    energy = accounts(2, [EnergyBudget(power, size, STORE), EnergyBudget(1.0, 1.0, STORE)])
    put = 0.499 * size
    for k in range(1000):
        energy.supply([put, -put])
        put = parts[k % len(parts)] * power * T
        assert energy.ratio(0) == 1.0
        assert not energy.restrained
    assert energy.scaled == [0, 0]


@settings(max_examples=cases(50, 100))
@given(
    size=st.floats(0.1, 50.0),
    parts=st.lists(st.tuples(st.floats(0.0, 1.0), joules, joules), min_size=1, max_size=60),
    known=st.booleans(),
)
def test_a_party_below_half_its_bucket_is_never_scaled(
    size: float, parts: list[tuple[float, float, float]], known: bool
) -> None:
    energy = accounts(
        3, [EnergyBudget(1e-3, size, STORE), EnergyBudget(1.0, 1.0, STORE), EnergyBudget(1.0, 1.0, STORE)], known
    )
    whole = max(1.0, sum(part for part, *_ in parts))
    for part, *others in parts:
        energy.supply([0.499 * size * part / whole, *others])
        energy.bound(0.0 if others[0] > 0.5 else 1e3)
        assert energy.ratio(0) == 1.0


def test_a_stopped_party_goes_on_once_half_its_bucket_is_free() -> None:
    energy = accounts(2, [EnergyBudget(1.0, 1.0, STORE), EnergyBudget(1.0, 1.0, STORE)])
    energy.supply([0.97, -0.97])
    assert energy.ratio(0) == 0.0
    assert energy.stops == [1, 0]
    stopped = 0
    while energy.ratio(0) == 0.0:
        energy.supply([0.0, 0.0])
        stopped += 1
    assert stopped == pytest.approx(0.47 / T, abs=2)
    assert energy.ratio(0) == 1.0
    assert energy.scaled[0] == stopped
    assert energy.ratio(1) == 1.0


def test_ports_of_a_block_count_together() -> None:
    energy = Energy([(0, 2), (1,)], None, T)
    for _ in range(POSTING):
        energy.enter([-1.0, 2.0, -2.0], [0.1, 0.2, 0.3], [0.0, 0.0, 0.0])  # 0.1 + 0.6 J in, 0.4 J out
    assert energy.moved == [[0.0, pytest.approx(POSTING * 0.4)], [0.0, 0.0]]


def test_a_tick_worth_an_eighth_of_a_bucket_is_posted_immediately() -> None:
    energy = accounts(2, [EnergyBudget(1e-6, 1.0, STORE), EnergyBudget(1.0, 4.0, STORE)], known=True)
    for put, ratio in ((0.1, 1.0), (0.1, 1.0), (0.35, pytest.approx(0.9))):  # only the third makes a posting
        energy.enter([-put, 0.0], [1.0, 1.0], [0.0, 0.0])
        assert energy.ratio(0) == ratio
    assert energy.restrained


def test_what_waits_is_posted_before_the_world_burns_it() -> None:
    energy = accounts(2, known=True)
    energy.enter([-1.0, 0.0], [1.0, 1.0], [0.0, 0.0])
    energy.bound(0.25)
    for _ in range(POSTING):
        energy.enter([0.0, 1.0], [1.0, 1.0], [0.0, 0.0])
    assert energy.given[0] == pytest.approx(0.25)
    assert energy.unowned == pytest.approx(POSTING - 0.25)


@pytest.mark.parametrize("found", [0.0, -1.0, math.inf, math.nan])
def test_a_budget_is_a_positive_number(found: float) -> None:
    with pytest.raises(ValueError, match="expected a finite number greater than 0"):
        EnergyBudget(found, 1.0, STORE)
    with pytest.raises(ValueError, match="expected a finite number greater than 0"):
        EnergyBudget(1.0, found, STORE)


def test_a_blow_that_only_passes_through_a_party_is_not_its_own() -> None:
    """It receives 30 J of the other within a tick, six times a hand's store, and gives all back in 20 ticks.

    Beyond the store it was charged with all of that: it was stopped for what the other had done.
    """
    energy = Energy([[0], [1]], [EnergyBudget(100.0, 1000.0, 5.0), EnergyBudget(1.0, 1.0, 5.0)], 1e-3, known=True)
    energy.supply([30.0, -30.0])
    given = 0.0
    for _ in range(20):
        energy.supply([-1.2, 1.2])
        given += 1.2
    assert given < 30.0
    assert energy.stops == [0, 0]
    assert energy.given[1] == 0.0
    # what was received longer ago than that is a hand's store and no more
    for _ in range(5000):
        energy.supply([0.0, 0.0])
    for _ in range(4):
        energy.supply([-5.0, 5.0])
    assert energy.given[1] > 9.0
