"""The live connection of Foxglove: the channels of a recording, over the Foxglove WebSocket protocol.

A running session has the topics, schemas and times of its recording, so that one layout shows both. The JSON of a
message is that of the recording; of the ticks of a trace only every n-th is sent. One more channel, ``health``, has
what an observer computes from telemetry: the health of session and nodes, and what is felt of each wave link.

:class:`LiveMessages` makes the messages and is pure. :class:`FoxgloveServer` hands them to foxglove-sdk, whose threads
serve the clients. The queue of a client is bounded; a client that is too slow misses the oldest messages. Nothing that
a client sends reaches the session.
"""

from __future__ import annotations

import asyncio
import json
import math
import secrets
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import urlencode

from manyhands.extras import require
from manyhands.launch.bridges.relay import MAX_HEAD_BYTES, Relay
from manyhands.launch.look.page.feed import EVERY, BroadcastFollower, SessionTime
from manyhands.launch.look.page.security import Doorstep, Token, ViewError
from manyhands.launch.look.page.server import Connections, address_of, listen
from manyhands.launch.run.running import Running
from manyhands.nodes.kernel.json_number import json_number
from manyhands.nodes.monitor.session_state import About, LiveSession
from manyhands.nodes.recorder.core import Ticks, trace_messages
from manyhands.nodes.recorder.format import (
    MESSAGE_ENCODING,
    SCHEMA_ENCODING,
    SUPERVISOR,
    TICK,
    ChannelAbout,
    encode_condition,
    encode_figures,
    object_schema,
    recorded_of,
)
from manyhands.nodes.recorder.hand_messages import HandMessages
from manyhands.nodes.recorder.scene_messages import SpaceMessages
from manyhands.protocol.channels import CONDITION, TELEMETRY, topic_name
from manyhands.protocol.clock import Instant, RealtimeClock
from manyhands.protocol.messages import Condition, Observation

HEALTH: Final = "health"
"""The name of the channel that a recording does not have; its node is the supervisor."""

_TEXT: Final = {"type": "string"}
_NODE: Final = {
    "type": "object",
    "properties": {
        "health": _TEXT,
        "state": _TEXT,
        TICK: {"type": "integer"},
        "rate": {"type": "number", "description": "ticks a second"},
    },
}
_LINK: Final = {
    "type": "object",
    "properties": {
        "round_trip": {"type": "number", "description": "R, s"},
        "stiffness": {"type": "number", "description": "felt K = 2 b/R, N/m"},
        "mass": {"type": "number", "description": "felt M = b R/2, kg"},
        "tanks": {"type": "array", "items": {"type": "number"}, "description": "of the user's and the world's end, J"},
        "limited": {"type": "integer", "description": "ticks in which a tank limited a wave"},
        "silences": {"type": "integer", "description": "times that an end heard nothing and held the tool"},
        "holding": {"type": "boolean", "description": "whether an end does so now"},
    },
}
HEALTH_SCHEMA: Final = object_schema(
    HEALTH,
    {
        HEALTH: {**_TEXT, "description": "of the session, in a word"},
        "nodes": {"type": "object", "properties": {}, "additionalProperties": _NODE},
        "wave_links": {"type": "object", "properties": {}, "additionalProperties": _LINK},
    },
)
"""Name and text of the schema of the channel :data:`HEALTH`."""

PORT: Final = 8765
"""The port at which Foxglove looks for a live connection by default."""

LEAST_QUEUE: Final = 1024
MOST_QUEUE: Final = 65536
"""Bounds of the number of messages that wait for one client."""

_QUEUED_S: Final = 0.4  # s of the session that fit into a client's queue: four of the supervisor's messages


@dataclass(frozen=True)
class LiveMessage:
    """One message: the full name of its topic, its time in ns since 1970, and its JSON."""

    topic: str
    time: int
    data: bytes


