"""Percentiles in bounded memory agree with sorted data to their stated one percent."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.rows.distribution import Distribution


@given(st.lists(st.floats(0.2, 1e7), min_size=1, max_size=300), st.sampled_from([0.5, 0.99, 0.999]))
def test_quantiles_are_those_of_the_sorted_values(values: list[float], fraction: float) -> None:
    distribution = Distribution()
    for value in values:
        distribution.add(value)
    exact = np.quantile(values, fraction, method="inverted_cdf")
    assert distribution.quantile(fraction) == pytest.approx(exact, rel=0.0101)
    assert distribution.percentiles()["max"] == max(values)


def test_no_value_is_lost_at_the_ends() -> None:
    distribution = Distribution()
    assert distribution.quantile(0.5) == 0.0
    for value in (-3.0, 0.0, 0.01, 1e12):
        distribution.add(value)
    assert distribution.quantile(0.75) == 0.0
    assert distribution.percentiles()["max"] == 1e12
