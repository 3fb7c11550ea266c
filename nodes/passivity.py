"""The energy ledger of one party: its promise, watched online from its own data alone.

A party that is Delta-OSP and Phi-ISP (Definition 2 of [Bianchini2010]_) satisfies, at every tick k,

    E_k = sum_{j <= k} T (y^T u - y^T Delta y - u^T Phi u) >= -V(psi_0),

and everything here starts at rest, V(psi_0) = 0. A ledger below zero is a broken promise.

A passivity controller at the environment's ports: it keeps a promise that nothing proves.

A physics engine or a neural simulator has no storage function to show. What it exerts at the ports is held back
instead, tick by tick, until the ledger of its declared level Phi is never below zero: the passivity observer and
controller of [Hannaford2002]_, in the form that an algebraic loop of force and motion needs.

At one tick the tool's velocity depends on the force by the couplings' feedthrough,

    w(f) = w_0 + G f,     G = D_V/T,

with G + G^T > 0, as every output strictly passive V_hat has. So one force holds the tool where it is,

    h = -G^{-1} w_0,     w(h) = 0,     w(f) = G (f - h).

Damping the model's force f_m in the metric of the couplings, with Z = G^{-1} (N*s/m, what the coupling itself opposes
to a motion of one tick), gives an algebraic loop in the applied force,

    f = f_m - alpha Z w(f),     alpha >= 0,

which has one solution for every alpha, on the line between the two forces: with s = 1/(1 + alpha) in (0, 1],

    f = s f_m + (1 - s) h,     w = s w_m,     w_m = w(f_m).

What the ledger gains is a quadratic in s,

    e(s)/T = -w^T f + w^T Phi w = a s - b s^2,     a = -w_m^T h,     b = w_m^T (f_m - h) - w_m^T Phi w_m,

and e(0) = 0: a tool that stands still costs nothing, so that s = 0 (alpha = infinity) always keeps a ledger that is
not below zero. Where s = 1 would break the promise, E + e(0) >= 0 > E + e(1) leaves exactly one change of sign in
[0, 1], whatever the signs of a and b; the forces before it are those that keep the promise, and the greatest such s,
the least alpha, is a root in closed form. Where w_m = 0 nothing moves, nothing can be damped, and nothing needs to be:
the work is zero.

f and w may be any model's: nothing about it is assumed but that its force is finite. The controller never makes a tool
go further than the model would, and never the other way.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


class Ledger:
    """Running total of a party's energy, J.

    Attributes:
        total: E_k, J.
        minimum: the least total so far, J; not above 0, where it began.
        ticks: how many were entered.
        at: after which of them the total was least; 0 where it never fell below its beginning.
    """

    __slots__ = ("at", "minimum", "ticks", "total")

    def __init__(self) -> None:
        self.total = 0.0
        self.minimum = 0.0
        self.ticks = self.at = 0

    @property
    def margin(self) -> float:
        """By how much the least total stayed above its bound, -V(psi_0) = 0, J; negative for a broken promise."""
        return self.minimum

    def enter(self, energy: float) -> None:
        """Add one tick's T (y^T u - y^T Delta y - u^T Phi u), J."""
        self.total += energy
        self.ticks += 1
        if self.total < self.minimum:
            self.minimum = self.total
            self.at = self.ticks


Vector = NDArray[np.float64]

_ROUNDING = 1e-12  # of the work in a tick: less than this is rounding, and breaks no promise
_INSIDE = 1e-9  # of s: stay that far inside the root, a million times its rounding


class PassivityController:
    """Decides how much of a model's force may be exerted, and counts what it kept back.

    A tick is :meth:`part`, perhaps several times, and :meth:`settle`.

    Attributes:
        ticks: how often it has acted.
        energy: J that it kept back: what the raw forces of those ticks would have put out more.
    """

    __slots__ = ("_T", "_kept_back", "energy", "ticks")

    def __init__(self, T: float) -> None:
        """Nothing kept back so far; T is the period, s."""
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
            s; 1 where nothing is to be kept back.
        """
        c = max(balance, 0.0) / self._T
        e = allowed - float(w @ f)  # e(1)/T
        if c + e >= -_ROUNDING * (float(np.abs(w * f).sum()) + abs(allowed)):
            self._kept_back = None
            return 1.0
        a = -float(w @ hold)
        b = a - e
        s = (1.0 - _INSIDE) * _greatest(a, b, c)
        self._kept_back = self._T * ((a * s - b * s * s) - e)
        return s

    def settle(self) -> None:
        """Count what the last answer kept back: it is what was done in this tick."""
        if self._kept_back is not None:
            self.ticks += 1
            self.energy += self._kept_back
            self._kept_back = None


def _greatest(a: float, b: float, c: float) -> float:
    """The greatest s in [0, 1] with c + a s - b s^2 >= 0, where c >= 0 and s = 1 is beyond it.

    Of the two ways to write a root the one is taken whose sum cannot cancel.
    """
    root = math.sqrt(max(a * a + 4.0 * b * c, 0.0))
    s = (a + root) / (2.0 * b) if a > 0.0 else 2.0 * c / (root - a) if root - a > 0.0 else 0.0
    return min(max(s, 0.0), 1.0)
