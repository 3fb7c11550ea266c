"""A recording as a bag of ROS 2: rosbags' reader opens it, and it holds the same numbers at the same times."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from manyhands.extras import MissingExtra
from manyhands.launch.bridges import rosbag
from manyhands.launch.bridges.rosbag import (
    JOINTS,
    POSE,
    TWIST,
    WRENCH,
    device_topics,
    ros_name,
    ros_types,
    save_bag,
    serialiser,
)
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import RecordedRun, RecordedTrace, read_run
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded, recorded_of
from manyhands.protocol.channels import TOPICS
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Figures, Observation, Role

from ...support.commands import manyhands_command
from ...support.slot import described

STARTED = 1_700_000_000_123_456_789  # ns since 1970
TICKS = 30
AXES = {"dx": ("dx",), "flat": ("flat.0", "flat.1"), "hand-1": ("hand-1.x", "hand-1.y", "hand-1.z"), "arm": ()}
AXES["arm"] = tuple(f"arm.{axis}" for axis in range(4))
PORTS = {**AXES, "c": AXES["dx"] + AXES["flat"], "v": AXES["hand-1"][::-1], "w": AXES["arm"]}
RECORDED = Recorded(
    session="a-session.1",
    certificate="0" * 64,
    period=0.001,
    clock="realtime",
    roles={**dict.fromkeys(AXES, Role.DEVICE), **dict.fromkeys("cvw", Role.COUPLING)},
    ports=PORTS,
)
LOST = range(10, 15)  # ticks of dx


def numbers(node: str, trace: str) -> np.ndarray:
    """Other numbers for each node and trace, of all magnitudes."""
    draw = np.random.default_rng([*node.encode(), *trace.encode()])
    return draw.normal(size=(TICKS, len(PORTS[node]))) * 10.0 ** draw.integers(-9, 9, size=(TICKS, len(PORTS[node])))


def speeds(device: str) -> np.ndarray:
    """(x(k) - x(k-1))/T, x(-1) being zero, m/s."""
    return np.diff(numbers(device, "x"), axis=0, prepend=0.0) / RECORDED.period


@pytest.fixture
def file(tmp_path: Path) -> Path:
    core = RecorderCore(RECORDED)
    for node, role in RECORDED.roles.items():
        for first, end in ((0, LOST.start), (LOST.start, LOST.stop), (LOST.stop, TICKS)):
            if node == "dx" and first == LOST.start:
                continue
            traces = {"x": numbers(node, "x")[first:end]} if role is Role.DEVICE else {}
            traces["f_v"] = numbers(node, "f_v")[first:end]
            core.take(encode(Observation(node, end, Figures(), traces)), STARTED + end * 1_000_000)
    path = tmp_path / "run.mcap"
    path.write_bytes(core.cut() + core.end())
    return path


def read(path: Path) -> dict[str, tuple[str, list[tuple[int, Any]]]]:
    """The type of each topic of a bag, and its messages with their times."""
    store = get_typestore(Stores.ROS2_JAZZY)
    out: dict[str, tuple[str, list[tuple[int, Any]]]] = {}
    with Reader(path) as reader:
        for connection in reader.connections:
            out[connection.topic] = (connection.msgtype, [])
            assert connection.digest == store.hash_rihs01(connection.msgtype)
        times = []
        for connection, time, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time  # type: ignore[attr-defined]
            out[connection.topic][1].append((time, message))
            times.append(time)
        assert times == sorted(times)
        assert {c.topic: c.msgcount for c in reader.connections} == {topic: len(own[1]) for topic, own in out.items()}
    return out


def test_a_bag_holds_the_numbers_of_the_recording(file: Path, tmp_path: Path) -> None:
    parts: list[float] = []
    count = save_bag(read_run(file), tmp_path / "out.rosbag", progress=parts.append)
    found = read(tmp_path / "out.rosbag")
    space = "/a_session_1"
    assert {topic: kind for topic, (kind, _) in found.items()} == {
        f"{space}/dx/measured_js": JOINTS,
        f"{space}/dx/measured_cf": WRENCH,
        f"{space}/dx/servo_cf": WRENCH,
        f"{space}/flat/measured_js": JOINTS,
        f"{space}/flat/measured_cf": WRENCH,
        f"{space}/flat/servo_cf": WRENCH,
        f"{space}/hand_1/measured_cp": POSE,
        f"{space}/hand_1/measured_cv": TWIST,
        f"{space}/hand_1/measured_cf": WRENCH,
        f"{space}/hand_1/servo_cf": WRENCH,
        f"{space}/arm/measured_js": JOINTS,
        f"{space}/arm/servo_jf": JOINTS,
    }
    assert count == sum(len(messages) for _, messages in found.values())
    assert parts[-1] == 1.0
    every = np.arange(TICKS)
    sent = {port: column for node in "cvw" for port, column in zip(PORTS[node], numbers(node, "f_v").T, strict=True)}
    for device, axes in AXES.items():
        kept = np.setdiff1d(every, LOST) if device == "dx" else every
        x, f = numbers(device, "x")[kept], numbers(device, "f_v")[kept]
        commanded = np.stack([sent[axis] for axis in axes], axis=1)
        own = {topic.rpartition("/")[2]: m for topic, (_, m) in found.items() if f"/{ros_name(device)}/" in topic}
        for name, messages in own.items():
            ticks = every if name.startswith("servo") else kept
            assert [time for time, _ in messages] == [STARTED + int(tick) * 1_000_000 for tick in ticks]
            assert {message.header.frame_id for _, message in messages} == {device}
        if device == "hand-1":
            assert np.array_equal(x, [_three(m.pose.position) for _, m in own["measured_cp"]])
            assert {_four(m.pose.orientation) for _, m in own["measured_cp"]} == {(0.0, 0.0, 0.0, 1.0)}
            assert np.array_equal(speeds(device), [_three(m.twist.linear) for _, m in own["measured_cv"]])
            assert not any(any(_three(m.twist.angular)) for _, m in own["measured_cv"])
        else:
            assert np.array_equal(x, [m.position for _, m in own["measured_js"]])
            assert np.array_equal(f, [m.effort for _, m in own["measured_js"]])
            assert {tuple(m.name) for _, m in own["measured_js"]} == {axes}
            for tick, (_, m) in zip(kept, own["measured_js"], strict=True):
                if device == "dx" and tick == LOST.stop:  # the sample before it is missing
                    assert not len(m.velocity)
                else:
                    assert np.array_equal(m.velocity, speeds(device)[tick])
        if device == "arm":
            assert np.array_equal(commanded, [m.effort for _, m in own["servo_jf"]])
            continue
        for name, values in (("measured_cf", f), ("servo_cf", commanded)):
            forces = np.array([_three(m.wrench.force) for _, m in own[name]])
            assert np.array_equal(forces[:, : len(axes)], values)
            assert not forces[:, len(axes) :].any()
            assert not any(any(_three(m.wrench.torque)) for _, m in own[name])


def _three(vector: Any) -> tuple[float, ...]:
    return vector.x, vector.y, vector.z


def _four(vector: Any) -> tuple[float, ...]:
    return vector.x, vector.y, vector.z, vector.w


def test_the_times_of_a_recording_that_begins_late(tmp_path: Path) -> None:
    core = RecorderCore(RECORDED)
    core.take(encode(Observation("dx", TICKS, Figures(), {"x": numbers("dx", "x")[20:]})), STARTED + TICKS * 1_000_000)
    path = tmp_path / "late.mcap"
    path.write_bytes(core.cut() + core.end())
    run = read_run(path)
    assert run.started == STARTED
    assert run.topics == [("dx", "sample")]
    save_bag(run, tmp_path / "late.rosbag")
    ((_, messages),) = read(tmp_path / "late.rosbag").values()
    assert [time for time, _ in messages] == [STARTED + tick * 1_000_000 for tick in range(20, TICKS)]
    assert all(np.array_equal(m.velocity, speeds("dx")[tick]) for tick, (_, m) in enumerate(messages[1:], 21))


def test_a_velocity_needs_the_sample_before(tmp_path: Path) -> None:
    """A recording of a session's later hours has none in its first row, and never one from zero."""
    later = replace(run_of("d"), first=500)
    assert np.isnan(later.velocity_of("d")[0]).all()
    assert np.array_equal(later.velocity_of("d")[1:], np.zeros((2, 1)))
    save_bag(later, tmp_path / "later.rosbag")
    ((_, messages),) = read(tmp_path / "later.rosbag").values()
    assert [len(m.velocity) for _, m in messages] == [0, 1, 1]


