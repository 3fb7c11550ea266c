"""A session in ROS 2, without Zenoh: what is published, what a sample asks of a device, and what is refused."""

from __future__ import annotations

import math
import struct
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from manyhands.launch.bridges.ros import (
    MAX_SERVO_BYTES,
    MOST_TICKS,
    RosMessage,
    RosMessages,
    RosNode,
    Servo,
    ServoSample,
    ZenohAccess,
    attachment,
    dds_type,
    domain_of,
    holdable,
    publisher_of,
    read_pose,
    topic_key,
)
from manyhands.launch.bridges.rosbag import LATEST, POSE, RosTopic, ros_types, save_bag
from manyhands.launch.look.page.pointer import Hold
from manyhands.launch.look.page.security import ViewError
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import read_run
from manyhands.nodes.monitor.session_state import About, NodeAbout
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import recorded_of
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Role

from ...support.commands import manyhands_command
from ...support.observed_session import ABOUT, observed
from ...support.slot import described

TYPES = ros_types()
HASH = TYPES.hash_rihs01(POSE)
WALL = 1_700_000_000_000_000_000  # ns since 1970
THREE = ("pen.x", "pen.y", "pen.z")
FOUR = tuple(f"arm.{axis}" for axis in range(4))
WIDE = replace(
    ABOUT,
    nodes={
        "left": NodeAbout(Role.DEVICE, ("left",), wall=True),
        "pen": NodeAbout(Role.DEVICE, THREE, wall=True),
        "arm": NodeAbout(Role.DEVICE, FOUR, wall=True),
        "plane": NodeAbout(Role.COUPLING, ("pen.y", "pen.x")),
        "rest": NodeAbout(Role.COUPLING, ("left", "pen.z", *FOUR)),
        "environment": NodeAbout(Role.ENVIRONMENT, ("left", *THREE, *FOUR)),
    },
    links=(),
    grips=("pen", "arm", "left"),
    reach={"left": 0.1, "pen.x": 0.1, "pen.y": 0.05, "pen.z": 0.2},
)
"""Devices of one, three and four axes; the blocks do not follow the devices."""

TICKS = 100
BEGIN = observed("environment", TICKS, {"q": np.zeros((TICKS, 1))})


def values(node: str, trace: str, ticks: int = TICKS) -> np.ndarray:
    """Other numbers for each node and trace, of all magnitudes."""
    draw = np.random.default_rng([*node.encode(), *trace.encode()])
    size = (ticks, len(WIDE.nodes[node].ports))
    return draw.normal(size=size) * 10.0 ** draw.integers(-9, 9, size=size)


FRAMES = (
    BEGIN,
    *(observed(node, TICKS, {"x": values(node, "x"), "f_v": values(node, "f_v")}) for node in ("left", "pen", "arm")),
    *(observed(node, TICKS, {"f_v": values(node, "f_v")}) for node in ("plane", "rest")),
)


def made(
    *frames: bytes, about: About = WIDE, every: int = 1, wanted: Callable[[RosTopic], bool] = lambda topic: True
) -> list[RosMessage]:
    return list(of(RosMessages(about, every, TYPES), *frames, wanted=wanted))


def of(
    messages: RosMessages, *frames: bytes, wanted: Callable[[RosTopic], bool] = lambda topic: True
) -> list[RosMessage]:
    return [one for frame in frames for one in messages.take(frame, Instant(0), WALL, wanted)]


