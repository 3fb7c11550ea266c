"""From a session to the haptic loop that design knows, and to what is asked of its coupling."""

from __future__ import annotations

from manyhands.design.coupling import SpringDamper
from manyhands.design.network import Link, Network
from manyhands.design.partition import Partition
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    NoCoupling,
    SpringDamperGiven,
    SpringDamperWanted,
)
from manyhands.design.statespace import StateSpace
from manyhands.launch.session import Session


def haptic_loop(session: Session) -> HapticLoop:
    """The loop: ports, levels, block structure and network, all in the session's order."""
    index = {port: i for i, port in enumerate(session.ports)}
    environment = session.environment
    return HapticLoop(
        session=session.name,
        period=session.period,
        ports=session.ports,
        devices=tuple(
            DeviceLevel(name, tuple(index[p] for p in session.ports_of(name)), session.osp_level(name))
            for name in session.devices
        ),
        partition=Partition(
            tuple(session.couplings), tuple(tuple(index[p] for p in block) for block in session.blocks)
        ),
        network=Network(
            session.ports,
            tuple(environment.masses.items()),
            tuple(Link((a, b), link.stiffness, link.damping) for link in environment.links for a, b in [link.between]),
        ),
    )


def coupling_request(session: Session) -> CouplingRequest:
    """What the session's ``design:`` asks for."""
    design = session.design
    if design.coupling == "none":
        return NoCoupling()
    if design.coupling == "spring-damper":
        return SpringDamperWanted()
    if design.matrices is not None:
        return LinearGiven(tuple(StateSpace(*design.matrices[name].arrays()) for name in session.couplings))
    stiffness, damping = session.given_stiffness, session.given_damping
    if stiffness is None or damping is None:
        raise AssertionError("a validated session gives stiffness and damping, or matrices")
    return SpringDamperGiven(SpringDamper(stiffness, damping))
