"""A planned session: everything that follows from the structure is derived once and is equal for all users."""

from __future__ import annotations

from manyhands.launch.plan.access import access, peers
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import unproved
from manyhands.launch.plan.topology import topology
from manyhands.launch.session.shipped import load_named


def test_a_plan_derives_graph_rights_and_peers_once() -> None:
    session = load_named("example1-uncoupled")
    for plan in (Plan(session), unproved(session)):
        assert plan.graph == topology(session)
        assert plan.access == access(session, topology(session))
        assert plan.peers == peers(plan.access)
        assert plan.graph is plan.graph
        assert plan.access is plan.access
        assert plan.peers is plan.peers
