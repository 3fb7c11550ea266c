"""What the service says, as data: readings, versions, what makes a device useless, and what it does by itself."""

from __future__ import annotations

import copy
import math
import re
from typing import Any

import pytest

from manyhands.devices.haply import HaplyError
from manyhands.devices.haply.service import decoded, devices, grip_in, left_on, reading, unusable, version_of

from ...fakes.haply_service import DEFAULTS, Service

DEVICE: dict[str, Any] = Service(DEFAULTS).inventory(7, True)["inverse3"][0]


def changed(*path: str, to: Any) -> dict[str, Any]:
    """The fake's device with another value at this path; None leaves it out."""
    device = copy.deepcopy(DEVICE)
    part = device
    for key in path[:-1]:
        part = part[key]
    if to is None:
        del part[path[-1]]
    else:
        part[path[-1]] = to
    return device


@pytest.mark.parametrize(
    ("told", "version"),
    [
        ({"project_version": "3.5.0.0", "git_tag": "3.4.0"}, (3, 5)),
        ({"git_tag": "3.4.2"}, (3, 4)),
        ({"project_version": "4.10.1"}, (4, 10)),
        ("v3.2", (3, 2)),
    ],
)
def test_versions(told: Any, version: tuple[int, int]) -> None:
    assert version_of(told) == version


@pytest.mark.parametrize("told", [{"project_version": "3.0.7.0"}, {}, "nothing", None])
def test_a_service_that_is_too_old_is_refused(told: Any) -> None:
    with pytest.raises(HaplyError, match=r"/version: found .*; expected a service of at least 3\.1"):
        version_of(told)


def test_angles_are_in_degrees_on_the_wire() -> None:
    found = reading(changed("state", "angular_position", to={"a0": 180.0, "a1": -90.0, "a2": 0.0}))
    assert found is not None
    assert found.angles == pytest.approx((math.pi, -math.pi / 2.0, 0.0))


@pytest.mark.parametrize("to", [None, {"x": 0.1, "y": 0.2}, {"x": 0.1, "y": "a", "z": 0.0}, 5, {"x": float("nan")}])
def test_a_state_without_a_position_is_none(to: Any) -> None:
    assert reading(changed("state", "cursor_position", to=to)) is None


def test_what_is_left_out_is_unknown_and_no_zero() -> None:
    for key, attribute in (
        ("current_cursor_force", "force"),
        ("angular_position", "angles"),
        ("current_angular_torques", "torques"),
    ):
        found = reading(changed("state", key, to=None))
        assert found is not None
        assert getattr(found, attribute) is None


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"inverse3": 3}', '{"inverse3": [3]}', "[[[["])
def test_frames_that_are_none_have_no_devices(text: str) -> None:
    assert devices(decoded(text)) == {}


@pytest.mark.parametrize(
    ("path", "to", "said"),
    [
        (("status", "power_supply"), False, "without power; .*: plug its power supply in"),
        (("status", "calibrated"), False, "not calibrated; .*calibrate it"),
        (("status", "ready"), False, "not ready; .*emergency brake"),
        (("state", "cursor_position"), {"x": 78.4, "y": -148.3, "z": 142.9}, "a position of -148.3 m; .*another unit"),
        (("state", "transform"), {"scale": {"x": 2.0, "y": 1.0, "z": 1.0}}, "scaled by"),
    ],
)
def test_a_device_that_is_of_no_use_is_named(path: tuple[str, ...], to: Any, said: str) -> None:
    found = reading(changed(*path, to=to))
    assert found is not None
    assert re.match(f"device 049D: found .*{said}", unusable(found, "device 049D"))


def test_a_device_that_is_of_use() -> None:
    for device in (DEVICE, changed("status", to=None), changed("state", "transform", to=None)):
        found = reading(device)
        assert found is not None
        assert unusable(found, "device 049D") == ""


def test_what_is_on_is_said_with_how_it_stands() -> None:
    assert left_on(DEVICE["config"]) == {
        "gravity_compensation": "enabled is True",
        "torque_scaling": "enabled is True",
        "force_gate": "gain is 0.3",
    }
    assert set(left_on(None).values()) == {"its service does not tell"}
    off: dict[str, Any] = {
        "gravity_compensation": {"enabled": False},
        "torque_scaling": {"enabled": False},
        "filters": {"force_gate": {"gain": 0}, "damping": {"scalar": 0.0}},
    }
    assert left_on(off) == {}
    off["filters"]["damping"] = {"scalar": 0.0, "vector": {"x": 0.0, "y": 1.0, "z": 0.0}}
    assert left_on(off) == {"damping": "vector is (0.0, 1.0, 0.0)"}


@pytest.mark.parametrize(
    ("frame", "held"),
    [
        ({"wireless_verse_grip": [{"state": {"buttons": {"a": True, "b": False, "c": True}}}]}, 0b101),
        ({"verse_grip": [{"state": {"button": True}}]}, 1),
        ({"wireless_verse_grip": [], "verse_grip": [{"state": {"button": False}}]}, 0),
        ({"wireless_verse_grip": [{"state": {"buttons": {"a": 1, "b": "true", "z": True}}}]}, 0),
        ({"wireless_verse_grip": [None, {"state": 3}, {"state": {"buttons": [True]}}]}, 0),
        ({"wireless_verse_grip": {"a": True}}, 0),
        (None, 0),
        ([], 0),
    ],
)
def test_buttons_are_held_down_where_a_frame_says_so_and_nowhere_else(frame: Any, held: int) -> None:
    found = grip_in(frame)
    assert (0 if found is None else found.buttons) == held


HALF = {"w": 0.6, "x": 0.0, "y": 0.8, "z": 0.0}


@pytest.mark.parametrize(
    ("told", "found"),
    [
        (HALF, (0.6, 0.0, 0.8, 0.0)),
        ({**HALF, "w": -0.6}, (-0.6, 0.0, 0.8, 0.0)),
        ({**HALF, "w": 0.6004}, (0.6004, 0.0, 0.8, 0.0)),
        ({**HALF, "w": 0.61}, None),
        ({**HALF, "w": float("nan")}, None),
        ({**HALF, "w": "upright"}, None),
        ({"x": 0.0, "y": 0.0, "z": 1.0}, None),
        ([1.0, 0.0, 0.0, 0.0], None),
        (None, None),
    ],
)
def test_an_orientation_is_a_unit_quaternion_or_none(told: Any, found: Any) -> None:
    grip = grip_in({"verse_grip": [{"device_id": "7", "state": {"orientation": told}}]})
    assert grip is not None
    assert grip.orientation == found


def test_of_several_grips_the_wanted_one_counts() -> None:
    frame = {
        "wireless_verse_grip": [{"device_id": "7", "state": {"buttons": {"a": True}}}],
        "verse_grip": [{"device_id": 8, "state": {"orientation": HALF}}],
    }
    seven, eight, nine = (grip_in(frame, wanted) for wanted in ("7", "8", "9"))
    assert seven == grip_in(frame)
    assert seven is not None
    assert eight is not None
    assert (seven.buttons, seven.orientation) == (1, None)
    assert (eight.buttons, eight.orientation) == (0, (0.6, 0.0, 0.8, 0.0))
    assert nine is None
