"""The force law of proxies: a spring from each tool to a position that a model proposes, under one test a tick.

A *proxy*, or god-object, is where a tool would be if it could not enter what it touches ([Ruspini1997]_,
[Ortega2007]_). A model proposes the proxies q(k), m, one number for each port, and the springs K = K^T > 0, N/m, pull:

    f(k) = -K e(k),     e = x - q,     x(k) = r(k) + D f(k),

with r and D of the tick (:mod:`manyhands.nodes.environment.enforced`). The loop is solved in closed form, so the force
belongs to the positions of its own tick:

    e = M (r - q),     M = (I + D K)^{-1},

which exists for every D with D + D^T >= 0, as K^{-1} + D is then regular.

**The test** (docs/decisions/0042-proxies.md). For any positions x and q, with d(k) = e(k) - e(k-1),

    -(x(k) - x(k-1))^T f(k) = 1/2 e^T K e - 1/2 e^T K e (k-1) + b(k),   b = 1/2 d^T K d + e^T K (q(k) - q(k-1)).

So the world promises the level Phi if B(k) = sum of b + T w^T Phi w, w = (x(k) - x(k-1))/T, never falls below 0. Where
the proposed q would make it, a part s of the step is taken instead. With s = 0 the proxy is held, and b is at least 0.
So a part always exists, and the greatest is a root in closed form. Nothing is assumed of the positions proposed.

**The tank.** A world that may give out energy of its own, as one with a load on it, has a tank of so many joules: B
begins there in place of 0. It counts as energy that is stored at the start, and the same test keeps it.

**Who is held.** With K, Phi and D block-diagonal in the parties (the couplings), b is a sum over the parties. Only the
proxies of parties whose own term is below 0 are held; the other parties' tools stay free. Otherwise all are held.

**What an engine feels.** An engine's avatar is at the proposed position, also while its proxy is held. So it is given
the force of the spring *there*, -f = K (x - q) at its own q, which leads it back to its tool.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.passivity import greatest_part

Vector = NDArray[np.float64]


class ProxyLaw:
    """The law f = -K (x - q), with the interface of :class:`manyhands.nodes.environment.enforced.ForceLaw`.

    Attributes:
        held: by party, the ticks in which the test shortened the step of its proxies.
        figures: always empty, for nothing else is counted.
    """

    def __init__(
        self,
        model: AskedModel,
        K: Vector,
        Phi: Vector | None,
        T: float,
        parties: Sequence[Sequence[int]],
        bodies: int = 0,
        tank: float = 0.0,
        oriented: int = 0,
    ) -> None:
        """Start at rest, with every tool and every proxy at 0.

        Args:
            model: proposes the proxies, and is asked once a tick.
            K: stiffness, m x m, symmetric positive definite, N/m.
            Phi: the level, m x m, symmetric positive semidefinite, N*s/m; None for 0.
            T: period, s.
            parties: the ports of each coupling.
            bodies: the number of bodies whose positions the model, an engine, reports.
            tank: what the world may give out beyond what it has received, at least 0, J.
            oriented: the number of them whose orientations it reports, too.

        Raises:
            ValueError: K is not symmetric positive definite, or Phi not symmetric positive semidefinite.
        """
        m = len(K)
        self._K = np.array(K, dtype=np.float64)
        self._Phi = np.zeros((m, m)) if Phi is None else np.array(Phi, dtype=np.float64)
        if not _definite(self._K, strict=True):
            raise ValueError("found a stiffness that is not symmetric positive definite; expected one that is")
        if not _definite(self._Phi, strict=False):
            raise ValueError("found a level with a negative eigenvalue; expected one of at least 0 for proxies")
        self._model, self._k, self._T, self._bodies, self._oriented = model, 0, T, bodies, oriented
        self._parties = [np.array(ports, dtype=np.intp) for ports in parties]
        owner = np.empty(m, dtype=np.intp)
        for party, ports in enumerate(self._parties):
            owner[ports] = party
        self._between = owner[:, None] != owner[None, :]
        self._apart = not (np.any(self._K[self._between]) or np.any(self._Phi[self._between]))
        self._separate = self._apart  # and D joins no parties either
        self._x, self._q, self._e = np.zeros(m), np.zeros(m), np.zeros(m)  # of the tick before
        self._next = self._q  # q of this tick
        self._proposed: Vector | None = None  # by the model for this tick, which is asked once
        self._shortened: list[int] = []  # the parties held in this tick
        self._total = self._budget = tank  # the tank with the energy received, and B, J
        self._felt = np.zeros(m)  # the force on the tools at the proposed positions, N, of the tick before
        self._compliance: Vector | None = None
        self._M, self._DK = self._K, self._K  # made with the first compliance
        self.held = [0] * len(self._parties)
        self.figures: Mapping[str, float] = {}

    @property
    def failure(self) -> str | None:
        """What was wrong with the model's first bad answer, from which on the proxies rest; None without one."""
        return self._model.failure

    @property
    def masses(self) -> Floats:
        """x, y and z of each reported body, m; empty without an engine."""
        return self._model.positions(self._bodies) if self._bodies else []

    @property
    def orientations(self) -> Floats:
        """The unit quaternion of each body whose orientation is reported; empty without any."""
        return self._model.orientations(self._oriented) if self._oriented else []

    def press(self, pressed: int) -> None:
        """Tell the model, where it asks for buttons."""
        self._model.press(pressed)

    def propose(self, r: Vector, compliance: Vector, x_e: Vector) -> Vector:
        """The springs' forces, N; the model is asked at the ``r`` of the tick's first call, its later calls reuse q."""
        if compliance is not self._compliance:
            self._compliance, self._DK = compliance, compliance @ self._K
            self._M = np.asarray(np.linalg.inv(np.eye(len(r)) + self._DK), dtype=np.float64)
            self._separate = self._apart and not np.any(compliance[self._between])
        if self._proposed is None:
            found = self._model.proxies(r.copy(), self._felt.copy(), self._k)
            self._proposed = self._q if found is None else found
        q = self._proposed
        e = self._M @ (r - q)
        gains = self._gains(r, e, q - self._q)
        self._shortened = []
        if self._budget + float(gains.sum()) < 0.0:
            q = self._kept(r, q - self._q, gains)
            e = self._M @ (r - q)
        self._next = q
        f: Vector = -(self._K @ e)
        return f

    def advance(self, x_e: Vector, f: Vector) -> None:
        """Step to the next tick, with the tools at x_e(k), m, under the forces f_e(k), N.

        B is what was exerted and moved in fact, less the springs' energy. As a sum of b it would drift by rounding.
        """
        e, w = x_e - self._next, (x_e - self._x) / self._T
        self._total += float(self._T * (w @ self._Phi @ w) - (x_e - self._x) @ f)
        self._budget = self._total - 0.5 * float(e @ self._K @ e)
        for party in self._shortened:
            self.held[party] += 1
        # while nothing is held, the avatar is at the proxy, and feels f to the last bit
        self._felt = f
        if self._shortened and self._proposed is not None:
            self._felt = f + self._K @ (self._proposed - self._next)
        self._x, self._q, self._e = x_e, self._next, e
        self._proposed, self._shortened = None, []
        self._k += 1

    def _gains(self, r: Vector, e: Vector, step: Vector) -> Vector:
        """What each port adds to B under the deflections e with proxies that move by ``step``, J."""
        d = e - self._e
        w = (r - self._DK @ e - self._x) / self._T
        gains: Vector = 0.5 * d * (self._K @ d) + step * (self._K @ e) + self._T * w * (self._Phi @ w)
        return gains

    def _kept(self, r: Vector, step: Vector, gains: Vector) -> Vector:
        """The proxies of this tick, m: of those whose party would overdraw B, only the part of the step that keeps it.

        The sum of b over a part s of their step is c + a s - b s^2, and it is not below 0 at s = 0.
        """
        K, Phi, T = self._K, self._Phi, self._T
        self._shortened = [
            party for party, ports in enumerate(self._parties) if not self._separate or gains[ports].sum() < 0.0
        ]
        short = np.zeros_like(step)
        for party in self._shortened:
            short[self._parties[party]] = step[self._parties[party]]
        free = step - short  # K joins it to no port of short
        e = self._M @ (r - self._q - free)  # at s = 0
        by = self._M @ short  # e falls by s times this, and the tools move by s D K times it
        moved = self._DK @ by / T
        w = (r - self._DK @ e - self._x) / T
        d = e - self._e
        c = self._budget + float(0.5 * (d @ K @ d) + e @ K @ free + T * (w @ Phi @ w))
        a = float(-(d @ K @ by) + e @ K @ short + 2.0 * T * (w @ Phi @ moved))
        b = float(by @ K @ short - 0.5 * (by @ K @ by) - T * (moved @ Phi @ moved))
        kept: Vector = self._q + free + greatest_part(a, b, max(c, 0.0)) * short
        return kept


def _definite(matrix: Vector, strict: bool) -> bool:
    """Whether a matrix is symmetric and positive definite, or semidefinite up to rounding."""
    if not np.array_equal(matrix, matrix.T):
        return False
    values = np.linalg.eigvalsh(matrix)
    return bool(values[0] > 0.0 if strict else values[0] >= -1e-12 * max(abs(values[-1]), 1.0))
