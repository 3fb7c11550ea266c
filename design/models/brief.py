"""A repr of a line or a few for objects that hold matrices: sizes and what is typical, instead of every number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST_ITEMS = 4  # of a tuple, a mapping or a diagonal that are shown
_MOST_CHARACTERS = 120  # of one value
_ROUNDING = 1e-6  # relative: smaller entries and differences are not shown


def brief_repr(instance: Any) -> str:
    """``Name(field=value, ...)`` of a dataclass, each value by :func:`brief`; to be assigned to ``__repr__``.

    Fields that are None are left out.
    """
    values = {field.name: getattr(instance, field.name) for field in fields(instance) if field.repr}
    shown = (f"{name}={brief(value)}" for name, value in values.items() if value is not None)
    return f"{type(instance).__name__}({', '.join(shown)})"


def brief(value: object) -> str:
    """A short text for a value: ``1110.2 I (3 x 3)`` for a matrix, the first items of a long list or mapping."""
    match value:
        case np.ndarray():
            return brief_array(value)
        case bool() | int() | str() | None if len(repr(value)) <= _MOST_CHARACTERS:
            return repr(value)
        case float():
            return f"{value:.6g}"
        case Mapping():
            items = [f"{key}: {brief(item)}" for key, item in list(value.items())[:_MOST_ITEMS]]
            return "{" + _joined(items, len(value)) + "}"
        case tuple() | list():
            return "(" + _joined([brief(item) for item in value[:_MOST_ITEMS]], len(value)) + ")"
        case _:
            text = repr(value)
            return text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 3]}..."


def brief_array(values: NDArray[Any]) -> str:
    """A multiple of I or a short diagonal by its numbers, any other array by its shape."""
    if values.ndim != 2 or values.shape[0] != values.shape[1] or not values.size:
        return f"[{' x '.join(map(str, values.shape))}]"
    diagonal = np.diag(values)
    if len(diagonal) == 1:
        return f"{diagonal[0]:.6g}"
    if np.max(np.abs(values - np.diag(diagonal))) > _ROUNDING * np.max(np.abs(values)):
        return f"[{len(diagonal)} x {len(diagonal)}]"
    if np.ptp(diagonal) <= _ROUNDING * np.max(np.abs(diagonal)):
        return f"{diagonal[0]:.6g} I ({len(diagonal)} x {len(diagonal)})"
    return "diag(" + _joined([f"{entry:.6g}" for entry in diagonal[:_MOST_ITEMS]], len(diagonal)) + ")"


def brief_names(names: Sequence[str]) -> str:
    """Names separated by commas; of many the first ones and their number."""
    return _joined([*names[:_MOST_ITEMS]], len(names))


def _joined(items: list[str], size: int) -> str:
    return ", ".join(items if size <= _MOST_ITEMS else [*items[: _MOST_ITEMS - 1], f"... {size} in all"])
