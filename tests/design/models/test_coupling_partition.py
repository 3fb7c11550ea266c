"""The block structure: exact zeros outside the blocks, and exact values inside, in every direction of the trip."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.coupling import Partition
from manyhands.design.models.statespace import StateSpace


@given(st.data(), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_round_trips_are_exact(problems, data: st.DataObject, m: int, seed: int) -> None:
    partition = data.draw(problems.partitions(m))
    rng = np.random.default_rng(seed)
    parts = [rng.normal(size=(len(b), len(b))) for b in partition.blocks]
    M = partition.embed(parts)
    assert partition.size == m
    assert partition.admits(M)
    assert np.all(M[~partition.mask()] == 0.0)
    for part, back, select in zip(parts, partition.restrict(M), partition.selections(), strict=True):
        np.testing.assert_array_equal(part, back)
        np.testing.assert_array_equal(part, select.T @ M @ select)
    if not partition.mask().all():
        i, j = np.argwhere(~partition.mask())[0]
        M[i, j] = 5e-324  # the least number there is
        assert not partition.admits(M)


@given(st.data(), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_joined_systems_act_on_their_own_ports_only(problems, data: st.DataObject, m: int, seed: int) -> None:
    partition = data.draw(problems.partitions(m))
    rng = np.random.default_rng(seed)
    systems = []
    for block in partition.blocks:
        n, k = int(rng.integers(0, 3)), len(block)
        draws = (rng.normal(size=shape) for shape in ((n, n), (n, k), (k, n), (k, k)))
        systems.append(StateSpace(*draws))
    joined = partition.join(systems)
    u = rng.normal(size=(8, m))
    y = joined.simulate(u)
    for block, system in zip(partition.blocks, systems, strict=True):
        expected = system.simulate(u[:, list(block)])
        np.testing.assert_allclose(y[:, list(block)], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    response = joined.response(2.0 + 1.0j)
    assert np.all(response[~partition.mask()] == 0.0)


@pytest.mark.parametrize(
    ("names", "blocks", "words"),
    [
        (("a", "b"), ((0, 1), (1,)), "expected every port in exactly one"),
        (("a",), ((0, 2),), "expected every port in exactly one"),
        (("a", "b"), ((0,), ()), "expected every port in exactly one"),
        (("a", "a"), ((0,), (1,)), "expected one of its own for each block"),
        (("a",), ((0,), (1,)), "expected one of its own for each block"),
    ],
)
def test_what_is_no_partition_is_refused(names, blocks, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Partition(names, blocks)
