"""Tools on axes, edges, corners and faces of a few pairs of shapes; ``make scenes`` searches 100,000 steps of all."""

from __future__ import annotations

import pytest

from tests.deterministic.edges import outcome_of, pairs

# the places that were lost once: a centre on an axis, in a hand of one axis; rods in line, and crossing ones
LOST = (("sphere", "bar"), ("ball", "bar"), ("rod", "bar"), ("rod", "parallel bar"), ("slanted rod", "slanted bar"))


@pytest.mark.parametrize("pair", LOST, ids=" on ".join)
def test_nothing_comes_out_of_an_axis(pair: tuple[str, str]) -> None:
    outcome = outcome_of(pair, 1, 1)
    assert outcome.steps == 800
    assert not outcome.broken, outcome


def test_every_pair_of_shapes_is_searched() -> None:
    """All but a box with a capsule along no axis, whose gap is not known."""
    assert len(pairs()) == 6 * 13 - 5
