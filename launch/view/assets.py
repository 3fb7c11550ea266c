"""The page's own files: read once, served from memory, and none but these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

STATIC: Final = Path(__file__).parent / "static"

TYPES: Final[Mapping[str, str]] = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
"""The kinds of files that are served; what else lies in the folder (a license) is not."""

INDEX: Final = "/index.html"


@dataclass(frozen=True)
class Asset:
    """A file of the page: its type and what is in it."""

    type: str
    content: bytes


def load_assets() -> dict[str, Asset]:
    """Every file of the page, by the path of its address; the page itself also by ``/``.

    Raises:
        OSError: one cannot be read.
    """
    found = {
        f"/{path.relative_to(STATIC).as_posix()}": Asset(TYPES[path.suffix], path.read_bytes())
        for path in sorted(STATIC.rglob("*"))
        if path.suffix in TYPES
    }
    return {**found, "/": found[INDEX]}
