"""Nodes of ROS 2 without ROS: zenoh-ros2-sdk ([Wie2026]_), an implementation of rmw_zenoh's protocol by others.

Everything that could be wrong in the same way on both sides is theirs: keys, liveliness tokens, attachments, and the
hashes of types, which they compute from the definitions below.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zenoh
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, ZenohSession
from zenoh_ros2_sdk.utils import get_type_hash

POSE, WRENCH, JOINTS = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState"

DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/msg/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    POSE: "std_msgs/Header header\ngeometry_msgs/Pose pose",
    WRENCH: "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    JOINTS: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
}
"""The definitions of the messages in common_interfaces of ROS 2, without what no byte depends on."""


def hash_of(type_: str) -> str:
    """The hash of a type, as they compute it."""
    return get_type_hash(type_, DEFINITIONS[type_], DEFINITIONS)


def free_port() -> int:
    """A port of the loopback that was free a moment ago."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@contextmanager
def zenoh_session(mode: str, *, listen: int | None = None, connect: int | None = None) -> Iterator[Any]:
    """A session of Zenoh itself; its mode ``router`` stands for the daemon of ROS 2."""
    config = zenoh.Config()
    settings = {
        "mode": mode,
        "listen/endpoints": [] if listen is None else [f"tcp/127.0.0.1:{listen}"],
        "connect/endpoints": [] if connect is None else [f"tcp/127.0.0.1:{connect}"],
        "scouting/multicast/enabled": False,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


class RosNodes:
    """The nodes of one process that has joined ROS 2 by a router.

    Attributes:
        session: its session of Zenoh.
        received: the messages of each topic, in the order of their arrival.
    """

    def __init__(self, router_port: int) -> None:
        self._port = router_port
        self._shared = ZenohSession.get_instance("127.0.0.1", router_port)
        self.session = self._shared.session
        for type_, definition in DEFINITIONS.items():
            self._shared.register_message_type(definition, type_)
        self.received: dict[str, list[Any]] = {}
        self._open: list[Any] = []

    def subscribe(self, topic: str, type_: str) -> None:
        """Receive the messages of a topic."""
        got = self.received.setdefault(topic, [])
        self._open.append(ROS2Subscriber(topic, type_, got.append, DEFINITIONS[type_], type_hash=hash_of(type_)))

    def publisher(self, topic: str, type_: str) -> Any:
        """A publisher of a topic."""
        made = ROS2Publisher(topic, type_, DEFINITIONS[type_], type_hash=hash_of(type_))
        self._open.append(made)
        return made

    def pose(self, frame: str, *position: float) -> dict[str, Any]:
        """The fields of a pose."""
        types = self._shared.store.types
        stamp = types["builtin_interfaces/msg/Time"](1, 2)
        point, upright = types["geometry_msgs/msg/Point"](*position), types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
        return {
            "header": types["std_msgs/msg/Header"](stamp, frame),
            "pose": types["geometry_msgs/msg/Pose"](point, upright),
        }

    def close(self) -> None:
        """Leave ROS 2."""
        for one in self._open:
            one.close()
        self._shared.close()
