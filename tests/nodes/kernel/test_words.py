"""Numbers with their nouns."""

from __future__ import annotations

import pytest

from manyhands.nodes.kernel.words import counted


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (0, "0 ticks"),
        (1, "1 tick"),
        (2, "2 ticks"),
        (1.0, "1 tick"),
        (4 / 3, "1 tick"),
        (0.7, "1 tick"),
        (1.6, "2 ticks"),
    ],
)
def test_the_noun_goes_by_the_number_that_is_shown(number: float, text: str) -> None:
    assert counted(number, "tick") == text


def test_a_noun_may_have_its_own_plural() -> None:
    assert [counted(n, "axis", "axes") for n in (1, 3)] == ["1 axis", "3 axes"]
