"""A running session in ROS 2: its devices are published, and a ROS 2 node may hold what a page may hold.

ROS 2 is reached by the protocol of rmw_zenoh ([RmwZenoh2025]_), over Zenoh, without any ROS. Topics, messages and
stamps are those of a bag (:mod:`manyhands.launch.bridges.rosbag`); of the ticks only every n-th is sent.
``servo_cp`` of a device that a page could drag (``driver: browser``) is subscribed to where the user allows it. A pose
is then what a pointer's position is: the same reach, the same smoothing, the same timeouts, one holder at a time.

The first part is pure: keys, liveliness tokens and attachments of the protocol, :class:`RosMessages` from the session
to ROS 2, and :class:`Servo` back. :class:`RosBridge` hands bytes to eclipse-zenoh and takes them from it. What comes in
is bounded twice: by its size, and by a ring that keeps the latest samples of each device.

The key of a topic holds its domain, name, type and the hash of the type's definition (REP-2016). Each sample has an
attachment: sequence number, time of sending, id of the publisher. This layout is the one of rmw_zenoh from 0.1.2, 0.2.4
and 0.6.0 on: ROS 2 Jazzy, Kilted, Lyrical and Rolling. Humble has no hashes of types, so no message gets to it or from
it.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import re
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from manyhands.extras import require
from manyhands.launch.bridges.rosbag import (
    LATEST,
    POSE,
    RosTopic,
    device_topics,
    joined,
    motion_rows,
    ros_name,
    ros_types,
    serialiser,
    whole_rows,
)
from manyhands.launch.look.page.feed import BroadcastFollower, SessionTime
from manyhands.launch.look.page.pointer import DEMANDS_PER_S, Hold, Holding, hold_of
from manyhands.launch.look.page.security import ViewError, is_loopback
from manyhands.launch.recordings.recording import Array
from manyhands.launch.run.running import Running
from manyhands.nodes.kernel.orientation import unit
from manyhands.nodes.monitor.session_state import About, LiveSession
from manyhands.nodes.recorder.format import CARTESIAN, recorded_of
from manyhands.protocol.channels import AXIS_NAMES, DISPLACEMENT, FORCE, ORIENTATION, QUATERNION_NAMES, TORQUE
from manyhands.protocol.clock import Clock, Instant, RealtimeClock
from manyhands.protocol.messages import Observation, Role

ROUTER: Final = "localhost:7447"
"""The router of Zenoh at which ROS 2 looks for one by default."""

DOMAIN_VARIABLE: Final = "ROS_DOMAIN_ID"
MOST_DOMAIN: Final = 232
"""The variable of the environment that states the domain of ROS 2, 0 without it, and the greatest domain."""

NODE: Final = "manyhands"
"""The name of the node as which a session appears in ROS 2, in the namespace of the session."""

MAX_SERVO_BYTES: Final = 1024
"""The longest message of ``servo_cp`` that is read: a pose has 60 bytes, its stamp and its frame's name the rest."""

MAX_ZENOH_BYTES: Final = 2**20
"""The longest message that Zenoh puts together from fragments."""

MOST_SAMPLES: Final = 16
"""The samples of a device that are kept until the next look; older ones are dropped."""

MOST_TICKS: Final = 256
"""The ticks of a device that wait for the force of one of its couplings, at most."""

_OF_TURNS: Final = ((ORIENTATION, len(QUATERNION_NAMES)), (TORQUE, len(AXIS_NAMES)))
_ATTACHMENT: Final = struct.Struct("<qqB16s")  # sequence number, ns since 1970, length of the id, the id
_ID_BYTES: Final = 16
_PUBLISHED: Final = "2::,10:,:,:,,"  # quality of service: best effort, volatile, the last ten
_SUBSCRIBED: Final = "::,1:,:,:,,"  # reliable, volatile, the last one
_ADDRESS: Final = re.compile(r"(\[[\w:.%]+\]|[\w.-]+):(\d{1,5})", re.ASCII)


