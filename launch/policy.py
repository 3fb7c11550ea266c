"""What follows when a device measures that its loop is not the one the certificate is about: pure.

A certificate assumes that a force acts at most tau after its sample, and that samples come every T. Each device counts
the ticks in which that did not hold; here the counts of its telemetry are made into a decision.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Protocol

from manyhands.nodes import telemetry as names

SHARE: Final = 0.01
"""Of the ticks between two telemetry messages, so many may break an assumption: every machine is late now and then."""

IN_A_ROW: Final = 2
"""Telemetry messages that must break it one after the other: one may be a disturbance that is over already."""


class Policy(StrEnum):
    """What the session wishes."""

    WARN = "warn"
    SOFTEN = "soften"
    STOP = "stop"


class Breach(StrEnum):
    """Which assumption does not hold."""

    DELAY = "delay"
    PERIOD = "period"


class Remedy(StrEnum):
    """What is done."""

    TELL = "tell"
    SOFTEN = "soften"
    END = "end"


REMEDIES: Final[Mapping[tuple[Policy, Breach], Remedy]] = {
    (Policy.WARN, Breach.DELAY): Remedy.TELL,
    (Policy.WARN, Breach.PERIOD): Remedy.TELL,
    (Policy.SOFTEN, Breach.DELAY): Remedy.SOFTEN,
    (Policy.SOFTEN, Breach.PERIOD): Remedy.TELL,  # a softer coupling is certified for a longer delay, not another T
    (Policy.STOP, Breach.DELAY): Remedy.END,
    (Policy.STOP, Breach.PERIOD): Remedy.END,
}
"""What each wish comes to."""

_COUNTS: Final = {Breach.DELAY: names.TAU_BREACHES, Breach.PERIOD: names.PERIOD_BREACHES}


class Ladder(Protocol):
    """Couplings that were certified beforehand for longer delays."""

    @property
    def taus(self) -> tuple[float, ...]:
        """The longest delay that each rung covers, s, growing; rung 0 is the session's own coupling."""
        ...

    @property
    def independent(self) -> bool:
        """Whether every coupling may change by itself."""
        ...


@dataclass(frozen=True)
class Notice:
    """Tell people; a later notice under the same ``key`` says nothing new."""

    key: str
    text: str


@dataclass(frozen=True)
class ShiftCoupling:
    """Change ``coupling`` to ``rung``."""

    coupling: str
    rung: int


@dataclass(frozen=True)
class EndSession:
    """End the session, for this reason."""

    reason: str


Decision = Notice | ShiftCoupling | EndSession


@dataclass
class _Watched:
    """What the last telemetry of a device said, and for how many in a row each assumption has not held."""

    tick: int
    counts: dict[Breach, float]
    in_a_row: dict[Breach, int]
    worst: list[float]  # the longest delay in each of the latest messages, s


