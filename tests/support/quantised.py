"""Hands that look for energy in a linear loop whose devices round what they measure.

The loop is V and E of a certificate, closed by the rounded displacements, with forces that act up to tau after their
samples. A device burns exactly Delta_D v^2 + c |v| along the motion, and not more. Many hands move at once, each by a
policy of its own; what they have been given is the work of the forces less what the devices burnt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.design.certificate import Certificate
from manyhands.design.models.statespace import Matrix
from manyhands.design.quantisation import closed, steps

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Hands:
    """How many hands search, for how long, and by which policies.

    Attributes:
        count: of hands.
        ticks: that each of them moves.
        seed: of their choices.
    """

    count: int = 96
    ticks: int = 300
    seed: int = 0


def most_given(certificate: Certificate, friction: Matrix, hands: Hands, speed: float = np.inf) -> float:
    """The most that any hand was given at any instant, J; 0 for the hand that stays where it is.

    Args:
        certificate: of the loop; its devices state steps.
        friction: c by port, N, that the devices burn.
        hands: who search.
        speed: m/s, that no axis exceeds at any instant.
    """
    loop = certificate.loop
    V, E = loop.partition.join(certificate.blocks), loop.cut.environment.environment(loop.period)
    Y, q, T = closed(V, E), steps(loop), loop.period
    m, B = len(loop.ports), hands.count
    Delta = np.zeros((m, m))
    for device in loop.devices:
        Delta[np.ix_(device.ports, device.ports)] = device.level
    rng = np.random.default_rng(hands.seed)
    hand = _Policies(rng, B, m, np.where(q > 0.0, q, np.max(q)), friction, np.diag(Delta), T)
    x, old = np.zeros((B, m)), np.zeros((B, m))
    state, given, most = np.zeros((B, Y.order)), np.zeros(B), np.zeros(B)
    for k in range(hands.ticks):
        measured = np.where(q > 0.0, np.floor(x / np.where(q > 0.0, q, 1.0) + 0.5) * q, x)
        force = -(state @ Y.C.T + measured @ Y.D.T)
        state = state @ Y.A.T + measured @ Y.B.T
        late = loop.tau * rng.choice([0.0, 0.5, 1.0], size=B)
        for f, h in ((old, late), (force, T - late)):
            most_far = np.where(h > 0.0, speed * np.maximum(h, 1e-12), 0.0)[:, None]
            d = np.clip(hand.moves(k, x, f, force, h), -most_far, most_far)
            burnt = np.einsum("bi,ij,bj->b", d, Delta, d) / np.where(h > 0.0, h, 1.0) + np.abs(d) @ friction
            given += np.einsum("bi,bi->b", f, d) - burnt
            x = x + d
            most = np.maximum(most, given)
        old = force
    return float(np.max(most))


class _Policies:
    """The policy of each hand: rock over an edge of a step, follow the force, swing, or wander."""

    def __init__(
        self, rng: np.random.Generator, B: int, m: int, q: Floats, friction: Floats, Delta: Floats, T: float
    ) -> None:
        self._rng, self._q, self._friction, self._Delta, self._T = rng, q, friction, Delta, T
        self._kind = rng.integers(0, 4, size=B)
        self._moving = rng.random((B, m)) < 0.7  # some axes rest
        self._moving[np.arange(B), rng.integers(0, m, size=B)] = True
        self._edge = (rng.integers(0, 20, size=(B, m)) * rng.integers(0, 2, size=(B, 1)) + 0.5) * q
        self._width = q * 10.0 ** rng.uniform(-4.0, 0.0, size=(B, 1))
        self._pace = q * 10.0 ** rng.uniform(-2.3, -0.5, size=(B, 1))
        self._turn = rng.integers(1, 4, size=(B, 1))
        self._phase = rng.integers(0, 2, size=(B, m))
        self._gain = rng.uniform(0.1, 1.3, size=(B, 1))
        self._omega = 10.0 ** rng.uniform(-2.5, 0.4, size=(B, 1))
        self._reach = q * 10.0 ** rng.uniform(-0.5, 3.5, size=(B, 1))

    def moves(self, k: int, x: Floats, f: Floats, new: Floats, h: Floats) -> Floats:
        """The displacements over the next time h, while the force f is exerted."""
        best = np.sign(f) * np.maximum(np.abs(f) - self._friction, 0.0) / (2.0 * self._Delta)
        side = np.where((k // self._turn + self._phase) % 2 == 0, 1.0, -1.0)
        rock = self._edge + side * self._width - x
        far = np.abs(rock) > 3.0 * self._width  # slowly to the edge: what is burnt on the way has to be regained
        rock = np.where(far, np.clip(rock, -self._pace, self._pace), rock) * (h / self._T)[:, None]
        swing = self._reach * (np.sin(self._omega * (k + 1)) - np.sin(self._omega * k)) * (h / self._T)[:, None]
        wander = self._width * self._rng.standard_normal(x.shape)
        ways = np.stack([rock, self._gain * best * h[:, None], swing, wander])
        own = ways[self._kind, np.arange(len(x))]
        return np.where(self._moving, own, 0.0)
