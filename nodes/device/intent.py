"""What a simulated hand intends: a force or a motion as a pure function of time.

A session file says it as a number, as a formula in ``t`` or as a recorded trace; :func:`intent_from` turns
each into a callable. All three are deterministic, so that two runs of a session intend the same.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final, TypeAlias

import numpy as np

from manyhands.nodes.device.formula import Formula, FormulaError

__all__ = [
    "Constant",
    "Formula",
    "FormulaError",
    "Intent",
    "IntentData",
    "IntentError",
    "Trace",
    "intent_from",
]

MAX_TRACE_SAMPLES: Final = 1_000_000

Intent: TypeAlias = Callable[[float], float]
IntentData: TypeAlias = float | str | Mapping[str, Sequence[float]]


class IntentError(ValueError):
    """A number or a recorded trace that cannot be an intent; the text says why."""


class Trace:
    """A recorded signal: linear between its samples, and its last value afterwards.

    Args:
        times: sample times (s), strictly increasing from 0; at most ``MAX_TRACE_SAMPLES``.
        values: the signal at those times, one each.

    Raises:
        IntentError: nothing is there, lengths differ, a number is not finite, or times do not increase
            strictly from 0; samples are counted from 1.
    """

    __slots__ = ("_times", "_values")

    def __init__(self, times: Sequence[float], values: Sequence[float]) -> None:
        if not 1 <= len(times) <= MAX_TRACE_SAMPLES:
            raise IntentError(f"{len(times)} samples; expected 1 to {MAX_TRACE_SAMPLES}")
        if len(times) != len(values):
            raise IntentError(f"{len(times)} times and {len(values)} values; expected as many of both")
        self._times = np.array(times, dtype=np.float64)
        self._values = np.array(values, dtype=np.float64)
        unusable = np.flatnonzero(~(np.isfinite(self._times) & np.isfinite(self._values)))
        if unusable.size:
            raise IntentError(f"sample {unusable[0] + 1} is not finite; expected finite numbers")
        if self._times[0] != 0.0:
            raise IntentError(f"the first time is {self._times[0]:g} s; expected 0")
        stalled = np.flatnonzero(np.diff(self._times) <= 0.0)
        if stalled.size:
            i = int(stalled[0]) + 1
            before, after = self._times[i - 1], self._times[i]
            raise IntentError(f"sample {i + 1} is at {after:g} s, after {before:g} s; expected increasing times")

    def __call__(self, t: float) -> float:
        """The value at time ``t`` (s); the first value before 0."""
        return float(np.interp(t, self._times, self._values))


class Constant:
    """An intent that does not change."""

    __slots__ = ("value",)

    def __init__(self, value: float) -> None:
        if not math.isfinite(value):
            raise IntentError(f"the number {value!r} is not finite")
        self.value = float(value)

    def __call__(self, t: float) -> float:
        """The value, whatever ``t`` is."""
        return self.value


def intent_from(data: IntentData) -> Intent:
    """The intent that a session writes as a number, a formula, or ``{"times": [...], "values": [...]}``.

    Raises:
        FormulaError: the formula is not allowed.
        IntentError: the data is of another form, or its numbers are unusable.
    """
    match data:
        case bool():
            pass  # a number to Python, but no intent
        case int() | float():
            return Constant(float(data))
        case str():
            return Formula(data)
        case Mapping() if set(data) == {"times", "values"}:
            return Trace(data["times"], data["values"])
        case _:
            pass  # refused below
    raise IntentError(
        f"{type(data).__name__} is no intent; expected a number, a formula or a trace of times and values"
    )
