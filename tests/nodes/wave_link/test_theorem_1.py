"""Theorem 1 of docs/remote/proof.md: passivity for every behaviour outside and every delivery."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.wave_link.tank import Tank

from .hostile import HostileLine

LINES = st.builds(
    HostileLine,
    seed=st.integers(0, 2**32 - 1),
    m=st.integers(1, 3),
    E_0=st.sampled_from([0.0, 1e-6, 5e-3, 0.1]),
    harvests=st.booleans(),
)
"""Links with E_0 and theta at 0 among them; impedance, periods, depths and D_V follow from the seed."""

OUTAGES = st.lists(st.tuples(st.integers(0, 300), st.integers(0, 300)), max_size=3)
"""When nothing is delivered: first step and number of steps."""

DEATHS = st.lists(st.tuples(st.integers(0, 300), st.integers(0, 1)), max_size=3)
"""Which process dies after which step."""


def run(
    line: HostileLine, outages: list[tuple[int, int]], deaths: list[tuple[int, int]], check: Callable[[], None]
) -> None:
    """300 steps: ticks of the two sites in any order, one of them for a while alone, with deliveries between them.

    Now and then a process misses ticks.
    """
    rng = line.rng
    bias = 0.5
    for step in range(300):
        if step % 20 == 0:
            bias = float(rng.choice([0.5, 0.5, 0.9, 0.1]))
        silent = any(first <= step < first + count for first, count in outages)
        site = int(rng.random() < bias)
        if not silent:
            line.deliver(site)
        if rng.random() < 0.1:
            line.skip(site)
            check()
        (line.tick_user, line.tick_world)[site]()
        check()
        for when, who in deaths:
            if when == step:
                line.die(who)
                check()


@given(line=LINES, outages=OUTAGES, deaths=DEATHS)
def test_the_two_port_never_gives_more_energy_than_both_tanks_held(
    line: HostileLine, outages: list[tuple[int, int]], deaths: list[tuple[int, int]]
) -> None:
    """Sum of -T f_c^T w_c + T w_c^T theta_c w_c and of T f_e^T w_e + T w_e^T theta_e w_e is never below -2 E_0."""

    def check() -> None:
        assert line.ledger >= -2.0 * line.E_0 - line.rounding

    run(line, outages, deaths, check)


@given(line=LINES, outages=OUTAGES, deaths=DEATHS)
def test_the_ledger_is_what_the_tanks_hold_and_what_is_in_transit(
    line: HostileLine, outages: list[tuple[int, int]], deaths: list[tuple[int, int]]
) -> None:
    """It equals L_c + L_e + transit + what died - 2 E_0, to rounding, and each face's own part of it is right."""

    def check() -> None:
        held = line.user.tank.level + line.world.tank.level + line.transit + line.lost
        assert line.ledger == pytest.approx(held - 2.0 * line.E_0, rel=0.0, abs=line.rounding)
        if line.life == 0:
            assert line.user.ledger + line.world.ledger == pytest.approx(line.ledger, rel=0.0, abs=line.rounding)

    run(line, outages, deaths, check)


@given(line=LINES, outages=OUTAGES, deaths=DEATHS)
def test_both_rules_hold_in_every_tick(
    line: HostileLine, outages: list[tuple[int, int]], deaths: list[tuple[int, int]]
) -> None:
    """L >= 0, transit >= 0 on each way, and G never falls in a life."""
    shipped = [(0, 0.0), (0, 0.0)]

    def check() -> None:
        user, world = line.user.tank, line.world.tank
        assert user.level >= 0.0
        assert world.level >= 0.0
        assert user.shipped >= world.heard
        assert world.shipped >= user.heard
        for site, face in enumerate(line.faces):
            life, before = shipped[site]
            assert face.life != life or face.tank.shipped >= before
            shipped[site] = (face.life, face.tank.shipped)

    run(line, outages, deaths, check)


@given(
    levels=st.lists(st.floats(0.0, 1e3), min_size=1, max_size=50),
    waves=st.lists(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=2), min_size=1, max_size=50),
    parts=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=50),
)
def test_a_tank_pays_for_no_wave_beyond_its_level(
    levels: list[float], waves: list[list[float]], parts: list[float]
) -> None:
    """|c|^2 <= 2 L/T, in the direction asked for; and what is shipped leaves L."""
    T = 1e-3
    tank = Tank(T, levels[0])
    for G, c, part in zip(np.cumsum(levels).tolist(), waves, parts, strict=False):
        tank.receive(G)
        before = tank.level
        paid = tank.pay(c)
        assert 0.5 * T * (paid[0] ** 2 + paid[1] ** 2) <= before * (1.0 + 1e-15)
        assert paid[0] * c[1] == pytest.approx(paid[1] * c[0], rel=1e-9, abs=1e-300)
        assert 0.0 <= tank.level <= before
        before, shipped = tank.level, tank.shipped
        tank.ship(part * tank.level)
        assert tank.shipped >= shipped
        assert tank.level >= 0.0
        assert tank.level == pytest.approx(before - (tank.shipped - shipped), rel=1e-15, abs=1e-15 * before)
