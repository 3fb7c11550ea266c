"""Theorem 3 of docs/remote/proof.md is attained: K = 2b/R against a wall, M = bR/2 of a free end."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.nodes.wave_link import Sums, UserFace, WorldFace
from tests.support.cases import cases

from .hostile import impedance

T = 1e-3


class CleanLine:
    """Both faces with equal periods, a whole number of ticks apart, and a wall or nothing at the world's end."""

    def __init__(self, b: np.ndarray, up: int, down: int, depth: float, smoothing: float, wall: bool) -> None:
        m = len(b)
        self.user = UserFace(b, 1e-7 * np.eye(m), T, T, depth, E_0=10.0, smoothing=smoothing)
        self.world = WorldFace(b, T, T, depth, E_0=10.0, smoothing=smoothing)
        self.wall = np.linalg.inv(self.world.D_V) if wall else np.zeros((m, m))
        self.up: deque[Sums] = deque(maxlen=up)
        self.down: deque[Sums] = deque(maxlen=down + 1)
        self.R = (up + down) * T + self.user.latency + self.world.latency
        self.x_e = np.zeros(m)

    def tick(self, p: np.ndarray) -> np.ndarray:
        """f_c(k) for the user's p(k); the world's tick k comes before the user's."""
        if len(self.up) == self.up.maxlen:
            self.world.hear(*self.up[0])
        at = np.array(self.world.tool())
        f = -self.wall @ at
        self.world.step(f.tolist())
        self.x_e = at + self.world.D_V @ f
        if self.world.aligned:
            self.down.append(self.world.message())
        if len(self.down) == self.down.maxlen:
            self.user.hear(*self.down[0])
        f_c = np.array(self.user.step(p.tolist()))
        self.up.append(self.user.message())
        return f_c


LINES = {
    "seed": st.integers(0, 2**32 - 1),
    "m": st.integers(1, 3),
    "up": st.integers(1, 30),
    "down": st.integers(0, 30),
    "depth": st.integers(0, 10),
    "smoothing": st.floats(1.0, 3.0),
}


def felt(line: CleanLine, motion: Callable[[int], np.ndarray]) -> np.ndarray:
    """The mean force in the last four periods of the line, N; it is lossless, so the force swings about its mean."""
    for _ in range(200):
        line.tick(motion(0))
    forces = [line.tick(motion(k)) for k in range(1500)]
    period = 2 * round(line.R / T)
    return np.mean(forces[-4 * period :], axis=0)


@settings(max_examples=cases(20, 100))
@given(**LINES)
def test_a_wall_feels_like_a_spring_of_2b_over_R(
    seed: int, m: int, up: int, down: int, depth: int, smoothing: float
) -> None:
    rng = np.random.default_rng(seed)
    b = impedance(rng, m)
    line = CleanLine(b, up, down, depth, smoothing, wall=True)
    x = 1e-3 * rng.normal(size=m)
    f = felt(line, lambda k: min(1.0, k / 200.0) * x)
    assert line.x_e == pytest.approx(0.0, abs=1e-12)
    expected = -2.0 * b / line.R @ x
    assert np.linalg.norm(f - expected) <= 0.05 * np.linalg.norm(expected)


@settings(max_examples=cases(20, 100))
@given(**LINES)
def test_a_free_end_feels_like_a_mass_of_bR_over_2(
    seed: int, m: int, up: int, down: int, depth: int, smoothing: float
) -> None:
    rng = np.random.default_rng(seed)
    b = impedance(rng, m)
    line = CleanLine(b, up, down, depth, smoothing, wall=False)
    acceleration = 0.1 * rng.normal(size=m)
    f = felt(line, lambda k: 0.5 * acceleration * (k * T) ** 2)
    expected = -b * line.R / 2.0 @ acceleration
    assert np.linalg.norm(f - expected) <= 0.05 * np.linalg.norm(expected)
