"""Pages whose tables a benchmark rewrites between two marks; the text around them stays as it is."""

from __future__ import annotations

from pathlib import Path


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
