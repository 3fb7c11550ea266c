"""The shipped gripper: a jaw that turns, two fingers, and a cube that friction alone lifts, carries and puts down."""

from __future__ import annotations

import numpy as np
import pytest

from manyhands.design.models.axis import AxisKind
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.session.shipped import load_named

from ...support.engine_runs import Traces, simulated, world_kept

HALF = 0.02  # m, of the cube, which begins at (-30, 0) mm on the table


def carried(*changes: tuple[str, str]) -> tuple[Simulation, Traces]:
    """Six seconds of the session, whose model has these changes of its text."""
    session = load_named("gripper", [])
    data = session.to_dict()
    for before, after in changes:
        assert before in data["environment"]["model"]
        data["environment"]["model"] = data["environment"]["model"].replace(before, after)
    return simulated(data, 6000)


def test_the_cube_is_lifted_by_friction_carried_and_put_down() -> None:
    simulation, traces = carried()
    x, y, z = traces["environment/masses"][:, :3].T
    table = pytest.approx(HALF, abs=2e-4)
    assert z[:1700] == table  # until the fingers have closed
    carry = slice(2600, 3900)
    assert z[carry].min() > HALF + 0.03  # 33 mm above the table, while it goes 60 mm to the right
    assert x[2600] == pytest.approx(-0.03, abs=1e-3)
    assert x[3900] == pytest.approx(0.03, abs=1e-3)
    assert z[4800:] == table
    assert x[-1] == pytest.approx(0.03, abs=1e-3)  # where it was put down, though the hand is gone
    assert abs(y).max() < 1e-3
    hand = traces["pinch/sample"]
    assert hand[-1, 2] > -1e-3
    assert hand[-1, 3] == pytest.approx(0.0, abs=1e-3)
    f = traces["pinch/force"]
    assert f[3500, 2] == pytest.approx(-0.05 * 9.81, abs=0.02)  # the hand bears the cube's weight
    assert f[3500, 3] < -0.05  # and feels, in N·m, what it holds
    assert sum(world_kept(simulation).held) < 10


def test_without_friction_the_fingers_slip_off() -> None:
    _, traces = carried(('friction="0.8 0.005 0.0001"', 'friction="0 0 0"'))
    assert traces["environment/masses"][2600:3900, 2].max() < HALF + 1e-3


def test_the_session_says_what_turns() -> None:
    session = load_named("gripper", [])
    assert session.turning == ("pinch.jaw",)
    assert session.devices["pinch"].kinds == (*[AxisKind.TRANSLATION] * 3, AxisKind.ROTATION)
    assert session.units("pinch.jaw")("N/m") == "N·m/rad"
    _, parameters = session.environment.code(session.ports, session.turning_ports) or ("", {})
    assert parameters["turning"] == ["pinch.jaw"]


def test_the_finger_that_follows_is_turned_as_far_as_the_jaw() -> None:
    _, traces = carried()
    w, x, y, z = traces["environment/orientations"][:, 4:].T
    assert abs(np.column_stack([x, z])).max() < 1e-9
    angle = 2.0 * np.arctan2(y, w)  # about y, from upright; 0.25 outwards at the start
    jaw = traces["environment/tools"][:, 3]
    assert np.ptp(jaw) > 0.25
    # the spring of the session stands between tool and avatar, and gives way by the torque
    assert angle + 0.25 == pytest.approx(jaw, abs=0.06)
