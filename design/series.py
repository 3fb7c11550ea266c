"""Which part of the world's own compliance is counted in series with the coupling, port by port.

**A network.** Where one spring and damper k + b s joins port i to a mass or to ground, it is in series with the
coupling. So the loop may be cut inside that link: its compliance 1/(k + b s) is the sum of a part p/(k + b s), which
joins the coupling, and of (1 - p)/(k + b s), a link stiffer by 1/(1 - p) that stays in the world. Theorem 3 then
applies to the pair

    V + C,   C = diag(p_i/(k_i + b_i s)),        and        E', the world with the stiffer links,

and the same pair is run. docs/decisions/0045-series-compliance.md has the proof. For every aim of a design more is
better: E' is a network, hence passive whatever p is, and the couplings V + C that (10) admits do not depend on p,
except through a Phi_E' < 0, which only adds to the margin. So p is the greatest that two limits allow:

- ``most`` < 1: p = 1 would leave a link of infinite stiffness;
- p/k <= 0.9 times the least compliance kappa T/Delta_D that V + C can have, so that V itself keeps a tenth of it. A
  world that is softer than the coupling's limit would otherwise leave V a negative compliance.

**A state space or rational functions** have no links. There C = diag(c_i) are plain springs, and

    E' = E (I - C E)^-1

has the states of E. On the unit circle Re Tz/(z-1) = T/2. So the congruence of He E'_hat with I - C E is the first of

    He E_hat >= (T/2) E* C E at every angle,        E(1) >= E(1) C E(1) at rest.

Where both hold, E'_hat is passive, and E' is stable for every s C with 0 <= s < 1: (s C E) v = v, v != 0, at a point of
the circle would need s >= 1. Both are linear in C, and with C they hold for every smaller C. So a convex program finds
the greatest C: the one with the greatest product of the c_i, each at most 0.9 kappa T/Delta_D. It is unique, and no c_i
of it can grow alone. The program has the inequalities of some angles. The test of E' at all frequencies, without a
grid, accepts its solution or gives one angle more.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.levels.contract import NO_DELAY_GAIN
from manyhands.design.levels.device import least_gain
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import Matrix, frequency_response
from manyhands.design.problem import HapticLoop

MOST = 0.999
"""The greatest part that is counted by default: what is left of a network's link is a thousand times as stiff."""
_DIGITS = 1000  # parts are whole thousandths: the same decimals on every machine
_KEPT = 0.9  # of the coupling's least compliance
_LEAST = 1e-3  # of the limit: a compliance below it is not worth a certificate of its own form
_FIGURES = 4  # of a compliance: the same decimals on every machine
_ROUNDING = 1e-6  # relative: of a compliance that four figures hold exactly, rounding does not take the last one
_PASSIVE = 1e-9  # of the devices' level: a lack of passivity below it is rounding
_SINGULAR = 1e-12  # relative: added to He E_hat before it is inverted
_CENTRED = 1e-2  # Newton's decrement
_MOST_STEPS = 60  # of Newton's method for a weight; most need less than ten
_GAP = 1e-6  # of the logarithm of the product
_STEP = 5.0  # from one weight of the product to the next
_MOST_CUTS = 60  # angles that are added; most worlds need less than five


def counted_parts(loop: HapticLoop, most: float = MOST) -> tuple[float, ...]:
    """What is counted at each port, as :attr:`.HapticLoop.series` has it; empty if nothing is.

    Args:
        loop: the loop; its ``series`` does not matter.
        most: the greatest part, more than 0 and less than 1: of the compliance of a network's links, or of the greatest
            C that leaves a state space or rational functions passive.
    """
    environment = loop.environment
    kappa = NO_DELAY_GAIN if loop.punctual else least_gain(loop.tau / loop.period, loop.period_tolerance)
    limits = np.zeros(len(loop.ports))
    for ports, gain in zip(loop.partition.blocks, loop.loop_gain(kappa), strict=True):
        limits[list(ports)] = _KEPT * float(np.linalg.eigvalsh(gain)[0])
    out = [0.0] * len(loop.ports)
    if environment.counts == "part":
        contacts = environment.contacts()
        for i, port in enumerate(loop.ports):
            if port in contacts:
                out[i] = math.floor(_DIGITS * min(most, contacts[port].stiffness * float(limits[i]))) / _DIGITS
    elif environment.counts == "compliance":
        found = most * _greatest_compliance(environment, loop.period, limits, loop.Delta_D)
        out = [_rounded_down(float(c)) if c > _LEAST * limit else 0.0 for c, limit in zip(found, limits, strict=True)]
    return tuple(out) if any(out) else ()


def _rounded_down(value: float) -> float:
    """The greatest number of four decimal figures that is not above ``value``, up to rounding."""
    exponent = math.floor(math.log10(value)) + 1 - _FIGURES
    return float(f"{math.floor(value * (1.0 + _ROUNDING) / 10.0**exponent)}e{exponent}")