@dataclass(frozen=True)
class RosNode:
    """A node of ROS 2 in one session of Zenoh.

    Attributes:
        domain: of ROS 2.
        zenoh_id: of the session of Zenoh.
        namespace: of the node, such as ``/session``.
    """

    domain: int
    zenoh_id: str
    namespace: str

    def token(self) -> str:
        """The key of its liveliness token."""
        return self._token(0, "NN")

    def publisher_token(self, number: int, topic: RosTopic, type_hash: str) -> str:
        """The key of the liveliness token of its publisher of this number."""
        return self._token(number, "MP", topic, type_hash, _PUBLISHED)

    def subscription_token(self, number: int, topic: RosTopic, type_hash: str) -> str:
        """The key of the liveliness token of its subscription of this number."""
        return self._token(number, "MS", topic, type_hash, _SUBSCRIBED)

    def _token(self, number: int, kind: str, topic: RosTopic | None = None, *of_topic: str) -> str:
        parts = ["@ros2_lv", str(self.domain), self.zenoh_id, "0", str(number), kind]
        parts += ["%", _mangled(self.namespace), NODE]  # no enclave
        if topic is not None:
            parts += [_mangled(topic.name), dds_type(topic.type), *of_topic]
        return "/".join(parts)


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def dds_type(type_: str) -> str:
    """The name of a type in keys: ``geometry_msgs::msg::dds_::PoseStamped_`` for ``geometry_msgs/msg/PoseStamped``."""
    package, folder, name = type_.split("/")
    return f"{package}::{folder}::dds_::{name}_"


def topic_key(domain: int, topic: RosTopic, type_hash: str) -> str:
    """The key of a topic's samples."""
    return f"{domain}{topic.name}/{dds_type(topic.type)}/{type_hash}"


def attachment(sequence: int, sent: int, publisher: bytes) -> bytes:
    """The attachment of a sample: its sequence number from 1 on, the time of sending in ns since 1970, the id."""
    return _ATTACHMENT.pack(sequence, sent, _ID_BYTES, publisher)


def publisher_of(found: bytes) -> bytes | None:
    """The publisher's id in a sample's attachment; None where the attachment has a different layout."""
    if len(found) != _ATTACHMENT.size:
        return None
    _, _, length, publisher = _ATTACHMENT.unpack(found)
    return publisher if length == _ID_BYTES else None


def publisher_id(token: str) -> bytes:
    """An id of the publisher with this liveliness token; others only compare it."""
    return hashlib.blake2b(token.encode(), digest_size=_ID_BYTES).digest()


def servo_topic(session: str, device: str, axes: tuple[str, ...]) -> RosTopic:
    """The topic by which a device is held."""
    return RosTopic(f"/{ros_name(session)}/{ros_name(device)}/servo_cp", POSE, device, axes)


def holdable(about: About) -> tuple[str, ...]:
    """The devices that ROS 2 can hold: those that a page could, whose position is a point of up to three axes.

    A pose has metres, so none of these axes turns.
    """
    ports = {device: about.nodes[device].ports for device in about.grips}
    return tuple(device for device, own in ports.items() if len(own) <= CARTESIAN and not {*own} & {*about.turning})


def read_pose(data: bytes) -> tuple[str, tuple[float, float, float], tuple[float, float, float, float]] | None:
    """The frame, the position (m) and the orientation (w, x, y, z) of a geometry_msgs/PoseStamped.

    None where these bytes are no such message. The encapsulation is that of plain CDR, of either byte order. The four
    numbers of the orientation must be there, whatever they are.
    """
    if len(data) > MAX_SERVO_BYTES or len(data) < 4 or data[0] != 0 or data[1] > 1:
        return None
    body, order = data[4:], "<" if data[1] else ">"
    try:
        (length,) = struct.unpack_from(f"{order}I", body, 8)  # behind the stamp
        end = 12 + length
        numbers = struct.unpack_from(f"{order}7d", body, end + -end % 8)
        if length < 1 or end + -end % 8 + 56 != len(body) or body[end - 1] != 0:
            return None
        frame = body[12 : end - 1].decode()
    except (struct.error, UnicodeDecodeError):
        return None
    x, y, z, w = numbers[3:]
    return frame, numbers[:3], (w, x, y, z)


@dataclass(frozen=True)
class RosMessage:
    """A message to publish: its topic, and its CDR."""

    topic: RosTopic
    data: bytes


