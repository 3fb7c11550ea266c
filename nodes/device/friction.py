"""Dry friction of a simulated device: a held mass that burns c |dx| besides its damping (:class:`DryPlant`).

**A step** is at most :data:`STEP` long, and has a constant force phi of friction on each axis. The plant is linear, so
that it moves in the step by dx = a + G phi: a is what it does without friction, and G its response to forces that are
held. phi is that of Coulomb's law between the ends of the step,

    phi_i = -c_i sign(dx_i),    or    |phi_i| <= c_i    where dx_i = 0.

Its work is phi^T dx = -sum c_i |dx_i|, exactly: friction never gives energy, and none comes from the integration. A
level c_i that changes with place and speed (:class:`FrictionCurve`) is that of the state in which the step begins. So
it is one number over a step, and no less than the least one. What is burned is at least the least c_i |dx_i| by that
alone, in every step and so over every way, however coarse the step is beside the curve. At rest the level is greatest.
An axis that has come to a stand so stands, until a force beyond its static friction moves it: nothing chatters. For a
symmetric positive G this phi is the one solution of a linear complementarity problem, which projected sweeps over the
axes find. Forces of one axis reach another through the hand alone, so that a few sweeps are enough.

**An axis that stands** (dx_i = 0) is stopped: what is left of its momentum is taken by friction as well. Without that
it would swing to and fro within each step, by some 10 nm.

The books stay exact: the impulse of friction follows the state, for the work of the hand's intention.

What a step does depends on where it begins and ends. So a driver in wall time ends one at each sample under a force,
and the books of the motion that it saw are those of the motion that was.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from manyhands.design.models.device import HeldDevice
from manyhands.nodes.device.simulated import Intention, Plant
from manyhands.nodes.kernel.arithmetic import Floats, Rows, minus, plus
from manyhands.nodes.kernel.friction_curve import FrictionCurve
from manyhands.protocol.clock import Duration, from_seconds, seconds

STEP: Final = from_seconds(500e-6)
"""The longest step, ns."""

_SETTLED: Final = 1e-15  # of c, by which a last sweep changes phi
_MOST_SWEEPS: Final = 100
_KNOWN: Final = 16  # lengths of steps whose responses are kept


class DryPlant(Plant):
    """A :class:`Plant` with dry friction; the impulse of friction so far, N*s by axis, follows its state."""

    def __init__(self, device: HeldDevice, T: float, friction: Sequence[float] | FrictionCurve) -> None:
        """Sample ``device`` with the period ``T``, s.

        Args:
            device: the device with its hand.
            T: period, s.
            friction: c by axis, N, or how it changes.

        Raises:
            ValueError: there is not one c for each axis.
        """
        super().__init__(device, T, parts=True)
        self.divides = True
        self._curve = friction if isinstance(friction, FrictionCurve) else None
        self._friction: Floats = list(friction.least if isinstance(friction, FrictionCurve) else friction)
        if len(self._friction) != self.axes:
            raise ValueError(f"friction: found {len(self._friction)} numbers; expected {self.axes}, one an axis")
        self._response = lru_cache(_KNOWN)(self._of_ones)

    def holding(self, x: Floats, v: Floats) -> Floats:
        """As of :class:`Plant`."""
        return [*super().holding(x, v), *[0.0] * self.axes]

    def after(self, before: Floats, f: Floats, intention: Intention, part: int | None = None) -> Floats:
        """The state after one period, or a part of it."""
        left = self._period if part is None else part
        inputs = plus(f, intention.force) + intention.velocity
        state = before
        for number in range(-(-left // STEP), 0, -1):
            h = left // number
            state = self._stepped(state, inputs, h)
            left -= h
        return state

    def seen(self, before: Floats, f: Floats, intention: Intention, part: int) -> Floats:
        """As :meth:`after`."""
        return self.after(before, f, intention, part)

    def work(self, before: Floats, after: Floats, f: Floats, intention: Intention, part: int | None = None) -> float:
        """The intention's work over a step of :meth:`after`, J; both states are whole."""
        n = self.order
        h = seconds(Duration(self._period if part is None else part))
        forces = [force * h for force in plus(f, intention.force)]
        return self._work_by(plus(forces, minus(after[n:], before[n:])), before, after, intention)

    def _stepped(self, before: Floats, inputs: Floats, h: int) -> Floats:
        """The state after a step of h ns."""
        assert self._parts is not None  # noqa: S101
        n, m, c = self.order, self.axes, self._levels(before)
        x = before[:m]
        after = self._parts.step(before[:n], inputs, h)
        responses = self._response(h)
        phi = _law(minus(after[:m], x), responses, c)
        for force, response in zip(phi, responses, strict=True):
            if force != 0.0:
                after = [at + force * by for at, by in zip(after, response, strict=True)]
        span = seconds(Duration(h))
        impulse = [so_far + force * span for so_far, force in zip(before[n:], phi, strict=True)]
        for axis in range(m):
            if abs(phi[axis]) < c[axis]:
                impulse[axis] -= self._mass[axis] * after[m + axis]
                after[axis], after[m + axis] = x[axis], 0.0
        return after + impulse

    def _levels(self, state: Floats) -> Floats:
        """The level c of each axis over a step that begins in ``state``, N."""
        curve, m = self._curve, self.axes
        return self._friction if curve is None else [curve.level(i, state[i], state[m + i]) for i in range(m)]

    def _of_ones(self, h: int) -> Rows:
        """By axis, the change of the state in h ns by a force of 1 N."""
        assert self._parts is not None  # noqa: S101
        n, m = self.order, self.axes
        ones = [[1.0 if axis == other else 0.0 for other in range(2 * m)] for axis in range(m)]
        return [self._parts.step([0.0] * n, one, h) for one in ones]


def _law(a: Floats, responses: Rows, c: Floats) -> Floats:
    """Coulomb's forces phi for a motion of a + G phi (m), N; ``responses`` begin with the rows of G."""
    m = len(a)
    phi = [0.0] * m
    for _ in range(_MOST_SWEEPS):
        change = 0.0
        for axis in range(m):
            own = responses[axis][axis]
            moves = a[axis] + sum([phi[other] * responses[other][axis] for other in range(m) if other != axis])
            force = max(-c[axis], min(c[axis], -moves / own))
            change = max(change, abs(force - phi[axis]) - _SETTLED * c[axis])
            phi[axis] = force
        if m == 1 or change <= 0.0:
            break
    return phi
