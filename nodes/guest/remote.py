"""A guest: a node that joins a session on another machine, with its bundle and its key alone.

The bundle names the node and the peers that it may talk to. The user names the supervisor's endpoint. A guest has no
parent process to watch: it ends when its connection to the supervisor is lost, at the supervisor's Stop, or on Ctrl-C.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.guest.handed_over import STDIN, end_with_input, taken_over
from manyhands.nodes.guest.observer import observe
from manyhands.nodes.kernel.bundle import (
    BundleError,
    Common,
    CouplingBundle,
    DeviceBundle,
    EnvironmentBundle,
    ObserverBundle,
    elsewhere,
    foreign_code,
    load,
    role_of,
)
from manyhands.nodes.kernel.factory import require_allowed
from manyhands.nodes.kernel.lifetime import Life, Stopped
from manyhands.nodes.link.process import EXIT_BAD_INPUT, EXIT_OK, Node, key_ring, run
from manyhands.protocol.keys import KeyFileError
from manyhands.protocol.messages import Role
from manyhands.protocol.transport.zeromq import SCHEMES, is_address

MAKERS: dict[Role, tuple[type[Any], Callable[[Any], Node]]] = {
    Role.DEVICE: (DeviceBundle, lambda bundle: DeviceNode(bundle, driver_of(bundle))),
    Role.COUPLING: (CouplingBundle, CouplingNode),
    Role.ENVIRONMENT: (EnvironmentBundle, EnvironmentNode),
}


def join(
    name: str, bundle_path: Path, private: Path | None, endpoint: str, host: str | None, allowed: str | None = None
) -> int:
    """Run one node of a session whose supervisor is at ``endpoint``; returns the exit code (130 on Ctrl-C).

    Args:
        name: the node's name, which must be the name in the bundle.
        bundle_path: its bundle; :data:`manyhands.nodes.guest.handed_over.STDIN` for bundle and key over standard input.
        private: its private key's file; by default the bundle's own name with the suffix ``.key``.
        endpoint: ``tcp://HOST:PORT`` of the supervisor (or an ``ipc://`` path).
        host: the address of this machine that others reach; needed only by a node that others connect to.
        allowed: the factory of another package whose code the bundle may run here; None for none.
    """
    life = Life(None)
    try:
        code = _join(life, name, bundle_path, private, endpoint, host, allowed)
    except Stopped:
        code = EXIT_OK
    return code if life.signal is None or code != EXIT_OK else 128 + life.signal


def _join(
    life: Life,
    name: str,
    bundle_path: Path,
    private: Path | None,
    endpoint: str,
    host: str | None,
    allowed: str | None,
) -> int:
    try:
        with taken_over(name) if bundle_path == STDIN else nullcontext(bundle_path) as path:
            role = role_of(path)
            kind, make = MAKERS.get(role, (ObserverBundle, None))
            bundle = load(path, kind)
            common = _placed(bundle.common, name, path, endpoint, host)
            ring = key_ring(common, private or path.with_suffix(".key")) if common.public else None
        if bundle_path == STDIN:
            end_with_input()
        else:  # over standard input it comes from this user's own launch --on
            require_allowed(foreign_code(bundle), allowed)
        bundle = elsewhere(dataclasses.replace(bundle, common=common))
        if make is None:
            return observe(bundle, life, ring)
        node = make(bundle)
    except (BundleError, KeyFileError, ValueError, OverflowError) as error:
        print(f"error: {error}", file=sys.stderr)  # noqa: T201 -- the process's own error channel
        return EXIT_BAD_INPUT
    try:
        return run(common, node, life, ring, remote=True)
    finally:
        if isinstance(node, DeviceNode):
            node.close()


def _placed(common: Common, name: str, path: Path, endpoint: str, host: str | None) -> Common:
    """The bundle's common part with the addresses that only the guest knows: the supervisor's and its own."""
    if common.name != name:
        raise BundleError(f"{path}: found the bundle of {common.name}; expected that of {name}")
    scheme, _, place = endpoint.partition("://")
    if scheme not in SCHEMES or not place or (scheme == "tcp" and not is_address(place)):
        raise BundleError(f"--connect: found {endpoint!r:.300}; expected tcp://HOST:PORT, such as tcp://192.0.2.7:7400")
    if common.public and scheme != "tcp":
        raise BundleError(f"--connect: found {endpoint!r:.300}; expected tcp://HOST:PORT, for this bundle has keys")
    others = common.peers
    if host is not None:
        others = tuple(dataclasses.replace(p, address=f"{host}:*") if p.binds else p for p in others)
    # no directory, whatever the bundle says: its author must not choose where this machine writes files
    return dataclasses.replace(common, transport=scheme, control=endpoint, peers=others, directory="")
