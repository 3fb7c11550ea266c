"""What a site can do at most: an honest face is never refused, and no other face makes a tool do more."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.kernel.bundle import WaveEnd
from manyhands.nodes.kernel.site_bounds import SiteBounds, site_bounds
from manyhands.nodes.wave_link import UserFace, WorldFace
from manyhands.nodes.wave_link.ends import wave_bounds
from manyhands.protocol.codec import encode
from manyhands.protocol.gate import WaveGate
from manyhands.protocol.messages import Wave

from ..wave_link.hostile import impedance

T = 1e-3


def test_the_bounds_follow_from_the_limits() -> None:
    """b S + F = 48 N are 48/sqrt(40) W^(1/2); the gap at a round trip of 1 s is F/2b = 0.2 m."""
    bounds = site_bounds(np.array([[20.0]]), [8.0], [2.0], [0.25], 3.2, T)
    assert bounds.wave == pytest.approx((48.0 / math.sqrt(40.0),))
    assert bounds.place == pytest.approx((0.45,))
    assert bounds.power == pytest.approx(28.8)


def test_no_tick_costs_more_than_a_quarter_of_the_budget() -> None:
    bounds = site_bounds(np.diag([20.0, 60.0]), [1000.0] * 2, [100.0] * 2, [math.inf] * 2, 2.0, T)
    assert T * bounds.power == pytest.approx(0.5)
    assert all(math.isfinite(place) for place in bounds.place)


@given(
    seed=st.integers(0, 2**32 - 1),
    m=st.integers(1, 3),
    force=st.floats(0.5, 50.0),
    speed=st.floats(0.05, 5.0),
    wild=st.sampled_from([0.1, 1.0, 10.0, 1e3]),
    loss=st.floats(0.0, 0.8),
)
def test_an_honest_faces_waves_are_never_refused(
    seed: int, m: int, force: float, speed: float, wild: float, loss: float
) -> None:
    """Whatever its own device or world does, and whichever waves are lost: the face keeps to the bounds by itself."""
    rng = np.random.default_rng(seed)
    b = impedance(rng, m)
    periods = T * 2.0 ** int(rng.integers(-2, 2)), T * 2.0 ** int(rng.integers(-2, 2))
    bounds = site_bounds(b, [force] * m, [speed] * m, [0.2] * m, 5.0, periods[1])
    user = UserFace(b, 1e-5 * np.eye(m), *periods, 2.0, E_0=0.005, bounds=bounds)
    world = WorldFace(b, *periods[::-1], 2.0, E_0=0.005, bounds=bounds)
    gates = [
        WaveGate(m, bounds=wave_bounds(WaveEnd(b, None, 0.005, period, bounds=bounds))) for period in periods
    ]  # of what the user sends, and of what the world sends
    x, f = np.zeros(m), np.zeros(m)
    for _ in range(150):
        x = x + wild * speed * T * rng.normal(size=m)
        f = wild * force * rng.normal(size=m)
        if rng.random() < 0.05:
            user.skip(int(rng.integers(1, 30)))
        user.step(x.tolist())
        world.tool()
        if world.aligned:
            world.step(f.tolist())
        for face, other, gate, back in ((user, world, *gates), (world, user, *gates[::-1])):
            if rng.random() < loss or not (face is user or world.aligned):
                continue
            sent = face.message()
            n, U, G = sent.n, sent.U, sent.G
            back.granted = G
            wave = gate.admitted(encode(Wave(n, U, G)))
            assert wave is not None or gate.dropped["out_of_range"] == 0
            if wave is not None:
                other.hear(n, U, G)


@given(seed=st.integers(0, 2**32 - 1), m=st.integers(1, 3), size=st.sampled_from([1e-2, 1.0, 1e3, 1e6, 9e11]))
def test_a_tool_has_the_bounds_of_its_site_whatever_is_heard(seed: int, m: int, size: float) -> None:
    """A free tool: no faster than its greatest wave moves it, and no further than its place."""
    rng = np.random.default_rng(seed)
    b = impedance(rng, m)
    bounds = SiteBounds((5.0,) * m, (0.3,) * m)
    face = WorldFace(b, T, T, 2.0, E_0=10.0, bounds=bounds)
    before = None
    for n in range(1, 200):
        G = 1e9 if n > 3 else 0.0
        face.hear(n, (size * rng.normal(size=m) if n > 1 else np.zeros(m)).tolist(), G)
        p = face.tool()
        face.step([0.0] * m)
        assert all(abs(wave) <= 5.0 * (1.0 + 1e-12) for wave in face.wave)
        assert all(abs(at) <= 0.3 + 1e-9 for at in p)
        if before is not None:
            energy = 0.5 * T * float(np.dot(face.wave, face.wave))
            assert energy <= T * bounds.power * (1.0 + 1e-12)
        before = p


def test_without_bounds_nothing_is_kept_from_a_face() -> None:
    assert wave_bounds(WaveEnd(np.array([[20.0]]), None, 0.005, T)) is None


@pytest.mark.parametrize("wrong", [((1.0,), (1.0, 2.0)), ((0.0,), (1.0,)), ((1.0,), (math.nan,))])
def test_bounds_are_positive_and_as_many_as_ports(wrong: tuple[tuple[float, ...], tuple[float, ...]]) -> None:
    with pytest.raises(ValueError, match=r"found .*; expected"):
        SiteBounds(*wrong)
