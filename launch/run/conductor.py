"""The decisions of the supervisor, without any I/O: events of the nodes go in, instructions come out.

:data:`TRANSITIONS` lists the nodes' states and what moves them. A session starts, runs, ends and is over. The first
fault is the reason of its end; everything after it only clears up. Faults that a running session survives are handled
by :mod:`manyhands.launch.run.recovery`.

:class:`Reception` decides whether a node or an observer may join. It compares the hello with the session.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from manyhands.launch.plan.topology import Topology
from manyhands.launch.run.recovery import Recovery, Restarts
from manyhands.launch.run.states import (
    RETURNING,
    TRANSITIONS,
    Happenings,
    Incidents,
    Instruction,
    Kill,
    NodeState,
    ReleaseName,
    Send,
    SessionPhase,
    Terminate,
    ending,
)
from manyhands.nodes.kernel.words import counted
from manyhands.nodes.monitor.health import FREE_STATE
from manyhands.protocol.codec import ForeignHello, Malformed, Received
from manyhands.protocol.handshake import check_node_hello
from manyhands.protocol.limits import MAX_PIECE_BYTES, MAX_ROUND_TRIP
from manyhands.protocol.messages import (
    Connect,
    Echo,
    Fault,
    Fetch,
    NodeHello,
    Offer,
    Piece,
    Probe,
    Ready,
    Refusal,
    Report,
    Role,
    Start,
    Stop,
    Telemetry,
    Welcome,
)


@dataclass(frozen=True)
class Reception:
    """Compares a hello with the session.

    Attributes:
        graph: the session's nodes and links.
        certificate: the id that all nodes must share, except those in ``ids``.
        session: the session's name.
        ids: the ids of nodes at the sites of wave links.
    """

    graph: Topology
    certificate: str
    session: str
    ids: Mapping[str, str]

    def refusal(self, sender: str, hello: NodeHello | ForeignHello) -> Refusal | None:
        """Why ``sender`` is no node of this session; None if it is one."""
        binds = [link.connector for link in self.graph.links_of(sender) if link.binder == sender]
        certificate = self.ids.get(sender, self.certificate)
        return check_node_hello(hello, certificate, self.session, self.graph.nodes, sender, binds)

    def connects(self, endpoints: Mapping[tuple[str, str], str], absent: Collection[str] = ()) -> list[Instruction]:
        """Report to each node where its peers are, once all have joined.

        Args:
            endpoints: of every link, by binder and connector.
            absent: the nodes that are yet to come.
        """
        out: list[Instruction] = []
        for node in self.graph.nodes:
            if node in absent:
                continue
            ends = [link for link in self.graph.links_of(node) if link.connector == node]
            binders = [link.binder for link in ends if link.binder not in absent]
            out.append(Send(node, Connect({binder: endpoints.get((binder, node), "") for binder in binders})))
        return out

    def greet_observer(
        self, name: str, hello: NodeHello | ForeignHello, places: Mapping[str, str]
    ) -> list[Instruction]:
        """Send an observer its endpoint, or refuse it. In both cases its name becomes free for its next visit.

        Args:
            name: the observer.
            hello: the frame it sent.
            places: the endpoint of each observer.
        """
        roles = {**self.graph.nodes, **dict.fromkeys(places, Role.OBSERVER)}
        refusal = check_node_hello(hello, self.certificate, self.session, roles, name)
        if refusal is not None:
            return [Send(name, refusal), ReleaseName(name)]
        endpoints = {Role.SUPERVISOR.value: places[name]}
        return [Send(name, Welcome()), Send(name, Connect(endpoints)), ReleaseName(name)]


@dataclass
class Conductor:
    """The session's state.

    Attributes:
        graph: the session's nodes and links.
        certificate: the id that all nodes must share, except those in ``ids``.
        session: the session's name.
        ticks: number of ticks to run; 0 runs until interrupted.
        remote: nodes that are started on other machines; the supervisor cannot see their processes end.
        observers: the endpoint of each observer.
        restarts: how often a node may come back; without restarts, the first death ends the session.
        together: whether a guest that leaves ends the session, as it does in a session without restarts.
        seats: those of the remote nodes for which the session does not wait: they come and go while it runs.
        ids: the ids of nodes at the sites of wave links, which share one with their site's others alone.
        parts: by the node that asks for it, what a guest needs of the session; it holds keys, and shows in no text.
        phase: of the session.
        states: of each node.
        reports: the final report of each node that sent one.
        left: the final reports of guests that left while the session went on.
        faults: what went wrong, in the order of arrival; empty for a good run.
        interrupted: whether the user ended the session.
        ignored: number of messages that came out of turn, or could not be read.
    """

    graph: Topology
    certificate: str
    session: str
    ticks: int
    remote: frozenset[str] = frozenset()
    observers: Mapping[str, str] = field(default_factory=dict)
    restarts: Restarts = field(default_factory=Restarts)
    together: bool = False
    seats: frozenset[str] = frozenset()
    ids: dict[str, str] = field(default_factory=dict)
    parts: dict[str, bytes] = field(default_factory=dict, repr=False)
    phase: SessionPhase = SessionPhase.STARTING
    states: dict[str, NodeState] = field(init=False)
    reports: dict[str, Report] = field(default_factory=dict)
    left: dict[str, Report] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    interrupted: bool = False
    ignored: int = 0
    _endpoints: dict[tuple[str, str], str] = field(default_factory=dict)
    _welcomed: dict[str, int] = field(default_factory=dict)  # by node, the process id of its latest accepted hello
    _round_trips: dict[str, float] = field(default_factory=dict)  # of wave links, by coupling, s
    _reception: Reception = field(init=False)
    _recovery: Recovery = field(init=False)

    def __post_init__(self) -> None:
        self.states = {n: NodeState.LOST if n in self.seats else NodeState.STARTING for n in self.graph.nodes}
        self._reception = Reception(self.graph, self.certificate, self.session, self.ids)
        self._recovery = Recovery(self.graph, self.remote, self.restarts, self.states, self.faults, seats=self.seats)

    @property
    def incidents(self) -> Incidents:
        """The incidents that the session survived."""
        return self._recovery.incidents

    @property
    def visits(self) -> Happenings:
        """Who has taken a seat, and who has left one as its user wanted."""
        return self._recovery.visits

    def shown_state(self, node: str) -> str:
        """The state of a node for people: a seat that nobody has taken is free, and not lost."""
        state = self.states[node]
        return FREE_STATE if node in self.seats and state is NodeState.LOST else state.value

    @property
    def rungs(self) -> Mapping[str, int]:
        """The rung of the ladder that each coupling was asked to change to; couplings that never changed are absent."""
        return self._recovery.rungs

    def receive(self, sender: str, received: Received, now: int) -> list[Instruction]:
        """Decide what follows from a frame of a node or an observer.

        Args:
            sender: the name that the hub gives the frame's connection.
            received: the decoded frame.
            now: monotonic ns; the instant of tick 0 is set from it.
        """
        if isinstance(received, NodeHello | ForeignHello):
            if sender in self.observers:
                answer = self._reception.greet_observer(sender, received, self.observers)
                self.ignored += any(isinstance(one, Send) and isinstance(one.message, Refusal) for one in answer)
                return answer
            if sender not in self.states or self._is_awaited(sender, received):
                return self._greet(sender, received, now)
            if sender in self.remote and self._repeats(sender, received):
                return []
            return self._out_of_turn(sender)
        state = self.states.get(sender)
        if state is None:
            self.ignored += 1
            return []
        if isinstance(received, Offer) and self.phase in (SessionPhase.STARTING, SessionPhase.RUNNING):
            instructions = self._recovery.receive_offer(sender, received, now)
            return self._out_of_turn(sender) if instructions is None else instructions
        if isinstance(received, Malformed):
            return self._out_of_turn(sender)
        heard = sender in self.reports if state is NodeState.ENDED else state in (NodeState.REPORTED, NodeState.FAULTED)
        if heard and isinstance(received, Report | Fault):  # it repeats its last message until an answer comes
            return [Send(sender, Stop("received"))]
        target = TRANSITIONS.get((state, type(received)))
        if target is None or (isinstance(received, Fetch) and received.at >= len(self.parts.get(sender, b""))):
            return self._out_of_turn(sender)
        self.states[sender] = target
        match received:
            case Fetch(at):  # the guest joins on another connection, so its name becomes free
                part = self.parts[sender]
                return [Send(sender, Piece(at, len(part), part[at : at + MAX_PIECE_BYTES])), ReleaseName(sender)]
            case Probe(sent):
                R = self._round_trips.get(sender) if target is NodeState.RUNNING else None
                return [Send(sender, Echo(sent, now, now, R))]
            case Ready():
                return self._ready(sender, now)
            case Telemetry(tick) if self.graph.nodes[sender] is Role.ENVIRONMENT:
                self._recovery.reached = max(self._recovery.reached, tick)
            case Report():
                return self._reported(sender, received, now)
            case Fault():
                return self._faulted(sender, state, received, now)
        return []

    def exited(self, node: str, code: int, now: int, said: str = "") -> list[Instruction]:
        """Decide what follows from the end of a node's process.

        Args:
            node: its name.
            code: exit code; negative: the signal that killed it.
            now: monotonic ns.
            said: the last line of its error output. A node that is to come back, and has no line to the supervisor
                yet, says only there what its device lacks.
        """
        carrier = self.graph.carriers.get(node)
        if carrier is not None and code > 0:  # its device says what ended their process
            return self._ended(node, f"ended with {carrier}, in whose process it ran,", now, said)
        return self._ended(node, ending(code), now, said)

    def started(self, node: str, pid: int) -> None:
        """Note the process id of a node that is to come back: a hello of its former process may still arrive."""
        self._recovery.pids[node] = pid

    def not_started(self, node: str, why: str, now: int) -> list[Instruction]:
        """Decide what follows when no process could be started for a node that is to come back."""
        return self._ended(node, f"could not be started ({why})", now)

    def silent(self, node: str, now: int, how: str = "fell silent") -> list[Instruction]:
        """Decide what follows when a remote node has been silent for so long that it counts as gone.

        ``how`` it has gone may be known from elsewhere.
        """
        if self.states[node] in (NodeState.ENDED, NodeState.LOST, NodeState.GONE):
            return []
        return self._ended(node, how, now)

    def comes_back(self, node: str) -> bool:
        """Whether a node is on its way into a session that runs."""
        return self.phase is SessionPhase.RUNNING and self.states[node] in RETURNING

    def look(self, now: int) -> list[Instruction]:
        """Decide what follows from time alone: a node that takes too long to return is given up."""
        return self._withstood(self._recovery.overdue(now)) if self.phase is SessionPhase.RUNNING else []

    def shift(self, coupling: str, rung: int) -> list[Instruction]:
        """Change ``coupling`` to ``rung`` of the ladder."""
        return self._recovery.shift(coupling, rung) if self.phase is SessionPhase.RUNNING else []

    def stop(self, reason: str) -> list[Instruction]:
        """End the session because of a measurement; ``reason`` becomes its fault."""
        return self._fail(reason) if self.phase is SessionPhase.RUNNING else []

    def note(self, sentence: str, now: int) -> None:
        """Record an incident that happened ``now``, monotonic ns."""
        self._recovery.note(sentence, now)

    def note_round_trip(self, coupling: str, R: float) -> None:
        """Note R of a coupling's wave link, s, which its echoes tell it while it runs; a guest may claim any number."""
        if 0.0 < R <= MAX_ROUND_TRIP:
            self._round_trips[coupling] = R
        else:
            self._round_trips.pop(coupling, None)

    @property
    def finished(self) -> tuple[str, ...]:
        """The nodes whose final report shows that the session nears its end: those started here, and the environment.

        What a guest reports of itself decides for nobody else.
        """
        worlds = {node for node, role in self.graph.nodes.items() if role is Role.ENVIRONMENT}
        return tuple(node for node in self.reports if node not in self.remote or node in worlds)

    @property
    def awaited(self) -> tuple[str, ...]:
        """Remote nodes that have not joined yet. People start those, so the start-up deadline waits for them."""
        return tuple(n for n in self.graph.nodes if n in self.remote and self.states[n] is NodeState.STARTING)

    def interrupt(self) -> list[Instruction]:
        """End the session for its user. A second interrupt kills every process at once."""
        if self.interrupted:
            return [Kill()]
        self.interrupted = True
        return self._end()

    def too_late(self) -> list[Instruction]:
        """Decide what follows when the time for a phase is over: a start failed, or a process does not end."""
        match self.phase:
            case SessionPhase.STARTING:
                late = {n: s for n, s in self.states.items() if s is not NodeState.READY and n not in self.seats}
                waiting = (f"{node} ({state})" for node, state in late.items())
                return self._fail(f"not every node became ready in time; still waiting for {', '.join(waiting)}")
            case SessionPhase.RUNNING if self.finished:
                return self._leave_behind()
            case SessionPhase.ENDING:
                hung = [node for node, state in self.states.items() if state is not NodeState.ENDED]
                if local := [node for node in hung if node not in self.remote]:
                    self.incidents.add(f"did not end when the session did, and was killed: {', '.join(local)}")
                for node in self.remote:  # the supervisor cannot kill a process on another machine
                    self.states[node] = NodeState.ENDED
                self._over_if_all_ended()
                return [Kill()]
        return []

    def _is_awaited(self, node: str, hello: NodeHello | ForeignHello) -> bool:
        """Whether a hello of ``node`` is expected now, and comes from its present process."""
        if node in self.remote and self.phase is SessionPhase.RUNNING:
            return self.states[node] is NodeState.LOST
        pid = self._recovery.pids.get(node)
        ours = pid is None or not isinstance(hello, NodeHello) or hello.pid == pid
        return self.states[node] is NodeState.STARTING and ours

    def _repeats(self, guest: str, hello: NodeHello | ForeignHello) -> bool:
        """Whether a hello only repeats one that was accepted: a guest sends it every second until it is welcomed."""
        if guest in self.seats and self.phase is SessionPhase.STARTING:
            return True
        ours = isinstance(hello, NodeHello) and self._welcomed.get(guest) == hello.pid
        return ours and self.states[guest] in (NodeState.WELCOMED, NodeState.CONNECTED)

    def _out_of_turn(self, node: str) -> list[Instruction]:
        self.ignored += 1
        return self._recovery.disown(node) if self.phase is SessionPhase.RUNNING else []

    def _greet(self, sender: str, hello: NodeHello | ForeignHello, now: int) -> list[Instruction]:
        """Accept or refuse a node."""
        refusal = self._reception.refusal(sender, hello)
        if refusal is not None:
            return [Send(sender, refusal), *self._refused(sender, refusal, now)]
        endpoints = dict(hello.endpoints) if isinstance(hello, NodeHello) else {}
        if isinstance(hello, NodeHello):
            self._welcomed[sender] = hello.pid
        if self.phase is SessionPhase.RUNNING:
            return [Send(sender, Welcome()), *self._recovery.greet(sender, endpoints, now)]
        self.states[sender] = NodeState.WELCOMED
        self._endpoints.update({(sender, peer): endpoint for peer, endpoint in endpoints.items()})
        return [Send(sender, Welcome()), *self._connect_if_all_here()]

    def _refused(self, sender: str, refusal: Refusal, now: int) -> list[Instruction]:
        """What follows the refusal of a hello."""
        if sender not in self.states:  # a stranger must not be able to end the session
            self.ignored += 1
            return []
        if self.phase is not SessionPhase.RUNNING:
            self.states[sender] = NodeState.FAULTED  # so its later messages are out of turn
            return self._fail(refusal.text)
        if sender in self.remote:  # it stays lost; its user may join again with the right bundle
            self.ignored += 1
            return [ReleaseName(sender)]
        return self._withstood(self._recovery.lose(sender, f"was refused: {refusal.text}", now, alive=True))

    def _connect_if_all_here(self) -> list[Instruction]:
        """Send each node the endpoints of its peers, once all nodes have joined."""
        present = [node for node in self.states if node not in self.seats]
        if self.phase is not SessionPhase.STARTING or {self.states[n] for n in present} != {NodeState.WELCOMED}:
            return []
        self.states.update(dict.fromkeys(present, NodeState.CONNECTED))
        return [*self._recovery.vacate(), *self._reception.connects(self._endpoints, self.seats)]

    def _ready(self, sender: str, now: int) -> list[Instruction]:
        if self.phase is SessionPhase.RUNNING:
            return self._recovery.ready(sender, now)
        present = [node for node in self.graph.nodes if node not in self.seats]
        if self.phase is not SessionPhase.STARTING or any(self.states[n] is not NodeState.READY for n in present):
            return []
        self.phase = SessionPhase.RUNNING
        start = self._recovery.start = Start(now + EPOCH_DELAY_NS, self.ticks)
        for node in present:
            self.states[node] = NodeState.RUNNING
            self.restarts.ran(node, now)
        # the environment first and the devices last: each node's first signal then finds its peer past the handshake
        return [Send(node, start) for node in reversed(present)]

    def _reported(self, sender: str, report: Report, now: int) -> list[Instruction]:
        out: list[Instruction] = [Send(sender, Stop("reported"))]
        early = self.phase is SessionPhase.RUNNING and not 0 < self.ticks <= report.ticks
        if early and self._does_without(sender):
            self.left[sender] = report
            how = f"left after {counted(report.ticks, 'tick')}"
            return out + self._withstood(self._recovery.lose(sender, how, now, visit=sender in self.seats))
        self.reports[sender] = report
        if early:  # the other nodes would wait for its signals for ever
            out += self._fail(f"{sender} left after {counted(report.ticks, 'tick')}, before the session was over")
        elif self.phase is SessionPhase.RUNNING and self.graph.nodes[sender] is Role.ENVIRONMENT:
            out += self._recovery.close(now)
        self._gone_if_remote(sender)
        return out

    def _faulted(self, sender: str, state: NodeState, fault: Fault, now: int) -> list[Instruction]:
        """A node ends by its own decision. That ends the session, except for a guest, a device whose driver may find
        its hardware again, and a node that was on its way back.
        """
        out: list[Instruction] = [Send(sender, Stop("received"))]
        text = fault.text
        if self.phase is SessionPhase.RUNNING and state in RETURNING:
            visit = fault.by_user and sender in self.seats
            how = "left before its first tick" if visit else f"could not return: {text}"
            lost = self._recovery.lose(sender, how, now, alive=sender not in self.remote, visit=visit)
            return out + self._withstood(lost)
        device = self.graph.nodes[sender] is Role.DEVICE and self._starts_anew
        if self.phase is SessionPhase.RUNNING and (device or self._does_without(sender)):
            lost = self._recovery.lose(sender, f"failed: {text}", now, alive=sender not in self.remote)
            return out + self._withstood(lost)
        if (
            self.phase is SessionPhase.STARTING
            and state is NodeState.WELCOMED
            and sender in self.remote
            and not self.together
        ):
            return out + self._awaited_again(sender, text)
        out += self._fail(text)
        self._gone_if_remote(sender)
        return out

    def _does_without(self, node: str) -> bool:
        """Whether the session goes on without the guest ``node`` and lets it join again; without restarts, only seats
        may.
        """
        return node in self.seats or (node in self.remote and self._starts_anew)

    @property
    def _starts_anew(self) -> bool:
        """Whether the session goes on without a node that is lost, and takes it in again."""
        return self.restarts.allowed > 0 and not self.together

    def _awaited_again(self, guest: str, why: str) -> list[Instruction]:
        """Take back the welcome of a guest that ended before all had joined. No peer knows of it yet, so it may start
        over.
        """
        self.states[guest] = NodeState.STARTING
        self._endpoints = {ends: place for ends, place in self._endpoints.items() if ends[0] != guest}
        self.incidents.add(f"{why}; the session waits for {guest} again")
        return [ReleaseName(guest)]

    def _ended(self, node: str, how: str, now: int, said: str = "") -> list[Instruction]:
        state = self.states[node]
        if self.phase is SessionPhase.RUNNING:
            if state is NodeState.LEAVING:
                return self._withstood(self._recovery.left(node, now))
            survived = self.restarts.allowed > 0 or node in self.seats
            if survived and (state is NodeState.RUNNING or state in RETURNING):
                vain = bool(said) and state is NodeState.STARTING
                told = any(said in one for one in self.incidents.sentences)  # by a node of the same process
                why = f": {said}" if vain else f"; the last line of its log: {said}" if said and not told else ""
                return self._withstood(self._recovery.lose(node, f"{how} while {state}{why}", now, vain=vain))
        self.states[node] = NodeState.ENDED
        out: list[Instruction] = []
        expected = (NodeState.REPORTED, NodeState.FAULTED, NodeState.LEAVING)
        if state not in expected and self.phase is not SessionPhase.ENDING:
            out = self._fail(f"{node} {how} while {state}")
        self._over_if_all_ended()
        return out

    def _withstood(self, out: list[Instruction]) -> list[Instruction]:
        """Return the recovery's instructions, and end the session if nothing is left to recover."""
        if self._recovery.hopeless:
            return out + self._end()
        self._over_if_all_ended()
        return out

    def _gone_if_remote(self, node: str) -> None:
        """Count a remote node as ended: its last message is all that the supervisor sees of its end."""
        if node in self.remote:
            self.states[node] = NodeState.ENDED
        self._over_if_all_ended()

    def _over_if_all_ended(self) -> None:
        if all(state is NodeState.ENDED for state in self.states.values()):
            self.phase = SessionPhase.OVER

    def _leave_behind(self) -> list[Instruction]:
        """End the session when some nodes are long overdue: a fault unless the environment is done."""
        left = ", ".join(node for node, state in self.states.items() if state is NodeState.RUNNING)
        if not self._recovery.closing:
            return self._fail(f"{', '.join(self.finished)} had done every tick long before {left}")
        self.incidents.add(f"{left} had not finished when the session was over")
        return self._end()

    def _fail(self, reason: str) -> list[Instruction]:
        self.faults.append(reason)
        return self._end()

    def _end(self) -> list[Instruction]:
        if self.phase in (SessionPhase.ENDING, SessionPhase.OVER):
            return []
        self.phase = SessionPhase.ENDING
        farewell = [Send(node, Stop("the session ends")) for node in self.graph.nodes if node in self.remote]
        for node, state in self.states.items():
            if node in self.awaited or state in (NodeState.LOST, NodeState.GONE):
                self.states[node] = NodeState.ENDED  # there is no process to wait for
        self._over_if_all_ended()
        return [Terminate(), *farewell]


EPOCH_DELAY_NS = 100_000_000
"""From the last Ready to tick 0: long enough for every node to lock its memory and settle, so that no tick is lost.

With 20 ms Example 1 lost some 15 ticks at the beginning of two runs in three, on two cores.
"""
