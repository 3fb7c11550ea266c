"""Any messages from nodes and strangers to the conductor, in any order, between the ends of processes, deadlines and
Ctrl-C: it never raises, every message of it can be sent, and a session only moves forward. Nodes come back at most as
often as their restarts allow, and a message of one node moves no other running node.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Final

from draws import Draws
from forger import Forger

import manyhands.launch
from manyhands.launch.plan.topology import Topology, topology
from manyhands.launch.run.conductor import Conductor
from manyhands.launch.run.recovery import Restarts
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
from manyhands.launch.session import load_session
from manyhands.protocol.clock import Duration
from manyhands.protocol.codec import ForeignHello, Received, decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Connect,
    Fault,
    Fetch,
    Figures,
    LinkHello,
    Message,
    NodeHello,
    Offer,
    Ready,
    Refusal,
    Report,
    Return,
    Role,
    Start,
    Telemetry,
    Welcome,
)

MOST_EVENTS: Final = 64
CERTIFICATE: Final = "c0ffee"
SESSION: Final = load_session(Path(manyhands.launch.__file__).parent / "sessions" / "example1-centralised.yaml")
GRAPH: Final[Topology] = topology(SESSION)
NODES: Final = tuple(GRAPH.nodes)
OBSERVERS: Final = {"watch": "ipc:///s/watch"}
STRANGERS: Final = ("stranger", "supervisor", "dx2")
COUPLINGS: Final = tuple(node for node, role in GRAPH.nodes.items() if role is Role.COUPLING)
_ELSEWHERE: Final = {"nobody": frozenset[str](), "a device": frozenset({NODES[0]}), "all": frozenset(NODES)}
RESTARTS: Final = 2
REMOTE: Final = {
    **{name: (remote, 0) for name, remote in _ELSEWHERE.items()},
    **{f"{name}, restarts": (remote, RESTARTS) for name, remote in _ELSEWHERE.items()},
    "a coupling, restarts": (frozenset(COUPLINGS[:1]), RESTARTS),
}
"""Who is started elsewhere, and how often a node may come back."""
ROLES: Final = {**GRAPH.nodes, **dict.fromkeys(OBSERVERS, Role.OBSERVER)}
EVENTS: Final = (
    "good hello",
    "ready",
    "frame",
    "exit",
    "silent",
    "interrupt",
    "too late",
    "all good hellos",
    "all ready",
    "good offer",
    "good return",
    "look",
    "no process",
    "shift",
    "stop",
)
PHASES: Final = (SessionPhase.STARTING, SessionPhase.RUNNING, SessionPhase.ENDING, SessionPhase.OVER)
EXITS: Final = (0, 1, 2, 4, 255, *range(-64, 0))
NOW: Final = (0, 1, 10**15, 2**62)
MOST_FAULTS: Final = 3 * len(NODES) + 2
"""Each node can fail once, end badly once and be given up once, the start can be too late once, and a policy can end
the session once; more would be a flood."""
MOST_STARTS: Final = (RESTARTS + 1) * len(NODES) ** 2
"""A process is started anew when it has died, or when a peer has died that it was shaking hands with."""


def check(data: bytes) -> None:
    """Play the session that ``data`` decides; raise if the conductor breaks one of its promises."""
    play(Draws(data))


def play(draws: Draws) -> None:
    """The same for decisions from anywhere."""
    watch = Watch(*REMOTE[draws.choice(tuple(REMOTE))])
    for _ in range(MOST_EVENTS):
        # a supervisor that has seen the last process end listens no more
        if not draws.more or watch.conductor.phase is SessionPhase.OVER:
            return
        match draws.choice(EVENTS):
            case "good hello":
                node = draws.choice(NODES)
                watch.hear(node, node_hello(node))
            case "ready":
                watch.hear(draws.choice(NODES), Ready(), draws.choice(NOW))
            case "all good hellos":
                for node in NODES:
                    watch.hear(node, node_hello(node))
            case "all ready":
                for node in NODES:
                    watch.hear(node, Ready())
            case "frame":
                sender = draws.choice((*NODES, *OBSERVERS, *STRANGERS))
                frame = Forger(draws, _in_place(sender), (*NODES, CERTIFICATE, SESSION.name, "other")).frame()
                watch.hear(sender, decode(frame, MAX_CONTROL_BYTES), draws.choice(NOW))
            case "exit":
                watch.exited(draws.choice(NODES), draws.choice(EXITS))
            case "silent":
                watch.silent(draws.choice(NODES))
            case "interrupt":
                watch.look(watch.conductor.interrupt())
            case "too late":
                watch.look(watch.conductor.too_late())
            case "good offer":
                watch.hear(draws.choice(NODES), Offer(draws.choice(NODES), "ipc:///s/anew"))
            case "good return":
                watch.bring_back(draws.choice(NODES))
            case "look":
                watch.look(watch.conductor.look(draws.choice(NOW)))
            case "no process":
                watch.not_started(draws.choice(NODES))
            case "shift":
                watch.look(watch.conductor.shift(draws.choice(COUPLINGS), draws.integer(0, 3)))
            case "stop":
                watch.look(watch.conductor.stop("too slow"))


def node_hello(sender: str) -> NodeHello:
    """The correct hello of ``sender``."""
    binds = {link.connector: f"ipc:///s/{sender}-{link.connector}" for link in GRAPH.links if link.binder == sender}
    role = ROLES.get(sender, Role.DEVICE)
    return NodeHello(PROTOCOL_VERSION, CERTIFICATE, SESSION.name, sender, role, 1, binds)


class Watch:
    """A conductor, and beside it what may be known of a session from its messages alone."""

    def __init__(self, remote: frozenset[str], restarts: int) -> None:
        budget = Restarts(restarts, Duration(2**63))  # no session runs so long
        self.conductor = Conductor(GRAPH, CERTIFICATE, SESSION.name, 5, remote, OBSERVERS, budget)
        self.restarts = restarts
        self.begun = False
        self.starts = 0
        self.absent: dict[str, set[str]] = {node: set() for node in NODES}
        self.welcomed: set[str] = set()
        self.connected: set[str] = set()
        self.ready: set[str] = set()
        self.started: set[str] = set()
        self._processes: set[str] = set(NODES) - remote
        self._terminated = False

    def hear(self, sender: str, received: Received, now: int = 0) -> None:
        """Give the conductor a message."""
        before = self._snapshot()
        if isinstance(received, Ready) and sender in self.welcomed:
            self.ready.add(sender)
        out = self.conductor.receive(sender, received, now)
        for one in out:
            if isinstance(one, Send) and isinstance(one.message, Welcome):
                assert one.node == sender, f"{sender} spoke and {one.node} was welcomed"
                assert _belongs(sender, received), f"{sender} was welcomed for {received!r}"
                self.welcomed.add(sender)
        if sender in OBSERVERS:
            assert self._snapshot() == before, f"{sender}, an observer, changed the session with {received!r}"
            self._told_observer(sender, received, out)
        elif sender not in NODES:
            assert self._snapshot() == before, f"{sender}, a stranger, changed the session with {received!r}"
            said = [one.message for one in out if isinstance(one, Send) and one.node == sender]
            assert len(said) == len(out) <= 1, f"{sender}, a stranger, brought about {out}"
            assert all(isinstance(message, Refusal) for message in said), f"{sender}, a stranger, was told {said}"
        elif self.begun or not any(isinstance(one, Send) and isinstance(one.message, Connect | Start) for one in out):
            self._others_stay(sender, before[0], ending=Terminate() in out)
        assert len(self.conductor.reports) <= (len(NODES) if self.begun else 0)
        self.look(out)

    def bring_back(self, node: str) -> None:
        """All that a node on its way back needs, as far as it stands there: offers, its hello, its Ready."""
        for link in GRAPH.links_of(node):
            self.hear(link.binder, Offer(link.connector, "ipc:///s/anew"))
        self.hear(node, node_hello(node))
        self.hear(node, Ready())

    def not_started(self, node: str) -> None:
        """Report to the conductor that a silent node that it has started has no process."""
        if node in self._processes and self.begun and self.conductor.states[node] is NodeState.STARTING:
            self._processes.remove(node)
            self.look(self.conductor.not_started(node, "no more processes", 0))

    def exited(self, node: str, code: int) -> None:
        """Report a process's end to the conductor; a process ends once, and is one of this machine."""
        if node in self._processes:
            self._processes.remove(node)
            self.look(self.conductor.exited(node, code, 0))

    def silent(self, node: str) -> None:
        """Report a long silence of a node to the conductor; only remote nodes are missed this way."""
        if node in self.conductor.remote:
            self.look(self.conductor.silent(node, 0))

    def look(self, out: list[Instruction]) -> None:
        """Everything that must hold whatever happened."""
        for one in out:
            match one:
                case Send(node, message):
                    assert decode(encode(message), MAX_CONTROL_BYTES) == message
                    self._said(node, message)
                case Terminate():
                    assert not self._terminated, "processes were asked to end twice"
                    self._terminated = True
                case Kill():
                    assert self._terminated, "processes were killed before they were asked to end"
                case StartProcess(node):
                    self._started(node)
                case KillProcess(node):
                    assert node in self._processes, f"{node} has no process to kill"
                    assert self.begun, f"{node} was killed during the start"
                case ReleaseName(node) if node in self.conductor.remote and self.begun:
                    self._forget(node)
        assert self.conductor.states.keys() == set(NODES)
        over = all(state is NodeState.ENDED for state in self.conductor.states.values())
        assert (self.conductor.phase is SessionPhase.OVER) == over
        assert not (over and self._processes), f"over, and {self._processes} still run"
        assert len(self.conductor.faults) <= MOST_FAULTS, f"{len(self.conductor.faults)} faults are kept"
        self._only_forward()

    def _started(self, node: str) -> None:
        assert node not in self._processes, f"{node} was started while its former process still runs"
        assert node not in self.conductor.remote, f"{node} was started here and is of elsewhere"
        assert self.begun, f"{node} was started anew during the start"
        assert not self._terminated, f"{node} was started after all were asked to end"
        self.starts += 1
        assert self.starts <= MOST_STARTS, f"{self.starts} processes were started anew"
        self._processes.add(node)
        self._forget(node)

    def _forget(self, node: str) -> None:
        """``node`` begins again."""
        for kept in (self.welcomed, self.connected, self.ready, self.started):
            kept.discard(node)
        self.absent[node].clear()

    _phase: SessionPhase = SessionPhase.STARTING

    def _only_forward(self) -> None:
        phase = self.conductor.phase
        assert PHASES.index(phase) >= PHASES.index(self._phase), f"from {self._phase} back to {phase}"
        assert phase is not SessionPhase.RUNNING or self.begun
        self._phase = phase

    def _said(self, node: str, message: Message) -> None:
        if isinstance(message, Connect) and node not in OBSERVERS:
            assert self.begun or self.welcomed >= set(NODES), f"{node} was told its peers before all had said hello"
            assert node in self.welcomed, f"{node} was told its peers before it was welcomed"
            assert node not in self.connected, f"{node} was told its peers twice"
            binders = {link.binder for link in GRAPH.links if link.connector == node}
            assert message.endpoints.keys() == binders - self.absent[node], f"{node}: told of {list(message.endpoints)}"
            self.connected.add(node)
        elif isinstance(message, Start):
            assert self.begun or self.ready == set(NODES), f"{node} was started before all were ready"
            assert node in self.ready, f"{node} was started before it was ready"
            assert node in self.connected, f"{node} was started before it was told its peers"
            assert node not in self.started, f"{node} was started twice"
            assert not self._terminated, f"{node} was started after it was asked to end"
            assert (message.tick > 0) == self.begun, f"{node} was started at tick {message.tick}"
            self.started.add(node)
            self.begun = self.begun or self.started == set(NODES)
        elif isinstance(message, Absent | Return):
            assert self.begun, f"{node} was told of {message} before the session had begun"
            assert self.restarts, f"{node} was told of {message}, and nobody comes back"
            assert any({node, message.peer} == {link.binder, link.connector} for link in GRAPH.links)
            if isinstance(message, Absent):
                self.absent[node].add(message.peer)
            else:
                assert message.peer in self.absent[node], f"{node} was told of the return of one that it does not miss"
                self.absent[node].discard(message.peer)

    def _others_stay(self, sender: str, before: dict[str, NodeState], ending: bool) -> None:
        """One node's message moves no other that runs or has run; a node that never came is not awaited at the end."""
        moved = {node for node, state in self.conductor.states.items() if node != sender and state is not before[node]}
        if self.begun and self.restarts:
            settled = {NodeState.RUNNING, NodeState.REPORTED, NodeState.FAULTED, NodeState.ENDED}
            assert not {node for node in moved if before[node] in settled}, f"{sender} moved {moved}"
            return
        given_up = {node for node in moved if before[node] is NodeState.STARTING and node in self.conductor.remote}
        assert moved == (given_up if ending else set()), f"{sender} moved {moved}"
        assert all(self.conductor.states[node] is NodeState.ENDED for node in moved)

    def _told_observer(self, observer: str, received: Received, out: list[Instruction]) -> None:
        """A listed observer receives its endpoint, any other is refused; the name is free again after both."""
        if not isinstance(received, NodeHello | ForeignHello):
            assert out == [], f"{observer} brought about {out} with {received!r}"
            return
        *said, last = out
        assert last == ReleaseName(observer)
        messages = [one.message for one in said if isinstance(one, Send) and one.node == observer]
        assert len(messages) == len(said)
        if _belongs(observer, received):
            assert messages == [Welcome(), Connect({Role.SUPERVISOR.value: OBSERVERS[observer]})]
        else:
            assert [type(message) for message in messages] == [Refusal]

    def _snapshot(self) -> tuple[dict[str, NodeState], object]:
        c = self.conductor
        return dict(c.states), (c.phase, list(c.faults), dict(c.reports), c.interrupted)


