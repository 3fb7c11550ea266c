"""Reading a session's certificate, and proving it again for that session."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from manyhands.design.certificate import Certificate, content, differences, identity, load
from manyhands.design.errors import CertificateError
from manyhands.launch.plan.access import capability_violations
from manyhands.launch.plan.loop import NotCertified, coupling_request, haptic_loop
from manyhands.launch.plan.plan import Plan
from manyhands.launch.session import Session


def read_certificate(path: Path, session: Session | None = None) -> Certificate:
    """Read a certificate and prove it again, for ``session`` where one is given.

    A session that leaves its delay open runs with the certificate's (:func:`with_delay_of`).

    Raises:
        CertificateError: the file is not a certificate.
        NotCertified: it does not hold, is another session's, or would have another id if it were written again.
    """
    certificate, data = load(path)
    return proved(certificate, data, str(path), session)


def proved(certificate: Certificate, data: Mapping[str, Any], path: str, session: Session | None) -> Certificate:
    """``certificate``, proved from its plain ``data``, for ``session`` where one is given.

    Raises:
        CertificateError, NotCertified: as :func:`read_certificate`; ``path`` names the certificate.
    """
    from manyhands.design.proof import ProofInputError, prove  # imported here: not every command proves

    try:
        failing = [finding for finding in prove(data) if not finding.holds]
    except ProofInputError as error:
        raise CertificateError(f"{path}: {error}") from error
    if failing:
        first = failing[0]
        raise NotCertified(
            f"{path}: not proved: {first.condition}: found {first.value:.6g}, bound {first.bound:.3g}; "
            "design the session anew"
        )
    if (written := identity(content(certificate))) != certificate.id:
        raise NotCertified(
            f"{path}: the file was re-serialised: its content has the id {written[:16]}, the file says "
            f"{certificate.id[:16]}; design the session anew"
        )
    if session is not None and (found := _foreign(certificate, session)):
        raise NotCertified(f"{path}: a certificate of another session: {found}; design this session anew")
    return certificate


def _foreign(certificate: Certificate, session: Session) -> str:
    """How a certificate's session differs from this one; empty where it does not.

    A block that needs ports outside its process is reported first, as that: it could not run there, proved or not.
    """
    session = with_delay_of(certificate, session)
    found = differences(certificate, haptic_loop(session), coupling_request(session))
    loop = certificate.loop
    if loop.session == session.name and loop.ports == session.ports:
        blocks = zip(loop.partition.names, loop.partition.blocks, strict=True)
        structure = {name: [loop.ports[p] for p in block] for name, block in blocks}
        found = capability_violations(session, Plan(session).access, structure) + found
    return found[0] if found else ""


def with_delay_of(certificate: Certificate, session: Session) -> Session:
    """The session with the certificate's delay, where the session leaves its delay open."""
    if session.design.stated_tau is not None:
        return session
    if certificate.tau > session.period:  # then the periods differ
        return session.with_delay(session.latency)
    if certificate.tau < session.latency:  # then it is another session's: it covers less than the devices state
        return session.with_delay(session.latency, certificate.period_tolerance)
    return session.with_delay(certificate.tau, certificate.period_tolerance)
