"""In which ticks an end of a wave link sends a wave.

A wave holds all before it, so an end may send one in every ``every`` ticks only. What is lost with the others is no
energy: between two waves the receiver plays a straight line, and by Jensen's inequality that never costs more than what
was sent (:mod:`manyhands.nodes.wave_link.play_out`). What it costs is time, ``every - 1`` ticks of the sender on
each way: on average a wave waits (every - 1)/2 ticks to be sent, and the play-out buffers as many, since it knows where
a straight line goes only when its end is there.

The ends of different links take turns, so that a world with many of them has the same work in each tick.
"""

from __future__ import annotations


class Turns:
    """The ticks n of one direction in which a wave is sent: the first of a life, and then every n = turn mod every.

    Attributes:
        every: ticks from one wave to the next; 1 for a wave in each.
    """

    __slots__ = ("_turn", "every")

    def __init__(self, every: int, turn: int) -> None:
        """Send a wave in one of ``every`` ticks; ends with the same ``turn`` send in the same ones."""
        self.every, self._turn = every, turn % every

    def sends(self, n: int) -> bool:
        """Whether the wave of tick n, counted from 1 on, is sent."""
        return n == 1 or (n - self._turn) % self.every == 0

    def latest(self, n: int) -> int:
        """The tick of the newest wave that was sent up to tick n; 0 for none."""
        return max(min(n, 1), n - (n - self._turn) % self.every)

    def after(self, n: int) -> int:
        """The tick of the first wave that is sent after tick n."""
        return n + self.every - (n - self._turn) % self.every if n > 0 else 1

    @property
    def depth(self) -> float:
        """The least mean depth at which a play-out never overtakes the newest wave, ticks of the sender."""
        return 0.5 * (self.every - 1)
