"""From a session to the coupling of its run and the certificate that proves it.

A run needs a certificate, which is designed now or read from a file and proved again. Without a certificate the run is
refused, unless the user asks for an uncertified run. :func:`haptic_loop` and :func:`coupling_request` translate a
session into the types of ``design``: the loop, and what is asked of its coupling.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from manyhands.design.certificate import Certificate, content, differences, identity, load
from manyhands.design.errors import CertificateError, DesignError, Infeasible
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.environment import (
    DeclaredEnvironment,
    DeclaredScene,
    DelayedNetwork,
    Environment,
    NetworkBox,
    ProxyEnvironment,
    StateSpaceEnvironment,
    TransferEnvironment,
)
from manyhands.design.models.network import Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import (
    MOST_ITERATIONS,
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    LinearWanted,
    NoCoupling,
    PolePair,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.series import counted_parts
from manyhands.launch.plan.access import capability_violations
from manyhands.launch.plan.plan import Plan
from manyhands.launch.session import AskedEnvironment, BlockMatrices, Session
from manyhands.launch.session.design import AUTO
from manyhands.launch.session.environment import NetworkEnvironment
from manyhands.launch.session.environment import StateSpaceEnvironment as GivenMatrices
from manyhands.launch.session.fields import Interval
from manyhands.launch.session.scene import SceneEnvironment

if TYPE_CHECKING:
    from manyhands.design.ladder import Ladder
    from manyhands.design.synthesis import Designed
    from manyhands.design.world import World


def haptic_loop(session: Session) -> HapticLoop:
    """The loop: ports, levels, block structure and environment, all in the session's order.

    A session that states no delay is designed for none, as in [Bianchini2010]_. One that asks for a measured delay gets
    it by :meth:`Session.with_delay` before it comes here.

    Raises:
        NotCertified: the delay is to be measured, and has not been.
    """
    tau = stated_delay(session)
    index = {port: i for i, port in enumerate(session.ports)}
    loop = HapticLoop(
        session=session.name,
        period=session.period,
        ports=session.ports,
        devices=tuple(
            DeviceLevel(name, tuple(index[p] for p in session.ports_of(name)), session.osp_level(name))
            for name in session.devices
        ),
        partition=Partition(
            tuple(session.couplings), tuple(tuple(index[p] for p in block) for block in session.blocks)
        ),
        environment=session_environment(session),
        tau=tau,
        period_tolerance=session.period_tolerance,
    )
    most = session.design.counted
    return loop if most is None else replace(loop, series=counted_parts(loop, most))


def stated_delay(session: Session) -> float:
    """The delay inside the tick that the session is designed for, s.

    Where the session states none, it is what its devices state of themselves: the age of their samples and the delay of
    their forces, and 0 without either. Where it states one, it is at least that.

    Raises:
        NotCertified: the delay is to be measured, and has not been.
    """
    if session.design.tau == AUTO:
        raise NotCertified(
            f"{session.name}: design.tau: found {AUTO}, and no measurement; expected a delay in s, or a command that "
            "measures it (launch, design)"
        )
    return session.latency if session.design.stated_tau is None else session.design.stated_tau


def session_environment(session: Session) -> Environment:
    """The environment as one of the types of ``design``."""
    given, ports = session.environment, session.ports
    if isinstance(given, SceneEnvironment):
        return DeclaredScene(given.scene(ports))
    if isinstance(given, AskedEnvironment):
        level, stiffness = given.level_matrix(len(ports)), given.stiffness_matrix(len(ports))
        if stiffness is not None:
            return ProxyEnvironment(ports, level, stiffness, given.content(ports), given.tank)
        return DeclaredEnvironment(ports, level, given.enforce)
    if isinstance(given, NetworkEnvironment):
        low = _network(given, ports, high=False)
        if given.uncertain:
            return NetworkBox(low, _network(given, ports, high=True))
        return DelayedNetwork(low, given.delay) if given.delay else low
    if isinstance(given, GivenMatrices):
        system = _system(given, "the environment", continuous=given.time == "continuous")
        return StateSpaceEnvironment(ports, system, given.method, given.delay)
    entries = tuple(tuple((entry.num, entry.den) for entry in row) for row in given.entries)
    return TransferEnvironment(ports, entries, given.method, given.delay)


def _system(given: GivenMatrices | BlockMatrices, what: str, *, continuous: bool) -> StateSpace:
    """The matrices, with D as stated, or computed from the static gain that is stated in its place.

    Raises:
        Infeasible: a static gain is stated, but a pole at s = 0 or z = 1 permits none.
    """
    A, B, C, last = given.arrays()
    if given.static is None:
        return StateSpace(A, B, C, last)
    try:
        return StateSpace.with_static_gain(A, B, C, last, continuous=continuous)
    except ValueError as error:
        raise Infeasible(f"{what}: {error}", ("state D instead", "give every mode a spring that holds it")) from error


def _network(given: NetworkEnvironment, ports: tuple[str, ...], high: bool) -> Network:
    """The network with every interval at one of its ends."""

    def end(value: float | Interval) -> float:
        interval = Interval.of(value)
        return interval.high if high else interval.low

    return Network(
        ports,
        tuple((name, end(mass)) for name, mass in given.masses.items()),
        tuple(NetworkLink(link.between, end(link.stiffness), end(link.damping)) for link in given.links),
    )


def coupling_request(session: Session) -> CouplingRequest:
    """What the session's ``design:`` asks for."""
    design = session.design
    if design.coupling == "none":
        return NoCoupling()
    aim = _aim(session)
    if design.coupling == "given":
        if design.matrices is not None:
            given = design.matrices
            blocks = tuple(_system(given[name], f"coupling {name}", continuous=False) for name in session.couplings)
            return LinearGiven(blocks, aim)
        stiffness, damping = session.given_stiffness, session.given_damping
        if stiffness is None or damping is None:
            raise AssertionError("a validated session gives stiffness and damping, or matrices")
        return SpringDamperGiven(SpringDamper(stiffness, damping), aim)
    wish = Wish(design.objective, aim, design.algorithm, design.iterations or MOST_ITERATIONS)
    if design.coupling == "spring-damper":
        return SpringDamperWanted(wish)
    orders = tuple(design.order_of(name) for name in session.couplings)
    poles = None if design.poles is None else tuple(PolePair(pole.frequency, pole.damping) for pole in design.poles)
    return LinearWanted(orders, wish, poles)


