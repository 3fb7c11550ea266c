"""What the supervisor decides, without any I/O: events of the nodes go in, instructions come out.

The nodes' states and what moves them stand in :data:`TRANSITIONS`. The session as a whole starts up, runs, ends
and is over; the first thing that goes wrong is its reason, and everything after that is only clearing up.
"""

from __future__ import annotations

import signal
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from manyhands.launch.topology import Topology
from manyhands.protocol.codec import ForeignHello, Malformed, Received
from manyhands.protocol.handshake import check_node_hello
from manyhands.protocol.messages import (
    Connect,
    Echo,
    Fault,
    Message,
    NodeHello,
    Probe,
    Ready,
    Report,
    Role,
    Start,
    Stop,
    Telemetry,
    Welcome,
)


class NodeState(StrEnum):
    """Where a node stands in its life."""

    STARTING = "starting"
    WELCOMED = "connecting"
    CONNECTED = "shaking hands"
    READY = "ready"
    RUNNING = "running"
    REPORTED = "done"
    FAULTED = "failed"
    ENDED = "ended"


class Phase(StrEnum):
    """Where the session stands."""

    STARTING = "starting"
    RUNNING = "running"
    ENDING = "ending"
    OVER = "over"


TRANSITIONS: Mapping[tuple[NodeState, type[Message]], NodeState] = {
    (NodeState.STARTING, NodeHello): NodeState.WELCOMED,
    (NodeState.WELCOMED, Probe): NodeState.WELCOMED,
    (NodeState.CONNECTED, Probe): NodeState.CONNECTED,
    (NodeState.CONNECTED, Ready): NodeState.READY,
    (NodeState.RUNNING, Probe): NodeState.RUNNING,
    (NodeState.RUNNING, Telemetry): NodeState.RUNNING,
    (NodeState.RUNNING, Report): NodeState.REPORTED,
    (NodeState.STARTING, Fault): NodeState.FAULTED,
    (NodeState.WELCOMED, Fault): NodeState.FAULTED,
    (NodeState.CONNECTED, Fault): NodeState.FAULTED,
    (NodeState.READY, Fault): NodeState.FAULTED,
    (NodeState.RUNNING, Fault): NodeState.FAULTED,
}
"""Every message a node may send, and where it leaves the node. Anything else is counted and ignored."""


@dataclass(frozen=True)
class Send:
    """Instruction: send a message to a node."""

    node: str
    message: Message


@dataclass(frozen=True)
class Release:
    """Instruction: an observer was told all it needs; the next one of its name may come."""

    observer: str


@dataclass(frozen=True)
class Terminate:
    """Instruction: ask every process that still runs to end (SIGTERM)."""


@dataclass(frozen=True)
class Kill:
    """Instruction: end every process that still runs (SIGKILL)."""


Instruction = Send | Release | Terminate | Kill


