"""A remote user over every kind of network: passive, without a creep, and the tools together again at rest."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.support.cases import cases

from .network import KINDS, Channel, Path
from .remote import EXAMPLE_1, Remote, RemoteSession, waves
from .remote_peers import naive

V = (1110.2, 0.2598)
"""Stiffness (N/m) and damping (N*s/m) of the couplings, those of example1.yaml."""

E_0 = 0.02
THETA = (0.4, 0.3)


def linked(path: Path, depth: float, b: float = 20.0, E_0: float = E_0, **options: Any) -> Remote:
    """A user behind a wave link, with what Example 1's certificate leaves as harvest."""
    ends = waves(
        b,
        depth,
        E_0=E_0,
        user={"theta": np.array([[THETA[0]]])},
        world={"theta": np.array([[THETA[1]]])},
    )
    return Remote(path, path, ends, theta=THETA, **options)


@pytest.mark.parametrize("ppm", [100.0, -100.0])
@pytest.mark.parametrize(
    ("path", "depth", "gap"),
    [
        (Path(0.02, 0.1, "uniform", 0.1, 0.05), 25.0, 1e-4),
        (Path(0.02, 0.04, "lumps", 0.1, 0.05), 40.0, 1e-3),
        (Path(0.05, 0.005, "machine", 0.01, outages=((0.8, 1.0), (1.5, 2.5))), 5.0, 1e-4),
        (Path(0.001, 0.0, rate=400.0), 5.0, 2e-4),  # a queue of 200 ms fills and empties both tanks
    ],
    ids=["jitter", "lumps", "dead", "thin"],
)
def test_a_remote_user_is_passive_and_the_tools_come_together(path: Path, depth: float, gap: float, ppm: float) -> None:
    session = RemoteSession([linked(path, depth, ppm=ppm), None, None], V, seed=3).run(cases(6, 12))
    user = session.users[0]
    assert session.diverged is None
    assert user.least >= -2.0 * E_0 - 1e-9
    assert abs(user.trace.gap[-1]) < gap
    assert max(abs(one.device.v) for one in session.users) < 5e-3


def test_without_a_link_the_same_delay_diverges() -> None:
    path = Path(0.02)
    session = RemoteSession([Remote(path, path, naive), None, None], V).run(3.0)
    assert session.diverged is not None


def test_a_successor_joins_in_a_new_life_where_the_tool_is() -> None:
    """The coupling's process dies twice, under 0.1 N: no energy is made, no force steps, and the gap is right again."""
    path = Path(0.02, 0.01, "uniform", 0.05)
    hands = [lambda t: 0.1 if t > 0.1 else 0.0, *EXAMPLE_1[1:]]
    session = RemoteSession([linked(path, 6.0), None, None], V, hands, seed=4)
    user = session.users[0]
    for life, at in ((1, 2.0), (2, 3.0)):
        session.run(at)
        session.restart(0, life)
    session.run(3.01)
    since = len(user.trace.f_c)
    session.run(cases(12, 20))
    assert user.least >= -2.0 * E_0
    f = np.array(user.trace.f_c[since:])
    assert np.abs(f[10:] - f[:-10]).max() < 0.5
    R = 0.045 + user.user.latency + user.world.latency
    assert user.trace.gap[-1] == pytest.approx(0.1 * R / (2.0 * 20.0), rel=0.2)


@pytest.mark.parametrize("E_0", [0.02, 0.0])
def test_a_constant_force_neither_creeps_nor_trembles(E_0: float) -> None:
    """1 N over 20 to 120 ms each way, 10 % lost, +100 millionths: the tool stays where it is."""
    path = Path(0.02, 0.1, "uniform", 0.1, 0.05)
    hands = [lambda t: 1.0 if t > 0.1 else 0.0, *EXAMPLE_1[1:]]
    session = RemoteSession([linked(path, 25.0, E_0=E_0, ppm=100.0), None, None], V, hands, seed=1)
    session.run(cases(12, 60))
    trace = session.users[0].trace
    gap = np.array(trace.gap)
    assert abs(gap[-500:].mean() - gap[5000:5500].mean()) < 1.5e-4
    assert np.std(trace.f_c[-2000:]) < 3e-3


def test_three_users_on_a_shared_machine_feel_no_noise() -> None:
    """Local stiffness 2300 N/m, 3 % of the messages up to 3.5 ms late, 5 N held: noise below 2 mN, no creep."""
    path = Path(0.25e-3, 3.5e-3, "machine")
    remotes = [Remote(path, path, waves(20.0, 2.0, E_0=0.005), delay=0.05e-3, ppm=ppm) for ppm in (0.0, 50.0, -50.0)]
    hands = [lambda t: 5.0 if t > 0.1 else 0.0, *EXAMPLE_1[1:]]
    session = RemoteSession(remotes, (2300.0, 0.05), hands, seed=1).run(cases(6, 20))
    trace = session.users[0].trace
    assert session.diverged is None
    assert np.std(trace.f_c[-500:]) < 2e-3
    assert trace.gap[-1] == pytest.approx(0.786e-3, rel=0.05)
    assert abs(trace.gap[-1] - trace.gap[len(trace.gap) // 2]) < 1e-5


def test_a_fast_user_and_a_slow_world_share_a_link() -> None:
    """Device and coupling at 4 kHz, the environment at 1 kHz: no clock enters the account."""
    path = Path(0.25e-3, 1e-3, "machine")
    remote = linked(path, 3.0, E_0=0.005, period=0.25e-3)
    session = RemoteSession([remote, None, None], (4000.0, 0.05), seed=2).run(cases(4, 10))
    user = session.users[0]
    assert session.diverged is None
    assert user.least >= -2.0 * 0.005
    assert abs(user.trace.gap[-1]) < 2e-5


@pytest.mark.parametrize("kind", KINDS)
def test_a_channel_has_the_jitter_the_loss_and_the_copies_that_its_path_says(kind: str) -> None:
    path = Path(0.01, 0.05, kind, loss=0.1, again=0.05)
    sent = [k * 1e-3 for k in range(20000)]
    came: dict[int, list[float]] = {}
    channel: Channel[int] = Channel(path, 5)
    for k, at in enumerate(sent):
        channel.send(at, k)
        for message in channel.arrived(at):
            came.setdefault(message, []).append(at)
    first = np.array([times[0] - sent[message] for message, times in came.items()])
    assert first.min() >= 0.01 - 1e-9
    assert first.max() <= 0.06 + 1e-3 + 1e-9
    assert len(came) / len(sent) == pytest.approx(0.9, abs=0.01)
    assert sum(len(times) > 1 for times in came.values()) / len(came) == pytest.approx(0.05, abs=0.01)
    again: Channel[int] = Channel(path, 5)
    for k, at in enumerate(sent[:1000]):
        again.send(at, k)
    assert {*again.arrived(math.inf)} == {message for message in came if message < 1000}


def test_a_limited_rate_delays_and_then_loses() -> None:
    channel: Channel[int] = Channel(Path(rate=100.0), 1)
    for k in range(1000):
        channel.send(k * 1e-3, k)
    passed = list(channel.arrived(math.inf))
    assert len(passed) == pytest.approx(120, abs=2)
    assert passed == sorted(passed)
