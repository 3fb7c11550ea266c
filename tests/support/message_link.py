"""A link to a node under test, by messages instead of frames."""

from __future__ import annotations

from collections import deque

from manyhands.protocol.clock import Duration
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Message


class MessageLink:
    """A link whose other end a test holds: messages to come, and messages sent."""

    def __init__(self) -> None:
        self.coming: deque[bytes] = deque()
        self.said: list[Message] = []

    def say(self, *messages: Message) -> None:
        self.coming.extend(map(encode, messages))

    def recv(self, _timeout: Duration | None) -> bytes | None:
        return self.coming.popleft() if self.coming else None

    def send(self, frame: bytes) -> bool:
        self.said.append(decode(frame, MAX_CONTROL_BYTES))  # type: ignore[arg-type]
        return True

    def close(self) -> None:
        pass