def test_topics_choose_what_is_written(file: Path, tmp_path: Path) -> None:
    run = read_run(file)
    save_bag(run, tmp_path / "one.rosbag", ["dx/sample", "c"])
    found = read(tmp_path / "one.rosbag")
    assert [*found] == [f"/a_session_1/{name}" for name in ("dx/measured_js", "dx/servo_cf", "flat/servo_cf")]
    assert all(not len(message.effort) for _, message in found["/a_session_1/dx/measured_js"][1])
    with pytest.raises(RecordingError, match="--topics: found no motion or force of a device"):
        save_bag(run, tmp_path / "none.rosbag", ["dx/tau", "c/tool"])


@pytest.mark.parametrize(
    ("name", "plain"),
    [("example-1", "example_1"), ("a.b--c", "a_b_c"), ("3d", "_3d"), ("Überall", "_berall"), ("left", "left")],
)
def test_names_that_ros_allows(name: str, plain: str) -> None:
    assert ros_name(name) == plain


def run_of(*devices: str, started: int = STARTED) -> RecordedRun:
    recorded = Recorded(
        "s", "0" * 64, 0.001, "realtime", dict.fromkeys(devices, Role.DEVICE), {d: (d,) for d in devices}
    )
    sample = TOPICS[Role.DEVICE][0]
    traces: Mapping[tuple[str, str], RecordedTrace] = {
        (device, "sample"): RecordedTrace(sample, (device,), np.zeros((3, 1))) for device in devices
    }
    return RecordedRun(recorded, traces, started=started)


