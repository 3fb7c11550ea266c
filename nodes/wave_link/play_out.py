"""When an incoming wave is played: the sender's time line, at a depth, across gaps and outages.

A receiver knows the sum U of the other face's waves at the ticks n of the messages that it has heard, newest only. It
plays the sum, so nothing is lost with a message. The position nu on the sender's time line moves at the sender's rate,
+-2 %, so that its distance to the newest message (the *depth*, in ticks of the sender) stays near the one wanted.
Between two messages the sum is a straight line; by Jensen's inequality that never costs more than what was sent. Beyond
the newest it goes on with its last slope, for at most :data:`HOLD_AFTER` seconds.

Why a time line: a constant force is a constant wave, of power f^2/(4b). Whoever plays it at a varying rate pays
half the variance more than was sent, and the missing energy becomes a creep of the tool.
"""

from __future__ import annotations

import math
from collections import deque
from heapq import heapreplace
from typing import Final, TypeAlias

from manyhands.nodes.kernel.arithmetic import Floats, dot, minus

HOLD_AFTER: Final = 0.03
"""Time beyond the newest message after which a face holds the tool, s."""

_MOST: Final = 0.02  # greatest part by which the rate differs from the sender's
_PULL: Final = 0.5  # time in which the rate makes up for a wrong depth, s
_MEAN: Final = 0.1  # time constant of the mean depth, s
_ASTRAY: Final = 0.25  # distance from the depth wanted that is jumped and not run, s
_SPAN: Final = 0.005  # least time over which the last slope is taken, s

_Known: TypeAlias = tuple[int, Floats, float]
"""A message that was heard: n, U, and what the straight way from the one before costs, J."""

_NOTHING: Final[Floats] = []


