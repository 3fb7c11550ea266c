"""Writes a recording as a bag of ROS 2: motions and forces of each device, under the names of CRTK ([CRTK2023]_).

Each device has the namespace ``/SESSION/DEVICE``, and in each tick up to four messages, stamped with the tick's time:

- ``measured_cp`` (geometry_msgs/PoseStamped), of a device with three axes: x, in the device's own frame, whose axes are
  those of the device in their order. It has no orientation to report; the pose has that of the frame.
- ``measured_cv`` (geometry_msgs/TwistStamped), of such a device: its velocity (x(k) - x(k-1))/T, m/s. A device in wall
  time has the difference of the recorded instants in place of T. After a missing tick there is none.
- ``measured_js`` (sensor_msgs/JointState), of every other device: x, its velocity and the exerted force by axis, m, m/s
  and N. A pose would state coordinates that such a device does not have.
- ``measured_cf`` (geometry_msgs/WrenchStamped): the force that the device exerted on the hand, N.
- ``servo_cf`` (geometry_msgs/WrenchStamped): the force that its couplings sent it, N. The device's limits, and what
  bounds the cost of lateness, stand between the two.

A device of more than three axes has ``servo_jf`` (JointState, effort alone) in place of the last two. The numbers are
those of the recording, exactly; velocities alone are computed from them. A tick that the recording misses has no
message.
"""

from __future__ import annotations

import heapq
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.extras import require
from manyhands.launch.recordings.recording import Array, RecordingError
from manyhands.launch.recordings.run import RecordedRun
from manyhands.launch.recordings.tables import Progress, Traces, chosen
from manyhands.protocol.channels import DISPLACEMENT, FORCE
from manyhands.protocol.messages import Role

ROSBAG: Final = "rosbag"
"""The name of the format, and the suffix of a bag's folder."""

CARTESIAN: Final = 3
"""The number of axes of a device whose position is a point in space."""

POSE: Final = "geometry_msgs/msg/PoseStamped"
TWIST: Final = "geometry_msgs/msg/TwistStamped"
WRENCH: Final = "geometry_msgs/msg/WrenchStamped"
JOINTS: Final = "sensor_msgs/msg/JointState"

_LATEST: Final = 2**31 * 10**9  # ns since 1970: a stamp of ROS 2 has 32 bits of seconds
_VERSION: Final = 9  # of the metadata of rosbag2: that of ROS 2 Jazzy and later
_REPORTED: Final = 4096  # messages between two reports of progress


@dataclass(frozen=True, eq=False)
class Stream:
    """The messages of one topic of the bag.

    Attributes:
        topic: its full name.
        type: of its messages.
        device: whose they are; also the name of the frame.
        axes: names of the device's axes.
        tick: the device's tick of the first row.
        tick_ns: its T, ns.
        values: ticks x columns: what its messages hold, m, m/s or N.
    """

    topic: str
    type: str
    device: str
    axes: tuple[str, ...]
    tick: int
    tick_ns: float
    values: Array

    @property
    def recorded(self) -> NDArray[np.bool_]:
        """The rows that were recorded; a velocity or an effort beside a position may be missing."""
        return np.asarray(np.isfinite(self.values[:, : len(self.axes)]).all(axis=1), dtype=np.bool_)


