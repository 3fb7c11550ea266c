"""Nodes of a session that the launching machine starts on other machines, by ssh: ``--on NODE=HOST``."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Final

from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.reach import ReachError
from manyhands.launch.session.errors import one_of
from manyhands.protocol.messages import Role

_HOST: Final = re.compile(r"[A-Za-z0-9_.:%@\[\]][A-Za-z0-9_.:%@\[\]-]*")
"""A name as ssh takes it: of a machine, with a user before it or not, or of an entry of its configuration."""


def hosts_of(words: Sequence[str], plan: Plan, remote: Collection[str] = ()) -> dict[str, str]:
    """The machine of each node that is to be started by ssh, in the session's order.

    Args:
        words: ``NODE=HOST`` for each.
        plan: the planned session.
        remote: nodes that join by invitation.

    Raises:
        ReachError: a word has another form, names no node, or one that cannot run there.
    """
    nodes, found = plan.session.roles, dict[str, str]()
    for word in words:
        name, equals, host = word.partition("=")
        if not equals or _HOST.fullmatch(host) is None:
            raise ReachError(f"--on: found {word!r:.100}; expected NODE=HOST, such as dx=user@192.0.2.9")
        if name in plan.session.observers:
            raise ReachError(
                f"--on: found the observer {name}; expected a device or a coupling; observers join by invite"
            )
        if name not in nodes:
            raise ReachError(f"--on: found {name!r:.100}; expected {one_of(nodes, name)}")
        if nodes[name] is Role.ENVIRONMENT:
            raise ReachError(f"--on: found {name}; expected a device or a coupling: launch on that machine instead")
        if name in found:
            raise ReachError(f"--on: found {name} twice; expected one host for each node")
        if name in remote:
            raise ReachError(f"give either --on or --remote for {name}")
        found[name] = host
    if found and plan.graph.carriers:
        raise ReachError("--on: found colocate: true; expected false, for a node on another machine is one process")
    for link in plan.graph.links:
        binder, connector = found.get(link.binder), found.get(link.connector)
        if binder is not None and binder != connector:
            raise ReachError(
                f"--on: found {link.binder} on {binder} without {link.connector}; expected --on "
                f"{link.connector}={binder} as well, for a coupling runs here or beside its devices"
            )
    return {name: found[name] for name in nodes if name in found}


def ssh_command(node: str, host: str, endpoint: str, program: str) -> list[str]:
    """What starts a node on another machine; its bundle and its key go to the standard input.

    Args:
        node: its name.
        host: the machine, as :func:`hosts_of` admits it.
        endpoint: of the supervisor's hub.
        program: what starts manyhands there.
    """
    there = f"{program} node {node} --bundle - --connect {endpoint}"
    return ["ssh", "-T", *(word for option in _OPTIONS for word in ("-o", option)), "--", host, there]


_OPTIONS: Final = ("BatchMode=yes", "ConnectTimeout=20", "ServerAliveInterval=5", "ServerAliveCountMax=3")
"""ssh asks nobody for a password, since nobody may be there, and gives up rather than wait for ever."""


def by_hand(node: str, endpoint: str) -> str:
    """The command with which somebody on another machine starts a node there, with what ``invite`` has written."""
    return f"manyhands node {node} --bundle {node}.bundle --key {node}.key --connect {endpoint}"


def ended_there(host: str, code: int, log: str) -> str:
    """How a node on another machine has ended, for "NODE …", from the exit code and the error output of its ssh."""
    lines = log.splitlines()
    return f"ended on {host} (ssh: exit code {code}{f': {lines[-1]}' if lines else ''})"


def require_hosts_alone(hosts: Mapping[str, str], transport: str | None, insecure: bool, listens: bool) -> None:
    """Refuse options that do not go with ``--on``.

    Args:
        hosts: as of :func:`hosts_of`.
        transport: as given; None for none.
        insecure: whether encryption is to be left out.
        listens: whether an address is given.

    Raises:
        ReachError: they contradict each other.
    """
    if not hosts:
        return
    if transport not in (None, "tcp"):
        raise ReachError(f"--on: found --transport {transport}; expected tcp")
    if insecure:
        raise ReachError("--on needs keys, which are made for the run without --keys: leave out --insecure")
    if not listens:
        raise ReachError("--on needs --listen HOST:PORT, the address at which those machines reach this one")
