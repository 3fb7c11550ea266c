"""Writes a recording as a bag of ROS 2: motions and forces of each device, under the names of CRTK ([CRTK2023]_).

The topics and their messages (:func:`device_topics`, :func:`serialiser`) are also those of a running session, which
:mod:`manyhands.launch.bridges.ros` publishes. Each device has the namespace ``/SESSION/DEVICE``, and in each tick up to
four messages, stamped with the tick's time:

- ``measured_cp`` (geometry_msgs/PoseStamped), of a device with three axes that translate: x, in the device's own frame,
  whose axes are those of the device in their order. The orientation is that of the device, where it is a port, in the
  world's axes; of any other it is that of the frame.
- ``measured_cv`` (geometry_msgs/TwistStamped), of such a device: its velocity (x(k) - x(k-1))/T, m/s, and where its
  orientation is a port the turn from tick to tick, likewise, rad/s. A device in wall time has the difference of the
  recorded instants in place of T. After a missing tick there is none.
- ``measured_js`` (sensor_msgs/JointState), of every other device: x, its velocity and the exerted force by axis, m, m/s
  and N; rad, rad/s and N·m of an axis that turns. A pose would state coordinates that such a device does not have.
- ``measured_cf`` (geometry_msgs/WrenchStamped): the force that the device exerted on the hand, N; the torque of an axis
  that turns, and of an orientation that is a port, N·m.
- ``servo_cf`` (geometry_msgs/WrenchStamped): the force that its couplings sent it, N. The device's limits, and what
  bounds the cost of lateness, stand between the two. No torque is sent: the device finds it itself.

A device of more than three axes has ``servo_jf`` (JointState, effort alone) in place of the last two. An axis that
turns beside others, as a jaw, has ``AXIS/measured_js`` and ``AXIS/servo_jf`` besides, as CRTK has the jaw of a gripper;
three axes that translate beside it have the topics of a device with these alone. The numbers are those of the
recording, exactly; velocities alone are computed from them. A tick that the recording misses has no message.
"""

from __future__ import annotations

import heapq
import os
import re
import secrets
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manyhands.extras import require
from manyhands.launch.recordings.formats import Progress
from manyhands.launch.recordings.recording import Array, RecordingError
from manyhands.launch.recordings.run import RecordedRun, Traces, chosen
from manyhands.nodes.recorder.format import CARTESIAN
from manyhands.protocol.channels import DISPLACEMENT, FORCE, ORIENTATION, TORQUE
from manyhands.protocol.messages import Role

ROSBAG: Final = "rosbag"
"""The name of the format, and the suffix of a bag's folder."""

POSE: Final = "geometry_msgs/msg/PoseStamped"
TWIST: Final = "geometry_msgs/msg/TwistStamped"
WRENCH: Final = "geometry_msgs/msg/WrenchStamped"
JOINTS: Final = "sensor_msgs/msg/JointState"

LATEST: Final = 2**31 * 10**9
"""The end of the times that a stamp of ROS 2 can have, ns since 1970: its seconds have 32 bits."""

_VERSION: Final = 9  # of the metadata of rosbag2: that of ROS 2 Jazzy and later
_REPORTED: Final = 4096  # messages between two reports of progress


@dataclass(frozen=True)
class RosTopic:
    """A topic of ROS 2.

    Attributes:
        name: its full name, such as ``/session/device/measured_cf``.
        type: of its messages.
        device: whose it is; also the name of the frame.
        axes: names of those of the device's axes that it is about.
        turning: those of them that turn.
        oriented: whether its messages hold an orientation, or what belongs to one, behind the numbers of the axes.
    """

    name: str
    type: str
    device: str
    axes: tuple[str, ...]
    turning: tuple[str, ...] = ()
    oriented: bool = False


class AxesTopics(NamedTuple):
    """The topics of a device, or of some of its axes.

    Attributes:
        places: where these axes are among the device's.
        motion: their position; a JointState has velocity and effort beside it.
        velocity: of three axes that translate.
        exerted: the force that they exerted; None beyond three axes, and where effort says it.
        sent: the force that the device's couplings sent them.
    """

    places: tuple[int, ...]
    motion: RosTopic
    velocity: RosTopic | None
    exerted: RosTopic | None
    sent: RosTopic

    def of(self, values: Array) -> Array:
        """The columns of these axes in a trace of the device."""
        return values[:, self.places]


