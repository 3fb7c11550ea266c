"""From a loop and a wish to a certificate: synthesise, certify, prove. No step trusts the step before it.

:func:`search` chooses the method by the class of couplings and by what the session asks:

| class | objective | method |
|---|---|---|
| spring-damper | feasible | one exact program a block (:mod:`manyhands.design.levels.spring_damper`), or Theorem 4 |
| spring-damper | stiffest | the same program with a different aim |
| spring-damper | loop-shaping, closed-loop | sequential convex programs (:mod:`manyhands.design.transparency.design`) |
| linear | feasible | the convex program over fixed poles, or Theorem 4 |
| linear | stiffest | the convex program over fixed poles |
| linear | loop-shaping, closed-loop | the same, inside a search of the poles |

:func:`certificate_of` then finds levels for the coupling (:mod:`manyhands.design.theorem3`), and has the draft of the
certificate proved by :mod:`manyhands.design.proof`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy.linalg import eigh

from manyhands.design.budget import kept_at_the_limit
from manyhands.design.certificate import Certificate, TransparencyClaim, content, describe_request, identity
from manyhands.design.errors import DesignError, Infeasible, SolverFailure
from manyhands.design.levels.contract import ENERGY, DeviceShare, Levels, least_coupling_level, margin
from manyhands.design.levels.device import PIECES, device_share, gain_for_share, greatest_share
from manyhands.design.levels.encoder import EncoderClaim
from manyhands.design.levels.environment import lack_of_passivity
from manyhands.design.levels.floats import within_floats
from manyhands.design.levels.orientation import require_proved
from manyhands.design.levels.spring_damper import centred, stiffest
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import CouplingBlock, SpringDamper, realisations
from manyhands.design.models.statespace import Matrix, StateSpace, symmetric_part
from manyhands.design.models.transfer import stated
from manyhands.design.models.weights import Transparency, states_of_E, weighted
from manyhands.design.passivity.hinfinity import bounded_real_storage, hinf_norm
from manyhands.design.problem import (
    CouplingRequest,
    HapticLoop,
    LinearGiven,
    LinearWanted,
    NoCoupling,
    PolePair,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.proof import Finding, ProofInputError, prove
from manyhands.design.proof.prove import of_block
from manyhands.design.proof.quantisation import BOUNDED
from manyhands.design.quantisation import KeptTooLittle, encoder_claim, force_of_steps, friction
from manyhands.design.solver import SOLVER
from manyhands.design.statics import check_block, check_environment
from manyhands.design.theorem3 import (
    MOST_SEARCHED,
    BlockLevel,
    certifies,
    certify_beside,
    certify_given,
    devices,
    nearly_too_stiff,
)
from manyhands.design.theorem4 import Interrupted, LinearCoupling, StoppedShort, design_linear, design_spring_damper
from manyhands.design.transparency import design as transparency
from manyhands.design.transparency.families import UNWEIGHTED, NormalisedLoop
from manyhands.design.transparency.pole_search import design_linear as design_linear_by_search

Progress = Callable[[str], None]

SHARE_KEPT = 0.02  # part of Delta_D: the stiffest coupling leaves this much of the device's level
LEAST_LEVEL = 1e-3  # part of Delta_D, and of the least level that (10) allows a block: the block's level is above by it
_NEED_ROOM = 1e-6  # part of Delta_D above the environment's need: a storage function has to be strict


@dataclass(frozen=True, eq=False)
class Found:
    """A coupling that the session gave or a method found; nothing about it is proved.

    Attributes:
        coupling: V's blocks, in the partition's order.
        method: the algorithm and its figures, for the certificate.
        aim: the transparency problem that the coupling was chosen by; None without one.
        history: by iteration, the quantity that the method watches.
        watched: name of that quantity.
        interrupted: whether the user ended the search early.
        device: the gain kappa that the coupling was found for, with the device's share; None if it has none.
        levels: of the blocks at that gain, if the method proves any.
    """

    coupling: tuple[CouplingBlock, ...]
    method: Mapping[str, str | int]
    aim: Transparency | None = None
    history: tuple[float, ...] = ()
    watched: str = ""
    interrupted: bool = False
    device: DeviceShare | None = None
    levels: tuple[BlockLevel, ...] = ()

    __repr__ = brief_repr


def search(loop: HapticLoop, wanted: CouplingRequest, progress: Progress | None = None) -> Found:
    """Find a coupling.

    Args:
        loop: the haptic loop.
        wanted: the class and the wish.
        progress: called with a line of text after each iteration.

    Raises:
        Infeasible: no coupling of the class satisfies the conditions.
        NotConverged: a cap was reached and nothing usable was found before.
        SolverFailure: a solver gave no usable answer.
        TooLarge: the class's program would not fit the machine.
    """
    match wanted:
        case SpringDamperWanted(wish):
            if wish.algorithm == "complementarity":
                return _complementarity(loop, wish, None, progress)
            if wish.aim is not None:
                return _transparent_springs(loop, wish.aim, progress)
            return _springs(loop, stiff=wish.objective == "stiffest", progress=progress)
        case LinearWanted(orders, wish):
            if wish.algorithm == "complementarity":
                return _complementarity(loop, wish, orders, progress)
            return _linear(loop, wanted, progress)
        case _:
            raise TypeError(f"found {type(wanted).__name__}; expected a class of couplings to search")


def _complementarity(loop: HapticLoop, wish: Wish, orders: tuple[int, ...] | None, progress: Progress | None) -> Found:
    """Theorem 4 as the paper solves it; at the cap the best iterate is returned, which the proof may still accept."""
    device = devices(loop)[0]
    kind = "Theorem 4, cone complementarity linearisation"
    watched = "||W Z - I||"
    interrupted = False
    coupling: tuple[CouplingBlock, ...]
    options: dict[str, Any] = {"kappa": device.kappa, "share": device.share, "iterations": wish.iterations}
    found: SpringDamper | LinearCoupling
    try:
        if orders is None:
            found, convergence = design_spring_damper(loop.cut, progress, **options)
        else:
            sizes = tuple(n * len(block) for n, block in zip(orders, loop.partition.blocks, strict=True))
            found, convergence = design_linear(loop.cut, sizes, progress, **options)
    except (StoppedShort, Interrupted) as error:
        if not isinstance(error.best, SpringDamper | LinearCoupling) or error.convergence is None:
            raise
        found, convergence = error.best, error.convergence
        interrupted = isinstance(error, Interrupted)
        kind += ", not converged"
    coupling = found.restrict(loop.partition) if isinstance(found, SpringDamper) else found.blocks
    method: dict[str, str | int] = {"algorithm": kind, "iterations": convergence.iterations}
    method |= tools()
    return Found(coupling, method, None, convergence.residuals, watched, interrupted, device)


def _springs(loop: HapticLoop, stiff: bool, progress: Progress | None) -> Found:
    """The spring-damper class by its exact program, block by block."""
    needed = environment_need(loop, progress)
    best: tuple[float, tuple[CouplingBlock, ...], DeviceShare] | None = None
    first: Infeasible | None = None
    for device in (gain_of_stiffest(loop, needed),) if stiff else devices(loop):
        if progress is not None:
            progress(f"spring-damper class, kappa = {device.kappa:.4g}")
        member = stiffest if stiff else centred
        try:
            members = [
                member(Delta / (2.0 * device.kappa), needed * Delta, device.part, loop.period, name)
                for name, Delta in zip(loop.partition.names, loop.Delta_D_blocks, strict=True)
            ]
        except Infeasible as error:
            first = first or error
            continue
        distance = min(m.distance for m in members) / (2.0 * device.kappa)  # in units of Delta_D
        if best is None or distance > best[0]:
            best = distance, tuple(m.coupling for m in members), device
    if best is None:
        raise first or Infeasible("no spring-damper coupling satisfies Theorem 3")
    method = {"algorithm": f"spring-damper class, {'stiffest' if stiff else 'centred'}"} | tools()
    return Found(best[1], method, device=best[2])


def environment_need(loop: HapticLoop, progress: Progress | None = None) -> float:
    """The part of Delta_D that the environment needs, dimensionless: Phi_E = need * Delta_D is admissible.

    It is 0 or less for a passive environment.

    Raises:
        Infeasible: E_hat is passive at no level.
    """
    loop = loop.cut
    environment = loop.environment
    promised = environment.promised()
    if promised is not None:
        return float(eigh(promised, loop.Delta_D, eigvals_only=True)[-1])
    network = environment.passive_network
    if network is not None and (environment.only_energy or environment.order > MOST_SEARCHED):
        return 0.0  # proved by its energy: nothing sharper is known, or is cheap to compute
    try:
        split = loop.split
        if network is not None and split.rest.order < environment.order:
            return 0.0
        found = lack_of_passivity(split, loop.period, loop.Delta_D, progress)
    except (SolverFailure, np.linalg.LinAlgError):
        if network is None:
            raise
        return 0.0  # its links are too far apart for floats, and its energy is a storage all the same
    room = _NEED_ROOM * max(abs(found.multiple), 1.0)
    return found.multiple + room


def gain_of_stiffest(loop: HapticLoop, needed: float) -> DeviceShare:
    """The least kappa whose share the environment does not use up; hence the stiffest limit, Delta_D/(kappa T).

    Raises:
        Infeasible: no kappa leaves enough.
    """
    if loop.punctual:
        return DeviceShare()
    tau_hat, rho = loop.tau / loop.period, loop.period_tolerance
    most = greatest_share(tau_hat, rho)
    wanted = SHARE_KEPT if needed <= 0.0 else (needed + most) / 2.0  # between the two, (10) keeps a margin
    kappa = gain_for_share(wanted, tau_hat, PIECES, rho) if needed < most else None
    if kappa is None:
        raise Infeasible(
            f"a delay of {loop.tau:g} s in the tick{_with_tolerance(loop)} leaves at most {most:.3g} of the devices' "
            f"level, and the environment needs {needed:.3g} of it"
        )
    kappa *= 1.0 + 1e-12  # rounding
    share = device_share(kappa, tau_hat, period_tolerance=rho)
    return DeviceShare(kappa, share.share, share.c)


def _with_tolerance(loop: HapticLoop) -> str:
    return f" with periods up to {1.0 + loop.period_tolerance:g} T" if loop.period_tolerance else ""


_version = cache(version)  # it reads the package's metadata, and a world has hundreds of designs


def tools() -> dict[str, str | int]:
    """The solver and the versions that a design was computed with, for the certificate."""
    return {"solver": SOLVER.lower(), "cvxpy": _version("cvxpy"), "numpy": np.__version__}


def _transparent_springs(loop: HapticLoop, aim: Transparency, progress: Progress | None) -> Found:
    """The spring-damper class with a transparency problem, by sequential convex programs."""
    needed = environment_need(loop, progress)
    device = gain_of_stiffest(loop, needed)
    T = loop.period
    Phi_E = max(needed, 0.0) * loop.Delta_D  # with a negative need, V_hat might be output strictly passive at no level
    E, counted = loop.split.environment(T), loop.counted if loop.series else None
    normalised = NormalisedLoop(E, loop.Delta_D, device.kappa, T, loop.partition, aim, counted)
    found = transparency.design_spring_damper(normalised, Phi_E, device.share, progress)
    method: dict[str, str | int] = {"algorithm": "spring-damper class, sequential convex programs"}
    method["iterations"] = len(found.history)
    coupling = found.coupling.restrict(loop.partition)
    return Found(coupling, method | tools(), aim, found.history, "γ", found.interrupted, device)


def _linear(loop: HapticLoop, wanted: LinearWanted, progress: Progress | None) -> Found:
    """The linear class by the convex program over fixed poles: given poles, default poles, or a search of the poles."""
    needed = environment_need(loop, progress)
    device = gain_of_stiffest(loop, needed)
    if needed >= device.share:
        raise Infeasible(
            f"no coupling satisfies Theorem 3: the environment needs {needed:.4g} of the devices' level, "
            f"expected less than {device.share:.4g} of it"
        )
    wish, T = wanted.wish, loop.period
    if wish.aim is None and loop.environment.declared_level is not None:
        E = StateSpace.static(np.zeros(loop.Delta_D.shape))  # without an aim, only the number of its ports matters
    else:
        E = loop.split.environment(loop.period)
    least = tuple(
        LEAST_LEVEL * Delta + (1.0 + LEAST_LEVEL) * least_coupling_level(device.share * Delta, max(needed, 0.0) * Delta)
        for Delta in loop.Delta_D_blocks
    )
    counted = loop.counted if loop.series else None
    normalised = NormalisedLoop(E, loop.Delta_D, device.kappa, T, loop.partition, wish.aim or UNWEIGHTED, counted)
    if wish.aim is not None and wanted.poles is None:
        found = design_linear_by_search(normalised, wanted.orders, least, progress)
        kind = "linear class over fixed poles, poles searched"
    else:
        static: Any = wish.objective if wish.aim is None else None
        poles = tuple(poles_in_z(wanted.poles or default_poles(order), T, order) for order in wanted.orders)
        found = transparency.design_fixed_poles(normalised, poles, least, progress, static)
        kind = f"linear class over fixed poles, {wish.objective}"
    method: dict[str, str | int] = {"algorithm": kind, "iterations": len(found.history)}
    levels = tuple(BlockLevel(Delta, P) for Delta, P in zip(least, found.storages, strict=True))
    return Found(found.blocks, method | tools(), wish.aim, found.history, "γ", found.interrupted, device, levels)


def default_poles(order: int) -> tuple[PolePair, ...]:
    """Well damped pairs from 1 to 30 Hz, where hands and virtual objects move; the program may leave any unused."""
    count = (order + 1) // 2
    frequencies = 2.0 * np.pi * np.geomspace(1.0, 30.0, count) if count > 1 else [2.0 * np.pi * 5.0]
    return tuple(PolePair(float(frequency), 0.7) for frequency in frequencies)


def poles_in_z(poles: tuple[PolePair, ...], T: float, order: int) -> tuple[complex, ...]:
    """The first ``order`` poles in z by backward Euler, z = 1/(1 - sT); conjugate poles are neighbours.

    An odd order ends with a real pole at the last pair's frequency.
    """
    out: list[complex] = []
    for pole in poles:
        real, imaginary = -pole.damping * pole.frequency, pole.frequency * np.sqrt(1.0 - pole.damping**2)
        z = complex(1.0 / (1.0 - complex(real, imaginary) * T))
        if len(out) + 2 <= order:
            out += [z, z.conjugate()]
        elif len(out) < order:
            out.append(complex(1.0 / (1.0 + pole.frequency * T)))
    return tuple(out)


_CLAIMED = (1e-6, 1e-5, 1e-4)  # relative distances of the claim above the norm; the first that can be proved is used


@dataclass(frozen=True, eq=False)
class Designed:
    """A proved design and how its search went.

    Attributes:
        certificate: proved and sealed.
        history: by iteration, what the method watches: ||W Z - I|| or gamma; empty for a method without iterations.
        watched: name of that quantity, for the axis of a plot.
        interrupted: whether the user ended the search, so that a better coupling may exist.
    """

    certificate: Certificate
    history: tuple[float, ...]
    watched: str
    interrupted: bool

    __repr__ = brief_repr


def design(loop: HapticLoop, wanted: CouplingRequest, progress: Progress | None = None) -> Designed:
    """Find or take a coupling, prove it, and return the proved, sealed certificate.

    Args:
        loop: the haptic loop.
        wanted: what is asked of the coupling.
        progress: called with a line of text for each step.

    Raises:
        Infeasible: no coupling of that class can be certified, or the given coupling cannot.
        NotConverged: the synthesis stopped at its cap, and its last iterate could not be certified either.
        SolverFailure: the solver's answer does not survive the proof.
        TooLarge: the class's program would not fit the machine.
        ValueError: the ports or blocks of a given coupling are not those of the loop.
    """
    with within_floats(loop.environment):
        check_environment(loop.environment, loop.turning)
        _require_orientations(loop)
        if loop.speed is not None:
            return _below_speed(loop, wanted, progress)
        return _designed(loop, wanted, progress)


def _designed(loop: HapticLoop, wanted: CouplingRequest, progress: Progress | None) -> Designed:
    found = _take(loop, wanted) or search(loop, wanted, progress)
    certificate = certificate_of(loop, wanted, found, progress)
    return Designed(certificate, found.history, found.watched, found.interrupted)


def _require_orientations(loop: HapticLoop) -> None:
    """Require of each orientation that what its device burns pays for its spring.

    Raises:
        Infeasible: it does not.
    """
    for device in loop.devices:
        if device.orientation is not None:
            require_proved(device.name, device.orientation, loop.period, loop.tau, loop.period_tolerance)


def finds_levels(loop: HapticLoop, wanted: CouplingRequest) -> bool:
    """Whether levels are found for a coupling of the class, without the proof and without its aim: quick, for a search.

    What it accepts, :func:`design` accepts but for rounding.
    """
    if isinstance(wanted, SpringDamperWanted | LinearWanted) and wanted.wish.aim is not None:
        wanted = replace(wanted, wish=Wish("feasible"))
    try:
        with within_floats(loop.environment):
            check_environment(loop.environment, loop.turning)
            _require_orientations(loop)
            if loop.speed is not None:
                _below_speed(loop, wanted, None)
                return True
            taken = _take(loop, wanted)
            found = taken or search(loop, wanted)
            _well_posed(loop, realisations(found.coupling, loop.period))
            if taken is not None:
                return certifies(loop.cut, found.coupling)
            certify_given(loop.cut, found.coupling, None, found.device, found.levels)
    except (DesignError, ValueError, np.linalg.LinAlgError):
        return False
    return True


_MOST_ROUNDS = 12
_KEPT_ABOVE = 1.02  # of what the steps add: a little more is kept, so that the next round ends
_ABOVE_LIMIT = 1.002  # of what springs at their limit ask for, likewise
_HALVINGS = 3  # of what is kept too much


def _below_speed(loop: HapticLoop, wanted: CouplingRequest, progress: Progress | None) -> Designed:
    """The design whose levels count the dry friction that the steps of encoders leave.

    What the steps add depends on the coupling, and the coupling on what is left. For springs it begins with what is
    kept at the limit of their stiffness, and a little more. Where that is not enough, and for any other coupling, it
    begins with nothing, keeps what the coupling that was found asks for, and never less again. As more is kept, levels
    sink, and with them what softer couplings ask for. So too much may be kept, and what is between it and too little
    is halved a few times, where a design is quick.

    Raises:
        Infeasible: the friction does not cover the steps of any coupling that was tried, or no round was the last.
        DesignError: as :func:`design`.
    """
    springs = isinstance(wanted, SpringDamperWanted)
    begun = _at_the_limit(loop, wanted, progress) if springs else None
    found, too_little, kept = begun or _rising(loop, wanted, progress)
    for _ in range(_HALVINGS if springs and np.any(kept > too_little) else 0):
        asked = force_of_steps(loop, found.certificate.blocks)
        if asked is not None:  # less kept leaves a stiffer coupling, which asks for more
            too_little = np.clip(asked, too_little, kept)
        middle = (too_little + kept) / 2.0
        try:
            found, kept = _designed(_keeping(loop, middle), wanted, progress), middle
        except DesignError:
            too_little = middle
    return found


_Kept = tuple[Designed, Matrix, Matrix]
"""A design, what is known to be too little kept for it, and what it keeps, N by port."""


def _at_the_limit(loop: HapticLoop, wanted: CouplingRequest, progress: Progress | None) -> _Kept | None:
    """The design that keeps what springs at their limit ask for; None where there is none."""
    at_limit = None if loop.speed is None else kept_at_the_limit(loop, loop.speed)
    if at_limit is None:
        return None
    kept = np.minimum(_ABOVE_LIMIT * at_limit, friction(loop))
    with suppress(DesignError):  # what was asked for may need less kept, or more
        return _designed(_keeping(loop, kept), wanted, progress), np.zeros(len(kept)), kept
    return None


def _rising(loop: HapticLoop, wanted: CouplingRequest, progress: Progress | None) -> _Kept:
    """The first design of rounds that keep more and more; what the round before kept was too little."""
    most, kept = friction(loop), np.zeros(len(loop.ports))
    too_little = kept
    for number in range(_MOST_ROUNDS):
        if progress is not None and number:
            progress(f"keeping dry friction for the steps of encoders, round {number + 1}")
        try:
            return _designed(_keeping(loop, kept), wanted, progress), too_little, kept
        except KeptTooLittle as error:
            more = np.maximum(kept, np.minimum(error.force * _KEPT_ABOVE, most))
            if np.all(more == kept):
                raise _uncovered(loop, error.force) from error
            too_little, kept = kept, more
    raise Infeasible(
        f"after {_MOST_ROUNDS} rounds the steps of the encoders still ask for more dry friction than was kept"
    )


def _keeping(loop: HapticLoop, kept: Matrix) -> HapticLoop:
    return replace(loop, kept=tuple(kept.tolist()))


def _uncovered(loop: HapticLoop, force: Matrix) -> Infeasible:
    """The error of a loop whose dry friction does not cover what the steps add, N by port."""
    port = int(np.argmax(force - friction(loop)))
    return Infeasible(
        f"{loop.ports[port]}: its dry friction of {1e3 * friction(loop)[port]:.4g} mN does not cover what the steps of "
        f"encoders add, {1e3 * force[port]:.4g} mN"
    )


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
        wanted: the request, which the certificate records.
        found: the coupling.
        progress: called with a line of text for each step.
        environment: levels whose Phi_E and storage are used; None searches the environment's level.

    Raises:
        DesignError: as :func:`design`.
    """
    try:
        blocks = realisations(found.coupling, loop.period)
    except ValueError as error:
        raise Infeasible(f"the coupling cannot be realised: {error}") from error
    _well_posed(loop, blocks)
    if environment is None:
        levels = certify_given(loop.cut, found.coupling, progress, found.device, found.levels)
    else:
        levels = certify_beside(loop.cut, found.coupling, environment, found.device)
    *tighter, last = _CLAIMED if found.aim is not None else _CLAIMED[:1]
    for above in tighter:
        with suppress(SolverFailure):  # the next claim is less tight and leaves its storage function more room
            return _proved(loop, found, wanted, levels, above, progress)
    try:
        return _proved(loop, found, wanted, levels, last, progress)
    except SolverFailure:
        # A level of a network whose links are far apart is often lost in rounding. Phi_E = 0 with the energy needs no
        # arithmetic, and leaves (10) blockdiag(share Delta_D, Delta_V).
        if loop.cut.environment.passive_network is None or environment is not None or not np.any(levels.Phi_E):
            raise
        plain = replace(levels, Phi_E=np.zeros_like(levels.Phi_E), P_E=ENERGY)
        return _proved(loop, found, wanted, plain, last, progress)


