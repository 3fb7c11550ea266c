"""One number as JSON can write it."""

from __future__ import annotations

import math


def json_number(value: float | None) -> float | None:
    """``value``, or None where JSON cannot write it: it is infinite or not a number."""
    return None if value is None or not math.isfinite(value) else value
