"""Processes that die in the middle of a session: the others go on, and the dead come back.

The clock is simulated, so that a slow machine freezes no user.
"""

from __future__ import annotations

import signal

import numpy as np
import pytest

from manyhands.launch.run.states import NodeState

from .stage import (
    PORTS,
    at,
    back,
    nodes_of,
    nothing,
    play,
    prepared,
    recording_of,
    require_as_simulated,
    require_calm,
    require_eased_in,
    require_sound,
    send,
)


@pytest.mark.parametrize(
    "victims", [("dx",), ("cx",), pytest.param(("dx", "cx"), marks=pytest.mark.long)], ids="+".join
)
def test_a_users_death_and_return_are_not_felt_by_the_other(victims: tuple[str, ...]) -> None:
    outcome = play((at(100), send(signal.SIGKILL, *victims)), (back(*victims), nothing))
    require_sound(outcome)
    require_as_simulated(outcome, "dx", "dy")
    require_calm(outcome, "dy")
    require_eased_in(outcome, "dx")
    nodes = nodes_of(outcome)
    for node in nodes:
        assert nodes[node].get("incidents", {}).get("restarts", 0) == (node in victims)
    for victim in victims:
        assert sum(f"{victim} was killed by SIGKILL while running" in told for told in outcome.incidents) == 1
    assert nodes["environment"]["incidents"]["frozen"] > 0


@pytest.mark.parametrize(
    "victims", [("environment",), pytest.param(("cx", "environment"), marks=pytest.mark.long)], ids="+".join
)
def test_after_the_environments_death_everybody_begins_without_force(victims: tuple[str, ...]) -> None:
    outcome = play((at(100), send(signal.SIGKILL, *victims)), (back(*victims), nothing))
    require_sound(outcome)
    nodes = nodes_of(outcome)
    for victim in victims:
        assert nodes[victim]["incidents"]["restarts"] == 1
    f = recording_of(outcome).f_v
    for i, port in enumerate(PORTS):
        (zero,) = np.nonzero(f[:, i] == 0.0)
        assert zero[-1] > 100, f"{port} was never without force after tick 100"


def test_a_node_without_restarts_left_stays_away_and_others_go_on() -> None:
    outcome = play(
        (at(100), send(signal.SIGKILL, "dx")),
        (back("dx"), send(signal.SIGKILL, "dx")),
        (lambda progress: progress.states["dx"] == NodeState.GONE.value, nothing),
        of=prepared("faults.restarts=1"),
    )
    assert outcome.code == 130
    (fault,) = (fault for fault in outcome.faults if "wrote:" not in fault)
    assert fault.startswith("dx was killed by SIGKILL while running; it stays away")
    require_calm(outcome, "dy")