def _aim(session: Session) -> Transparency | None:
    """The transparency problem, its weights discretised by backward Euler."""
    design, T = session.design, session.period
    if design.objective not in ("loop-shaping", "closed-loop"):
        return None
    W1, W2 = (Filter.from_continuous(W.num, W.den, T) for W in (design.W1, design.W2))
    return Transparency(design.objective, W1, W2)


Progress = Callable[[str], None]

UNCERTIFIED = "uncertified-"


class NotCertified(Exception):
    """A run was refused because its session is not certified; the text states the reason and a remedy.

    Example:
        >>> import manyhands as mh
        >>> try:
        ...     mh.launch("example1-uncoupled", 1.0, clock="simulated")
        ... except mh.NotCertified as error:
        ...     print(str(error)[:42])
        example-1-uncoupled is not certified: ther
    """


IN_TICK: Final = "in-tick"
"""The name of the part of all users without a wave link; no coupling may have it."""


@dataclass(frozen=True, eq=False)
class Prepared(Plan):
    """A planned session with the coupling of its run.

    Attributes:
        loop: the session's haptic loop as it is run; where compliance of the world is counted in series, it is cut
            inside the world's links (:attr:`.HapticLoop.cut`).
        blocks: the realisation of each block of V, in the session's order.
        certificate: the certificate of the loop's stability; None for an uncertified run.
        id: the certificate's id, or one of the uncertified session; all processes of the run must agree on it.
        ladder: the certificate and those for longer delays; None where there are none.
        notes: one sentence for each delay of the ladder without a certificate: why it has none.
        world: the certificate of the world of a session with wave links; None for every other run. Then
            ``certificate`` is None, and every party has one of its own.
        parts: the certificates of the parties of such a world, by part: a coupling with a wave link, or the users in
            the tick (:data:`IN_TICK`).
    """

    loop: HapticLoop
    blocks: tuple[StateSpace, ...]
    certificate: Certificate | None
    id: str
    ladder: Ladder | None = None
    notes: tuple[str, ...] = ()
    world: World | None = None
    parts: Mapping[str, Certificate] = field(default_factory=dict)

    __repr__ = brief_repr

    @property
    def certified(self) -> bool:
        """Whether the run is proved stable."""
        return self.certificate is not None or self.world is not None

    def certificate_of(self, node: str) -> Certificate | None:
        """The certificate that a device or a coupling runs under; None for an uncertified run."""
        if self.world is None:
            return self.certificate
        return self.parts[self.session.sites.get(node, IN_TICK)]

    @property
    def certificates(self) -> tuple[Certificate, ...]:
        """All certificates of the run's parties: one, or with wave links one for each part; none if uncertified."""
        return tuple(self.parts.values()) if self.certificate is None else (self.certificate,)


def certify(session: Session, progress: Progress | None = None) -> Designed:
    """Design the session's coupling, or take the given one, and prove it.

    Raises:
        DesignError: the session cannot be certified.
    """
    from manyhands.design.synthesis import design  # the solver takes a second to import; a proof does not need it

    return design(haptic_loop(session), coupling_request(session), progress)


def read_certificate(path: Path, session: Session | None = None) -> Certificate:
    """Read a certificate and prove it again, for ``session`` where one is given.

    A session that leaves its delay open runs with the certificate's (:func:`with_delay_of`).

    Raises:
        CertificateError: the file is not a certificate.
        NotCertified: it does not hold, is another session's, or would have another id if it were written again.
    """
    certificate, data = load(path)
    return _proved(certificate, data, str(path), session)


