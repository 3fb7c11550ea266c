"""The energy ledger of one party: its promise, watched online from its own data alone.

A party that is Delta-OSP and Phi-ISP (Definition 2 of [Bianchini2010]_) satisfies, at every tick k,

    E_k = sum_{j <= k} T (y^T u - y^T Delta y - u^T Phi u) >= -V(psi_0),

and everything here starts at rest, V(psi_0) = 0. A ledger below zero is a broken promise.
"""

from __future__ import annotations


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
