"""The prover takes what held torques may give out from a device's level, whatever the file says of it."""

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from manyhands.design.certificate import content, from_content, identity
from manyhands.design.errors import CertificateError, Infeasible
from manyhands.design.ladder import automatic_delays, design_ladder
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.coupling import Partition
from manyhands.design.models.linkage import greatest_bending, linkage_of
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperWanted, Wish
from manyhands.design.proof import ProofInputError, contract, prove
from manyhands.design.proof.claim import read
from manyhands.design.proof.finding import Verdict
from manyhands.design.proof.ladder import prove_ladder
from manyhands.design.proof.linkage import MOST_PARTS
from manyhands.design.synthesis import design

Data = dict[str, Any]

HELD = HeldTorque(18.8, 12.0, 1.0)
STIFFEST = SpringDamperWanted(Wish("stiffest"))


@pytest.fixture(scope="module")
def loop(problems) -> HapticLoop:
    """Two axes of one device in a loop of three, its torques held; the third port is a device that holds forces."""
    devices = (DeviceLevel("arm", (0, 1), 0.5 * np.eye(2), HELD), DeviceLevel("dz", (2,), np.eye(1)))
    own = dataclasses.replace(problems.example_1(), devices=devices, tau=1e-4)
    return dataclasses.replace(own, partition=Partition(("c", "cz"), ((0, 1), (2,))))


@pytest.fixture(scope="module")
def proved(loop: HapticLoop) -> Data:
    certificate = design(loop, STIFFEST).certificate
    return content(certificate) | {"id": certificate.id}


def resealed(data: Data, change: Callable[[Data], None]) -> Data:
    out = copy.deepcopy(data)
    change(out)
    out["margins"] = {}
    return out | {"id": identity(out)}


def failed(data: Data) -> list[str]:
    return [finding.condition for finding in prove(data) if not finding.holds]


def held_of(data: Data) -> Data:
    found: Data = data["devices"]["arm"]["held"]
    return found


def test_the_certificate_is_of_version_6_and_comes_back(proved: Data, loop: HapticLoop) -> None:
    assert proved["version"] == 6
    assert failed(proved) == []
    assert from_content(proved).loop.devices[0].held == HELD
    least = float(np.array(proved["levels"]["Delta_D"]["c"])[0, 0])
    assert least == pytest.approx(0.5 - HELD.damping(1e-3, 1e-4, 0.0), rel=1e-9)
    assert proved["levels"]["Delta_D"]["cz"] == [[1.0]]


@pytest.mark.parametrize("key", ["kappa", "force", "speed"])
def test_more_of_anything_needs_more_damping(proved: Data, key: str) -> None:
    # by one part in a thousand: design leaves nothing over but for rounding
    changed = resealed(proved, lambda data: held_of(data).update({key: 1.01 * held_of(data)[key]}))
    assert failed(changed) == ["Delta_D <= the devices' levels"]
    less = resealed(proved, lambda data: held_of(data).update({key: 0.99 * held_of(data)[key]}))
    assert failed(less) == []


def test_a_device_that_is_said_to_hold_forces_may_promise_more(proved: Data) -> None:
    def forget(data: Data) -> None:
        del data["devices"]["arm"]["held"]
        data["version"] = 3

    assert failed(resealed(proved, forget)) == []  # the claim is then about another device


def test_torques_that_turn_too_far_are_no_promise(proved: Data) -> None:
    changed = resealed(proved, lambda data: held_of(data).update({"speed": 2.001 / (18.8 * 1.1e-3)}))
    assert failed(changed) == ["arm holds torques: kappa, F and v > 0, kappa v (lambda T + tau) < 2"]
    negative = resealed(proved, lambda data: held_of(data).update({"force": -12.0}))
    assert failed(negative) == ["arm holds torques: kappa, F and v > 0, kappa v (lambda T + tau) < 2"]


@pytest.mark.parametrize(
    ("change", "named"),
    [(lambda data: data.update(version=3), "held"),
     (lambda data: data["devices"]["arm"].pop("held"), "version"),
     (lambda data: held_of(data).pop("kappa"), "kappa"),
     (lambda data: held_of(data).update(mass=1.0), "mass"),
     (lambda data: held_of(data).update(force=[12.0]), "force")],
)  # fmt: skip
def test_what_is_no_such_file_is_refused_by_name(proved: Data, change: Callable[[Data], None], named: str) -> None:
    data = resealed(proved, change)
    with pytest.raises(ProofInputError, match=named):
        prove(data)
    with pytest.raises((CertificateError, KeyError, TypeError, ValueError)):
        from_content(data)


