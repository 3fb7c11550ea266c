"""What an orientation promises: a chordal spring of stiffness k at the hand, and a device that burns b|omega|^2.

With periods of at most lambda T and delays of at most tau the promise holds on all of SO(3) if

    k (lambda T + 3 tau)/2 <= b,

whatever the world proposes and however late it does (docs/decisions/0054-orientation.md). The hand itself tests what is
proposed (:mod:`manyhands.nodes.kernel.orientation`), so the claim is none about couplings or environment.

Where joints hold the torque, what that may give out is taken of b first: L^2 d of
:mod:`manyhands.design.levels.held_torque`.

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
from manyhands.design.levels.held_torque import HeldTorque

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
        held: how the device's motors hold torques of joints, where they hold the orientation's as well; it is the
            device's own. None where they hold the torque itself.

    Raises:
        ValueError: a number is not finite, or not greater than 0.
    """

    osp: float | None
    stiffness: float
    held: HeldTorque | None = None

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

    def taken(self, T: float, tau: float, period_tolerance: float) -> float:
        """L^2 d, N*m*s/rad: what torques of joints take of the damping; 0 where the torque itself is held."""
        return 0.0 if self.held is None else self.held.turning(T, tau, period_tolerance)

    def within(self, T: float, tau: float, period_tolerance: float) -> OrientationLevel:
        """Itself where it is proved, and otherwise with the stiffest spring that is, less :data:`SPARE`.

        Raises:
            Infeasible: torques of joints leave nothing for any spring.
        """
        if self.osp is None or self.proved(T, tau, period_tolerance):
            return self
        most = stiffest(self.osp, T, tau, period_tolerance, taken=self.taken(T, tau, period_tolerance))
        if not most > 0.0:
            raise Infeasible(nothing_left("a device", self, T, tau, period_tolerance))
        return OrientationLevel(self.osp, most, self.held)

    def proved(self, T: float, tau: float, period_tolerance: float) -> bool:
        """Whether the device burns as much."""
        taken = self.taken(T, tau, period_tolerance)
        if self.osp is None:
            return True
        return math.isfinite(taken) and self.needed(T, tau, period_tolerance) <= Fraction(self.osp) - Fraction(taken)


def stiffest(
    osp: float, T: float, tau: float, period_tolerance: float, spare: float = SPARE, taken: float = 0.0
) -> float:
    """The stiffest spring that b allows, N*m/rad, less a part of it; 0 where nothing of b is left.

    Args:
        osp: b, N*m*s/rad.
        T: period, s.
        tau: the longest delay inside the tick, s.
        period_tolerance: rho; periods are at most (1 + rho) T.
        spare: that part.
        taken: what torques of joints take of b, N*m*s/rad.
    """
    if not taken < osp:
        return 0.0
    return (1.0 - spare) * float((Fraction(osp) - Fraction(taken)) / _half(T, tau, period_tolerance))


def nothing_left(name: str, of: OrientationLevel, T: float, tau: float, period_tolerance: float) -> str:
    """That torques of joints take all that a device burns by turning, in words."""
    taken = of.taken(T, tau, period_tolerance)
    if not math.isfinite(taken):
        return f"the orientation of {name}: its tip may turn too far while its torques are held; state lower speeds"
    return (
        f"the orientation of {name}: found an osp of {of.osp:g} N·m·s/rad; expected more than the {taken:.4g} "
        f"N·m·s/rad that torques of its joints may give out at delays of {1e3 * tau:g} ms; state a lower greatest "
        "force or torque"
    )


def require_proved(name: str, of: OrientationLevel, T: float, tau: float, period_tolerance: float) -> None:
    """Require a spring that what the device burns pays for.

    Raises:
        Infeasible: it does not.
    """
    if of.osp is None or of.proved(T, tau, period_tolerance):
        return
    taken = of.taken(T, tau, period_tolerance)
    most = stiffest(of.osp, T, tau, period_tolerance, 0.0, taken)
    if not most > 0.0:
        raise Infeasible(nothing_left(name, of, T, tau, period_tolerance))
    leaves = f", of which torques of its joints take {taken:.4g}," if taken else ""
    raise Infeasible(
        f"the orientation of {name}: found a stiffness of {of.stiffness:g} N·m/rad; expected at most {most:.4g} "
        f"N·m/rad, which an osp of {of.osp:g} N·m·s/rad{leaves} allows at delays of {1e3 * tau:g} ms; state less, or "
        "no stiffness for the stiffest that is proved"
    )


def _half(T: float, tau: float, period_tolerance: float) -> Fraction:
    return ((1 + Fraction(period_tolerance)) * Fraction(T) + 3 * Fraction(tau)) / 2


def orientation_of(data: Mapping[str, Any], held: HeldTorque | None = None) -> OrientationLevel:
    """What :meth:`OrientationLevel.describe` wrote, of a device whose motors hold torques as ``held`` says.

    Raises:
        KeyError, TypeError, ValueError: a key is missing or unknown, or its value is none.
    """
    if set(data) not in ({"osp", "stiffness"}, {SENSED, "stiffness"}) or data.get(SENSED, True) is not True:
        expected = f"osp and stiffness, or {SENSED} (true) and stiffness"
        raise ValueError(f"orientation: found the keys {sorted(data)}; expected {expected}")
    if SENSED in data:
        return OrientationLevel(None, float(data["stiffness"]))
    return OrientationLevel(float(data["osp"]), float(data["stiffness"]), held)
