"""`manyhands sweep`: a table of designs, which goes on where an earlier run ended."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from ....support.commands import manyhands_command

pytestmark = pytest.mark.usefixtures("own_interrupt")
VARY = ["--vary", "design.tau=[0, 0.0005]", "--vary", "design.objective=[feasible, stiffest]"]


def test_a_sweep_writes_a_table_and_goes_on_from_its_journal(tmp_path: Path) -> None:
    table, journal = tmp_path / "sweep.csv", tmp_path / "sweep.csv.journal"
    done = manyhands_command("sweep", "example1.yaml", *VARY, "-o", table, "--workers", "2")
    assert done.exit_code == 0, done.stderr
    assert f"4 designs written to {table}" in done.stderr
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [(row["design.tau"], row["design.objective"], round(float(row["stiffness_N/m"]))) for row in rows] == [
        ("0.0", "feasible", 1110),
        ("0.0", "stiffest", 2740),
        ("0.0005", "feasible", 391),
        ("0.0005", "stiffest", 1087),
    ]
    before = journal.read_bytes()
    again = manyhands_command("sweep", "example1.yaml", *VARY, "-o", table, "--workers", "2")
    assert again.exit_code == 0, again.stderr
    assert journal.read_bytes() == before
    assert list(csv.DictReader(table.read_text().splitlines())) == rows


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ("design.tau=3", "--vary design.tau=3: design.tau: found 3; expected a list of values, such as"),
        ("design.tau=[]", "found an empty list; expected a list of values"),
        ("design.tau", "--vary design.tau: found no '='; expected KEY.PATH=VALUE"),
        ("design.tua=[1]", "design.tua: found the unknown key 'tua'"),
        ("design.tau=[0, -1]", "design.tau: found -1; expected"),
    ],
)
def test_a_wrong_variation_is_refused_and_nothing_is_written(vary: str, message: str, tmp_path: Path) -> None:
    done = manyhands_command("sweep", "example1.yaml", "--vary", vary, "-o", tmp_path / "sweep.csv")
    assert done.exit_code == 2
    assert message in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_another_table_is_refused(tmp_path: Path) -> None:
    done = manyhands_command("sweep", "example1.yaml", *VARY, "-o", tmp_path / "sweep.txt")
    assert done.exit_code == 2
    assert "found the suffix '.txt'; expected one of .csv" in done.stderr