def _proved(
    loop: HapticLoop,
    found: Found,
    wanted: CouplingRequest,
    levels: Levels,
    above: float,
    progress: Progress | None,
) -> Certificate:
    """The certificate with these levels and a claim on transparency, gamma = (1 + above) times the norm; proved."""
    claim = None if found.aim is None else _transparency(loop, found.coupling, found.aim, above)
    asked = describe_request(wanted, loop.partition.names)
    draft = Certificate(loop, found.coupling, levels, claim, {}, found.method, asked)
    of_environment = loop.environment.margins(lambda: _compliance(loop, draft.blocks))
    encoder = encoder_claim(loop, draft.blocks)
    draft = replace(draft, margins={"(10)": margin(loop.partition, levels), **of_environment}, encoder=encoder)
    if progress is not None:
        progress("proving the certificate")
    draft, failing = _tried(draft)
    if encoder is not None and loop.speed is None and [finding.condition for finding in failing] == [BOUNDED]:
        # the responses decay too slowly to be summed: a certificate that says so is better than none
        draft, failing = _tried(replace(draft, encoder=EncoderClaim(None, False)))
    if failing:
        conditions = {finding.condition for finding in failing}
        broken = {name for name in loop.partition.names if of_block(name) in conditions}
        if error := nearly_too_stiff(loop.cut, found.coupling, levels.device.kappa, broken):
            raise error
        worst = failing[0]
        figure = "" if np.isnan(worst.value) else f": found {worst.value:.3g}, bound {worst.bound:.3g}"
        because = f" ({worst.argument})" if worst.argument else ""
        raise SolverFailure(f"the solver's answer does not survive the proof: {worst.condition}{figure}{because}")
    return draft