def ticks_of(messages: list[RosMessage], name: str) -> list[int]:
    begin = WALL - TICKS * 1_000_000
    found = [TYPES.deserialize_cdr(one.data, one.topic.type).header.stamp for one in messages if one.topic.name == name]
    return [(stamp.sec * 10**9 + stamp.nanosec - begin) // 1_000_000 for stamp in found]


# ---- what is published


def without_velocity(type_: str, data: bytes) -> bytes:
    """A message of a bag, as a running session sends it."""
    message = TYPES.deserialize_cdr(data, type_)
    if hasattr(message, "velocity"):
        message.velocity = np.empty(0)
    return bytes(TYPES.serialize_cdr(message, type_))


def test_messages_are_those_of_a_bag_but_for_velocities(tmp_path: Path) -> None:
    core = RecorderCore(recorded_of(WIDE))
    for frame in FRAMES:
        core.take(frame, WALL)
    (tmp_path / "run.mcap").write_bytes(core.cut() + core.end())
    save_bag(read_run(tmp_path / "run.mcap"), tmp_path / "run.rosbag")
    with Reader(tmp_path / "run.rosbag") as reader:
        both = [one for one in reader.connections if not one.topic.endswith("/measured_cv")]
        kept = {(one.topic, without_velocity(one.msgtype, bytes(data))) for one, _, data in reader.messages(both)}
        types = {connection.topic: connection.msgtype for connection in both}
    sent = made(*FRAMES)
    assert len(sent) == len(kept) == 8 * TICKS
    assert {(one.topic.name, one.data) for one in sent} == kept
    assert {topic.name: topic.type for topic in RosMessages(WIDE, 1, TYPES).topics} == types


def turning(**others: Any) -> bytes:
    """A hundred ticks of a hand that turns its tool."""
    draw = np.random.default_rng(5)
    R = draw.normal(size=(TICKS, 4))
    R /= np.linalg.norm(R, axis=1)[:, None]
    x, f, torque = (draw.normal(size=(TICKS, 3)) for _ in range(3))
    return observed("pen", TICKS, {"x": x, "f_v": f, "R": R, "Q": R, "t_v": torque} | others)


TURNED = described()
BEGUN = observed("environment", TICKS, {"x_e": np.zeros((TICKS, 3))})


def test_what_a_hand_turns_is_sent_as_a_bag_has_it(tmp_path: Path) -> None:
    core = RecorderCore(recorded_of(TURNED))
    for frame in (BEGUN, turning()):
        core.take(frame, WALL)
    (tmp_path / "run.mcap").write_bytes(core.cut() + core.end())
    save_bag(read_run(tmp_path / "run.mcap"), tmp_path / "run.rosbag")
    with Reader(tmp_path / "run.rosbag") as reader:
        both = [one for one in reader.connections if not one.topic.endswith("/measured_cv")]
        kept = {(one.topic, bytes(data)) for one, _, data in reader.messages(both)}
    sent = made(BEGUN, turning(), about=TURNED)
    assert len(sent) == 2 * TICKS
    assert {(one.topic.name, one.data) for one in sent} == kept
    last = {one.topic.name.rpartition("/")[2]: TYPES.deserialize_cdr(one.data, one.topic.type) for one in sent}
    pose, wrench = last["measured_cp"].pose, last["measured_cf"].wrench
    q = pose.orientation
    assert (q.x, q.y, q.z, q.w) != (0.0, 0.0, 0.0, 1.0)
    assert q.x**2 + q.y**2 + q.z**2 + q.w**2 == pytest.approx(1.0)
    assert (wrench.torque.x, wrench.torque.y, wrench.torque.z) != (0.0, 0.0, 0.0)


def test_of_a_hand_that_senses_alone_the_wrench_has_no_torque_and_the_pose_its_turn() -> None:
    about = replace(TURNED, sensed=("pen",))
    sent = made(BEGUN, turning(), about=about)
    assert len(sent) == 2 * TICKS
    last = {one.topic.name.rpartition("/")[2]: TYPES.deserialize_cdr(one.data, one.topic.type) for one in sent}
    torque, q = last["measured_cf"].wrench.torque, last["measured_cp"].pose.orientation
    assert (torque.x, torque.y, torque.z) == (0.0, 0.0, 0.0)
    assert (q.x, q.y, q.z, q.w) != (0.0, 0.0, 0.0, 1.0)


def test_turns_that_do_not_fit_the_ticks_are_counted_and_those_that_are_missing_not_sent() -> None:
    for others, topic, unfit in (
        ({"R": np.zeros((TICKS, 3))}, "measured_cf", 1),
        ({"t_v": np.full((TICKS, 3), np.nan)}, "measured_cp", 0),
    ):
        messages = RosMessages(TURNED, 1, TYPES)
        assert {one.topic.name for one in of(messages, BEGUN, turning(**others))} == {f"/slot/pen/{topic}"}
        assert messages.unfit == unfit


def test_every_nth_tick_is_sent_whatever_the_frames() -> None:
    odd = [observed("left", 35, {"x": np.zeros((35, 1))}), observed("left", 70, {"x": np.zeros((35, 1))})]
    assert ticks_of(made(BEGIN, *odd, every=10), "/pair/left/measured_js") == [*range(0, 70, 10)]
    forces = [observed("rest", 35, {"f_v": np.zeros((35, 6))}), observed("plane", 35, {"f_v": np.zeros((35, 2))})]
    assert ticks_of(made(BEGIN, *forces, every=10), "/pair/pen/servo_cf") == [0, 10, 20, 30]


def test_nothing_is_sent_before_the_time_is_known_and_nothing_that_nobody_receives() -> None:
    assert made(*FRAMES[1:]) == []
    names = {one.topic.name for one in made(*FRAMES, wanted=lambda topic: topic.name.endswith("_cf"))}
    assert names == {f"/pair/{device}/{name}_cf" for device in ("left", "pen") for name in ("measured", "servo")}


def test_a_force_that_no_coupling_shows_any_more_is_not_waited_for() -> None:
    messages = RosMessages(WIDE, 1, TYPES)
    of(messages, BEGIN)
    long = 3 * MOST_TICKS
    assert of(messages, observed("plane", long, {"f_v": np.zeros((long, 2))})) == []
    late = of(messages, observed("rest", long, {"f_v": np.zeros((long, 6))}))
    assert ticks_of(late, "/pair/pen/servo_cf") == [*range(long - MOST_TICKS, long)]


@pytest.mark.parametrize(
    "frame",
    [
        observed("left", 10, {"x": np.zeros((10, 2))}),
        observed("left", 10, {"x": np.zeros((20, 1))}),
        observed("plane", 10, {"f_v": np.zeros((10, 3))}),
        observed("left", 2**60, {"x": np.zeros((1, 1))}),
        observed("left", (LATEST - WALL) // 1_000_000 + TICKS, {"x": np.zeros((1, 1))}),
    ],
)
def test_what_does_not_fit_the_session_is_counted(frame: bytes) -> None:
    messages = RosMessages(WIDE, 1, TYPES)
    assert of(messages, BEGIN, frame) == []
    assert messages.unfit == 1


def test_values_that_are_missing_are_not_sent() -> None:
    x = np.zeros((3, 3))
    x[1, 2] = np.nan
    sent = made(BEGIN, observed("pen", 3, {"x": x, "f_v": np.full((3, 3), np.nan)}))
    assert ticks_of(sent, "/pair/pen/measured_cp") == [0, 2]
    assert len(sent) == 2


def test_devices_of_one_name_in_ros_are_refused() -> None:
    nodes = {"a_b": NodeAbout(Role.DEVICE, ("a_b",)), "a__b": NodeAbout(Role.DEVICE, ("a__b",))}
    with pytest.raises(RecordingError, match="which ROS 2 would both call /pair/a_b"):
        RosMessages(replace(ABOUT, nodes=nodes), 1, TYPES)


# ---- the protocol of rmw_zenoh, by the examples of its design document and by types that `ros2 topic info -v` showed


def test_keys_and_tokens() -> None:
    assert dds_type("std_msgs/msg/String") == "std_msgs::msg::dds_::String_"
    chatter = RosTopic("/robot1/chatter", "std_msgs/msg/String", "robot1", ())
    string = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert TYPES.hash_rihs01(chatter.type) == string
    assert topic_key(0, chatter, string) == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{string}"
    node = RosNode(2, "aac3178e146ba6f1fc6e6a4085e77f21", "/robot1")
    session = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0"
    assert node.token() == f"{session}/0/NN/%/%robot1/manyhands"
    end = f"%/%robot1/manyhands/%robot1%chatter/std_msgs::msg::dds_::String_/{string}"
    assert node.publisher_token(10, chatter, string) == f"{session}/10/MP/{end}/2::,10:,:,:,,"
    assert node.subscription_token(7, chatter, string) == f"{session}/7/MS/{end}/::,1:,:,:,,"


def test_hashes_of_types_are_those_of_ros() -> None:
    assert TYPES.hash_rihs01("sensor_msgs/msg/JointState") == (
        "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )
    assert HASH == "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"


def test_an_attachment_has_33_bytes() -> None:
    found = attachment(1, 2, b"0123456789abcdef")
    assert found == b"\1" + bytes(7) + b"\2" + bytes(7) + b"\x10" + b"0123456789abcdef"
    assert publisher_of(found) == b"0123456789abcdef"
    labelled = (
        b"\x0fsequence_number" + bytes(8) + b"\x10source_timestamp" + bytes(8) + b"\x0asource_gid\x10" + bytes(16)
    )
    for wrong in (b"", found[:-1], found + b"\0", found[:16] + b"\x0f" + found[17:], labelled):
        assert publisher_of(wrong) is None


# ---- what a sample asks of a device


UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def pose(frame: str, *position: float, order: str = "<", turn: tuple[float, ...] = UPRIGHT) -> bytes:
    """A pose in CDR, by the rules of OMG: little endian or big endian; the real part of its ``turn`` is the last."""
    text = frame.encode() + b"\0"
    head = struct.pack(f"{order}iII", -1, 2, len(text)) + text
    head += bytes(-len(head) % 8)
    return bytes((0, order == "<", 0, 0)) + head + struct.pack(f"{order}7d", *position, *turn)


def sample(data: bytes | None, publisher: bytes = b"a" * 16, type_: str = f"{dds_type(POSE)}/{HASH}") -> ServoSample:
    return ServoSample(type_, attachment(1, 2, publisher), data)


def asked(device: str, *samples: ServoSample, about: About = WIDE) -> tuple[list[Hold], dict[str, int]]:
    servo = Servo(about, HASH, Counter())
    return list(servo.holds(device, samples).values()), dict(servo.refused)


@given(
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=40),
    st.tuples(*[st.floats()] * 3),
    st.tuples(*[st.floats()] * 4),
)
def test_a_pose_is_read_as_rosbags_writes_it(
    frame: str, position: tuple[float, float, float], orientation: tuple[float, float, float, float]
) -> None:
    types = TYPES.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](-1, 2), frame)
    point, turn = types["geometry_msgs/msg/Point"](*position), types["geometry_msgs/msg/Quaternion"](*orientation)
    written = bytes(TYPES.serialize_cdr(types[POSE](header, types["geometry_msgs/msg/Pose"](point, turn)), POSE))
    assert written == pose(frame, *position, turn=orientation)
    for data in (written, pose(frame, *position, order=">", turn=orientation)):
        found = read_pose(data)
        assert found is not None
        assert found[0] == frame
        assert np.array_equal(found[1], position, equal_nan=True)
        assert np.array_equal(np.roll(found[2], -1), orientation, equal_nan=True)


