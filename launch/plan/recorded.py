"""The traces that every node would report, kept by a simulation of the session.

A node's telemetry holds one row a tick of each of its topics (:mod:`manyhands.protocol.channels`). The same rows are
kept here under the same names, except for tau, which depends on the machine and not on the session.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from manyhands.launch.plan.engine import drawing_of
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings.run import RecordedTrace
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.rows.two_port import Row
from manyhands.protocol.channels import LEDGER, TAU, hands_at, links_at, topics_of


def recorded_of(prepared: Prepared, clock: str) -> Recorded:
    """The session as its recording describes it.

    Args:
        prepared: the session with its coupling and certificate.
        clock: "realtime" or "simulated".
    """
    session, graph = prepared.session, prepared.graph
    return Recorded(
        session.name,
        prepared.id,
        session.period,
        clock,
        graph.nodes,
        graph.ports,
        session.environment.reported(session.ports),
        periods=session.own_periods,
        linked=tuple(session.wave_links),
        scene=session.environment.geometry(session.ports),
        turning=session.turning,
        oriented=session.environment.oriented,
        hands=session.hands,
        sensed=session.sensed_hands,
        drawing=drawing_of(session),
    )


class Traces:
    """The traces of a run of ``ticks`` ticks.

    Attributes:
        by_node: the topics of each node, in the table's order.
    """

    def __init__(self, plan: Plan, ledgers: Collection[str], ticks: int) -> None:
        """All values begin as NaN.

        Args:
            plan: of the session.
            ledgers: the nodes that keep one.
            ticks: number of ticks.
        """
        graph, masses = plan.graph, plan.session.environment.reported(plan.session.ports)
        oriented = plan.session.environment.oriented
        self.by_node: dict[str, tuple[RecordedTrace, ...]] = {}
        for name, role in graph.nodes.items():
            links = links_at(name, role, graph.ports, plan.session.wave_links)
            hands = hands_at(name, role, plan.session.hands)
            topics = [
                topic
                for topic in topics_of(
                    role, masses, linked=bool(links), oriented=oriented, hands=hands, sensed=plan.session.sensed_hands
                )
                if topic.trace != TAU and (topic.trace != LEDGER or name in ledgers)
            ]
            columns = [topic.columns_of(graph.ports[name], masses, links, oriented, hands) for topic in topics]
            self.by_node[name] = tuple(
                RecordedTrace(topic, own, np.full((ticks, len(own)), np.nan))
                for topic, own in zip(topics, columns, strict=True)
            )

    def keep(self, node: str, tick: int, row: Row) -> None:
        """Keep the row of a tick that ``node`` has done."""
        for one, part in zip(self.by_node[node], filter(len, row), strict=True):
            one.values[tick] = part
