"""Zenoh: one session a process in peer mode, its neighbours named instead of searched for, express publishers."""

import importlib.metadata
import json
import threading

import zenoh
from chain import Peer


class ZenohWire:
    """A :class:`chain.Wire`."""

    def __init__(self, node: str, peers: list[Peer], port: int) -> None:
        self.version = f"eclipse-zenoh {importlib.metadata.version('eclipse-zenoh')}"
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("scouting/multicast/enabled", "false")
        for side, binds in (("listen", True), ("connect", False)):
            ends = [f"tcp/127.0.0.1:{port + peer.link}" for peer in peers if peer.binds is binds]
            config.insert_json5(f"{side}/endpoints", json.dumps(ends))
        config.insert_json5("connect/timeout_ms", "-1")  # a peer may start later
        self._session = zenoh.open(config)
        self._subscribers = {p.name: self._session.declare_subscriber(f"loop/{p.name}/{node}") for p in peers}
        self._publishers = {
            p.name: self._session.declare_publisher(
                f"loop/{node}/{p.name}",
                express=True,
                congestion_control=zenoh.CongestionControl.BLOCK,
                reliability=zenoh.Reliability.RELIABLE,
            )
            for p in peers
        }
        for publisher in self._publishers.values():
            matched = threading.Event()
            listener = publisher.declare_matching_listener(
                lambda status, matched=matched: matched.set() if status.matching else None
            )
            if not publisher.matching_status.matching:
                matched.wait()
            listener.undeclare()

    def send(self, peer: str, frame: bytes) -> None:
        """See :class:`chain.Wire`."""
        self._publishers[peer].put(frame)

    def receive(self, peer: str, wait: float) -> bytes | None:
        """See :class:`chain.Wire`; zenoh's own receive has no time limit."""
        return self._subscribers[peer].recv().payload.to_bytes()


def open_wire(node: str, peers: list[Peer], folder: str, port: int) -> ZenohWire:
    """Open, and wait until every peer has subscribed."""
    return ZenohWire(node, peers, port)
