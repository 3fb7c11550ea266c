"""SPEC.md as data: its text and its tables, for the tests that hold it against the code.

``python -m tests.support.spec_text`` writes its table of figures from their declarations.
"""

from pathlib import Path
from typing import Final

import manyhands.protocol
from manyhands.nodes.rows.figures import FIGURES

PATH: Final = Path(manyhands.protocol.__file__).parent / "SPEC.md"
SPEC = PATH.read_text(encoding="utf-8")
OF_FIGURES: Final = "| figure | for each | unit | what |"
"""The head of the table of figures."""


def figure_rows() -> list[str]:
    """The rows of the table of figures."""
    return [f"| `{figure.name}` | {figure.key or ''} | {figure.unit} | {figure.says} |" for figure in FIGURES.values()]


def table(header: str) -> list[list[str]]:
    """The cells of the table that begins with ``header``, without the backticks around a whole cell."""
    below = SPEC.split(header + "\n")[1].split("\n")[1:]
    rows = below[: next(i for i, line in enumerate(below) if not line.startswith("|"))]
    return [[cell.strip().strip("`") for cell in row.strip("|").split("|")] for row in rows]


def listed(cell: str) -> set[str]:
    """The entries of a cell; the word "nothing" means none."""
    return set() if cell == "nothing" else set(cell.split(", "))


def main() -> None:
    """Write the table of figures anew."""
    head, _, rest = SPEC.partition(f"{OF_FIGURES}\n|---|---|---|---|\n")
    after = rest[rest.index("\n\n") :]
    PATH.write_text(f"{head}{OF_FIGURES}\n|---|---|---|---|\n" + "\n".join(figure_rows()) + after, encoding="utf-8")


if __name__ == "__main__":
    main()
