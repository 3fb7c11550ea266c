"""What most tests here begin with: Example 1, and a recording of its first ticks in simulated time."""

from __future__ import annotations

from pathlib import Path

import pytest

from manyhands.launch.plan.prepare import Prepared

from ...support.simulated_recordings import TICKS, attachments_of, prepared_as, recorded_of, simulated, written


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepared_as("example1")


@pytest.fixture(scope="module")
def recording(prepared: Prepared, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    return written(path, recorded_of(prepared), attachments_of(prepared), simulated(prepared, TICKS))
