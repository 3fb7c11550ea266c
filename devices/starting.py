"""What drivers do at their start: check what a session gives them, and measure trips."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeGuard

from manyhands.nodes.device.specification import ACTUATION_DELAY, AGE_JITTER, SAMPLE_AGE
from manyhands.protocol.clock import Duration, seconds

TRIPS: Final = 200
"""Exchanges of which the longest counts."""


def merged(parameters: Mapping[str, Any], known: Mapping[str, object]) -> dict[str, Any]:
    """The parameters of a session, with what holds where one is not given.

    Raises:
        ValueError: one is not known.
    """
    for name in parameters:
        if name not in known:
            raise ValueError(f"parameters: found {name!r:.40}; expected {', '.join(known)}")
    return {**known, **parameters}


def checked(parameters: Mapping[str, Any], known: Mapping[str, object], times: Sequence[str]) -> dict[str, Any]:
    """The parameters of a session for a device behind a serial port, with what holds where one is not given.

    Args:
        parameters: as the session gives them.
        known: every parameter of the driver, ``port`` and ``baud`` among them, and what holds where it is not given.
        times: those that are times in s; one of None may stay so.

    Raises:
        ValueError: one is not known, there is no port, or a value is none of its kind.
    """
    given = merged(parameters, known)
    if not isinstance(given["port"], str) or not given["port"]:
        raise ValueError("parameters.port: found none; expected the device's serial port, as /dev/ttyACM0")
    if not isinstance(given["baud"], int):
        raise ValueError(f"parameters.baud: found {given['baud']!r:.40}; expected bits a second")
    for name in times:
        value = given[name]
        if value is None and known[name] is None:
            continue
        if not is_number(value) or not 0.0 < value < 1.0:
            raise ValueError(f"parameters.{name}: found {value!r:.40}; expected a time in s, below 1")
    return given


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether it is a finite number, and no truth value."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def trips(trip: Callable[[], Duration]) -> tuple[float, float]:
    """The shortest and the longest of :data:`TRIPS` exchanges with the device, s; ``trip`` does one, ns."""
    of_each = sorted(seconds(trip()) for _ in range(TRIPS))
    return of_each[0], of_each[-1]


def measured_times(given: Mapping[str, Any]) -> tuple[str, ...]:
    """The times that a driver measures at its start, where a session's parameters have None in their place."""
    age = () if given[SAMPLE_AGE] is not None else (SAMPLE_AGE, AGE_JITTER)
    return age if given[ACTUATION_DELAY] is not None else (*age, ACTUATION_DELAY)
