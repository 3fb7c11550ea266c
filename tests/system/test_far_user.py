"""A user across a WAN: bounds hold, and the local users feel no difference to an ideal line of the same R."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..support.far_user import LOCAL, START, WIRE, certified, in_real_time, in_simulated_time
from ..support.wan import wan


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("far")
    certified(folder)
    return folder


def test_jitter_and_loss_are_not_felt_by_the_local_users(folder: Path) -> None:
    found = in_simulated_time(WIRE, folder, START + 3.0)
    assert [line.what[:2] for line in found.close] == list(LOCAL)
    assert found.held, found.close


@pytest.mark.long
@pytest.mark.alone
def test_every_bound_holds_across_a_wan(folder: Path) -> None:
    """By real processes; how close the motions are depends on what else the machine does, so the target judges that."""
    with wan(WIRE):
        pass  # skips where there is none
    found = in_real_time(WIRE, folder, 10.0)
    assert len(found.bounds) == 13
    assert all(line.holds for line in found.bounds), found.bounds
