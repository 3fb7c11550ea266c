"""How a running session loses a node and gets it back: pure, like the rest of the conductor.

When a node dies, its linked peers are informed and go on with frozen ports. The node is started anew once every peer
that it connects to has an endpoint for it; so the binder of a link returns before its connector. A returning node
learns which peers are absent, so that it does not wait for them, and where the others are. The peers that connect to it
learn its new endpoint.

    lost -> starting -> connecting -> shaking hands -> running          (a node elsewhere: from lost to connecting)

A link that lost one of its ends is cut. It can be joined again once its binder has bound a fresh endpoint. A running
binder *offers* an endpoint when it learns of the absence; a returning binder names it in its hello. The supervisor
passes the endpoint on when the connector is there, and then the link is joined.

A node may come back a limited number of times in a row. After a run of :data:`WINDOW` its earlier deaths are forgotten,
so that a session of hours does not lose it at its fourth mishap. A node that keeps dying soon after its start is given
up. No node returns once the environment is done, because the environment counts the session's ticks.

The nodes of a *seat* are lost from the start on, and come as often as they like: a user takes the seat while the
session runs, and leaves it for the next one. Nobody waits for them, so nothing limits how often they come.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final

from manyhands.launch.plan.topology import LinkPlan, Topology
from manyhands.launch.run.states import (
    OFFERING,
    RETURNING,
    Happenings,
    Incidents,
    Instruction,
    KillProcess,
    NodeState,
    ReleaseName,
    Send,
    StartProcess,
)
from manyhands.protocol.clock import Duration, from_seconds
from manyhands.protocol.messages import JOIN_AGAIN, Absent, Connect, Offer, Return, Role, Shift, Start, Stop


class LinkState(StrEnum):
    """The state of a link."""

    JOINED = "joined"
    CUT = "cut"
    OFFERED = "offered"  # cut, and there is a fresh endpoint that the connector does not know yet


class LinkEvent(StrEnum):
    """What happens to a link."""

    BINDER_LOST = "binder lost"
    CONNECTOR_LOST = "connector lost"
    PLACE = "place"  # the binder has bound a fresh endpoint
    ASKED = "asked"  # the returning binder learns that the connector is absent, and binds once more
    SENT = "sent"  # the connector has been sent the endpoint


LINK_TRANSITIONS: Final[Mapping[tuple[LinkState, LinkEvent], LinkState]] = {
    (LinkState.JOINED, LinkEvent.BINDER_LOST): LinkState.CUT,
    (LinkState.JOINED, LinkEvent.CONNECTOR_LOST): LinkState.CUT,
    (LinkState.CUT, LinkEvent.BINDER_LOST): LinkState.CUT,
    (LinkState.CUT, LinkEvent.CONNECTOR_LOST): LinkState.CUT,
    (LinkState.CUT, LinkEvent.PLACE): LinkState.OFFERED,
    (LinkState.OFFERED, LinkEvent.BINDER_LOST): LinkState.CUT,
    (LinkState.OFFERED, LinkEvent.CONNECTOR_LOST): LinkState.OFFERED,  # the endpoint is unused, so it stays good
    (LinkState.OFFERED, LinkEvent.ASKED): LinkState.CUT,
    (LinkState.OFFERED, LinkEvent.SENT): LinkState.JOINED,
}
"""All events of a link. The running binder of a cut link owes one Offer: at most one is on its way at any time."""


def other_end(link: LinkPlan, node: str) -> str:
    """The node at the end of ``link`` that is not ``node``'s."""
    return link.connector if link.binder == node else link.binder


