"""An audit of an honest recording in real time accuses nobody; more of them: ``make honest``."""

from __future__ import annotations

from pathlib import Path

import pytest

from .honest import one


@pytest.mark.parametrize(
    ("seed", "kind"),
    [
        (100008, "clipped"),  # a force at its limit behind an open clutch: where the coupling's end was is not recorded
        (100022, "budget"),  # a process does the last tick of the one before again
        (100036, "crossed"),  # the first row of a new coupling, in whose tick the old one was still sent a force
        (100097, "clipped"),  # a device ended in mid-tick: its coupling had answered it, not the one after
    ],
)
def test_nobody_is_accused(seed: int, kind: str, tmp_path: Path) -> None:
    honest = one(seed, 900, tmp_path, kind)
    assert honest.accused == []
    assert honest.happened["began"] > 2
