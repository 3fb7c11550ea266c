"""Users behind wave links: a process that dies is not felt by the others, and comes back in a new life of its link."""

from __future__ import annotations

import signal
from functools import cache

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED

from .stage import (
    AWAY,
    COUPLING_OF,
    NODES,
    PORTS,
    PROMISE,
    STEP,
    at,
    back,
    largest_step,
    nodes_of,
    nothing,
    play,
    prepared,
    recording_of,
    returned,
    rows_of,
    send,
    told_of,
)

LINKED = tuple(f"couplings.{name}.wave_link={{b: 20, depth: 2}}" for name in ("cx", "cy"))
ONE = LINKED[:1]
RIPPLE = 1.0  # N in a tick


@cache
def steps_of(overrides: tuple[str, ...]) -> float:
    """The largest step of dy's force, N, in simulations in which cx falls silent and comes back."""
    found = 0.0
    for begin in range(100, 900, 200):
        f = Simulation(prepared(*overrides)).run(1300, faults=[Silence("cx", begin, begin + AWAY)]).f_v[:, 1]
        found = max(found, largest_step(f))
    return found


@pytest.mark.parametrize("overrides", [LINKED, ONE], ids=["both linked", "one linked, one in the tick"])
@pytest.mark.parametrize("victims", [("cx",), pytest.param(("dx", "cx"), marks=pytest.mark.long)], ids="+".join)
def test_a_linked_users_death_is_not_felt_by_the_other(overrides: tuple[str, ...], victims: tuple[str, ...]) -> None:
    outcome = play(
        (at(100), send(signal.SIGKILL, *victims)), (back(*victims), nothing), of=prepared(*overrides), clock=SIMULATED
    )
    assert (outcome.code, outcome.faults) == (130, ())
    nodes = nodes_of(outcome)
    assert nodes.keys() == NODES
    assert all(node["ledger"]["margin"] >= PROMISE for node in nodes.values())
    _, f = rows_of(recording_of(outcome), "dy", linked=True)
    assert 0.0 < largest_step(f) <= STEP * steps_of(overrides)


@pytest.mark.alone
@pytest.mark.parametrize("victims", [("cx",), ("environment",)], ids="+".join)
def test_in_real_time_a_process_comes_back(victims: tuple[str, ...]) -> None:
    session = prepared(*LINKED, "design.tau=0.001", "design.period_tolerance=1.0")
    outcome = play(
        (told_of(500), send(signal.SIGKILL, *victims)),
        (returned(*NODES, ticks=600), nothing),
        of=session,
        clock=REALTIME,
    )
    assert (outcome.code, outcome.faults) == (130, ())
    nodes = nodes_of(outcome)
    for node in NODES:
        assert nodes[node].get("incidents", {}).get("restarts", 0) == (node in victims)
    # whoever is behind a wave link is never behind in ticks: nothing was jumped over
    for device in (device for device in PORTS if COUPLING_OF[device] not in victims):
        assert nodes[device].get("incidents", {}).get("jumps", 0) == 0
    f = recording_of(outcome).f_v[:, PORTS.index("dy")]  # sites end by themselves, each at a tick of its own
    assert 0.2 < np.nanmax(np.abs(f)) <= 5.0


def test_an_environment_that_comes_back_drops_no_force_at_once() -> None:
    """Its faces begin with empty tanks, which limit the waves for a while: forces ripple by some 0.3 N."""
    outcome = play(
        (at(300), send(signal.SIGKILL, "environment")),
        (back("environment"), nothing),
        of=prepared(*LINKED),
        clock=SIMULATED,
    )
    assert (outcome.code, outcome.faults) == (130, ())
    assert nodes_of(outcome)["environment"]["incidents"]["restarts"] == 1
    for port in PORTS:
        _, f = rows_of(recording_of(outcome), port, linked=True)
        assert 0.0 < largest_step(f) <= RIPPLE
