"""Chatter: a force on a hand that turns back and forth from tick to tick.

The forces are those that the couplings receive, f_c = S f_e. While a clutch works an offset off, the force f_e on the
tool may go to and fro with its ratio, of which a hand feels next to nothing. A force *reverses* at a port where two
successive steps f(k) - f(k-1) have opposite signs, and both are at least :data:`LEAST`. A press of a hand reverses a
few times a second. A model that is asked ahead of the tick, with a local stiffness C and a coupling with the
feedthrough D_V, reverses in every tick once the spectral radius of D_V C is 1 or more
(docs/decisions/0042-proxies.md): stable under the certificate, and felt as a buzz.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.rows import figures as names

LEAST: Final = 0.01
"""The least step of a force that counts, N: below it a device's friction hides a buzz."""

MOST: Final = 40
"""The reversals in a second from which a force is reported as chatter; a hand makes fewer than ten."""


class Chatter:
    """The ticks in which forces reversed, by party.

    Attributes:
        reversals: by party, the ticks in which the force at any port of its reversed.
        most: by party, the greatest number of them in one second, over seconds that follow each other.
    """

    def __init__(self, parties: Sequence[Sequence[int]], T: float) -> None:
        """No force so far; T is the period, s."""
        self._parties = [list(ports) for ports in parties]
        m = sum(len(ports) for ports in self._parties)
        self._f, self._step = np.zeros(m), np.zeros(m)
        self._left = self._ticks = max(1, round(1.0 / T))
        self._second = [0] * len(self._parties)
        self.reversals, self.most = [0] * len(self._parties), [0] * len(self._parties)

    def enter(self, f: NDArray[np.float64]) -> None:
        """Take the forces f_c(k) of one tick, N."""
        step = f - self._f
        before, self._f, self._step = self._step, f, step
        turned = (step * before < 0.0) & (np.minimum(np.abs(step), np.abs(before)) >= LEAST)
        if turned.any():
            for party, ports in enumerate(self._parties):
                if turned[ports].any():
                    self.reversals[party] += 1
                    self._second[party] += 1
                    self.most[party] = max(self.most[party], self._second[party])
        self._left -= 1
        if self._left == 0:
            self._left, self._second = self._ticks, [0] * len(self._parties)


def contact_tables(
    held: Sequence[int], chatter: Chatter | None, parties: tuple[str, ...]
) -> dict[str, dict[str, float]]:
    """How often proxies were held and forces reversed, by party; reversals of 0 are left out.

    Args:
        held: by party, the ticks in which the proxy test held its proxies; empty without proxies.
        chatter: the reversals; None where none are counted.
        parties: their names.
    """
    counted = () if chatter is None else ((names.REVERSALS, chatter.reversals), (names.CHATTER, chatter.most))
    return {
        names.HELD: {name: float(n) for name, n in zip(parties, held, strict=False)},
        **{kind: {name: float(n) for name, n in zip(parties, all_, strict=True) if n} for kind, all_ in counted},
    }
