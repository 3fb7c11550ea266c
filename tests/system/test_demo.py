"""The demonstration in real time, as a newcomer runs it: its pictures, its recording, and its last sentence."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ..support.commands import manyhands_command

pytestmark = [pytest.mark.alone, pytest.mark.usefixtures("own_interrupt")]


@pytest.mark.long
def test_a_demonstration_in_real_time(tmp_path: Path) -> None:
    result = manyhands_command("demo", "-o", tmp_path, "--duration", "3")
    assert "without coupling, as seven processes in real time: " in result.stdout, result.stderr
    *_, last = result.stdout.splitlines()
    assert last.startswith("all 7 promises were kept, and ")
    assert "(bound -5 mJ, falling by 1 mW)" in last
    assert result.exit_code == ("not every device came to rest" in last)
    pictures = {path.stem for path in tmp_path.glob("*.png")}
    assert pictures == {
        *("fig5-without-coupling", "fig6-decentralised", "fig7-centralised", "velocities"),
        *("uncoupled-in-real-time", "accounts"),
    }
    made = json.loads((tmp_path / "report.json").read_text())
    assert made["lateness"]["enforced"]
    assert (tmp_path / "run.mcap").stat().st_size > 100_000