def test_devices_of_one_name_in_ros_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="which ROS 2 would both call /s/a_b"):
        save_bag(run_of("a-b", "a.b"), tmp_path / "out.rosbag")
    assert [*tmp_path.iterdir()] == []


def named(axes: tuple[str, ...], turning: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """The topics of a device with these axes: name within its space to the axes."""
    (parts,) = device_topics("s", {"d": axes}, turning).values()
    found = [topic for part in parts for topic in part[1:] if topic is not None]
    assert len({topic.name for topic in found}) == len(found)
    return {topic.name.removeprefix("/s/d/"): topic.axes for topic in found}


def test_an_axis_that_turns_beside_others_has_topics_of_its_own() -> None:
    x, y, z, jaw, tip = "d.x", "d.y", "d.z", "d.jaw", "d.tip"
    whole = ("measured_js", "servo_jf")
    point = dict.fromkeys(("measured_cp", "measured_cv", "measured_cf", "servo_cf"), (x, y, z))
    jaws = {f"jaw/{name}": (jaw,) for name in whole}
    assert named((x, y, z), ()) == point
    assert named((x, jaw, y, z), (jaw,)) == dict.fromkeys(whole, (x, jaw, y, z)) | point | jaws
    both = dict.fromkeys(("measured_js", "measured_cf", "servo_cf"), (x, jaw))
    assert named((x, jaw), (jaw,)) == both | jaws
    three = dict.fromkeys(
        ("measured_js", "measured_cf", "servo_cf"), (x, jaw, tip)
    )  # an angle is no coordinate of a pose
    assert named((x, jaw, tip), (jaw, tip)) == three | jaws | {f"tip/{name}": (tip,) for name in whole}
    assert named(("d",), ("d",)) == dict.fromkeys(("measured_js", "measured_cf", "servo_cf"), ("d",))


def test_a_torque_is_one_in_a_wrench() -> None:
    ((part,),) = (parts[:1] for parts in device_topics("s", {"d": ("d.x", "d.phi")}, ("d.phi",)).values())
    assert part.exerted is not None
    typestore = ros_types()
    found = typestore.deserialize_cdr(serialiser(typestore, part.exerted)(0, [1.5, -0.25]), WRENCH)
    assert _three(found.wrench.force) == (1.5, 0.0, 0.0)
    assert _three(found.wrench.torque) == (0.0, -0.25, 0.0)


def test_a_device_that_its_hand_turns_has_pose_twist_and_wrench_with_its_turn(tmp_path: Path) -> None:
    """Quaternions of either sign, the smallest turns, and a tick that is lost."""
    run = turned_run(tmp_path)
    save_bag(run, tmp_path / "run.rosbag")
    found = {topic.removeprefix("/slot/pen/"): own for topic, own in read(tmp_path / "run.rosbag").items()}
    assert {name: kind for name, (kind, _) in found.items()} == {
        "measured_cp": POSE, "measured_cv": TWIST, "measured_cf": WRENCH}  # fmt: skip
    kept = np.setdiff1d(np.arange(50), [20])
    R, x, f, torque = (TURNED[name][kept] for name in ("R", "x", "f_v", "t_v"))
    messages = {name: [message for _, message in own] for name, (_, own) in found.items()}
    assert np.array_equal(np.roll(R, -1, axis=1), [_four(m.pose.orientation) for m in messages["measured_cp"]])
    assert np.array_equal(x, [_three(m.pose.position) for m in messages["measured_cp"]])
    assert np.array_equal(f, [_three(m.wrench.force) for m in messages["measured_cf"]])
    assert np.array_equal(torque, [_three(m.wrench.torque) for m in messages["measured_cf"]])
    turns = Rotation.from_quat(np.roll(TURNED["R"], -1, axis=1))
    by = (turns * Rotation.concatenate([Rotation.identity(), turns[:-1]]).inv()).as_rotvec() / 1e-3
    both = np.setdiff1d(kept, [21])
    twists = np.array([_three(m.twist.angular) for m in messages["measured_cv"]])
    assert twists == pytest.approx(by[both], rel=1e-7, abs=1e-12)
    assert np.linalg.norm(by[both], axis=1).min() < 1e-5


def test_a_pose_without_its_orientation_is_not_written(tmp_path: Path) -> None:
    run = turned_run(tmp_path)
    save_bag(run, tmp_path / "run.rosbag", ["pen/sample", "pen/force", "pen/torque"])
    assert [*read(tmp_path / "run.rosbag")] == ["/slot/pen/measured_cf"]


def _turned(random: np.random.Generator) -> dict[str, np.ndarray]:
    steps = random.normal(size=(50, 3)) * 10.0 ** random.integers(-12, 0, size=(50, 1))
    at, R = Rotation.identity(), []
    for step in steps:
        at = Rotation.from_rotvec(step) * at
        R.append(np.roll(at.as_quat(), 1) * random.choice([-1.0, 1.0]))
    x, f, torque = (random.normal(size=(50, 3)) for _ in range(3))
    return {"R": np.array(R), "Q": np.array(R), "x": x, "f_v": f, "t_v": torque}


TURNED = _turned(np.random.default_rng(3))


def turned_run(folder: Path) -> RecordedRun:
    """The recording of a hand that turns, of which tick 20 is lost."""
    core = RecorderCore(recorded_of(described()))
    for first, end in ((0, 20), (21, 50)):
        traces = {name: values[first:end] for name, values in TURNED.items()}
        core.take(encode(Observation("pen", end, Figures(), traces)), STARTED + end * 1_000_000)
    path = folder / "run.mcap"
    path.write_bytes(core.cut() + core.end())
    return read_run(path)


def test_axes_of_one_name_in_ros_are_refused() -> None:
    with pytest.raises(
        RecordingError, match=r"found the axes 'd\.a-b' and 'd\.a\.b', which ROS 2 would both call /s/d/a_b"
    ):
        device_topics("s", {"d": ("d.a-b", "d.a.b")}, ("d.a-b", "d.a.b"))


def test_times_beyond_those_of_ros_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="to 2038"):
        save_bag(run_of("d", started=2**31 * 10**9 - 1000), tmp_path / "out.rosbag")


