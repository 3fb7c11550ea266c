"""The process of one or several nodes from its start to its exit code, whatever their role.

    bind -> hello -> (welcome, connect) -> shake hands on every link -> ready -> (start) -> ticks -> report

A role adds a :class:`Node`. A failure at any step ends in one Fault to the supervisor, one line on standard error, and
an exit code other than 0.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

from manyhands.nodes.kernel.bundle import (
    SIMULATED,
    BundleError,
    Common,
    CouplingBundle,
    DeviceBundle,
    EnvironmentBundle,
    load,
    own_start,
)
from manyhands.nodes.kernel.lifetime import Life, Sight, Stopped
from manyhands.nodes.kernel.log import Log, LogEvent, log_path
from manyhands.nodes.kernel.realtime import Granted, RealtimeWishes, pin_guest, prepare, restore
from manyhands.nodes.link.peer_link import bind_links
from manyhands.nodes.link.supervisor_line import ControlLine, Refused
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Instant, RealtimeClock
from manyhands.protocol.handshake import HandshakeRefused, HandshakeTimeout
from manyhands.protocol.keys import KeyFileError, KeyRing, load_private
from manyhands.protocol.messages import Figures, Report, Start
from manyhands.protocol.transport import Link, Transport, TransportError
from manyhands.protocol.transport.descriptors import node_needs, require_descriptors
from manyhands.protocol.transport.zeromq import ZmqTransport

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
EXIT_REFUSED = 4


class Node(Protocol):
    """The part of a node that depends on its role."""

    @property
    def by_itself(self) -> tuple[str, ...]:
        """Of a device, what it does by itself; empty for the others."""
        ...

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with every peer on ``links``, a link for each peer that is present."""
        ...

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Run the ticks until the last one or ``life.stopping``."""
        ...

    def report(self) -> Report:
        """The figures of the whole run, for the supervisor."""
        ...


_B = TypeVar("_B", DeviceBundle, CouplingBundle, EnvironmentBundle)


def main(kind: type[_B], make: Callable[[_B], Node]) -> int:
    """Run the node whose bundle and supervisor's process id the command line names; returns the exit code.

    Args:
        kind: the type of the bundle.
        make: makes the node from its bundle.
    """
    return main_together(kind, lambda bundle: [(bundle, make(bundle))])


def main_together(
    kind: type[_B], make: Callable[[_B], Sequence[tuple[DeviceBundle | CouplingBundle | EnvironmentBundle, Node]]]
) -> int:
    """As :func:`main`, for a process of several nodes; ``make`` makes all of them from the first node's bundle."""
    if len(sys.argv) != 3 or not sys.argv[2].isdigit():
        print("usage: python -m manyhands.nodes.ROLE BUNDLE SUPERVISOR_PID", file=sys.stderr)  # noqa: T201
        return EXIT_BAD_INPUT
    try:
        life = Life(int(sys.argv[2]))
        bundle = load(Path(sys.argv[1]), kind)
        nodes = [(own.common, node, _ring_of(own.common)) for own, node in make(bundle)]
    except Stopped:
        return EXIT_OK
    except (BundleError, KeyFileError, TransportError, ValueError, OverflowError) as error:
        print(error, file=sys.stderr)  # noqa: T201 -- there is no line to the supervisor yet
        return EXIT_BAD_INPUT
    return run_together(nodes, life)


def _ring_of(common: Common) -> KeyRing | None:
    return key_ring(common, Path(common.private)) if common.public else None


def key_ring(common: Common, private: Path) -> KeyRing:
    """The node's own key pair, and the public keys of its peers and the supervisor.

    Args:
        common: the node's bundle.
        private: the file of its private key.

    Raises:
        KeyFileError: the private key cannot be read, or is not this node's.
    """
    pair = load_private(private, common.session, common.name)
    if common.public.get(common.name) != pair.public:
        raise KeyFileError(
            f"{private}: found a key that is not the one in the bundle of {common.name}; "
            "expected the one it was cut with; have bundle and key renewed together"
        )
    return KeyRing(common.name, pair, {name: key for name, key in common.public.items() if name != common.name})


@dataclass
class HostedNode:
    """One node of the process. There are several where couplings are co-located with their device.

    Attributes:
        common: the common part of its bundle.
        node: the part that depends on its role.
        transport: its sockets; each node has its own, as it has its own keys.
        control: its line to the supervisor.
        links: by peer, the links that exist so far.
    """

    common: Common
    node: Node
    transport: Transport
    control: ControlLine
    links: dict[str, Link] = field(default_factory=dict)