def _proved(certificate: Certificate, data: Mapping[str, Any], path: str, session: Session | None) -> Certificate:
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
            f"{path}: found another order of keys, or other forms of numbers, than manyhands writes; written again, as "
            f"in a recording, its id would be {written[:16]} instead of {certificate.id[:16]}; design the session anew"
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


def with_delay_of(certificate: Certificate, session: Session) -> Session:
    """The session with the certificate's delay, where the session leaves its delay open."""
    if session.design.stated_tau is not None:
        return session
    if certificate.tau > session.period:  # then the periods differ
        return session.with_delay(session.latency)
    if certificate.tau < session.latency:  # then it is another session's: it covers less than the devices state
        return session.with_delay(session.latency, certificate.period_tolerance)
    return session.with_delay(certificate.tau, certificate.period_tolerance)


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
    if session.wave_links:
        if isinstance(certificate, Certificate):
            expected = "the file of its world, with those of its parts beside it"
            raise CertificateError(
                f"{session.name}: found one certificate for a session with wave links; expected {expected}"
            )
        return _prepare_parts(_settled(session), certificate, uncertified, progress)
    if certificate is not None:
        if isinstance(certificate, Certificate):
            plain = {"id": certificate.id, **content(certificate)}
            proof = _proved(certificate, plain, f"certificate {certificate.id[:16]}", session)
        else:
            proof = read_certificate(certificate, session)
        session = with_delay_of(proof, session)
    else:
        session = _settled(session)
        try:
            proof = certify(session, progress).certificate
        except DesignError as error:
            return _uncertified(session, error, uncertified)
    ladder, notes = _ladder(session, proof, progress)
    return Prepared(session, haptic_loop(session).cut, proof.blocks, proof, proof.id, ladder, notes)


def _prepare_parts(
    session: Session, certificate: Path | None, uncertified: bool, progress: Progress | None
) -> Prepared:
    """Settle each part of a session with wave links: the world, the sites, and the users in the tick.

    Args:
        session: the session, with its delay.
        certificate: the file of the world, with those of the parts beside it; None to design them.
        uncertified: as for :func:`prepare`.
        progress: called with each step of the design, as a text.

    Raises:
        CertificateError, NotCertified: as :func:`prepare`.
    """
    from manyhands.launch.plan import sites  # it makes the parts' loops with this module's functions

    if certificate is not None:
        world, parts = sites.read_parts(certificate, session)
    else:
        try:
            parts = {part.name: part.design(progress).certificate for part in sites.parts(session)}
            world = sites.world(session, progress)
        except DesignError as error:
            return _uncertified(session, error, uncertified)
    return _of_parts(session, world, parts)


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
    from manyhands.launch.plan import sites

    session = _settled(session)
    try:
        world, parts, renewed = sites.kept_parts(certificate, session, progress)
    except DesignError as error:
        raise NotCertified(f"{session.name} is not certified: {error}") from error
    return _of_parts(session, world, parts), renewed


def _of_parts(session: Session, world: World, parts: Mapping[str, Certificate]) -> Prepared:
    """The session under the certificates of its world and its parts."""
    of_parts = {
        name: block
        for part in parts.values()
        for name, block in zip(part.loop.partition.names, part.blocks, strict=True)
    }
    blocks = tuple(of_parts[name] for name in session.couplings)
    every = json.dumps([world.id, *(part.id for part in parts.values())])
    id = hashlib.sha256(every.encode()).hexdigest()
    return Prepared(session, haptic_loop(session), blocks, None, id, world=world, parts=parts)


def _uncertified(session: Session, why: DesignError, allowed: bool) -> Prepared:
    if not allowed:
        raise NotCertified(f"{session.name} is not certified: {why}") from why
    return unproved(session, why)


def _settled(session: Session) -> Session:
    """The session with the delay written out that it runs with, for its records (:func:`stated_delay`)."""
    return session.with_delay(session.latency) if session.design.tau is None else session


def _ladder(session: Session, first: Certificate, progress: Progress | None) -> tuple[Ladder | None, tuple[str, ...]]:
    """The ladder that the session asks for, with ``first`` as its rung 0, and notes on the delays that it lacks."""
    stated = session.design.ladder
    if stated == () or (stated is None and first.tau == first.loop.period):
        return None, ()
    from manyhands.design.ladder import automatic_delays, design_ladder  # the solver takes a second to import

    delays = automatic_delays(first.loop) if stated is None else stated
    return design_ladder(first, coupling_request(session), delays, progress)


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
    settled = session.as_plain() | {"colocate": session.colocated}  # the word for "as the machine needs it" is no form
    content = json.dumps(settled, sort_keys=True)
    return UNCERTIFIED + hashlib.sha256(content.encode()).hexdigest()
