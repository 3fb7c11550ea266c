"""What follows when a device measures that its loop differs from the certified one: pure.

A certificate assumes that a force acts at most tau after its sample, and that samples are at most (1 + rho) T apart,
with rho the period tolerance, or more after an early force. Each device counts the ticks in which that did not hold.
:class:`BreachPolicy` turns these counts into a decision: a notice, a softer coupling, or the session's end.
:class:`Assumptions` feeds it with the telemetry of one run.

Every machine is late now and then, and a design takes a quantile of the delays (:mod:`manyhands.launch.doctor.profile`
covers 99.5 %). So a single late tick has no consequence. A *burst*, more than :data:`SHARE` of the ticks of
:data:`IN_A_ROW` messages, is answered at once. People get a notice of late ticks only when they are more than
:data:`ALLOWED` of all, or when couplings were softened. There is one notice for each :class:`Cause`, which names all
devices that it is about, and what to do next.

The time that a device waited for *another* user is not its own. The environment charges late couplings
(:mod:`manyhands.nodes.environment.late_arrivals`), and waits no longer for one that is late again and again. The ticks
that were charged to other couplings are taken off a device's telemetry, and the rest is judged. The environment's
telemetry may arrive after the device's, so a message is judged only when the environment has reported its ticks.

A softened coupling climbs again, one rung at a time, when its devices have kept within the next stiffer rung, with a
margin, for :data:`CALM`. A coupling that is softened again after it has climbed must be calm for twice as long each
time. So the number of changes grows with the logarithm of time.

:class:`UserIncidents` describes what a session survives of its users: couplings that stay frozen, and energy. A device
beyond its limits knows that it is, but not what moved it. The environment knows whose energy went where
(:mod:`manyhands.nodes.monitor.causes`). The two are combined here, so that the incident names the supplier and not
the user that was moved.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final, Protocol

import numpy as np

from manyhands.design.models.axis import TRANSLATING, Units
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.topology import Topology
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.monitor.causes import Causes
from manyhands.nodes.monitor.given import MEASURE
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.lateness import lateness_by_coupling
from manyhands.nodes.rows.own_ticks import session_tick
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.protocol.messages import Figures, Role, Telemetry

SHARE: Final = 0.05
"""The part of the ticks between two telemetry messages that may break an assumption. Lateness comes in bursts: with a
tau that covered 99.5 % of all ticks, two messages in a row had more than 1 % in 40 to 80 of 100 runs of ten seconds,
and in none more than 5 % (docs/decisions/0031-designed-for-the-machine.md)."""

ALLOWED: Final = 0.01
"""The part of a device's ticks that may be late in a whole run without a notice: twice what a design leaves out."""

LEAST: Final = 50
"""Late ticks of a device without which there is no notice: as many as :data:`ALLOWED` of the first 5 s at 1 kHz. One
burst of a shared machine takes 10 to 40 ticks, and would be more than 1 % of every run's first second."""

IN_A_ROW: Final = 2
"""Number of successive telemetry messages that must break it: a single one may be a disturbance that is over already.
"""


UNSURE: Final = 1 / 3
"""The part of the ticks in which a device waited for others that is excused on top of those ticks. It applies before
a notice reports the device as late, and before its coupling is softened. A quarter of a late guest's ticks may fall
where the environment cannot decide whose they are (CROSSING in nodes/environment/late_arrivals.py), and by chance more
of some fifty. A user that often makes others wait is soon not waited for, which ends the excuse."""

CALM: Final = 5.0
"""Seconds for which a softened coupling must have needed no more than the next stiffer rung before it climbs to it."""

MARGIN: Final = 0.8
"""The part of a rung's delay that may be used before a coupling climbs to it; it is softened above the whole delay."""

MOST_DOUBLINGS: Final = 10
"""The most doublings of :data:`CALM`: it grows to an hour and a half at most."""

MOST_HELD: Final = 8
"""The most telemetry messages of a device that are held until the environment has reported their ticks."""

MOST_WAITS: Final = 32
"""Telemetry messages of the environment that are kept: a device's are a few behind at most."""


class Policy(StrEnum):
    """What the session file asks for in ``faults.breach``."""

    WARN = "warn"
    SOFTEN = "soften"
    STOP = "stop"


class Breach(StrEnum):
    """An assumption of the certificate that does not hold."""

    DELAY = "delay"
    PERIOD = "period"


