"""What a certificate states of a contract: the name of its terms, and the figures of a wave link.

A wave link of impedance b and round trip R is felt as the mass b R/2, and in series with the coupling as the stiffness
(V(1) + (R/2) b^-1)^-1. Its user's face is (-theta)-ISP, up to the energy in tanks and in transit, by the rules that
the face itself keeps, whatever arrives (docs/remote/proof.md). This needs b > 0, E_0 >= 0 and theta >= 0:
with theta < 0 a tank would have to pay after the tick for a motion that nobody bounds.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping

from flint import fmpq_mat

from manyhands.design.proof import exact, rational, statics
from manyhands.design.proof.claim import Claim, PromiseData, StatedSpringDamper, WaveLinkData
from manyhands.design.proof.exact import Number, StatedMatrix, exact_decimal
from manyhands.design.proof.finding import Finding

FELT_STIFFNESS = "felt stiffness"


def wave_link_id(session: str, coupling: str, ports: list[str], b: StatedMatrix, tank: Number) -> str:
    """SHA-256 (hex) of the terms of a wave link."""
    terms = {"session": session, "coupling": coupling, "ports": ports, "b": b.values, "tank": tank}
    return _name({"contract": "wave-link", **terms})


def in_tick_id(session: str, period: Number, ports: list[str], level: list[list[Number]]) -> str:
    """SHA-256 (hex) of the terms between a world and the users in the tick."""
    return _name({"contract": "in-tick", "session": session, "period": period, "ports": ports, "level": level})


def _name(terms: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(terms, separators=(",", ":"), allow_nan=False).encode()).hexdigest()


def named(what: str, stated: str, computed: str) -> Finding:
    """The finding that the stated name of a contract is that of its terms."""
    holds = stated == computed
    return Finding(f"the id of {what} is the SHA-256 of its terms", holds, float(holds) - 1.0, 0.0, argument="computed")


def link_findings(what: str, b: StatedMatrix, tank: Number) -> list[Finding]:
    """The wave impedance is positive definite, b > 0, and the tank begins with E_0 >= 0."""
    positive = exact.definite(b.rational()).finding(f"the wave impedance of {what} is positive: b > 0")
    return [positive, Finding(f"the tank of {what}: E_0 >= 0", tank >= 0, float(tank), 0.0, argument="exactly")]


def contract_findings(claim: Claim) -> list[Finding]:
    """The findings on the contract that stands in the environment's place; none for an environment of its own."""
    data, session = claim.environment, claim.data["session"]
    if isinstance(data, PromiseData):
        level = data.level.values
        return [named("the promise", data.id, in_tick_id(session, claim.data["period"], list(claim.ports), level))]
    if not isinstance(data, WaveLinkData):
        return []
    names = [block.name for block in claim.blocks]
    condition = "the site has one coupling, on all ports in their order"
    one = len(names) == 1 and claim.blocks[0].ports == tuple(range(len(claim.ports)))
    out = [Finding(condition, one, float(one) - 1.0, 0.0, argument="compared")]
    if not one:
        return out
    what = f"the wave link of {names[0]}"
    out.append(named(what, data.id, wave_link_id(session, names[0], list(claim.ports), data.b, data.tank)))
    out += link_findings(what, data.b, data.tank)
    least = min(data.harvest)
    out.append(Finding("the harvest: theta >= 0", least >= 0, float(least), 0.0, argument="exactly"))
    if data.round_trip is None:
        return out
    R = exact_decimal(data.round_trip)
    out.append(Finding("the round trip: R > 0", R > 0, rational.rounded(R), 0.0, argument="exactly"))
    if data.mass is not None:
        room = data.mass.rational() - data.b.rational() * (R / 2)
        out.append(exact.definite(room, strict=False).finding("the felt mass b R/2 is at most the mass allowed"))
    return out


def felt_stiffness(claim: Claim) -> fmpq_mat | None:
    """(V(1) + (R/2) b^-1)^-1, m x m, N/m; None if the certificate is of no wave link whose round trip is stated.

    Raises:
        ZeroDivisionError: a matrix is singular.
        Undecided: V(1) is not decided.
    """
    data = claim.environment
    if not isinstance(data, WaveLinkData) or data.round_trip is None or len(claim.coupling) != 1:
        return None
    V = claim.coupling[0]
    if isinstance(V, StatedSpringDamper):
        compliance = V.stiffness.rational().inv()
    else:
        compliance = statics.of_system(V.A, V.B, V.C, V.D, V.static, discrete=True)
    series: fmpq_mat = (compliance + data.b.rational().inv() * (exact_decimal(data.round_trip) / 2)).inv()
    return series
