"""A session around a conductor whose nodes only keep the protocol of joining, leaving and coming back.

Nothing is sent at once: the messages of nodes, the messages to them, and the ends of their processes wait in queues. A
test decides which comes next. Messages of a process from before its death still arrive.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field

from manyhands.launch.plan.topology import Topology
from manyhands.launch.run.conductor import Conductor
from manyhands.launch.run.states import (
    Instruction,
    Kill,
    KillProcess,
    NodeState,
    ReleaseName,
    Send,
    SessionPhase,
    StartProcess,
    Terminate,
)
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Connect,
    Message,
    NodeHello,
    Offer,
    Ready,
    Return,
    Shift,
    Start,
    Stop,
    Welcome,
)

CERTIFICATE = "c"


def hello_of(graph: Topology, node: str, endpoints: dict[str, str], pid: int = 1) -> NodeHello:
    """The first message of ``node``."""
    return NodeHello(PROTOCOL_VERSION, CERTIFICATE, "s", node, graph.nodes[node], pid, endpoints)


@dataclass
class FakeProcess:
    """One process of a node.

    Attributes:
        bound: its own endpoint for each peer that connects to it.
        connected: the endpoints that it has connected to, by peer.
        absent: peers that were reported absent to it.
        connects: whether it has received its peers' endpoints.
        ready: whether it has sent Ready.
        starts: the Start messages that it has received.
        shifts: the Shift messages that it has received.
        inbox: messages that it has not read.
    """

    bound: dict[str, str]
    connected: dict[str, str] = field(default_factory=dict)
    absent: set[str] = field(default_factory=set)
    connects: bool = False
    ready: bool = False
    starts: list[Start] = field(default_factory=list)
    shifts: list[Shift] = field(default_factory=list)
    inbox: deque[Message] = field(default_factory=deque)


class FakeSession:
    """The nodes of ``graph``, all of them with processes, and their conductor.

    Attributes:
        conductor: the conductor under test.
        processes: the living processes, by node.
        said: messages of nodes that the conductor has not received yet.
        ended: ends of processes that the conductor has not seen yet.
        killed: nodes whose processes the conductor has killed.
        now: the time, ns.
    """

    def __init__(self, graph: Topology, conductor: Conductor, absent: Collection[str] = ()) -> None:
        """``absent``: nodes that are not started yet."""
        self.graph, self.conductor = graph, conductor
        self.processes: dict[str, FakeProcess] = {}
        self.said: deque[tuple[str, Message]] = deque()
        self.ended: deque[tuple[str, int]] = deque()
        self.killed: list[str] = []
        self.terminated = False
        self.now = 0
        self._places, self._pids = itertools.count(), itertools.count(1)
        for node in graph.nodes:
            if node not in absent:
                self.start(node)
        self.settle()

    def settle(self) -> None:
        """Deliver everything under way, until all queues are empty."""
        while self.said or self.ended or any(process.inbox for process in self.processes.values()):
            while self.deliver():
                pass
            for node in list(self.processes):
                while node in self.processes and self.read(node):
                    pass
            while self.see_end():
                pass

    def deliver(self) -> bool:
        """Give the conductor the next message, if there is one."""
        if self.said:
            sender, message = self.said.popleft()
            self.obey(self.conductor.receive(sender, message, self.now))
            return True
        return False

    def read(self, node: str) -> bool:
        """Let a node read its next message, if there is one."""
        process = self.processes.get(node)
        if process is None or not process.inbox:
            return False
        self._take(node, process, process.inbox.popleft())
        self._say_ready()
        return True

    def see_end(self) -> bool:
        """Report the next end of a process to the conductor, if there is one."""
        if self.ended:
            self.obey(self.conductor.exited(*self.ended.popleft(), self.now))
            return True
        return False

    def kill(self, node: str) -> None:
        """The process of a node dies."""
        if self.processes.pop(node, None) is not None:
            self.ended.append((node, -9))

    def joined(self) -> bool:
        """Whether every node runs and every link leads from one living process to another."""
        return self.goes_on(self.graph.nodes)

    def goes_on(self, nodes: Collection[str]) -> bool:
        """Whether these nodes run, and every link between them leads from one living process to another."""
        return all(
            self.conductor.states[node] is NodeState.RUNNING and self.processes[node].starts for node in nodes
        ) and all(
            self._met(link.binder, link.connector)
            for link in self.graph.links
            if link.binder in nodes and link.connector in nodes
        )

    def _met(self, binder: str, connector: str) -> bool:
        ends = self.processes.get(binder), self.processes.get(connector)
        return all(ends) and ends[0].bound[connector] == ends[1].connected.get(binder)  # type: ignore[union-attr]

    def start(self, node: str) -> None:
        assert node not in self.processes, f"{node} was started while it still runs"
        assert all(ended != node for ended, _ in self.ended), f"{node} was started before its end was seen"
        binds = [link.connector for link in self.graph.links_of(node) if link.binder == node]
        self.processes[node] = FakeProcess({peer: self._place(node, peer) for peer in binds})
        pid = next(self._pids)
        if self.conductor.phase is SessionPhase.RUNNING and node not in self.conductor.remote:
            self.conductor.started(node, pid)
        self.said.append((node, hello_of(self.graph, node, dict(self.processes[node].bound), pid)))

    def _place(self, node: str, peer: str) -> str:
        return f"ipc:///{node}-{peer}.{next(self._places)}"

    def obey(self, instructions: list[Instruction]) -> None:
        for one in instructions:
            match one:
                case Send(node, message):
                    if node in self.processes:
                        self.processes[node].inbox.append(message)
                case StartProcess(node):
                    self.start(node)
                case KillProcess(node):
                    self.killed.append(node)
                    self.kill(node)
                case Terminate() | Kill():
                    self.terminated = True
                    for node in list(self.processes):
                        self.kill(node)
                case ReleaseName():
                    pass

    def _take(self, node: str, process: FakeProcess, message: Message) -> None:
        match message:
            case Connect(endpoints):
                expected = {link.binder for link in self.graph.links_of(node) if link.connector == node}
                assert endpoints.keys() == expected - process.absent, f"{node} was told of {list(endpoints)}"
                process.connected.update(endpoints)
                process.connects = True
            case Absent(peer):
                process.absent.add(peer)
                process.connected.pop(peer, None)
                if peer in process.bound:
                    process.bound[peer] = self._place(node, peer)
                    self.said.append((node, Offer(peer, process.bound[peer])))
            case Return(peer, place):
                assert process.starts, f"{node} was told of a return before it ran"
                process.connected[peer] = place
            case Start():
                process.starts.append(message)
            case Shift():
                process.shifts.append(message)
            case Stop() | Welcome():
                pass
            case _:
                raise AssertionError(f"{node} was told {message}")

    def _say_ready(self) -> None:
        for node, process in self.processes.items():
            links = self.graph.links_of(node)
            peers = {link.binder if link.connector == node else link.connector: link for link in links}
            waited_for = [link for peer, link in peers.items() if peer not in process.absent]
            if process.connects and not process.ready and all(self._met(k.binder, k.connector) for k in waited_for):
                process.ready = True
                self.said.append((node, Ready()))