class Cause(StrEnum):
    """What a notice is about. A run has at most one notice of each."""

    DELAY = "delay"
    PERIOD = "period"
    WAITS = "waits"
    BEGINNING = "beginning"


class Reply(StrEnum):
    """What is done about a breach."""

    NOTICE = "notice"
    SOFTEN = "soften"
    END = "end"


REPLIES: Final[Mapping[tuple[Policy, Breach], Reply]] = {
    (Policy.WARN, Breach.DELAY): Reply.NOTICE,
    (Policy.WARN, Breach.PERIOD): Reply.NOTICE,
    (Policy.SOFTEN, Breach.DELAY): Reply.SOFTEN,
    (Policy.SOFTEN, Breach.PERIOD): Reply.NOTICE,  # a softer coupling is certified for a longer delay, not another T
    (Policy.STOP, Breach.DELAY): Reply.END,
    (Policy.STOP, Breach.PERIOD): Reply.END,
}
"""The reply for each policy and breach."""

_COUNTS: Final = {Breach.DELAY: names.TAU_BREACHES, Breach.PERIOD: names.PERIOD_BREACHES}


class CertifiedLadder(Protocol):
    """Couplings that were certified beforehand for longer delays."""

    @property
    def taus(self) -> tuple[float, ...]:
        """The longest delay that each rung covers, s, growing; rung 0 is the session's own coupling."""
        ...

    @property
    def independent(self) -> bool:
        """Whether each coupling may change without the others."""
        ...


@dataclass(frozen=True)
class Notice:
    """A sentence for people; a later one about the same cause replaces it."""

    cause: Cause
    text: str


@dataclass(frozen=True)
class ShiftCoupling:
    """Change ``coupling`` to ``rung``."""

    coupling: str
    rung: int


@dataclass(frozen=True)
class EndSession:
    """End the session for ``reason``."""

    reason: str


Decision = Notice | ShiftCoupling | EndSession


@dataclass(frozen=True)
class Covered:
    """What the certificate of a device covers.

    Attributes:
        tau: the longest delay inside the tick, s.
        period: T of the device, s.
        period_tolerance: rho; periods up to (1 + rho) T are covered.
        in_tick: whether the device waits for the other users within its tick; behind a wave link it waits for nobody.
    """

    tau: float
    period: float
    period_tolerance: float = 0.0
    in_tick: bool = True

    @property
    def longest_period(self) -> float:
        """(1 + rho) T, s."""
        return self.period * (1.0 + self.period_tolerance)


@dataclass(frozen=True)
class _DeviceTelemetry:
    """One telemetry message of a device.

    Attributes:
        tick: the tick after its last.
        counts: of breaches so far.
        figures: all of them.
        taus: the delay of each of its ticks, s; empty where the device does not report it.
    """

    tick: int
    counts: Mapping[Breach, float]
    figures: Figures
    taus: Sequence[float]


@dataclass
class _DeviceHistory:
    """The last telemetry of a device, and for how many messages in a row each assumption has not held."""

    tick: int
    counts: Mapping[Breach, float]
    in_a_row: dict[Breach, int]
    worst: list[float]  # the longest delay in each of the latest messages, s
    calm: list[int]  # by rung: number of ticks in a row for which the rung would have sufficed


@dataclass
class _LateTicks:
    """The ticks of one device in which an assumption did not hold, over all of its processes."""

    ticks: float = 0.0
    of: int = 0
    longest: float = 0.0  # of the delays, s

    @property
    def worth_a_notice(self) -> bool:
        return self.ticks > max(ALLOWED * self.of, LEAST)