def domain_of(environment: Mapping[str, str]) -> int:
    """The domain of ROS 2 that the environment states.

    Raises:
        ViewError: it states none that there is.
    """
    text = environment.get(DOMAIN_VARIABLE, "") or "0"
    if not (text.isascii() and text.isdigit() and len(text) <= 8 and int(text) <= MOST_DOMAIN):
        raise ViewError(f"{DOMAIN_VARIABLE}: found {text[:32]!r}; expected a whole number from 0 to {MOST_DOMAIN}")
    return int(text)


class RosMessages:
    """Makes the messages of a session from the frames of its broadcast. Pure.

    Attributes:
        topics: all topics.
        unfit: number of traces that did not have this session's shape, and of ticks beyond the times of ROS 2.
    """

    def __init__(self, about: About, every: int, typestore: Any) -> None:
        """Begin without any frame.

        Args:
            about: the session.
            every: of the ticks of a trace, those that are multiples of this are sent.
            typestore: of :func:`~manyhands.launch.bridges.rosbag.ros_types`.

        Raises:
            RecordingError: two devices would have one namespace in ROS 2.
        """
        self._recorded, self._session, self._every = recorded_of(about), LiveSession(about), every
        self._time, self.unfit = SessionTime(self._recorded), 0
        self._devices = device_topics(about.session, self._recorded.devices, about.turning, about.hands, about.sensed)
        parts = (part for parts in self._devices.values() for part in parts)
        live = ((one.motion, one.exerted, one.sent) for one in parts)  # a bag alone has velocities
        self.topics = [topic for topics in live for topic in topics if topic is not None]
        self._serialise = {topic: serialiser(typestore, topic) for topic in self.topics}
        devices = self._recorded.devices
        axes = {axis: (device, place) for device, own in devices.items() for place, axis in enumerate(own)}
        self._sent_by = {
            node: [axes[column] for column in columns]
            for node, role in self._recorded.roles.items()
            if role is Role.COUPLING
            for topic, columns in about.topics(node).items()
            if topic.trace == FORCE
        }
        self._waiting: dict[str, dict[int, Array]] = {device: {} for device in self._devices}

    def take(self, frame: bytes, now: Instant, wall: int, wanted: Callable[[RosTopic], bool]) -> Iterator[RosMessage]:
        """Take in a frame, and make its messages.

        Args:
            frame: of the broadcast.
            now: when it came.
            wall: the same in ns since 1970.
            wanted: whether anybody receives a topic; messages of others are not made.
        """
        observation = self._session.take(frame, now)
        if not isinstance(observation, Observation):
            return
        at = self._time.take(observation, wall)
        if at is None or at >= LATEST:
            if self._time.start is not None:
                self.unfit += 1
            return
        node = observation.node
        if node in self._devices:
            yield from self._measured(observation, wanted)
        elif node in self._sent_by:
            yield from self._sent(observation, wanted)

    def _measured(self, observation: Observation, wanted: Callable[[RosTopic], bool]) -> Iterator[RosMessage]:
        node = observation.node
        width = len(self._recorded.devices[node])
        x, f = (self._kept(observation, name, width) for name in (DISPLACEMENT, FORCE))
        both = x is not None and any(wanted(part.motion) for part in self._devices[node])
        if both and x is not None and f is not None and len(f[1]) != len(x[1]):
            self.unfit += 1
            f = None
        for part in self._devices[node]:
            moved, exerted = (None if kept is None else part.of(kept[1]) for kept in (x, f))
            if part.motion.oriented:
                R, torque = (self._kept(observation, name, w) for name, w in _OF_TURNS)
                moved = self._joined(moved, R)
                if part.exerted is not None and part.exerted.oriented:
                    exerted = self._joined(exerted, torque)
            if x is not None and moved is not None and wanted(part.motion):
                yield from self._messages(part.motion, x[0], motion_rows(part.motion, moved, None, exerted))
            if f is not None and exerted is not None and part.exerted is not None and wanted(part.exerted):
                yield from self._messages(part.exerted, f[0], exerted)

    def _joined(self, values: Array | None, turn: tuple[list[int], Array] | None) -> Array | None:
        """The rows of an oriented topic; None where one of both is missing, or has other ticks."""
        if values is not None and turn is not None and len(turn[1]) != len(values):
            self.unfit += 1
            return None
        return joined(values, None if turn is None else turn[1])

    def _sent(self, observation: Observation, wanted: Callable[[RosTopic], bool]) -> Iterator[RosMessage]:
        """The forces of a coupling; a tick is complete when every coupling of the device has shown it."""
        places = self._sent_by[observation.node]
        kept = self._kept(observation, FORCE, len(places))
        if kept is None:
            return
        ticks, values = kept
        for device in dict.fromkeys(device for device, _ in places):
            parts, waiting = [part for part in self._devices[device] if wanted(part.sent)], self._waiting[device]
            if not parts:
                continue
            own = [column for column, (of, _) in enumerate(places) if of == device]
            axes = [places[column][1] for column in own]
            whole: list[tuple[int, Array]] = []
            for tick, row in zip(ticks, values[:, own], strict=True):
                force = waiting.setdefault(tick, np.full(len(self._recorded.devices[device]), np.nan))
                force[axes] = row
                if np.isfinite(force).all():
                    whole.append((tick, waiting.pop(tick)))
            while len(waiting) > MOST_TICKS:
                del waiting[next(iter(waiting))]
            for part in parts if whole else ():
                forces = part.of(np.stack([force for _, force in whole]))
                yield from self._messages(part.sent, [tick for tick, _ in whole], forces)

    def _kept(self, observation: Observation, trace: str, width: int) -> tuple[list[int], Array] | None:
        """The ticks of a trace that are sent, and their rows; None where the trace is missing, or of a wrong shape."""
        values = observation.traces.get(trace)
        if values is None:
            return None
        if values.ndim != 2 or values.shape[1] != width or len(values) > observation.tick:
            self.unfit += 1
            return None
        first = observation.tick - len(values)
        kept = slice(-first % self._every, None, self._every)
        return list(range(first, observation.tick))[kept], values[kept]

    def _messages(self, topic: RosTopic, ticks: Sequence[int], values: Array) -> Iterator[RosMessage]:
        serialise = self._serialise[topic]
        for row in np.flatnonzero(whole_rows(topic, values)).tolist():
            stamp = self._time.of(topic.device, ticks[row])
            if stamp is not None and stamp < LATEST:
                yield RosMessage(topic, serialise(stamp, values[row].tolist()))


