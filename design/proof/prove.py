"""The proof of a certificate: every condition of Theorem 3 [Bianchini2010]_, from its plain data."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from typing import Any

from manyhands.design.proof import contract, environment, quantisation, series, transparency, wave_link, work
from manyhands.design.proof.claim import Claim, ProxyData, StatedSpringDamper, read
from manyhands.design.proof.coupling import linear, spring_damper
from manyhands.design.proof.device import device_form
from manyhands.design.proof.finding import Finding

Progress = Callable[[str], None]


def prove(data: Mapping[str, Any], progress: Progress | None = None) -> tuple[Finding, ...]:
    """Prove everything that a certificate claims.

    Args:
        data: the certificate's plain data, as json.load gives them.
        progress: called with the name of each part of the proof.

    Returns:
        Every finding. The certificate is proved if all of them hold; a finding marked ``enforced`` is kept at run time
        instead. Consequences of a failed condition are left out, so that the first finding that fails is the reason.
        The key ``asked`` claims nothing and has no finding.

    Raises:
        ProofInputError: the data are no certificate of a known version, or their proof may take more work than is done
            for a file of their size; the message names the key.
    """
    report = progress if progress is not None else _silent
    report("reading the certificate")
    claim = read(data)
    work.require_bounded(data, lambda: work.parts_of(claim))
    findings = [_identity(claim), contract.one_party_each(claim), contract.times(claim)]
    if not all(finding.holds for finding in findings[1:]):
        return tuple(findings)
    report("the devices' levels")
    promises = [*contract.device_findings(claim), contract.gains(claim)]
    if not all(finding.holds for finding in promises):
        return (*findings, *promises)
    tau_hat = claim.tau / claim.period
    promises.append(device_form(claim.kappa, claim.share, claim.c, tau_hat, 1 + claim.period_tolerance))
    promises.append(contract.level_of_coupling(claim))
    report("the coupling's blocks")
    promises += [_block(claim, i) for i in range(len(claim.blocks))] if promises[-1].holds else []
    report("the environment")
    if claim.series:
        promises.append(series.finding(claim))
        if not promises[-1].holds:
            return (*findings, *promises)
    inner = series.cut(claim).environment
    promises += environment.findings(inner, claim.P_E, claim.Phi_E, len(claim.ports), claim.period)
    promises += wave_link.contract_findings(claim)
    report("condition (10)")
    promises.append(contract.loop_condition(claim))
    # springs to proxies are solved with D_E = K
    enforced = any(finding.enforced for finding in promises) and not isinstance(claim.environment, ProxyData)
    findings += [*promises, contract.well_posed(promises, enforced)]
    if any(claim.step) or claim.encoder is not None:
        report("the encoders' steps")
        findings += quantisation.findings(claim)
    if claim.transparency is not None:
        report("transparency")
        findings.append(transparency.finding(claim, claim.transparency))
    report("the margins")
    return (*findings, *contract.margin_findings(claim))


def _silent(text: str) -> None:
    """Show no progress."""


def _identity(claim: Claim) -> Finding:
    """The id is the SHA-256 over the content's canonical JSON: keys in order, no spaces, shortest exact floats."""
    content = {key: value for key, value in claim.data.items() if key != "id"}
    canonical = json.dumps(content, separators=(",", ":"), allow_nan=False)
    holds = hashlib.sha256(canonical.encode()).hexdigest() == claim.id
    return Finding("the id is the SHA-256 of the content", holds, float(holds) - 1.0, 0.0, argument="computed again")


def of_block(name: str) -> str:
    """The condition on one block of the coupling, as its finding has it."""
    return f"V_hat of {name} is Delta_V-OSP, Lemma 1"


def _block(claim: Claim, i: int) -> Finding:
    V, Delta_D, Delta_V = claim.coupling[i], claim.Delta_D[i], claim.Delta_V[i]
    condition = of_block(claim.blocks[i].name)
    if isinstance(V, StatedSpringDamper):
        verdict = spring_damper(V, Delta_D, Delta_V, claim.kappa, claim.period)
        return verdict.finding(condition, "the spring-damper class in closed form")
    return linear(V, Delta_D, Delta_V, claim.kappa, claim.period).finding(condition, "storage matrix; V is stable")