def run(common: Common, node: Node, life: Life, ring: KeyRing | None, remote: bool = False) -> int:
    """Run one node to its end; returns the exit code.

    Args:
        common: the common part of its bundle.
        node: the part that depends on its role.
        life: whether the process should still run.
        ring: its keys; None for a session without keys.
        remote: whether its supervisor may be on a different machine.
    """
    return run_together([(common, node, ring)], life, remote)


Engage = Callable[[Sequence[ControlLine], Life], None]
"""Called with the lines of a process's nodes before they shake hands; raises Stopped where they are not to."""


def run_together(
    nodes: Sequence[tuple[Common, Node, KeyRing | None]],
    life: Life,
    remote: bool = False,
    host: str = "",
    engage: Engage | None = None,
) -> int:
    """Run one or several nodes in this process; the loop of the first node runs the ticks of all of them.

    The others shake hands before the first node does, in the order given, which must be the session's. Their loops
    begin before the first node's, and return at once.

    Args:
        nodes: the common part of each node's bundle, the node and its keys.
        life: whether the process should still run.
        remote: whether the supervisor may be on a different machine.
        host: where that machine is reached, as for :class:`ControlLine`.
        engage: called before the handshakes; None for nothing.
    """
    members: list[HostedNode] = []
    transports: list[Transport] = []
    if remote and nodes[0][0].clock != SIMULATED:
        pin_guest(nodes[0][0].name)
    try:
        try:
            require_descriptors(node_needs(sum(len(common.peers) for common, _, _ in nodes)))
            for common, node, ring in nodes:
                transport: Transport = ZmqTransport.of(common.transport, common.folder, ring)
                transports.append(transport)
                control = ControlLine(transport, common, _log_of(common), host)
                members.append(HostedNode(common, node, transport, control))
        except TransportError as error:
            print(f"error: {nodes[0][0].name}: {error}", file=sys.stderr)  # noqa: T201 -- no line to the supervisor
            return EXIT_BAD_INPUT
        return run_members(members, life, remote, engage)
    except Stopped:
        return EXIT_OK
    finally:
        for member in members:
            member.control.log.close()
        for transport in transports:
            transport.close()


def _log_of(common: Common) -> Log:
    log = Log(log_path(common.directory, common.name), common.session, common.name, RealtimeClock())
    log.note(LogEvent.START, role=common.role.value, pid=os.getpid(), certificate=common.certificate)
    return log


def run_members(members: Sequence[HostedNode], life: Life, remote: bool, engage: Engage | None = None) -> int:
    """Run the nodes to their end, and report how they ended to the supervisor and the log; returns the exit code."""
    common, control = members[0].common, members[0].control
    if remote:
        life.watch = lambda: _first(member.control.joining(RealtimeClock().now()) for member in members)
    try:
        code = _converse(members, life, remote, engage)
    except Stopped:
        code = _stopped(members, life) if remote else EXIT_OK
    except (HandshakeRefused, Refused) as error:
        _fault(members, str(error), life, remote)
        print(error, file=sys.stderr)  # noqa: T201 -- the process's own error channel
        control.log.note(LogEvent.REFUSED, reason=str(error))
        code = EXIT_REFUSED
    except (HandshakeTimeout, TransportError, ValueError) as error:
        text = str(error) if isinstance(error, HandshakeTimeout) else f"{common.name}: {error}"
        _fault(members, text, life, remote)
        print(error, file=sys.stderr)  # noqa: T201
        control.log.note(LogEvent.FAULT, text=text)
        code = EXIT_FAILED
    for member in members:
        member.control.log.note(LogEvent.END, reason=life.failure or "", code=code)
    return code


