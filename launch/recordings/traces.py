"""What every node of a session would tell of its ticks, kept by a simulation of it.

A node's telemetry holds one row a tick of each of its topics (:mod:`manyhands.protocol.channels`). Here are the same
rows by the same names, but for tau, which is the machine's and not the session's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.plan.bundles import mass_names
from manyhands.launch.plan.plan import Plan
from manyhands.nodes.passivity import Ledger
from manyhands.protocol.channels import LEDGER, TAU, Topic, topics_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Kept:
    """One topic of one node.

    Attributes:
        topic: which.
        columns: names of its columns.
        values: ticks x columns; NaN in ticks that the node did not do.
    """

    topic: Topic
    columns: tuple[str, ...]
    values: Array


class Traces:
    """The traces of a run of ``ticks`` ticks.

    Attributes:
        by_node: by node, the topics that it tells of, in the table's order.
    """

    def __init__(self, plan: Plan, ledgers: Mapping[str, Ledger], ticks: int) -> None:
        """Everything NaN.

        Args:
            plan: whose nodes.
            ledgers: by node, of those that keep one.
            ticks: how many.
        """
        graph, masses = plan.graph, mass_names(plan.session)
        self.by_node: dict[str, tuple[Kept, ...]] = {}
        for name, role in graph.nodes.items():
            told = [
                topic
                for topic in topics_of(role, masses)
                if topic.trace != TAU and (topic.trace != LEDGER or name in ledgers)
            ]
            columns = [topic.columns_of(graph.ports[name], masses) for topic in told]
            self.by_node[name] = tuple(
                Kept(topic, own, np.full((ticks, len(own)), np.nan)) for topic, own in zip(told, columns, strict=True)
            )
        self._signals = {
            name: [kept for kept in own if kept.topic.trace != LEDGER] for name, own in self.by_node.items()
        }
        self._ledgers = ledgers

    def keep(self, node: str, tick: int, *signals: Sequence[float]) -> None:
        """A tick that ``node`` has done: ``signals`` in the order of its topics; its ledger is looked up."""
        for one, row in zip(self._signals[node], signals, strict=False):  # where there are no masses, q has no topic
            one.values[tick] = row
        if node in self._ledgers:
            self.by_node[node][-1].values[tick] = self._ledgers[node].total
