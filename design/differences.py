"""Whether a certificate is about a given loop and wish, or about another: what a proof alone does not say."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from manyhands.design.certificate import Certificate
from manyhands.design.certificate_parts import describe_request
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

_MOST_SHOWN = 200  # characters of a value, which somebody else may have written


def unrecorded(certificate: Certificate) -> str:
    """What a certificate's file does not record, as a sentence; empty where it records everything."""
    if certificate.asked is not None:
        return ""
    return (
        f"format version {certificate.version} does not record what was asked of the coupling (design.objective and "
        "the other keys of design), and its id does not cover the order of devices and couplings"
    )


def asked_text(asked: Mapping[str, Any]) -> str:
    """What was asked, on one line."""
    return ", ".join(f"{key} {_shown(value)}" for key, value in asked.items())[: 2 * _MOST_SHOWN]


def differences(certificate: Certificate, loop: HapticLoop, wanted: CouplingRequest) -> list[str]:
    """Where the certificate is about another loop, or another coupling, than these; empty when it fits.

    What was asked is compared where it is recorded: see :func:`unrecorded`.
    """
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
    if certificate.asked is not None:
        out += _other_wishes(certificate.asked, describe_request(wanted, loop.partition.names))
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


def _other_wishes(asked: Mapping[str, Any], wish: Mapping[str, Any]) -> list[str]:
    """A sentence for each key of ``design:`` that was asked otherwise than the session asks.

    Where the class of coupling differs, the keys that only one of the classes has differ with it, and are left out.
    """
    one_class = asked.get("coupling") == wish["coupling"]
    return [
        f"design.{key} differs: the certificate has {_shown(asked.get(key, 'none'))}, "
        f"the session asks for {_shown(wish.get(key, 'none'))}"
        for key in dict.fromkeys((*wish, *asked))
        if asked.get(key) != wish.get(key) and (one_class or (key in asked and key in wish))
    ]


def _shown(value: object) -> str:
    """A value as a message shows it, without anything that a terminal would take for a command."""
    text = json.dumps(value)
    text = text[1:-1] if isinstance(value, str) else text
    return text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 3]}..."


def _level(device: DeviceLevel) -> tuple[str, tuple[int, ...], list[list[float]]]:
    return device.name, device.ports, device.level.tolist()


def _system(system: StateSpace) -> list[list[list[float]]]:
    return [M.tolist() for M in (system.A, system.B, system.C, system.D)]