def device_topics(
    session: str,
    devices: Mapping[str, tuple[str, ...]],
    turning: Collection[str] = (),
    hands: Collection[str] = (),
    sensed: Collection[str] = (),
) -> dict[str, tuple[AxesTopics, ...]]:
    """The topics of the devices of a session, by device: of all its axes, and then of some.

    Args:
        session: its name.
        devices: names of the axes of each device.
        turning: the axes that turn.
        hands: the devices whose orientation is a port.
        sensed: those of them on which no torque acts.

    Raises:
        RecordingError: two devices, or two axes of one, would have one namespace.
    """
    spaces: dict[str, str] = {}

    def space_of(what: str, name: str, space: str) -> str:
        if space in spaces:
            raise RecordingError(
                f"found the {what} {spaces[space]!r} and {name!r}, which ROS 2 would both call {space}; expected "
                "names that differ in more than '-' and '.'"
            )
        spaces[space] = name
        return space

    out = {}
    for device, axes in devices.items():
        space = space_of("devices", device, f"/{ros_name(session)}/{ros_name(device)}")
        turn = [place for place, axis in enumerate(axes) if axis in turning]
        straight = [place for place in range(len(axes)) if place not in turn]
        found = [
            _topics_of(space, device, axes, range(len(axes)), turn, oriented=device in hands, felt=device not in sensed)
        ]
        if turn and len(axes) > 1:
            found += [_topics_of(space, device, axes, straight)] if len(straight) == CARTESIAN else []
            for place in turn:
                own = axes[place].removeprefix(f"{device}.")
                within = space_of("axes", axes[place], f"{space}/{ros_name(own)}")
                found.append(_topics_of(within, device, axes, [place], turn, joint=True))
        out[device] = tuple(found)
    return out


def _topics_of(
    space: str,
    device: str,
    axes: tuple[str, ...],
    places: Sequence[int],
    turn: Sequence[int] = (),
    joint: bool = False,
    oriented: bool = False,
    felt: bool = True,
) -> AxesTopics:
    """The topics in a namespace of the axes at ``places``; ``joint`` where efforts say what they exert and are sent.

    ``oriented`` where the device has an orientation besides; it has the three coordinates of a pose then. ``felt``
    where a torque belongs to it.
    """
    point = len(places) == CARTESIAN and not turn
    wrench = len(places) <= CARTESIAN and not joint
    motion = ("measured_cp", POSE) if point else ("measured_js", JOINTS)
    sent = ("servo_cf", WRENCH) if wrench else ("servo_jf", JOINTS)
    own = tuple(axes[place] for place in places)
    turning = tuple(axes[place] for place in places if place in turn)

    def topic(name: str, kind: str, oriented: bool = False) -> RosTopic:
        return RosTopic(f"{space}/{name}", kind, device, own, turning, oriented)

    turns = oriented and point
    return AxesTopics(
        tuple(places),
        topic(*motion, turns),
        topic("measured_cv", TWIST, turns) if point else None,
        topic("measured_cf", WRENCH, turns and felt) if wrench else None,
        topic(*sent),
    )


def motion_rows(topic: RosTopic, x: Array, v: Array | None, f: Array | None) -> Array:
    """The rows of a device's motion: of a JointState with its velocities and the forces that it exerted, NaN for None.

    Each is ticks x axes, m, m/s and N. A pose with an orientation has that behind x already.
    """
    if topic.type == POSE:
        return x
    return np.hstack([x, *(np.full_like(x, np.nan) if known is None else known for known in (v, f))])


def whole_rows(topic: RosTopic, values: Array) -> NDArray[np.bool_]:
    """The rows that have a message: all finite; a velocity or an effort beside a position may be missing."""
    needed = len(topic.axes) if topic.type == JOINTS else values.shape[1]
    return np.asarray(np.isfinite(values[:, :needed]).all(axis=1), dtype=np.bool_)


def joined(values: Array | None, turn: Array | None) -> Array | None:
    """The rows of an oriented topic: what belongs to its orientation behind what belongs to its axes.

    None where one of them is not there; rows that one lacks have no message.
    """
    if values is None or turn is None:
        return None
    rows = min(len(values), len(turn))
    return np.hstack([values[:rows], turn[:rows]])


@dataclass(frozen=True, eq=False)
class Stream:
    """The messages of one topic of the bag.

    Attributes:
        topic: the topic.
        tick: the device's tick of the first row.
        tick_ns: its T, ns.
        values: ticks x columns: what its messages hold, m, m/s or N, and of an orientation 1, rad/s or N·m.
    """

    topic: RosTopic
    tick: int
    tick_ns: float
    values: Array


