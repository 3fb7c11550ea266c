"""Whether a certificate is about a given loop and wish, or about another: what a proof alone does not say."""

from __future__ import annotations

import numpy as np

from manyhands.design.certificate import Certificate
from manyhands.design.coupling import SpringDamper
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    LinearWanted,
    NoCoupling,
    SpringDamperGiven,
    SpringDamperWanted,
)
from manyhands.design.statespace import StateSpace
from manyhands.design.weighted_loop import Transparency


def differences(certificate: Certificate, loop: HapticLoop, wanted: CouplingRequest) -> list[str]:
    """Where the certificate is about another loop, or another coupling, than these; empty when it fits."""
    own = certificate.loop
    out = [
        f"the {what} differs: the certificate has {mine}, the session {theirs}"
        for what, mine, theirs in (
            ("session's name", own.session, loop.session),
            ("period", own.period, loop.period),
            ("delay inside the tick", own.tau, loop.tau),
            ("list of ports", ", ".join(own.ports), ", ".join(loop.ports)),
        )
        if mine != theirs
    ]
    out += [
        f"the {what} differs"
        for what, mine, theirs in (
            ("block structure", own.partition, loop.partition),
            ("environment", own.environment, loop.environment),
            ("level or order of devices", [_level(d) for d in own.devices], [_level(d) for d in loop.devices]),
        )
        if mine != theirs
    ]
    springs = all(isinstance(part, SpringDamper) for part in certificate.coupling)
    match wanted:
        case SpringDamperGiven(given, aim):
            held = certificate.spring_damper
            if held is None or np.any(held.stiffness != given.stiffness) or np.any(held.damping != given.damping):
                out.append("the coupling is not the one that the session gives")
        case LinearGiven(blocks, aim):
            if [_system(b) for b in certificate.coupling if isinstance(b, StateSpace)] != [_system(b) for b in blocks]:
                out.append("the coupling is not the one that the session gives")
        case SpringDamperWanted(wish):
            aim = wish.aim
            if not springs:
                out.append("the coupling is not of the spring-damper class that the session wants")
        case LinearWanted(_, wish):
            aim = wish.aim
            if springs:
                out.append("the coupling is of the spring-damper class, and the session wants a linear one")
        case NoCoupling():
            aim = None
            out.append("the session wants no coupling")
    claimed: Transparency | None = None if certificate.transparency is None else certificate.transparency.aim
    if claimed != aim:
        out.append("the transparency problem differs, in its objective or its weights")
    return out


def _level(device: DeviceLevel) -> tuple[str, tuple[int, ...], list[list[float]]]:
    return device.name, device.ports, device.level.tolist()


def _system(system: StateSpace) -> list[list[list[float]]]:
    return [M.tolist() for M in (system.A, system.B, system.C, system.D)]
