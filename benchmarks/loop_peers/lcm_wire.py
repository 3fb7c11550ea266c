"""LCM: UDP multicast that stays on the machine; a network of its own for each direction of a link.

On one common network every process would be woken by every message of all others.
"""

import importlib.metadata

import lcm
from chain import Peer

CHANNEL = "FRAME"
_GROUP = "239.255.76.67"


class LcmWire:
    """A :class:`chain.Wire`."""

    def __init__(self, peers: list[Peer], port: int) -> None:
        self.version = f"lcm {importlib.metadata.version('lcm')}"
        self._heard: list[bytes] = []
        self._out, self._in = {}, {}
        for peer in peers:
            down, up = (f"udpm://{_GROUP}:{port + 2 * peer.link + way}?ttl=0" for way in (0, 1))
            self._out[peer.name], self._in[peer.name] = (
                (lcm.LCM(down), lcm.LCM(up)) if peer.binds else (lcm.LCM(up), lcm.LCM(down))
            )
            self._in[peer.name].subscribe(CHANNEL, lambda _channel, data: self._heard.append(data))

    def send(self, peer: str, frame: bytes) -> None:
        """See :class:`chain.Wire`."""
        self._out[peer].publish(CHANNEL, frame)

    def receive(self, peer: str, wait: float) -> bytes | None:
        """See :class:`chain.Wire`."""
        return self._heard.pop() if self._in[peer].handle_timeout(int(wait * 1000)) > 0 else None


def open_wire(node: str, peers: list[Peer], folder: str, port: int) -> LcmWire:
    """Join the groups; only members of a group are received."""
    return LcmWire(peers, port)