def _belongs(sender: str, received: Received) -> bool:
    """Whether ``received`` is the hello of the node that the hub knows as ``sender``."""
    return isinstance(received, NodeHello) and (
        (received.version, received.certificate, received.session) == (PROTOCOL_VERSION, CERTIFICATE, SESSION.name)
        and received.name == sender
        and ROLES.get(sender) is received.role
        and received.endpoints.keys() == node_hello(sender).endpoints.keys()
    )


@functools.cache
def _in_place(sender: str) -> dict[str, Message]:
    """Messages of a node in their place, and out of it."""
    hello = node_hello(sender)
    return {
        "hello": hello,
        "ready": Ready(),
        "telemetry": Telemetry(1, Figures({"speed": 0.5}), {}),
        "report": Report(5, Figures({"late": 0})),
        "fault": Fault("boom"),
        "other certificate": dataclasses.replace(hello, certificate="other"),
        "other session": dataclasses.replace(hello, session="other"),
        "other name": dataclasses.replace(hello, name="other"),
        "neighbour's name": dataclasses.replace(hello, name=NODES[0]),
        "other role": dataclasses.replace(hello, role=Role.OBSERVER),
        "foreign": dataclasses.replace(hello, version=PROTOCOL_VERSION + 1),
        "no endpoints": dataclasses.replace(hello, endpoints={}),
        "other endpoints": dataclasses.replace(hello, endpoints={"other": "ipc:///other"}),
        "start": Start(0, 0),
        "welcome": Welcome(),
        "link hello": LinkHello(PROTOCOL_VERSION, CERTIFICATE, SESSION.name, sender, hello.role, ("dx",)),
        "offer": Offer(NODES[0], "ipc:///s/anew"),
        "absent": Absent(NODES[0]),
        "fetch": Fetch(0),
    }