def _tried(draft: Certificate) -> tuple[Certificate, list[Finding]]:
    """The draft with its id, and the findings of its proof that fail."""
    data = content(draft)
    data["id"] = identity(data)
    try:
        failing = [finding for finding in prove(data) if not finding.holds]
    except ProofInputError as error:
        raise SolverFailure(f"the certificate cannot be proved: {error}") from error
    return replace(draft, id=data["id"]), failing


def _compliance(loop: HapticLoop, blocks: tuple[StateSpace, ...]) -> Matrix:
    """V(1), m x m, m/N."""
    return loop.partition.embed([symmetric_part(block.response(1.0).real) for block in blocks])


def _take(loop: HapticLoop, wanted: CouplingRequest) -> Found | None:
    """The coupling that the session gives; None if the session asks for a search."""
    match wanted:
        case NoCoupling():
            raise Infeasible(
                "there is no coupling: f_v = -E x leaves V_hat = -(z-1)/(Tz) K, output strictly passive at no level"
            )
        case LinearGiven(blocks, aim):
            found = [(block.outputs, block.inputs) for block in blocks]
            sizes = [(len(ports), len(ports)) for ports in loop.partition.blocks]
            if found != sizes:
                raise ValueError(f"found blocks of V with {found} outputs and inputs; expected {sizes}")
            for name, block, ports in zip(loop.partition.names, blocks, loop.partition.blocks, strict=True):
                check_block(name, block, tuple(loop.ports[port] for port in ports), loop.turning)
            return Found(blocks, {"algorithm": "given"}, aim)
        case SpringDamperGiven(coupling, aim):
            m = len(loop.ports)
            if coupling.stiffness.shape != (m, m):
                raise ValueError(f"found a coupling of {len(coupling.stiffness)} ports; expected {m}")
            return Found(coupling.restrict(loop.partition), {"algorithm": "given"}, aim)
    return None


