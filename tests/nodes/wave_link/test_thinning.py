"""An end that does not send a wave in every tick: when it sends, and what that costs in energy and in distance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.wave_link import UserFace, WorldFace
from manyhands.nodes.wave_link.thinning import Turns

T, B = 1e-3, np.array([[20.0]])


@given(every=st.integers(1, 12), turn=st.integers(0, 40), ticks=st.integers(1, 200))
def test_turns_say_the_same_of_every_tick(every: int, turn: int, ticks: int) -> None:
    turns = Turns(every, turn)
    sent = [n for n in range(1, ticks + 1) if turns.sends(n)]
    assert sent[0] == 1
    assert all(n % every == turn % every for n in sent[1:])
    assert turns.latest(ticks) == sent[-1]
    assert turns.latest(0) == 0
    n, found = 0, []
    while (n := turns.after(n)) <= ticks:
        found.append(n)
    assert found == sent


@pytest.mark.parametrize("every", [1, 2, 5, 8])
def test_links_take_turns(every: int) -> None:
    """Of so many links as there are ticks between two waves, one sends in each tick."""
    links = [Turns(every, turn) for turn in range(every)]
    assert all(sum(turns.sends(n) for turns in links) == 1 for n in range(2, 60))


def pressed(every: int, delay: int = 5) -> tuple[UserFace, WorldFace, float]:
    """Both faces with waves in one of ``every`` ticks each way, when a hand has pressed on a wall; and K felt, N/m."""
    user, world = UserFace(B, 1e-7 * np.eye(1), T, T, 4.0, E_0=0.005), WorldFace(B, T, T, 4.0, E_0=0.005)
    up, down = Turns(every, 1), Turns(every, 2)
    wall = 1.0 / world.D_V[0, 0]
    on_way_up, on_way_down = [], []
    for k in range(12_000):
        if on_way_up and on_way_up[0][0] <= k:
            world.hear(*on_way_up.pop(0)[1])
        world.step([-wall * world.tool()[0]])
        if world.aligned and down.sends(world.n):
            on_way_down.append((k + delay, world.message()))
        if on_way_down and on_way_down[0][0] <= k:
            user.hear(*on_way_down.pop(0)[1])
        p = 2e-3 * min(1.0, max(0.0, (k - 1000) / 1000))
        (f,) = user.step([p])
        if up.sends(user.n):
            on_way_up.append((k + delay, user.message()))
        for face in (user, world):
            if k == 100:
                face.measure()
            if k == 900:
                face.set_depth(face.measured)
        assert user.ledger + world.ledger >= -2.0 * 0.005
    return user, world, -f / p


def test_thinning_costs_the_round_trip_that_is_stated_and_no_energy() -> None:
    """K = 2b/R with R longer by every - 1 ticks each way, half of them in the depth that a face measures."""
    whole, _, stiffness = pressed(1)
    R = 2.0 * B[0, 0] / stiffness
    for every in (3, 6):
        user, world, felt = pressed(every)
        assert user.measured == pytest.approx(whole.measured + Turns(every, 0).depth, abs=0.1)
        longer = 2.0 * (every - 1) * T + (user.latency + world.latency - 2.0 * whole.latency) - (every - 1) * T
        assert 2.0 * B[0, 0] / felt == pytest.approx(R + longer, rel=0.03)
        assert longer == pytest.approx(2.0 * (every - 1) * T, abs=0.1 * T)
        assert (user.tank.clipped, world.tank.clipped) == (0, 0)
