"""The rooms of the repository: the folders that src/manyhands links to."""

from __future__ import annotations

from pathlib import Path
from typing import Final

_LINKS: Final = Path(__file__).parents[2] / "src" / "manyhands"

ROOMS: Final = tuple(sorted(path.name for path in _LINKS.iterdir() if path.is_symlink()))