def _converse(members: Sequence[HostedNode], life: Life, remote: bool, engage: Engage | None) -> int:
    leader, others = members[0], members[1:]
    for member in members:
        member.links, endpoints = bind_links(member.common, member.transport)
        member.control.hello(endpoints, os.getpid())
    for member in members:
        _connect(member, life)
    if engage is not None:
        engage([member.control for member in members], life)
    for member in (*others, leader):
        member.node.establish(member.links)
        member.control.log.note(LogEvent.ESTABLISHED, peers=len(member.links))
    clock = RealtimeClock()
    ahead = leader.control.clock_offset(clock, life) if remote else 0
    for member in members:
        member.control.ready(member.node.by_itself)
    start, *_ = [member.control.start(life) for member in members]
    if remote:
        start = Start(start.epoch - ahead, start.ticks, start.tick)
        life.watch = lambda: _sight(members, clock.now())
    leader.control.require_near(start, clock.now())
    for member in members:
        member.transport.settle()
        member.control.log.note(LogEvent.LOOP, ticks=start.ticks, tick=start.tick)
    granted = _prepare(leader)
    for member in members:
        member.control.log.flush()
    life.enter_loop()
    try:
        for member in others:
            member.node.loop(own_start(member.common, start), life, member.control)
        leader.node.loop(own_start(leader.common, start), life, leader.control)
    finally:
        life.leave_loop()
        if granted is not None:
            restore(granted)
    if remote:
        # from now on a Stop is the supervisor's answer to the last message, and no longer a request to end
        life.watch = leader.control.connection
    if life.failure is not None:
        _fault(members, life.failure, life, remote)
        print(life.failure, file=sys.stderr)  # noqa: T201 -- the process's own error channel
        return EXIT_FAILED
    if remote and life.orphaned:
        return _lost(leader.common)
    for member in members:
        _report(member, {} if granted is None else granted.table(), life)
    return EXIT_OK


def _fault(members: Sequence[HostedNode], text: str, life: Life, remote: bool) -> None:
    """Report a fault: one ends a session's own process, and a guest's nodes are lost one by one."""
    for member in members if remote else members[:1]:
        member.control.fault(text, life)


def _sight(members: Sequence[HostedNode], now: Instant) -> Sight:
    """What a guest in its loop sees of the supervisor, on the lines of all its nodes."""
    return _first(member.control.sight(now) for member in members)


def _first(seen: Iterable[Sight]) -> Sight:
    """The first that is not PRESENT, of the lines of all nodes; every line is looked at."""
    return next((sight for sight in list(seen) if sight is not Sight.PRESENT), Sight.PRESENT)


def _connect(member: HostedNode, life: Life) -> None:
    """Wait for the endpoints of the peers that bind their links, and connect to them."""
    endpoints = member.control.peers_endpoints(life)
    for name in member.control.absent:  # an absent peer may come back, but on a new link
        link = member.links.pop(name, None)
        if link is not None:
            link.close()
    wanted = {peer.name for peer in member.common.peers if not peer.binds} - member.control.absent
    if endpoints.keys() != wanted:
        raise ValueError(
            f"found endpoints of {sorted(endpoints)}; expected those of {sorted(wanted)}; see what listens there"
        )
    for name, endpoint in endpoints.items():
        member.links[name] = member.transport.connect(endpoint, name)
    member.control.log.note(LogEvent.WELCOMED)


def _prepare(leader: HostedNode) -> Granted | None:
    """Ask the machine for real-time scheduling and locked memory; None under the simulated clock."""
    if leader.common.clock == SIMULATED:
        return None
    granted = prepare(RealtimeWishes(links=len(leader.common.peers)))
    for name, grant in granted.grants().items():
        leader.control.log.note(LogEvent.GRANTED, wish=name, granted=grant.granted, said=grant.answer)
    return granted


def _report(member: HostedNode, granted: Mapping[str, float], life: Life) -> None:
    """Send the report of one node."""
    report = member.node.report()
    control = member.control
    lost = {"telemetry": float(control.dropped), "log": float(control.log.dropped)}
    tables = {
        **report.figures.tables,
        names.REFUSED: {kind: float(count) for kind, count in control.refused().items()},
        names.DROPPED: {**report.figures.table(names.DROPPED), **lost},
        **({names.REALTIME: granted} if granted else {}),
    }
    control.report(Report(report.ticks, Figures(report.figures, tables)), life)


def _stopped(members: Sequence[HostedNode], life: Life) -> int:
    """End a guest before its loop; it reports its end, which a supervisor on a different machine cannot see."""
    if life.orphaned:
        return _lost(members[0].common)
    if life.stopping:  # its user ended it, for a Stop of the supervisor does not set this
        for member in members:
            member.control.fault(f"{member.common.name}: its user ended it before the first tick", life, by_user=True)
    return EXIT_OK


def _lost(common: Common) -> int:
    print(f"{common.name}: lost the supervisor at {common.control}", file=sys.stderr)  # noqa: T201
    return EXIT_FAILED