WHOLE = pose("pen", 0.01, 0.02, 0.03)


@given(
    st.binary(max_size=120) | st.builds(lambda at, new: WHOLE[:at] + new, st.integers(0, 90), st.binary(max_size=90))
)
def test_no_bytes_raise(data: bytes) -> None:
    found = read_pose(data)
    assert found is None or len(found[1]) == 3
    holds, refused = asked("pen", sample(data))
    assert len(holds) + sum(refused.values()) == 1


@pytest.mark.parametrize(
    "data",
    [
        b"",
        WHOLE[:-1],
        WHOLE + bytes(1),
        b"\0\3" + WHOLE[2:],  # an encapsulation with parameters
        b"\1\1" + WHOLE[2:],
        WHOLE[:12] + struct.pack("<I", 2**32 - 1) + WHOLE[16:],
        WHOLE[:12] + struct.pack("<I", 0) + WHOLE[16:],
        WHOLE[:19] + b"x" + WHOLE[20:],  # a text without its end
        WHOLE[:16] + b"\xff\xff" + WHOLE[18:],
        pose("pen", np.nan, 0.0, 0.0),
        pose("pen", 0.0, -np.inf, 0.0),
        pose("x" * MAX_SERVO_BYTES, 0.0, 0.0, 0.0),
    ],
)
def test_what_is_no_pose_is_counted(data: bytes) -> None:
    assert asked("pen", sample(data)) == ([], {"servo_no_pose": 1})