@dataclass(frozen=True)
class ServoSample:
    """A sample that came for ``servo_cp``: the type and hash of its key, its attachment and its bytes.

    ``data`` is None where the message is longer than :data:`MAX_SERVO_BYTES`.
    """

    type: str
    attachment: bytes
    data: bytes | None


class Servo:
    """What samples of ``servo_cp`` ask of the devices. Pure.

    Attributes:
        refused: samples that were ignored, by reason.
    """

    def __init__(self, about: About, type_hash: str, refused: Counter[str]) -> None:
        """For the devices of ``about``; ``type_hash`` is that of the messages, ``refused`` counts others."""
        self._about, self.refused = about, refused
        self._type = f"{dds_type(POSE)}/{type_hash}"

    def holds(self, device: str, samples: Iterable[ServoSample]) -> dict[int, Hold]:
        """The latest request of each publisher, by the publisher's number."""
        out: dict[int, Hold] = {}
        for sample in samples:
            publisher = publisher_of(sample.attachment)
            if sample.type != self._type:
                self.refused["servo_wrong_type"] += 1
            elif publisher is None:
                self.refused["servo_no_attachment"] += 1
            elif (hold := self._hold(device, sample.data)) is not None:
                out[int.from_bytes(publisher)] = hold
        return out

    def _hold(self, device: str, data: bytes | None) -> Hold | None:
        if data is None:
            self.refused["servo_too_long"] += 1
            return None
        pose = read_pose(data)
        if pose is None or not all(map(math.isfinite, pose[1])):
            self.refused["servo_no_pose"] += 1
            return None
        frame, position, orientation = pose
        if frame not in ("", device):
            self.refused["servo_other_frame"] += 1
            return None
        # the nearest point that the device can reach: it has no extent along axes that it does not have
        hold = hold_of(device, position[: len(self._about.nodes[device].ports)], self._about)
        if not isinstance(hold, Hold):
            return None
        # an orientation that is none turns nothing, as one of a device that has none
        return replace(hold, turn=unit(orientation)) if device in self._about.hands else hold


