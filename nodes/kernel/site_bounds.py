"""The greatest wave of a site, and the furthest place of its tool, from the limits that the session states for it.

A user whose tool moves by |w| <= S and whose force is |f| <= F, port by port, meets and sends waves with

    |h c|, |h a|  <=  |b| S + F,      so that      |c_i|, |a_i|  <=  sum_j |h^-1|_ij (|b| S + F)_j.

Both faces of a link keep to this bound a_max in what they tell each other and in what they play. So the waves that an
honest face sends are within it by construction, whatever its world does. Where the energy of a tick would be more than
a quarter of the site's energy budget E, T/2 |a_max|^2 > E/4, a_max is shortened to that.

The tool in the world is at x_e, and x_e - x_c is at most (R/2) b^-1 F at a round trip R
(docs/remote/proof.md). So the world's face keeps it within the displacement of the site's own tool and
that gap at :data:`LONGEST_GAP` seconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

LONGEST_GAP: Final = 1.0
"""The round trip up to which the gap between both tools counts to the furthest place, s."""

_PART: Final = 0.25
"""The part of an energy budget that a tick may cost at most: three eighths would still never overdraw it
(docs/decisions/0029-energy-budgets.md).
"""


_FURTHEST: Final = 1e12  # in place of infinity, m


@dataclass(frozen=True)
class SiteBounds:
    """What the site of a wave link can do at most, by port of the link.

    Attributes:
        wave: the greatest |a_i| and |c_i|, W^(1/2).
        place: the greatest displacement of the tool in the world, m.

    Raises:
        ValueError: a number is not greater than 0, or the two differ in length.
    """

    wave: tuple[float, ...]
    place: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.wave) != len(self.place):
            raise ValueError(f"found {len(self.wave)} greatest waves and {len(self.place)} places; expected one each")
        for found in (*self.wave, *self.place):
            if not found > 0.0:
                raise ValueError(f"found {found} as a bound of a site; expected a number greater than 0")

    @property
    def power(self) -> float:
        """The greatest power of a wave, 1/2 |a_max|^2, W."""
        return 0.5 * sum(one * one for one in self.wave)

    def first_sum(self, b: Vector) -> tuple[float, ...]:
        """The greatest |U_i| of a life's first message, U = h^-1 b x, W^(1/2)*s."""
        return tuple((np.abs(_inverse_root(b) @ b) @ np.array(self.place)).tolist())


def site_bounds(
    b: Vector, force: Sequence[float], speed: Sequence[float], tool: Sequence[float], energy: float, T: float
) -> SiteBounds:
    """The bounds of a site.

    Args:
        b: the impedance, m x m, N*s/m.
        force: F, the limit of each port, N.
        speed: S, likewise, m/s.
        tool: the greatest displacement of the site's own tool, likewise, m; ``inf`` for no bound.
        energy: E of the site's budget, J.
        T: the environment's period, s.
    """
    F, S = np.array(force), np.array(speed)
    wave = np.abs(_inverse_root(b)) @ (np.abs(b) @ S + F)
    tick = 0.5 * T * float(wave @ wave)
    wave *= min(1.0, math.sqrt(_PART * energy / tick))
    place = np.array(tool) + 0.5 * LONGEST_GAP * np.abs(np.linalg.inv(b)) @ F
    return SiteBounds(tuple(wave.tolist()), tuple(np.minimum(place, _FURTHEST).tolist()))


def _inverse_root(b: Vector) -> Vector:
    """h^-1 = (2 b)^(-1/2)."""
    eigenvalues, Q = np.linalg.eigh(b)
    out: Vector = (Q / np.sqrt(2.0 * eigenvalues)) @ Q.T
    return out
