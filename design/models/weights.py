"""Weights W_1, W_2 of the transparency problems (23), (24) of [Bianchini2010]_: scalar stable filters in z.

A weight stands for the filter times the identity, one copy a port. It is large where the tool should follow the hand
closely. Filters designed in continuous time are discretised by backward Euler, s = (z-1)/(Tz), which keeps them stable.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, isfinite, pi

import numpy as np
from numpy.typing import NDArray

from manyhands.design.statespace import Matrix, StateSpace, matrix

MOST_DEGREE = 16  # companion forms of higher degree lose their poles to rounding
_STATIC_TOLERANCE = (
    1e-3  # n poles of w rad/s make the static gain lose 1e-16/(w T)^n: more than this is not a rounding error
)


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
            raise ValueError("denominator: found zero, expected a coefficient that is not")
        if len(num) > len(den):
            raise ValueError(
                f"found a numerator of degree {len(num) - 1} over a denominator of degree {len(den) - 1}: "
                "expected a proper filter"
            )
        radius = max(np.abs(np.roots(den)), default=0.0)
        if not radius < 1.0:
            raise ValueError(f"found a pole of modulus {radius:.6g}, expected a stable weight: all below 1")
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
            ValueError: as the class, for the discretised filter; or its coefficients, rounded, are another filter's.
        """
        if not (isfinite(T) and T > 0.0):
            raise ValueError(f"period: found {T}, expected a positive one")
        a, b = _trimmed(num, "numerator"), _trimmed(den, "denominator")
        degree = max(len(a), len(b), 1) - 1
        out = cls(_backward_euler(a, degree, T), _backward_euler(b, degree, T))
        if b and b[-1] != 0.0:
            wanted, found = (a[-1] / b[-1] if a else 0.0), sum(out.num) / sum(out.den)
            if not abs(found - wanted) <= _STATIC_TOLERANCE * max(abs(wanted), max(map(abs, out.num))):
                raise ValueError(
                    f"found a static gain of {found:.6g} after rounding, expected {wanted:.6g}: several poles are too "
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
            raise ValueError(f"band: found {low} to {high} Hz, expected 0 <= low < high < {0.5 / T:g} Hz = 1/(2T)")
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
        raise ValueError(f"{what}: found {len(coefficients)} coefficients, expected 1 to {MOST_DEGREE + 1}")
    values = [float(c) for c in coefficients]
    if not all(isfinite(c) for c in values):
        raise ValueError(f"{what}: found {values}, expected finite coefficients")
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