@dataclass(frozen=True)
class ZenohAccess:
    """How Zenoh is joined.

    Attributes:
        address: ``HOST:PORT``, reached by TCP.
        listens: whether to listen there, as a peer; otherwise a router there is connected to, and no port is opened.
    """

    address: str
    listens: bool = False

    def __post_init__(self) -> None:
        """Check the address.

        Raises:
            ViewError: it is none.
        """
        found = _ADDRESS.fullmatch(self.address)
        if found is None or not 0 < int(found[2]) < 2**16:
            option = "--port" if self.listens else "--router"
            raise ViewError(f"{option}: found {self.address!r:.100}; expected HOST:PORT, such as {ROUTER}")

    @property
    def is_local(self) -> bool:
        """Whether the address is this machine's own."""
        return is_loopback(self.address.rpartition(":")[0].strip("[]"))

    def settings(self) -> dict[str, str]:
        """The settings of Zenoh that are not its defaults, as JSON: nobody is looked for, nothing else listens."""
        one, none = f'["tcp/{self.address}"]', "[]"
        return {
            "mode": '"peer"' if self.listens else '"client"',
            "listen/endpoints": one if self.listens else none,
            "connect/endpoints": none if self.listens else one,
            "scouting/multicast/enabled": "false",
            "scouting/gossip/enabled": "false",
            "transport/shared_memory/enabled": "false",
            "transport/link/rx/max_message_size": str(MAX_ZENOH_BYTES),
        }


@dataclass
class _Publisher:
    """A publisher of Zenoh with its id in ROS 2, and the number of its messages."""

    publisher: Any
    id: bytes
    count: int = 0

    def put(self, data: bytes, now: int) -> None:
        self.count += 1
        self.publisher.put(data, attachment=attachment(self.count, now, self.id))


class RosBridge:
    """Publishes a session in ROS 2, and takes in the poses by which ROS 2 holds devices; eclipse-zenoh's threads send.

    Attributes:
        over: whether the session is over.
    """

    def __init__(
        self, running: Running, access: ZenohAccess, domain: int, every: int, servo: bool, refused: Counter[str]
    ) -> None:
        """Join Zenoh, and declare the session's node with its topics.

        Args:
            running: the session.
            access: how Zenoh is joined.
            domain: of ROS 2.
            every: of the ticks of a trace, those that are multiples of this are sent.
            servo: whether ROS 2 may hold devices.
            refused: counts samples that were ignored, by reason.

        Raises:
            MissingExtra: eclipse-zenoh or rosbags is not installed.
            RecordingError: two devices would have one namespace in ROS 2.
            ViewError: the router cannot be reached, or the port is not free.
            TransportError: the pointer of a device cannot be connected.
        """
        typestore, about = ros_types(), running.about
        self.over = False
        self._messages = RosMessages(about, every, typestore)
        self._servo = Servo(about, typestore.hash_rihs01(POSE), refused)
        self._holding: Holding | None = None
        self._publishers: dict[RosTopic, _Publisher] = {}
        self._samples: dict[str, Any] = {}
        with ExitStack() as opened:
            session = opened.enter_context(closing(_opened(access)))
            node = RosNode(domain, str(session.zid()), f"/{ros_name(about.session)}")
            self._tokens = [session.liveliness().declare_token(node.token())]
            for topic in self._messages.topics:
                self._publish(session, node, topic, typestore.hash_rihs01(topic.type))
            if servo and holdable(about):
                self._holding = opened.enter_context(closing(Holding(running.directory, about)))
                for device in holdable(about):
                    topic = servo_topic(about.session, device, about.nodes[device].ports)
                    self._subscribe(session, node, topic, typestore.hash_rihs01(topic.type))
            self._opened = opened.pop_all()

    def _publish(self, session: Any, node: RosNode, topic: RosTopic, type_hash: str) -> None:
        import zenoh

        token = node.publisher_token(len(self._tokens), topic, type_hash)
        publisher = session.declare_publisher(
            topic_key(node.domain, topic, type_hash),
            congestion_control=zenoh.CongestionControl.DROP,  # nobody waits for a slow receiver
            reliability=zenoh.Reliability.BEST_EFFORT,
        )
        self._publishers[topic] = _Publisher(publisher, publisher_id(token))
        self._tokens.append(session.liveliness().declare_token(token))

    def _subscribe(self, session: Any, node: RosNode, topic: RosTopic, type_hash: str) -> None:
        import zenoh

        # of any type, so that a wrong one is counted
        ring: Any = zenoh.handlers.RingChannel(MOST_SAMPLES)
        self._samples[topic.device] = session.declare_subscriber(f"{node.domain}{topic.name}/*/*", ring)
        token = node.subscription_token(len(self._tokens), topic, type_hash)
        self._tokens.append(session.liveliness().declare_token(token))

    @property
    def topics(self) -> int:
        """The number of its topics."""
        return len(self._publishers) + len(self._samples)

    def take(self, frame: bytes, now: Instant) -> None:
        """Publish what a frame of the broadcast holds, for those who have subscribed to it."""
        wall = time.time_ns()
        for message in self._messages.take(frame, now, wall, self._wanted):
            self._publishers[message.topic].put(message.data, wall)

    def look(self, now: Instant) -> None:
        """Let go of devices whose holder has fallen silent."""
        if self._holding is not None:
            self._holding.expire(now)

    def receive(self, now: Instant) -> None:
        """Take in the samples that have come, and hold the devices where they ask for it."""
        if self._holding is None:
            return
        for device, subscriber in self._samples.items():
            for holder, hold in self._servo.holds(device, _samples(subscriber)).items():
                if self._holding.hold(holder, hold, now) is not None:
                    self._servo.refused["servo_not_held"] += 1

    async def keep_receiving(self, clock: Clock) -> None:
        """Take in samples again and again, as often as a page may send, until cancelled."""
        while True:
            await asyncio.sleep(1.0 / DEMANDS_PER_S)
            self.receive(clock.now())

    def _wanted(self, topic: RosTopic) -> bool:
        return bool(self._publishers[topic].publisher.matching_status)

    def close(self) -> None:
        """Let go of all devices, and leave Zenoh. A second call does nothing."""
        self._opened.close()


