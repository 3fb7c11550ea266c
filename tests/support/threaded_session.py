"""A session whose nodes are threads, over the in-memory transport, with a test in the supervisor's place.

The test ends nodes without a message, reports this to the survivors, collects their offers, and starts nodes anew. It
waits for the nodes' telemetry and for their looks at a line, never for time to pass.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.topology import topology
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.environment.membership import Membership
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.kernel.bundle import SIMULATED, Bundle, CouplingBundle, DeviceBundle, EnvironmentBundle, Peer
from manyhands.nodes.kernel.log import Log
from manyhands.nodes.link.process import Node
from manyhands.nodes.link.supervisor_line import NOT_AT_ALL, Word
from manyhands.protocol.clock import Duration, Instant, RealtimeClock, seconds
from manyhands.protocol.messages import Absent, Report, Return, Start, Telemetry
from manyhands.protocol.transport import Link
from tests.support.memory_transport import MemoryTransport

PATIENCE = 30.0  # s, of a test for what must come


class ThreadLine:
    """A node's line to the test.

    Attributes:
        told: every telemetry, with its traces copied.
        pause: the node waits in the telemetry of this tick until :meth:`ThreadedSession.release`; -1: it never waits.
    """

    def __init__(self, transport: MemoryTransport, name: str, generation: int) -> None:
        self._transport, self._name, self._generation = transport, f"{name}.{generation}", 0
        self.words: queue.SimpleQueue[Word] = queue.SimpleQueue()
        self.offers: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self.told: list[Telemetry] = []
        self.pause = -1
        self.paused, self.released = threading.Event(), threading.Event()
        self.dropped = 0
        self.log = Log(None, "s", name, RealtimeClock())
        self._news = threading.Condition()
        self.looking: Callable[[], None] = lambda: None
        self.given_up = False

    def listen(self, timeout: Duration = NOT_AT_ALL) -> Word | None:
        self.looking()
        try:
            return self.words.get(timeout=seconds(timeout)) if timeout else self.words.get_nowait()
        except queue.Empty:
            return None

    def bind_anew(self, peer: Peer) -> tuple[Link, str]:
        self._generation += 1
        return self._transport.bind(f"{self._name}-{peer.name}.{self._generation}", peer.name)

    def connect(self, endpoint: str, peer: Peer) -> Link:
        return self._transport.connect(endpoint, peer.name)

    def offer(self, peer: str, endpoint: str) -> None:
        self.offers.put((peer, endpoint))

    def publish(self, telemetry: Telemetry) -> None:
        traces = {name: trace.copy() for name, trace in telemetry.traces.items()}
        with self._news:
            self.told.append(Telemetry(telemetry.tick, telemetry.figures, traces))
            self._news.notify_all()
        if 0 <= self.pause <= telemetry.tick:
            self.paused.set()
            self.released.wait(PATIENCE)

    def reach(self, done: Callable[[Telemetry], bool]) -> Telemetry:
        """Wait for a telemetry that is ``done``."""
        with self._news:
            assert self._news.wait_for(lambda: self.given_up or any(map(done, self.told)), PATIENCE)
            assert not self.given_up, self._name
            return next(filter(done, self.told))

    def give_up(self) -> None:
        """End every wait, because a node has failed."""
        with self._news:
            self.given_up = True
            self._news.notify_all()
        self.paused.set()
        self.released.set()

    def trace(self, name: str) -> np.ndarray:
        """One trace over all ticks."""
        return np.vstack([telemetry.traces[name] for telemetry in self.told])


def _in_step(bundle: Bundle) -> Bundle:
    """The bundle with telemetry in the same ticks for all nodes, so that a test knows in which."""
    common = bundle.common
    return replace(bundle, common=replace(common, telemetry_first=common.telemetry_ticks))


class ThreadedSession:
    """A session whose nodes are threads; use it as a context."""

    def __init__(
        self, prepared: Prepared, new_life: Callable[[], Any], *, clock: str = SIMULATED, ticks: int = 0, tick: int = 0
    ) -> None:
        """``ticks``: how many to run; 0 until the stage is left. ``tick``: the one that the session is at already."""
        self.graph = topology(prepared.session)
        self._new_life, self._ticks, self._tick = new_life, ticks, tick
        self._bundles = {name: _in_step(bundle) for name, bundle in cut(prepared, RunPlan(clock, None, "")).items()}
        self.transport = MemoryTransport()
        self._pool = ThreadPoolExecutor(3 * len(self.graph.nodes))
        self.lines: dict[str, ThreadLine] = {}
        self.all_lines: list[ThreadLine] = []
        self.lives: dict[str, Any] = {}
        self.nodes: dict[str, Node] = {}
        self.ends: dict[str, Future[None]] = {}
        self._generation = 0
        self._awaited: list[threading.Event] = []
        self.error: BaseException | None = None
        self.epoch = Instant(RealtimeClock().now() + 50_000_000)
        self.prepare: Callable[[str, ThreadLine], None] = lambda _name, _line: None

    def __enter__(self) -> ThreadedSession:
        links: dict[str, dict[str, Link]] = {name: {} for name in self.graph.nodes}
        for plan in self.graph.links:
            link, endpoint = self.transport.bind(f"{plan.binder}-{plan.connector}", plan.connector)
            links[plan.binder][plan.connector] = link
            links[plan.connector][plan.binder] = self.transport.connect(endpoint, plan.binder)
        for name in self.graph.nodes:
            if name not in self.graph.carriers:
                self._run(name, links, self._tick)
        return self

    def __exit__(self, *_: object) -> None:
        for life in self.lives.values():
            life.stopping = True
        for line in self.all_lines:
            line.released.set()
        self._pool.shutdown()
        self.transport.close()
        if self.error is not None:  # the cause of whatever else went wrong
            raise self.error

    def together(self, name: str) -> list[str]:
        """A node and the couplings that it carries."""
        return [name, *(node for node, carrier in self.graph.carriers.items() if carrier == name)]

    def _run(self, name: str, links: dict[str, dict[str, Link]], tick: int) -> None:
        """Start a thread for ``name`` and the couplings that it carries."""
        together, life = self.together(name), self._new_life()
        carried = [CouplingNode(self._bundles[other]) for other in together[1:]]  # type: ignore[arg-type]
        leader: Node
        match self._bundles[name]:
            case DeviceBundle() as bundle:
                leader = DeviceNode(bundle, driver_of(bundle), inside=carried)
            case CouplingBundle() as bundle:
                leader = CouplingNode(bundle)
            case EnvironmentBundle() as bundle:
                leader = EnvironmentNode(bundle)
        self.nodes.update(zip(together, (leader, *carried), strict=True))
        for node in together:
            self._generation += 1
            line = self.lines[node] = ThreadLine(self.transport, node, self._generation)
            self.all_lines.append(line)
            self.prepare(node, line)
            self.lives[node] = life
        lines = [self.lines[node] for node in together]
        start = Start(self.epoch, self._ticks, tick)

        def run() -> None:
            for node, one in zip(together[1:], carried, strict=True):
                one.establish(links[node])
            leader.establish(links[name])
            for one, line in zip(carried, lines[1:], strict=True):
                one.loop(start, life, line)  # type: ignore[arg-type]
            leader.loop(start, life, lines[0])  # type: ignore[arg-type]

        end = self._pool.submit(run)
        end.add_done_callback(self._look_at)
        self.ends.update(dict.fromkeys(together, end))

    def _look_at(self, end: Future[None]) -> None:
        """End the other nodes at a node's error; leaving the session raises it."""
        if (error := end.exception()) is not None or any(life.failure for life in self.lives.values()):
            self.error = self.error or error
            for life in self.lives.values():
                life.stopping = True
            for line in self.all_lines:
                line.give_up()
            for seen in self._awaited:
                seen.set()

    def paused(self, name: str) -> None:
        """Wait until a node pauses."""
        assert self.lines[name].paused.wait(PATIENCE)
        self._raise()

    def release(self, name: str) -> None:
        """Let a node that pauses go on."""
        self.lines[name].pause = -1
        self.lines[name].released.set()

    def see(self, name: str, what: Callable[[], bool]) -> None:
        """Wait until ``what`` holds; it is tested whenever the node looks at its line."""
        seen = threading.Event()
        self._awaited.append(seen)
        self.lines[name].looking = lambda: seen.set() if what() else None
        assert seen.wait(PATIENCE)
        self._raise()

    def _raise(self) -> None:
        failures = [life.failure for life in self.lives.values() if life.failure]
        assert not failures, failures
        if self.error is not None:
            raise self.error

    def reach(self, name: str, tick: int) -> int:
        """Wait until a node has sent telemetry of this tick."""
        return self.lines[name].reach(lambda telemetry: telemetry.tick >= tick).tick

    def lose(self, *names: str) -> None:
        """End nodes without a message, all at once; then report them as absent to their living peers."""
        gone = {node for name in names for node in self.together(name)}
        for name in names:
            self.lives[name].stopping = True
        for name in names:
            self.lines[name].released.set()
            self.ends[name].result(timeout=PATIENCE)
        for name in gone:
            for peer in self.peers(name):
                if peer not in gone:
                    self.lines[peer].words.put(Absent(name))

    def bring_back(self, name: str, tick: int, absent: Sequence[str] = ()) -> None:
        """Start a new process for ``name``, and report ``absent`` to it as lost peers."""
        links: dict[str, dict[str, Link]] = {}
        returns: list[tuple[str, Return]] = []
        for node in self.together(name):
            mine = links[node] = {}
            for plan in self.graph.links_of(node):
                peer = plan.connector if plan.binder == node else plan.binder
                if peer in absent:
                    continue
                self._generation += 1
                if plan.binder == node:
                    mine[peer], endpoint = self.transport.bind(f"{node}.{self._generation}", peer)
                    returns.append((peer, Return(node, endpoint)))
                else:
                    offered, endpoint = self.lines[peer].offers.get(timeout=PATIENCE)
                    assert offered == node
                    mine[peer] = self.transport.connect(endpoint, peer)
        self._run(name, links, tick)
        for peer, word in returns:
            self.lines[peer].words.put(word)
        for node in self.together(name):
            for peer in absent:
                if peer in self.peers(node):
                    self.lines[node].words.put(Absent(peer))

    def peers(self, name: str) -> list[str]:
        return [plan.connector if plan.binder == name else plan.binder for plan in self.graph.links_of(name)]

    def state(self, coupling: str) -> Membership | None:
        """The membership of a coupling now; None before the environment has shaken hands."""
        environment = self.nodes[ENVIRONMENT]
        assert isinstance(environment, EnvironmentNode)
        members = environment.members
        if members is None:
            return None
        return next(member.membership.state for member in members.all if member.join.peer.name == coupling)

    def await_state(self, coupling: str, *states: Membership) -> None:
        """Wait until the environment gives ``coupling`` one of these states; it looks at its line repeatedly."""
        self.see(ENVIRONMENT, lambda: self.state(coupling) in states)

    def reports(self, *names: str) -> dict[str, Report]:
        """The reports of all nodes, or of ``names``, after their end."""
        for name in names or self.nodes:
            self.ends[name].result(timeout=PATIENCE)
        return {name: self.nodes[name].report() for name in names or self.nodes}

    def end(self) -> dict[str, Report]:
        """End a session that has no last tick."""
        for life in self.lives.values():
            life.stopping = True
        for line in self.all_lines:
            line.released.set()
        return self.reports()
