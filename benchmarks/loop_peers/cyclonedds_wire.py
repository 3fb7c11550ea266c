"""Cyclone DDS, the middleware under ROS 2: a topic for each direction of a link, reliable; a wait set a reader."""

import importlib.metadata
import threading
from dataclasses import dataclass

from chain import Peer
from cyclonedds.core import InstanceState, Listener, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import sequence, uint8
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class Frame(IdlStruct, typename="Frame"):
    """What a topic carries."""

    data: sequence[uint8]


class CycloneWire:
    """A :class:`chain.Wire`."""

    def __init__(self, node: str, peers: list[Peer], domain: int) -> None:
        self.version = f"cyclonedds {importlib.metadata.version('cyclonedds')}"
        participant = DomainParticipant(domain)
        qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(16))
        self._writers, self._readers, self._waits = {}, {}, {}
        self._matched = []
        for peer in peers:
            reader = DataReader(participant, Topic(participant, f"{peer.name}_{node}", Frame), qos=qos)
            self._readers[peer.name] = reader
            self._waits[peer.name] = WaitSet(participant)
            fresh = ReadCondition(reader, ViewState.Any | InstanceState.Alive | SampleState.NotRead)
            self._waits[peer.name].attach(fresh)
            matched = threading.Event()
            listener = Listener(on_publication_matched=lambda _writer, _status, matched=matched: matched.set())
            topic = Topic(participant, f"{node}_{peer.name}", Frame)
            self._writers[peer.name] = DataWriter(participant, topic, qos=qos, listener=listener)
            self._matched.append(matched)
        for matched in self._matched:
            matched.wait()

    def send(self, peer: str, frame: bytes) -> None:
        """See :class:`chain.Wire`."""
        self._writers[peer].write(Frame(frame))

    def receive(self, peer: str, wait: float) -> bytes | None:
        """See :class:`chain.Wire`."""
        if not self._waits[peer].wait(duration(seconds=wait)):
            return None
        taken = self._readers[peer].take(1)
        return bytes(taken[0].data) if taken else None


def open_wire(node: str, peers: list[Peer], folder: str, port: int) -> CycloneWire:
    """Open, and wait until every peer reads; the run has a DDS domain of its own."""
    return CycloneWire(node, peers, port % 200)