class Links:
    """The state of every link, and the endpoints of those that are offered."""

    def __init__(self, graph: Topology) -> None:
        """All links begin joined, as after a start."""
        self._of = {node: graph.links_of(node) for node in graph.nodes}
        self._states = {(link.binder, link.connector): LinkState.JOINED for link in graph.links}
        self._places: dict[tuple[str, str], str] = {}
        self._links = graph.links

    def of(self, node: str) -> tuple[LinkPlan, ...]:
        """The links that end at ``node``."""
        return self._of[node]

    def state(self, link: LinkPlan) -> LinkState:
        """The state of ``link``."""
        return self._states[link.binder, link.connector]

    def lost(self, node: str) -> list[str]:
        """Cut the links of ``node``, which is gone; returns the other ends of those that were joined."""
        severed = []
        for link in self._of[node]:
            if self.state(link) is LinkState.JOINED:
                severed.append(other_end(link, node))
            self._move(link, LinkEvent.BINDER_LOST if link.binder == node else LinkEvent.CONNECTOR_LOST)
        return severed

    def owed(self, binder: str, connector: str) -> bool:
        """Whether ``binder`` may offer an endpoint to ``connector``."""
        return self._states.get((binder, connector)) is LinkState.CUT

    def offer(self, binder: str, connector: str, place: str) -> None:
        """Note the fresh endpoint ``place`` that ``binder`` has bound; the link must be cut."""
        state = self._states[binder, connector]
        self._states[binder, connector] = LINK_TRANSITIONS[state, LinkEvent.PLACE]
        self._places[binder, connector] = place

    def ask(self, link: LinkPlan) -> None:
        """The binder of an offered link learns that the connector is absent."""
        self._move(link, LinkEvent.ASKED)

    def join(self, link: LinkPlan) -> str:
        """The connector of an offered link is sent the endpoint, which is returned."""
        self._move(link, LinkEvent.SENT)
        return self._places.pop((link.binder, link.connector))

    def offered_between(self, nodes: Iterable[str]) -> Iterator[LinkPlan]:
        """Offered links with both ends among ``nodes``."""
        there = set(nodes)
        for link in self._links:
            if self.state(link) is LinkState.OFFERED and link.binder in there and link.connector in there:
                yield link

    def _move(self, link: LinkPlan, event: LinkEvent) -> None:
        self._states[link.binder, link.connector] = LINK_TRANSITIONS[self.state(link), event]


WINDOW: Final = from_seconds(60.0)


@dataclass
class Restarts:
    """Counts the deaths of each node, and compares them with the number allowed.

    Attributes:
        allowed: number of deaths in a row that a node may come back from; with 0 no node comes back.
        window: after a run of this length, ns, all earlier deaths are forgotten.
    """

    allowed: int = 0
    window: Duration = WINDOW
    _deaths: dict[str, int] = field(default_factory=dict)
    _ran_since: dict[str, int] = field(default_factory=dict)

    def ran(self, node: str, now: int) -> None:
        """``node`` runs from ``now`` on, monotonic ns."""
        self._ran_since[node] = now

    def died(self, node: str, now: int) -> bool:
        """Count a death at ``now``, monotonic ns; returns whether the node may come back."""
        since = self._ran_since.pop(node, None)  # removed: a death before the next run follows no stable one
        stable = since is not None and now - since >= self.window
        deaths = self._deaths[node] = 1 if stable else self._deaths.get(node, 0) + 1
        return deaths <= self.allowed


FIRST_PAUSE: Final = from_seconds(1.0)
LONGEST_PAUSE: Final = from_seconds(10.0)

RETURN_TIME = from_seconds(60.0)
"""The longest time that a node may take from its start to its hello, and again for its handshakes."""