class LiveMessages:
    """Makes the messages of a session from the frames of its broadcast.

    Nothing is sent before the session's time is known.

    Attributes:
        session: the state of the session as far as it is known.
        time: the session's time.
        channels: every channel by its full name.
        unfit: number of traces that did not have this session's shape, and of ticks beyond all times.
    """

    def __init__(self, about: About, every: int = EVERY) -> None:
        """Begin without any frame.

        Args:
            about: the session.
            every: of the ticks of a trace, those that are multiples of this are sent.

        Raises:
            ValueError: ``every`` is below 1.
        """
        if every < 1:
            raise ValueError(f"found one of every {every} ticks; expected at least 1")
        self.session, self._recorded, self._every = LiveSession(about), recorded_of(about), every
        self.time, self.unfit = SessionTime(self._recorded), 0
        self._topics = {node: list(about.topics(node)) for node in about.nodes}
        channels = [self._recorded.channel(node, topic) for node in about.nodes for topic in self._topics[node]]
        channels += [self._recorded.channel(node, TELEMETRY) for node in about.nodes]
        self._shown = self._recorded.space_messages()
        channels += [self._recorded.channel(node, topic) for node, one in self._shown.items() for topic in one.topics]
        channels.append(self._recorded.channel(SUPERVISOR, CONDITION))
        condition = channels[-1]
        self._health = topic_name(about.session, SUPERVISOR, HEALTH)
        channels.append(ChannelAbout(self._health, *HEALTH_SCHEMA, condition.metadata))
        self.channels = {channel.topic: channel for channel in channels}

    @property
    def queue(self) -> int:
        """The number of messages that should wait for one client at most, within its bounds."""
        topics = self._topics.items()
        ticks = {node: _QUEUED_S / self._recorded.period_of(node) / self._every for node in self._topics}
        most = sum(len(own) * math.ceil(ticks[node]) for node, own in topics) + len(self.channels)
        return min(max(most, LEAST_QUEUE), MOST_QUEUE)

    def take(self, frame: bytes, now: Instant, wall: int, wanted: Callable[[str], bool]) -> Iterator[LiveMessage]:
        """Take in a frame, and make its messages.

        Args:
            frame: of the broadcast.
            now: when it came.
            wall: the same in ns since 1970.
            wanted: whether anybody receives a topic; messages of others are not made.
        """
        match self.session.take(frame, now):
            case Observation() as observation:
                yield from self._observed(observation, wall, wanted)
            case Condition() as condition:
                yield from self._conditioned(condition, wall, wanted)

    def _observed(self, observation: Observation, wall: int, wanted: Callable[[str], bool]) -> Iterator[LiveMessage]:
        node, tick, session = observation.node, observation.tick, self._recorded.session
        at = self.time.take(observation, wall)
        if at is None or self.time.start is None:
            if self.time.start is not None:  # a tick beyond all times
                self.unfit += 1
            return
        rows = max((len(trace) for trace in observation.traces.values()), default=0)
        whole: Ticks | None = None
        for topic in self._topics[node]:
            values = observation.traces.get(topic.trace)
            name = topic_name(session, node, topic.name)
            if values is None or not wanted(name):
                continue
            if values.shape != (rows, len(self._recorded.columns(node, topic))) or not rows <= tick:
                self.unfit += 1
                continue
            if whole is None:
                whole = Ticks.of(tick - rows, rows, self.time.start, self._recorded.tick_ns(node))
            kept = slice((rows - tick) % self._every, None, self._every)
            ticks = Ticks(whole.times[kept], whole.sequences[kept], whole.beginnings[kept], whole.lengths[kept])
            if len(ticks.times):
                _, pieces = trace_messages(topic, ticks, values[kept])
                for then, *message in zip(ticks.times.tolist(), *pieces, strict=True):
                    yield LiveMessage(name, then, b"".join(message))
        if node in self._shown:
            yield from self._in_space(observation, self._shown[node], self.time.start, wanted)
        name = topic_name(session, node, TELEMETRY)
        if observation.figures and wanted(name):
            yield LiveMessage(name, at, encode_figures(tick, observation.figures))

    def _in_space(
        self,
        observation: Observation,
        shown: SpaceMessages | HandMessages,
        start: int,
        wanted: Callable[[str], bool],
    ) -> Iterator[LiveMessage]:
        """What shows the scene, or a device that its hand turns, from traces that fit the session."""
        node, tick, traces = observation.node, observation.tick, observation.traces
        full = {topic: topic_name(self._recorded.session, node, topic) for topic in shown.topics}
        topics = [topic for topic, name in full.items() if wanted(name)]
        widths = {topic.trace: len(self._recorded.columns(node, topic)) for topic in self._topics[node]}
        if not topics:
            return
        if len({len(trace) for trace in traces.values()}) > 1 or any(
            len(trace) > tick or trace.shape[1] != widths.get(name) for name, trace in traces.items()
        ):
            self.unfit += 1
            return
        for made in shown.of(tick, traces, start, topics):
            yield LiveMessage(full[made.topic], made.time, made.data)

    def _conditioned(self, condition: Condition, wall: int, wanted: Callable[[str], bool]) -> Iterator[LiveMessage]:
        """A recording has a condition only where it has changed; here each is sent, for clients that come later."""
        tick = self.session.tick
        at = self.time.of(SUPERVISOR, tick)
        at = wall if at is None else at
        name = topic_name(self._recorded.session, SUPERVISOR, CONDITION)
        if wanted(name):
            yield LiveMessage(name, at, encode_condition(tick, condition))
        if wanted(self._health):
            yield LiveMessage(self._health, at, json.dumps(self._well_being(tick), allow_nan=False).encode())

    def _well_being(self, tick: int) -> dict[str, Any]:
        """The health of session and nodes; a rate that is not known yet is left out."""
        session = self.session
        return {
            TICK: tick,
            HEALTH: session.health,
            "nodes": {
                name: {"health": node.health, "state": node.state, TICK: node.tick, **_rate(node.rate)}
                for name, node in session.nodes.items()
            },
            "wave_links": {name: felt.as_plain() for name, felt in session.felt_links.items()},
        }


