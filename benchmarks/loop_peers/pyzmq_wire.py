"""Bare pyzmq: a PAIR socket over ipc for each link, blocking receive."""

import zmq
from chain import Peer


class PyzmqWire:
    """A :class:`chain.Wire`."""

    def __init__(self, node: str, peers: list[Peer], folder: str) -> None:
        self.version = f"pyzmq {zmq.__version__}, libzmq {zmq.zmq_version()}"
        self._context = zmq.Context()
        self._sockets = {}
        for peer in peers:
            one = self._context.socket(zmq.PAIR)
            one.setsockopt(zmq.LINGER, 0)
            one.setsockopt(zmq.RCVTIMEO, 100)  # chain.WAIT, set once
            endpoint = f"ipc://{folder}/link{peer.link}"
            if peer.binds:
                one.bind(endpoint)
            else:
                one.connect(endpoint)
            self._sockets[peer.name] = one

    def send(self, peer: str, frame: bytes) -> None:
        """See :class:`chain.Wire`."""
        self._sockets[peer].send(frame, zmq.NOBLOCK)

    def receive(self, peer: str, wait: float) -> bytes | None:
        """See :class:`chain.Wire`."""
        try:
            return self._sockets[peer].recv()
        except zmq.Again:
            return None


def open_wire(node: str, peers: list[Peer], folder: str, port: int) -> PyzmqWire:
    """ZeroMQ queues what is sent before the peer is there: nothing to wait for."""
    return PyzmqWire(node, peers, folder)
