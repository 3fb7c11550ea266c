"""The notebooks run from their first cell to their last, and every number in their text is one that they print."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from manyhands.launch.files import EXIT_OK

from .test_design_docs import NUMBER, SMALL

NOTEBOOKS = sorted((Path(__file__).parents[2] / "examples" / "notebooks").glob("*.py"))
MADE = {
    "own_plant.py": {"own_plant_impedance.png", "own_plant_touch.png", "gel.cert.json"},
    "recording.py": {"run.mcap", "certificate.json", "recording.png"},
    "stiffness_and_delay.py": {"stiffness_and_delay.png"},
}
CELL = re.compile(r"^# %%(.*)$", flags=re.MULTILINE)


def cells(text: str) -> tuple[str, str]:
    """The text of the Markdown cells, and the code of the others."""
    first, *parts = CELL.split(text)
    assert not first.strip(), "a notebook begins with a cell"
    kinds = {"markdown": "", "code": ""}
    for marker, body in zip(parts[::2], parts[1::2], strict=True):
        assert marker.strip() in ("", "[markdown]"), f"an unknown kind of cell: {marker}"
        kinds["markdown" if marker.strip() else "code"] += body
    assert all(line.startswith("#") for line in kinds["markdown"].splitlines() if line)
    return re.sub(r"^# ?", "", kinds["markdown"], flags=re.MULTILINE), kinds["code"]


def unfounded(prose: str, shown: str) -> list[str]:
    """Numbers of the prose that neither the code has nor the notebook prints."""
    prose = re.sub(r"`[^`]*`", "", prose)
    return [
        number
        for number in NUMBER.findall(prose)
        if not (number.isdigit() and int(number) <= SMALL)
        and not re.search(rf"(?<![\d.]){re.escape(number)}(?!\d)", shown)
    ]


@pytest.mark.long
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_tells_no_other_numbers(notebook: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-W", "error", str(notebook)],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (EXIT_OK, "")
    assert {path.name for path in tmp_path.iterdir()} == MADE[notebook.name]
    prose, code = cells(notebook.read_text(encoding="utf-8"))
    assert len(prose) > 1000
    assert unfounded(prose, done.stdout + code) == []


def test_every_notebook_is_known() -> None:
    assert [path.name for path in NOTEBOOKS] == sorted(MADE)


def test_the_check_of_numbers_sees_a_wrong_one() -> None:
    prose, code = cells("# %% [markdown]\n# 2740 N/m in 3 steps, not 2741; `9999`.\n# %%\nlimit = 2740\n")
    assert unfounded(prose, code) == ["2741"]
