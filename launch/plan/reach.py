"""How the processes of a run reach each other: by which transport, at which addresses, with which keys."""

from __future__ import annotations

import ipaddress
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from manyhands.launch.plan.keys import Keys, ephemeral
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.topology import Topology, roster
from manyhands.launch.session import SUPERVISOR
from manyhands.launch.session.errors import one_of
from manyhands.protocol.keys import KeyRing
from manyhands.protocol.transport.datagrams import shared_address
from manyhands.protocol.transport.zeromq import LOOPBACK, is_address

HUB_NAME = "control"
_MAX_PORT: Final = 65535


class ReachError(Exception):
    """The options about transport, addresses or remote nodes contradict each other or the session."""


@dataclass(frozen=True)
class Listen:
    """Where a session listens: an address of this machine, and the first of its TCP ports (0: any free ones)."""

    host: str = LOOPBACK
    port: int = 0

    @classmethod
    def parse(cls, text: str) -> Listen:
        """From ``HOST:PORT``.

        Raises:
            ReachError: the text has another form, or 0.0.0.0, to which other machines cannot connect.
        """
        if not is_address(text):
            raise ReachError(f"--listen: found {text!r:.100}; expected HOST:PORT, such as 192.0.2.7:7400")
        host, _, port = text.rpartition(":")
        try:
            address = ipaddress.IPv4Address(host)
        except ValueError as error:
            raise ReachError(f"--listen: found the host {host!r:.100}; expected an IPv4 address") from error
        if address.is_unspecified:
            raise ReachError(f"--listen: found {host}; expected the one address that others reach this machine at")
        return cls(host, int(port))

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


ANYWHERE: Final = Listen()
"""Any free ports of the loopback address."""


@dataclass(frozen=True)
class Reach:
    """How a run's processes reach each other.

    Attributes:
        transport: "ipc" or "tcp".
        keys: the session's keys; None for a session without encryption.
        listen: where the supervisor listens, and every process to which a remote node connects (tcp).
        remote: nodes that run on other machines: by invitation, or in ``hosts``.
        allowed: the processes with which each process shares a channel, supervisor and observers among them.
        hosts: the machines of those that this one starts there by ssh.
        program: what starts manyhands on these.
        seats: those of the remote nodes for which the session does not wait, for they come and go while it runs.
    """

    transport: str
    keys: Keys | None = None
    listen: Listen = ANYWHERE
    remote: frozenset[str] = frozenset()
    allowed: Mapping[str, frozenset[str]] = field(default_factory=dict)
    hosts: Mapping[str, str] = field(default_factory=dict)
    program: str = "manyhands"
    seats: frozenset[str] = frozenset()

    def address(self, graph: Topology, index: int) -> str:
        """The address at which the link of this index in ``graph`` is bound; empty for ipc.

        The TCP ports of the links follow the hub's, in the graph's order. Links between processes of another machine
        stay on its loopback address. Those between processes of this machine use ipc, for a tick over TCP takes longer,
        and its processes may not be raised. Only where no node is elsewhere they use what was asked for.
        """
        binder, connector = graph.links[index].binder, graph.links[index].connector
        if binder in self.remote:
            return f"{LOOPBACK}:*" if self.transport == "tcp" else ""
        if connector in self.remote:
            return self._at(1 + index, self.listen.host)
        return "" if self.remote else self._at(1 + index, LOOPBACK)

    def datagram_port(self, graph: Topology, linked: Collection[str]) -> int:
        """The UDP port of the world's end of all wave links (:func:`.shared_address`).

        Args:
            graph: the session's processes and links.
            linked: the couplings that have a wave link.

        Returns:
            0 where no wave goes to another machine, or where the ports are chosen when they are bound.
        """
        to = {i: link.connector for i, link in enumerate(graph.links) if link.connector in linked}
        port = shared_address([self.address(graph, i) for i in to]).rpartition(":")[2]
        return int(port) if self.remote.intersection(to.values()) and port.isdecimal() else 0

    def hub_address(self) -> str:
        """The address at which the supervisor's hub is bound; empty for ipc."""
        return self._at(0, self.listen.host)

    def observer_address(self, graph: Topology, index: int) -> str:
        """The address at which the observer of this index is served; empty for ipc."""
        return self._at(1 + len(graph.links) + index, self.listen.host)

    def _at(self, offset: int, host: str) -> str:
        if self.transport != "tcp":
            return ""
        return f"{host}:{self.listen.port + offset}" if self.listen.port else f"{host}:*"

    def public(self, name: str) -> Mapping[str, str]:
        """The public keys that a process receives: its own, and those of all with which it shares a channel."""
        if self.keys is None:
            return {}
        keys = self.keys.public.keys
        return {one: keys[one] for one in sorted({name, *self.allowed[name]})}

    def ring(self) -> KeyRing | None:
        """The supervisor's key ring; None without encryption."""
        return None if self.keys is None else self.keys.ring(SUPERVISOR, self.allowed[SUPERVISOR])


IPC: Final = Reach("ipc")
"""Unix-domain sockets: every process on one machine, and for one user."""


def reach(
    plan: Plan,
    transport: str,
    *,
    insecure: bool = False,
    keys: Keys | None = None,
    listen: Listen | None = None,
    remote: frozenset[str] = frozenset(),
    hosts: Mapping[str, str] = MappingProxyType({}),
    program: str = "manyhands",
) -> Reach:
    """How the processes of a run reach each other. TCP is encrypted; keys are made for this run if none are given.

    Args:
        plan: the planned session.
        transport: "ipc" or "tcp".
        insecure: TCP without encryption and keys.
        keys: the keys to use.
        listen: where to listen; by default on free ports of the loopback address.
        remote: nodes that join by invitation.
        hosts: the machine of each node that is started there by ssh (:func:`manyhands.launch.plan.hosts.hosts_of`).
        program: what starts manyhands there.

    Raises:
        ReachError: the options contradict each other or the session.
    """
    if transport != "tcp" and (insecure or keys or listen or remote):
        raise ReachError(
            f"--transport: found {transport}; expected tcp, which --insecure, --keys, --listen and --remote need"
        )
    if insecure and keys is not None:
        raise ReachError("give either --insecure or --keys: without encryption keys have no use")
    session = plan.session
    nodes = session.roles
    for name in remote:
        if name not in nodes:
            raise ReachError(f"--remote: found {name!r:.100}; expected {one_of(nodes, name)}")
    if listen is not None and listen.port:
        most = len(plan.graph.links) + len(session.observers)
        if listen.port + most > _MAX_PORT:
            raise ReachError(
                f"--listen: found the port {listen.port}, after which {most} more are used; expected at most "
                f"{_MAX_PORT - most}"
            )
    if remote and listen is None:
        raise ReachError("--remote needs --listen HOST:PORT, an address that the remote node can reach")
    if remote and not insecure and keys is None:
        raise ReachError(
            "--remote needs --keys DIR, the folder that the invitation was made with (manyhands invite): the remote "
            "node cannot know keys that are made for one run"
        )
    if transport == "tcp" and not insecure and keys is None:
        keys = ephemeral(roster(session), session.name)
    return Reach(transport, keys, listen or ANYWHERE, remote | hosts.keys(), plan.peers, hosts, program)