def streams_of(run: RecordedRun, traces: Traces) -> list[Stream]:
    """The topics of a bag of these traces that have a message.

    Raises:
        RecordingError: two devices would have one namespace, or no trace is a device's motion or force.
    """
    recorded, out = run.recorded, []
    topics = device_topics(recorded.session, recorded.devices, recorded.turning, recorded.hands, recorded.sensed)
    for device, parts in topics.items():
        whole = {name: _trace_of(traces, device, name) for name in (DISPLACEMENT, FORCE)}
        speed = None if whole[DISPLACEMENT] is None else run.velocity_of(device)
        commanded = _sent_to(run, traces, device)
        first, tick_ns = run.first_of(device), recorded.tick_ns(device)
        for part in parts:
            x, f, v, sent = (
                None if values is None else part.of(values)
                for values in (whole[DISPLACEMENT], whole[FORCE], speed, commanded)
            )
            if part.motion.oriented:
                R, torque = (_trace_of(traces, device, name) for name in (ORIENTATION, TORQUE))
                x = joined(x, R)
                f = joined(f, torque) if part.exerted is not None and part.exerted.oriented else f
                v = joined(v, None if R is None else run.angular_velocity_of(device))
            found = [
                (part.motion, None if x is None else motion_rows(part.motion, x, v, f)),
                (part.velocity, v),
                (part.exerted, f),
                (part.sent, sent),
            ]
            out += [
                Stream(topic, first, tick_ns, values)
                for topic, values in found
                if topic is not None and values is not None
            ]
    out = [stream for stream in out if whole_rows(stream.topic, stream.values).any()]
    if not out:
        raise RecordingError(
            "--topics: found no motion or force of a device; expected sample or force among the topics"
        )
    return out


def ros_name(name: str) -> str:
    """A name as ROS 2 allows it: ASCII letters, digits and single underscores, no digit first."""
    plain = re.sub("_+", "_", re.sub("[^A-Za-z0-9_]", "_", name))
    return f"_{plain}" if plain[:1].isdigit() else plain


def _trace_of(traces: Traces, node: str, name: str) -> Array | None:
    return next((kept.values for (of, _), kept in traces.items() if (of, kept.topic.trace) == (node, name)), None)


def _sent_to(run: RecordedRun, traces: Traces, device: str) -> Array | None:
    """The forces that the couplings of a device sent it, ticks x axes, N; None where one of them is not there."""
    columns: dict[str, Array] = {}
    for (node, _), kept in traces.items():
        if run.recorded.roles[node] is Role.COUPLING and kept.topic.trace == FORCE:
            columns |= dict(zip(kept.columns, kept.values.T, strict=True))
    ports = run.recorded.devices[device]
    if not columns.keys() >= {*ports}:
        return None
    rows = min(len(columns[port]) for port in ports)
    return np.stack([columns[port][:rows] for port in ports], axis=1)


Serialise = Callable[[int, Sequence[float]], bytes]
"""Makes a message of a time, ns since 1970, and a row."""


def messages_of(stream: Stream, started: int, serialise: Serialise) -> Iterator[tuple[int, bytes]]:
    """The messages of a stream with their times, ns since 1970; a row that was not recorded has none.

    Args:
        stream: the stream.
        started: the time of tick 0, ns since 1970.
        serialise: makes a message.
    """
    whole = np.flatnonzero(whole_rows(stream.topic, stream.values))
    times = (started + np.rint((stream.tick + whole) * stream.tick_ns).astype(np.int64)).tolist()
    for row, time in zip(whole.tolist(), times, strict=True):
        yield time, serialise(time, stream.values[row].tolist())


