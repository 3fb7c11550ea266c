"""The rule by which forces and torques of six axes act: what acts is always paid for, whatever comes late."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from manyhands.design.levels.contract import DeviceShare
from manyhands.nodes.device.covered import CoveredHolds
from manyhands.nodes.kernel.bundle import DeviceRung
from manyhands.protocol.clock import Duration, Instant, from_seconds, seconds

T = 1e-3
SHARE = DeviceShare(1.0, 0.5, 0.1)


@dataclass(frozen=True)
class Hold:
    """A pair that acted: its sample, and from when until when, s."""

    sampled: float
    acts: float
    ends: float


class Long(CoveredHolds):
    """A pair acts until the next one does."""

    def until(self, sampled: Instant, at: Instant, *rungs: DeviceRung) -> Instant | None:
        """Ten periods later."""
        return None if super().until(sampled, at, *rungs) is None else Instant(sampled + from_seconds(10 * T))


class Late(CoveredHolds):
    """A pair acts however late, for as long as one that is in time."""

    def until(self, sampled: Instant, at: Instant, *rungs: DeviceRung) -> Instant | None:
        """As of one whose sample came as much later."""
        return super().until(sampled, at, *rungs) or Instant(at + from_seconds(T))


def acted(rng: np.random.Generator, kind: type[CoveredHolds], rung: DeviceRung, ticks: int) -> list[Hold]:
    """The pairs of a device with a driver that measures and acts late, at instants of all kinds."""
    age, delay = (float(rng.uniform(0.0, 0.5)) * rung.tau * (rng.random() < 0.7) for _ in range(2))
    covered = kind(T, from_seconds(age + delay))
    longest, holds, now = T * (1.0 + rung.period_tolerance), list[Hold](), 0.0
    last, wild, late = 0.0, rng.random(), rng.random() < 0.2
    for _ in range(ticks):
        periods = 1.0, rng.uniform(0.1, 1.0), rng.uniform(1.0, 1.0 + 2.5 * wild)
        now = max(last, now) + longest * (0.1 if late else float(rng.choice(periods)))
        delays = 0.0, 1.0, rng.uniform(0.0, 1.0), rng.uniform(1.0, 1.0 + 2.0 * wild)
        at = now + (rung.tau - age - delay) * (3.0 if late else float(rng.choice(delays)))
        last = at
        sample, call = Instant(from_seconds(now)), Instant(from_seconds(at))
        begins = at + delay * float(rng.choice([0.0, 1.0, rng.random()]))
        until = covered.until(sample, call, rung)
        if holds and holds[-1].ends > begins:
            holds[-1] = Hold(holds[-1].sampled, holds[-1].acts, max(begins, holds[-1].acts))
        if until is None:
            continue
        if rng.random() < 0.2:  # the account ends it sooner
            until = Instant(max(call, call + int(rng.random() * (until - call))))
        holds.append(Hold(now - age, begins, max(begins, seconds(Duration(until)) + delay * float(rng.random()))))
    return holds


def spare(holds: list[Hold], d: float) -> float:
    """The least eigenvalue of what d burns less what the holds give out, as a form in the ways between all instants.

    With the way p in a time t, d p^2/t is burnt. A hold of K = 1 gives out (P(s, e)^2 - P(s, a)^2)/2 of the ways P
    since its sample. The form is scaled by the times.
    """
    instants = np.unique(np.concatenate([[one.sampled, one.acts, one.ends] for one in holds]))
    middles, times = (instants[1:] + instants[:-1]) / 2, np.diff(instants)
    kept = times > 1e-12
    middles, times = middles[kept], times[kept]
    form = np.diag(d / times)
    for one in holds:
        whole = ((middles > one.sampled) & (middles < one.ends)).astype(float)
        before = ((middles > one.sampled) & (middles < one.acts)).astype(float)
        form -= (np.outer(whole, whole) - np.outer(before, before)) / 2
    root = np.sqrt(times)
    return float(np.linalg.eigvalsh(root[:, None] * form * root)[0]) / d


def least(kind: type[CoveredHolds], seeds: range, d: Callable[[DeviceRung], float]) -> tuple[float, int]:
    """The least of :func:`spare` over so many courses, and the pairs that acted."""
    found, count = np.inf, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        tau = T * float(rng.choice([0.0, 0.05, 0.25, 0.5, 1.0, rng.uniform(0.0, 1.0)]))
        rung = DeviceRung(tau, float(rng.choice([0.0, 0.1, 0.5])), SHARE)
        holds = acted(rng, kind, rung, 12)
        count += len(holds)
        if len(holds) > 1:
            found = min(found, spare(holds, d(rung)))
    return found, count


def enough(rung: DeviceRung) -> float:
    """(lambda T + 3 tau)/2."""
    return (T * (1.0 + rung.period_tolerance) + 3.0 * rung.tau) / 2.0


def test_whatever_acts_is_paid_for() -> None:
    found, count = least(CoveredHolds, range(600), enough)
    assert found >= -1e-6  # instants are in ns
    assert count > 2000


@pytest.mark.parametrize("kind", [Long, Late])
def test_without_a_part_of_the_rule_it_is_not(kind: type[CoveredHolds]) -> None:
    assert least(kind, range(600), enough)[0] < -0.01


def test_with_less_damping_it_is_not() -> None:
    assert least(CoveredHolds, range(600), lambda rung: enough(rung) / 1.3)[0] < -0.01
