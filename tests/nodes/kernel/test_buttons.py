"""Buttons: what counts as a change, and how often; and the scripts that press them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.kernel.buttons import LEAST, Buttons, scripted

T = 1e-3
EVERY = round(LEAST / T)


def test_a_press_counts_at_once_and_a_bounce_does_not() -> None:
    buttons = Buttons(("d.a", "d.b"), T)
    assert buttons.take(5, 0b01) == 0b01
    assert list(buttons.changes(0b01)) == [("d.a", True)]
    assert [buttons.take(k, 0b00) for k in range(6, 5 + EVERY)] == [0] * (EVERY - 1)  # a contact that bounces
    assert buttons.take(5 + EVERY, 0b00) == 0b01
    assert buttons.state == 0
    assert buttons.table() == {"d.a": 0.0, "d.b": 0.0}
    assert buttons.take(5 + EVERY, 0b10) == 0b10, "each button has a time of its own"
    assert buttons.table() == {"d.a": 0.0, "d.b": 1.0}


@given(st.lists(st.integers(0, 7), max_size=300), st.sampled_from([1e-4, 1e-3, 0.016, 0.5]))
def test_the_changes_of_a_telemetry_are_few_whatever_is_pressed(states: list[int], period: float) -> None:
    buttons = Buttons(("d.a", "d.b", "d.c"), period)
    changed = [buttons.take(k, state).bit_count() for k, state in enumerate(states)]
    ticks = max(1, round(0.1 / period))
    for begin in range(len(changed)):
        assert sum(changed[begin : begin + ticks]) <= 3 * 5
    assert 0 <= buttons.state < 8


def test_a_change_that_came_too_soon_counts_later() -> None:
    buttons = Buttons(("d.a",), T)
    buttons.take(0, 1)
    assert [k for k in range(1, 3 * EVERY) if buttons.take(k, 0)] == [EVERY]


def test_a_script_holds_a_button_down_from_its_begin_to_before_its_end() -> None:
    scripts = (((0.5, 1.0), (2.0, 3.0)), ())
    assert [scripted(scripts, t) for t in (0.0, 0.5, 0.999, 1.0, 2.5, 3.0)] == [0, 1, 1, 0, 1, 0]
