"""How far a device has gone at least, by displacements that are measured with an error (:class:`Play`).

Friction burns c on each metre of way. Of a real device the way is not known: its encoder gives x with an error of up
to e, and the sum of |dx| of what it gives counts steps and noise as ways. What is certain is the least way of all
motions that the samples allow. A play finds it, on each axis by itself. It keeps the interval J in which the shortest
motion may be by now: where the new sample's I = [x - e, x + e] meets J, both are true of a device that stood still, and
J becomes what they have in common. Elsewhere the motion was at least as long as the gap between them, and ends at the
edge of I.

**Lemma.** Let W be the sum of the gaps up to a sample. Then for every p in I the shortest motion with a place in the
interval of each sample so far, and with its last one in p, is W + dist(p, J) long.

It holds at the first sample, J = I and W = 0. Let it hold before I. A motion to p came from some p' in the interval of
the sample before, so that the shortest is W + min over p' of dist(p', J) + |p - p'| = W + dist(p, J), which p' = the
nearest of J attains. If I meets J, the nearest of J to a p in I lies in I as well, so that J may become what they have
in common. If there is a gap g, every way from J to p in I passes the edge z of I, and dist(p, J) = g + |p - z|.

So **no motion whose samples are within e of these is shorter than W**, and one is not longer. The sum up to each sample
counts, and not the gap of one alone: a device may have gone before within the error what shows now.

**Rounding.** The error is taken :data:`_BEYOND` greater and the edges of I are rounded outwards, so that I holds all
that it should; the lemma then is about the intervals in floats, whose gaps are rounded down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from manyhands.nodes.kernel.arithmetic import Floats

_BEYOND: Final = 1e-12
"""m; a driver's own arithmetic in doubles, from the counts of its encoder to a displacement."""


class Play:
    """The least way that a device has gone, by axis."""

    __slots__ = ("_error", "_high", "_low")

    def __init__(self, steps: Sequence[float]) -> None:
        """Begin before the first displacement.

        Args:
            steps: q on each axis, m, at least 0; a displacement is known to e = q/2.
        """
        self._error = [0.5 * q + _BEYOND for q in steps]
        self._low: Floats = [-math.inf] * len(steps)
        self._high: Floats = [math.inf] * len(steps)

    def moved(self, x: Floats) -> Floats:
        """Take the displacement x that was measured, m; returns what it adds to the least way on each axis, m."""
        gaps = []
        for axis, (at, error) in enumerate(zip(x, self._error, strict=True)):
            low = math.nextafter(at - error, -math.inf)
            high = math.nextafter(at + error, math.inf)
            gap = max(low - self._high[axis], self._low[axis] - high)
            if gap > 0.0:
                edge = low if low > self._high[axis] else high
                self._low[axis] = self._high[axis] = edge
                gaps.append(math.nextafter(gap, 0.0))
            else:
                self._low[axis], self._high[axis] = max(low, self._low[axis]), min(high, self._high[axis])
                gaps.append(0.0)
        return gaps
