"""The shipped insertion: a peg that a hand turns, and a part with a hole that two hands hold by friction."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session.shipped import load_named

from ...support.engine_runs import Traces, account_kept, simulated, world_kept

HOME: Final = 0.04  # m, from the rim of the hole to its bottom
TICKS: Final = 5000
TURNED_ALONE: Final = ["-0.0058*pulse(t, 0.4, 0.9)", 0, "-0.013*pulse(t, 0.9, 1.4)"]
"""The hand's torques without its wiggling: the peg ends 1.4 degrees from the hole."""

TOUCHING, TWISTED, PRESSED = slice(2100, 2400), slice(2500, 4400), slice(4500, TICKS)


def inserted(torque: list[Any] | None = None) -> tuple[Simulation, Traces]:
    """Five seconds of the session, in which the hand of the peg intends these torques."""
    session = load_named("insert", [])
    data = session.to_dict()
    if torque is not None:
        data["devices"]["peg"]["orientation"]["torque"] = torque
    return simulated(data, TICKS)


def depth(traces: Traces) -> np.ndarray:
    """How far the end of the peg is below the rim of the hole, m: both stand upright, within half a degree."""
    masses = traces["environment/masses"]
    found: np.ndarray = masses[:, 5] + 0.025 - (masses[:, 2] - 0.035)
    return found


def angles(quaternions: np.ndarray) -> np.ndarray:
    """About x, y and z, degrees; for small turns."""
    found: np.ndarray = np.degrees(2.0 * quaternions[:, 1:] * np.sign(quaternions[:, :1]))
    return found


@pytest.fixture(scope="module")
def run() -> tuple[Simulation, Traces]:
    return inserted()


def test_the_peg_is_turned_finds_the_hole_and_is_pressed_home(run: tuple[Simulation, Traces]) -> None:
    _, traces = run
    found, peg = depth(traces), angles(traces["environment/orientations"][:, :4])
    assert peg[0] == pytest.approx([7.9, -1.4, 19.8], abs=0.1)
    assert abs(found[TOUCHING]).max() < 1e-4  # on the rim, 1.4 degrees from where it fits
    assert peg[2300, 2] == pytest.approx(1.4, abs=0.2)
    assert found[3000] > 0.002  # the wiggling has found it
    assert found[PRESSED] == pytest.approx(HOME, abs=1e-4)
    inside = peg[3000:] - angles(traces["environment/orientations"][3000:, 4:])
    assert abs(inside[:, 2]).max() < 0.6  # degrees: it fits within half of one
    assert abs(inside[:, 2]).max() > 0.45
    x, y, _ = (traces["environment/masses"][PRESSED, :3] - traces["environment/masses"][PRESSED, 3:]).T
    assert max(abs(x).max(), abs(y).max()) < 0.00026  # m: half a millimetre, from one wall to the other


def test_the_hands_feel_it(run: tuple[Simulation, Traces]) -> None:
    _, traces = run
    torque, force = traces["peg/torque"], traces["peg/force"]
    assert abs(torque[:400]).max() == 0.0  # in free space nothing but what turns the peg
    assert abs(torque[1500:2400]).max() < 2e-3
    assert abs(torque[TWISTED, 2]).max() == pytest.approx(0.012, abs=0.002)  # the hole takes the hand's whole torque
    assert force[TOUCHING, 2] == pytest.approx(0.55, abs=0.15)  # the rim
    assert force[PRESSED, 2] == pytest.approx(0.77, abs=0.1)  # the bottom
    weight = 0.21 * 9.81
    both = traces["left/force"][:, 2] + traces["right/force"][:, 2]
    assert both[1500] == pytest.approx(-weight, abs=0.1)  # two hands bear the part,
    assert both[-1] == pytest.approx(-weight - force[-1, 2], abs=0.1)  # and what the third presses


def test_every_account_is_kept(run: tuple[Simulation, Traces]) -> None:
    simulation, traces = run
    assert sum(world_kept(simulation).held) < 10
    _, deposited, _ = account_kept(traces, "peg").T
    assert deposited[-1] > 1e-5  # J; the hand has turned the part, and got some of it back
    assert np.linalg.norm(traces["peg/torque"], axis=1).max() < 0.2


@pytest.mark.parametrize("torque", [[0, 0, 0], TURNED_ALONE], ids=["not turned", "1.4 degrees away"])
def test_a_peg_that_is_held_wrong_jams(torque: list[Any]) -> None:
    """It stays on the rim, pressed by more than what inserts it, and pushes the part down between the hands."""
    _, traces = inserted(torque)
    assert depth(traces).max() < 0.001
    assert traces["peg/force"][-1, 2] > 3.0
    assert traces["environment/masses"][-1, 5] < 0.03


def test_the_certificate_has_the_orientation() -> None:
    prepared = prepare(load_named("insert", []))
    certificate = prepared.certificate
    assert certificate is not None
    claimed = {device.name: device.orientation for device in certificate.loop.devices}
    assert (claimed["left"], claimed["right"]) == (None, None)
    assert claimed["peg"] is not None
    assert (claimed["peg"].stiffness, claimed["peg"].osp) == (1.0, 0.0034)
