"""The energy ledger of a party, and the controller that keeps the ledger of an environment without a proof above zero.

**The ledger** checks the promise of one party in every tick, from the party's own data alone. A party that is Delta-OSP
and Phi-ISP (Definition 2 of [Bianchini2010]_) satisfies, at every tick k,

    E_k = sum_{j <= k} T (y^T u - y^T Delta y - u^T Phi u) >= -V(psi_0),

and every party starts at rest. Its ledger begins at V(psi_0): at 0, unless it stores energy at the start, as a scene
with raised bodies does. A ledger below zero is a broken promise.

**The controller** stands at the environment's ports and keeps a promise that nothing proves. A physics engine or a
neural simulator has no known storage function. So the controller reduces the model's forces, tick by tick, as far as
the ledger of its declared level Phi needs to stay at zero or above. This is the passivity observer and controller of
[Hannaford2002]_, in the form that an algebraic loop of force and motion needs.

At one tick the tool's velocity depends on the force by the couplings' feedthrough,

    w(f) = w_0 + G f,     G = D_V/T,

with G + G^T > 0, as every output strictly passive V_hat has. So one force holds the tool where it is,

    h = -G^{-1} w_0,     w(h) = 0,     w(f) = G (f - h).

The controller damps the model's force f_m in the metric of the couplings, with Z = G^{-1} (N*s/m, the resistance of the
coupling itself to a motion of one tick). That gives an algebraic loop in the applied force,

    f = f_m - alpha Z w(f),     alpha >= 0,

which has one solution for every alpha, on the line between the two forces: with s = 1/(1 + alpha) in (0, 1],

    f = s f_m + (1 - s) h,     w = s w_m,     w_m = w(f_m).

The ledger gains an energy that is quadratic in s,

    e(s)/T = -w^T f + w^T Phi w = a s - b s^2,     a = -w_m^T h,     b = w_m^T (f_m - h) - w_m^T Phi w_m,

and e(0) = 0: a tool that stands still costs nothing, so s = 0 (alpha = infinity) always keeps a ledger that is not
below zero. Where s = 1 would break the promise, E + e(0) >= 0 > E + e(1) leaves exactly one change of sign in [0, 1],
whatever the signs of a and b. The values of s before it keep the promise, and the greatest of them, the least alpha, is
a root in closed form. Where w_m = 0 nothing moves, and nothing needs to be damped: the work is zero.

The only assumption on the model is that its force is finite. The controller never moves a tool further than the model
would, and never in the opposite direction.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


class Ledger:
    """The running total of a party's energy, J.

    Attributes:
        total: E_k, J.
        minimum: the least total so far, J; at most the total with which the ledger began.
        ticks: the number of ticks entered.
        at: the number of ticks after which the total was least; 0 where it never fell below its beginning.
        allowed: how far the total may be below 0 now, J.
        margin: the least distance of the total from its bound so far, J; negative for a broken promise. The bound is
            0; for a device whose lateness is bounded it is less by what lateness may have put in.
    """

    __slots__ = ("allowed", "at", "margin", "minimum", "ticks", "total")

    def __init__(self, allowed: float = 0.0, stored: float = 0.0) -> None:
        """No energy is entered yet.

        Args:
            allowed: how far the total may fall below 0, J.
            stored: V(psi_0), the energy that the party stores at the start, J.
        """
        self.allowed = allowed
        self.total = stored
        self.minimum = stored
        self.margin = stored + allowed
        self.ticks = self.at = 0

    def enter(self, energy: float) -> None:
        """Add one tick's T (y^T u - y^T Delta y - u^T Phi u), J."""
        self.total += energy
        self.ticks += 1
        if self.total < self.minimum:
            self.minimum = self.total
            self.at = self.ticks
        if self.total + self.allowed < self.margin:
            self.margin = self.total + self.allowed


Vector = NDArray[np.float64]

_ROUNDING = 1e-12  # part of the work in a tick below which an overdraft is rounding, and breaks no promise
_INSIDE = 1e-9  # part of s by which the result stays inside the root, a million times the root's rounding


class PassivityController:
    """Decides which part of a model's force is exerted, and counts the energy that it kept back.

    A tick is :meth:`part`, once or several times, and then :meth:`settle`.

    Attributes:
        ticks: the number of ticks in which it reduced a force.
        energy: the energy that it kept back, J: the raw forces of those ticks would have put out so much more.
    """

    __slots__ = ("_T", "_kept_back", "energy", "ticks")

    def __init__(self, T: float) -> None:
        """No energy is kept back so far; T is the period, s."""
        self._T = T
        self._kept_back: float | None = None  # in this tick, J
        self.ticks = 0
        self.energy = 0.0

    def part(self, balance: float, f: Vector, w: Vector, hold: Vector, allowed: float) -> float:
        """The greatest s in [0, 1] at which s f + (1 - s) hold keeps the promise.

        Args:
            balance: E, the ledger before this tick, J.
            f: f_m, the model's force, N.
            w: w_m, the tool's velocity if that force is exerted, m/s.
            hold: h, the force that holds the tool, N; without effect at ports where w is zero.
            allowed: w_m^T Phi w_m, W.

        Returns:
            s; 1 where the whole force keeps the promise.
        """
        c = max(balance, 0.0) / self._T
        e = allowed - float(w @ f)  # e(1)/T
        if c + e >= -_ROUNDING * (float(np.abs(w * f).sum()) + abs(allowed)):
            self._kept_back = None
            return 1.0
        a = -float(w @ hold)
        b = a - e
        s = greatest_part(a, b, c)
        self._kept_back = self._T * ((a * s - b * s * s) - e)
        return s

    def settle(self) -> None:
        """Count the energy that the last answer of :meth:`part` kept back: that answer was applied in this tick."""
        if self._kept_back is not None:
            self.ticks += 1
            self.energy += self._kept_back
            self._kept_back = None


def greatest_part(a: float, b: float, c: float) -> float:
    """The greatest s in [0, 1] with c + a s - b s^2 >= 0, where c >= 0 and s = 1 is beyond it, and a little less.

    Of the two forms of the root the function takes the one whose sum does not cancel. The result is inside the root by
    a part 1e-9 of s.
    """
    root = math.sqrt(max(a * a + 4.0 * b * c, 0.0))
    s = (a + root) / (2.0 * b) if a > 0.0 else 2.0 * c / (root - a) if root - a > 0.0 else 0.0
    return (1.0 - _INSIDE) * min(max(s, 0.0), 1.0)
