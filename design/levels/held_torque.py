"""What is left of a device's damping where its motors hold torques in place of forces.

Between two ticks the motors of a linkage hold the torques J(q)^T f that stood for the force f in one pose q. As the tip
moves on, the same torques push with another force. Per unit of path and force the difference is at most kappa, the
greatest acceleration of a tip that moves with unit speed while no joint accelerates
(:mod:`manyhands.design.models.linkage`). Over a path of at most l, with F the greatest force,

    |force at the tip - f| <= F (e^(kappa l) - 1) <= K_geo l,     K_geo = kappa F / (1 - kappa l / 2),     kappa l < 2.

So a hand may get more energy than the ports count, as from a held spring of the stiffness K_geo. With sigma the path in
a tick and alpha its part before the force acts, a tick gives out at most K_geo (sigma^2/2 + sigma alpha_next), and this
much damping pays for it at every delay up to tau, every period up to lambda T, and every reading of the joints between
the sample and the force (docs/decisions/0050-held-torques.md has the proof):

    d = K_geo (lambda T + 3 tau) / 2,      Delta_D - d I   in place of Delta_D.

The path l is at most that of one hold and of the delay before it, at the limit of speed: v (lambda T + tau). A device
that moves faster is outside the claim.

**Of six axes** where the motors hold the torque of an orientation as well. A turn counts by a length L: a twist by
sqrt(|v|^2 + L^2 |omega|^2), m/s, and a wrench by sqrt(|f|^2 + |m|^2/L^2), N. F, v and kappa are in these norms, kappa
being the greatest |dJ/dt J^-1| of a twist of 1 m/s. Then d is taken of Delta_D, and L^2 d of what the orientation burns
(docs/decisions/0054-orientation.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from manyhands.design.levels.rounding import rounded_up
from manyhands.design.models.statespace import Matrix, matrix

_BELOW = 1e-12  # of Delta_D: a file's numbers are its shortest decimals, which a proof takes exactly


@dataclass(frozen=True)
class HeldTorque:
    """How a device holds its force: as torques of a linkage.

    Attributes:
        kappa: how much its tip's path bends where the joints move evenly, 1/m: the greatest over all poses and
            directions. Of six axes the greatest change of J per way, in the norm with L.
        force: F, the greatest |f|, N; of six axes the greatest wrench.
        speed: v, the greatest speed of its tip, m/s; of six axes the greatest twist.
        linkage: its kinematics as plain data, of which kappa is proved; None where kappa is believed.
        length: L, m/rad, by which turns count; None where the motors hold no torque of an orientation.

    Raises:
        ValueError: a number is not finite, or not greater than 0, or kinematics stand beside a length.
    """

    kappa: float
    force: float
    speed: float
    linkage: Mapping[str, Any] | None = None
    length: float | None = None

    def __post_init__(self) -> None:
        for name in ("kappa", "force", "speed", *(() if self.length is None else ("length",))):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: found {getattr(self, name)}; expected a finite number greater than 0")
        if self.length is not None and self.linkage is not None:
            raise ValueError("found kinematics beside a length; expected kappa alone, for none of six axes is known")

    @property
    def works(self) -> bool:
        """Whether a device's account rests on the work of its motors: of six axes it needs none."""
        return self.length is None

    def describe(self) -> dict[str, Any]:
        """As plain data, which :func:`held_torque_of` reads."""
        out: dict[str, Any] = {"kappa": self.kappa, "force": self.force, "speed": self.speed}
        if self.length is not None:
            out["length"] = self.length
        return out if self.linkage is None else out | {"linkage": dict(self.linkage)}

    def stiffness(self, T: float, tau: float, period_tolerance: float) -> Fraction | None:
        """K_geo, N/m; None where the tip may turn too far in one hold for any bound: kappa l is 2 or more.

        Args:
            T: period, s.
            tau: the longest delay inside the tick, s.
            period_tolerance: rho; periods are at most (1 + rho) T.
        """
        held = (1 + Fraction(period_tolerance)) * Fraction(T) + Fraction(tau)
        turned = Fraction(self.kappa) * Fraction(self.speed) * held
        return Fraction(self.kappa) * Fraction(self.force) / (1 - turned / 2) if turned < 2 else None

    def damping(self, T: float, tau: float, period_tolerance: float) -> float:
        """d, N*s/m, rounded up: the damping that pays for what the held torques give out; infinite if nothing does."""
        K_geo = self.stiffness(T, tau, period_tolerance)
        if K_geo is None:
            return math.inf
        return rounded_up(K_geo * ((1 + Fraction(period_tolerance)) * Fraction(T) + 3 * Fraction(tau)) / 2)

    def turning(self, T: float, tau: float, period_tolerance: float) -> float:
        """L^2 d, N*m*s/rad, rounded up: what is taken of an orientation's damping; 0 where no torque of it is held."""
        if self.length is None:
            return 0.0
        d = self.damping(T, tau, period_tolerance)
        return rounded_up(Fraction(self.length) ** 2 * Fraction(d)) if math.isfinite(d) else math.inf

    def left(self, level: Matrix, T: float, tau: float, period_tolerance: float) -> Matrix | None:
        """Delta_D - d I, N*s/m, slightly less; None if that is not positive definite.

        Args:
            level: Delta_D, m x m, N*s/m.
            T: period, s.
            tau: the longest delay inside the tick, s.
            period_tolerance: rho; periods are at most (1 + rho) T.
        """
        d = self.damping(T, tau, period_tolerance)
        if not math.isfinite(d):
            return None
        out = np.array(level)
        for i, own in enumerate(np.diag(level).tolist()):
            out[i, i] = own - d - _BELOW * own
        out = matrix(out)
        return out if float(np.linalg.eigvalsh(out)[0]) > 0.0 else None


def held_torque_of(data: Mapping[str, Any]) -> HeldTorque:
    """What :meth:`HeldTorque.describe` wrote.

    Raises:
        KeyError, TypeError, ValueError: a key is missing or unknown, or its value is none.
    """
    if unknown := set(data) - {"kappa", "force", "speed", "linkage", "length"}:
        expected = "kappa, force, speed, and perhaps linkage or length"
        raise ValueError(f"held: found the keys {sorted(unknown)}; expected {expected}")
    linkage = data.get("linkage")
    if linkage is not None and not isinstance(linkage, Mapping):
        raise ValueError("held: linkage: expected an object")
    length = float(data["length"]) if "length" in data else None
    return HeldTorque(float(data["kappa"]), float(data["force"]), float(data["speed"]), linkage, length)
