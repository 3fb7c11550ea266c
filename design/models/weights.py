"""Transparency of the coupling: the two H-infinity problems of section 5 of [Bianchini2010]_, and their weights.

    loop shaping    minimise ||W_1 E V W_2||_inf                                     (24)
    closed loop     minimise ||W_1 (F(E,V) - E) W_2||_inf,   F = (I + E V)^{-1} E    (23)

The weights W_1, W_2 are scalar stable filters in z. A weight stands for the filter times the identity, one copy for
each port. It is large at frequencies where the tool should follow the hand closely. Filters designed in continuous time
are discretised by backward Euler, s = (z-1)/(Tz), which keeps them stable.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, isfinite, pi
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import Matrix, StateSpace, frequency_response, matrix

MOST_DEGREE = 16  # companion forms of higher degree lose their poles to rounding
_STATIC_TOLERANCE = 1e-3  # relative; n poles of w rad/s lose 1e-16/(w T)^n of the static gain by rounding


@dataclass(frozen=True)
class Filter:
    """A scalar stable proper filter num(z)/den(z).

    Attributes:
        num: numerator, descending powers of z.
        den: denominator, descending powers of z; made monic.

    Raises:
        ValueError: no or too many coefficients, one that is not finite, a zero denominator, a numerator of higher
            degree, or a pole on or outside the unit circle.
    """

    num: tuple[float, ...]
    den: tuple[float, ...]

    def __post_init__(self) -> None:
        num, den = _trimmed(self.num, "numerator"), _trimmed(self.den, "denominator")
        if not den:
            raise ValueError("denominator: found zero; expected a coefficient that is not")
        if len(num) > len(den):
            raise ValueError(
                f"found a numerator of degree {len(num) - 1} over a denominator of degree {len(den) - 1}: "
                "expected a proper filter"
            )
        radius = max(np.abs(np.roots(den)), default=0.0)
        if not radius < 1.0:
            raise ValueError(f"found a pole of modulus {radius:.6g}; expected a stable weight: all below 1")
        object.__setattr__(self, "num", tuple(c / den[0] for c in num) or (0.0,))
        object.__setattr__(self, "den", tuple(c / den[0] for c in den))

    @classmethod
    def one(cls) -> Filter:
        """The weight 1."""
        return cls((1.0,), (1.0,))

    @classmethod
    def from_continuous(cls, num: tuple[float, ...], den: tuple[float, ...], T: float) -> Filter:
        """num(s)/den(s) by backward Euler with period T (s).

        Args:
            num: descending powers of s.
            den: descending powers of s.
            T: period, s.

        Raises:
            ValueError: the discretised filter is refused by the class; or rounding its coefficients changes its static
                gain.
        """
        if not (isfinite(T) and T > 0.0):
            raise ValueError(f"period: found {T}; expected a positive one")
        a, b = _trimmed(num, "numerator"), _trimmed(den, "denominator")
        degree = max(len(a), len(b), 1) - 1
        out = cls(_backward_euler(a, degree, T), _backward_euler(b, degree, T))
        if b and b[-1] != 0.0:
            wanted, found = (a[-1] / b[-1] if a else 0.0), sum(out.num) / sum(out.den)
            if not abs(found - wanted) <= _STATIC_TOLERANCE * max(abs(wanted), max(map(abs, out.num))):
                raise ValueError(
                    f"found a static gain of {found:.6g} after rounding; expected {wanted:.6g}: several poles are too "
                    "slow for this period; give the filter fewer of them"
                )
        return out

    @classmethod
    def emphasise(cls, low: float, high: float, T: float) -> Filter:
        """Emphasise the band from ``low`` to ``high`` (Hz).

            w(s) = 1 / (1 + s/w_h)                          for low = 0   (Example 2: 0-20 Hz, w_h = 125 rad/s)
            w(s) = (s/w_l) / ((1 + s/w_l) (1 + s/w_h))      otherwise,    w = 2 pi times the frequency in Hz

        Raises:
            ValueError: not 0 <= low < high < 1/(2T).
        """
        if not 0.0 <= low < high < 0.5 / T:
            raise ValueError(f"band: found {low} to {high} Hz; expected 0 <= low < high < {0.5 / T:g} Hz = 1/(2T)")
        fall = (0.5 / (pi * high), 1.0)
        if low == 0.0:
            return cls.from_continuous((1.0,), fall, T)
        rise = 0.5 / (pi * low)
        return cls.from_continuous((rise, 0.0), tuple(float(c) for c in np.polymul((rise, 1.0), fall)), T)

    def response(self, points: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """The filter's values at ``points`` of the z plane, of the same shape."""
        return np.asarray(np.polyval(self.num, points) / np.polyval(self.den, points), dtype=np.complex128)

    def realisation(self, ports: int) -> StateSpace:
        """The filter times the identity of ``ports`` inputs: controllable companion form, kron with I.

        For den = z^n + a_1 z^(n-1) + ... + a_n: first row of A is (-a_1, ..., -a_n), ones below the diagonal,
        B the first unit vector, C_j = b_j - a_j b_0, D = b_0.
        """
        n = len(self.den) - 1
        b = np.concatenate([np.zeros(n + 1 - len(self.num)), self.num])
        a = np.array(self.den[1:])
        A: Matrix = np.eye(n, k=-1)
        if n:
            A[0] = -a
        B = np.eye(n, 1)
        I = np.eye(ports)
        C = (b[1:] - a * b[0])[None, :]
        return StateSpace(matrix(np.kron(A, I)), matrix(np.kron(B, I)), matrix(np.kron(C, I)), b[0] * I)


