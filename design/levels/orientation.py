"""What an orientation promises: a chordal spring of stiffness k at the hand, and a device that burns b|omega|^2.

With periods of at most lambda T and delays of at most tau the promise holds on all of SO(3) if

    k (lambda T + 3 tau)/2 <= b,

whatever the world proposes and however late it does (docs/decisions/0054-orientation.md). The hand itself tests what is
proposed (:mod:`manyhands.nodes.kernel.orientation`), so the claim is none about couplings or environment.

Where the orientation is sensed alone, no torque acts on the hand, and nothing has to be burnt: k is that of the spring
by which the tool's avatar follows the hand.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final

from manyhands.design.errors import Infeasible

SPARE: Final = 0.01
"""The part of the stiffest spring that is left out where no stiffness is stated."""


SENSED: Final = "sensed"
"""The key of an orientation without a torque, in a certificate."""


@dataclass(frozen=True)
class OrientationLevel:
    """The orientation of a device.

    Attributes:
        osp: b, N*m*s/rad: it burns b|omega|^2 at least; None where the orientation is sensed and no torque acts.
        stiffness: k, N*m/rad.

    Raises:
        ValueError: a number is not finite, or not greater than 0.
    """

    osp: float | None
    stiffness: float

    def __post_init__(self) -> None:
        for name in ("stiffness",) if self.osp is None else ("osp", "stiffness"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: found {getattr(self, name)}; expected a finite number greater than 0")

    def describe(self) -> dict[str, float | bool]:
        """As plain data, which :func:`orientation_of` reads."""
        own: dict[str, float | bool] = {SENSED: True} if self.osp is None else {"osp": self.osp}
        return {**own, "stiffness": self.stiffness}

    def needed(self, T: float, tau: float, period_tolerance: float) -> Fraction:
        """K (lambda T + 3 tau)/2, N*m*s/rad: the damping that the spring needs; 0 where no torque acts."""
        return Fraction(0) if self.osp is None else Fraction(self.stiffness) * _half(T, tau, period_tolerance)

    def within(self, T: float, tau: float, period_tolerance: float) -> OrientationLevel:
        """Itself where it is proved, and otherwise with the stiffest spring that is, less :data:`SPARE`."""
        if self.osp is None or self.proved(T, tau, period_tolerance):
            return self
        return OrientationLevel(self.osp, stiffest(self.osp, T, tau, period_tolerance))

    def proved(self, T: float, tau: float, period_tolerance: float) -> bool:
        """Whether the device burns as much."""
        return self.osp is None or self.needed(T, tau, period_tolerance) <= Fraction(self.osp)


def stiffest(osp: float, T: float, tau: float, period_tolerance: float, spare: float = SPARE) -> float:
    """The stiffest spring that b allows, N*m/rad, less a part of it.

    Args:
        osp: b, N*m*s/rad.
        T: period, s.
        tau: the longest delay inside the tick, s.
        period_tolerance: rho; periods are at most (1 + rho) T.
        spare: that part.
    """
    return (1.0 - spare) * float(Fraction(osp) / _half(T, tau, period_tolerance))


def require_proved(name: str, of: OrientationLevel, T: float, tau: float, period_tolerance: float) -> None:
    """Require a spring that what the device burns pays for.

    Raises:
        Infeasible: it does not.
    """
    if of.osp is not None and not of.proved(T, tau, period_tolerance):
        most = stiffest(of.osp, T, tau, period_tolerance, 0.0)
        raise Infeasible(
            f"the orientation of {name}: found a stiffness of {of.stiffness:g} N·m/rad; expected at most {most:.4g} "
            f"N·m/rad, which an osp of {of.osp:g} N·m·s/rad allows at delays of {1e3 * tau:g} ms; state less, or no "
            "stiffness for the stiffest that is proved"
        )


def _half(T: float, tau: float, period_tolerance: float) -> Fraction:
    return ((1 + Fraction(period_tolerance)) * Fraction(T) + 3 * Fraction(tau)) / 2


def orientation_of(data: Mapping[str, Any]) -> OrientationLevel:
    """What :meth:`OrientationLevel.describe` wrote.

    Raises:
        KeyError, TypeError, ValueError: a key is missing or unknown, or its value is none.
    """
    if set(data) not in ({"osp", "stiffness"}, {SENSED, "stiffness"}) or data.get(SENSED, True) is not True:
        expected = f"osp and stiffness, or {SENSED} (true) and stiffness"
        raise ValueError(f"orientation: found the keys {sorted(data)}; expected {expected}")
    return OrientationLevel(None if SENSED in data else float(data["osp"]), float(data["stiffness"]))
