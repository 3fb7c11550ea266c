"""The chaos campaign, in short: a few faults by a seed under the simulated clock; all invariants hold."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.recordings.recording import Recording

from .stage import PORTS, prepared

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
FAULTS = 6


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Benchmarks are scripts beside each other, and no package."""
    monkeypatch.syspath_prepend(BENCHMARKS)


@pytest.mark.long
def test_a_session_withstands_faults_at_random(tmp_path: Path) -> None:
    file, page = tmp_path / "chaos.json", tmp_path / "page.md"
    page.write_text("before\n<!-- chaos: begin -->\n<!-- chaos: end -->\nafter\n")
    options = ["--simulated", FAULTS, "--realtime", 0, "--seed", 7, "--json", file, "--markdown", page]
    command = [sys.executable, str(BENCHMARKS / "chaos.py"), *map(str, options)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=150, env=dict(os.environ))
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = json.loads(file.read_text())["runs"]
    assert sum(run["faults"].values()) == FAULTS
    assert run["violations"] == []
    assert run["ticks"] > 0
    assert 0.0 < run["step"] < 1.0
    assert 0.0 < run["force"] <= 1.0
    assert "| example-1 | simulated | 1 | 6 |" in page.read_text()


def broken(**changes: Any) -> Recording:
    """A recording of two users at rest, except for the given changes."""
    x, f_v = np.zeros((50, 2)), np.full((50, 2), 0.25)
    for name, (tick, value) in changes.items():
        (x if name == "x" else f_v)[tick:, 0] = value
    return Recording("pair", "", 0.001, PORTS, x, f_v)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"f_v": (20, 7.0)}, "a force of 7; expected at most 5"),
        ({"x": (20, 3.0)}, "a displacement of 3; expected at most 2"),
        ({"x": (20, 0.5)}, "a speed of 500; expected at most 2"),
        ({"f_v": (20, 0.5)}, "a step of 0.25 N; expected at most 0.1 N"),
        ({"f_v": (20, 0.0)}, "let go 1 times; expected at most 0"),
    ],
)
def test_what_does_not_hold_is_found(changes: dict[str, Any], said: str) -> None:
    from chaos_checks import examine

    found = examine(prepared(), broken(**changes), dict.fromkeys(PORTS, 0.1), {})
    assert any(said in violation for violation in found.violations), found
    assert not examine(prepared(), broken(), dict.fromkeys(PORTS, 0.1), {}).violations


def test_a_ledger_below_its_bound_is_found() -> None:
    from chaos_checks import broken_promises

    assert broken_promises({"dx": -1e-13, "dy": 0.0}) == []
    assert broken_promises({"dx": -1e-9}) == ["dx: found a ledger 1e-09 J below its bound; expected none"]
