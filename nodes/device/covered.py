"""Which forces and torques act where the motors of six axes hold both as torques of joints (:class:`CoveredHolds`).

What held torques give out beyond what force and torque count is paid for by a part of the device's damping, in every
motion, as long as each pair of them acts within the delay and the period of the certificate
(docs/decisions/0054-orientation.md). A late pair would give out more than that pays for. So it does not act, and no
pair acts for longer. With s the sample of a pair, a and e the instants from which and until which it acts, and a' that
from which the pair before it acted that did,

    a - s <= tau,    e <= s + lambda T + tau,    a' <= s.

No account is needed then, and no work has to be known. Where a driver's samples are up to A old and its torques act up
to delta late, s is the earliest instant that may be, and a and e are the latest. Nothing is claimed of a device that
turns faster than it states (:class:`TurningSpeed`).
"""

from __future__ import annotations

from typing import Final

from manyhands.nodes.kernel.bundle import DeviceRung
from manyhands.nodes.kernel.orientation import Quaternion, angle
from manyhands.protocol.clock import Duration, Instant, from_seconds, seconds

_EQUAL: Final = 1.0 + 1e-9
"""Of a speed: that of an angle between two orientations, in doubles."""


class TurningSpeed:
    """Whether a device has turned faster than its greatest speed from one tick's row to the next."""

    def __init__(self, most: float, jitter: float) -> None:
        """Begin before the first row.

        Args:
            most: the greatest speed, rad/s.
            jitter: by how much the time between two samples may be longer than that between their rows, s.
        """
        self._most, self._jitter = most, jitter
        self._before: tuple[Quaternion, Instant] | None = None

    def beyond(self, now: Quaternion, at: Instant) -> bool:
        """Whether it has turned to ``now``, the orientation of the row at ``at``, faster than that; no at the first."""
        before, self._before = self._before, (now, at)
        if before is None:
            return False
        turned, since = before
        return angle(turned, now) > self._most * (seconds(Duration(at - since)) + self._jitter) * _EQUAL


class CoveredHolds:
    """The rule above, for one device in wall time."""

    def __init__(self, T: float, latency: Duration) -> None:
        """Begin without a pair.

        Args:
            T: period, s.
            latency: the age of a sample and the delay of a force beside the loop, A + delta together, ns.
        """
        self._T, self._latency = T, latency
        self._acted: Instant | None = None  # from when the last pair acted, by the device's calls

    def until(self, sampled: Instant, at: Instant, *rungs: DeviceRung) -> Instant | None:
        """Until when a pair acts that was sampled at ``sampled`` and comes at ``at``; None where it does not act.

        Args:
            sampled: the instant of its sample.
            at: the instant of the call that lets it act.
            rungs: those of which the device has set damping aside; the narrowest counts.
        """
        tau = min(from_seconds(rung.tau) for rung in rungs)
        longest = min(from_seconds(self._T * (1.0 + rung.period_tolerance)) for rung in rungs)
        overtakes = self._acted is not None and self._acted + self._latency > sampled
        if at - sampled + self._latency > tau or overtakes:
            return None
        self._acted = at
        return Instant(sampled + longest + tau - self._latency)
