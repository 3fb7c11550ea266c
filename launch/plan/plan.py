"""A session and what follows from its structure alone: each part is derived once, at its first use, and kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from manyhands.launch.plan.access import Capability, access, peers
from manyhands.launch.plan.topology import Topology, topology
from manyhands.launch.session import Session


@dataclass(frozen=True, eq=False)
class Plan:
    """A planned session; :class:`manyhands.launch.plan.prepare.Prepared` is one whose coupling is settled.

    Attributes:
        session: the session.
    """

    session: Session

    @cached_property
    def graph(self) -> Topology:
        """The processes, and the links between them."""
        return topology(self.session)

    @cached_property
    def access(self) -> tuple[Capability, ...]:
        """The capability table: which process may read and write what."""
        return access(self.session, self.graph)

    @cached_property
    def peers(self) -> Mapping[str, frozenset[str]]:
        """The processes with which each node, the supervisor and each observer share a channel, and so public keys."""
        return peers(self.access)
