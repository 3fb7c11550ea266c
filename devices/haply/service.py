"""What the service and its clients say to each other, as data: commands out, readings in. No sockets, no clocks.

By the maker's pages of service 3.5 (docs.haply.co/inverseSDK/service: *WebSocket Protocol*, *Control Commands*,
*Device Configuration*, *HTTP*, *Events & Monitoring*), and frames of 3.1 to 3.4 as others have recorded them.

The service sends the first frame by itself, with the ``config`` of each device. Then it sends one frame for each
message that it receives, and in their order. So the n-th frame after the first answers the n-th message.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from manyhands.nodes.device.plugin import OFF_UNIT

AXES: Final = ("x", "y", "z")
JOINTS: Final = ("a0", "a1", "a2")
FAMILY: Final = "inverse3"

SINCE_VECTOR: Final = (3, 5)
"""The version since which ``set_cursor_force`` has a ``vector``; up to 3.4 it has ``values``."""

OLDEST: Final = (3, 1)
"""The oldest version with this format."""

REACH: Final = 0.6
"""m from the mounting plate, along any axis; a position in mm or cm is beyond.

InfinyTech3D/SofaHaplyRobotics (``Haply_Inverse3Controller::init``) has seen up to 0.38 m.
"""

Vector = tuple[float, float, float]
ZERO: Final[Vector] = (0.0, 0.0, 0.0)


class HaplyError(RuntimeError):
    """The service or its device does not answer, or is of no use; the message names it and says what to do."""


@dataclass(frozen=True)
class Reading:
    """What a frame says of one device.

    Attributes:
        position: of the cursor, m, in the session's basis.
        force: that the service reports for its cursor, N; None where it does not.
        angles: of the joints, rad; None where the frame has none.
        torques: of the joints, N·m; None where the frame has none.
        idle: whether the device takes no command.
        scale: of the transform from the device to the cursor; 1 for metres.
        status: by name.
    """

    position: Vector
    force: Vector | None
    angles: Vector | None
    torques: Vector | None
    idle: bool
    scale: Vector
    status: Mapping[str, bool]


def version_of(told: Any) -> tuple[int, int]:
    """Major and minor number of the answer to GET /version.

    Raises:
        HaplyError: it has none, or one that is older than :data:`OLDEST`.
    """
    text = str(told.get("project_version") or told.get("git_tag")) if isinstance(told, Mapping) else str(told)
    found = re.search(r"(\d+)\.(\d+)", text)
    version = (int(found[1]), int(found[2])) if found else (0, 0)
    if version < OLDEST:
        raise HaplyError(
            f"/version: found {text:.60}; expected a service of at least {OLDEST[0]}.{OLDEST[1]}: update the Haply Hub"
        )
    return version


class Speech:
    """The messages of a client to one device."""

    def __init__(self, device_id: str, version: tuple[int, int]) -> None:
        """Of the device ``device_id``, to a service of this version."""
        self._id = json.dumps(device_id)
        self._key = "vector" if version >= SINCE_VECTOR else "values"

    def force(self, f: Sequence[float]) -> str:
        """Exert f, N."""
        return f'{{"inverse3":[{{"device_id":{self._id},{self._commands(f)}}}]}}'

    def hello(self, name: str) -> str:
        """The first message: who this is, the plain basis, and no gate nor damping on this session's forces."""
        session = {"configure": {"profile": {"name": name}, "basis": {"permutation": "XYZ"}}}
        filters = {"force_gate": {"gain": 0.0}, "damping": {"scalar": 0.0}}
        return (
            f'{{"session":{json.dumps(session)},"inverse3":[{{"device_id":{self._id},'
            f'"configure":{json.dumps(filters)},{self._commands(ZERO)}}}]}}'
        )

    def all(self) -> str:
        """Exert no force, and ask for a frame with the config."""
        return (
            '{"session":{"force_render_full_state":{}},"inverse3":[{"device_id":'
            f"{self._id},{self._commands(ZERO)}}}]}}"
        )

    def _commands(self, f: Sequence[float]) -> str:
        x, y, z = f
        return f'"commands":{{"set_cursor_force":{{"{self._key}":{{"x":{x!r},"y":{y!r},"z":{z!r}}}}}}}'


def devices(frame: Any) -> dict[str, dict[str, Any]]:
    """The devices of a frame, by their id."""
    found = frame.get(FAMILY) if isinstance(frame, dict) else None
    listed = found if isinstance(found, list) else []
    return {str(one.get("device_id")): one for one in listed if isinstance(one, dict)}


BUTTONS: Final = ("a", "b", "c")
"""The buttons of a VerseGrip; one with a cable has the first alone."""

GRIPS: Final = ("wireless_verse_grip", "verse_grip")


QUATERNION: Final = ("w", "x", "y", "z")


@dataclass(frozen=True)
class Grip:
    """What a frame says of a VerseGrip.

    Attributes:
        buttons: those that are held down, bit by bit in the order of :data:`BUTTONS`.
        orientation: (w, x, y, z), the rotation from the grip's axes to those of positions (x to the right, y forward, z
            up); None where the frame has no unit quaternion.
    """

    buttons: int
    orientation: tuple[float, ...] | None