def _trimmed(coefficients: tuple[float, ...], what: str) -> tuple[float, ...]:
    """The coefficients as floats without leading zeros."""
    if not 0 < len(coefficients) <= MOST_DEGREE + 1:
        raise ValueError(f"{what}: found {len(coefficients)} coefficients; expected 1 to {MOST_DEGREE + 1}")
    values = [float(c) for c in coefficients]
    if not all(isfinite(c) for c in values):
        raise ValueError(f"{what}: found {values}; expected finite coefficients")
    while values and values[0] == 0.0:
        values.pop(0)
    return tuple(values)


def _backward_euler(coefficients: tuple[float, ...], degree: int, T: float) -> tuple[float, ...]:
    """Coefficients in z of (Tz)^degree p((z-1)/(Tz)), divided by T^degree."""
    out = np.zeros(degree + 1)
    for k, c in enumerate(reversed(coefficients)):  # c s^k gives c (z-1)^k z^(degree-k) / T^k
        for j in range(k + 1):
            out[j] += c / T**k * comb(k, j) * (-1.0) ** j
    return tuple(float(c) for c in out)


ComplexArray = NDArray[np.complex128]
Objective = Literal["loop-shaping", "closed-loop"]


@dataclass(frozen=True)
class Transparency:
    """The transparency problem that a coupling is optimised for.

    Attributes:
        objective: "loop-shaping" (24) or "closed-loop" (23).
        W1: weight on the force side, times the identity.
        W2: weight on the hand's side, times the identity.
    """

    objective: Objective
    W1: Filter
    W2: Filter

    def __post_init__(self) -> None:
        if self.objective not in ("loop-shaping", "closed-loop"):
            raise ValueError(f"objective: found {self.objective!r}; expected 'loop-shaping' or 'closed-loop'")


def weighted(loop_E: StateSpace, V: StateSpace, aim: Transparency) -> StateSpace:
    """W_1 E V W_2, or W_1 (F(E,V) - E) W_2 = -W_1 E V (I + E V)^{-1} E W_2, as a system.

    Both are series connections. The states stand in the order in which the signal passes the systems,

        loop shaping    W_2, V, E, W_1
        closed loop     W_2, E, L, W_1,    L = -E V (I + E V)^{-1} with the states of V, then those of a second E:

            r = R (y - C_E eta - D_E C_V xi),   R = (I + D_E D_V)^{-1},   u = C_V xi + D_V r,
            xi+ = A_V xi + B_V r,   eta+ = A_E eta + B_E u,   output r - y,

    with the realisations of E and V as given and those of W_1, W_2 from :meth:`Filter.realisation`.

    Args:
        loop_E: E, displacement (m) to force (N), m x m.
        V: coupling, force (N) to displacement (m), m x m.
        aim: objective and weights.

    Raises:
        ValueError: I + D_E D_V is singular (closed loop), or sizes differ.
    """
    m = loop_E.inputs
    if (loop_E.outputs, V.inputs, V.outputs) != (m, m, m):
        raise ValueError(f"found E of {loop_E.outputs} outputs and V of {V.outputs} x {V.inputs}; expected {m} ports")
    before, after = aim.W2.realisation(m), aim.W1.realisation(m)
    if aim.objective == "loop-shaping":
        return _series(before, V, loop_E, after)
    return _series(before, loop_E, _lost(loop_E, V), after)