def streams_of(run: RecordedRun, traces: Traces) -> list[Stream]:
    """The topics of a bag of these traces that have a message.

    Raises:
        RecordingError: two devices would have one namespace, or no trace is a device's motion or force.
    """
    recorded, out = run.recorded, []
    spaces: dict[str, str] = {}
    for device, ports in recorded.devices.items():
        space = f"/{ros_name(recorded.session)}/{ros_name(device)}"
        if space in spaces:
            raise RecordingError(
                f"found the devices {spaces[space]!r} and {device!r}, which ROS 2 would both call {space}; expected "
                "names that differ in more than '-' and '.'"
            )
        spaces[space] = device
        x, f = (_trace_of(traces, device, name) for name in (DISPLACEMENT, FORCE))
        sent = _sent_to(run, traces, device)
        found: list[tuple[str, str, Array]] = []
        wrench = len(ports) <= CARTESIAN
        v = run.velocity_of(device) if x is not None else None
        if x is not None and v is not None and len(ports) == CARTESIAN:
            found += [("measured_cp", POSE, x), ("measured_cv", TWIST, v)]
        elif x is not None and v is not None:
            found.append(("measured_js", JOINTS, np.hstack([x, v, np.full_like(x, np.nan) if f is None else f])))
        if f is not None and wrench:
            found.append(("measured_cf", WRENCH, f))
        if sent is not None:
            found.append(("servo_cf", WRENCH, sent) if wrench else ("servo_jf", JOINTS, sent))
        first, tick_ns = run.first_of(device), recorded.tick_ns(device)
        out += [
            Stream(f"{space}/{name}", type_, device, ports, first, tick_ns, values) for name, type_, values in found
        ]
    out = [stream for stream in out if stream.recorded.any()]
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
    whole = np.flatnonzero(stream.recorded)
    times = (started + np.rint((stream.tick + whole) * stream.tick_ns).astype(np.int64)).tolist()
    for row, time in zip(whole.tolist(), times, strict=True):
        yield time, serialise(time, stream.values[row].tolist())


def _serialiser(typestore: Any, stream: Stream) -> Serialise:
    types, name, width = typestore.types, stream.type, len(stream.axes)
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    vector, message = types["geometry_msgs/msg/Vector3"], types[name]
    point, pose = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Pose"]
    upright, wrench = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), types["geometry_msgs/msg/Wrench"]
    twist = types["geometry_msgs/msg/Twist"]
    no_turn, none, axes = vector(0.0, 0.0, 0.0), np.empty(0), list(stream.axes)
    effort_alone = stream.topic.endswith("servo_jf")

    def body(row: Sequence[float]) -> tuple[Any, ...]:
        if name == POSE:
            return (pose(point(*row), upright),)
        if name == WRENCH:
            return (wrench(vector(*row, *(0.0,) * (CARTESIAN - width)), no_turn),)
        if name == TWIST:
            return (twist(vector(*row), no_turn),)
        numbers = np.array(row)
        if effort_alone:
            return axes, none, none, numbers
        velocity, effort = (known if np.isfinite(known).all() else none for known in np.split(numbers[width:], 2))
        return axes, numbers[:width], velocity, effort

    def serialise(time: int, row: Sequence[float]) -> bytes:
        seconds, nanoseconds = divmod(time, 10**9)
        made = message(header(stamp(seconds, nanoseconds), stream.device), *body(row))
        return bytes(typestore.serialize_cdr(made, name))

    return serialise


def save_bag(run: RecordedRun, path: Path, patterns: Sequence[str] = (), progress: Progress | None = None) -> int:
    """Write a bag: a folder with an MCAP file and its metadata, whole or not at all.

    Args:
        run: the recording.
        path: the folder, which must not exist.
        patterns: the topics of the recording to write; see :func:`~manyhands.launch.recordings.tables.chosen`.
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
    if end >= _LATEST:
        raise RecordingError(
            f"found a tick at {end / 1e9:.0f} s since 1970; expected times that ROS 2 can write, to 2038"
        )
    try:
        with _making(path) as folder:
            return _write(streams, started, folder, progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error


def _write(streams: Sequence[Stream], started: int, folder: Path, progress: Progress) -> int:
    require("ros")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    typestore = get_typestore(Stores.ROS2_JAZZY)
    total, done = max(1, sum(len(stream.values) for stream in streams)), 0
    with Writer(folder, version=_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [writer.add_connection(one.topic, one.type, typestore=typestore) for one in streams]
        by_stream = [
            zip(messages_of(one, started, _serialiser(typestore, one)), repeat(connection))
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
