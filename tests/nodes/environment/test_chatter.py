"""Force reversals: which steps count, for whom, and the most in a second."""

from __future__ import annotations

import numpy as np

from manyhands.launch.look.display import chatter_line, held_line, world_lines
from manyhands.nodes.environment.chatter import LEAST, MOST, Chatter, contact_tables
from manyhands.nodes.environment.enforced import BlackBox, EnforcedCore
from manyhands.nodes.environment.model import AskedModel
from manyhands.protocol.messages import Figures

T = 1e-3


def counted(f: np.ndarray, T: float = T) -> Chatter:
    chatter = Chatter(([0, 2], [1]), T)
    for row in f:
        chatter.enter(row)
    return chatter


def test_a_force_that_alternates_reverses_in_every_tick_but_the_first() -> None:
    f = np.zeros((100, 3))
    f[:, 2] = 0.5 * (-1.0) ** np.arange(100)
    chatter = counted(f)
    assert chatter.reversals == [99, 0]
    assert chatter.most == [99, 0]


def test_two_ports_of_a_party_are_one_reversal() -> None:
    f = np.zeros((100, 3))
    f[:, 0] = f[:, 2] = 0.5 * (-1.0) ** np.arange(100)
    assert counted(f).reversals == [99, 0]


def test_small_steps_and_slow_turns_do_not_count() -> None:
    k = np.arange(2000)[:, None]
    assert counted(0.49 * LEAST * (-1.0) ** k * np.ones(3)).reversals == [0, 0]
    slow = counted(5.0 * np.sin(2.0 * np.pi * 2.0 * T * k) * np.ones(3))
    assert max(slow.reversals) == 0  # at its turns a smooth force has small steps


def test_the_most_is_that_of_one_second() -> None:
    f = np.zeros((300, 3))
    f[20:60, 1] = (-1.0) ** np.arange(40)
    f[150:160, 1] = (-1.0) ** np.arange(10)
    chatter = counted(f, T=0.01)  # 100 ticks are a second
    assert chatter.reversals[1] == 40 + 10
    assert chatter.most[1] == 40


def test_what_is_reported_and_what_to_do() -> None:
    f = np.zeros((200, 3))
    f[:, 1] = (-1.0) ** np.arange(200)
    figures = Figures({}, contact_tables((), counted(f), ("left", "right")))
    assert figures.tables == {"held": {}, "reversals": {"right": 199.0}, "chatter": {"right": 199.0}}
    assert chatter_line(figures) == (
        "the model's force chatters: right up to 199 times a second; docs/models.md says why, and what a proxy does "
        "about it"
    )
    with_proxies = Figures({}, contact_tables([0, 7], counted(f), ("left", "right")))
    assert chatter_line(with_proxies).endswith("its proxies jump, or ticks are late")
    of_a_scene = chatter_line(Figures({"unfinished": 0.0}, figures.tables))
    assert of_a_scene == (
        "the scene's force chatters: right up to 199 times a second; ticks are late, or a contact opens and closes"
    )
    assert held_line(with_proxies) == "proxies held: right in 7 ticks"
    assert len(world_lines(with_proxies)) == 2
    assert world_lines(Figures({}, {"chatter": {"left": MOST - 1.0}, "held": {"left": 0.0}})) == []


def test_reversals_are_those_of_what_the_couplings_receive() -> None:
    """A model that turns its force in every tick is not felt through a frozen clutch, and counts once it is."""

    class Buzz:
        def react(self, x_e: np.ndarray, k: int) -> np.ndarray:
            return np.array([(-1.0) ** k])

    law = BlackBox(AskedModel("buzz", Buzz(), ("p",)))
    core = EnforcedCore(law, np.array([[1e-3]]), None, 1e-3, False, ramp=20)
    assert core.chatter is not None
    core.clutches.freeze(0)
    for _ in range(50):
        core.react([0.0])
        core.settle()
    assert core.chatter.reversals == [0]
    core.clutches.engage(0)
    for _ in range(100):
        core.react([0.0])
        core.settle()
    assert 70 < core.chatter.reversals[0] <= 100