def states_of_E(loop_E: StateSpace, V: StateSpace, aim: Transparency) -> tuple[int, ...]:
    """Where the states of E, and of its second copy, begin among those of :func:`weighted`."""
    before = aim.W2.realisation(loop_E.inputs).order
    if aim.objective == "loop-shaping":
        return (before + V.order,)
    return before, before + loop_E.order + V.order


def _lost(E: StateSpace, V: StateSpace) -> StateSpace:
    """L = (I + E V)^{-1} - I."""
    m, n_V, n_E = E.inputs, V.order, E.order
    inner = np.eye(m) + E.D @ V.D
    if not np.linalg.norm(inner, -2) > 1e-12 * (1.0 + np.linalg.norm(E.D @ V.D, 2)):
        raise ValueError("I + D_E D_V is singular: force and tool position have no unique solution in a tick")
    R = np.linalg.inv(inner)
    r = np.hstack([-R @ E.D @ V.C, -R @ E.C, R])  # over (xi, eta, y)
    u = V.D @ r
    u[:, :n_V] += V.C
    xi, eta = V.B @ r, E.B @ u
    xi[:, :n_V] += V.A
    eta[:, n_V : n_V + n_E] += E.A
    r[:, n_V + n_E :] -= np.eye(m)
    state = np.vstack([xi, eta])
    return StateSpace(state[:, : n_V + n_E], state[:, n_V + n_E :], r[:, : n_V + n_E], r[:, n_V + n_E :])


def _series(*systems: StateSpace) -> StateSpace:
    """The series connection, the first system's output into the second's input and so on; states in that order."""
    total = systems[0]
    for s in systems[1:]:
        total = StateSpace(
            np.block([[total.A, np.zeros((total.order, s.order))], [s.B @ total.C, s.A]]),
            np.vstack([total.B, s.B @ total.D]),
            np.hstack([s.D @ total.C, s.C]),
            s.D @ total.D,
        )
    return total


@dataclass(frozen=True, eq=False)
class WeightedLoop:
    """The weighted response and its derivative with respect to V, frequency by frequency.

    Attributes:
        E: the environment, displacement to force.
        aim: objective and weights.
    """

    E: StateSpace
    aim: Transparency

    def factors(self, V: ComplexArray, angles: Matrix) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """The weighted response G and L, R with dG = L dV R, each angles x m x m.

        Loop shaping: G = w E V, dG = w E dV with w = W_1 W_2. Closed loop: dF = -F dV F, so dG = -w F dV F.

        Args:
            V: response of the coupling, angles x m x m.
            angles: theta in rad.
        """
        z = np.exp(1j * angles)
        w = (self.aim.W1.response(z) * self.aim.W2.response(z))[:, None, None]
        E = frequency_response(self.E, angles)
        I = np.eye(self.E.inputs, dtype=np.complex128)
        if self.aim.objective == "loop-shaping":
            return w * E @ V, w * E, np.asarray(np.broadcast_to(I, E.shape))
        F: ComplexArray = np.asarray(np.linalg.solve(I + E @ V, E), dtype=np.complex128)
        return -w * F @ V @ E, -w * F, F  # F - E = -F V E

    def poles(self) -> ComplexArray:
        """Poles of E and of the weights: where the response changes fast."""
        filters = (self.aim.W1.den, self.aim.W2.den)
        return np.concatenate([np.linalg.eigvals(self.E.A), *(np.roots(den) for den in filters)]).astype(np.complex128)

    def poles_with(self, V: StateSpace) -> ComplexArray:
        """The poles that the coupling adds to the response: its own poles, or those of F(E,V)."""
        A = V.A if self.aim.objective == "loop-shaping" else _lost(self.E, V).A
        return np.linalg.eigvals(A).astype(np.complex128)
