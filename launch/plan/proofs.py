"""Certificates proved again, of one loop or of a world with its parts, and compared with a session."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from manyhands.design.certificate import Certificate, certificate_of
from manyhands.design.proof import Finding, Proof, prove, prove_together, prove_world
from manyhands.design.world import world_differences
from manyhands.launch.plan.certificates import with_delay_of
from manyhands.launch.plan.sites import differences_from, terms_of_world
from manyhands.launch.session import Session

Progress = Callable[[str], None]
Data = Mapping[str, Any]
"""The plain data of a certificate's file."""


def prove_loop(
    certificate: Certificate, data: Data, session: Session | None = None, progress: Progress | None = None
) -> Proof:
    """Prove the certificate of a loop again.

    Args:
        certificate: what is read from ``data``.
        data: the plain data of its file.
        session: the session that it should belong to; None for any.
        progress: called with the name of each part of the proof.

    Raises:
        ProofInputError: the data are no certificate.
    """
    found = prove(data, progress) + _of_session(certificate, session)
    return Proof(certificate.loop.session, found)


def prove_parts(
    data: Data, others: Mapping[str, Data], session: Session | None = None, progress: Progress | None = None
) -> tuple[Proof, dict[str, Proof]]:
    """Prove a world again, and that other certificates meet it by the contracts that it states.

    Args:
        data: the plain data of the world's file.
        others: those of sites and of the users in the tick, by a name for messages.
        session: the session that the world and each part should be of; None for any.
        progress: called with the name of each part of the proof.

    Returns:
        The proof of the world and of its contracts, and the proof of each other certificate.

    Raises:
        ProofInputError, CertificateError: some data are no certificate.
    """
    certificates = {name: certificate_of(other, Path(name)) for name, other in others.items()}
    found = prove_world(data, progress) + prove_together(data, [*others.values()])
    parts = {}
    for name, other in others.items():
        own = prove(other, progress) + _of_session(certificates[name], session)
        parts[name] = Proof(name, own)
    if session is not None:
        found += _foreign(world_differences(data, terms_of_world(session)))
    return Proof(str(data["session"]), found), parts


def _of_session(certificate: Certificate, session: Session | None) -> tuple[Finding, ...]:
    """How the certificate of a loop differs from its part of the session, where one is given."""
    if session is None:
        return ()
    return _foreign(differences_from(certificate, with_delay_of(certificate, session)))


def _foreign(texts: Sequence[str]) -> tuple[Finding, ...]:
    """A finding that fails for each sentence about how a certificate differs from a session."""
    return tuple(Finding(f"it is the session's: {text}", False, 1.0, 0.0) for text in texts)
