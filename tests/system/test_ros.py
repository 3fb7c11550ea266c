"""A session in ROS 2, over real Zenoh: nodes of an implementation by others receive its numbers, and move a device."""

from __future__ import annotations

import os
import queue
import re
import shutil
import signal
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from zenoh.ext import Int64, z_deserialize
from zenoh_ros2_sdk import get_topic_info, get_topic_names_and_types

from manyhands.launch.bridges import ros

from ..support.commands import read_until, run, started
from ..support.ros_nodes import JOINTS, POSE, WRENCH, RosNodes, free_port, zenoh_session

END = 60.0  # s, of patience with what is about to happen
GOAL = (0.03, -0.02, 0.01)  # m
TICK_NS = 10_000_000
SESSION = """
session: three-axes
period: 0.01
devices:
  pen: {dof: 3, osp: 1.37, driver: browser, mass: 0.2, limits: {force: 30, displacement: 0.15, speed: 3}}
  other: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}
couplings:
  plane: {ports: [pen.1, pen.0]}
  rest: {ports: [pen.2, other.0]}
environment:
  type: network
  links:
    - {between: [pen.0, other.0], stiffness: 20}
    - {between: [pen.1, ground], stiffness: 20}
    - {between: [pen.2, ground], stiffness: 20}
design: {coupling: spring-damper, tau: 0.001}
"""
TOPICS = {
    "/three_axes/pen/measured_cp": POSE,
    "/three_axes/pen/measured_cf": WRENCH,
    "/three_axes/pen/servo_cf": WRENCH,
    "/three_axes/other/measured_js": JOINTS,
    "/three_axes/other/measured_cf": WRENCH,
    "/three_axes/other/servo_cf": WRENCH,
}
HELD = "/three_axes/pen/servo_cp"
JAWED = """
session: jawed
period: 0.01
devices:
  grip:
    dof: 4
    axes: {x: translation, y: translation, z: translation, jaw: rotation}
    osp: [1.37, 1.37, 1.37, 0.003]
    driver: simulated
    mass: [0.2, 0.2, 0.2, 0.0001]
    hand: {stiffness: [100, 100, 100, 0.5], damping: [2, 2, 2, 0.01], motion: ["0.02*sin(t)", 0, 0, "0.3*sin(2*t)"]}
  wheel: {dof: 1, axes: rotation, osp: 0.1, driver: simulated, mass: 0.02, hand: {stiffness: 6, motion: "0.5*sin(t)"}}
couplings:
  c: {ports: [grip.jaw, wheel, grip.x, grip.y, grip.z]}
environment:
  type: network
  links:
    - {between: [grip.x, ground], stiffness: 20}
    - {between: [grip.y, ground], stiffness: 20}
    - {between: [grip.z, ground], stiffness: 20}
    - {between: [grip.jaw, ground], stiffness: 0.02}
    - {between: [wheel, ground], stiffness: 0.5}
design: {coupling: spring-damper, tau: 0.001}
"""
JAW_TOPICS = {
    "/jawed/grip/measured_js": JOINTS,
    "/jawed/grip/servo_jf": JOINTS,
    "/jawed/grip/measured_cp": POSE,
    "/jawed/grip/measured_cf": WRENCH,
    "/jawed/grip/servo_cf": WRENCH,
    "/jawed/grip/jaw/measured_js": JOINTS,
    "/jawed/grip/jaw/servo_jf": JOINTS,
    "/jawed/wheel/measured_js": JOINTS,
    "/jawed/wheel/measured_cf": WRENCH,
    "/jawed/wheel/servo_cf": WRENCH,
}
ENOUGH = 5  # messages of each of them

pytestmark = [pytest.mark.usefixtures("own_interrupt"), pytest.mark.long]


