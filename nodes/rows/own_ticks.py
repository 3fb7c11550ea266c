"""Ticks of a node with a period of its own, and the session's ticks: a node at the site of a wave link may have one.

The *rate* of a node is the number of its ticks in one tick of the session, the quotient of their periods. It is 1 for
every other node, and then both count alike.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

_ROUNDING: Final = 1e-9  # of a tick, for a rate is a quotient of two decimals


def own_tick(tick: float, rate: float) -> int:
    """The first tick of a node with this rate that begins with the session's ``tick`` or later."""
    return math.ceil(tick * rate - _ROUNDING)


def own_tick_before(tick: float, rate: float) -> int:
    """The last tick of a node with this rate that begins with the session's ``tick`` or before."""
    return math.floor(tick * rate + _ROUNDING)


def own_ticks_before(ticks: NDArray[np.int64], rate: float) -> NDArray[np.int64]:
    """:func:`own_tick_before` of each of the session's ``ticks``."""
    return np.asarray(np.floor(ticks * rate + _ROUNDING), dtype=np.int64)


def session_tick(own: int, rate: float) -> int:
    """The session's tick in which the tick ``own`` of a node with this rate begins."""
    return math.floor(own / rate + _ROUNDING)


def own_span(ticks: range, rate: float) -> range:
    """The ticks of a node with this rate that begin within the session's ``ticks``."""
    return range(own_tick(ticks.start, rate), own_tick(ticks.stop, rate))
