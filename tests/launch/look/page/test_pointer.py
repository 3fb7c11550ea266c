"""What a page may send, how often, and which page holds a device."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.launch.look.page.pointer import (
    DEMANDS_AT_ONCE,
    DEMANDS_PER_S,
    GRIP_LASTS,
    MAX_DEMAND_BYTES,
    Hold,
    Holding,
    LetGo,
    MessageAllowance,
    Wrong,
    demand_of,
    token_of,
)
from manyhands.nodes.kernel.orientation import Quaternion
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Grasp, Release
from manyhands.protocol.transport.pointer import PointerInlet

from ....support.observed_session import ABOUT

NOW = Instant(10**9)
HERE = Hold("right", (0.01, 0.02))


def test_a_grasp_and_a_release() -> None:
    assert demand_of('{"grasp": "right", "position": [0.01, 0.02]}', ABOUT) == HERE
    assert demand_of('{"release": "right"}', ABOUT) == LetGo("right")


def test_a_position_ends_at_the_reach() -> None:
    assert demand_of('{"grasp": "right", "position": [7, -7]}', ABOUT) == Hold("right", (0.1, -0.05))


TURNED = replace(ABOUT, hands=("right",))


def test_a_device_with_an_orientation_is_turned() -> None:
    def said(turn: object) -> Hold | LetGo | Wrong:
        return demand_of(json.dumps({"grasp": "right", "position": [0.01, 0.02], "turn": turn}), TURNED)

    found = said([0.6, 0, 0.8, 0])
    assert isinstance(found, Hold)
    assert (found.position, found.turn) == (HERE.position, (0.6, 0.0, 0.8, 0.0))
    nearly = said([0.6 + 1e-7, 0.0, 0.8, 0.0])  # as the digits of a page may have it
    assert isinstance(nearly, Hold)
    assert nearly.turn is not None
    assert math.hypot(*nearly.turn) == pytest.approx(1.0, abs=1e-15)
    assert said(None) == HERE
    for wrong in ([0.6, 0.0, 0.8], [0.6, 0, 0.9, 0], [0, 0, 0, 0], ["1", 0, 0, 0], [True, 0, 0, 0], {"w": 1}, "up", 1.0,
                  [math.nan, 0, 0, 1], [1e999, 0, 0, 0], [10**400, 0, 0, 0], [1, 0, 0, 0, 0]):  # fmt: skip
        answer = said(wrong)
        assert isinstance(answer, Wrong), wrong
        assert "expected a unit quaternion" in answer.why
    answer = demand_of('{"grasp": "right", "position": [0.01, 0.02], "turn": [1, 0, 0, 0]}', ABOUT)
    assert isinstance(answer, Wrong)
    assert "its orientation is no port" in answer.why


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"grasp": "left", "position": [0.0]}', "expected a device that can be held: right"),
        ('{"release": "left"}', "expected a device that can be held: right"),
        ('{"grasp": "right", "position": [0.0]}', "found 1 entries; expected 2 numbers in m"),
        ('{"grasp": "right", "position": [0.0, "1"]}', "expected 2 numbers"),
        ('{"grasp": "right", "position": [0.0, true]}', "expected 2 numbers"),
        ('{"grasp": "right", "position": [0.0, NaN]}', "expected 2 numbers"),
        ('{"grasp": "right", "position": [0.0, 1e999]}', "expected 2 numbers"),
        (f'{{"grasp": "right", "position": [0.0, {10**400}]}}', "expected 2 numbers"),
        ('{"grasp": "right", "position": [0.0, 0.0], "more": 1}', "found no message of a page"),
        ('{"grasp": ["right"], "position": [0.0, 0.0]}', "found no message of a page"),
        ("[" * 4000, "found no message of a page"),
        ("{", "found no message of a page"),
        (json.dumps({"release": "right" + " " * MAX_DEMAND_BYTES}), "found no message of a page"),
    ],
)
def test_errors_are_reported(text: str, words: str) -> None:
    answer = demand_of(text, ABOUT)
    assert isinstance(answer, Wrong)
    assert words in answer.why


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
NEARLY = st.fixed_dictionaries({"grasp": st.just("right"), "position": JSON}) | JSON
TURN = st.fixed_dictionaries({"grasp": st.just("right"), "position": st.just([0.0, 0.0]), "turn": JSON})


@settings(max_examples=60)
@given((NEARLY | TURN).map(json.dumps) | st.text(max_size=200))
def test_no_message_of_a_page_raises(text: str) -> None:
    answer = demand_of(text, TURNED)
    assert isinstance(answer, Hold | LetGo | Wrong)
    if isinstance(answer, Hold):
        limits = (0.1, 0.05)
        assert len(answer.position) == 2
        assert all(abs(x) <= limit for x, limit in zip(answer.position, limits, strict=True))


def test_the_token_of_a_first_message() -> None:
    assert token_of('{"token": "secret"}') == "secret"
    assert token_of('{"token": "secret", "more": 1}') is None
    assert token_of("secret") is None


def test_messages_are_bounded_in_number() -> None:
    allowance = MessageAllowance(NOW)
    assert all(allowance.spend(NOW) for _ in range(DEMANDS_AT_ONCE))
    assert not allowance.spend(NOW)
    later = Instant(NOW + 10**9)
    assert sum(allowance.spend(later) for _ in range(2 * DEMANDS_PER_S)) == DEMANDS_PER_S


@pytest.fixture
def inlet(tmp_path: Path) -> Iterator[PointerInlet]:
    inlet = PointerInlet(tmp_path, "right")
    yield inlet
    inlet.close()


@pytest.fixture
def holding(tmp_path: Path, inlet: PointerInlet) -> Iterator[Holding]:
    holding = Holding(tmp_path, ABOUT)
    yield holding
    holding.close()


def test_where_a_device_is_turned_stands_behind_its_position(holding: Holding, inlet: PointerInlet) -> None:
    assert holding.hold(1, replace(HERE, turn=Quaternion(0.6, 0.0, 0.8, 0.0)), NOW) is None
    held = inlet.latest()
    assert isinstance(held, Grasp)
    assert held.position.tolist() == [0.01, 0.02, 0.6, 0.0, 0.8, 0.0]


def test_a_device_is_held_and_let_go(holding: Holding, inlet: PointerInlet) -> None:
    assert holding.hold(1, HERE, NOW) is None
    held = inlet.latest()
    assert isinstance(held, Grasp)
    assert held.position.tolist() == [0.01, 0.02]
    assert (holding.of(1), holding.of(2)) == ({"right": "here"}, {"right": "elsewhere"})
    holding.let_go(1, "right")
    assert inlet.latest() == Release()
    assert holding.of(1) == {}


def test_another_page_must_wait(holding: Holding, inlet: PointerInlet) -> None:
    holding.hold(1, HERE, NOW)
    assert holding.hold(2, Hold("right", (0.0, 0.0)), NOW) == "right is held by another page"
    holding.let_go(2, "right")
    assert holding.of(1) == {"right": "here"}
    held = inlet.latest()
    assert isinstance(held, Grasp)
    assert held.position.tolist() == [0.01, 0.02]
    holding.let_go(1)
    assert holding.hold(2, HERE, NOW) is None


def test_who_falls_silent_has_let_go(holding: Holding, inlet: PointerInlet) -> None:
    holding.hold(1, HERE, NOW)
    holding.hold(1, HERE, Instant(NOW + GRIP_LASTS))
    holding.expire(Instant(NOW + 2 * GRIP_LASTS))
    assert holding.of(1) == {"right": "here"}
    holding.expire(Instant(NOW + 2 * GRIP_LASTS + 1))
    assert holding.of(1) == {}
    assert inlet.latest() == Release()


def test_the_end_lets_go(holding: Holding, inlet: PointerInlet) -> None:
    holding.hold(1, HERE, NOW)
    holding.close()
    assert inlet.latest() == Release()


def test_a_device_that_is_not_there_is_not_held(holding: Holding, inlet: PointerInlet) -> None:
    inlet.close()
    why = holding.hold(1, HERE, NOW)
    assert why is not None
    assert "cannot be held now" in why
    assert holding.of(1) == {}
