"""The time of an environment's step, before and after it sends the forces."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from manyhands.nodes.environment.core import respond
from manyhands.nodes.environment.enforced import EnforcedCore

WARM = 200
"""Ticks before the measurement."""


def step_times(
    core: EnforcedCore, ticks: int, place: Callable[[int], Sequence[float]], touching: Callable[[Sequence[float]], int]
) -> dict[str, float]:
    """Processor times of the thread in microseconds, so that other programs do not count; ``wall_p99`` is by the clock.

    Args:
        core: the environment's, with its controller and ledger.
        ticks: of the measurement; :data:`WARM` come before it.
        place: p of a tick, from 0 on, m, and what rides with it.
        touching: how many things touch, from the forces of a tick, N, and what rides with them.
    """
    touched, react, settle, wall = [], [], [], []
    for k in range(WARM + ticks):
        p = [*place(k)]
        clock, begin = time.perf_counter(), time.thread_time()
        f = respond(core, p, k)
        sent = time.thread_time()
        core.settle()
        end, passed = time.thread_time(), time.perf_counter() - clock
        if k >= WARM:
            react.append(sent - begin)
            settle.append(end - sent)
            wall.append(passed)
            touched.append(touching(f))
    step = 1e6 * (np.array(react) + np.array(settle))
    return {
        "touching": round(float(np.mean(touched)), 1),
        "p50": round(float(np.median(step)), 1),
        "p99": round(float(np.percentile(step, 99)), 1),
        "wall_p99": round(1e6 * float(np.percentile(wall, 99)), 1),
        "before_sending_p50": round(1e6 * float(np.median(react)), 1),
        "before_sending_p99": round(1e6 * float(np.percentile(react, 99)), 1),
        "kept_back": core.controller.ticks if core.controller is not None else 0,
    }