def _samples(subscriber: Any) -> Iterator[ServoSample]:
    for _ in range(MOST_SAMPLES):
        sample = subscriber.try_recv()
        if sample is None:
            return
        kind, payload, found = "/".join(str(sample.key_expr).rsplit("/", 2)[1:]), sample.payload, sample.attachment
        short = found is not None and len(found) <= _ATTACHMENT.size
        yield ServoSample(
            kind,
            found.to_bytes() if short else b"",
            payload.to_bytes() if len(payload) <= MAX_SERVO_BYTES else None,
        )


def _opened(access: ZenohAccess) -> Any:
    """A session of Zenoh.

    Raises:
        ViewError: it cannot be joined.
    """
    import zenoh

    config = zenoh.Config()
    for key, value in access.settings().items():
        config.insert_json5(key, value)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if access.listens:
            why = f"--port: cannot listen at {access.address}; expected a port that is free"
        else:
            why = (
                f"--router: found no router of Zenoh at {access.address}; start one with: ros2 run rmw_zenoh_cpp "
                "rmw_zenohd; or let ROS 2 connect to this program, with --port"
            )
        raise ViewError(why) from error


def serve_ros(
    running: Running,
    access: ZenohAccess,
    domain: int,
    every: int,
    servo: bool,
    ready: Callable[[int], None],
    refused: Counter[str],
) -> None:
    """Publish a session in ROS 2 until a signal ends it.

    Args:
        running: the session.
        access: how Zenoh is joined.
        domain: of ROS 2.
        every: of the ticks of a trace, those that are multiples of this are sent.
        servo: whether ROS 2 may hold the devices that a page could.
        ready: called with the number of topics as soon as they are there.
        refused: counts samples that were ignored, by reason.

    Raises:
        MissingExtra: eclipse-zenoh or rosbags is not installed.
        RecordingError: two devices would have one namespace in ROS 2.
        ViewError: the router cannot be reached, or the port is not free.
        TransportError: the session's broadcast, or the pointer of a device, cannot be connected.
    """
    require("ros")
    clock = RealtimeClock()
    with (
        closing(RosBridge(running, access, domain, every, servo, refused)) as bridge,
        closing(BroadcastFollower(running, clock, bridge)) as follower,
    ):
        asyncio.run(_serve(bridge, follower, lambda: ready(bridge.topics)))


async def _serve(bridge: RosBridge, follower: BroadcastFollower, ready: Callable[[], None]) -> None:
    tasks = [asyncio.create_task(follower.run()), asyncio.create_task(bridge.keep_receiving(follower.clock))]
    ready()
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