class BreachPolicy:
    """Judges the telemetry of every device."""

    def __init__(
        self,
        policy: Policy,
        chains: Mapping[str, tuple[str, ...]],
        covered: Mapping[str, Covered],
        ladder: CertifiedLadder | None,
        rungs: Mapping[str, int],
        no_ladder: str = "",
    ) -> None:
        """Begin without any telemetry.

        Args:
            policy: the session's wish.
            chains: the couplings of each device.
            covered: what the certificate of each device covers.
            ladder: softer couplings; None where there are none.
            rungs: the rung that each coupling was changed to; the caller, which carries out decisions, updates it.
            no_ladder: why there are no softer couplings, where none could be designed.
        """
        self._no_ladder = no_ladder or "no softer coupling was designed beforehand (design.ladder)"
        self._policy, self._chains, self._covered = policy, chains, covered
        self._ladder, self._rungs = ladder, rungs
        self._late: dict[Breach, dict[str, _LateTicks]] = {breach: {} for breach in Breach}
        self._named: dict[Breach, list[str]] = {breach: [] for breach in Breach}  # devices that a notice names
        self._softened: dict[str, float] = {}  # couplings, and the delay that each was softened for, s
        self._watched: dict[str, _DeviceHistory] = {}
        self._held: dict[str, deque[_DeviceTelemetry]] = {}
        self._waits: deque[tuple[int, Mapping[str, Collection[int]]]] = deque(maxlen=MOST_WAITS)
        self._climbed: set[str] = set()  # couplings that climbed, and were not softened since
        self._doublings: dict[str, int] = {}

    def forget(self, device: str) -> None:
        """``device`` has a new process, which counts from 0."""
        self._watched.pop(device, None)
        self._held.pop(device, None)

    def judge(self, device: str, tick: int, figures: Figures, taus: Sequence[float] = ()) -> list[Decision]:
        """Decide what follows from a device's telemetry; unknown nodes and counts that make no sense have no
        consequence.

        Args:
            device: its name.
            tick: the tick after the telemetry's last.
            figures: the telemetry's.
            taus: the delay of each of its ticks, s; empty where the device does not report it.
        """
        counts = {breach: figures.get(name, 0.0) for breach, name in _COUNTS.items()}
        if device not in self._chains or not all(math.isfinite(count) and count >= 0.0 for count in counts.values()):
            return []
        message = _DeviceTelemetry(tick, counts, figures, taus)
        if not self._waits or tick <= self._waits[-1][0] or not self._covered[device].in_tick:
            return self._judge(device, message)
        held = self._held.setdefault(device, deque())
        held.append(message)
        return self._judge(device, held.popleft()) if len(held) > MOST_HELD else []

    def take_waits(self, tick: int, late: Mapping[str, Collection[int]]) -> list[Decision]:
        """Decide what follows once the environment has reported the late ticks of each coupling up to ``tick``."""
        if self._waits and tick <= self._waits[-1][0]:
            self._waits.clear()  # a new process of the environment, which counts the ticks anew
        self._waits.append((tick, late))
        out: list[Decision] = []
        for device, held in self._held.items():
            while held and held[0].tick <= tick:
                out += self._judge(device, held.popleft())
        return out

    def _judge(self, device: str, message: _DeviceTelemetry) -> list[Decision]:
        tick, counts = message.tick, message.counts
        out: list[Decision] = []
        before = self._watched.get(device)
        if before is not None and (tick <= before.tick or any(counts[b] < before.counts[b] for b in Breach)):
            before = None  # another process
        begin = tick - len(message.taus)
        since = begin if before is None else before.tick
        for_others = self._waited_for_others(device, since - 1, tick)  # a period ends in the tick after
        own = sorted((tau for at, tau in enumerate(message.taus, begin) if at not in for_others), reverse=True)
        longest = max(own, default=0.0) if for_others and message.taus else _longest_delay(message.figures)
        # often-late couplings were late in further ticks as well, in which the environment could not be sure of it
        unsure = max(SHARE * (tick - since), UNSURE * len(for_others)) if for_others else 0.0
        excused = len(for_others) * (1.0 + UNSURE)
        ticks = tick if before is None and not message.taus else tick - since
        for breach in Breach:
            already = 0.0 if before is None else before.counts[breach]
            out += self._add(breach, device, max(counts[breach] - already - excused, 0.0), ticks, longest)
        if before is None:
            calm = [0] * (1 if self._ladder is None else len(self._ladder.taus))
            self._watched[device] = _DeviceHistory(tick, counts, dict.fromkeys(Breach, 0), [], calm)
            return out
        before.worst = [*before.worst, longest][-IN_A_ROW:]
        for breach in Breach:
            share = max(SHARE * (tick - before.tick), unsure)
            broken = counts[breach] - before.counts[breach] - len(for_others) > share
            before.in_a_row[breach] = before.in_a_row[breach] + 1 if broken else 0
            if before.in_a_row[breach] == IN_A_ROW:
                before.in_a_row[breach] = 0
                out += self._reply(device, breach, min(before.worst))
        before.tick, before.counts = tick, counts
        return out + self._climb(device, before, own)

    def _waited_for_others(self, device: str, begin: int, end: int) -> set[int]:
        """The ticks in ``begin <= tick < end`` in which a coupling was late that does not belong to ``device``."""
        if not self._covered[device].in_tick:
            return set()
        chain = self._chains[device]
        late = (
            ticks for _, by_coupling in self._waits for coupling, ticks in by_coupling.items() if coupling not in chain
        )
        return {tick for ticks in late for tick in ticks if begin <= tick < end}

    def _climb(self, device: str, watched: _DeviceHistory, own: Sequence[float]) -> list[Decision]:
        """Decide which couplings of ``device`` go back to the next stiffer rung.

        Args:
            device: its name.
            watched: what is known of it.
            own: the delays of its last ticks, s, the longest first.
        """
        ladder = self._ladder
        if ladder is None or not own or not self._covered[device].in_tick:
            return []
        needed = own[min(int(SHARE * len(own)), len(own) - 1)]
        for rung, tau in enumerate(ladder.taus):
            watched.calm[rung] = watched.calm[rung] + len(own) if needed <= MARGIN * tau else 0
        couplings = self._chains[device] if ladder.independent else self._all_couplings
        softest = max((self._rungs.get(coupling, 0) for coupling in couplings), default=0)
        groups = [(coupling,) for coupling in couplings] if ladder.independent else [couplings]
        out: list[Decision] = []
        for group in groups if softest else ():
            rung = max(self._rungs.get(coupling, 0) for coupling in group) - 1
            if rung < 0 or not all(self._calm(group, rung)):
                continue
            out += [ShiftCoupling(coupling, rung) for coupling in group]
            self._climbed.update(group)
            for other in self._devices_of(group):
                self._watched[other].calm = [0] * len(ladder.taus)
        return out

    def _calm(self, group: Sequence[str], rung: int) -> Iterator[bool]:
        """Whether each device of these couplings has needed no more than ``rung`` for long enough."""
        doublings = max(self._doublings.get(coupling, 0) for coupling in group)
        for device in self._devices_of(group):
            watched, wanted = self._watched.get(device), CALM / self._covered[device].period * 2.0**doublings
            yield watched is not None and watched.calm[rung] >= wanted

    def _devices_of(self, group: Sequence[str]) -> list[str]:
        return [device for device, chain in self._chains.items() if set(chain) & set(group)]

    @property
    def _all_couplings(self) -> tuple[str, ...]:
        """The couplings of the ladder, those in the tick."""
        chains = (chain for device, chain in self._chains.items() if self._covered[device].in_tick)
        return tuple(dict.fromkeys(coupling for chain in chains for coupling in chain))

    def _reply(self, device: str, breach: Breach, measured: float) -> list[Decision]:
        """Apply the policy; ``measured`` is a delay, s, that each message in question reached, so one outlier decides
        nothing.
        """
        match REPLIES[self._policy, breach]:
            case Reply.END:
                covered = self._covered[device]
                if breach is Breach.DELAY:
                    found, allowed = f"its delay ({_ms(measured)})", _ms(covered.tau)
                else:
                    found = "the time between its samples"
                    allowed = f"{_ms(covered.longest_period)}, more after an early force"
                what = f"{device}: {found} keeps exceeding what the certificate covers ({allowed})"
                return [EndSession(f"{what}; the session's faults.breach is stop")]
            case Reply.SOFTEN:
                softened = self._soften(device, measured)
                return [*softened, *self._name(breach, device, news=bool(softened))]
            case Reply.NOTICE:
                return [*self._name(breach, device)]

    def _soften(self, device: str, measured: float) -> list[ShiftCoupling]:
        if self._ladder is None or not self._covered[device].in_tick:
            return []
        taus = self._ladder.taus
        rung = next((r for r, tau in enumerate(taus) if tau >= measured), len(taus) - 1)
        couplings = self._chains[device]
        if not self._ladder.independent:  # only all together are certified
            couplings = self._all_couplings
        stiffer = [coupling for coupling in couplings if self._rungs.get(coupling, 0) < rung]
        for coupling in self._climbed.intersection(stiffer):
            self._doublings[coupling] = min(self._doublings.get(coupling, 0) + 1, MOST_DOUBLINGS)
        self._climbed.difference_update(stiffer)
        self._softened |= {c: max(taus[rung], self._softened.get(c, 0.0)) for c in stiffer}
        return [ShiftCoupling(coupling, rung) for coupling in stiffer]

    def _add(self, breach: Breach, device: str, late: float, ticks: int, longest: float) -> list[Notice]:
        """Add late ticks of ``device``; returns the notice of this breach once they are worth one."""
        found = self._late[breach].setdefault(device, _LateTicks())
        found.ticks, found.of = found.ticks + late, found.of + max(ticks, 0)
        found.longest = max(found.longest, longest if late else 0.0)
        return self._name(breach, device) if found.worth_a_notice else []

    def _name(self, breach: Breach, device: str, news: bool = False) -> list[Notice]:
        """The notice of this breach, which names ``device`` and all devices before it; none where it names it already.

        A notice does not change with every message: observers and recordings take each text for a new one.

        Args:
            breach: what did not hold.
            device: the device's name.
            news: whether something was done that the notice has to include.
        """
        named = self._named[breach]
        if device in named and not news:
            return []
        if device not in named:
            named.append(device)
        late = self._late[breach]
        whole = all(self._covered[name].tau >= self._covered[name].period for name in named)
        next_ = MEASURE if any(self._covered[name].in_tick for name in named) else _BEHIND_LINKS
        if breach is Breach.PERIOD:
            who = {name: f"{name} in {_part(late[name])} of its ticks" for name in named}
            periods = {name: _ms(self._covered[name].longest_period) for name in named}
            found = _beyond(who, periods, "more after an early force")
            text = f"the time between samples exceeded what the certificate covers {found} so far"
            return [Notice(Cause.PERIOD, f"{text}; {next_}")]
        delays = {
            name: f"{name} in {_part(late[name])} of its ticks, up to {_ms(late[name].longest)}" for name in named
        }
        found = _beyond(delays, {name: _ms(self._covered[name].tau) for name in named})
        text = f"forces came later than the certificate covers {found} so far"
        return [Notice(Cause.DELAY, f"{text}{self._reaction(whole)}; {next_}")]

    def _reaction(self, whole: bool) -> str:
        """What was done about the delays so far, as a part of the notice; ``whole`` where a whole period is covered."""
        if self._policy is not Policy.SOFTEN:
            return ""
        if self._ladder is None:  # above a whole period there is nothing to design, nor are there rungs for wave links
            linked = not any(self._covered[name].in_tick for name in self._named[Breach.DELAY])
            return "" if whole or linked else f"; {self._no_ladder}"
        if not self._softened:
            return ""
        most = self._ladder.taus[-1]
        longest = max(late.longest for late in self._late[Breach.DELAY].values())
        beyond = f"; none is certified for more than {_ms(most)}" if longest > most else ""
        softened = ", ".join(sorted(self._softened))
        certified = _ms(max(self._softened.values()))
        return f"; softened, once their users let go, to what is certified for {certified}: {softened}{beyond}"


