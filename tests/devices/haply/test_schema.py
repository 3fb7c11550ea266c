"""The fake and the driver speak as the maker writes: each name with the place where it stands.

Sources: the maker's pages of service 3.5 under docs.haply.co/inverseSDK/service; a frame of a real service of 3.1 to
3.4 in a comment of InfinyTech3D/SofaHaplyRobotics (``HapticsHandling`` of the class ``Haply_Inverse3Controller``); the
maker's crate ``haply`` 1.3.1 (docs.rs), of which the list of types and ``examples/damping_demo.rs`` could be read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from manyhands.devices.haply import service

from ...fakes.haply_service import DEFAULTS, Service

WEBSOCKET = "realtime/websocket-protocol, step 1"
RECORDED = "recorded frame of 3.x"
CONFIG = "session-configuration/device-config"
COMMANDS = "realtime/control-commands"
HTTP = "api/http"
EVENTS = "events"
CRATE = "crate haply 1.3.1"

FIRST_FRAME = {
    "session_id": WEBSOCKET,
    "inverse3.0.device_id": WEBSOCKET,
    "inverse3.0.config.type": WEBSOCKET,
    "inverse3.0.config.device_info.major_version": WEBSOCKET,
    "inverse3.0.config.gravity_compensation.enabled": WEBSOCKET,
    "inverse3.0.config.gravity_compensation.scaling_factor": WEBSOCKET,
    "inverse3.0.config.torque_scaling.enabled": WEBSOCKET,
    "inverse3.0.config.handedness": WEBSOCKET,
    "inverse3.0.config.preset": WEBSOCKET,
    "inverse3.0.config.basis.permutation": WEBSOCKET,
    "inverse3.0.config.mount.scale.x": WEBSOCKET,
    "inverse3.0.config.filters.force_gate.gain": WEBSOCKET,
    "inverse3.0.config.filters.damping.scalar": f"{WEBSOCKET}; {CRATE}: DampingConfig.scalar",
    "inverse3.0.state.cursor_position.x": RECORDED,
    "inverse3.0.state.cursor_velocity.x": RECORDED,
    "inverse3.0.state.angular_position.a0": RECORDED,
    "inverse3.0.state.angular_velocity.a0": RECORDED,
    "inverse3.0.state.body_orientation.w": RECORDED,
    "inverse3.0.state.current_cursor_force.x": RECORDED,
    "inverse3.0.state.current_cursor_position.x": RECORDED,
    "inverse3.0.state.current_angular_torques.a0": RECORDED,
    "inverse3.0.state.current_angular_position.a0": RECORDED,
    "inverse3.0.state.control_domain": RECORDED,
    "inverse3.0.state.control_mode": RECORDED,
    "inverse3.0.state.mode": RECORDED,
    "inverse3.0.state.transform.scale.x": RECORDED,
    "inverse3.0.status.calibrated": RECORDED,
    "inverse3.0.status.in_use": RECORDED,
    "inverse3.0.status.power_supply": RECORDED,
    "inverse3.0.status.ready": RECORDED,
    "inverse3.0.status.started": RECORDED,
}

SAID = {
    "session.configure.profile.name": f"{WEBSOCKET}; tutorials/01-print-inverse3",
    "session.configure.basis.permutation": CONFIG,
    "inverse3.0.device_id": COMMANDS,
    "inverse3.0.configure.force_gate.gain": CONFIG,
    "inverse3.0.configure.damping.scalar": f"{CONFIG}; {CRATE}: DampingConfig.scalar",
    "inverse3.0.commands.set_cursor_force.vector.x": f"{COMMANDS}; {CRATE}: SetCursorForceCmd",
    "inverse3.0.commands.set_cursor_force.vector.y": COMMANDS,
    "inverse3.0.commands.set_cursor_force.vector.z": COMMANDS,
}


def paths(value: Any, before: str = "") -> Iterator[str]:
    """The path to every leaf."""
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    if not children:
        yield before[:-1]
    for key, child in children:
        yield from paths(child, f"{before}{key}.")


def family(path: str) -> str:
    """A path without its last part, where that is a coordinate: x stands for y and z."""
    head, _, last = path.rpartition(".")
    return head if last in ("x", "y", "z", "w", "a0", "a1", "a2") else path


@pytest.fixture
def fake() -> Service:
    return Service(DEFAULTS)


def test_the_first_frame_has_every_name_of_the_maker(fake: Service) -> None:
    assert set(FIRST_FRAME) <= set(paths(fake.inventory(7, True)))


def test_the_first_frame_has_no_state_or_status_of_its_own(fake: Service) -> None:
    """What the driver may rest on has a source."""
    invented = {family(path) for path in paths(fake.inventory(7, True))} - {family(path) for path in FIRST_FRAME}
    assert [path for path in invented if ".config." not in path] == ["inverse3.0.state.transform.position"]


GRIP = {
    "device_id": "tutorials/02-print-versegrip",
    "state.orientation": "tutorials/02-print-versegrip: a quaternion (w, x, y, z)",
    "state.buttons.a": "tutorials/06-combined",
    "state.buttons.b": "tutorials/06-combined",
    "state.buttons.c": "isaac-sim/IsaacLab, se3_haply.py",
    "state.hall": "tutorials/02-print-versegrip",
}


def test_a_grip_has_the_names_of_the_maker() -> None:
    frame = Service(DEFAULTS | {"pressed": "a", "turned": [1.0, 0.0, 0.0, 0.0]}).inventory(7, False)
    (grip,) = frame[service.GRIPS[0]]
    assert {family(path) for path in paths(grip)} == set(GRIP)
    assert set(grip["state"]["orientation"]) == set(service.QUATERNION)


def test_later_frames_have_no_config(fake: Service) -> None:
    answer = fake.hear(service.Speech("049D", (3, 5)).force((0.0, 0.0, 0.0)), 7)
    assert "config" not in answer["inverse3"][0]
    answer = fake.hear(service.Speech("049D", (3, 5)).all(), 7)
    assert "config" in answer["inverse3"][0]


def test_the_driver_says_these_names_alone() -> None:
    speech = service.Speech("049D", (3, 5))
    assert set(paths(json.loads(speech.hello("org.manyhands:hand")))) == set(SAID)
    assert set(paths(json.loads(speech.force((1.0, 2.0, 3.0))))) == {path for path in SAID if "configure" not in path}
    assert "session.force_render_full_state" in set(paths(json.loads(speech.all())))  # crate: ForceRenderFullStateMsg


@pytest.mark.parametrize(("version", "dialect"), [((3, 4), "values"), ((3, 5), "vector"), ((4, 0), "vector")])
def test_the_dialect_is_that_of_the_version(version: tuple[int, int], dialect: str) -> None:
    said = json.loads(service.Speech("049D", version).force((1.0, -0.5, 1e-7)))
    assert said["inverse3"][0]["commands"] == {"set_cursor_force": {dialect: {"x": 1.0, "y": -0.5, "z": 1e-7}}}


def test_http_is_asked_as_the_maker_writes(fake: Service) -> None:
    """api/http: the envelope, GET /version and /devices; migrations/3.5-migration: both routes of a switch."""
    version = fake.asked("GET", "/version", {})[1]
    assert {"git_tag", "project_version"} <= set(version)
    assert "inverse3" in fake.asked("GET", "/devices", {})[1]
    new, old = (service.switch("torque_scaling", False, "049D", version) for version in ((3, 5), (3, 4)))
    assert new == ("/inverse3/049D/config/torque_scaling", {"enabled": False})
    assert old == ("/torque_scaling", {"device_id": "049D", "enable": False})
    for path, body in (new, old):
        fake.devices["049D"].enabled["torque_scaling"] = True
        assert fake.asked("POST", path, body) == ("200 OK", {"ok": True, "data": {"enabled": False}})
        assert fake.devices["049D"].enabled["torque_scaling"] is False