@dataclass
class Seen:
    """What nodes of ROS 2 saw of a session."""

    folder: Path
    names: dict[str, list[str]] = field(default_factory=dict)
    infos: dict[str, Any] = field(default_factory=dict)
    received: dict[str, list[Any]] = field(default_factory=dict)
    attachments: dict[str, list[bytes]] = field(default_factory=dict)
    arrived: bool = False
    ports: list[set[int]] = field(default_factory=list)
    without_router: str = ""
    said: str = ""
    of_jaw: dict[str, list[Any]] = field(default_factory=dict)
    jaw_names: dict[str, list[str]] = field(default_factory=dict)


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """A session is recorded, and shown twice: through a router, where a node holds a device, and without one.

    Its ticks are slow, so that a busy machine keeps up with it. What the threads of Zenoh open stays open until the end
    of this process, so all of it is opened here, before any test.
    """
    out, temporary = Seen(tmp_path_factory.mktemp("run")), tempfile.mkdtemp(prefix="mh", dir="/tmp")
    (out.folder / "three.yaml").write_text(SESSION)
    (out.folder / "jawed.yaml").write_text(JAWED)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", temporary)
        patch.delenv("ROS_DOMAIN_ID", raising=False)
        _look(out)
    left = os.listdir(temporary)
    shutil.rmtree(temporary)
    assert left == []
    return out


def _look(out: Seen) -> None:
    router, own = free_port(), free_port()
    launched = ("launch", "three.yaml", "--record", "run.mcap")
    through = ("view", "--ros", "--router", f"127.0.0.1:{router}", "--servo", "--every", "2")
    with zenoh_session("router", listen=router), started(*launched, cwd=out.folder) as session:
        read_until(session, ": running")
        with started(*through) as view, started("view", "--ros", "--port", str(own)) as listening:
            out.said = read_until(view, "warning: ") + read_until(view, "ros: ")
            with closing(RosNodes(router)) as nodes:
                _look_through_router(nodes, router, out)
                _look_at_a_jaw(nodes, router, out)
            read_until(listening, "ros: ")
            out.without_router = _first_sample(own)
            out.ports = [listening_ports(one.pid) - {own} for one in (view, listening)]
            for one in (view, listening):
                one.send_signal(signal.SIGINT)
                out.said += one.communicate(timeout=END)[1]
                assert one.returncode == 130
        assert session.poll() is None  # the session did not notice
        session.send_signal(signal.SIGINT)
        session.communicate(timeout=END)


def _look_at_a_jaw(nodes: RosNodes, router: int, out: Seen) -> None:
    """A second session in the same ROS 2, of a gripper and a wheel."""
    launched = ("launch", "jawed.yaml", "--record", "jawed.mcap")
    through = ("view", "--running", "jawed", "--ros", "--router", f"127.0.0.1:{router}", "--every", "2")
    with started(*launched, cwd=out.folder) as session:
        read_until(session, ": running")
        with started(*through) as view:
            read_until(view, "ros: ")
            for topic, type_ in JAW_TOPICS.items():
                nodes.subscribe(topic, type_)
            out.jaw_names = dict(get_topic_names_and_types(router_port=router))
            until = time.monotonic() + END
            while time.monotonic() < until and any(len(nodes.received[topic]) < ENOUGH for topic in JAW_TOPICS):
                time.sleep(0.05)
            out.of_jaw = {topic: list(nodes.received[topic]) for topic in JAW_TOPICS}
            view.send_signal(signal.SIGINT)
            view.communicate(timeout=END)
        session.send_signal(signal.SIGINT)
        session.communicate(timeout=END)


def _look_through_router(nodes: RosNodes, router: int, out: Seen) -> None:
    def kept(sample: zenoh.Sample) -> None:
        if sample.attachment is not None and "/servo_cp/" not in str(sample.key_expr):
            out.attachments.setdefault(str(sample.key_expr), []).append(sample.attachment.to_bytes())

    nodes.session.declare_subscriber("0/three_axes/**", kept)
    for topic, type_ in TOPICS.items():
        nodes.subscribe(topic, type_)
    out.names = dict(get_topic_names_and_types(router_port=router))
    out.infos = {name: get_topic_info(name, router_port=router, verbose=True) for name in (*TOPICS, HELD)}
    first, second = nodes.publisher(HELD, POSE), nodes.publisher(HELD, POSE)
    positions = nodes.received["/three_axes/pen/measured_cp"]
    until = time.monotonic() + END
    while time.monotonic() < until and not out.arrived:
        first.publish(**nodes.pose("pen", *GOAL))
        time.sleep(0.05)  # twenty times a second, as a node would
        second.publish(**nodes.pose("", 0.1, 0.1, 0.1))  # the device is held by the first
        first.publish(**nodes.pose("world", 0.1, 0.1, 0.1))
        nodes.session.put(f"0{HELD}/geometry_msgs::msg::dds_::PoseStamped_/TypeHashNotSupported", b"")
        out.arrived = bool(positions) and np.allclose(_three(positions[-1].pose.position), GOAL, atol=0.004)
    out.received = {topic: list(messages) for topic, messages in nodes.received.items()}