def test_a_pose_is_what_a_pointers_position_is() -> None:
    assert asked("pen", sample(WHOLE)) == ([Hold("pen", (0.01, 0.02, 0.03))], {})
    assert asked("pen", sample(pose("", 7.0, -7.0, 0.03))) == ([Hold("pen", (0.1, -0.05, 0.03))], {})
    assert asked("left", sample(pose("left", -7.0, 5.0, 5.0))) == ([Hold("left", (-0.1,))], {})


HELD = replace(TURNED, grips=("pen",))


def test_a_pose_turns_a_device_with_an_orientation_alone() -> None:
    for turn, about, wanted in (
        ((0.0, 0.8, 0.0, 0.6), HELD, (0.6, 0.0, 0.8, 0.0)),
        (UPRIGHT, HELD, (1.0, 0.0, 0.0, 0.0)),
        ((0.0, 0.8, 0.0, 0.6), replace(HELD, hands=()), None),
        ((0.0, 0.0, 0.0, 0.0), HELD, None),  # no orientation: it is moved, and not turned
        ((0.0, 0.8, 0.0, 0.7), HELD, None),
        ((0.0, math.nan, 0.0, 1.0), HELD, None),
        ((0.0, math.inf, 0.0, 1e308), HELD, None),
    ):
        ((hold,), refused) = asked("pen", sample(pose("pen", 0.01, 0.02, 0.03, turn=turn)), about=about)
        assert hold == Hold("pen", (0.01, 0.02, 0.03), wanted)  # type: ignore[arg-type]
        assert refused == {}


