"""A device in wall time that touches a wall and stones: no buzz, and no energy for nothing (:mod:`.touch`)."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from tests.deterministic.touch import (
    ENCODER,
    HOSTILE,
    LIGHT,
    RESTING,
    Certified,
    Grip,
    Renderer,
    engine,
    proxies,
    scene,
    touch,
)
from tests.deterministic.touch_peers import STATED, GodObject, MocapWeld, Penalty

STIFF = 50e3  # N/m
LOOSE = Grip(100.0, 0.0)  # a hand that burns nothing


@pytest.mark.parametrize("kind", [scene, proxies])
@pytest.mark.parametrize(("objective", "grip"), [("feasible", LOOSE), ("stiffest", LIGHT)])
def test_a_wall_of_50_kN_a_metre_does_not_buzz(
    kind: Callable[[str, float], dict[str, Any]], objective: str, grip: Grip
) -> None:
    """The device's own damping is 0.5 N*s/m: it moves by less than a step of its encoder, at every frequency."""
    trace = touch("wall", grip, Certified(kind("wall", STIFF), objective), 4.0, ENCODER, RESTING)
    amplitude, line = trace.unrest(ENCODER)
    assert trace.f[-1, 1] > 0.3
    assert amplitude < 1.0
    assert line < 1.0


def test_a_penalty_wall_buzzes_in_the_same_hand() -> None:
    trace = touch("wall", LIGHT, Penalty("wall", STATED), 4.0, ENCODER, RESTING)
    amplitude, line = trace.unrest(ENCODER)
    assert amplitude > 10.0
    assert line > 10.0
    assert len(touch("wall", LIGHT, Penalty("wall", STIFF), 4.0, ENCODER, RESTING).x) < 4000  # beyond 1 m


def test_no_hand_is_given_energy_that_it_did_not_put_in() -> None:
    """What a certificate says, with an encoder without steps: over all stones, in the hands that ask most."""
    for grip in (LIGHT, HOSTILE):
        for kind in (scene, proxies):
            trace = touch("stones", grip, Certified(kind("stones", 2000.0)), 3.0, 0.0)
            assert trace.deepest > 2e-3
            assert trace.account.min() >= -1e-12


def test_an_engine_gives_no_energy_either() -> None:
    pytest.importorskip("mujoco")
    trace = touch("stones", LIGHT, Certified(engine("stones", 2000.0)), 3.0, 0.0)
    assert trace.deepest > 2e-3
    assert trace.account.min() >= -1e-12


@pytest.mark.parametrize("peer", ["penalty", "god-object", "weld"])
def test_what_others_do_gives_energy_in_the_same_hand(peer: str) -> None:
    """Otherwise the tests above would show nothing."""
    if peer == "weld":
        pytest.importorskip("mujoco")
    renderer: Renderer
    match peer:
        case "penalty":
            renderer = Penalty("stones", STATED)
        case "god-object":
            renderer = GodObject("stones", STATED)
        case _:
            renderer = MocapWeld("stones")
    assert touch("stones", LIGHT, renderer, 1.5, 0.0).account.min() < -1e-3


@pytest.fixture
def world_peers(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The benchmark, which is run from the repository's root."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    return import_module("benchmarks.world_peers")


@pytest.mark.long
def test_the_comparison_has_a_row_for_everybody(world_peers: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of 50 ms, with few gains: the documented one, and the best."""
    pytest.importorskip("mujoco")
    monkeypatch.setattr(world_peers, "SECONDS", 0.05)
    monkeypatch.setattr(world_peers, "SWEEP", (500.0, STATED))
    monkeypatch.setattr(world_peers, "WELDS", ((0.02, 0.9, 0.95),))
    outcomes = [world_peers.run(case) for case in world_peers.cases()]
    lines = world_peers.table(outcomes).splitlines()
    assert sum(line.startswith("| **") for line in lines) == 8
    assert sum("as documented: 2400 N/m" in line for line in lines) == 4
    assert sum(", best in damped hands: " in line for line in lines) == 6
    assert sum(", best in all hands: " in line for line in lines) == 6


def test_the_best_gain_is_the_stiffest_that_gives_nothing(world_peers: Any, tmp_path: Path) -> None:
    def outcome(felt: float, account: float, world: str = "wall") -> Any:
        hands = dict.fromkeys(world_peers.GRIPS, 0.0)
        lasted = dict.fromkeys(hands, world_peers.SECONDS)
        values = [{**hands, "firm": felt}, hands, hands, {**hands, "light": account}, hands, hands, lasted, {}]
        return world_peers.Outcome(world_peers.Case(world, "penalty", (felt,)), *values)

    soft, stiff, loud = outcome(300.0, 0.0), outcome(500.0, -1e-7), outcome(900.0, -1e-3)
    assert world_peers.best([soft, stiff, loud], ("firm", "light")) is stiff
    assert world_peers.best([soft, stiff, loud], ("firm",)) is loud
    assert world_peers.best([loud, outcome(2000.0, -1.0)], ("light",)) is loud
    world_peers.plot([soft, stiff, loud, outcome(700.0, -1e-3, "stones")], tmp_path / "peers.png")
    assert (tmp_path / "peers.png").read_bytes().startswith(b"\x89PNG")