def _greatest_compliance(environment: Environment, T: float, limits: Matrix, Delta_D: Matrix) -> Matrix:
    """The greatest diagonal of C, m/N, of which :data:`MOST` leaves E' passive; zeros if E itself is not passive.

    Args:
        environment: E.
        T: period, s.
        limits: the most that is useful at each port, m/N.
        Delta_D: the devices' level, in units of which a lack of passivity is measured.
    """
    from manyhands.design.levels.environment import Dissipation, lack_of_passivity  # with scipy, which is slow to load

    nothing = np.zeros(len(limits))
    try:
        split = environment.split(T)
        dissipation = Dissipation(split, T)
    except (Infeasible, SolverFailure):
        return nothing  # the design refuses this world, with the reason
    E = environment.environment(T)
    angles = dissipation.angles().tolist()
    H = [T / 2.0 * split.stiffness.astype(complex), *map(dissipation, angles)]
    E_z = [split.stiffness.astype(complex), *frequency_response(E, np.array(angles))]
    for _ in range(_MOST_CUTS):
        try:
            greatest = _greatest_at(np.array(H), np.array(E_z), T, limits)
            left = environment.stiffened(dict(zip(environment.ports, (MOST * greatest).tolist(), strict=True)))
            poles = np.linalg.eigvals(left.environment(T).A)
        except (Infeasible, np.linalg.LinAlgError):  # E itself is not passive at one of the angles
            return nothing
        try:
            lacking = lack_of_passivity(left.split(T), T, Delta_D)
        except (Infeasible, SolverFailure):  # E' has a pole outside: the circle is crossed at its angle
            worst = float(np.abs(np.angle(poles[np.argmax(np.abs(poles))]))) if len(poles) else 0.0
        else:
            if lacking.multiple <= _PASSIVE:
                return greatest
            worst = lacking.frequency * T
        if worst in angles:
            break
        angles.append(worst)
        H.append(dissipation(worst))
        E_z.append(E.response(np.exp(1j * worst)))
    return nothing


def _greatest_at(H: NDArray[np.complex128], E: NDArray[np.complex128], T: float, limits: Matrix) -> Matrix:
    """The C <= diag(limits) with the greatest product of its entries that keeps H >= (T/2) E* C E at every angle.

    By Newton's method on the logarithmic barrier. Its derivatives are the sums of X_ii and of |X_ij|^2 over the angles,
    for X = (T/2) E (H - (T/2) E* C E)^-1 E*.

    Args:
        H: He E_hat by angle, angles x m x m.
        E: E by angle, angles x m x m.
        T: period, s.
        limits: of each port, m/N.

    Returns:
        The diagonal of C, m/N; zeros if no part of the limits is possible.

    Raises:
        LinAlgError: H >= 0 fails at an angle.
    """
    E = np.sqrt(T / 2.0 * limits)[:, np.newaxis] * E  # C in parts of the limits
    adjoint = np.conj(np.swapaxes(E, 1, 2))
    scale = np.max(np.abs(np.diagonal(H, axis1=1, axis2=2)), axis=0)
    H = H + np.diag(_SINGULAR * np.where(scale > 0.0, scale, 1.0))  # where a direction of H is 0, that of E is too
    np.linalg.cholesky(H)  # for its error

    def answers(parts: Matrix) -> NDArray[np.complex128]:
        X = E @ np.linalg.solve(H - adjoint @ (parts[:, np.newaxis] * E), adjoint)
        return np.asarray((X + np.conj(np.swapaxes(X, 1, 2))) / 2.0)

    m = len(limits)
    together = 1.0 / max(float(np.max(np.linalg.eigvalsh(answers(np.zeros(m))))), 1.0)
    if together < _LEAST**2:
        return np.zeros(m)
    parts, weight = np.full(m, together / 2.0), 1.0
    while True:
        for _ in range(_MOST_STEPS):
            X = answers(parts)
            slope = 1.0 / (1.0 - parts) - weight / parts + np.sum(np.diagonal(X, axis1=1, axis2=2).real, axis=0)
            curvature = np.diag(weight / parts**2 + 1.0 / (1.0 - parts) ** 2) + np.sum(np.abs(X) ** 2, axis=0)
            step = -np.linalg.solve(curvature, slope)
            decrement = math.sqrt(max(-float(slope @ step), 0.0))
            parts = parts + step / (1.0 + decrement)  # inside, because the barrier is self-concordant
            if not decrement > _CENTRED:
                break
        if not np.all((parts > 0.0) & (parts < 1.0)):  # which only rounding could cause
            return np.zeros(m)
        if (len(H) + 1) * m / weight < _GAP:  # the product's logarithm is within it of the greatest
            return np.asarray(parts * limits)
        weight *= _STEP
