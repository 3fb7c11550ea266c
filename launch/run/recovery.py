"""How a running session loses a node and gets it back: pure, as the rest of the conductor.

Who is linked to a node that died is told that it is absent, and goes on with frozen ports. The node is started anew
when everything that it connects to is there to be found: whoever binds a link comes back before who connects to it. On
its return it is told who is absent meanwhile, so that it does not wait for them, and where the others are; those of
them that connect to it are told where it is.

    lost -> starting -> connecting -> shaking hands -> running          (a node elsewhere: from lost to connecting)

Nobody returns more often than the budget allows, and nobody once the environment is done: the session's ticks are its.

The links of a running session, as far as the supervisor has to mend them.

A link that lost one of its ends is cut. It can be joined again once there is a fresh place to meet at, which is the
binder's to make: one that runs *offers* it when it is told of the absence, one that comes back names it in its hello.
The connector is told of the place when it is there itself, and then the link is joined.

How often a node may come back: a budget with a stable-start window.

A node that ran for the whole window has a clean slate, so that a session of hours does not lose it by its fourth
mishap; one that dies again and again soon after its start is given up.
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
    Incidents,
    Instruction,
    KillProcess,
    NodeState,
    ReleaseName,
    Send,
    StartProcess,
)
from manyhands.protocol.clock import Duration, from_seconds
from manyhands.protocol.messages import Absent, Connect, Offer, Return, Role, Shift, Start, Stop


class LinkState(StrEnum):
    """Where a link stands."""

    JOINED = "joined"
    CUT = "cut"
    OFFERED = "offered"  # cut, and there is a fresh place that the connector has not been told of


class LinkEvent(StrEnum):
    """What happens to a link."""

    BINDER_LOST = "binder lost"
    CONNECTOR_LOST = "connector lost"
    PLACE = "place"  # the binder has bound a fresh one
    ASKED = "asked"  # the binder, at its return, is told that the connector is absent, and binds once more
    TOLD = "told"  # the connector is told where to connect to


LINK_TRANSITIONS: Final[Mapping[tuple[LinkState, LinkEvent], LinkState]] = {
    (LinkState.JOINED, LinkEvent.BINDER_LOST): LinkState.CUT,
    (LinkState.JOINED, LinkEvent.CONNECTOR_LOST): LinkState.CUT,
    (LinkState.CUT, LinkEvent.BINDER_LOST): LinkState.CUT,
    (LinkState.CUT, LinkEvent.CONNECTOR_LOST): LinkState.CUT,
    (LinkState.CUT, LinkEvent.PLACE): LinkState.OFFERED,
    (LinkState.OFFERED, LinkEvent.BINDER_LOST): LinkState.CUT,
    (LinkState.OFFERED, LinkEvent.CONNECTOR_LOST): LinkState.OFFERED,  # nobody has been there: it is as good as new
    (LinkState.OFFERED, LinkEvent.ASKED): LinkState.CUT,
    (LinkState.OFFERED, LinkEvent.TOLD): LinkState.JOINED,
}
"""Everything that can happen to a link. A link that is cut, and whose binder runs, is owed one Offer: no more than one
is ever on its way."""


def other_end(link: LinkPlan, node: str) -> str:
    """Who is at the end of ``link`` that is not ``node``'s."""
    return link.connector if link.binder == node else link.binder