def _three(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _first_sample(port: int) -> str:
    """The key of the first sample that a session of Zenoh receives which connects to this port."""
    keys: queue.SimpleQueue[str] = queue.SimpleQueue()
    with zenoh_session("client", connect=port) as session:
        session.declare_subscriber("0/three_axes/**", lambda sample: keys.put(str(sample.key_expr)))
        return keys.get(timeout=END)


def listening_ports(pid: int) -> set[int]:
    """The ports of TCP and UDP at which a process takes in something from anybody."""
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        inodes.update(re.findall(r"socket:\[(\d+)\]", os.readlink(descriptor)))
    found = set()
    for table, open_states in (("tcp", {"0A"}), ("tcp6", {"0A"}), ("udp", {"07"}), ("udp6", {"07"})):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[9] in inodes and words[3] in open_states:
                found.add(int(words[1].rpartition(":")[2], 16))
    return found


def numbers(message: Any) -> tuple[float, ...]:
    """What a message holds."""
    if hasattr(message, "pose"):
        return _three(message.pose.position)
    if hasattr(message, "wrench"):
        return _three(message.wrench.force) + _three(message.wrench.torque)
    return (*message.position, *message.effort)


def stamp(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def test_the_topics_appear_in_ros(seen: Seen) -> None:
    expected = {name: [type_] for name, type_ in {**TOPICS, HELD: POSE}.items()}
    assert {name: types for name, types in seen.names.items() if name.startswith("/three_axes/")} == expected
    for name, type_ in TOPICS.items():
        (publisher,) = seen.infos[name].publishers
        assert (publisher.node_name, publisher.node_namespace, publisher.topic_type) == (
            "manyhands",
            "/three_axes",
            type_,
        )
    assert (seen.infos[HELD].publisher_count, seen.infos[HELD].subscriber_count) == (0, 1)


def test_a_node_moves_the_device(seen: Seen) -> None:
    assert seen.arrived


def test_a_node_receives_the_numbers_of_the_recording(seen: Seen) -> None:
    run("export", "run.mcap", "--format", "rosbag", cwd=seen.folder)
    store, kept = get_typestore(Stores.ROS2_JAZZY), dict[str, dict[int, Any]]()
    with Reader(seen.folder / "run.rosbag") as reader:
        for connection, time_, data in reader.messages():
            kept.setdefault(connection.topic, {})[time_] = store.deserialize_cdr(data, connection.msgtype)
    moved = seen.received["/three_axes/pen/measured_cp"][-1]
    (same,) = [at for at, one in kept["/three_axes/pen/measured_cp"].items() if numbers(one) == numbers(moved)]
    later = stamp(moved) - same  # the start of the session is known to the recorder exactly
    assert abs(later) < END * 1e9
    for topic, messages in seen.received.items():
        assert messages, topic  # quality of service is best effort: how many came is the machine's affair
        stamps = [stamp(message) for message in messages]
        assert stamps == sorted(set(stamps))
        assert {(at - stamp(moved)) % (2 * TICK_NS) for at in stamps} == {0}  # every second tick
        for message in messages:
            own = kept[topic][stamp(message) - later]
            assert numbers(message) == numbers(own)
            assert message.header.frame_id == own.header.frame_id


def test_a_jaw_is_a_joint_of_its_own_beside_a_point(seen: Seen) -> None:
    """As CRTK has the jaw of a gripper; read by nodes of others, and in a bag by a reader of others."""
    types = {name: kinds for name, kinds in seen.jaw_names.items() if name.startswith("/jawed/")}
    assert types == {name: [type_] for name, type_ in JAW_TOPICS.items()}
    run("export", "jawed.mcap", "--format", "rosbag", cwd=seen.folder)
    store, kept = get_typestore(Stores.ROS2_JAZZY), dict[str, list[Any]]()
    with Reader(seen.folder / "jawed.rosbag") as reader:
        for connection, _, data in reader.messages():
            kept.setdefault(connection.topic, []).append(store.deserialize_cdr(data, connection.msgtype))
    assert {*kept} == {*JAW_TOPICS, "/jawed/grip/measured_cv"}
    for topic, messages in seen.of_jaw.items():
        assert len(messages) >= ENOUGH, topic
        assert {numbers(one) for one in messages} <= {numbers(one) for one in kept[topic]}
    for whole, point, jaw in zip(*(kept[f"/jawed/grip/{name}"] for name in JAW), strict=True):
        assert [*jaw.name] == ["grip.jaw"]
        assert [*whole.position] == [*_three(point.pose.position), *jaw.position]
        assert whole.effort[3:] == jaw.effort
        assert [*whole.velocity[3:]] == [*jaw.velocity]
    for joint, wrench in zip(kept["/jawed/wheel/measured_js"], kept["/jawed/wheel/measured_cf"], strict=True):
        assert _three(wrench.wrench.torque) == (joint.effort[0], 0.0, 0.0)  # N·m, and no force
        assert _three(wrench.wrench.force) == (0.0, 0.0, 0.0)
    assert max(abs(one.position[0]) for one in kept["/jawed/grip/jaw/measured_js"]) > 0.01


JAW = ("measured_js", "measured_cp", "jaw/measured_js")


def test_attachments_are_those_of_zenohs_own_serialiser(seen: Seen) -> None:
    assert len(seen.attachments) == len(TOPICS)
    publishers = set()
    for found in seen.attachments.values():
        read = [z_deserialize(tuple[Int64, Int64, bytes], zenoh.ZBytes(one)) for one in found]
        assert [sequence - read[0][0] for sequence, _, _ in read] == list(range(len(read)))
        times = [sent for _, sent, _ in read]
        assert times == sorted(times)
        assert abs(times[-1] - time.time_ns()) < 600e9
        (publisher,) = {publisher for _, _, publisher in read}
        assert len(publisher) == 16
        publishers.add(publisher)
    assert len(publishers) == len(seen.attachments)


def test_no_port_is_open_that_nobody_asked_for(seen: Seen) -> None:
    assert seen.ports == [set(), set()]
    assert seen.without_router.startswith("0/three_axes/")


PAGE = (Path(__file__).parents[2] / "docs" / "ros.md").read_text(encoding="utf-8")


def test_the_page_shows_what_the_command_says(seen: Seen) -> None:
    """With this session's name, device and router in place of the page's."""
    (quoted,) = re.findall(r"```text\n(warning: .*?)```", PAGE, flags=re.DOTALL)
    found = "".join(seen.said.splitlines(keepends=True)[:2]).replace("hold pen;", "hold left;")
    found = re.sub(r"127\.0\.0\.1:\d+", "localhost:7447", found).replace("of three-axes", "of browser")
    assert found == quoted


def test_the_page_names_every_topic_and_every_refusal(seen: Seen) -> None:
    source = Path(ros.__file__).read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|", PAGE, flags=re.MULTILINE)
    kinds = re.findall(r'refused\["(\w+)"\]', source)
    assert kinds == [row for row in rows if row in kinds]
    assert {name.rpartition("/")[2] for name in (*seen.received, HELD)} <= {*rows}


def test_the_user_reads_who_may_hold_and_what_was_refused(seen: Seen) -> None:
    assert "can hold pen; a router that listens to other machines" in seen.said
    assert re.search(r"^ros: 7 topics of three-axes in domain 0, by the router 127.0.0.1:\d+$", seen.said, re.M)
    (refused,) = re.findall(r"^refused: (.*)$", seen.said, re.M)
    assert re.sub(r"\d+", "N", refused) == "servo_not_held N, servo_other_frame N, servo_wrong_type N"
