"""From the limits that a session states for its devices to what each process holds its peers to.

A device keeps to its own limits, and a coupling clips every force to those of its devices. What an honest coupling can
then say to the environment follows; the environment is given these bounds, and never the limits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from manyhands.design.peak_gain import output_bounds
from manyhands.design.statespace import StateSpace
from manyhands.launch.session import Session
from manyhands.launch.session.limits import HAND_STORE
from manyhands.nodes.bundle import Limits
from manyhands.nodes.environment.energy import Budget

PortBounds = tuple[float | None, ...]
"""By port of the session; None for no bound."""


def limits_at(session: Session, ports: Sequence[str]) -> Limits:
    """What the devices at ``ports`` may exert and reach."""
    by_port = {
        port: limits
        for name, device in session.devices.items()
        for port, *limits in zip(
            session.ports_of(name),
            device.limits.force,
            device.limits.displacement,
            device.limits.speed,
            strict=True,
        )
    }
    force, displacement, speed = zip(*(by_port[port] for port in ports), strict=True)
    return Limits(force, displacement, speed)


def budgets(session: Session) -> tuple[Budget, ...]:
    """What each coupling may put into the others: what its devices may, of each the part of its axes that it holds."""
    of_port: dict[str, tuple[float, float, float]] = {}
    for name, device in session.devices.items():
        limits, ports = device.limits, session.ports_of(name)
        stroke = 2.0 * sum(force * reach for force, reach in zip(limits.force, limits.displacement, strict=True))
        whole = (limits.power, limits.energy, min(HAND_STORE, stroke))
        of_port |= {port: (whole[0] / len(ports), whole[1] / len(ports), whole[2] / len(ports)) for port in ports}
    return tuple(Budget(*map(sum, zip(*(of_port[port] for port in ports), strict=True))) for ports in session.blocks)


def tool_bounds(session: Session, blocks: Sequence[StateSpace]) -> tuple[PortBounds, PortBounds]:
    """The greatest |p| and |p(k) - p(k-1)|, m, that honest devices and couplings can send.

    p = x + C_V xi, and xi follows forces that were clipped, so that

        |p_i| <= X_i + sum_j ||h_ij||_1 F_j,     |p_i(k) - p_i(k-1)| <= T S_i + sum_j ||h_ij(k) - h_ij(k-1)||_1 F_j

    with h the impulse response of (A_V, B_V, C_V, 0) and X, S, F the limits of displacement, speed and force. A block
    that is not found to be stable leaves its ports without bounds.

    Args:
        session: the session.
        blocks: those of V, in the order of its couplings.
    """
    magnitude: dict[str, float] = {}
    step: dict[str, float] = {}
    for ports, block in zip(session.blocks, blocks, strict=True):
        limits = limits_at(session, ports)
        dynamic = StateSpace(block.A, block.B, block.C, np.zeros_like(block.D))
        offset, change = output_bounds(dynamic, np.array(limits.force))
        magnitude |= zip(ports, (limits.displacement + offset).tolist(), strict=True)
        step |= zip(ports, (session.period * np.array(limits.speed) + change).tolist(), strict=True)
    return _in_order(session, magnitude), _in_order(session, step)


def _in_order(session: Session, bounds: Mapping[str, float]) -> PortBounds:
    return tuple(bounds[port] if math.isfinite(bounds[port]) else None for port in session.ports)
