"""What a benchmark prints and writes: its progress, its files, and its tables within pages.

A page's table stands between two marks and is rewritten there; the text around it stays as it is.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def tell(text: str) -> None:
    """Progress, beside the table on standard output."""
    print(text, file=sys.stderr, flush=True)


def add_outputs(parser: argparse.ArgumentParser) -> None:
    """Add the options for files: --json, --plot and --markdown."""
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="FILE")
    parser.add_argument(
        "--markdown", type=Path, metavar="FILE", help="a page with marks, such as docs/loop-benchmark.md"
    )


def make_folders(*files: Path | None) -> None:
    """Make the folders of the files that were asked for, before anything is measured."""
    for file in files:
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)


def fill(path: Path, mark: str, text: str) -> None:
    """Put ``text`` between ``<!-- mark: begin -->`` and ``<!-- mark: end -->`` of a page.

    Raises:
        SystemExit: the page is not there, or does not have both marks once and in order.
    """
    begin, end = f"<!-- {mark}: begin -->\n", f"<!-- {mark}: end -->"
    page = path.read_text() if path.exists() else ""
    before, found, rest = page.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise SystemExit(f"{path}: found no place for the figures; expected the lines {begin.strip()} and {end}")
    path.write_text(f"{before}{begin}{text.strip()}\n{end}{after}")
