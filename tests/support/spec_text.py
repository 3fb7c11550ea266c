"""SPEC.md as data: its text and its tables, for the tests that hold it against the code."""

from pathlib import Path

import manyhands.protocol

SPEC = (Path(manyhands.protocol.__file__).parent / "SPEC.md").read_text(encoding="utf-8")


def table(header: str) -> list[list[str]]:
    """The cells of the table that begins with ``header``, without the backticks around a whole cell."""
    below = SPEC.split(header + "\n")[1].split("\n")[1:]
    rows = below[: next(i for i, line in enumerate(below) if not line.startswith("|"))]
    return [[cell.strip().strip("`") for cell in row.strip("|").split("|")] for row in rows]


def listed(cell: str) -> set[str]:
    """The entries of a cell; the word "nothing" means none."""
    return set() if cell == "nothing" else set(cell.split(", "))
