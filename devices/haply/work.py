"""The work of the motors, from the joints' angles and torques that frames tell: :class:`MotorWork`.

Between two readings the motors hold the torques of the message in between, so they do t^T (q_new - q_old). Which frame
tells these torques depends on the service: the one that answers the message, or, where a frame tells what was before
its message, the next one. Its reported force shows which: it is that of its own message, or that of the message before.

Nobody documents that a frame has torques under a Cartesian force, nor their unit. So they are believed only where they
are there when a force is, and where their work stays near that of the force, f^T dx, which it can differ from by a few
percent alone. Otherwise the work is unknown.
"""

from __future__ import annotations

from typing import Final

from manyhands.devices.haply.service import Reading, Vector

DOUBT: Final = 0.5
"""The part of the sum of |f^T dx| by which the work may differ from f^T dx; another unit is off by 57 or more."""

ENOUGH: Final = 1e-3
"""J; the sum of |f^T dx| from which on that is judged."""

SAME: Final = 0.05
"""N; forces that differ by less are the same: frames may have numbers of 32 bits."""


class MotorWork:
    """The sum of the motors' work.

    Attributes:
        sum: of all that is known, J.
        unknown: how many stretches between two readings are missing in it.
        late: whether a frame tells what was before its message, as far as is known.
        doubted: whether the torques were found to be none in N·m; the work is unknown from then on.
    """

    def __init__(self) -> None:
        """No reading yet."""
        self.sum, self.unknown, self.doubted = 0.0, 0, False
        self._last: tuple[Reading, Vector] | None = None  # with the force of the message that it answers
        self.late = False
        self._seen = self._size = 0.0  # J: the sum of f^T dx in the same stretches, and of the sizes of its parts

    def take(self, now: Reading, f: Vector) -> None:
        """A reading, which answers a message of the force f (N)."""
        last, self._last = self._last, (now, f)
        if last is None:
            return
        before, held = last
        if not same(f, held) and now.force is not None:
            self.late = same(now.force, held)
        told = now if self.late else before
        dx = [b - a for a, b in zip(before.position, now.position, strict=True)]
        done = None
        if now.angles is not None and before.angles is not None and told.torques is not None:
            known = told.force is not None and same(told.force, held) and (any(told.torques) or not any(held))
            if known:
                turns = zip(told.torques, before.angles, now.angles, strict=True)
                done = sum(t * (b - a) for t, a, b in turns)
        if done is None:
            self.unknown += 1
            return
        self.sum += done
        seen = [a * b for a, b in zip(held, dx, strict=True)]
        self._seen += sum(seen)
        self._size += sum(map(abs, seen))
        if self._size > ENOUGH and abs(self.sum - self._seen) > DOUBT * self._size:
            self.doubted = True

    def gap(self) -> None:
        """Readings are missing here: the work between the last one and the next is unknown."""
        self._last = None
        self.unknown += 1


def same(a: Vector, b: Vector) -> bool:
    """Whether two forces are the same, but for rounding."""
    return abs(a[0] - b[0]) <= SAME and abs(a[1] - b[1]) <= SAME and abs(a[2] - b[2]) <= SAME