_BEHIND_LINKS: Final = "the delay is that of the user's own machine, and not of the network"


def _beyond(found: Mapping[str, str], covered: Mapping[str, str], *more: str) -> str:
    """What was found of each device beyond what is covered, which is stated once where it is the same for all."""
    first, *others = dict.fromkeys(covered.values())
    if not others:
        return f"({', '.join((first, *more))}): {', '.join(found.values())}"
    each = ", ".join(f"{text} (covered {covered[device]})" for device, text in found.items())
    return f"({', '.join(more)}): {each}" if more else f"for each device: {each}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"


def _part(late: _LateTicks) -> str:
    return f"{min(late.ticks / max(late.of, 1), 1.0):.1%}"


def _longest_delay(figures: Figures) -> float:
    """The longest delay since the last telemetry, s; where a device does not report it, the 99th percentile."""
    for delay in (figures.get(names.TAU_WORST, math.nan), figures.table(names.TAU).get("p99", math.nan)):
        if math.isfinite(delay):
            return delay * 1e-6
    return math.inf


class Assumptions:
    """The certificate's assumptions in one run.

    Attributes:
        notices: what people should know of the run, a sentence by its cause.
        waited_for: the couplings that made the others wait, and are not waited for since.
    """

    def __init__(self, prepared: Prepared, graph: Topology, clock: str, rungs: Mapping[str, int]) -> None:
        """Begin without any telemetry.

        Args:
            prepared: the session with its coupling and certificate.
            graph: its nodes and links.
            clock: "realtime" or "simulated"; nothing is late under the simulated one.
            rungs: the rung of the ladder that each coupling was changed to.
        """
        session = prepared.session
        devices = [name for name, role in graph.nodes.items() if role is Role.DEVICE]
        chains = {device: graph.couplings_of(device) for device in devices}
        self._policy = BreachPolicy(
            Policy(session.faults.breach),
            chains if prepared.certified and clock == REALTIME else {},
            {device: _covered(prepared, device) for device in devices},
            prepared.ladder,
            rungs,
            prepared.notes[0] if prepared.ladder is None and prepared.notes else "",
        )
        self._couplings = [name for name, role in graph.nodes.items() if role is Role.COUPLING]
        self._policy.take_waits(0, {})  # from tick 0 on, the environment reports which couplings were late
        self.notices: dict[Cause, str] = {}
        self.waited_for: list[str] = []
        self._to_begin = {*devices}
        self._units = {device: session.devices[device].units for device in devices}
        self._away: list[str] = []  # devices that began elsewhere than in 0, and what follows, in words

    def forget(self, node: str) -> None:
        """``node`` has a new process, which counts from 0."""
        self._policy.forget(node)

    def check(self, node: str, telemetry: Telemetry) -> list[ShiftCoupling | EndSession]:
        """Add what a node's telemetry shows to the notices; returns what is to be done."""
        deeds: list[ShiftCoupling | EndSession] = []
        if node == ENVIRONMENT:
            decisions = self._policy.take_waits(telemetry.tick, self._late_ticks(telemetry))
        else:
            if node in self._to_begin:
                self._to_begin.discard(node)
                self._note_beginning(node, telemetry)
            tau = telemetry.traces.get(names.TAU, _NO_TAU)
            decisions = self._policy.judge(node, telemetry.tick, telemetry.figures, (tau.ravel() * 1e-6).tolist())
        for decision in decisions:
            if isinstance(decision, Notice):
                self.notices[decision.cause] = decision.text
            else:
                deeds.append(decision)
        return deeds

    def _note_beginning(self, device: str, telemetry: Telemetry) -> None:
        """Note a device that began far from 0: most of the way there was taken for what lateness may have put in."""
        x, offset = telemetry.traces.get(names.DISPLACEMENT), telemetry.figures.get(names.INTERFACE_OFFSET, 0.0)
        if x is None or not 0 < telemetry.tick == len(x):
            return
        away = float(np.abs(x[0]).max())
        if away > NEAR and offset > away / 2.0:
            unit = self._units.get(device, TRANSLATING)("m")
            self._away.append(f"{device} {away:.3g} {unit} (its tool {offset:.3g} {unit} behind)")
            self.notices[Cause.BEGINNING] = (
                f"a device began away from 0, where the world expects it: {', '.join(self._away)}; it gets a part of "
                "the force until its tool has caught up. Take the zero of its driver at the start, or bring the "
                "device to 0 before the run"
            )

    def _late_ticks(self, telemetry: Telemetry) -> dict[str, list[int]]:
        """The ticks in which each coupling was late; a notice names those that nobody waits for since."""
        for name, lateness in lateness_by_coupling(telemetry.figures).items():
            often = lateness.ticks > max(ALLOWED * telemetry.tick, LEAST)
            if lateness.waived and often and name not in self.waited_for:
                self.waited_for.append(name)
        if self.waited_for:
            self.notices[Cause.WAITS] = (
                f"late too often: {', '.join(self.waited_for)}; nobody waits for them any more, and their tools rest "
                "in the ticks that they miss; the report has how often (late_couplings)"
            )
        late: dict[str, list[int]] = {}
        waited = telemetry.traces.get(names.WAITED_IN)
        for tick, place in () if waited is None or waited.shape[1] != 2 else waited.tolist():
            if 0 <= place < len(self._couplings) and 0 <= tick <= telemetry.tick:
                late.setdefault(self._couplings[int(place)], []).append(int(tick))
        return late


