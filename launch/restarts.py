"""How often a node may come back: a budget with a stable-start window.

A node that ran for the whole window has a clean slate, so that a session of hours does not lose it by its fourth
mishap; one that dies again and again soon after its start is given up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from manyhands.protocol.clock import Duration, from_seconds

WINDOW: Final = from_seconds(60.0)


@dataclass
class RestartBudget:
    """Counts the deaths of each node against what is allowed.

    Attributes:
        restarts: how many deaths in a row a node may come back from; with 0 none does.
        window: after a run of this length (ns) all earlier deaths are forgotten.
    """

    restarts: int = 0
    window: Duration = WINDOW
    _deaths: dict[str, int] = field(default_factory=dict)
    _ran_since: dict[str, int] = field(default_factory=dict)

    def ran(self, node: str, now: int) -> None:
        """``node`` runs from ``now`` on (monotonic ns)."""
        self._ran_since[node] = now

    def died(self, node: str, now: int) -> bool:
        """Count a death at ``now``; whether the node may come back from it."""
        since = self._ran_since.pop(node, None)  # a death before the next run is none after a long one
        stable = since is not None and now - since >= self.window
        deaths = self._deaths[node] = 1 if stable else self._deaths.get(node, 0) + 1
        return deaths <= self.restarts
