"""dora: an output for each direction of a link in a dataflow that its daemon runs, frames as Arrow arrays."""

import importlib.metadata
from collections import deque

import pyarrow
from chain import Peer
from dora import Node


class DoraWire:
    """A :class:`chain.Wire`."""

    def __init__(self, node: str, peers: list[Peer]) -> None:
        self.version = f"dora-rs {importlib.metadata.version('dora-rs')}"
        self._node = Node()
        self._heard: dict[str, deque[bytes]] = {peer.name: deque() for peer in peers}

    def send(self, peer: str, frame: bytes) -> None:
        """See :class:`chain.Wire`."""
        self._node.send_output(f"to_{peer}", pyarrow.array(memoryview(frame), pyarrow.uint8()))

    def receive(self, peer: str, wait: float) -> bytes | None:
        """See :class:`chain.Wire`; dora has one queue for all inputs."""
        heard = self._heard[peer]
        while not heard:
            event = self._node.next(wait)
            if event is None or event["type"] == "ERROR":  # nothing within the time
                return None
            if event["type"] == "INPUT":
                frame = event["value"].to_numpy(zero_copy_only=False).tobytes()
                self._heard[event["id"].removeprefix("from_")].append(frame)
        return heard.popleft()


def open_wire(node: str, peers: list[Peer], folder: str, port: int) -> DoraWire:
    """The daemon starts all nodes of a dataflow together."""
    return DoraWire(node, peers)
