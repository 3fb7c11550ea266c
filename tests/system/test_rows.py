"""The helper that reads the rows of an ended session admits no missed tick."""

from __future__ import annotations

import numpy as np
import pytest

from manyhands.launch.recordings.recording import Recording

from ..support.rows import rows_of

TICKS = 20


def recording(*missing: int) -> Recording:
    """Two users' rows, those of the second without the ticks that are ``missing``."""
    x, f_v = (np.arange(2.0 * TICKS).reshape(TICKS, 2) + offset for offset in (0.0, 100.0))
    x[list(missing), 1] = f_v[list(missing), 1] = np.nan
    return Recording("pair", "", 0.001, ("dx", "dy"), x, f_v)


@pytest.mark.parametrize("missing", [(), (TICKS - 1,)], ids=["whole", "last tick undone"])
def test_rows_go_to_the_last_tick_that_the_device_recorded(missing: tuple[int, ...]) -> None:
    x, f_v = rows_of(recording(*missing), "dy")
    ticks = TICKS - len(missing)
    np.testing.assert_array_equal(x, 2.0 * np.arange(ticks) + 1.0)
    np.testing.assert_array_equal(f_v, 2.0 * np.arange(ticks) + 101.0)


@pytest.mark.parametrize("missing", [(0,), (7,), (7, TICKS - 1), (TICKS - 2,)], ids=str)
def test_a_tick_missed_before_the_last_fails(missing: tuple[int, ...]) -> None:
    with pytest.raises(AssertionError, match="dy missed ticks"):
        rows_of(recording(*missing), "dy")


@pytest.mark.parametrize("last", [TICKS - 2, 1, 0])
def test_a_device_that_ended_long_before_the_other_fails(last: int) -> None:
    with pytest.raises(AssertionError, match="dy ended early"):
        rows_of(recording(*range(last, TICKS)), "dy")
