"""A session whose world is an engine's, simulated: what every such run has, and what it must keep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import Session
from manyhands.nodes.environment.enforced import EnforcedCore

Traces = dict[str, np.ndarray]
"""By ``NODE/TOPIC``, a row a tick."""


def simulated(data: Mapping[str, Any], ticks: int) -> tuple[Simulation, Traces]:
    """So many ticks of a session, with the traces of its devices and its environment."""
    simulation = Simulation(prepare(Session.from_dict(data)))
    traces = simulation.traces(ticks)
    simulation.run(ticks, traces=traces)
    return simulation, {
        f"{node}/{kept.topic.name}": kept.values
        for node in (*data["devices"], "environment")
        for kept in traces.by_node[node]
    }


def world_kept(simulation: Simulation) -> EnforcedCore:
    """See that the controller had nothing to do, forces turned seldom, and no ledger fell; returns the environment."""
    core = simulation.environment
    assert isinstance(core, EnforcedCore)
    assert core.controller is not None
    assert core.controller.ticks == 0
    assert max(core.chatter.most) < 20
    assert all(ledger.minimum >= -1e-12 for ledger in simulation.ledgers.values())
    return core


def account_kept(traces: Traces, hand: str) -> np.ndarray:
    """See that the account of an orientation kept its bound; returns account, deposits and grants, ticks x 3, J."""
    found: np.ndarray = traces[f"{hand}/account"][:, :3]
    account, deposited, granted = found.T
    assert (account >= deposited - granted - 1e-15).all()
    return found
