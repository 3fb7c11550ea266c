"""The stiffness delivered in a recorded press, beside the certified one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.press import BLOCK, averaged, held_still, presses
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import read_run
from manyhands.launch.session import load_session

from ...support.simulated_recordings import SESSIONS, attachments_of, recorded_of, simulated, written

TICKS = 4000
PUSH = ["design.objective=stiffest", 'devices.dx.hand.force="3*min(t/0.5, 1)"', "devices.dy.hand.force=0",
        "devices.dz.hand.force=0"]  # fmt: skip


@pytest.fixture(scope="module")
def pressed() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml", PUSH))


@pytest.fixture(scope="module")
def rows(pressed: Prepared) -> dict[tuple[str, str], np.ndarray]:
    return simulated(pressed, TICKS)


def test_a_session_in_time_delivers_what_is_certified(
    pressed: Prepared, rows: dict[tuple[str, str], np.ndarray], tmp_path: Path
) -> None:
    run = read_run(written(tmp_path / "r.mcap", recorded_of(pressed), attachments_of(pressed), rows))
    (press,) = presses(pressed, run)
    assert press.port == "dx"
    assert press.seconds >= 1.0
    assert press.force == pytest.approx(3.0, rel=0.05)
    assert press.delivered == pytest.approx(press.certified, rel=0.01)
    assert f"{press.delivered:.4g} N/m delivered of {press.certified:.4g} certified" in press.sentence()


def test_a_tool_that_stayed_behind_shows_in_what_was_delivered(
    pressed: Prepared, rows: dict[tuple[str, str], np.ndarray], tmp_path: Path
) -> None:
    """The hand has to go 10 mm further for the same force, as after a clutch that left an offset."""
    moved = rows | {("dx", "x"): rows["dx", "x"] + 0.01}
    run = read_run(written(tmp_path / "r.mcap", recorded_of(pressed), attachments_of(pressed), moved))
    (press,) = presses(pressed, run)
    apart = press.force / press.certified + 0.01
    assert press.delivered == pytest.approx(press.force / apart, rel=0.02)


def test_only_a_hand_that_is_still_under_a_constant_force_presses() -> None:
    still, force = np.full(50, 0.01), np.full(50, -5.0)
    assert held_still(still, force) == (0, 50)
    moving = still + np.where(np.arange(50) < 20, 1e-3 * np.arange(50), 0.02)
    assert held_still(moving, force) == (20, 50)
    assert held_still(still, np.where(np.arange(50) < 30, force, -3.0)) == (0, 30)
    assert held_still(still, np.full(50, -0.1)) == (0, 0)
    gap = still.copy()
    gap[10] = np.nan
    assert held_still(gap, force) == (11, 50)
    assert held_still(still[:0], force[:0]) == (0, 0)


def test_rows_are_averaged_in_whole_blocks() -> None:
    rows = np.arange(250.0)[:, None]
    assert averaged(rows, 1e-3).tolist() == [[49.5], [149.5]]
    assert averaged(rows[:50], 1e-3).shape == (0, 1)
    assert BLOCK == 0.1
