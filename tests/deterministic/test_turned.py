"""Hostile hands of six axes in MuJoCo, at less length than ``make orientation`` has them."""

from __future__ import annotations

import pytest

from manyhands.nodes.environment import oriented_tools
from manyhands.nodes.kernel.orientation import OrientationBank
from tests.deterministic.turned import Told, Untested, thrown

pytest.importorskip("mujoco")

WORLDS = pytest.mark.parametrize(
    ("body", "shape", "care"),
    [("free", "dumb-bell", "careful"), ("ball", "box", "careless"), ("hinge on free", "box", "careful")],
)


@WORLDS
def test_hostile_hands_of_six_axes_get_nothing_out_of_what_they_turn(body: str, shape: str, care: str) -> None:
    told = Told()
    for seed in range(1, 9):
        told.add(thrown(body, shape, care, min(1000, 1200 - told.ticks), seed))
        if told.ticks >= 1200:
            break
    assert told.holds, told
    assert told.ticks == 1200
    assert told.touching > 240
    assert told.turned > 5.0
    assert told.held > 100
    assert told.lives > 2
    assert told.turning > 0.1


@WORLDS
def test_without_the_test_they_get_energy(body: str, shape: str, care: str) -> None:
    assert thrown(body, shape, care, 1000, 1, Untested).put_in < -1e-3


def test_a_bank_that_grants_what_it_does_not_have_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    class Generous(OrientationBank):
        def grant(self, hand: str, asked: float) -> float:
            self.balance += asked
            return super().grant(hand, asked)

    monkeypatch.setattr(oriented_tools, "OrientationBank", Generous)
    told = thrown("free", "dumb-bell", "careful", 1000, 1)
    assert not told.holds
    assert told.put_in < -1e-3