class Links:
    """The state of every link, and the places of those that are offered."""

    def __init__(self, graph: Topology) -> None:
        """All joined, as after a start."""
        self._of = {node: graph.links_of(node) for node in graph.nodes}
        self._states = {(link.binder, link.connector): LinkState.JOINED for link in graph.links}
        self._places: dict[tuple[str, str], str] = {}
        self._links = graph.links

    def of(self, node: str) -> tuple[LinkPlan, ...]:
        """The links that end at ``node``."""
        return self._of[node]

    def state(self, link: LinkPlan) -> LinkState:
        """Where ``link`` stands."""
        return self._states[link.binder, link.connector]

    def lost(self, node: str) -> list[str]:
        """``node`` is gone: cut its links; returns the other ends of those that were joined."""
        severed = []
        for link in self._of[node]:
            if self.state(link) is LinkState.JOINED:
                severed.append(other_end(link, node))
            self._move(link, LinkEvent.BINDER_LOST if link.binder == node else LinkEvent.CONNECTOR_LOST)
        return severed

    def owed(self, binder: str, connector: str) -> bool:
        """Whether ``binder`` may offer a place for ``connector``."""
        return self._states.get((binder, connector)) is LinkState.CUT

    def offer(self, binder: str, connector: str, place: str) -> None:
        """``binder`` has bound a fresh place; the link must be cut."""
        state = self._states[binder, connector]
        self._states[binder, connector] = LINK_TRANSITIONS[state, LinkEvent.PLACE]
        self._places[binder, connector] = place

    def ask(self, link: LinkPlan) -> None:
        """The binder of an offered link is told that the connector is absent."""
        self._move(link, LinkEvent.ASKED)

    def tell(self, link: LinkPlan) -> str:
        """The connector of an offered link is told; returns the place."""
        self._move(link, LinkEvent.TOLD)
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
class RestartBudget:
    """Counts the deaths of each node against what is allowed.

    Attributes:
        restarts: how many deaths in a row a node may come back from; with 0 none does.
        window: after a run of this length (ns) all earlier deaths are forgotten.
    """

    restarts: int = 0
    window: Duration = WINDOW
    _deaths: dict[str, int] = field(default_factory=dict)
    _ran_since: dict[str, int] = field(default_factory=dict)

    def ran(self, node: str, now: int) -> None:
        """``node`` runs from ``now`` on (monotonic ns)."""
        self._ran_since[node] = now

    def died(self, node: str, now: int) -> bool:
        """Count a death at ``now``; whether the node may come back from it."""
        since = self._ran_since.pop(node, None)  # a death before the next run is none after a long one
        stable = since is not None and now - since >= self.window
        deaths = self._deaths[node] = 1 if stable else self._deaths.get(node, 0) + 1
        return deaths <= self.restarts


RETURN_TIME = from_seconds(60.0)
"""How long a node may take from its start to its hello, and again over its handshakes."""


