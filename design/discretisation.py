"""From continuous to discrete environments, and what each way does to passivity.

An environment E maps displacement to force; what the loop needs to be passive is E_hat = Tz/(z-1) E, the map from
the backward-difference velocity.

- *Backward Euler*, s = (z-1)/(Tz), maps E(s)/s, the impedance from velocity, to E_hat itself, and the right half
  plane to the outside of a disc inside the unit disc: a passive E(s)/s gives a passive E_hat, with damping to spare.
  It also takes improper entries, k + b s + M s^2.
- *Tustin*, s = 2(z-1)/(T(z+1)), keeps the passivity of E(s)/s when that is paired with the trapezoidal velocity, not
  with the backward difference: E_hat gains the factor 2z/(z+1). A spring stays passive, a damper keeps a pole at
  z = -1 and a mass a double one, so that what is not proper is refused, and what is proper can lose passivity near the
  Nyquist frequency.
- *Zero-order hold* is exact at the ticks for a displacement that is held. E_hat is then T times the sampled impulse
  response of the impedance E(s)/s: its Hermitian part is the sum of that of E(s)/s over all frequencies that sampling
  makes one, and half the first sample. What is passive and proper stays passive.

What was kept or lost is not assumed but computed: Phi_E is searched for whatever E results.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.operators import Rational, companion_forms
from manyhands.design.statespace import Matrix, StateSpace

Method = Literal["backward-euler", "tustin", "zoh"]
METHODS: tuple[Method, ...] = ("backward-euler", "tustin", "zoh")
_SINGULAR = 1e12  # condition above which a discretisation does not exist


def discretise(system: StateSpace, method: Method, T: float) -> StateSpace:
    """The discrete system of a continuous one (A, B, C, D) for the period T (s).

    Backward Euler: with R = (I - T A)^{-1}, (R, T R B, C R, D + T C R B) in the state of the tick before.
    Tustin: with R = (I - T A/2)^{-1}, (R (I + T A/2), T R B, C R, D + T/2 C R B).

    Raises:
        Infeasible: the method's matrix is singular for this period.
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    n = system.order
    if method == "zoh":
        from manyhands.design.device import zero_order_hold  # scipy is slow to import, and only this method needs it

        return zero_order_hold(system, T)
    step = T if method == "backward-euler" else T / 2.0
    if n and not np.linalg.cond(np.eye(n) - step * A) < _SINGULAR:
        raise Infeasible(f"{method}: I - {step:g} A is singular", ("change the period, or the method",))
    R: Matrix = np.asarray(np.linalg.inv(np.eye(n) - step * A), dtype=np.float64)
    if method == "backward-euler":
        return StateSpace(R, T * R @ B, C @ R, D + T * C @ R @ B)
    return StateSpace(R @ (np.eye(n) + step * A), T * R @ B, C @ R, D + step * C @ R @ B)


def substitute(entry: Rational, method: Literal["backward-euler", "tustin"], T: float) -> Rational:
    """Numerator and denominator in z, descending, of an entry in s with s = (z-1)/(Tz) or 2(z-1)/(T(z+1)).

    Multiplied out by the method's denominator to the entry's degree, the larger one of numerator and denominator
    without their leading zeros; improper entries are fine.
    """
    entry = (_trimmed(entry[0]), _trimmed(entry[1]))
    below = np.array([T, 0.0]) if method == "backward-euler" else np.array([T, T])
    above = np.array([1.0, -1.0]) if method == "backward-euler" else np.array([2.0, -2.0])
    degree = max(len(part) for part in entry) - 1
    out = []
    for part in entry:
        total = np.zeros(degree + 1)
        for power, coefficient in enumerate(reversed(part)):
            term = np.array([coefficient])
            for factor in [above] * power + [below] * (degree - power):
                term = np.convolve(term, factor)
            total += term
        out.append(tuple(float(c) for c in total))
    return out[0], out[1]


def realise(entries: tuple[tuple[Rational, ...], ...]) -> StateSpace:
    """A discrete state space of a matrix of rational functions of z, in the companion forms of its entries.

    Every entry keeps its states, also one that is a plain gain: who rebuilds the system exactly has then no zero to
    decide.

    Args:
        entries: rows of (numerator, denominator) of equal length, as :func:`substitute` gives them.

    Raises:
        Infeasible: an entry is improper in z: its output would lead its input.
    """
    for i, row in enumerate(entries):
        for j, (_, den) in enumerate(row):
            if den[0] == 0.0:
                raise Infeasible(
                    f"the environment's entry ({i + 1}, {j + 1}) is not causal after discretisation",
                    ("use backward Euler", "lower the numerator's degree"),
                )
    return companion_forms(entries, idle=True)


def _trimmed(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """Without leading zeros; the zero polynomial keeps one."""
    for i, c in enumerate(coefficients):
        if c != 0.0:
            return coefficients[i:]
    return (0.0,)
