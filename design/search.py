"""Finding a coupling by a wish: which method answers which question.

| class | objective | method |
|---|---|---|
| spring-damper | feasible | one exact program a block (:mod:`manyhands.design.spring_damper`), or Theorem 4 |
| spring-damper | stiffest | the same program with another aim |
| spring-damper | loop-shaping, closed-loop | sequential convex programs (:mod:`manyhands.design.transparency`) |
| linear | feasible | the convex program over fixed poles, or Theorem 4 |
| linear | stiffest | the convex program over fixed poles |
| linear | loop-shaping, closed-loop | the same, with a search of the poles around it |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import cvxpy
import numpy as np
from scipy.linalg import eigh

from manyhands.design import transparency
from manyhands.design.complementarity import Interrupted, StoppedShort
from manyhands.design.contract import DeviceShare, least_coupling_level
from manyhands.design.coupling import CouplingBlock, SpringDamper
from manyhands.design.declared import DeclaredEnvironment
from manyhands.design.delay import PIECES, device_share, gain_for_share, greatest_share
from manyhands.design.environment import NetworkBox
from manyhands.design.environment_level import lack_of_passivity
from manyhands.design.errors import Infeasible
from manyhands.design.frame import UNWEIGHTED, NormalisedLoop
from manyhands.design.pole_search import design_linear as design_linear_by_search
from manyhands.design.problem import CouplingRequest, HapticLoop, LinearWanted, Pole, SpringDamperWanted, Wish
from manyhands.design.solver import SOLVER
from manyhands.design.spring_damper import centred, stiffest
from manyhands.design.statespace import StateSpace
from manyhands.design.theorem3 import MOST_SEARCHED, devices
from manyhands.design.theorem3_program import BlockLevel
from manyhands.design.theorem4 import design_spring_damper
from manyhands.design.theorem4_linear import LinearCoupling, design_linear
from manyhands.design.weighted_loop import Transparency

Progress = Callable[[str], None]

SHARE_KEPT = 0.02  # of Delta_D: what the stiffest coupling leaves of the device's level
LEAST_LEVEL = 1e-3  # of Delta_D, and of what (10) asks of a block: how far the block's level is above that
_NEED_ROOM = 1e-6  # of Delta_D, above what the environment needs: a storage function has to be strict


@dataclass(frozen=True, eq=False)
class Found:
    """A coupling that somebody gave or a method found; nothing about it is proved.

    Attributes:
        coupling: V's blocks, in the partition's order.
        method: the algorithm and its figures, for the certificate.
        aim: the transparency problem that it was chosen by.
        history: by iteration, what the method watches.
        watched: what that is.
        interrupted: whether the search was ended before its time.
        device: the gain kappa that it was found for.
        levels: of the blocks at that gain, where the method proves some.
    """

    coupling: tuple[CouplingBlock, ...]
    method: Mapping[str, str | int]
    aim: Transparency | None = None
    history: tuple[float, ...] = ()
    watched: str = ""
    interrupted: bool = False
    device: DeviceShare | None = None
    levels: tuple[BlockLevel, ...] = ()


def search(loop: HapticLoop, wanted: CouplingRequest, progress: Progress | None = None) -> Found:
    """Find a coupling.

    Args:
        loop: the haptic loop.
        wanted: the class and the wish.
        progress: told about iterations.

    Raises:
        Infeasible: the class is empty.
        NotConverged: a cap was reached and nothing usable was found on the way.
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
            raise TypeError(f"expected a class of couplings to search, found {type(wanted).__name__}")


def _complementarity(loop: HapticLoop, wish: Wish, orders: tuple[int, ...] | None, progress: Progress | None) -> Found:
    """Theorem 4 as the paper solves it. Where the cap is reached, the best iterate may be certified all the same."""
    device = devices(loop)[0]
    kind = "Theorem 4, cone complementarity linearisation"
    watched = "||W Z - I||"
    interrupted = False
    coupling: tuple[CouplingBlock, ...]
    options: dict[str, Any] = {"kappa": device.kappa, "share": device.share, "iterations": wish.iterations}
    found: SpringDamper | LinearCoupling
    try:
        if orders is None:
            found, convergence = design_spring_damper(loop, progress, **options)
        else:
            sizes = tuple(n * len(block) for n, block in zip(orders, loop.partition.blocks, strict=True))
            found, convergence = design_linear(loop, sizes, progress, **options)
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
        raise first or Infeasible("no spring-damper coupling satisfies Theorem 3", ())
    method = {"algorithm": f"spring-damper class, {'stiffest' if stiff else 'centred'}"} | tools()
    return Found(best[1], method, device=best[2])


