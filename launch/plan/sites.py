"""From a session to its parts: its sites, its users in the tick and its world, each with what it alone needs.

Without wave links all users are in the tick, and that part is the session's whole loop.

A site's loop is made of one coupling, its devices and its wave link, and of nothing else in the session. So its
certificate is the same, byte for byte, whoever else takes part (docs/decisions/0034-sites-and-worlds.md).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from manyhands.design.certificate import Certificate, differences, read_plain
from manyhands.design.errors import CertificateError
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    LinearWanted,
    SpringDamperGiven,
)
from manyhands.design.wave_link import WaveLinkFace, WorldPromise, in_tick_id, promised_level, wave_link_id
from manyhands.design.world import is_world, world_differences, world_from_content, world_terms
from manyhands.launch.plan.certificates import read_certificate
from manyhands.launch.plan.loop import (
    NotCertified,
    Progress,
    coupling_request,
    device_level,
    haptic_loop,
    stated_delay,
)
from manyhands.launch.session import ENVIRONMENT, Session

if TYPE_CHECKING:
    from manyhands.design.synthesis import Designed
    from manyhands.design.world import World, WorldTerms

IN_TICK: Final = "in-tick"
"""The name of the part of all users without a wave link, who may be all; no coupling may have it."""


class SessionPart(NamedTuple):
    """A part of a session that is designed and certified by itself.

    Attributes:
        name: of the coupling of a site; or :data:`IN_TICK`.
        loop: its loop, with what stands for the rest of the session in the environment's place.
        request: what the session asks of its couplings.
    """

    name: str
    loop: HapticLoop
    request: CouplingRequest

    def design(self, progress: Progress | None = None) -> Designed:
        """Find or take its couplings, and prove them.

        Raises:
            DesignError: they cannot be certified.
        """
        from manyhands.design.synthesis import design  # the solver takes a second to import

        return design(self.loop, self.request, progress)


def whole(session: Session) -> SessionPart:
    """All users of a session in one loop that closes inside the tick, wave links or not.

    Raises:
        NotCertified: the delay is to be measured, and has not been.
    """
    return SessionPart(IN_TICK, haptic_loop(session), coupling_request(session))


def site(session: Session, coupling: str) -> SessionPart:
    """The site of a coupling with a wave link.

    Raises:
        KeyError: the coupling has no wave link.
        NotCertified: the delay is to be measured, and has not been.
    """
    return SessionPart(coupling, site_loop(session, coupling), request_of(session, (coupling,)))


def in_tick(session: Session) -> SessionPart:
    """The users without a wave link, together; in a session without wave links, its whole loop.

    Raises:
        ValueError: every coupling has a wave link.
        Infeasible: the level that the world promises them does not exist.
        NotCertified: the delay is to be measured, and has not been.
    """
    if not session.wave_links:
        return whole(session)
    names = tuple(name for name in session.couplings if name not in session.wave_links)
    if not names:
        raise ValueError(f"{session.name}: found a wave link at every coupling; expected users in the tick")
    own = {port for name in names for port in session.blocks_by_name[name]}
    ports = tuple(port for port in session.ports if port in own)
    index = {port: i for i, port in enumerate(ports)}
    environment = session.environment.for_design(session.ports)
    level = promised_level(environment, _partition(session), frozenset(session.wave_links))
    blocks = tuple(tuple(index[p] for p in session.blocks_by_name[name]) for name in names)
    loop = HapticLoop(
        session=session.name,
        period=session.period,
        ports=ports,
        devices=_devices(session, index, stated_delay(session)),
        partition=Partition(names, blocks),
        environment=WorldPromise(ports, level, id=in_tick_id(session.name, session.period, ports, level)),
        tau=stated_delay(session),
        period_tolerance=session.period_tolerance,
    )
    return SessionPart(IN_TICK, loop, request_of(session, names, ports))


def part(session: Session, name: str) -> SessionPart:
    """A part by its name: the site of a coupling with a wave link, or the users in the tick (:data:`IN_TICK`).

    Raises:
        KeyError, ValueError, Infeasible, NotCertified: as :func:`site` and :func:`in_tick`.
    """
    return in_tick(session) if name == IN_TICK else site(session, name)


def world(session: Session, progress: Progress | None = None) -> World:
    """The certificate of the session's world, proved.

    Raises:
        DesignError: the environment does not keep what it owes.
    """
    from manyhands.design.world_synthesis import design_world  # the solver's modules take a second to import

    return design_world(terms_of_world(session), progress)


def terms_of_world(session: Session) -> WorldTerms:
    """What a session asks of its world."""
    links = {
        name: (link.impedance(len(session.blocks_by_name[name])), link.tank)
        for name, link in session.wave_links.items()
    }
    environment = session.environment.for_design(session.ports)
    return world_terms(session.name, session.period, environment, _partition(session), links)


def parts(session: Session) -> tuple[SessionPart, ...]:
    """The sites of a session, in the order of its couplings, and then the users in the tick where there are any.

    Raises:
        Infeasible, NotCertified: as :func:`in_tick`.
    """
    sites = tuple(site(session, name) for name in session.wave_links)
    return (*sites, in_tick(session)) if len(sites) < len(session.couplings) else sites


def part_names(session: Session) -> tuple[str, ...]:
    """The parts of a session, by name: its sites, the users in the tick, and the world where there are wave links."""
    others = (IN_TICK,) if len(session.wave_links) < len(session.couplings) else ()
    return (*session.wave_links, *others, *([ENVIRONMENT] if session.wave_links else []))


def part_files(session: Session, output: Path) -> dict[str, Path]:
    """The file of each part: ``output`` of the world, or of the only part; of the others, ``two.cx.cert.json``."""
    *others, whole = part_names(session)
    stem, dot, suffixes = output.name.partition(".")
    return {name: output.with_name(f"{stem}.{name}{dot}{suffixes}") for name in others} | {whole: output}


def read_parts(path: Path, session: Session) -> tuple[World, dict[str, Certificate]]:
    """Read the certificate of a world and those of its parts beside it, and prove all of them for ``session``.

    Raises:
        CertificateError: a file is missing, or is no certificate.
        NotCertified: one does not hold, or is of another session.
    """
    proved = _read_world(path, session)
    if isinstance(proved, str):
        raise NotCertified(f"{path}: a world of another session: {proved}; design this session anew")
    parts: dict[str, Certificate] = {}
    for name, file in part_files(session, path).items():
        if name == ENVIRONMENT:
            continue
        certificate = parts[name] = read_certificate(file)
        if found := differences_from(certificate, session):
            raise NotCertified(f"{file}: a certificate of another session: {found[0]}; design this session anew")
    return proved, parts


def kept_parts(
    path: Path, session: Session, progress: Progress | None = None
) -> tuple[World, dict[str, Certificate], tuple[str, ...]]:
    """As :func:`read_parts`, for a session that may have changed: what is no longer its own is designed anew.

    Returns:
        The world, the parts, and the names of those that were designed anew.

    Raises:
        CertificateError: a file is no certificate.
        NotCertified: one does not hold.
        DesignError: a part that has changed cannot be certified.
    """
    renewed: list[str] = []
    certified: dict[str, Certificate] = {}
    files = part_files(session, path)
    for part in parts(session):
        file = files[part.name]
        own = read_certificate(file) if file.exists() else None
        if own is None or differences_from(own, session):
            renewed.append(part.name)
            own = part.design(progress).certificate
        certified[part.name] = own
    proved = _read_world(path, session)
    if isinstance(proved, str):
        renewed.append(ENVIRONMENT)
        proved = world(session, progress)
    return proved, certified, tuple(renewed)


def with_kept_delay(path: Path, session: Session) -> Session:
    """The session for the delay that its users in the tick are certified for already, where that covers its own.

    A measured delay differs from one day to the next. Certificates that cover more than the latest are not made anew.

    Args:
        path: the file of the world's certificate, which need not exist.
        session: the session with the delay that was measured.

    Raises:
        CertificateError: the file of the users in the tick is no certificate.
        NotCertified: that certificate does not hold.
    """
    file = part_files(session, path)[IN_TICK]
    if not file.exists():
        return session
    kept = read_certificate(file)
    if not stated_delay(session) <= kept.tau <= session.period or session.period_tolerance > kept.period_tolerance:
        return session
    return session.with_delay(kept.tau, kept.period_tolerance)


def _read_world(path: Path, session: Session) -> World | str:
    """The world in a file, proved; where it is another session's, a sentence that says what differs.

    Raises:
        CertificateError: the file is no certificate of a world.
        NotCertified: the world does not hold.
    """
    from manyhands.design.proof import ProofInputError, prove_world  # imported here: not every command proves

    data = read_plain(path)
    if not is_world(data):
        raise CertificateError(
            f"{path}: found a certificate of one loop; expected that of a world, for the session has wave links"
        )
    try:
        failing = [finding for finding in prove_world(data) if not finding.holds]
    except ProofInputError as error:
        raise CertificateError(f"{path}: {error}") from error
    if failing:
        raise NotCertified(f"{path}: not proved: {failing[0].condition} ({failing[0].argument}); design it anew")
    terms = terms_of_world(session)
    if found := world_differences(data, terms):
        return found[0]
    try:
        return world_from_content(data, terms)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        what = f"key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise CertificateError(f"{path}: not a world as manyhands writes it: {what}; design it anew") from error


def differences_from(certificate: Certificate, session: Session) -> list[str]:
    """A sentence for each difference between a certificate and the part of the session that it is of."""
    environment = certificate.loop.environment
    name = certificate.loop.partition.names[0]
    # the two kinds are those that this module itself gives to a part
    in_the_tick = isinstance(environment, WorldPromise) and len(session.wave_links) < len(session.couplings)
    if isinstance(environment, WaveLinkFace) and name in session.wave_links:
        own = site(session, name)
    elif in_the_tick or not session.wave_links:
        own = in_tick(session)
    else:
        return [f"the session has the wave links {', '.join(session.wave_links)}, and no part like this one"]
    return differences(certificate, own.loop, own.request)


def _partition(session: Session) -> Partition:
    index = {port: i for i, port in enumerate(session.ports)}
    return Partition(tuple(session.couplings), tuple(tuple(index[p] for p in block) for block in session.blocks))


def site_loop(session: Session, coupling: str) -> HapticLoop:
    """The loop of a coupling with a wave link: its devices, the coupling, and the user's face of the wave link.

    Raises:
        KeyError: the coupling has no wave link.
    """
    link = session.wave_links[coupling]
    ports = session.blocks_by_name[coupling]
    m = len(ports)
    b = link.impedance(m)
    face = WaveLinkFace(
        ports,
        id=wave_link_id(session.name, coupling, ports, b, link.tank),
        b=b,
        tank=link.tank,
        harvest=link.harvest_of(m),
        round_trip=link.round_trip,
        mass=link.mass_matrix(m),
    )
    index = {port: i for i, port in enumerate(ports)}
    tau = stated_delay(session) if link.tau is None else link.tau
    return HapticLoop(
        session=session.name,
        period=link.period_in(session.period),
        ports=ports,
        devices=_devices(session, index, tau),
        partition=Partition((coupling,), (tuple(range(m)),)),
        environment=face,
        tau=tau,
        period_tolerance=session.period_tolerance,
    )


def _devices(session: Session, index: dict[str, int], tau: float) -> tuple[DeviceLevel, ...]:
    """The devices of these ports, with their places in ``index``; ``tau`` is the longest delay of their part, s."""
    names = {session.device_at[port] for port in index}
    own = {name: session.ports_of(name) for name in session.devices if name in names}
    return tuple(
        device_level(session, name, tuple(index[p] for p in ports), tau)
        for name, ports in own.items()
        if ports[0] in index
    )


def request_of(session: Session, couplings: tuple[str, ...], ports: tuple[str, ...] = ()) -> CouplingRequest:
    """What the session asks of these of its couplings.

    Args:
        session: the session.
        couplings: their names.
        ports: their ports in the loop's order; those of the only coupling unless given.
    """
    wanted = coupling_request(session)
    places = [i for i, name in enumerate(session.couplings) if name in couplings]
    match wanted:
        case LinearWanted(orders):
            return replace(wanted, orders=tuple(orders[i] for i in places))
        case LinearGiven(blocks):
            return replace(wanted, blocks=tuple(blocks[i] for i in places))
        case SpringDamperGiven(given):
            own = [session.ports.index(port) for port in ports or session.blocks_by_name[couplings[0]]]
            at = np.ix_(own, own)
            return replace(wanted, coupling=SpringDamper(given.stiffness[at], given.damping[at]))
    return wanted
