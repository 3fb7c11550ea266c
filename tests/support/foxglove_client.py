"""A client of live connections, written from the specification of the Foxglove WebSocket protocol.

The specification is docs/spec.md of foxglove/ws-protocol ([Foxglove2023]_). Text messages are JSON
objects with an ``op``; binary ones begin with a byte: 1 stands for the message of a subscription, 2 for the time.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from websockets.sync.client import ClientConnection, connect

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
PATIENCE = 60.0  # s

_MESSAGE = struct.Struct("<BIQ")  # opcode, subscription, time in ns
_TIME = struct.Struct("<BQ")


@dataclass(frozen=True)
class Message:
    """A message of a channel: its topic, its time in ns, and its data."""

    topic: str
    time: int
    data: bytes


@dataclass(frozen=True)
class ServerTime:
    """The server's time, ns."""

    time: int


class Client:
    """A connected client.

    Attributes:
        info: what the server says of itself.
        channels: its channels by topic, as it advertises them.
    """

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._topics = socket, dict[int, str]()
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        while not self.channels:
            self._take(socket.recv(PATIENCE))

    @property
    def subprotocol(self) -> str | None:
        return self._socket.subprotocol

    def subscribe(self, *topics: str) -> None:
        """Ask for the messages of these topics."""
        begin = len(self._topics)
        for number, topic in enumerate(topics, begin):
            self._topics[number] = topic
        wanted = [{"id": number, "channelId": self.channels[topic]["id"]} for number, topic in enumerate(topics, begin)]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def messages(self, patience: float = PATIENCE) -> Iterator[Message | ServerTime]:
        """Messages and times as they come; TimeoutError where none comes for ``patience``, s."""
        while True:
            found = self._take(self._socket.recv(patience))
            if found is not None:
                yield found

    def _take(self, data: str | bytes) -> Message | ServerTime | None:
        if isinstance(data, str):
            match json.loads(data):
                case {"op": "serverInfo", **info}:
                    self.info = info
                case {"op": "advertise", "channels": list(channels)}:
                    self.channels |= {channel["topic"]: channel for channel in channels}
            return None
        if data[0] == 1:
            _, number, time = _MESSAGE.unpack_from(data)
            return Message(self._topics[number], time, data[_MESSAGE.size :])
        if data[0] == 2:
            return ServerTime(_TIME.unpack(data)[1])
        raise AssertionError(f"found a binary message of the kind {data[0]}, which the specification does not have")


@contextmanager
def connected(address: str, headers: Mapping[str, str] | None = None) -> Iterator[Client]:
    """A client that has received the server's channels."""
    with connect(
        address, subprotocols=list(SUBPROTOCOLS), additional_headers=headers, open_timeout=PATIENCE, close_timeout=5
    ) as socket:
        yield Client(socket)
