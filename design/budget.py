"""The stiffest coupling that a device's damping certifies, as a function of period and delay.

With K = kappa T Delta_D^-1 and Lambda = Delta_D/(2 kappa), a spring-damper coupling (K_s, B) is certified where
J = Lambda - T K_s/2 > 0, J - B > 0 and (10) of [Bianchini2010]_ holds with (share Delta_D, Delta_V*),
Delta_V* = Lambda J^-1 (J + B) J^-1 Lambda - Lambda. As J -> 0 with B below J, Delta_V* grows without bound, and (10)
asks only for

    share(kappa, tau/T) Delta_D > Phi_E,

which no coupling can replace. So the supremum of K_s over the class, in every direction, is

    K_s < 2 Lambda/T = Delta_D/(kappa T),    kappa the least gain that leaves the share that Phi_E needs

(:mod:`manyhands.design.levels.device`). For every passive environment this is Delta_D/(lambda T/2 + 3 tau/2), with
lambda T the longest period to be covered, lambda = 1 + rho.

For comparison, the limit of [Colgate1997]_ is for one device of damping b that renders a wall H directly and passively
for every hand:

    b > sup_w T/2 / (1 - cos wT) Re{(1 - e^{-jwT}) H(e^{jwT})},    H = k e^{-jw tau}.

The right side is (T k/2) sin((T/2 + tau) w)/sin(wT/2). It is greatest as w -> 0, because sin(nx) <= n sin x for n >= 1
and 0 <= x <= pi/2:

    k < b/(T/2 + tau).

Where periods up to lambda T are to be covered, a constant period of lambda T is one of them: T is lambda T here. The
two limits meet at tau = 0.

Colgate's wall is fixed and belongs to one device. The certified coupling may be joined to any passive environment and,
through it, to any number of other users.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq

from manyhands.design.errors import Infeasible
from manyhands.design.levels.device import gain_for_share, greatest_share
from manyhands.design.levels.environment import lack_of_passivity
from manyhands.design.models.coupling import SpringDamper, realisations
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import Matrix, matrix
from manyhands.design.problem import DeviceLevel, HapticLoop
from manyhands.design.quantisation import force_of_steps, friction, steps


@dataclass(frozen=True)
class Stiffness:
    """The limits of one device's coupling at one period and delay.

    Attributes:
        T: period, s.
        tau: longest delay inside the tick, s.
        certified: supremum of the certified stiffness in the device's weakest direction, N/m; 0 if no coupling can be
            certified.
        colgate: Colgate's passivity limit in the same direction, at the longest period that is covered, N/m.
        kappa: of the gain K = kappa T Delta_D^-1 at which ``certified`` is reached; None if no coupling can be
            certified.
    """

    T: float
    tau: float
    certified: float
    colgate: float
    kappa: float | None


def stiffest(
    level: Matrix | None, T: float, tau: float, share: float = 0.0, period_tolerance: float = 0.0
) -> Stiffness:
    """The greatest stiffness of a coupling to a device of this level.

    Args:
        level: Delta_Di, m_i x m_i symmetric positive definite, N*s/m; None where nothing is left of it.
        T: period, s.
        tau: the longest delay inside the tick, s, 0 ... T.
        share: part of the devices' levels that the environment needs, :func:`needed_share`; 0 if it is passive.
        period_tolerance: rho; periods are at most (1 + rho) T; 0 ... 1.

    Raises:
        ValueError: T is not positive and finite, tau is outside 0 ... T, share negative, the tolerance outside 0 ... 1,
            or level not positive definite.
    """
    if not 0.0 < T < np.inf:
        raise ValueError(f"T: found {T!r} s; expected a finite positive period")
    if not 0.0 <= tau <= T:
        raise ValueError(f"tau: found {tau!r} s; expected 0 ... T = {T!r} s: a delay inside the tick")
    if not 0.0 <= share < np.inf:
        raise ValueError(f"share: found {share!r}; expected 0 or more")
    if level is None:
        return Stiffness(T, tau, 0.0, 0.0, None)
    least = float(np.linalg.eigvalsh(matrix(level))[0])
    if least <= 0.0:
        raise ValueError(f"level: found the eigenvalue {least:.3g}; expected a positive definite OSP level")
    # (10) is strict: at the greatest share itself no coupling remains
    left = greatest_share(tau / T, period_tolerance)
    kappa = gain_for_share(share, tau / T, period_tolerance=period_tolerance) if share < left else None
    certified = 0.0 if kappa is None else least / (kappa * T)
    return Stiffness(T, tau, certified, colgate_limit(least, (1.0 + period_tolerance) * T, tau), kappa)


def certified_limit(
    loop: HapticLoop, device: DeviceLevel, T: float, tau: float, share: float, period_tolerance: float | None = None
) -> Stiffness:
    """The greatest stiffness of a coupling to one device of a loop, at another period and delay.

    Args:
        loop: the loop; its coupling does not matter.
        device: one of its devices.
        T: period, s.
        tau: the longest delay inside the tick, s, 0 ... T.
        share: part of the devices' levels that the environment needs at this period.
        period_tolerance: rho; None for the loop's.

    Raises:
        SolverFailure: the search for the share that is needed beside held torques did not end.
        ValueError: as for :func:`stiffest`.
    """
    rho = loop.period_tolerance if period_tolerance is None else period_tolerance
    whole = loop.Delta_D_at(T, tau, rho)
    if share > 0.0 and device.held is not None:  # it is a part of what the torques leave at this delay
        share = environment_share(loop.environment, whole, T)
    level = None if whole is None else whole[np.ix_(device.ports, device.ports)]
    return stiffest(level, T, tau, min(share, 1.0), rho)  # a share of 1 or more leaves nothing


_OF_KEPT = 1e-4  # part of what is kept for the steps, to which it is found


def stiffest_below(loop: HapticLoop, speed: float) -> tuple[Stiffness, ...]:
    """The greatest stiffness of a coupling to each device, where dry friction counts as damping below a speed.

    Args:
        loop: the loop; its coupling does not matter, nor do its own ``speed`` and ``kept``.
        speed: v*, m/s: every axis is slower.

    Returns:
        By device, in the loop's order, at its own period and delay; 0 N/m where the friction does not pay for the
        steps, or nothing bounds what they take of it.

    Raises:
        SolverFailure: the search for the share that the environment needs did not end.
    """
    kept = kept_at_the_limit(loop, speed)
    if kept is not None:
        return _counting(loop, speed, kept)[0]
    free, _ = _counting(loop, speed, np.zeros(len(loop.ports)))
    return tuple(replace(limit, certified=0.0, kappa=None) for limit in free)


def kept_at_the_limit(loop: HapticLoop, speed: float) -> Matrix | None:
    """What is kept of the friction for the steps of encoders at the limits of :func:`stiffest_below`, N by port.

    It is what springs of these very limits ask for, w of :mod:`manyhands.design.quantisation`. Stiffer springs ask for
    more, and more that is kept leaves softer ones. None where the friction does not pay for any.

    Raises:
        SolverFailure: as :func:`stiffest_below`.
    """
    nothing = np.zeros(len(loop.ports))
    if not np.any(steps(loop)):
        return nothing
    asked = _asked(loop, *_counting(loop, speed, nothing))
    if asked is None:
        return None
    most = np.minimum(asked, friction(loop))

    def lacks(part: float) -> float:
        force = _asked(loop, *_counting(loop, speed, part * most))
        return np.inf if force is None else float(np.max(force - part * most))

    if lacks(1.0) > 0.0:
        return None
    part = brentq(lacks, 0.0, 1.0, xtol=_OF_KEPT) if np.any(most) else 0.0
    return np.asarray(part * most)


def _counting(loop: HapticLoop, speed: float, kept: Matrix) -> tuple[tuple[Stiffness, ...], HapticLoop]:
    """The limits with so much of the friction kept for the steps (N, by port), and the loop whose levels count it."""
    own = replace(loop, speed=speed, kept=tuple(kept.tolist()))
    share = environment_share(own.environment, own.Delta_D_at(own.period, own.tau), own.period)
    return tuple(certified_limit(own, device, own.period, own.tau, share) for device in own.devices), own


def _asked(loop: HapticLoop, limits: tuple[Stiffness, ...], own: HapticLoop) -> Matrix | None:
    """What the steps add to the forces of springs at these limits, N by port; None where it is not known."""
    kappa = limits[0].kappa  # of every device: their delay, period and share are the same
    if kappa is None:
        return np.zeros(len(loop.ports))
    springs = tuple(SpringDamper(Delta / (kappa * loop.period), 0.0 * Delta) for Delta in own.Delta_D_blocks)
    return force_of_steps(loop, realisations(springs, loop.period))


def colgate_limit(damping: float, T: float, tau: float) -> float:
    """The stiffest delayed wall that one device can render passively, b/(T/2 + tau) in N/m [Colgate1997]_.

    Args:
        damping: b of the device, N*s/m.
        T: period, s.
        tau: the delay from sample to force, s.
    """
    return damping / (T / 2.0 + tau)


@dataclass(frozen=True)
class Felt:
    """The feel of a tool over a wave link, at one round trip, beside what else could be done with that delay.

    Attributes:
        T: period of the user's site, s.
        tau: longest delay inside a tick of the site, s.
        round_trip: R, s.
        coupling: supremum of the certified stiffness of the site's coupling, N/m; 0 if none can be certified.
        felt: of that coupling in series with the wave link, 1/(1/K + R/(2 b)), N/m.
        mass: felt while the tool moves freely, b R/2, kg.
        least_mass: the least with which any linear passive link of this round trip is as stiff, felt R^2/4, kg.
        naive: Colgate's limit with the round trip inside the loop, b_D/(T/2 + tau + R), N/m.
    """

    T: float
    tau: float
    round_trip: float
    coupling: float
    felt: float
    mass: float
    least_mass: float
    naive: float


def felt_over(
    level: Matrix | None,
    T: float,
    tau: float,
    b: Matrix,
    round_trip: float,
    harvest: Matrix | None = None,
    period_tolerance: float = 0.0,
) -> Felt:
    """What is felt at most over a wave link, in its weakest direction; the mass is that of its heaviest one.

    Args:
        level: Delta_D of the site, m_i x m_i symmetric positive definite, N*s/m; None where nothing is left of it.
        T: period of the site, s.
        tau: longest delay inside its tick, s, 0 ... T.
        b: wave impedance, m_i x m_i symmetric positive definite, N*s/m.
        round_trip: R > 0, s.
        harvest: theta, m_i x m_i, N*s/m; None for 0.
        period_tolerance: rho; periods are at most (1 + rho) T; 0 ... 1.

    Raises:
        ValueError: the round trip is not positive and finite, or as for :func:`stiffest`.
    """
    if not 0.0 < round_trip < np.inf:
        raise ValueError(f"round trip: found {round_trip!r} s; expected a finite positive time")
    share = 0.0 if harvest is None or level is None else needed_share(level, harvest)
    site = stiffest(level, T, tau, share, period_tolerance)
    impedances = np.linalg.eigvalsh(b)
    felt = 0.0
    if site.certified > 0.0:
        felt = 1.0 / (1.0 / site.certified + round_trip / (2.0 * float(impedances[0])))
    least = 0.0 if level is None else float(np.linalg.eigvalsh(level)[0])
    return Felt(
        T=T,
        tau=tau,
        round_trip=round_trip,
        coupling=site.certified,
        felt=felt,
        mass=float(impedances[-1]) * round_trip / 2.0,
        least_mass=felt * round_trip**2 / 4.0,
        naive=colgate_limit(least, (1.0 + period_tolerance) * T, tau + round_trip),
    )


def needed_share(Delta_D: Matrix, Phi_E: Matrix) -> float:
    """The least s >= 0 with Phi_E <= s Delta_D: the share of the devices' levels that (10) takes.

    Args:
        Delta_D: m x m symmetric positive definite, N*s/m.
        Phi_E: m x m symmetric, N*s/m; E_hat is (-Phi_E)-ISP. Not above 0 for a passive environment.
    """
    return max(0.0, float(eigh(Phi_E, Delta_D, eigvals_only=True)[-1]))


def environment_share(environment: Environment, Delta_D: Matrix | None, T: float) -> float:
    """The least :func:`needed_share` over all admissible Phi_E; 0 for a passive environment.

    Phi_E = s Delta_D reaches it, because s Delta_D is admissible if some Phi_E <= s Delta_D is. So

        s = max_w lambda_max(-Delta_D^-1/2 He E_hat(e^jwT) Delta_D^-1/2),

    infinite for an environment that is passive at no level. For a network it is 0 by its energy, without any search.

    Args:
        environment: E.
        Delta_D: m x m, N*s/m; None where nothing is left of it: then the share is infinite.
        T: period, s.

    Raises:
        SolverFailure: the search over frequency did not end.
    """
    if environment.passive_network is not None:
        return 0.0
    if Delta_D is None:
        return float("inf")
    if environment.declared_level is not None:
        return needed_share(Delta_D, environment.declared_level)
    try:
        split = environment.split(T)
    except Infeasible:
        return float("inf")
    if np.max(np.abs(np.linalg.eigvals(split.rest.A)), initial=0.0) >= 1.0:
        return float("inf")  # a mode that does not decay: no strict inequality holds
    return max(0.0, lack_of_passivity(split, T, Delta_D).multiple)