def test_something_of_that_name_is_kept(tmp_path: Path) -> None:
    (tmp_path / "out.rosbag").mkdir()
    with pytest.raises(RecordingError, match="found something of that name; expected a new name"):
        save_bag(run_of("d"), tmp_path / "out.rosbag")
    with pytest.raises(RecordingError, match="found no folder"):
        save_bag(run_of("d"), tmp_path / "none" / "out.rosbag")
    assert [*tmp_path.iterdir()] == [tmp_path / "out.rosbag"]


def test_nothing_is_left_of_a_bag_that_could_not_be_written(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(done: float) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(rosbag, "_REPORTED", 10)
    with pytest.raises(RecordingError, match="cannot be written: No space left on device"):
        save_bag(read_run(file), tmp_path / "out.rosbag", progress=full)
    assert [*tmp_path.iterdir()] == [file]


def test_a_missing_extra_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(MissingExtra, match=r"pip install 'manyhands\[ros\]'"):
        save_bag(run_of("d"), tmp_path / "out.rosbag")
    assert [*tmp_path.iterdir()] == []


@pytest.mark.usefixtures("own_interrupt")
def test_the_command_writes_a_bag_beside_the_recording(file: Path) -> None:
    done = manyhands_command("export", file, "--format", "rosbag")
    assert done.exit_code == 0, done.stderr
    assert "messages written to" in done.stderr
    assert {path.name for path in file.with_suffix(".rosbag").iterdir()} == {"metadata.yaml", "run.rosbag.mcap"}
    again = manyhands_command("export", file, "-o", file.with_suffix(".rosbag"))
    assert again.exit_code == 2
    assert "found something of that name" in again.stderr
