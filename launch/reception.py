"""Who may join a session, and what is said at the door: hellos go in, answers come out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from manyhands.launch.instructions import Instruction, Release, Send
from manyhands.launch.topology import Topology
from manyhands.protocol.codec import ForeignHello
from manyhands.protocol.handshake import check_node_hello
from manyhands.protocol.messages import Connect, NodeHello, Refusal, Role, Welcome


@dataclass(frozen=True)
class Reception:
    """What a hello is held against.

    Attributes:
        graph: the session's nodes and links.
        certificate: the id that all nodes must share.
        session: the session's name.
    """

    graph: Topology
    certificate: str
    session: str

    def refusal(self, sender: str, hello: NodeHello | ForeignHello) -> Refusal | None:
        """Why ``sender`` is no node of this session; None if it is one."""
        binds = [link.connector for link in self.graph.links_of(sender) if link.binder == sender]
        return check_node_hello(hello, self.certificate, self.session, self.graph.nodes, sender, binds)

    def connects(self, endpoints: Mapping[tuple[str, str], str]) -> list[Instruction]:
        """All nodes are here: where each finds its peers, from the ``endpoints`` by binder and connector."""
        out: list[Instruction] = []
        for node in self.graph.nodes:
            binders = [link.binder for link in self.graph.links_of(node) if link.connector == node]
            out.append(Send(node, Connect({binder: endpoints.get((binder, node), "") for binder in binders})))
        return out

    def greet_observer(
        self, name: str, hello: NodeHello | ForeignHello, places: Mapping[str, str]
    ) -> list[Instruction]:
        """Tell an observer where it is served, or refuse it; either way the next one of its name may come.

        Args:
            name: the observer.
            hello: what it said.
            places: where each observer is served.
        """
        roles = {**self.graph.nodes, **dict.fromkeys(places, Role.OBSERVER)}
        refusal = check_node_hello(hello, self.certificate, self.session, roles, name)
        if refusal is not None:
            return [Send(name, refusal), Release(name)]
        endpoints = {Role.SUPERVISOR.value: places[name]}
        return [Send(name, Welcome()), Send(name, Connect(endpoints)), Release(name)]