def grip_in(frame: Any, wanted: str = "") -> Grip | None:
    """The VerseGrip of a frame with the id ``wanted``, or the first one where that is empty; None without it."""
    for family in GRIPS:
        listed = frame.get(family) if isinstance(frame, dict) else None
        for grip in listed if isinstance(listed, list) else []:
            state = grip.get("state") if isinstance(grip, dict) else None
            if not isinstance(state, dict) or (wanted and str(grip.get("device_id")) != wanted):
                continue
            told = state.get("buttons")
            told = told if isinstance(told, dict) else {"a": state.get("button")}
            held = sum(1 << i for i, name in enumerate(BUTTONS) if told.get(name) is True)
            return Grip(held, _rotation(state.get("orientation")))
    return None


def _rotation(told: Any) -> tuple[float, ...] | None:
    try:
        q = tuple(float(told[name]) for name in QUATERNION)
    except (TypeError, KeyError, ValueError):
        return None
    return q if abs(math.hypot(*q) - 1.0) <= OFF_UNIT else None  # not for NaN


def decoded(text: str) -> Any:
    """A frame; None where it is no JSON."""
    try:
        return json.loads(text)
    except ValueError:
        return None


def reading(device: Mapping[str, Any]) -> Reading | None:
    """What a frame says of a device; None without a position."""
    state: Any = device.get("state")
    if not isinstance(state, dict):
        return None
    position = _numbers(state.get("cursor_position"), AXES)
    if position is None:
        return None
    degrees = _numbers(state.get("angular_position"), JOINTS)
    transform = state.get("transform")
    scale = _numbers(transform.get("scale"), AXES) if isinstance(transform, dict) else None  # 1 is left out
    status = device.get("status")
    return Reading(
        position=position,
        force=_numbers(state.get("current_cursor_force"), AXES),
        angles=None if degrees is None else (radians(degrees[0]), radians(degrees[1]), radians(degrees[2])),
        torques=_numbers(state.get("current_angular_torques"), JOINTS),
        idle=(state.get("control_mode") or state.get("mode")) == "idle",
        scale=scale or (1.0, 1.0, 1.0),
        status=status if isinstance(status, dict) else {},
    )


def radians(degrees: float) -> float:
    """An angle that is given in degrees."""
    return degrees * (math.pi / 180.0)


def _numbers(of: Any, names: Sequence[str]) -> Vector | None:
    try:
        a, b, c = (float(of[name]) for name in names)
    except (TypeError, KeyError, ValueError):
        return None
    return (a, b, c) if math.isfinite(a + b + c) else None


UNUSABLE: Final = (
    ("power_supply", False, "without power", "plug its power supply in"),
    ("calibrated", False, "not calibrated", "calibrate it, as its quick start shows"),
    ("ready", False, "not ready", "free its emergency brake, and see what its light and the Haply Hub say"),
)
"""By key of the status: what makes a device useless, and what to do about it."""


def unusable(found: Reading, name: str) -> str:
    """Why a device is of no use, and what to do; empty where it is of use."""
    for key, bad, what, do in UNUSABLE:
        if found.status.get(key) is bad:
            return f"{name}: found it {what}; expected it ready: {do}"
    if found.scale != (1.0, 1.0, 1.0):
        return f"{name}: found positions that are scaled by {found.scale}; expected a transform with the scale 1"
    if max(map(abs, found.position)) > REACH:
        far = max(found.position, key=abs)
        return (
            f"{name}: found a position of {far:g} m; expected at most {REACH:g} m, for no arm is longer: positions may "
            "be in another unit since an update, or a transform is set (see the Haply Hub)"
        )
    return ""


OFF: Final = {
    "gravity_compensation": "compensates gravity by forces of its own",
    "torque_scaling": "scales the torques of its joints",
    "force_gate": "lets a gate weaken forces that oscillate",
    "damping": "adds damping of its own",
}
"""What the device does inside the loop by itself, by the key of its config, and how that is said."""


def left_on(config: Any) -> dict[str, str]:
    """What of :data:`OFF` a config does not show to be off, by key: how it stands."""
    config = config if isinstance(config, dict) else {}
    filters = config.get("filters")
    filters = filters if isinstance(filters, dict) else {}
    gate, damping = filters.get("force_gate"), filters.get("damping")
    found = {
        "gravity_compensation": _off(config.get("gravity_compensation"), "enabled", False),
        "torque_scaling": _off(config.get("torque_scaling"), "enabled", False),
        "force_gate": _off(gate, "gain", 0.0),
        "damping": _off(damping, "scalar", 0.0) or (_vector(damping) if isinstance(damping, dict) else ""),
    }
    return {key: how for key, how in found.items() if how}


def _off(part: Any, key: str, off: bool | float) -> str:
    value = part.get(key) if isinstance(part, dict) else None
    if value is None:
        return "its service does not tell"
    return "" if value == off else f"{key} is {value!r:.20}"


def _vector(damping: Mapping[str, Any]) -> str:
    along = _numbers(damping.get("vector"), AXES)
    return f"vector is {along}" if along is not None and any(along) else ""


def switch(key: str, on: bool, device_id: str, version: tuple[int, int]) -> tuple[str, dict[str, Any]]:
    """Path and body of the POST that switches ``gravity_compensation`` or ``torque_scaling``, of all sessions."""
    if version >= SINCE_VECTOR:
        return f"/{FAMILY}/{device_id}/config/{key}", {"enabled": on}
    return f"/{key}", {"device_id": device_id, "enable": on}