@dataclass
class Conductor:
    """The session's state.

    Attributes:
        graph: the session's nodes and links.
        certificate: the id that all nodes must share.
        session: the session's name.
        ticks: number of ticks to run; 0 runs until interrupted.
        remote: nodes that are started elsewhere; of those no process can be seen to end.
        observers: where each observer is served.
        phase: where the session stands.
        states: where each node stands.
        reports: the last words received.
        faults: what went wrong, in the order it was heard; empty for a good run.
        interrupted: whether the user ended it.
        ignored: messages that came out of turn, or made no sense.
    """

    graph: Topology
    certificate: str
    session: str
    ticks: int
    remote: frozenset[str] = frozenset()
    observers: Mapping[str, str] = field(default_factory=dict)
    phase: Phase = Phase.STARTING
    states: dict[str, NodeState] = field(init=False)
    reports: dict[str, Report] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    interrupted: bool = False
    ignored: int = 0
    _endpoints: dict[tuple[str, str], str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.states = dict.fromkeys(self.graph.nodes, NodeState.STARTING)

    def hear(self, sender: str, received: Received, now: int) -> list[Instruction]:
        """A message from a node.

        Args:
            sender: the identity it came from.
            received: what the frame turned out to be.
            now: monotonic ns, from which the first tick's instant is reckoned.
        """
        if isinstance(received, NodeHello | ForeignHello):
            if sender in self.observers:
                return self._greet_observer(sender, received)
            if self.states.get(sender) in (None, NodeState.STARTING):
                return self._greet(sender, received)
        state = self.states.get(sender)
        if state is None or isinstance(received, ForeignHello | Malformed):
            self.ignored += 1
            return []
        target = TRANSITIONS.get((state, type(received)))
        if target is None:
            self.ignored += 1
            return []
        self.states[sender] = target
        match received:
            case Probe(sent):
                return [Send(sender, Echo(sent, now, now))]
            case Ready():
                return self._start_if_all_ready(now)
            case Report(ticks):
                self.reports[sender] = received
                told: list[Instruction] = [Send(sender, Stop("reported"))]
                if self.phase is Phase.RUNNING and not 0 < self.ticks <= ticks:  # the others would wait for it for ever
                    told += self._fail(f"{sender} left after {ticks} ticks, before the session was over")
                self._gone_if_remote(sender)
                return told
            case Fault(text):
                told = [Send(sender, Stop("heard")), *self._fail(text)]
                self._gone_if_remote(sender)
                return told
        return []

    def exited(self, node: str, code: int) -> list[Instruction]:
        """A node's process has ended with ``code`` (negative: the signal that killed it)."""
        how = f"was killed by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
        return self._ended(node, how)

    def silent(self, node: str) -> list[Instruction]:
        """Nothing was heard of a remote node for so long that it must be gone."""
        return self._ended(node, "fell silent") if self.states[node] is not NodeState.ENDED else []

    @property
    def awaited(self) -> tuple[str, ...]:
        """Remote nodes that have not joined yet; people start those, and people take their time."""
        return tuple(n for n in self.graph.nodes if n in self.remote and self.states[n] is NodeState.STARTING)

    def _ended(self, node: str, how: str) -> list[Instruction]:
        state, self.states[node] = self.states[node], NodeState.ENDED
        out: list[Instruction] = []
        if state not in (NodeState.REPORTED, NodeState.FAULTED) and self.phase is not Phase.ENDING:
            out = self._fail(f"{node} {how} while {state}")
        self._over_if_all_ended()
        return out

    def _gone_if_remote(self, node: str) -> None:
        """A remote node's last word is all that is seen of its end."""
        if node in self.remote:
            self.states[node] = NodeState.ENDED
            self._over_if_all_ended()

    def _over_if_all_ended(self) -> None:
        if all(state is NodeState.ENDED for state in self.states.values()):
            self.phase = Phase.OVER

    def interrupt(self) -> list[Instruction]:
        """The user wants the session to end; who asks again wants it at once."""
        if self.interrupted:
            return [Kill()]
        self.interrupted = True
        return self._end()

    def too_late(self) -> list[Instruction]:
        """The time for the present phase is over: start-up failed, or a process does not end."""
        if self.phase is Phase.STARTING:
            waiting = ", ".join(f"{node} ({state})" for node, state in self.states.items() if state != NodeState.READY)
            return self._fail(f"not every node became ready in time; still waiting for {waiting}")
        if self.phase is not Phase.ENDING:
            return []
        for node in self.remote:  # which nobody here can kill
            self.states[node] = NodeState.ENDED
        self._over_if_all_ended()
        return [Kill()]

    def _greet(self, sender: str, hello: NodeHello | ForeignHello) -> list[Instruction]:
        """Accept or refuse a node; once all are here, tell each where its peers are."""
        binds = [link.connector for link in self.graph.links_of(sender) if link.binder == sender]
        refusal = check_node_hello(hello, self.certificate, self.session, self.graph.nodes, sender, binds)
        if refusal is not None:
            told: list[Instruction] = [Send(sender, refusal)]
            if sender not in self.states:  # a stranger: refused, and no reason to end a session that is not its own
                self.ignored += 1
                return told
            self.states[sender] = NodeState.FAULTED  # heard once; what it says after that is out of turn
            return [*told, *self._fail(refusal.text)]
        if isinstance(hello, NodeHello):
            self.states[sender] = NodeState.WELCOMED
            self._endpoints.update({(sender, peer): endpoint for peer, endpoint in hello.endpoints.items()})
        out: list[Instruction] = [Send(sender, Welcome())]
        if all(state is NodeState.WELCOMED for state in self.states.values()):
            self.states = dict.fromkeys(self.states, NodeState.CONNECTED)
            for node in self.graph.nodes:
                binders = [link.binder for link in self.graph.links_of(node) if link.connector == node]
                out.append(Send(node, Connect({b: self._endpoints.get((b, node), "") for b in binders})))
        return out

    def _greet_observer(self, sender: str, hello: NodeHello | ForeignHello) -> list[Instruction]:
        """Tell an observer where it is served; the session goes on as if it were not there."""
        roles = {**self.graph.nodes, **dict.fromkeys(self.observers, Role.OBSERVER)}
        refusal = check_node_hello(hello, self.certificate, self.session, roles, sender)
        if refusal is not None:
            self.ignored += 1
            return [Send(sender, refusal), Release(sender)]
        endpoints = {Role.SUPERVISOR.value: self.observers[sender]}
        return [Send(sender, Welcome()), Send(sender, Connect(endpoints)), Release(sender)]

    def _start_if_all_ready(self, now: int) -> list[Instruction]:
        if self.phase is not Phase.STARTING or any(state is not NodeState.READY for state in self.states.values()):
            return []
        self.phase = Phase.RUNNING
        self.states = dict.fromkeys(self.states, NodeState.RUNNING)
        start = Start(now + EPOCH_DELAY_NS, self.ticks)
        # those that wait for others first, so that nobody's first tick finds a partner still in the handshake
        return [Send(node, start) for node in reversed(list(self.graph.nodes))]

    def _fail(self, reason: str) -> list[Instruction]:
        self.faults.append(reason)
        return self._end()

    def _end(self) -> list[Instruction]:
        if self.phase in (Phase.ENDING, Phase.OVER):
            return []
        self.phase = Phase.ENDING
        farewell = [Send(node, Stop("the session ends")) for node in self.graph.nodes if node in self.remote]
        for node in self.awaited:
            self.states[node] = NodeState.ENDED  # nobody to wait for
        self._over_if_all_ended()
        return [Terminate(), *farewell]


def signal_name(number: int) -> str:
    """A signal's name; the realtime signals between the first and the last have none."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


EPOCH_DELAY_NS = 20_000_000
"""From the last Ready to tick 0: long enough for every Start to arrive, so that devices begin in phase."""
