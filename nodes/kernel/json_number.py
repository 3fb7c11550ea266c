"""Numbers and figures as JSON can write them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from manyhands.protocol.messages import Figures


def json_number(value: float | None) -> float | None:
    """``value``, or None where JSON cannot write it: it is infinite or not a number."""
    return None if value is None or not math.isfinite(value) else value


def json_figures(figures: Figures, number: Callable[[float], Any] = json_number) -> dict[str, Any]:
    """Figures as a JSON object: numbers by name, and tables as objects; ``number`` makes what JSON can write."""
    tables = {name: _numbers(table, number) for name, table in figures.tables.items()}
    return _numbers(figures, number) | tables


def _numbers(numbers: Mapping[str, float], number: Callable[[float], Any]) -> dict[str, Any]:
    return {name: number(value) for name, value in numbers.items()}
