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
        minimum: the least total so far, J.
    """

    __slots__ = ("minimum", "total")

    def __init__(self) -> None:
        self.total = 0.0
        self.minimum = 0.0

    def enter(self, energy: float) -> None:
        """Add one tick's T (y^T u - y^T Delta y - u^T Phi u), J."""
        self.total += energy
        if self.total < self.minimum:
            self.minimum = self.total