def ros_types() -> Any:
    """The message types of ROS 2, of rosbags: a type store.

    Raises:
        MissingExtra: rosbags is not installed.
    """
    require("ros")
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def serialiser(typestore: Any, topic: RosTopic) -> Serialise:
    """What makes the messages of a topic, as CDR with its encapsulation.

    Args:
        typestore: of :func:`ros_types`.
        topic: the topic.
    """
    types, name, width = typestore.types, topic.type, len(topic.axes)
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    vector, message = types["geometry_msgs/msg/Vector3"], types[name]
    point, pose = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Pose"]
    quaternion, wrench = types["geometry_msgs/msg/Quaternion"], types["geometry_msgs/msg/Wrench"]
    upright = quaternion(0.0, 0.0, 0.0, 1.0)
    twist = types["geometry_msgs/msg/Twist"]
    no_turn, none, axes = vector(0.0, 0.0, 0.0), np.empty(0), list(topic.axes)
    turns = [axis in topic.turning for axis in topic.axes]
    effort_alone = topic.name.endswith("servo_jf")

    def body(row: Sequence[float]) -> tuple[Any, ...]:
        if topic.oriented:
            return oriented(row[:width], row[width:])
        if name == POSE:
            return (pose(point(*row), upright),)
        if name == WRENCH:
            rest = (0.0,) * (CARTESIAN - width)
            if not any(turns):
                return (wrench(vector(*row, *rest), no_turn),)
            force = (0.0 if turn else f for f, turn in zip(row, turns, strict=True))
            torque = (f if turn else 0.0 for f, turn in zip(row, turns, strict=True))
            return (wrench(vector(*force, *rest), vector(*torque, *rest)),)
        if name == TWIST:
            return (twist(vector(*row), no_turn),)
        numbers = np.array(row)
        if effort_alone:
            return axes, none, none, numbers
        velocity, effort = (known if np.isfinite(known).all() else none for known in np.split(numbers[width:], 2))
        return axes, numbers[:width], velocity, effort

    def oriented(row: Sequence[float], turn: Sequence[float]) -> tuple[Any, ...]:
        if name == POSE:
            w, x, y, z = turn
            return (pose(point(*row), quaternion(x, y, z, w)),)
        return ((wrench if name == WRENCH else twist)(vector(*row), vector(*turn)),)

    def serialise(time: int, row: Sequence[float]) -> bytes:
        seconds, nanoseconds = divmod(time, 10**9)
        made = message(header(stamp(seconds, nanoseconds), topic.device), *body(row))
        return bytes(typestore.serialize_cdr(made, name))

    return serialise


def save_bag(run: RecordedRun, path: Path, patterns: Sequence[str] = (), progress: Progress | None = None) -> int:
    """Write a bag: a folder with an MCAP file and its metadata, whole or not at all.

    Args:
        run: the recording.
        path: the folder, which must not exist.
        patterns: the topics of the recording to write; see :func:`~manyhands.launch.recordings.run.chosen`.
        progress: called with the part that is done, 0 to 1.

    Returns:
        The number of messages.

    Raises:
        MissingExtra: rosbags is not installed.
        RecordingError: something of that name exists; a pattern names no topic, or no motion
            or force; or the bag cannot be written.
    """
    streams = streams_of(run, chosen(run, patterns))
    started = run.started or 0
    end = max(started + (one.tick + len(one.values)) * one.tick_ns for one in streams)
    if end >= LATEST:
        raise RecordingError(
            f"found a tick at {end / 1e9:.0f} s since 1970; expected times that ROS 2 can write, to 2038"
        )
    try:
        with _making(path) as folder:
            return _write(streams, started, folder, progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error


def _write(streams: Sequence[Stream], started: int, folder: Path, progress: Progress) -> int:
    typestore = ros_types()
    from rosbags.rosbag2 import StoragePlugin, Writer

    total, done = max(1, sum(len(stream.values) for stream in streams)), 0
    with Writer(folder, version=_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [writer.add_connection(one.topic.name, one.topic.type, typestore=typestore) for one in streams]
        by_stream = [
            zip(messages_of(one, started, serialiser(typestore, one.topic)), repeat(connection))
            for one, connection in zip(streams, connections, strict=True)
        ]
        for (time, data), connection in heapq.merge(*by_stream, key=lambda entry: entry[0][0]):
            writer.write(connection, time, data)
            done += 1
            if done % _REPORTED == 0:
                progress(done / total)
    progress(1.0)
    return done


@contextmanager
def _making(path: Path) -> Iterator[Path]:
    """A folder to make: at the end it is flushed to the disk and takes its name; on an error nothing is left.

    Yields:
        A path with the same last part, which does not exist yet, in a folder that nobody can guess.

    Raises:
        RecordingError: something of that name exists, or its parent does not.
    """
    if os.path.lexists(path):
        raise RecordingError(f"{path}: found something of that name; expected a new name, for a bag is a folder")
    if not path.absolute().parent.is_dir():
        raise RecordingError(f"{path}: found no folder {path.parent}; expected one that exists")
    partial = path.absolute().with_name(f".{secrets.token_hex(16)}.part")
    partial.mkdir(mode=0o700)
    try:
        yield partial / path.name
        for file in (partial / path.name).iterdir():
            with file.open("rb") as written:
                os.fsync(written.fileno())
        os.rename(partial / path.name, path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