def _rate(rate: float | None) -> dict[str, float]:
    return {} if (known := json_number(rate)) is None else {"rate": known}


class FoxgloveServer:
    """Serves the messages of one session to Foxglove's clients, in threads of foxglove-sdk.

    It listens at an address of the loopback that is drawn at random from 2²⁴, and at any free port. A page of another
    origin that is open in a browser cannot guess it; :mod:`manyhands.launch.bridges.relay` stands before it, with an
    address that can be given to people.

    Attributes:
        live: makes the messages.
        over: whether the session is over.
        address: where it listens.
    """

    def __init__(self, running: Running, every: int = EVERY) -> None:
        """Listen, and advertise every channel.

        Args:
            running: the session.
            every: of the ticks of a trace, those that are multiples of this are sent.

        Raises:
            ViewError: foxglove-sdk is not installed, or cannot listen.
        """
        sdk, about = _sdk(), running.about
        self.live, self.over = LiveMessages(about, every), False
        self._context = context = sdk.Context()  # its channels are gone with it
        self._channels = {
            topic: sdk.Channel(
                topic,
                schema=sdk.Schema(name=one.schema, encoding=SCHEMA_ENCODING, data=one.schema_text.encode()),
                message_encoding=MESSAGE_ENCODING,
                context=context,
                metadata=dict(one.metadata),
            )
            for topic, one in self.live.channels.items()
        }
        host = f"127.{'.'.join(str(1 + secrets.randbelow(254)) for _ in range(3))}"
        try:
            self._server = sdk.start_server(
                name=f"manyhands {about.session}",
                host=host,
                port=0,
                capabilities=[sdk.websocket.Capability.Time],
                context=context,
                session_id=f"{about.id[:16]}-{about.pid}-{about.started:.0f}",
                message_backlog_size=self.live.queue,
            )
        except RuntimeError as error:
            raise ViewError(f"--foxglove: foxglove-sdk cannot listen: {error}") from error
        self.address = host, self._server.port

    def take(self, frame: bytes, now: Instant) -> None:
        """Send the messages of a frame of the broadcast that came at ``now``, to the clients that receive them."""
        before = self.live.time.latest
        for message in self.live.take(frame, now, time.time_ns(), self._wanted):
            self._channels[message.topic].log(message.data, log_time=message.time)
        latest = self.live.time.latest
        if latest is not None and (before is None or latest > before):
            self._server.broadcast_time(latest)

    def look(self, now: Instant) -> None:
        """Nothing is due without a frame."""

    def _wanted(self, topic: str) -> bool:
        return bool(self._channels[topic].has_sinks())

    def close(self) -> None:
        """End the server and its connections. A second call does nothing."""
        self._server.stop()
        for channel in self._channels.values():
            channel.close()


def serve_foxglove(
    running: Running,
    host: str,
    port: int,
    token: Token | None,
    every: int,
    ready: Callable[[str], None],
    refused: Counter[str],
) -> None:
    """Serve Foxglove's clients until a signal ends the server.

    Args:
        running: the session.
        host: the name or address to listen at.
        port: the port to listen at; 0 for any free one.
        token: the token that clients give; None where the address is enough.
        every: of the ticks of a trace, those that are multiples of this are sent.
        ready: called with the address as soon as clients can connect; the token is not part of it.
        refused: counts refused connections, by reason.

    Raises:
        ViewError: foxglove-sdk is not installed, or the server cannot listen at this address.
        TransportError: the session's broadcast cannot be received.
    """
    clock = RealtimeClock()
    with listen(host, port) as listening, closing(FoxgloveServer(running, every)) as server:
        doorstep = Doorstep(host, listening.getsockname()[1])
        with closing(BroadcastFollower(running, clock, server)) as follower:
            connections = Connections(refused)
            relay = Relay(doorstep, token, server.address, connections, clock)
            asyncio.run(_serve(relay, follower, connections, listening, lambda: ready(_address_of(doorstep))))


async def _serve(
    relay: Relay,
    follower: BroadcastFollower,
    connections: Connections,
    listening: socket.socket,
    ready: Callable[[], None],
) -> None:
    async with await asyncio.start_server(relay.serve, sock=listening, limit=MAX_HEAD_BYTES):
        ending = asyncio.create_task(connections.keep_ending_overdue(follower.clock))
        ready()
        try:
            await follower.run()
        finally:
            ending.cancel()


def application_address(address: str) -> str:
    """The page of Foxglove's own application that connects to a live connection's ``address``."""
    query = urlencode({"ds": "foxglove-websocket", "ds.url": address})
    return f"https://app.foxglove.dev/~/view?{query}"


def _address_of(doorstep: Doorstep) -> str:
    return "ws" + address_of(doorstep, None).removeprefix("http")


def _sdk() -> Any:
    """The module ``foxglove``, which logs errors alone.

    Raises:
        MissingExtra: it is not installed.
    """
    require("foxglove")
    import foxglove

    foxglove.set_log_level("ERROR")  # a client that is none is counted by the relay
    return foxglove
