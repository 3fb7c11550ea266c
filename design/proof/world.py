"""The claim of a world, and that certificates belong together: condition (A) by contracts, exactly.

A world is an environment with every port of a session, and what it owes the parties at these ports. It owes the users
in the tick a level Phi at their ports, and a wave link a passive port: at the world's face nothing pays for more. With
E_hat (-Phi_E)-ISP, both hold if

    blockdiag(Phi, 0) - Phi_E  >=  0.                                                                            (A)

**Why this is enough.** A user in the tick has proved (10) with Phi in the place of Phi_E, so that Phi is below the
parallel sum of its share Delta_D and Delta_V. So the condition of the theorem on the whole loop,

    blockdiag(share Delta_D : Delta_V of users in the tick, 0 of wave links) - Phi_E >= 0,

holds, with the strictness of (10) at the users in the tick, and of (A) at every port where (A) is strict.

**The loop is well posed.** At the world's face of a wave link D_V = T b^-1 > 0. Suppose (I + D_E D_V) x = 0 and
y = D_V x. At infinite frequency T y'D_E y >= -y'Phi_E y, so that T x'y <= y'Phi_E y <= y'blockdiag(Phi, 0) y. At the
users in the tick x'y T >= y'Phi y, and not equal unless their x = 0 (:mod:`manyhands.design.proof.contract`); at a wave
link x'y = T x'b^-1 x > 0 unless x = 0. So x = 0.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flint import fmpq

from manyhands.design.proof import contract, environment, exact, rational, wave_link, work
from manyhands.design.proof.claim import (
    DeclaredData,
    EnvironmentData,
    PortGroup,
    PromiseData,
    WaveLinkData,
    indices,
    input_level,
    read,
    read_environment,
    storage_matrix,
)
from manyhands.design.proof.exact import MAX_PORTS, Item, Number, Sparse, StatedMatrix, exact_decimal
from manyhands.design.proof.finding import Finding, ProofInputError

FORMAT = "manyhands-world"
VERSION = 1
_KEYS: tuple[str, ...] = ("id", "format", "version", "session", "period", "ports", "structure", "environment")
_KEYS += ("wave_links", "in_tick", "levels", "storage", "margins", "method")

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class StatedWaveLink:
    """What a world states of a wave link.

    Attributes:
        id: the stated SHA-256 of its terms.
        b: wave impedance, m_i x m_i, N*s/m.
        tank: E_0, J.
    """

    id: str
    b: StatedMatrix
    tank: Number


@dataclass(frozen=True, eq=False)
class InTick:
    """What a world owes the users in the tick.

    Attributes:
        id: the stated SHA-256 of the terms.
        ports: indices of their ports, in their own order.
        level: Phi, N*s/m, in that order.
    """

    id: str
    ports: tuple[int, ...]
    level: StatedMatrix


@dataclass(frozen=True, eq=False)
class WorldClaim:
    """The claim of a world.

    Attributes:
        data: the plain data, for the id.
        id: the stated SHA-256.
        session: its name.
        period: T, s.
        ports: names of the m ports.
        couplings: name and ports of each coupling.
        environment: the physical data of E, or its declared level.
        wave_links: by coupling.
        in_tick: of all other couplings; None if there are none.
        Phi_E: m x m, N*s/m.
        P_E: the storage matrix of Rest; None if the storage is the mechanical energy, or the level is declared.
        margins: by name.
    """

    data: Mapping[str, Any]
    id: str
    session: str
    period: Number
    ports: tuple[str, ...]
    couplings: tuple[PortGroup, ...]
    environment: EnvironmentData
    wave_links: Mapping[str, StatedWaveLink]
    in_tick: InTick | None
    Phi_E: Sparse
    P_E: StatedMatrix | None
    margins: Mapping[str, fmpq]


def read_world(data: Mapping[str, Any]) -> WorldClaim:
    """Read the claim of a world from its plain data.

    Raises:
        ProofInputError: a key is missing or unknown, or its value has the wrong type, shape or size.
    """
    fields = Item(data, "").fields(_KEYS)
    fields["format"].text(FORMAT)
    fields["version"].whole(VERSION, VERSION)
    for item in fields["method"].entries(100).values():
        if not isinstance(item.value, str):
            item.whole(-(2**63), 2**63)
    ports = tuple(item.text() for item in fields["ports"].items(MAX_PORTS))
    index = {name: i for i, name in enumerate(ports)}
    if len(index) != len(ports) or not ports:
        raise fields["ports"].refusal("one distinct name for each port, and at least one port")
    couplings = tuple(
        PortGroup(name, indices(item, index)) for name, item in fields["structure"].entries(MAX_PORTS).items()
    )
    sizes = {coupling.name: len(coupling.ports) for coupling in couplings}
    wave_links = {}
    for name, item in fields["wave_links"].entries(MAX_PORTS).items():
        if name not in sizes:
            raise ProofInputError(f"{item.path}: found the coupling {name[:60]!r}; expected one of structure")
        terms = item.fields(("id", "b", "tank"))
        wave_links[name] = StatedWaveLink(terms["id"].text(), terms["b"].symmetric(sizes[name]), terms["tank"].number())
    in_tick = None
    if fields["in_tick"].value is not None:
        terms = fields["in_tick"].fields(("id", "ports", "level"))
        own = indices(terms["ports"], index)
        in_tick = InTick(terms["id"].text(), own, terms["level"].symmetric(len(own)))
    world = read_environment(fields["environment"], ports)
    if isinstance(world, WaveLinkData | PromiseData):
        raise fields["environment"].refusal("an environment, or a declared level")
    levels, storage = fields["levels"].fields(("Phi_E",)), fields["storage"].fields(("E_hat",))
    return WorldClaim(
        data=data,
        id=fields["id"].text(),
        session=fields["session"].text(),
        period=fields["period"].number(),
        ports=ports,
        couplings=couplings,
        environment=world,
        wave_links=wave_links,
        in_tick=in_tick,
        Phi_E=input_level(levels["Phi_E"], couplings, len(ports)),
        P_E=storage_matrix(storage["E_hat"], "enforced" if isinstance(world, DeclaredData) else "energy"),
        margins={name: exact_decimal(item.number()) for name, item in fields["margins"].entries(100).items()},
    )


def condition_A(claim: WorldClaim) -> Sparse:
    """The left-hand side of (A), m x m, N*s/m."""
    promised: Sparse = {}
    if claim.in_tick is not None:
        exact.add(promised, claim.in_tick.ports, claim.in_tick.level)
    return exact.difference(promised, claim.Phi_E)


def prove_world(data: Mapping[str, Any], progress: Progress | None = None) -> tuple[Finding, ...]:
    """Prove everything that the certificate of a world claims.

    Args:
        data: its plain data, as json.load gives them.
        progress: called with the name of each part of the proof.

    Returns:
        Every finding; the world is proved if all of them hold. A finding marked ``enforced`` is kept at run time.

    Raises:
        ProofInputError: the data are no world of a known version, or their proof may take more work than is done for a
            file of their size; the message names the key.
    """
    if progress is not None:
        progress("reading the world")
    claim = read_world(data)
    work.require_bounded(data, lambda: work.parts_of_world(claim, condition_A(claim)))
    findings = [_identity(claim), _parties(claim), _period(claim)]
    if not all(finding.holds for finding in findings[1:]):
        return tuple(findings)
    for coupling in claim.couplings:
        if (link := claim.wave_links.get(coupling.name)) is not None:
            what = f"the wave link of {coupling.name}"
            names = [claim.ports[i] for i in coupling.ports]
            findings.append(
                wave_link.named(
                    what, link.id, wave_link.wave_link_id(claim.session, coupling.name, names, link.b, link.tank)
                )
            )
            findings += wave_link.link_findings(what, link.b, link.tank)
    if claim.in_tick is not None:
        names = [claim.ports[i] for i in claim.in_tick.ports]
        own = wave_link.in_tick_id(claim.session, claim.period, names, claim.in_tick.level.values)
        findings.append(wave_link.named("the promise to the users in the tick", claim.in_tick.id, own))
    if progress is not None:
        progress("the environment")
    m, T = len(claim.ports), exact_decimal(claim.period)
    findings += environment.findings(claim.environment, claim.P_E, claim.Phi_E, m, T)
    verdict = exact.definite_by_groups(condition_A(claim), m, strict=False)
    findings.append(verdict.finding("condition (A): the world keeps what it promises at every port"))
    for name, stated in claim.margins.items():
        findings.append(contract.margin_finding(name, stated, condition_A(claim) if name == "(A)" else None, m))
    return tuple(findings)


def prove_together(world: Mapping[str, Any], parts: Sequence[Mapping[str, Any]]) -> tuple[Finding, ...]:
    """Prove that certificates meet this world by the contracts that it states.

    The world and each part are proved by themselves (:func:`prove_world`, :func:`manyhands.design.proof.prove`).

    Args:
        world: the plain data of the world.
        parts: the plain data of certificates of sites, and of the users in the tick.

    Raises:
        ProofInputError: data are not of the format; the message names the key.
    """
    claim = read_world(world)
    found = []
    for data in parts:
        part = read(data)
        names = ", ".join(block.name for block in part.blocks[:4])
        match part.environment:
            case WaveLinkData(id=stated):
                condition = f"the site of {names} meets the world by the wave link that both name"
                holds = len(part.blocks) == 1 and part.blocks[0].name in claim.wave_links
                holds = holds and claim.wave_links[part.blocks[0].name].id == stated
            case PromiseData(id=stated):
                condition = "the users in the tick meet the world by the promise that both name"
                holds = claim.in_tick is not None and claim.in_tick.id == stated
            case _:
                condition, holds = f"the certificate of {names} states a contract with a world", False
        argument = "compared" if holds else "the world states a different contract, or none"
        found.append(Finding(condition, holds, float(holds) - 1.0, 0.0, argument=argument))
    return tuple(found)


def _identity(claim: WorldClaim) -> Finding:
    """The id is the SHA-256 over the content's canonical JSON: keys in order, no spaces, shortest exact floats."""
    content = {key: value for key, value in claim.data.items() if key != "id"}
    canonical = json.dumps(content, separators=(",", ":"), allow_nan=False)
    holds = hashlib.sha256(canonical.encode()).hexdigest() == claim.id
    return Finding("the id is the SHA-256 of the content", holds, float(holds) - 1.0, 0.0, argument="computed again")


def _parties(claim: WorldClaim) -> Finding:
    """Every port belongs to one coupling, which is either in the tick or has a wave link."""
    owners = [port for coupling in claim.couplings for port in coupling.ports]
    left = sorted(p for coupling in claim.couplings if coupling.name not in claim.wave_links for p in coupling.ports)
    own = [] if claim.in_tick is None else sorted(claim.in_tick.ports)
    holds = sorted(owners) == list(range(len(claim.ports))) and left == own
    condition = "every port has one coupling, in the tick or with a wave link"
    return Finding(condition, holds, float(holds) - 1.0, 0.0, argument="counted")


def _period(claim: WorldClaim) -> Finding:
    T = exact_decimal(claim.period)
    return Finding("0 < T", T > 0, rational.rounded(T), 0.0, argument="exactly")