@dataclass
class Recovery:
    """What the conductor knows of the nodes of a running session, in order to bring lost ones back.

    Attributes:
        graph: the session's nodes and links.
        remote: nodes that are started on other machines.
        restarts: how often a node may come back.
        states: of each node; shared with the conductor.
        faults: receives a sentence for each node that is gone for good; shared with the conductor.
        incidents: those of the session.
        visits: who has taken a seat, and who has left one as its user wanted.
        start: the message that every node received before tick 0; a returning node receives it again, with ``reached``.
        reached: the latest tick that the environment has reported; it counts the session's ticks.
        rungs: the rung of the ladder that each coupling was asked to change to.
        pids: process ids of those that were started anew here.
        closing: whether the environment has done its ticks, so that no node returns any more.
        seats: remote nodes that are absent at first, and come and go without a limit.
    """

    graph: Topology
    remote: frozenset[str]
    restarts: Restarts
    states: dict[str, NodeState]
    faults: list[str]
    incidents: Incidents = field(default_factory=Incidents)
    visits: Happenings = field(default_factory=lambda: Happenings("visits"))
    start: Start = field(default_factory=lambda: Start(0, 0))
    reached: int = 0
    rungs: dict[str, int] = field(default_factory=dict)
    pids: dict[str, int] = field(default_factory=dict)
    closing: bool = False
    seats: frozenset[str] = frozenset()
    _links: Links = field(init=False)
    _then: dict[str, NodeState] = field(default_factory=dict)  # the state of a leaving node after its process's end
    _since: dict[str, int] = field(default_factory=dict)  # when the present wait for a returning node began
    _vain: dict[str, tuple[Duration, int]] = field(default_factory=dict)  # the latest pause, and when it ends

    def __post_init__(self) -> None:
        self._links = Links(self.graph)

    def vacate(self) -> list[Instruction]:
        """Cut the links of the seats, whose users are yet to come; their peers learn of it before they connect."""
        absent = [(seat, peer) for seat in self.seats for peer in self._links.lost(seat)]
        return [Send(peer, Absent(seat)) for seat, peer in sorted(absent) if peer not in self.seats]

    def lose(
        self, node: str, how: str, now: int, *, alive: bool = False, vain: bool = False, visit: bool = False
    ) -> list[Instruction]:
        """Take ``node`` out of the session: it is lost, or has failed to return. It counts as a death.

        Args:
            node: its name.
            how: what happened to it, to follow its name in a sentence.
            now: monotonic ns.
            alive: whether the end of its process is still to come.
            vain: whether its process started in vain, so that the next start waits.
            visit: whether this is how a guest leaves its seat when its user wants to; everything else is an incident.
        """
        (self.visits if visit else self.incidents).add(self._dated(f"{node} {how}", now))
        if vain:
            pause = min(Duration(2 * self._vain[node][0]), LONGEST_PAUSE) if node in self._vain else FIRST_PAUSE
            self._vain[node] = pause, now + pause
        allowed = node in self.seats or self.restarts.died(node, now)
        out = self._drop(node, self._future(allowed), alive, now)
        if self._awaits(node, NodeState.GONE):
            away = (
                f"it stays away: its {self.restarts.allowed} restarts are used up (faults.restarts), and none led to a "
                f"run of {self.restarts.window / 1e9:g} s (faults.window)"
            )
            self.note(f"{node}: {away}", now)  # while the session goes on, too
            self.faults.append(f"{node} {how}; {away}")
        return out + self.proceed(now)

    def left(self, node: str, now: int) -> list[Instruction]:
        """The process of a node that was leaving has ended."""
        self.states[node] = self._then.pop(node)
        return self.proceed(now)

    def greet(self, node: str, endpoints: dict[str, str], now: int) -> list[Instruction]:
        """``node`` is back and was welcomed; it has bound ``endpoints``, by peer."""
        self.states[node] = NodeState.WELCOMED
        self._since.pop(node, None)  # from here on it waits for others, so no deadline runs
        for peer, endpoint in endpoints.items():
            self._links.offer(node, peer, endpoint)
        return self.proceed(now)

    def receive_offer(self, node: str, offer: Offer, now: int) -> list[Instruction] | None:
        """``node`` offers an endpoint to an absent peer; None if it was not asked for one."""
        if self.states[node] not in OFFERING or not self._links.owed(node, offer.peer):
            return None
        self._links.offer(node, offer.peer, offer.endpoint)
        return self.proceed(now)

    def ready(self, node: str, now: int) -> list[Instruction]:
        """``node`` has all its links, and takes part again from the present tick on."""
        self.states[node] = NodeState.RUNNING
        self._since.pop(node, None)
        self._vain.pop(node, None)
        if node in self.seats:
            self.visits.add(self._dated(f"{node} has joined", now))
        else:
            self.restarts.ran(node, now)
            self.incidents.restarts[node] += 1
            self.note(f"{node} is back", now)
        start = replace(self.start, tick=max(1, self.reached))  # tick 0 would mean the session's beginning
        return [Send(node, start), *self._repeated_shifts(node), *self.proceed(now)]

    def disown(self, node: str) -> list[Instruction]:
        """Free the name of ``node`` when frames of its former process still come in: the name is for the next process.

        A remote process that was wrongly counted as lost is sent a Stop, so that its user may join again.
        """
        if self.states[node] not in (NodeState.LOST, NodeState.GONE, NodeState.STARTING):
            return []
        farewell: list[Instruction] = (
            [Send(node, Stop(f"the session counted this node as lost; {JOIN_AGAIN}"))] if node in self.remote else []
        )
        return [*farewell, ReleaseName(node)]

    def overdue(self, now: int) -> list[Instruction]:
        """Give up the nodes that take too long to return, and start those whose pause is over."""
        late = [node for node, since in self._since.items() if now - since > RETURN_TIME]
        out: list[Instruction] = []
        for node in late:
            if node not in self._since:
                continue  # it was given up with one of the others
            out += self._end_process(node)
            out += self.lose(node, f"took too long to return ({self.states[node]})", now, alive=node not in self.remote)
        return out + self.proceed(now) if self._vain else out

    def shift(self, coupling: str, rung: int) -> list[Instruction]:
        """Change ``coupling`` to ``rung``: the environment receives that now, and again after a restart that forgets
        it.
        """
        self.rungs[coupling] = rung
        return [Send(world, Shift(coupling, rung)) for world in self._environments()]

    def close(self, now: int) -> list[Instruction]:
        """The environment is done: no node returns, and only running nodes are waited for."""
        self.closing = True
        out: list[Instruction] = []
        for node, state in self.states.items():
            if state in (NodeState.LOST, NodeState.GONE):
                self.states[node] = NodeState.ENDED
            elif state in RETURNING:
                out += [*self._end_process(node), *self._drop(node, NodeState.ENDED, node not in self.remote, now)]
            elif state is NodeState.LEAVING:
                self._then[node] = NodeState.ENDED
        return out

    @property
    def hopeless(self) -> bool:
        """Whether the session cannot go on: the environment is gone, or its forces can reach no device."""
        if any(self._awaits(world, NodeState.GONE) for world in self._environments()):
            return True
        devices = [node for node, role in self.graph.nodes.items() if role is Role.DEVICE]
        return all(self._cut_off(device) for device in devices)

    def proceed(self, now: int) -> list[Instruction]:
        """Do what has become possible: start lost nodes, connect returning ones, join links between running ones."""
        out: list[Instruction] = []
        if self.closing:
            return out
        for node in reversed(list(self.graph.nodes)):  # the binder of a link before its connector
            state = self.states[node]
            # nodes of one process start together, so none of them may begin to wait for a process alone
            paused = any(mate in self._vain and now < self._vain[mate][1] for mate in self.graph.together(node))
            if state is NodeState.LOST and node not in self.remote and not paused and self._all_to_be_found(node):
                self.states[node], self._since[node] = NodeState.STARTING, now
                out += [ReleaseName(node), StartProcess(node)]
            elif state is NodeState.WELCOMED and self._all_to_be_found(node):
                self.states[node], self._since[node] = NodeState.CONNECTED, now
                out += self._connect(node)
        running = [node for node, state in self.states.items() if state is NodeState.RUNNING]
        for link in list(self._links.offered_between(running)):
            out.append(Send(link.connector, Return(link.binder, self._links.join(link))))
        return out

    def _future(self, allowed: bool) -> NodeState:
        if self.closing:
            return NodeState.ENDED
        return NodeState.LOST if allowed else NodeState.GONE

    def _awaits(self, node: str, end: NodeState) -> bool:
        """Whether ``node`` is in the state ``end``, or will be once its process has ended."""
        return self.states[node] is end or (self.states[node] is NodeState.LEAVING and self._then[node] is end)

    def note(self, sentence: str, now: int) -> None:
        """Record an incident that happened ``now``, monotonic ns, with its time since tick 0."""
        self.incidents.add(self._dated(sentence, now))

    def _dated(self, sentence: str, now: int) -> str:
        return f"at {max(0, now - self.start.epoch) / 1e9:.1f} s: {sentence}"

    def _drop(self, node: str, future: NodeState, alive: bool, now: int) -> list[Instruction]:
        """Take ``node`` out of the session, and inform the peers that were linked to it."""
        self._since.pop(node, None)
        if alive:
            self.states[node], self._then[node] = NodeState.LEAVING, future
        else:
            self.states[node] = future
        out: list[Instruction] = [ReleaseName(node)] if node in self.remote else []
        for peer in self._links.lost(node):
            if self.states[peer] is NodeState.RUNNING:
                out.append(Send(peer, Absent(node)))
            elif self.states[peer] in RETURNING:  # its handshake with ``node`` will never be answered
                self.note(f"{peer} cannot return: {node} was lost meanwhile", now)
                out += self._end_process(peer)
                # the peer is not to blame, so its death is not counted
                out += self._drop(peer, self._future(allowed=True), peer not in self.remote, now)
        return out

    def _end_process(self, node: str) -> list[Instruction]:
        """End a process that cannot return. A remote one is asked to end, and its user may start it again."""
        return [Send(node, Stop(f"the return failed; {JOIN_AGAIN}"))] if node in self.remote else [KillProcess(node)]

    def _all_to_be_found(self, node: str) -> bool:
        """Whether every peer that ``node`` connects to has an endpoint for it, or will not have one for long."""
        return all(self._to_be_found(link) for link in self._links.of(node) if link.connector == node)

    def _to_be_found(self, link: LinkPlan) -> bool:
        state = self.states[link.binder]
        if state is NodeState.RUNNING:
            return self._links.state(link) is LinkState.OFFERED
        if state is NodeState.LOST:
            return (
                link.binder in self.remote
            )  # a remote binder may stay away for long, so its peer does not wait for it
        return state not in RETURNING and state is not NodeState.LEAVING

    def _connect(self, node: str) -> Iterator[Instruction]:
        """Send ``node`` the absent peers and the endpoints of the others, and send its own to the peers that connect to
        it.
        """
        endpoints: dict[str, str] = {}
        returns: list[Instruction] = []
        for link in self._links.of(node):
            peer = other_end(link, node)
            offered = self._links.state(link) is LinkState.OFFERED
            if self.states[peer] is NodeState.RUNNING and offered:
                place = self._links.join(link)
                if link.connector == node:
                    endpoints[peer] = place
                else:
                    returns.append(Send(peer, Return(node, place)))
                continue
            yield Send(node, Absent(peer))
            if link.binder == node and offered:
                self._links.ask(link)
        yield Send(node, Connect(endpoints))
        yield from returns

    def _repeated_shifts(self, node: str) -> list[Instruction]:
        """The shifts to send again for a node that starts at rung 0: of its own block, or of those linked to it."""
        peers = {node, *(other_end(link, node) for link in self._links.of(node))}
        concerned = [coupling for coupling in self.rungs if coupling in peers]
        return [instruction for coupling in concerned for instruction in self.shift(coupling, self.rungs[coupling])]

    def _environments(self) -> list[str]:
        return [node for node, role in self.graph.nodes.items() if role is Role.ENVIRONMENT]

    def _cut_off(self, device: str) -> bool:
        """Whether no force will reach ``device`` any more."""
        couplings = [other_end(link, device) for link in self._links.of(device)]
        couplings += self.graph.together(device)[1:]
        return self._awaits(device, NodeState.GONE) or all(self._awaits(c, NodeState.GONE) for c in couplings)