def _well_posed(loop: HapticLoop, blocks: tuple[StateSpace, ...]) -> None:
    """Refuse a coupling with which the algebraic loop of D_E and D_V has no unique solution in a tick.

    The solution is unique where V_hat is output strictly passive, so that D_V + D_V^T >= 2 K > 0, and where
    D_E = D_E^T >= 0, as for every network. A declared model is evaluated ahead of the tick; the force that a
    passivity controller computes from its answer is unique wherever D_V + D_V^T > 0.
    """
    if loop.environment.passive_network is not None or loop.environment.declared_level is not None:
        return
    D_E = loop.environment.environment(loop.period).D
    D_V = loop.partition.embed([block.D for block in blocks])
    if not np.linalg.cond(np.eye(len(loop.ports)) + D_E @ D_V) < 1e12:
        raise Infeasible(
            "I + D_E D_V is singular: force and tool position have no unique solution in a tick; expected another "
            "direct feedthrough D of the coupling"
        )


def _transparency(
    loop: HapticLoop, coupling: tuple[CouplingBlock, ...], aim: Transparency, above: float
) -> TransparencyClaim:
    """The weighted norm that the coupling reaches, and a storage function that proves it."""
    V = loop.without_counted(loop.partition.join(realisations(coupling, loop.period)))
    E = loop.split.environment(loop.period)
    system = weighted(E, V, aim)
    norm, _ = hinf_norm(system, loop.period)
    gamma = norm * (1.0 + above)
    P = bounded_real_storage(system, gamma)
    if loop.split.units is None:
        return TransparencyClaim(aim, gamma, P)
    units = np.ones(system.order)
    for start in states_of_E(E, V, aim):
        units[start : start + len(loop.split.units)] = loop.split.units
    return TransparencyClaim(aim, gamma, stated(P, units))
