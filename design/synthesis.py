"""From a loop and a wish to a certificate: synthesise, certify, prove, each distrusting the one before."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from manyhands.design.certificate import Certificate, TransparencyClaim, content, identity
from manyhands.design.certificate_parts import describe_request
from manyhands.design.contract import Levels, margin
from manyhands.design.coupling import CouplingBlock, realisations
from manyhands.design.declared import DeclaredEnvironment
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.hinfinity import bounded_real_storage, hinf_norm
from manyhands.design.problem import CouplingRequest, HapticLoop, LinearGiven, NoCoupling, SpringDamperGiven
from manyhands.design.proof import ProofInputError, prove
from manyhands.design.search import Found, search
from manyhands.design.statespace import StateSpace
from manyhands.design.statics import check_block, check_environment
from manyhands.design.theorem3 import certify_beside, certify_given
from manyhands.design.weighted_loop import Transparency, weighted

Progress = Callable[[str], None]

_CLAIMED = (1e-6, 1e-5, 1e-4)  # relative, above the norm found, the first that is proved


@dataclass(frozen=True, eq=False)
class Designed:
    """A design with the way it took.

    Attributes:
        certificate: verified and sealed.
        history: by iteration, what the method watches: ||W Z - I|| or gamma; empty for a method without iterations.
        watched: what that is, with its unit, for the axis of a picture.
        interrupted: whether somebody ended the search, so that a better coupling may exist.
    """

    certificate: Certificate
    history: tuple[float, ...]
    watched: str
    interrupted: bool


def design(loop: HapticLoop, wanted: CouplingRequest, progress: Progress | None = None) -> Designed:
    """Find or take a coupling, prove it, and return the proved, sealed certificate.

    Args:
        loop: the haptic loop.
        wanted: what is asked of the coupling.
        progress: told what is being done.

    Raises:
        Infeasible: no coupling of that class, or not the given one, can be certified.
        NotConverged: the synthesis stopped at its cap, and its last iterate could not be certified either.
        SolverFailure: the solver's answer does not survive the proof.
        TooLarge: the class's program would not fit the machine.
        ValueError: a given coupling has not the loop's ports or blocks.
    """
    check_environment(loop.environment)
    found = _take(loop, wanted) or search(loop, wanted, progress)
    certificate = certificate_of(loop, wanted, found, progress)
    return Designed(certificate, found.history, found.watched, found.interrupted)


def certificate_of(
    loop: HapticLoop,
    wanted: CouplingRequest,
    found: Found,
    progress: Progress | None = None,
    environment: Levels | None = None,
) -> Certificate:
    """Certify a coupling and prove the certificate.

    Args:
        loop: the haptic loop.
        wanted: what was asked of the coupling, for the record.
        found: the coupling.
        progress: told what is being done.
        environment: levels whose Phi_E and storage are to be used instead of looking for better ones.

    Raises:
        DesignError: as :func:`design`.
    """
    try:
        blocks = realisations(found.coupling, loop.period)
    except ValueError as error:
        raise Infeasible(f"the coupling cannot be realised: {error}", ("make K and B positive definite",)) from error
    _well_posed(loop, blocks)
    if environment is None:
        levels = certify_given(loop, found.coupling, progress, found.device, found.levels)
    else:
        levels = certify_beside(loop, found.coupling, environment, found.device)
    *tighter, last = _CLAIMED if found.aim is not None else _CLAIMED[:1]
    for above in tighter:
        with suppress(SolverFailure):  # a claim that is less tight leaves its storage function more room
            return _proved(loop, found, wanted, levels, above, progress)
    return _proved(loop, found, wanted, levels, last, progress)


def _proved(
    loop: HapticLoop,
    found: Found,
    wanted: CouplingRequest,
    levels: Levels,
    above: float,
    progress: Progress | None,
) -> Certificate:
    """The certificate with these levels, and a claim on transparency that is the part ``above`` above the norm."""
    claim = None if found.aim is None else _transparency(loop, found.coupling, found.aim, above)
    asked = describe_request(wanted, loop.partition.names)
    draft = Certificate(loop, found.coupling, levels, claim, {}, found.method, asked)
    draft = replace(draft, margins={"(10)": margin(loop.partition, levels)})
    data = content(draft)
    data["id"] = identity(data)
    if progress is not None:
        progress("proving the certificate")
    try:
        failing = [finding for finding in prove(data) if not finding.holds]
    except ProofInputError as error:
        raise SolverFailure(f"the certificate cannot be proved: {error}") from error
    if failing:
        worst = failing[0]
        figure = "" if np.isnan(worst.value) else f": found {worst.value:.3g}, bound {worst.bound:.3g}"
        because = f" ({worst.argument})" if worst.argument else ""
        raise SolverFailure(f"the solver's answer does not survive the proof: {worst.condition}{figure}{because}")
    return replace(draft, id=data["id"])


def _take(loop: HapticLoop, wanted: CouplingRequest) -> Found | None:
    """The coupling that the session gives, None where one is to be found."""
    match wanted:
        case NoCoupling():
            raise Infeasible(
                "there is no coupling: f_v = -E x leaves V_hat = -(z-1)/(Tz) K, output strictly passive at no level",
                ("use 'design: {coupling: spring-damper}'",),
            )
        case LinearGiven(blocks, aim):
            found = [(block.outputs, block.inputs) for block in blocks]
            sizes = [(len(ports), len(ports)) for ports in loop.partition.blocks]
            if found != sizes:
                raise ValueError(f"expected blocks of V with {sizes} outputs and inputs, found {found}")
            for name, block, ports in zip(loop.partition.names, blocks, loop.partition.blocks, strict=True):
                check_block(name, block, tuple(loop.ports[port] for port in ports))
            return Found(blocks, {"algorithm": "given"}, aim)
        case SpringDamperGiven(coupling, aim):
            m = len(loop.ports)
            if coupling.stiffness.shape != (m, m):
                raise ValueError(f"expected a coupling of {m} ports, found {len(coupling.stiffness)}")
            return Found(coupling.restrict(loop.partition), {"algorithm": "given"}, aim)
    return None


def _well_posed(loop: HapticLoop, blocks: tuple[StateSpace, ...]) -> None:
    """The algebraic loop of D_E and D_V has one solution a tick.

    Always so where V_hat is output strictly passive, D_V + D_V^T >= 2 K > 0, and D_E = D_E^T >= 0, as a network's is. A
    model is asked ahead of the tick, and what a controller makes of its answer is unique wherever D_V + D_V^T > 0.
    """
    if loop.environment.passive_network is not None or isinstance(loop.environment, DeclaredEnvironment):
        return
    D_E = loop.environment.environment(loop.period).D
    D_V = loop.partition.embed([block.D for block in blocks])
    if not np.linalg.cond(np.eye(len(loop.ports)) + D_E @ D_V) < 1e12:
        raise Infeasible(
            "I + D_E D_V is singular: force and tool position have no unique solution in a tick",
            ("change the coupling's direct feedthrough D",),
        )


def _transparency(
    loop: HapticLoop, coupling: tuple[CouplingBlock, ...], aim: Transparency, above: float
) -> TransparencyClaim:
    """The weighted norm that the coupling reaches, and a storage function that proves it."""
    V = loop.partition.join(realisations(coupling, loop.period))
    system = weighted(loop.split.environment(loop.period), V, aim)
    norm, _ = hinf_norm(system, loop.period)
    gamma = norm * (1.0 + above)
    return TransparencyClaim(aim, gamma, bounded_real_storage(system, gamma))