def test_samples_that_are_not_ours_are_counted() -> None:
    assert asked("pen", sample(pose("world", 0.0, 0.0, 0.0))) == ([], {"servo_other_frame": 1})
    assert asked("pen", sample(None)) == ([], {"servo_too_long": 1})
    humble = sample(WHOLE, type_=f"{dds_type(POSE)}/TypeHashNotSupported")
    assert asked("pen", humble) == ([], {"servo_wrong_type": 1})
    assert asked("pen", replace(sample(WHOLE), attachment=b"")) == ([], {"servo_no_attachment": 1})


def test_the_latest_of_each_publisher_counts() -> None:
    servo = Servo(WIDE, HASH, Counter())
    samples = [sample(pose("pen", x, 0.0, 0.0), publisher) for x, publisher in ((0.01, b"a" * 16), (0.02, b"b" * 16))]
    samples.append(sample(pose("pen", 0.03, 0.0, 0.0), b"a" * 16))
    found = servo.holds("pen", samples)
    assert [hold.position[0] for hold in found.values()] == [0.03, 0.02]
    assert len(found) == 2


def test_only_what_a_page_could_drag_can_be_held() -> None:
    assert holdable(WIDE) == ("pen", "left")  # an arm of four axes has no pose
    assert holdable(replace(WIDE, grips=())) == ()
    assert holdable(replace(WIDE, turning=("left", "pen.z"))) == ()  # a pose has metres


# ---- how Zenoh is joined


def test_nobody_is_looked_for_and_nothing_else_listens() -> None:
    client, peer = ZenohAccess("localhost:7447").settings(), ZenohAccess("127.0.0.1:5", listens=True).settings()
    assert (client["mode"], client["listen/endpoints"], client["connect/endpoints"]) == (
        '"client"',
        "[]",
        '["tcp/localhost:7447"]',
    )
    assert (peer["mode"], peer["listen/endpoints"], peer["connect/endpoints"]) == (
        '"peer"',
        '["tcp/127.0.0.1:5"]',
        "[]",
    )
    for settings in (client, peer):
        assert settings["scouting/multicast/enabled"] == settings["scouting/gossip/enabled"] == "false"


@pytest.mark.parametrize(
    ("address", "local"),
    [
        ("localhost:7447", True),
        ("[::1]:7447", True),
        ("127.9.9.9:1", True),
        ("robot.local:7447", False),
    ],
)
def test_an_address_of_this_machine(address: str, local: bool) -> None:
    assert ZenohAccess(address).is_local is local


@pytest.mark.parametrize("address", ["", "localhost", "tcp/a:1", "a:0", "a:65536", 'a":1', ":1", "a:b"])
def test_other_addresses_are_refused(address: str) -> None:
    with pytest.raises(ViewError, match="expected HOST:PORT, such as localhost:7447"):
        ZenohAccess(address)


def test_the_domain_is_that_of_the_environment() -> None:
    assert [domain_of(one) for one in ({}, {"ROS_DOMAIN_ID": ""}, {"ROS_DOMAIN_ID": "42"})] == [0, 0, 42]
    for text in ("-1", "233", "x", "1e1", "٣", "9" * 5000):
        with pytest.raises(ViewError, match=r"ROS_DOMAIN_ID: found .* expected a whole number from 0 to 232"):
            domain_of({"ROS_DOMAIN_ID": text})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--router", "localhost:7447"), "--router needs --ros"),
        (("--servo",), "--servo needs --ros"),
        (("--every", "5"), "--every needs --foxglove or --ros"),
        (("--ros", "--foxglove"), "give either --foxglove or --ros"),
        (("--ros", "--open"), "give either --open or --ros"),
        (("--ros", "--layout", "l.json"), "--layout needs --foxglove"),
        (("--ros", "--token-file", "token"), "give either --token-file or --ros"),
        (("--ros", "--host", "192.0.2.7"), "expected a loopback address"),
        (("--ros", "--port", "7448", "--router", "a:1"), "give either --port"),
        (("--ros", "--port", "0"), "--port: found '127.0.0.1:0'"),
        (("--ros", "--router", "a"), "--router: found 'a'"),
        (("--ros", "--servo", "--router", "192.0.2.7:7447"), "--servo: found the router 192.0.2.7:7447"),
    ],
)
@pytest.mark.usefixtures("own_interrupt")
def test_options_that_do_not_fit_are_refused(options: tuple[str, ...], words: str) -> None:
    done = manyhands_command("view", *options)
    assert done.exit_code == 2
    assert words in done.stderr


@pytest.mark.usefixtures("own_interrupt")
def test_a_missing_extra_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    done: Any = manyhands_command("view", "--ros")
    assert (done.exit_code, done.stderr) == (
        2,
        "error: found no zenoh; expected the extra ros: pip install 'manyhands[ros]'\n",
    )