class PlayOut:
    """The time line of one incoming direction.

    Attributes:
        depth: the depth wanted, ticks of the sender.
        starved: whether nothing can be played: nothing was heard yet, or for too long.
        first: U of the first message, W^(1/2)*s; empty before it.
        jumped: whether the last :meth:`advance` moved nu by a jump.
        newest: n of the newest message; -1 before the first.
    """

    __slots__ = (
        "_ahead",
        "_fresh",
        "_gain",
        "_hold_after",
        "_latest",
        "_mean",
        "_misplaced",
        "_nominal",
        "_nu",
        "_passed",
        "_period",
        "_recent",
        "_since",
        "_span",
        "_start",
        "_ticks",
        "_total",
        "_weight",
        "depth",
        "first",
        "jumped",
        "newest",
        "starved",
    )

    def __init__(self, T: float, sender_T: float, depth: float) -> None:
        """Nothing heard.

        Args:
            T: the receiver's period, s.
            sender_T: the sender's period, s.
            depth: ticks of the sender by which nu stays behind the newest message, in the mean.
        """
        self._period = sender_T
        self._nominal = T / sender_T
        self._weight = T / _MEAN
        self._gain = sender_T / _PULL
        self._hold_after = HOLD_AFTER / sender_T
        self._span = max(1.0, _SPAN / sender_T)
        self.depth = depth
        self.renew()

    def renew(self) -> None:
        """Forget all that was heard; a new life begins."""
        self.newest, self.first = -1, _NOTHING
        self.starved, self.jumped = True, False
        self._fresh = self._misplaced = False  # whether a message came, or place was called, since the last advance
        self._nu = self._mean = 0.0
        self._passed: _Known = (0, _NOTHING, 0.0)  # the last message before nu
        self._ahead: deque[_Known] = deque()  # the messages beyond nu
        self._since = self._recent = self._passed  # the slope beyond the newest is the one from _since on
        self._ticks = 0  # since measure was called; 0 if it was not
        self._start = 0
        self._total = 0.0  # of how late messages were since then, ticks of the sender
        self._latest: list[float] = []  # the greatest of these, as a heap: the least of them comes first

    def hear(self, n: int, U: Floats) -> None:
        """Take the sum U of tick n, which is newer than all before; U is kept."""
        known: _Known = (n, U, 0.0)
        if self.newest < 0:
            self._passed = self._since = self._recent = known
            self.first = U
            self._nu, self._mean = n - self.depth - self._nominal, self.depth
        else:
            last, before, _ = self._ahead[-1] if self._ahead else self._passed
            way = minus(U, before)
            cost = dot(way, way) / (2.0 * (n - last) * self._period)
            known = (n, U, cost)
            self._ahead.append(known)
            if n - self._recent[0] >= self._span:
                self._since, self._recent = self._recent, known
        self.newest = n
        self._fresh = True

    def advance(self) -> Floats:
        """Move on by one tick of the receiver, and return the sum at nu; before the first message it is empty."""
        newest = self.newest
        if newest < 0:
            return _NOTHING
        fresh, self._fresh = self._fresh, False
        nu = self._nu + self._nominal
        lag = newest - nu
        astray = (lag - self.depth) * self._period > _ASTRAY or lag < -self._hold_after
        self.jumped = self._misplaced or (fresh and astray)
        self._misplaced = False
        if self.jumped:
            nu = newest - self.depth
        if self.jumped or self.starved:
            # in a silence nu runs on at the sender's rate, so that it is right when messages come again
            self._mean = self.depth
        else:
            self._mean += self._weight * (lag - self._mean)
            nu += self._nominal * max(-_MOST, min(_MOST, self._gain * (self._mean - self.depth)))
        self._nu = nu
        self.starved = nu > newest + self._hold_after
        if self._ticks:
            self._measure()
        return self._sum(nu)

    def run_on(self, ticks: int) -> None:
        """Move nu on by so many ticks of the receiver without playing them; a measurement begins again."""
        self._nu += ticks * self._nominal
        if self._ticks:
            self.measure(len(self._latest) - 1)

    def place(self, depth: float) -> None:
        """Change the depth wanted; nu jumps there."""
        self.depth, self._misplaced = depth, True

    @property
    def owed(self) -> float:
        """What the waves cost that were heard and not played yet, J: the sum over the queue, made anew each time.

        A running sum would keep the rounding of waves that have long been played, and theirs may be greater than
        anything that waits now.
        """
        owed = 0.0
        for _, _, cost in self._ahead:
            owed += cost
        return owed

    def lag(self) -> float:
        """How far nu is behind the newest message, ticks of the sender."""
        return self.newest - self._nu

    def measure(self, outliers: int = 0) -> None:
        """Begin to measure how late messages are, except in so many ticks; :meth:`measured` has the result."""
        self._ticks, self._start, self._total = 1, self.newest, 0.0
        self._latest = [-math.inf] * (outliers + 1)

    def measured(self) -> float:
        """The depth at which no message since :meth:`measure` would have come too late, except its outliers; ticks of
        the sender.
        """
        least = min((late for late in self._latest if late > -math.inf), default=0.0)
        return max(0.0, least - self._total / (self._ticks - 1) + 1.0) if self._ticks > 1 else 0.0

    def _measure(self) -> None:
        late = self._ticks * self._nominal - (self.newest - self._start)
        self._ticks += 1
        self._total += late
        if late > self._latest[0]:
            heapreplace(self._latest, late)

    def _sum(self, nu: float) -> Floats:
        """The sum at nu; nu does not fall."""
        ahead = self._ahead
        while ahead and ahead[0][0] <= nu:
            self._passed = ahead.popleft()
        n, U, _ = self._passed
        if ahead:
            part = max(0.0, (nu - n) / (ahead[0][0] - n))
            return [at + part * (to - at) for at, to in zip(U, ahead[0][1], strict=True)]
        start, before, _ = self._since
        if n == start:
            return U
        part = min(max(0.0, nu - n), self._hold_after) / (n - start)
        return [at + part * (at - come) for at, come in zip(U, before, strict=True)]
