"""The shipped stretcher: two users carry it, and what one turns the other feels."""

from __future__ import annotations

from typing import Final

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.session.shipped import load_named

from ...support.engine_runs import Traces, account_kept, simulated, world_kept

TICKS: Final = 4600
LIFTED, ROLLED, TURNED, DOWN = slice(1050, 3500), slice(1500, 1900), slice(3250, 3500), slice(4400, TICKS)
HANDS: Final = ("front", "back")


def carried(**torques: list[object]) -> tuple[Simulation, Traces]:
    """The session, in which these hands intend these torques."""
    session = load_named("stretcher", [])
    data = session.to_dict()
    for hand, torque in torques.items():
        data["devices"][hand]["orientation"]["torque"] = torque
    return simulated(data, TICKS)


def angles(quaternions: np.ndarray) -> np.ndarray:
    """About x, y and z, degrees; for small turns."""
    found: np.ndarray = np.degrees(2.0 * quaternions[:, 1:] * np.sign(quaternions[:, :1]))
    return found


@pytest.fixture(scope="module")
def run() -> tuple[Simulation, Traces]:
    return carried()


def test_it_is_lifted_rolled_turned_and_put_down_with_its_load(run: tuple[Simulation, Traces]) -> None:
    _, traces = run
    places, turns = traces["environment/masses"], angles(traces["environment/orientations"][:, :4])
    assert places[LIFTED, 2].min() > 0.025  # m
    assert places[DOWN, 2] == pytest.approx(0.006, abs=1e-4)
    assert turns[ROLLED, 0].max() == pytest.approx(3.6, abs=0.5)
    assert turns[TURNED, 2] == pytest.approx(20.0, abs=1.0)
    lies = places[:, 3:] - places[:, :3]
    assert abs(lies[:, :2]).max() < 0.0015  # the load is carried along, and leans as the stretcher does
    assert lies[50:, 2] == pytest.approx(0.013, abs=2e-4)


def test_a_hand_that_only_holds_is_turned_by_what_the_other_gave(run: tuple[Simulation, Traces]) -> None:
    _, traces = run
    rolls = {hand: angles(traces[f"{hand}/orientation"])[:, 0] for hand in HANDS}
    assert rolls["back"][ROLLED].max() == pytest.approx(rolls["front"][ROLLED].max(), abs=0.8)  # degrees
    assert traces["back/torque"][1500, 0] == pytest.approx(-traces["front/torque"][1500, 0], abs=1e-3)
    assert abs(traces["back/torque"][:, 0]).max() > 0.003  # N·m
    front, back = (traces[f"{hand}/account"] for hand in HANDS)
    assert 1e-4 < back[2300, 2] <= front[2300, 1]  # J: granted to one, of what the other had deposited


def test_a_hand_whose_tool_is_turned_by_another_feels_nothing_where_that_gives_nothing() -> None:
    """The stretcher is not rolled, and both wrists are still: where nobody turns, nobody is turned."""
    _, traces = carried(front=[0, 0, 0], back=[0, 0, 0])
    turns = angles(traces["environment/orientations"][:, :4])
    assert abs(turns[ROLLED, 0]).max() < 1e-3
    assert turns[TURNED, 2] == pytest.approx(14.2, abs=1.0)  # by the hands' way, against wrists that do not turn along
    assert np.linalg.norm(traces["front/force"][3400, :2]) > 1.5  # N
    for hand in HANDS:
        assert abs(angles(traces[f"{hand}/orientation"])).max() < 1e-6
        assert not traces[f"{hand}/account"][:, 1:3].any()


def test_every_account_is_kept(run: tuple[Simulation, Traces]) -> None:
    simulation, traces = run
    core = world_kept(simulation)
    assert core.oriented is not None
    assert core.oriented.bank.balance >= 0.0
    for hand in HANDS:
        account_kept(traces, hand)
    assert (traces["front/account"][:, 0] + traces["back/account"][:, 0] >= -1e-12).all()
