"""A device whose orientation is a port, in processes: they have the simulation's numbers, and may start anew."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from manyhands.launch.audit.simulation import simulate
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import Session
from manyhands.nodes.device.plugin import DriverFailure
from tests.support.slot import DEVICE, WORLD, sensed, session, slot_by, told, values
from tests.support.turning_drivers import Pen

from ..support.threaded_session import ThreadedSession

pytest.importorskip("mujoco")
TICKS = 450


FAR: dict[str, Any] = {"b": 20, "network": {"delay": 0.02, "jitter": 0.004, "loss": 0.02}}


@pytest.mark.parametrize("colocate", [False, True])
@pytest.mark.parametrize("link", [None, {"b": 20}, FAR, {"b": 20, "interval": 0.003}])
def test_processes_have_the_numbers_of_the_simulation(
    new_life: Callable[[], Any], colocate: bool, link: dict[str, Any] | None
) -> None:
    """Over a wave link as well, where what rides comes with the waves."""
    prepared = prepare(slot_by(link, colocate=colocate))
    run = simulate(prepared, TICKS)
    with ThreadedSession(prepared, new_life, ticks=TICKS) as stage:
        reports = stage.reports()
    assert np.abs(values(run, "pen", "t_v")).max() > 1e-3  # what was proposed has come, and turns the hand
    for node, traces in (("pen", DEVICE), ("environment", WORLD)):
        for trace in traces:
            np.testing.assert_array_equal(stage.lines[node].trace(trace), values(run, node, trace), trace)
    assert reports["pen"].figures["orientation_margin"] >= -1e-15
    assert reports["pen"].figures["orientation_late"] == 0.0


def test_a_hand_that_feels_nothing_has_the_numbers_of_the_simulation(new_life: Callable[[], Any]) -> None:
    prepared = prepare(Session.from_dict(sensed()), None)
    alone = simulate(prepared, TICKS)
    with ThreadedSession(prepared, new_life, ticks=TICKS) as stage:
        reports = stage.reports()
    for node, traces in (("pen", ("x", "f_v", "R")), ("environment", WORLD)):
        for trace in traces:
            np.testing.assert_array_equal(stage.lines[node].trace(trace), values(alone, node, trace), trace)
    assert not any(figure.startswith("orientation") for figure in reports["pen"].figures)


@pytest.mark.parametrize("sense", [False, True])
def test_a_driver_of_another_package_has_the_numbers_of_the_simulation(
    new_life: Callable[[], Any], sense: bool
) -> None:
    prepared = prepare(Session.from_dict(told({"sensed": True, "stiffness": 0.3} if sense else None)), None)
    alone = simulate(prepared, TICKS)
    with ThreadedSession(prepared, new_life, ticks=TICKS) as stage:
        stage.reports()
    for node, traces in (("pen", ("x", "f_v", "R") if sense else DEVICE), ("environment", WORLD)):
        for trace in traces:
            np.testing.assert_array_equal(stage.lines[node].trace(trace), values(alone, node, trace), trace)


@pytest.mark.parametrize("kind", ["NotANumber", "Torn", "WrenchTorn"])
def test_a_driver_that_fails_ends_its_node_by_name_and_lets_go(new_life: Callable[[], Any], kind: str) -> None:
    prepared = prepare(Session.from_dict(told(driver=f"tests.support.turning_drivers:{kind}")), None)
    Pen.let_go.clear()
    named = f"the driver tests.support.turning_drivers:{kind} failed in (orientation|apply_wrench)"
    with (
        pytest.raises(DriverFailure, match=named),
        ThreadedSession(prepared, new_life, ticks=20) as stage,
    ):
        stage.reports()
    assert Pen.let_go == [kind]


def test_a_device_that_comes_back_has_an_account_of_its_own(new_life: Callable[[], Any]) -> None:
    with ThreadedSession(prepare(session(), None), new_life, ticks=600) as stage:
        tick = stage.reach("environment", 200)
        stage.lose("pen")
        stage.bring_back("pen", tick)
        stage.reports("environment")
        heard = stage.lines["environment"].trace("heard")
        told = stage.lines["environment"].trace("told")
    assert set(heard[:, 5]) == {1.0, 2.0}
    first = int(np.flatnonzero(heard[:, 5] == 2.0)[0])
    assert heard[first - 1, 4] > 0.0  # the hand before had deposited
    assert heard[first, 4] == 0.0
    assert told[first - 1, 4] + told[-1, 4] <= heard[first - 1, 4] + heard[-1, 4] + 1e-15  # of both lives together
