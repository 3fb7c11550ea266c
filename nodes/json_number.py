"""One number as JSON has it."""

from __future__ import annotations

import math


def json_number(value: float | None) -> float | None:
    """The number, or None for one that JSON has no words for: infinite, or not a number."""
    return None if value is None or not math.isfinite(value) else value
