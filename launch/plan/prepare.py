"""From a session to the couplings of its run and the certificates that prove them.

Every session is parts, each with a certificate of its own. A session without wave links has one, *in the tick*. With
wave links there is one for each site, one for the users in the tick, and a world that the parts meet.

A run needs its certificates, which are designed now or read from files and proved again. Without them the run is
refused, unless the user asks for an uncertified run.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manyhands.design.certificate import Certificate, content, to_json
from manyhands.design.errors import CertificateError, DesignError, Infeasible
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.statespace import Matrix, StateSpace, matrix
from manyhands.design.problem import (
    CouplingRequest,
    HapticLoop,
    LinearGiven,
    NoCoupling,
    SpringDamperGiven,
)
from manyhands.design.world import world_json
from manyhands.launch.plan import sites
from manyhands.launch.plan.certificates import proved, read_certificate, with_delay_of
from manyhands.launch.plan.loop import NotCertified, Progress, coupling_request, haptic_loop
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.remedies import with_remedies
from manyhands.launch.session import ENVIRONMENT, Session
from manyhands.launch.session.design import AUTO
from manyhands.nodes.recorder.format import CERTIFICATE_FILE

if TYPE_CHECKING:
    from manyhands.design.ladder import Ladder
    from manyhands.design.world import World

UNCERTIFIED = "uncertified-"


@dataclass(frozen=True, eq=False)
class Prepared(Plan):
    """A planned session with the coupling of its run.

    Attributes:
        loop: the session's haptic loop as it is run; where compliance of the world is counted in series, it is cut
            inside the world's links (:attr:`.HapticLoop.cut`).
        blocks: the realisation of each block of V, in the session's order.
        id: of the certificates together, or of the uncertified session; all processes of the run must agree on it.
        parts: the certificate of each part: of a coupling with a wave link, and of the users in the tick
            (:data:`.sites.IN_TICK`), who are all where there is no wave link; empty for an uncertified run.
        world: the certificate of the world that the parts meet over wave links; None where there are none.
        ladder: the certificate of the users in the tick, and those for longer delays; None where there are none.
        notes: one sentence for each delay of the ladder without a certificate: why it has none.
    """

    loop: HapticLoop
    blocks: tuple[StateSpace, ...]
    id: str
    parts: Mapping[str, Certificate] = field(default_factory=dict)
    world: World | None = None
    ladder: Ladder | None = None
    notes: tuple[str, ...] = ()

    __repr__ = brief_repr

    @property
    def certified(self) -> bool:
        """Whether the run is proved stable."""
        return bool(self.parts)

    @property
    def certificate(self) -> Certificate | None:
        """The one certificate of a run without wave links; None for an uncertified run, or where each party has one."""
        return self.parts.get(sites.IN_TICK) if self.world is None else None

    def certificate_of(self, node: str) -> Certificate | None:
        """The certificate that a device or a coupling runs under; None for an uncertified run."""
        return self.parts.get(self.session.sites.get(node, sites.IN_TICK))

    @property
    def Phi_E(self) -> Matrix | None:
        """The level that the environment is proved to have, N·s/m, at every rung; None for an uncertified run."""
        if self.world is not None:
            return matrix(self.world.Phi_E)
        if self.ladder is not None:
            return self.ladder.Phi_E
        return None if self.certificate is None else self.certificate.levels.Phi_E

    @property
    def certificates(self) -> tuple[Certificate, ...]:
        """The certificates of all parts; none for an uncertified run."""
        return tuple(self.parts.values())

    @property
    def rungs(self) -> tuple[Certificate, ...]:
        """The certificates, and then those of the ladder for longer delays, growing."""
        return (*self.certificates, *(() if self.ladder is None else self.ladder.rungs[1:]))


def must_measure(session: Session, *, realtime: bool) -> bool:
    """Whether a session that is about to be designed needs the delay of this machine.

    The session asks for it by ``tau: auto``, or leaves its delay open and is to run in real time. A session without a
    coupling has nothing to design.

    Args:
        session: the session.
        realtime: whether it is to run in real time, with all its processes on this machine.
    """
    tau = session.design.tau
    return session.design.coupling != "none" and (tau == AUTO or (tau is None and realtime))


def prepare(
    session: Session,
    certificate: Path | Certificate | None = None,
    uncertified: bool = False,
    progress: Progress | None = None,
) -> Prepared:
    """Settle the coupling of a run, and the ladder of softer couplings to which it may change.

    A certificate's file holds no ladder. The ladder is designed here for the certificate; every reading of that file
    designs the same one.

    Args:
        session: the session.
        certificate: the certificate to run under, or its file, instead of designing; it is proved again.
        uncertified: run even if nothing proves the session stable.
        progress: called with each step of the design, as a text.

    Raises:
        CertificateError: the certificate cannot be read, or is not the file of a world where the session needs one.
        NotCertified: no certificate was found and ``uncertified`` is false, or there is no coupling to run.
    """
    if certificate is not None:
        return _of_parts(*_read(session, certificate), progress)
    session = _settled(session)
    parts: dict[str, Certificate] = {}
    world, name = None, sites.IN_TICK
    try:
        for name in sites.part_names(session):
            if name == ENVIRONMENT:
                world = sites.world(session, progress)
            else:
                parts[name] = sites.part(session, name).design(progress).certificate
    except DesignError as error:
        if not uncertified:
            raise NotCertified(f"{session.name} is not certified: {error}") from with_remedies(error, session, name)
        return unproved(session, error)
    return _of_parts(session, world, parts, progress)


def _read(session: Session, certificate: Path | Certificate) -> tuple[Session, World | None, Mapping[str, Certificate]]:
    """The session with the delay of a certificate that is given, the world where there is one, and the parts.

    Raises:
        CertificateError, NotCertified: as :func:`prepare`.
    """
    if session.wave_links:
        if isinstance(certificate, Certificate):
            expected = "the file of its world, with those of its parts beside it"
            raise CertificateError(
                f"{session.name}: found one certificate for a session with wave links; expected {expected}"
            )
        session = _settled(session)
        return session, *sites.read_parts(certificate, session)
    if isinstance(certificate, Certificate):
        plain = {"id": certificate.id, **content(certificate)}
        proof = proved(certificate, plain, f"certificate {certificate.id[:16]}", session)
    else:
        proof = read_certificate(certificate, session)
    return with_delay_of(proof, session), None, {sites.IN_TICK: proof}


def prepare_again(
    session: Session, certificate: Path, progress: Progress | None = None
) -> tuple[Prepared, tuple[str, ...]]:
    """Settle the parts of a session with wave links that may have changed since its certificates were written.

    A part whose terms are still the session's keeps its certificate; the others are designed anew.

    Args:
        session: the session.
        certificate: the file of the world, with those of the parts beside it.
        progress: called with each step of a design, as a text.

    Returns:
        The prepared session, and the parts that were designed anew; the world among them as "environment".

    Raises:
        CertificateError: a file is no certificate.
        NotCertified: a certificate in a file does not hold, or no certificate was found for a part that has changed.
    """
    session = _settled(session)
    try:
        world, parts, renewed = sites.kept_parts(certificate, session, progress)
    except DesignError as error:
        raise NotCertified(f"{session.name} is not certified: {error}") from error
    return _of_parts(session, world, parts, progress), renewed


def _of_parts(
    session: Session, world: World | None, parts: Mapping[str, Certificate], progress: Progress | None
) -> Prepared:
    """The session under the certificates of its parts, and of its world where there is one.

    The users in the tick have a ladder.
    """
    of_parts = {
        name: block
        for part in parts.values()
        for name, block in zip(part.loop.partition.names, part.blocks, strict=True)
    }
    loop, blocks = haptic_loop(session), tuple(of_parts[name] for name in session.couplings)
    ladder: Ladder | None = None
    notes: tuple[str, ...] = ()
    if sites.IN_TICK in parts:
        ladder, notes = _ladder(session, parts[sites.IN_TICK], sites.in_tick(session).request, progress)
    if world is None:
        return Prepared(session, loop.cut, blocks, parts[sites.IN_TICK].id, parts, None, ladder, notes)
    every = json.dumps([world.id, *(part.id for part in parts.values())])
    return Prepared(session, loop, blocks, hashlib.sha256(every.encode()).hexdigest(), parts, world, ladder, notes)


def _settled(session: Session) -> Session:
    """The session with the delay written out that it runs with, for its records (:func:`stated_delay`)."""
    return session.with_delay(session.latency) if session.design.tau is None else session


def _ladder(
    session: Session, first: Certificate, request: CouplingRequest, progress: Progress | None
) -> tuple[Ladder | None, tuple[str, ...]]:
    """The ladder that the session asks for, with ``first`` as its rung 0, and notes on the delays that it lacks.

    ``request`` is what was asked of the couplings of ``first``.
    """
    stated = session.design.ladder
    if stated == () or (stated is None and first.tau == first.loop.period):
        return None, ()
    from manyhands.design.ladder import automatic_delays, design_ladder  # the solver takes a second to import

    delays = automatic_delays(first.loop) if stated is None else stated
    return design_ladder(first, request, delays, progress)


def unproved(session: Session, why: DesignError | None = None) -> Prepared:
    """An uncertified run of the coupling that the session states.

    Args:
        session: the session.
        why: the error of the design, if one was tried.

    Raises:
        NotCertified: the session states no coupling, or one that cannot be realised.
    """
    session = _settled(session)
    loop = haptic_loop(session)
    return Prepared(session, loop, _unproved_blocks(session, loop, why), _uncertified_id(session))


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
    settled = session.as_plain() | {"colocate": session.colocated}  # the word for "as the machine needs it" is no form
    content = json.dumps(settled, sort_keys=True)
    return UNCERTIFIED + hashlib.sha256(content.encode()).hexdigest()


def certificate_files(prepared: Prepared) -> dict[str, bytes]:
    """The files of a run's certificates, contents by name; :func:`prepare` reads them."""
    files = sites.part_files(prepared.session, Path(CERTIFICATE_FILE))
    out = {} if prepared.world is None else {files[ENVIRONMENT].name: world_json(prepared.world).encode()}
    return out | {files[name].name: to_json(part).encode() for name, part in prepared.parts.items()}