ARM = {"kind": "chain", "turns": ["z", "z"], "links": [[0.12, 0.0, 0.0], [0.14, 0.0, 0.0]],
       "low": [-0.6, 1.4], "high": [0.6, 1.8]}  # fmt: skip
BENDS = greatest_bending(linkage_of(ARM))


@pytest.fixture(scope="module")
def stated(loop: HapticLoop) -> Data:
    """The same with kinematics in place of kappa alone."""
    held = HeldTorque(1.05 * BENDS, 12.0, 1.0, ARM)
    devices = (dataclasses.replace(loop.devices[0], held=held), loop.devices[1])
    certificate = design(dataclasses.replace(loop, devices=devices), STIFFEST).certificate
    return content(certificate) | {"id": certificate.id}


def test_kinematics_prove_their_kappa(stated: Data) -> None:
    [bends] = [finding for finding in prove(stated) if "bends" in finding.condition]
    assert bends.condition == f"the tip of arm bends by at most {held_of(stated)['kappa']:g}/m"
    assert bends.holds
    assert 0.99 * BENDS < bends.value <= 1.001 * BENDS
    assert from_content(stated).loop.devices[0].held == HeldTorque(1.05 * BENDS, 12.0, 1.0, ARM)


def test_a_kappa_that_is_too_small_or_of_another_arm_is_not_proved(stated: Data) -> None:
    smaller = resealed(stated, lambda data: held_of(data).update(kappa=0.99 * BENDS))
    assert failed(smaller) == [f"the tip of arm bends by at most {0.99 * BENDS:g}/m"]
    shorter = resealed(stated, lambda data: held_of(data)["linkage"]["links"].__setitem__(1, [0.1, 0.0, 0.0]))
    assert [condition.split(" bends")[0] for condition in failed(shorter)] == ["the tip of arm"]


def test_kinematics_have_the_axes_of_their_device(stated: Data) -> None:
    def moved(data: Data) -> None:
        data["devices"]["dz"]["held"] = data["devices"]["arm"].pop("held")

    with pytest.raises(ProofInputError, match="linkage"):
        prove(resealed(stated, moved))


def test_all_kinematics_of_a_file_share_one_bound_of_work(stated: Data, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def bends(linkage: object, kappa: object, most_parts: int) -> Verdict:
        asked.append(most_parts)
        return Verdict(True, 0.0, "")

    monkeypatch.setattr("manyhands.design.proof.contract.bends_at_most", bends)
    claim = read(stated)
    [held, *_] = claim.held
    assert held is not None
    other = dataclasses.replace(held, stated="another arm")
    contract.held_findings(dataclasses.replace(claim, devices=claim.devices * 2, held=(held, held, other, None)))
    assert asked == [MOST_PARTS // 2] * 2


def test_nothing_is_left_of_a_light_device(loop: HapticLoop) -> None:
    light = dataclasses.replace(loop.devices[0], level=0.1 * np.eye(2))
    with pytest.raises(Infeasible, match="held torques of arm") as error:
        design(dataclasses.replace(loop, devices=(light, loop.devices[1])), STIFFEST)
    enough = float(str(error.value).split("may give out what ")[1].split()[0])
    heavier = dataclasses.replace(light, level=1.01 * enough * np.eye(2))
    assert design(dataclasses.replace(loop, devices=(heavier, loop.devices[1])), STIFFEST).certificate


def test_rungs_have_less_left_and_are_mixed_where_no_device_is_in_two_blocks(loop: HapticLoop) -> None:
    first = design(loop, STIFFEST).certificate
    found = design_ladder(first, STIFFEST, automatic_delays(loop)).ladder
    assert found is not None
    assert found.independent
    levels = [float(rung.levels.Delta_D[0][0, 0]) for rung in found.rungs]
    assert len(levels) >= 2
    assert levels == sorted(levels, reverse=True)
    assert levels[0] > levels[-1]


def test_rungs_of_a_device_in_two_blocks_change_together(loop: HapticLoop) -> None:
    split = dataclasses.replace(loop, partition=Partition(("cx", "c"), ((0,), (1, 2))))
    first = design(split, STIFFEST).certificate
    found = design_ladder(first, STIFFEST, automatic_delays(split)).ladder
    assert found is not None
    assert not found.independent
    data = [content(rung) | {"id": rung.id} for rung in found.rungs]
    proof = prove_ladder(data, 0)
    assert proof.together.holds
    assert not proof.independent.holds
    assert "different Delta_D" in proof.independent.argument