@dataclass
class Recovery:
    """What is known of the nodes of a running session, for the sake of those that are lost.

    Attributes:
        graph: the session's nodes and links.
        remote: nodes that are started elsewhere.
        budget: how often a node may come back.
        states: where each node stands; the conductor's own.
        faults: where it is said who is gone for good; the conductor's own.
        incidents: what happened.
        start: what every node was told at the first tick, and is told again at its return, with ``reached``.
        reached: the latest tick that the environment has told of; the ticks are its.
        rungs: the rung of the ladder that each coupling was asked to change to.
        pids: process ids of those that were started anew here.
        closing: whether the environment has done its ticks, so that nobody returns any more.
    """

    graph: Topology
    remote: frozenset[str]
    budget: RestartBudget
    states: dict[str, NodeState]
    faults: list[str]
    incidents: Incidents = field(default_factory=Incidents)
    start: Start = field(default_factory=lambda: Start(0, 0))
    reached: int = 0
    rungs: dict[str, int] = field(default_factory=dict)
    pids: dict[str, int] = field(default_factory=dict)
    closing: bool = False
    _links: Links = field(init=False)
    _then: dict[str, NodeState] = field(default_factory=dict)  # of those that leave
    _since: dict[str, int] = field(default_factory=dict)  # from when on a return is waited for

    def __post_init__(self) -> None:
        self._links = Links(self.graph)

    def lose(self, node: str, how: str, now: int, *, alive: bool = False) -> list[Instruction]:
        """``node`` is lost, or has failed to return; that is charged to its budget.

        Args:
            node: who.
            how: what became of it, for a person.
            now: monotonic ns.
            alive: whether its process is still to be seen to end.
        """
        self.tell(f"{node} {how}", now)
        out = self._drop(node, self._future(self.budget.died(node, now)), alive, now)
        if self._awaits(node, NodeState.GONE):
            self.faults.append(
                f"{node} {how}; it stays away, for its {self.budget.restarts} restarts without a run of "
                f"{self.budget.window / 1e9:g} s between them are used up"
            )
        return out + self.proceed(now)

    def left(self, node: str, now: int) -> list[Instruction]:
        """The process of a node that was leaving has ended."""
        self.states[node] = self._then.pop(node)
        return self.proceed(now)

    def greet(self, node: str, endpoints: dict[str, str], now: int) -> list[Instruction]:
        """``node`` is back and was welcomed; it has bound ``endpoints``."""
        self.states[node] = NodeState.WELCOMED
        self._since.pop(node, None)  # from here on it waits for others
        for peer, endpoint in endpoints.items():
            self._links.offer(node, peer, endpoint)
        return self.proceed(now)

    def hear_offer(self, node: str, offer: Offer, now: int) -> list[Instruction] | None:
        """A place for somebody who is absent; None if ``node`` was not asked for one."""
        if self.states[node] not in OFFERING or not self._links.owed(node, offer.peer):
            return None
        self._links.offer(node, offer.peer, offer.endpoint)
        return self.proceed(now)

    def ready(self, node: str, now: int) -> list[Instruction]:
        """``node`` has all its links, and takes part again from the present tick on."""
        self.states[node] = NodeState.RUNNING
        self._since.pop(node, None)
        self.budget.ran(node, now)
        self.incidents.restarts[node] += 1
        self.tell(f"{node} is back", now)
        start = replace(self.start, tick=max(1, self.reached))  # not 0: it is not at the beginning
        return [Send(node, start), *self._repeated_shifts(node), *self.proceed(now)]

    def disown(self, node: str) -> list[Instruction]:
        """A former process of ``node`` still speaks, or its frames are still coming in: its name is for the next one.

        One on another machine that was taken for lost, and was not, is told, so that its user may join again.
        """
        if self.states[node] not in (NodeState.LOST, NodeState.GONE, NodeState.STARTING):
            return []
        farewell: list[Instruction] = [Send(node, Stop("you were taken for lost"))] if node in self.remote else []
        return [*farewell, ReleaseName(node)]

    def overdue(self, now: int) -> list[Instruction]:
        """Give up those who take too long to return."""
        late = [node for node, since in self._since.items() if now - since > RETURN_TIME]
        out: list[Instruction] = []
        for node in late:
            if node not in self._since:
                continue  # it was given up with one of the others
            out += self._end_process(node)
            out += self.lose(node, f"took too long to return ({self.states[node]})", now, alive=node not in self.remote)
        return out

    def shift(self, coupling: str, rung: int) -> list[Instruction]:
        """Have ``coupling`` changed to ``rung``; the environment is told, now and whenever it must be told again."""
        self.rungs[coupling] = rung
        return [Send(world, Shift(coupling, rung)) for world in self._environments()]

    def close(self, now: int) -> list[Instruction]:
        """The environment is done: nobody is waited for who does not run, and nobody returns."""
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
        """Whether nobody is left to go on with: no environment, or no device that its forces could reach."""
        if any(self._awaits(world, NodeState.GONE) for world in self._environments()):
            return True
        devices = [node for node, role in self.graph.nodes.items() if role is Role.DEVICE]
        return all(self._cut_off(device) for device in devices)

    def proceed(self, now: int) -> list[Instruction]:
        """Whatever can go on: starts, connections, links between two that run."""
        out: list[Instruction] = []
        if self.closing:
            return out
        for node in reversed(list(self.graph.nodes)):  # binders before those who connect to them
            state = self.states[node]
            if state is NodeState.LOST and node not in self.remote and self._all_to_be_found(node):
                self.states[node], self._since[node] = NodeState.STARTING, now
                out += [ReleaseName(node), StartProcess(node)]
            elif state is NodeState.WELCOMED and self._all_to_be_found(node):
                self.states[node], self._since[node] = NodeState.CONNECTED, now
                out += self._connect(node)
        running = [node for node, state in self.states.items() if state is NodeState.RUNNING]
        for link in list(self._links.offered_between(running)):
            out.append(Send(link.connector, Return(link.binder, self._links.tell(link))))
        return out

    def _future(self, allowed: bool) -> NodeState:
        if self.closing:
            return NodeState.ENDED
        return NodeState.LOST if allowed else NodeState.GONE

    def _awaits(self, node: str, end: NodeState) -> bool:
        """Whether ``node`` is, or will be once its process has ended, in the state ``end``."""
        return self.states[node] is end or (self.states[node] is NodeState.LEAVING and self._then[node] is end)

    def tell(self, sentence: str, now: int) -> None:
        """Something happened ``now``, monotonic ns, that the session withstands."""
        self.incidents.tell(f"at {(now - self.start.epoch) / 1e9:.1f} s: {sentence}")

    def _drop(self, node: str, future: NodeState, alive: bool, now: int) -> list[Instruction]:
        """Take ``node`` out of the session, and tell those who were linked to it."""
        self._since.pop(node, None)
        if alive:
            self.states[node], self._then[node] = NodeState.LEAVING, future
        else:
            self.states[node] = future
        out: list[Instruction] = [ReleaseName(node)] if node in self.remote else []
        for peer in self._links.lost(node):
            if self.states[peer] is NodeState.RUNNING:
                out.append(Send(peer, Absent(node)))
            elif self.states[peer] in RETURNING:  # it shakes hands with somebody who will not answer
                self.tell(f"{peer} cannot return: {node} was lost meanwhile", now)
                out += self._end_process(peer)
                out += self._drop(peer, self._future(allowed=True), peer not in self.remote, now)  # no fault of its own
        return out

    def _end_process(self, node: str) -> list[Instruction]:
        """End a process that cannot return; one elsewhere is asked to end, and may be started by its user again."""
        return [Send(node, Stop("the return failed; join again"))] if node in self.remote else [KillProcess(node)]

    def _all_to_be_found(self, node: str) -> bool:
        """Whether everybody that ``node`` connects to either has a place for it or will not have one for long."""
        return all(self._to_be_found(link) for link in self._links.of(node) if link.connector == node)

    def _to_be_found(self, link: LinkPlan) -> bool:
        state = self.states[link.binder]
        if state is NodeState.RUNNING:
            return self._links.state(link) is LinkState.OFFERED
        if state is NodeState.LOST:
            return link.binder in self.remote  # who knows when its user comes back
        return state not in RETURNING and state is not NodeState.LEAVING

    def _connect(self, node: str) -> Iterator[Instruction]:
        """Tell ``node`` who is absent and where the others are, and those who connect to it where it is."""
        endpoints: dict[str, str] = {}
        returns: list[Instruction] = []
        for link in self._links.of(node):
            peer = other_end(link, node)
            offered = self._links.state(link) is LinkState.OFFERED
            if self.states[peer] is NodeState.RUNNING and offered:
                place = self._links.tell(link)
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
        """What a node that starts at rung 0 must be told again, and whom it concerns."""
        peers = {node, *(other_end(link, node) for link in self._links.of(node))}
        concerned = [coupling for coupling in self.rungs if coupling in peers]
        return [told for coupling in concerned for told in self.shift(coupling, self.rungs[coupling])]

    def _environments(self) -> list[str]:
        return [node for node, role in self.graph.nodes.items() if role is Role.ENVIRONMENT]

    def _cut_off(self, device: str) -> bool:
        """Whether no force will reach ``device`` any more."""
        couplings = [other_end(link, device) for link in self._links.of(device)]
        couplings += self.graph.together(device)[1:]
        return self._awaits(device, NodeState.GONE) or all(self._awaits(c, NodeState.GONE) for c in couplings)