def environment_need(loop: HapticLoop, progress: Progress | None = None) -> float:
    """The part of Delta_D that the environment needs: Phi_E = need * Delta_D is admissible.

    0 or less for a passive environment.

    Raises:
        Infeasible: E_hat is passive at no level.
    """
    environment = loop.environment
    if isinstance(environment, DeclaredEnvironment):
        return float(eigh(environment.promised(), loop.Delta_D, eigvals_only=True)[-1])
    network = environment.passive_network
    if network is not None and (isinstance(environment, NetworkBox) or environment.order > MOST_SEARCHED):
        return 0.0  # its energy: no more is known, or cheap to know
    split = loop.split
    if network is not None and split.rest.order < environment.order:
        return 0.0
    found = lack_of_passivity(split, loop.period, loop.Delta_D, progress)
    room = _NEED_ROOM * max(abs(found.multiple), 1.0)
    return found.multiple + room


def gain_of_stiffest(loop: HapticLoop, needed: float) -> DeviceShare:
    """The least kappa, hence the stiffest limit Delta_D/(kappa T), whose share the environment does not use up.

    Raises:
        Infeasible: no kappa leaves enough.
    """
    if loop.tau == 0.0:
        return DeviceShare()
    tau_hat = loop.tau / loop.period
    most = greatest_share(tau_hat)
    wanted = SHARE_KEPT if needed <= 0.0 else (needed + most) / 2.0  # (10) has the room between the two
    kappa = gain_for_share(wanted, tau_hat, PIECES) if needed < most else None
    if kappa is None:
        raise Infeasible(
            f"a delay of {loop.tau:g} s in the tick leaves at most {most:.3g} of the devices' "
            f"level, and the environment needs {needed:.3g} of it",
            ("shorten the delay", "use devices with more damping (a greater osp)", "soften the environment"),
        )
    kappa *= 1.0 + 1e-12  # rounding
    share = device_share(kappa, tau_hat)
    return DeviceShare(kappa, share.share, share.c)


def tools() -> dict[str, str | int]:
    """What a design was computed with, for the certificate."""
    return {"solver": SOLVER.lower(), "cvxpy": cvxpy.__version__, "numpy": np.__version__}


def _transparent_springs(loop: HapticLoop, aim: Transparency, progress: Progress | None) -> Found:
    """Springs and dampers by sequential convex programs."""
    needed = environment_need(loop, progress)
    device = gain_of_stiffest(loop, needed)
    T = loop.period
    Phi_E = max(needed, 0.0) * loop.Delta_D  # with less, V_hat might be output strictly passive at no level
    normalised = NormalisedLoop(loop.split.environment(T), loop.Delta_D, device.kappa, T, loop.partition, aim)
    found = transparency.design_spring_damper(normalised, Phi_E, device.share, progress)
    method: dict[str, str | int] = {"algorithm": "spring-damper class, sequential convex programs"}
    method["iterations"] = len(found.history)
    coupling = found.coupling.restrict(loop.partition)
    return Found(coupling, method | tools(), aim, found.history, "γ", found.interrupted, device)


def _linear(loop: HapticLoop, wanted: LinearWanted, progress: Progress | None) -> Found:
    """Linear couplings by the convex program over poles: given ones, or a search around it."""
    needed = environment_need(loop, progress)
    device = gain_of_stiffest(loop, needed)
    if needed >= device.share:
        raise Infeasible(
            f"no coupling satisfies Theorem 3, for the environment needs {needed:.4g} of the devices' level, and "
            f"{device.share:.4g} is there",
            ("use devices with more damping (a greater osp)", "shorten the period", "soften the environment"),
        )
    wish, T = wanted.wish, loop.period
    if wish.aim is None and isinstance(loop.environment, DeclaredEnvironment):
        E = StateSpace.static(np.zeros(loop.Delta_D.shape))  # without an aim, nothing is asked of it but its ports
    else:
        E = loop.split.environment(loop.period)
    least = tuple(
        LEAST_LEVEL * Delta + (1.0 + LEAST_LEVEL) * least_coupling_level(device.share * Delta, max(needed, 0.0) * Delta)
        for Delta in loop.Delta_D_blocks
    )
    normalised = NormalisedLoop(E, loop.Delta_D, device.kappa, T, loop.partition, wish.aim or UNWEIGHTED)
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


def default_poles(order: int) -> tuple[Pole, ...]:
    """Well damped pairs from 1 to 30 Hz, where hands and virtual objects move; what is not used costs nothing."""
    count = (order + 1) // 2
    frequencies = 2.0 * np.pi * np.geomspace(1.0, 30.0, count) if count > 1 else [2.0 * np.pi * 5.0]
    return tuple(Pole(float(frequency), 0.7) for frequency in frequencies)


def poles_in_z(poles: tuple[Pole, ...], T: float, order: int) -> tuple[complex, ...]:
    """The first ``order`` poles in z by backward Euler, z = 1/(1 - sT), conjugates one after the other.

    An odd order ends with the real pole of the last pair's frequency.
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
