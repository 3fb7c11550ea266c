"""The search among motions of an arm: it finds what pays where the claim is false, and nothing where it is true."""

import copy
import json
from typing import Any

import numpy as np
import pytest

from manyhands.design.certificate import to_json
from manyhands.design.errors import Infeasible
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.synthesis import design
from tests.attack.linkages import Arm, Cycle, Timing, searched

Data = dict[str, Any]

T = 1e-3
ARM = Arm(0.12, 0.14, 1.2, 2.8)  # its condition number is below 4
KAPPA = ARM.worst()[0]
STIFFEST = SpringDamperWanted(Wish("stiffest"))
NYQUIST = Timing(2, (0, 0), (0, 0))


def certificate(wanted: CouplingRequest, osp: float, held: HeldTorque | None, tau: float = 0.0) -> Data:
    """An arm before a stiff wall in both directions."""
    ports = ("arm.x", "arm.y")
    wall = Network(ports, (), tuple(NetworkLink((port, GROUND), 2e4, 0.0) for port in ports))
    device = DeviceLevel("arm", (0, 1), osp * np.eye(2), held)
    loop = HapticLoop("arm", T, ports, (device,), Partition(("c",), ((0, 1),)), wall, tau)
    data: Data = json.loads(to_json(design(loop, wanted).certificate))
    return data


def stiffened(data: Data, times: float) -> Data:
    """The same claim of a stiffer coupling."""
    out = copy.deepcopy(data)
    block = out["coupling"]["blocks"]["c"]
    block["stiffness"] = (times * np.array(block["stiffness"])).tolist()
    return out


def stiffness(data: Data) -> float:
    return float(data["coupling"]["blocks"]["c"]["stiffness"][0][0])


def test_kappa_is_the_acceleration_of_a_tip_whose_joints_go_evenly() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = np.array([0.0, rng.uniform(ARM.least, ARM.most)])
        v = rng.normal(size=2)
        v /= np.linalg.norm(v)
        speeds, h = np.linalg.solve(ARM.jacobian(q), v), 1e-4
        second = (ARM.tip(q + h * speeds) - 2.0 * ARM.tip(q) + ARM.tip(q - h * speeds)) / h**2
        assert second == pytest.approx(ARM.bending(float(q[1]), v), rel=1e-5, abs=1e-5)
        assert np.linalg.norm(second) <= KAPPA * (1.0 + 1e-3)  # of a grid


def test_angles_are_those_of_the_tip() -> None:
    rng = np.random.default_rng(2)
    q = np.stack([rng.uniform(-1.0, 1.0, 50), rng.uniform(ARM.least, ARM.most, 50)], -1)
    assert ARM.angles(ARM.tip(q)) == pytest.approx(q, abs=1e-12)


def test_a_held_force_is_neutral_at_the_limit_and_a_held_torque_pays() -> None:
    # hands.md: with b = 0.1 and T = 1 ms a spring of 200 N/m is exactly neutral where the force is held
    data = certificate(SpringDamperGiven(SpringDamper(199.0 * np.eye(2), np.zeros((2, 2)))), 0.1, None)
    data["devices"]["arm"]["held"] = {"kappa": KAPPA, "force": 12.0, "speed": 1.0}
    found, looked = searched(data, ARM, NYQUIST, np.random.default_rng(3))
    assert looked > 200
    assert found > 1.5


def test_the_former_design_is_refused_and_the_new_one_survives_its_search() -> None:
    held = HeldTorque(1.001 * KAPPA, 12.0, 1.0)
    with pytest.raises(Infeasible, match="held torques of arm"):
        certificate(STIFFEST, 0.1, held)
    new, former = certificate(STIFFEST, 0.3, held), certificate(STIFFEST, 0.3, None)
    rng = np.random.default_rng(4)
    assert searched(new, ARM, NYQUIST, rng)[0] <= 1.0
    assert searched(stiffened(new, 1.5), ARM, NYQUIST, rng)[0] > 1.0
    assert searched(stiffened(new, stiffness(former) / stiffness(new)), ARM, NYQUIST, rng)[0] > 1.0


@pytest.mark.parametrize("part", [0.25, 1.0])
def test_with_a_delay_too(part: float) -> None:
    held = HeldTorque(1.001 * KAPPA, 12.0, 1.0)
    data = certificate(STIFFEST, 2.0, held, part * T)
    rng = np.random.default_rng(5)
    timing = Timing(4, (round(4 * part),) * 6, (0,) * 6)
    assert searched(data, ARM, timing, rng)[0] <= 1.0
    assert searched(stiffened(data, 4.0), ARM, timing, rng)[0] > 1.0


def test_half_of_kappa_and_a_pose_from_before_the_sample_are_found() -> None:
    rng = np.random.default_rng(6)
    half = certificate(STIFFEST, 0.3, HeldTorque(0.5 * KAPPA, 12.0, 1.0))
    assert searched(half, ARM, NYQUIST, rng)[0] > 1.0
    whole = certificate(STIFFEST, 0.3, HeldTorque(1.001 * KAPPA, 12.0, 1.0))
    assert searched(whole, ARM, Timing(1, (0,) * 12, (-1,) * 12), rng)[0] > 1.0  # a tick old


def test_a_cycle_counts_what_torques_do_exactly() -> None:
    # a constant force along a straight way, to and fro: f.dx vanishes, what is left is the leak, to second order
    data = certificate(STIFFEST, 0.3, HeldTorque(1.001 * KAPPA, 12.0, 1.0))
    cycle = Cycle(data, ARM, np.array([0.0, 2.0]), NYQUIST)
    cycle.responses = [np.zeros((2, 2), complex)] * 2
    assert float(cycle.ratio(1e-4 * np.array([[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0], [0.0, 0.0]]))) == 0.0
