"""The rows of a node: every number comes back in its trace, once."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.rows.two_port import RowBuffer
from manyhands.protocol.channels import TOPICS
from manyhands.protocol.messages import Role


@given(
    role=st.sampled_from([Role.DEVICE, Role.COUPLING, Role.ENVIRONMENT]),
    widths=st.lists(st.integers(0, 3), min_size=13, max_size=13).filter(lambda widths: any(widths[:5])),
    ticks=st.integers(1, 5),
)
def test_rows_come_back_by_topic_and_once(role: Role, widths: list[int], ticks: int) -> None:
    topics, rows = TOPICS[role], RowBuffer(role, ticks, ticks + 1)
    widths = widths[: len(topics)]
    for first in (0.0, 1000.0):
        expected = {
            topic.trace: first + 100.0 * at + np.arange(float(ticks * width)).reshape(ticks, width)
            for at, (topic, width) in enumerate(zip(topics, widths, strict=True))
        }
        for k in range(ticks):
            rows.add(tuple(values[k].tolist() for values in expected.values()))
        assert rows.filled == ticks
        assert rows.full is (first == 0.0)  # the first telemetry has fewer rows
        found = rows.take()
        assert list(found) == [topic.trace for topic, width in zip(topics, widths, strict=True) if width]
        for name, values in found.items():
            np.testing.assert_array_equal(values, expected[name])
    assert rows.filled == 0
