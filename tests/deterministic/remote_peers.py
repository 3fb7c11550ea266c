"""What others do about delay between a user and an environment, as both ends of a line of one port.

Each scheme is a user's end and a world's end, as :mod:`tests.deterministic.remote` asks for them. They have the same
device, coupling and environment as the wave link.

- *naive*: the newest position and the newest force, held.
- *last held*, *zeroing*: waves [Niemeyer1991]_; where no new wave has come, the last one again, or none.
- *PSPM*: passive set-position modulation, by D. Lee and K. Huang (2010). A spring K and a damper B pull each end to the
  position ybar that was received. A new position y that would store more energy in the spring than the reservoir E has
  is replaced by the nearest that does not,

      K/2 (x - ybar)^2 - K/2 (x - ybar_before)^2 <= E,      E += B dx^2/T - (that difference) + what was received,

  and what exceeds the ceiling of E goes to the other end.
- *TDPA*: time-domain passivity with delay [Ryu2010]_, without compensation of drift. Each end adds up the energy that
  enters the network there, and sends the sum. An end may give off no more than the newest sum received. A damper in
  series with the force takes up the rest at the user (f - alpha w), and one in series with the motion at the world
  (w + beta f), one tick later.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from .remote import T

Floats = list[float]
Ends = Callable[[float, np.ndarray], tuple[Any, Any]]


class End:
    """One end: the newest message that was received, of the form (n, values)."""

    def __init__(self, period: float, D_V: np.ndarray) -> None:
        self.T, self.D_V, self.D = period, D_V, float(D_V[0, 0])
        self.n, self.newest = 0, -1
        self.values: tuple[float, ...] = (0.0, 0.0)
        self.sent: tuple[float, ...] = (0.0, 0.0)
        self.fresh = False
        self.x, self.p = 0.0, 0.0

    def hear(self, n: int, values: tuple[float, ...]) -> None:
        """Take a message, if it is newer than all before."""
        if n > self.newest:
            self.newest, self.values, self.fresh = n, values, True

    def message(self) -> tuple[int, tuple[float, ...]]:
        """What was sent last, with its tick."""
        self.n += 1
        return self.n, self.sent


class NaiveUser(End):
    """Sends p, receives f."""

    def step(self, p: Floats) -> Floats:
        """The newest force."""
        self.sent = (p[0],)
        return [self.values[0]]


class NaiveWorld(End):
    """Sends f, receives p."""

    def tool(self) -> Floats:
        """The newest position."""
        return [self.values[0]]

    def step(self, f: Floats) -> None:
        """Take the environment's force."""
        self.sent = (f[0],)


def naive(period: float, D_V: np.ndarray) -> tuple[End, End]:
    """Position and force as they are."""
    return NaiveUser(period, D_V), NaiveWorld(T, D_V)


class WaveEnd(End):
    """Waves of one sample each; ``zeroing`` where nothing new has come."""

    def __init__(self, period: float, D_V: np.ndarray, b: float, zeroing: bool) -> None:
        super().__init__(period, D_V)
        self.b, self.h, self.zeroing = b, math.sqrt(2.0 * b), zeroing

    def incoming(self) -> float:
        """The wave c of this tick."""
        fresh, self.fresh = self.fresh, False
        self.c = 0.0 if self.zeroing and not fresh else self.values[0]
        return self.c


class WaveUser(WaveEnd):
    """The user's end."""

    def step(self, p: Floats) -> Floats:
        """f_c for p."""
        c = self.incoming()
        f = (self.h * c - self.b * (p[0] - self.x) / self.T) / (1.0 + self.b * self.D / self.T)
        self.x = p[0] + self.D * f
        self.sent = (c - 2.0 * f / self.h,)
        return [f]


class WaveWorld(WaveEnd):
    """The world's end."""

    def tool(self) -> Floats:
        """The free position p of a coupling with D_V = T/b."""
        self.p = self.x + self.D * self.h * self.incoming()
        return [self.p]

    def step(self, f: Floats) -> None:
        """Take the environment's force."""
        self.x = self.p + self.D * f[0]
        self.sent = (self.c + 2.0 * f[0] / self.h,)


def classic(b: float, zeroing: bool) -> Ends:
    """Waves of the impedance b, N*s/m."""

    def ends(period: float, D_V: np.ndarray) -> tuple[End, End]:
        return WaveUser(period, D_V, b, zeroing), WaveWorld(T, np.array([[T / b]]), b, zeroing)

    return ends


