"""The values that bundles are made of, to JSON and back: arrays with their shape, systems, floats."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from manyhands.design.statespace import Matrix, StateSpace, matrix


def plain(value: Any) -> Any:
    """A value as JSON has it: data classes by their fields, arrays with their shape."""
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return {"shape": value.shape, "entries": value.ravel().tolist()}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    return value


def array(data: Any) -> Matrix:
    """A matrix; what is none raises one of the errors that :func:`manyhands.nodes.bundle.load` knows."""
    return matrix(np.array(data["entries"], dtype=np.float64).reshape(data["shape"]))


def system(data: Any) -> StateSpace:
    """A system by its matrices A, B, C, D; likewise."""
    return StateSpace(*(array(data[name]) for name in "ABCD"))


def floats(data: Any) -> tuple[float, ...]:
    """Numbers; likewise."""
    return tuple(float(value) for value in data)
