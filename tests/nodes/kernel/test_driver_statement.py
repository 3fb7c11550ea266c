"""What is believed of a driver of another package: all that its session states of the device, in one sentence."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from manyhands.design.problem import MECHANISM
from manyhands.launch.session.device import Device
from manyhands.nodes.kernel.driver_statement import JOINED, DriverWord

PAGE = Path(__file__).parents[3] / "docs" / "drivers.md"
FACTORY = "tests.support.plugin_drivers:Counterpart"
DEVICE = {"dof": 2, "osp": 0.5, "driver": FACTORY, "sample_age": 0.0002, "actuation_delay": 0.0001}
OF_MECHANISM: dict[str, tuple[dict[str, object], tuple[str, ...]]] = {
    "held": (
        {"held": "torque", "linkage": {"kappa": 8.2}},
        ("that its motors hold joint torques of the stated linkage", "the work of these motors"),
    ),
    "step": ({"step": [0.00001, 0.00002]}, ("the step of its encoder (at most 20 µm)",)),
    "friction": ({"friction": {"least": [0.05, 0.1]}}, ("its dry friction (at least 50 mN)",)),
}


def word(**stated: object) -> DriverWord:
    found = Device.model_validate(DEVICE | stated).word
    assert found is not None
    return found


def test_the_sentence_of_a_driver_of_which_nothing_else_is_stated() -> None:
    assert word().sentence("d", measured=False) == (
        f"d rests on the word of its driver {FACTORY}: its displacements, the age of its samples (at most 0.2 ms), "
        "the delay of its forces (at most 0.1 ms) and their end, its damping (osp), that it holds the force at the tip "
        "from tick to tick, and that it exerts the force that it was given"
    )
    assert word().sentence("d", measured=True).endswith("tick to tick, and its own measurement of the force")


@pytest.mark.parametrize("key", MECHANISM)
def test_all_that_is_stated_of_its_mechanism_is_believed(key: str) -> None:
    """Whatever a certificate may count of a device: a new key of it needs words here."""
    stated, words = OF_MECHANISM[key]
    added = [one for one in word(**stated).believed(measured=False) if one not in word().believed(measured=False)]
    assert added == list(words)
    assert all(one in word(**stated).sentence("d", measured=True) for one in words)


def test_motors_that_hold_torques_hold_no_force() -> None:
    assert not any("holds the force" in one for one in word(**OF_MECHANISM["held"][0]).believed(measured=False))


def test_joints_that_hold_force_and_torque_together_tell_no_work() -> None:
    found = DriverWord(FACTORY, torques=True, turns=JOINED).believed(measured=False)
    assert not any("work" in one or "about axes at rest" in one or "at the tip" in one for one in found)
    assert "how these bend in all six directions" in found
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    assert all(one in text for one in found if "joints" in one or "bend" in one)


def test_a_step_of_nothing_is_none() -> None:
    assert word(step=0.0).believed(measured=False) == word().believed(measured=False)


def test_a_device_of_this_package_has_no_word() -> None:
    assert Device.model_validate({"dof": 1, "osp": 0.5, "driver": "simulated", "mass": 0.2}).word is None


def test_the_page_for_drivers_lists_the_same() -> None:
    """In the same words, without their numbers."""
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    whole = word(**{key: value for stated, _ in OF_MECHANISM.values() for key, value in stated.items()})
    believed = {*whole.believed(measured=True), *word().believed(measured=False)}
    said = [re.sub(r" \(at (most|least) [^)]*\)", "", one) for one in believed]
    assert len(said) == 11
    assert [one for one in said if one not in text] == []