class BreachPolicy:
    """Judges the telemetry of every device; couplings only ever get softer."""

    def __init__(
        self,
        policy: Policy,
        chains: Mapping[str, tuple[str, ...]],
        tau: float,
        period: float,
        ladder: Ladder | None,
        rungs: Mapping[str, int],
    ) -> None:
        """Nothing has been measured yet.

        Args:
            policy: the session's wish.
            chains: the couplings of each device.
            tau: the delay that the certificate allows, s.
            period: T, s.
            ladder: softer couplings; None where there are none.
            rungs: the rung that each coupling was changed to, kept by who carries out the decisions.
        """
        self._policy, self._chains, self._tau, self._period = policy, chains, tau, period
        self._ladder = ladder
        self._rungs = rungs
        self._watched: dict[str, _Watched] = {}

    def forget(self, device: str) -> None:
        """``device`` has a new process, which counts from 0."""
        self._watched.pop(device, None)

    def judge(self, device: str, tick: int, figures: Mapping[str, float]) -> list[Decision]:
        """What follows from a device's telemetry up to ``tick``. Of anybody else, or of no sense, nothing does."""
        counts = {breach: figures.get(name, 0.0) for breach, name in _COUNTS.items()}
        if device not in self._chains or not all(math.isfinite(count) and count >= 0.0 for count in counts.values()):
            return []
        out: list[Decision] = []
        if counts[Breach.DELAY] > 0.0:  # at once, whatever comes of it
            out.append(Notice(device, self._assumption(device, figures)))
        before = self._watched.get(device)
        if before is None or tick <= before.tick or any(counts[b] < before.counts[b] for b in Breach):
            self._watched[device] = _Watched(tick, counts, dict.fromkeys(Breach, 0), [])
            return out
        before.worst = [*before.worst, _longest_delay(figures)][-IN_A_ROW:]
        for breach in Breach:
            broken = counts[breach] - before.counts[breach] > SHARE * (tick - before.tick)
            before.in_a_row[breach] = before.in_a_row[breach] + 1 if broken else 0
            if before.in_a_row[breach] == IN_A_ROW:
                before.in_a_row[breach] = 0
                out += self._remedy(device, breach, min(before.worst))
        before.tick, before.counts = tick, counts
        return out

    def _remedy(self, device: str, breach: Breach, measured: float) -> list[Decision]:
        """``measured``: a delay, s, that each of the messages in question reached; one outlier does not decide."""
        found = f"a delay of {measured * 1e6:.0f} us" if breach is Breach.DELAY else "a period"
        allowed = f"{self._tau * 1e6:g} us" if breach is Breach.DELAY else f"{self._period * 1e6:g} us"
        what = f"{device}: {found} again and again that the certificate does not cover (it assumes {allowed})"
        match REMEDIES[self._policy, breach]:
            case Remedy.END:
                return [EndSession(f"{what}; the session's faults.breach is stop")]
            case Remedy.SOFTEN:
                return self._soften(device, measured, what)
            case Remedy.TELL:
                return [Notice(f"{device} {breach}", what)]

    def _soften(self, device: str, measured: float, what: str) -> list[Decision]:
        if self._ladder is None:
            hint = "no softer coupling was designed beforehand: see design.ladder in the session file"
            return [Notice(f"{device} {Breach.DELAY}", f"{what}; {hint}")]
        taus = self._ladder.taus
        rung = next((r for r, tau in enumerate(taus) if tau >= measured), len(taus) - 1)
        couplings = self._chains[device]
        if not self._ladder.independent:  # only all together are certified
            couplings = tuple(dict.fromkeys(coupling for chain in self._chains.values() for coupling in chain))
        stiffer = [coupling for coupling in couplings if self._rungs.get(coupling, 0) < rung]
        out: list[Decision] = [ShiftCoupling(coupling, rung) for coupling in stiffer]
        if stiffer:
            text = f"{what}; {', '.join(stiffer)} softened to rung {rung}, certified for {taus[rung] * 1e6:g} us"
            out.append(Notice(f"{device} rung {rung}", text))
        if measured > taus[-1]:
            text = f"{what}; no coupling of the ladder covers it, the softest is for {taus[-1] * 1e6:g} us"
            out.append(Notice(f"{device} beyond", text))
        return out

    def _assumption(self, device: str, figures: Mapping[str, float]) -> str:
        median = figures.get(f"{names.TAU}_p50", math.nan)
        return (
            f"{device}: a force was applied {_longest_delay(figures) * 1e6:.0f} us after its sample (median "
            f"{median:.0f} us); the certificate assumes {self._tau * 1e6:g} us"
        )


def _longest_delay(figures: Mapping[str, float]) -> float:
    """The longest since the last telemetry, s; for a device that does not say, what 99 % of all ticks kept within."""
    for name in (names.TAU_WORST, f"{names.TAU}_p99"):
        if math.isfinite(told := figures.get(name, math.nan)):
            return told * 1e-6
    return math.inf