class SetPosition(End):
    """One end of PSPM; ``direct``, for its spring and damper are the coupling."""

    direct = True

    def __init__(self, period: float, K: float, B: float, E_0: float) -> None:
        super().__init__(period, np.array([[1.0 / (K + B / period)]]))
        self.K, self.B, self.E, self.most = K, B, E_0, E_0
        self.ybar = self.shipped = self.heard = 0.0

    def modulate(self, x: float, before: float) -> None:
        """Take in the energy of the motion and of the message, and move ybar as far as that pays for it."""
        self.E += self.B * (x - before) ** 2 / self.T
        if self.fresh:
            self.fresh = False
            y, G = self.values
            self.E += G - self.heard
            self.heard = G
            old = (x - self.ybar) ** 2
            reach = math.sqrt(max(0.0, 2.0 * self.E / self.K + old))
            self.ybar = x + max(-reach, min(reach, y - x))
            self.E = max(0.0, self.E - 0.5 * self.K * ((x - self.ybar) ** 2 - old))
        over = max(0.0, self.E - self.most)
        self.E -= over
        self.shipped += over


class SetPositionUser(SetPosition):
    """The user's end; it is given the device's own position."""

    def step(self, x: Floats) -> Floats:
        """The force on the device."""
        self.modulate(x[0], self.x)
        f = -self.K * (x[0] - self.ybar) - self.B * (x[0] - self.x) / self.T
        self.x = x[0]
        self.sent = (self.x, self.shipped)
        return [f]


class SetPositionWorld(SetPosition):
    """The world's end, which carries the tool."""

    def tool(self) -> Floats:
        """The tool's position without the environment's force."""
        self.p = (self.K * self.ybar + self.B / self.T * self.x) * self.D
        return [self.p]

    def step(self, f: Floats) -> None:
        """Take the environment's force."""
        before, self.x = self.x, self.p + self.D * f[0]
        self.modulate(self.x, before)
        self.sent = (self.x, self.shipped)


def pspm(K: float, B: float, E_0: float) -> Ends:
    """PSPM with a spring K, N/m, and a damper B, N*s/m, at each end, and reservoirs of at most E_0, J."""

    def ends(period: float, D_V: np.ndarray) -> tuple[End, End]:
        return SetPositionUser(period, K, B, E_0), SetPositionWorld(T, K, B, E_0)

    return ends


class TimeDomainUser(End):
    """Sends (x, energy in); receives (f, energy in). ``direct``, for the coupling is at the other end."""

    direct = True
    entered = left = 0.0

    def step(self, x: Floats) -> Floats:
        """The force on the device."""
        f, budget = self.values
        moved = x[0] - self.x
        budget = max(0.0, budget - self.left)
        if f * moved > budget:  # f - alpha w, with the least alpha at which no more leaves
            f = budget / moved
        energy = f * moved
        self.left += max(0.0, energy)
        self.entered += max(0.0, -energy)
        self.x = x[0]
        self.sent = (self.x, self.entered)
        return [f]


class TimeDomainWorld(End):
    """Sends (f, energy in); receives (x, energy in). A spring K and a damper B lead from the position to the tool."""

    entered = left = damped = 0.0
    beta = force = commanded = at = before = 0.0

    def __init__(self, K: float, B: float) -> None:
        super().__init__(T, np.array([[1.0 / (K + B / T)]]))
        self.B = B

    def tool(self) -> Floats:
        """The tool's position without the environment's force."""
        self.moved = self.values[0] - self.commanded
        self.commanded = self.values[0]
        self.before, self.at = self.at, self.at + self.moved + T * self.beta * self.force
        self.p = self.at + self.D * self.B / T * (self.x - self.before)
        return [self.p]

    def step(self, f: Floats) -> None:
        """Take the environment's force, and choose the damper of the next tick."""
        force = f[0]
        self.damped += force * T * self.beta * self.force
        energy = force * self.moved
        self.entered += max(0.0, energy)
        self.left += max(0.0, -energy)
        lacking = self.left - self.values[1] - self.damped
        self.beta = lacking / (T * force * force) if lacking > 0.0 and abs(force) > 1e-3 else 0.0
        self.beta = min(self.beta, SHARE * self.D / T)
        self.x, self.force = self.p + self.D * force, force
        self.sent = (force, self.entered)


SHARE = 0.5
"""How much of the force one tick of the damper at the world's end may take away; beyond 1 the force turns round."""


def tdpa(K: float, B: float) -> Ends:
    """TDPA with one coupling, a spring K, N/m, and a damper B, N*s/m, at the world's end."""

    def ends(period: float, D_V: np.ndarray) -> tuple[End, End]:
        return TimeDomainUser(period, D_V), TimeDomainWorld(K, B)

    return ends
