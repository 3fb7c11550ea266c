"""The life of a node's process from its first line to its exit code, whatever its role.

    bind -> hello -> (welcome, connect) -> shake hands on every link -> ready -> (start) -> ticks -> report

Everything a role adds is a :class:`Node`; everything that can go wrong on the way ends in one Fault to the
supervisor, one line on standard error, and an exit code other than 0.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol, TypeVar

from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import (
    BundleError,
    Common,
    CouplingBundle,
    DeviceBundle,
    EnvironmentBundle,
    load,
)
from manyhands.nodes.control import ControlLine, Refused
from manyhands.nodes.exchange import bind_links
from manyhands.nodes.life import Life, Stopped
from manyhands.protocol.clock import RealtimeClock
from manyhands.protocol.handshake import HandshakeRefused, HandshakeTimeout
from manyhands.protocol.key_files import KeyFileError
from manyhands.protocol.keys import KeyRing, load_private
from manyhands.protocol.messages import Report, Start
from manyhands.protocol.transport import Link, Transport, TransportError
from manyhands.protocol.transport.zeromq import ZmqTransport

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
EXIT_REFUSED = 4


class Node(Protocol):
    """What a role adds to :func:`run`."""

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with every peer."""
        ...

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Run the ticks, until done or ``life.stopping``."""
        ...

    def report(self) -> Report:
        """The node's last word."""
        ...


_B = TypeVar("_B", DeviceBundle, CouplingBundle, EnvironmentBundle)


def main(kind: type[_B], make: Callable[[_B], Node]) -> int:
    """Run the node whose bundle and supervisor's process id the command line names; returns the exit code."""
    if len(sys.argv) != 3 or not sys.argv[2].isdigit():
        print("usage: python -m manyhands.nodes.ROLE BUNDLE SUPERVISOR_PID", file=sys.stderr)  # noqa: T201
        return EXIT_BAD_INPUT
    try:
        life = Life(int(sys.argv[2]))
        bundle = load(Path(sys.argv[1]), kind)
        ring = key_ring(bundle.common, Path(bundle.common.private)) if bundle.common.public else None
        node = make(bundle)
    except Stopped:
        return EXIT_OK
    except (BundleError, KeyFileError, ValueError, OverflowError) as error:
        print(error, file=sys.stderr)  # noqa: T201 -- there is no line to the supervisor yet
        return EXIT_BAD_INPUT
    return run(bundle.common, node, life, ring)


def key_ring(common: Common, private: Path) -> KeyRing:
    """The node's own keys, and the public ones of those it has to do with.

    Raises:
        KeyFileError: the private key cannot be read, or is not this node's.
    """
    pair = load_private(private, common.session, common.name)
    if common.public.get(common.name) != pair.public:
        raise KeyFileError(
            f"{private}: found another key than the bundle names for {common.name}; "
            "expected the one it was cut with; have bundle and key renewed together"
        )
    return KeyRing(common.name, pair, {name: key for name, key in common.public.items() if name != common.name})


def run(common: Common, node: Node, life: Life, ring: KeyRing | None, remote: bool = False) -> int:
    """Run one node to its end; returns the exit code.

    Args:
        common: its bundle.
        node: what its role adds.
        life: whether it should still run.
        ring: its keys; None for a session without.
        remote: whether it runs on another machine than its supervisor, or may.
    """
    transport: Transport = ZmqTransport.of(common.transport, Path(common.directory), ring)
    try:
        try:
            control = ControlLine(transport, common)
        except TransportError as error:
            print(f"error: {common.name}: {error}", file=sys.stderr)  # noqa: T201 -- no line to the supervisor
            return EXIT_BAD_INPUT
        if remote:
            life.watch = control.connection
        try:
            return _converse(common, node, life, transport, control, remote)
        except Stopped:
            return _stopped(common, life, control) if remote else EXIT_OK
        except (HandshakeRefused, Refused) as error:
            control.fault(str(error), life)
            print(error, file=sys.stderr)  # noqa: T201 -- the process's own error channel
            return EXIT_REFUSED
        except (HandshakeTimeout, TransportError, ValueError) as error:
            control.fault(str(error) if isinstance(error, HandshakeTimeout) else f"{common.name}: {error}", life)
            print(error, file=sys.stderr)  # noqa: T201
            return EXIT_FAILED
    except Stopped:
        return EXIT_OK
    finally:
        transport.close()


def _converse(common: Common, node: Node, life: Life, transport: Transport, control: ControlLine, remote: bool) -> int:
    links, endpoints = bind_links(common, transport)
    control.hello(endpoints, os.getpid())
    told, wanted = control.peers_endpoints(life), {peer.name for peer in common.peers if not peer.binds}
    if told.keys() != wanted:
        raise ValueError(
            f"found endpoints of {sorted(told)}; expected those of {sorted(wanted)}; see what listens there"
        )
    for name, endpoint in told.items():
        links[name] = transport.connect(endpoint, name)
    node.establish(links)
    clock = RealtimeClock()
    ahead = control.clock_offset(clock, life) if remote else 0
    control.ready()
    start = control.start(life)
    if remote:
        start = Start(start.epoch - ahead, start.ticks)
        life.watch = lambda: control.sight(clock.now())
    transport.settle()
    life.enter_loop()
    try:
        node.loop(start, life, control)
    finally:
        life.leave_loop()
    if remote:
        life.watch = control.connection  # a Stop is now the answer to the last word, and not to be taken from it
    if life.failure is not None:
        control.fault(life.failure, life)
        print(life.failure, file=sys.stderr)  # noqa: T201 -- the process's own error channel
        return EXIT_FAILED
    if remote and life.orphaned:
        return _lost(common)
    report = node.report()
    refused = {f"{names.REFUSED}{kind}": count for kind, count in transport.refused().items()}
    control.report(Report(report.ticks, report.figures, {**report.counts, **refused}, report.percentiles), life)
    return EXIT_OK


def _stopped(common: Common, life: Life, control: ControlLine) -> int:
    """The end of a guest before its loop; a supervisor elsewhere cannot see the process end, and is told."""
    if life.orphaned:
        return _lost(common)
    if life.stopping:  # and not because the supervisor said so
        control.fault(f"{common.name}: its user ended it before the first tick", life)
    return EXIT_OK


def _lost(common: Common) -> int:
    print(f"{common.name}: lost the supervisor at {common.control}", file=sys.stderr)  # noqa: T201
    return EXIT_FAILED
