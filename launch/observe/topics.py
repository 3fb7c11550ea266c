"""What `manyhands hz` finds: how often a topic is told of, and how evenly, and who measured that. Pure.

Ticks come in batches, one telemetry of about a hundred: when a batch arrives says how fast ticks go, and nothing of
how evenly. That the device measures itself, from sample to sample, and tells the percentiles since it was started; the
delays inside its ticks it tells one by one.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from manyhands.launch.looking.topics_named import Named
from manyhands.nodes import telemetry as names
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Condition, Observation
from manyhands.protocol.topics import CONDITION, TAU

DEFAULT_WINDOW: Final = 10_000
"""Messages that figures are taken over, if nothing else is asked for: of a topic of ticks, so many ticks."""


@dataclass(frozen=True, eq=False)
class _Batch:
    """What came at once: when, how many messages, which tick they lead up to, and the delays inside their ticks, us."""

    at: Instant
    messages: int
    tick: int
    tau: tuple[float, ...]


class Pacing:
    """Takes in what is seen, and says how often and how evenly it came.

    Attributes:
        missing: ticks that no telemetry told of, between two that did.
        restarts: times that the node began anew, at a tick that it had told of.
    """

    def __init__(self, named: Named, window: int = DEFAULT_WINDOW) -> None:
        """``window``: messages of the topic that the figures are taken over, at least 2."""
        self._named, self._window = named, window
        self._batches: deque[_Batch] = deque()
        self._kept = 0
        self._figures: dict[str, float] = {}
        self.missing = self.restarts = 0

    def take(self, message: Observation | Condition | None, at: Instant) -> bool:
        """Take in a message that came at ``at``; whether it said anything of the topic."""
        named = self._named
        if isinstance(message, Condition):
            if named.name != CONDITION:
                return False
            self._keep(_Batch(at, 1, 0, ()))
            return True
        if message is None or message.node != named.node:
            return False
        rows = 1
        tau: tuple[float, ...] = ()
        if named.topic is not None:
            trace = message.traces.get(named.topic.trace)
            if trace is None or len(trace) == 0:
                return False
            rows = len(trace)
            delays = message.traces.get(TAU)
            tau = () if delays is None else tuple(delays.ravel().tolist())
            self._follow(message.tick, rows)
        self._figures = dict(message.figures)
        self._keep(_Batch(at, rows, message.tick, tau))
        return True

    def _follow(self, tick: int, rows: int) -> None:
        if not self._batches:
            return
        ended = self._batches[-1].tick
        if tick - rows < ended:
            self.restarts += 1
            self._batches.clear()
            self._kept = 0
        else:
            self.missing += tick - rows - ended

    def _keep(self, batch: _Batch) -> None:
        self._batches.append(batch)
        self._kept += batch.messages
        while len(self._batches) > 2 and self._kept - self._batches[0].messages >= self._window:
            self._kept -= self._batches.popleft().messages

    def found(self) -> dict[str, Any]:
        """What is known by now, as ``--json`` prints it.

        ``rate`` (messages a second; of a topic of ticks, ticks a second) and ``arrival_ms`` need two arrivals, and are
        None before. ``period_us`` and ``tau_us`` are there for a device alone, which measures them.
        """
        batches = list(self._batches)
        ticks = self._named.topic is not None
        rate: float | None = None
        arrival: dict[str, float] | None = None
        if len(batches) >= 2 and batches[-1].at > batches[0].at:
            done = batches[-1].tick - batches[0].tick if ticks else len(batches) - 1
            rate = done * 1e9 / (batches[-1].at - batches[0].at)
            arrival = _spread(np.diff([batch.at for batch in batches]) / 1e6)
        found: dict[str, Any] = {
            "topic": self._named.full,
            "of": "ticks" if ticks else "messages",
            "window": self._kept,
            "rate": rate,
            "arrival_ms": arrival,
        }
        if ticks:
            found |= {"missing": self.missing, "restarts": self.restarts}
            period = {name: self._figures.get(f"{names.PERIOD}_{name}") for name in ("p50", "p99")}
            delays = np.array([delay for batch in batches for delay in batch.tau])
            delays = delays[np.isfinite(delays)]
            if all(value is not None and np.isfinite(value) for value in period.values()):
                found["period_us"] = period
            if delays.size:
                found["tau_us"] = _spread(delays)
        return found


def _spread(values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    p50, p99 = np.percentile(values, (50.0, 99.0)).tolist()
    return {"p50": p50, "p99": p99, "min": float(values.min()), "max": float(values.max())}


def sentence(found: dict[str, Any]) -> str:
    """One line for a person; each figure says who measured it."""
    if found["rate"] is None:
        return f"{found['topic']}: waiting for a second message"
    unit = "ticks/s" if found["of"] == "ticks" else "messages/s"
    parts = [f"{found['topic']}: {found['rate']:.1f} {unit} over {found['window']} {found['of']}"]
    if "period_us" in found:
        period = found["period_us"]
        parts.append(f"period p50/p99 {period['p50']:.0f}/{period['p99']:.0f} us (the device's, since its start)")
    if "tau_us" in found:
        tau = found["tau_us"]
        parts.append(f"tau p50/p99/max {tau['p50']:.0f}/{tau['p99']:.0f}/{tau['max']:.0f} us (the device's)")
    arrival = found["arrival_ms"]
    what = "batches" if found["of"] == "ticks" else "messages"
    spread = f"{arrival['p50']:.1f}/{arrival['p99']:.1f}/{arrival['max']:.1f}"
    parts.append(f"{what} arrive here every p50/p99/max {spread} ms")
    if found["of"] == "ticks":
        parts.append(f"missing {found['missing']}")
        if found["restarts"]:
            parts.append(f"restarts {found['restarts']}")
    return "; ".join(parts)
