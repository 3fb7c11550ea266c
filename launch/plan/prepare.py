"""Between a session file and a run: the coupling that will be in force, and what proves it.

A run needs a certificate, designed now or read from a file and proved again. Without one it is refused, unless
the user says that nothing needs to be proved.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manyhands.design.certificate import Certificate, content, identity, load
from manyhands.design.differences import differences
from manyhands.design.errors import CertificateError, DesignError, Infeasible
from manyhands.design.problem import HapticLoop, LinearGiven, NoCoupling, SpringDamperGiven
from manyhands.design.statespace import StateSpace
from manyhands.launch.access import capability_violations
from manyhands.launch.loop import coupling_request, haptic_loop
from manyhands.launch.plan import Plan
from manyhands.launch.session import Session

if TYPE_CHECKING:
    from manyhands.design.ladder import Ladder
    from manyhands.design.synthesis import Designed

Progress = Callable[[str], None]

UNCERTIFIED = "uncertified-"


class NotCertified(Exception):
    """A run was refused because its session is not certified; the text says why and what could be done."""


@dataclass(frozen=True, eq=False)
class Prepared(Plan):
    """A planned session with the coupling it will run under.

    Attributes:
        loop: its haptic loop.
        blocks: the realisation of each block of V, in the session's order.
        certificate: what proves it stable; None for a run that nothing proves.
        id: what all processes of the run must agree on.
        ladder: the certificate and those for longer delays; None where there are none.
        notes: why a delay of the ladder has none, a sentence each.
    """

    loop: HapticLoop
    blocks: tuple[StateSpace, ...]
    certificate: Certificate | None
    id: str
    ladder: Ladder | None = None
    notes: tuple[str, ...] = ()


def certify(session: Session, progress: Progress | None = None) -> Designed:
    """Design the session's coupling, or take the given one, and prove it.

    Raises:
        DesignError: it cannot be certified.
    """
    from manyhands.design.synthesis import design  # the solver takes a second to import; a proof does not need it

    return design(haptic_loop(session), coupling_request(session), progress)


def read_certificate(path: Path, session: Session | None = None) -> Certificate:
    """Read a certificate and prove it again, for ``session`` where one is given.

    Raises:
        CertificateError: the file is not a certificate.
        NotCertified: it does not hold, is another session's, or would not keep its id when it is written again.
    """
    from manyhands.design.proof import ProofInputError, prove  # what only runs need not import

    certificate, data = load(path)
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
            f"{path}: found another order of keys, or other forms of numbers, than manyhands writes; written again, as "
            f"in a recording, its id would be {written[:16]} instead of {certificate.id[:16]}; design the session anew"
        )
    if session is not None and (found := _foreign(certificate, session)):
        raise NotCertified(f"{path}: a certificate of another session: {found}; design this session anew")
    return certificate


def _foreign(certificate: Certificate, session: Session) -> str:
    """Why a certificate is another session's; empty where it is this one's.

    A block that would need ports outside its process is told as that: it could not run there, whatever was proved.
    """
    found = differences(certificate, haptic_loop(session), coupling_request(session))
    loop = certificate.loop
    if loop.session == session.name and loop.ports == session.ports:
        blocks = zip(loop.partition.names, loop.partition.blocks, strict=True)
        structure = {name: [loop.ports[p] for p in block] for name, block in blocks}
        found = capability_violations(session, Plan(session).access, structure) + found
    return found[0] if found else ""


def prepare(
    session: Session,
    certificate: Path | None = None,
    uncertified: bool = False,
    progress: Progress | None = None,
) -> Prepared:
    """Settle the coupling of a run, and the ladder of softer ones that it may change to.

    A certificate's file holds no ladder: one is designed for it here, and the same again wherever it is read.

    Args:
        session: the session.
        certificate: a certificate file to run under, instead of designing.
        uncertified: run even if nothing proves the session stable.
        progress: told what the design is doing.

    Raises:
        CertificateError: the certificate cannot be read.
        NotCertified: no certificate, and ``uncertified`` was not said, or there is no coupling to run.
    """
    loop = haptic_loop(session)
    try:
        proof = (
            certify(session, progress).certificate if certificate is None else read_certificate(certificate, session)
        )
    except DesignError as error:
        if certificate is not None:
            raise
        if not uncertified:
            raise NotCertified(f"{session.name} is not certified: {error}") from error
        return unproved(session, error)
    ladder, notes = _ladder(session, proof, progress)
    return Prepared(session, loop, proof.blocks, proof, proof.id, ladder, notes)


def _ladder(session: Session, first: Certificate, progress: Progress | None) -> tuple[Ladder | None, tuple[str, ...]]:
    """The ladder that the session asks for, with ``first`` as its rung 0, and what it lacks."""
    stated = session.design.ladder
    if stated == () or (stated is None and first.tau == first.loop.period):
        return None, ()
    from manyhands.design.ladder import automatic_delays, design_ladder  # the solver takes a second to import

    delays = automatic_delays(first.loop) if stated is None else stated
    return design_ladder(first, coupling_request(session), delays, progress)


def unproved(session: Session, why: DesignError | None = None) -> Prepared:
    """A run of the coupling that the session states, which nothing proves.

    Args:
        session: the session.
        why: what is known of why nothing does.

    Raises:
        NotCertified: the session states no coupling, or one that cannot be realised.
    """
    loop = haptic_loop(session)
    return Prepared(session, loop, _unproved_blocks(session, loop, why), None, _uncertified_id(session))


def _unproved_blocks(session: Session, loop: HapticLoop, why: DesignError | None) -> tuple[StateSpace, ...]:
    """The coupling that the session states, certified or not."""
    match coupling_request(session):
        case NoCoupling():
            return tuple(StateSpace.static(np.zeros((len(b), len(b)))) for b in loop.partition.blocks)
        case LinearGiven(blocks):
            return blocks
        case SpringDamperGiven(coupling):
            try:
                return tuple(part.realisation(loop.period) for part in coupling.restrict(loop.partition))
            except ValueError as error:
                raise NotCertified(f"{session.name}: the given coupling cannot be realised: {error}") from error
        case _:
            text = f"{session.name}: no coupling was found, so there is none to run uncertified: {why}"
            raise NotCertified(text) from (why if isinstance(why, Infeasible) else None)


def _uncertified_id(session: Session) -> str:
    content = json.dumps(session.as_plain(), sort_keys=True)
    return UNCERTIFIED + hashlib.sha256(content.encode()).hexdigest()
