"""The number of cases in a search: few in `make test`, all in `make test-long`."""

from __future__ import annotations

import os
from typing import Final

WIDE: Final = os.environ.get("MANYHANDS_WIDE") == "1"
"""Whether the wide searches run: `make test-long` and `make campaign` set it."""

EXAMPLES: Final = 30
WIDE_EXAMPLES: Final = 100
"""Random cases of each property that states no number of its own."""


def searched(few: int, many: int) -> int:
    """The number of cases of a search that has a target of its own: `MANYHANDS_SEARCHED` states it there."""
    return int(os.environ.get("MANYHANDS_SEARCHED", cases(few, many)))


def cases(few: int, many: int) -> int:
    """The number of cases of one search: ``few`` in `make test`, ``many`` in `make test-long`."""
    return many if WIDE else few