def _covered(prepared: Prepared, device: str) -> Covered:
    """What the certificate of a device covers; nothing is covered without one."""
    session, certificate = prepared.session, prepared.certificate_of(device)
    period, linked = session.period_of(device), any(device in session.devices_of(name) for name in session.wave_links)
    if certificate is None:
        return Covered(0.0, period, in_tick=not linked)
    return Covered(certificate.tau, period, certificate.period_tolerance, in_tick=not linked)


_NO_TAU: Final = np.empty((0, 1))


_NO_PERIODS: Final[Mapping[str, float]] = MappingProxyType({})
_NO_UNITS: Final[Mapping[str, Units]] = MappingProxyType({})

QUIET: Final = 10.0
"""Seconds between two incidents of the same party: a user that returns by a ramp may be beyond its limits again at
once."""


NEAR: Final = 1e-3
"""m; nearer to 0 a device may begin without a word: the reserve for lateness pays for that, or for most of it."""


STAYS: Final = 1.0
"""Seconds after which a frozen coupling is an incident. One that hurries back has its row among the promises alone."""


LIGHTEST: Final = 1e-6
"""kg, or kg m^2 of an axis that turns: no device is as light. So E at most moved one to a speed of sqrt(2 E / m)."""


class UserIncidents:
    """The incidents of one run's users: pure, telemetry goes in and sentences come out."""

    def __init__(
        self,
        graph: Topology,
        period: float,
        periods: Mapping[str, float] = _NO_PERIODS,
        units: Mapping[str, Units] = _NO_UNITS,
    ) -> None:
        """Begin without any telemetry.

        Args:
            graph: the nodes and links.
            period: T of the session, s.
            periods: T of the nodes that have one of their own, s.
            units: of each device's axes; those that are left out translate.
        """
        self._units = units
        self._rates = {node: period / own for node, own in periods.items()}
        devices = [name for name, role in graph.nodes.items() if role is Role.DEVICE]
        self._couplings = {device: graph.couplings_of(device) for device in devices}
        self._worlds = {name for name, role in graph.nodes.items() if role is Role.ENVIRONMENT}
        self._period, self._quiet = period, QUIET / period
        self._frozen: dict[str, int] = {}  # couplings, and the tick from which each is frozen while its nodes run
        self._reported: set[str] = set()  # frozen couplings with a sentence
        self._causes = Causes()
        self._told: dict[str, int] = {}  # by node, the tick of its latest telemetry
        self._counts: dict[str, float] = {}
        # devices that let go, and the ticks that the environment must have reported: the first and the last
        self._awaiting: dict[str, tuple[int, int]] = {}
        self._of_itself: dict[str, str] = {}  # devices that nobody can have moved so, and why
        self._speeds: dict[str, float] = {}  # of devices that let go, the greatest of about then, m/s
        self._later: dict[str, tuple[str, int]] = {}  # that devices let go, not said yet; its tick
        self._next: dict[str, float] = {}  # the first tick of a party's next sentence

    def forget(self, node: str) -> None:
        """``node`` has a new process, which counts from 0."""
        self._counts.pop(node, None)
        if node not in self._awaiting:  # what its last process did is still to be told
            self._of_itself.pop(node, None)
        if node in self._worlds:
            self._causes.forget()
            self._frozen, self._reported = {}, set()
            self._counts = {key: count for key, count in self._counts.items() if key in self._couplings}

    def receive(self, node: str, telemetry: Telemetry, running: Collection[str] = ()) -> list[str]:
        """The incidents that follow from a node's telemetry.

        Args:
            node: its name.
            telemetry: its telemetry.
            running: the nodes that run and should not be frozen for long; of others their loss is an incident already.
        """
        figures = telemetry.figures.finite()
        tick = session_tick(telemetry.tick, self._rates.get(node, 1.0))
        if node in self._worlds:
            self._causes.take(tick * self._period, figures)
            since, self._told[node] = min(tick, self._told.get(node, 0)), tick
            out = [*self._stays_frozen(tick, figures, running), *self._budgets(since, tick, figures)]
            for device in [device for device, (_, awaited) in self._awaiting.items() if awaited <= tick]:
                since, until = self._awaiting.pop(device)
                self._later[device] = self._let_go(device, since, until), until
            return [*out, *self._due(tick)]
        if node in self._couplings:
            since, self._told[node] = min(tick, self._told.get(node, 0)), tick
            before, self._counts[node] = self._counts.get(node, 0.0), figures.get(names.LET_GO, 0.0)
            if self._counts[node] > before:
                self._awaiting[node] = self._awaiting.get(node, (since, tick))[0], tick
                self._speeds[node] = figures.get(names.SPEED, 0.0)
                self._note_of_itself(node, figures)
        return []

    def _due(self, tick: int) -> Iterator[str]:
        """The sentences of devices that let go, once none was said of them lately: of several meanwhile the last."""
        for device in [device for device in self._later if tick >= self._next.get(device, 0.0)]:
            sentence, happened = self._later.pop(device)
            waited = happened < self._next.get(device, 0.0)
            self._next[device] = tick + self._quiet
            yield f"{sentence}; that was at {happened * self._period:.1f} s" if waited else sentence

    def _stays_frozen(self, tick: int, figures: Mapping[str, float], running: Collection[str]) -> Iterator[str]:
        for event in events_in(figures):
            if event.kind is Kind.FROZEN:
                self._frozen.setdefault(event.peer, event.tick)
            elif event.kind is Kind.RETURNED:
                self._frozen.pop(event.peer, None)
                self._reported.discard(event.peer)
        for coupling, since in self._frozen.items():
            if coupling not in running:
                self._frozen[coupling] = tick  # it was lost: its time counts from its return on
            elif coupling not in self._reported and (tick - since) * self._period > STAYS:
                self._reported.add(coupling)
                yield (
                    f"{self._who(coupling)} is frozen since {since * self._period:.1f} s: it takes no part, and the "
                    "others go on"
                )

    def _budgets(self, since: int, tick: int, figures: Figures) -> Iterator[str]:
        for party, stops in figures.table(names.STOPS).items():
            if not self._grown(party, stops, tick):
                continue
            mover = self._causes.mover((party,), since * self._period, tick * self._period)
            if mover is not None:
                yield (
                    f"{self._who(party)} was held until the energy that it passes on is within its budget; "
                    f"{self._who(mover.party)} had put {mover.energy:.3g} J into it"
                )
            else:
                given = figures.table(names.GIVEN).get(party, 0.0)
                yield (
                    f"{self._who(party)} was beyond its energy budget, and was stopped until it is within it "
                    f"again; it has put {given:.3g} J into the others so far"
                )

    def _let_go(self, device: str, since: int, until: int) -> str:
        text = f"{device} was beyond its limits of displacement or speed, and let go until it is within them again"
        if why := self._of_itself.pop(device, ""):
            return f"{text}; {why}"
        mover = self._causes.mover(self._couplings[device], since * self._period, until * self._period)
        if mover is None:
            return f"{text}; nobody else has moved it"
        speed, unit = self._speeds[device], self._units.get(device, TRANSLATING)("m/s")
        if mover.total < 0.5 * LIGHTEST * speed**2:
            return (
                f"{text}; it seemed to move at {speed:.3g} {unit}, for which the {mover.total:.3g} J that it had "
                "received from others are far too little: see its sensor, and the units of its driver"
            )
        return (
            f"{text}; another party moved it: it had received {mover.total:.3g} J from others, "
            f"{mover.energy:.3g} J of it from {self._who(mover.party)}"
        )

    def _note_of_itself(self, device: str, figures: Mapping[str, float]) -> None:
        """Note why no energy that a device received can have moved it beyond its limits, where that is so."""
        if figures.get(names.QUICKER, 0.0) > 0.0:
            self._of_itself[device] = (
                "it moved further in a tick than its stated mass and its hand's force allow: see its sensor, the units "
                "of its driver, and the mass that is stated"
            )
        elif any(event.kind is Kind.BEGAN and event.tick > 0 for event in events_in(figures)):  # forces rise by a ramp
            self._of_itself[device] = "it was there when its process began: see its sensor, and the units of its driver"

    def _who(self, coupling: str) -> str:
        devices = [device for device, couplings in self._couplings.items() if coupling in couplings]
        return f"{coupling} ({', '.join(devices)})" if devices else coupling

    def _grown(self, key: str, count: float, tick: int) -> bool:
        """Whether ``count`` has grown, and no sentence about it was given lately."""
        grown = count > self._counts.get(key, 0.0)
        self._counts[key] = count
        if not grown or tick < self._next.get(key, 0.0):
            return False
        self._next[key] = tick + self._quiet
        return True
