"""Invariants for the others in a session with a hostile guest, watched in each tick and judged at the end."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from typing import Any, Final

from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.topology import topology
from manyhands.nodes.environment.late_arrivals import BURST, SHARE
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.link import peer_link as peer_link_module
from manyhands.nodes.monitor.health import missed
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import from_seconds
from manyhands.protocol.gate import DRIFT, MOST_PERIODS, Bounds, Gate
from manyhands.protocol.messages import Role, SignalMessage, Telemetry

from .scheduler import Scheduler
from .world import SimulatedSession

TRANSIENT: Final = 2 * BURST
"""Late ticks of an honest device, at most, that each coupling of a guest may cause before it is frozen.

Its bucket, and as many in which it comes within the allowance (docs/decisions/0028-who-is-late.md).

Besides, :data:`SHARE` of all ticks for ever, and :data:`AGAIN` for each time that it is let in again.
"""

SLACK: Final = 1e-6
"""J, of rounding, in the comparison of two accounts of energy."""

AGAIN: Final = 6
"""The same for each time that the guest is frozen, or goes."""


TELEMETRY: Final = 100
"""Ticks after which the environment's telemetry has its actions."""


class Wrong(StrEnum):
    """Effects on the others that must not occur."""

    LATE = "late beyond what is covered"
    FROZEN = "frozen"
    SOFTENED = "softened"
    SCALED = "scaled"
    NAMED = "named"
    ENDED = "the session ended"
    STALLED = "the session stood still"
    PROMISE = "a ledger or a force limit broken"
    ENERGY = "more energy received than the budget"
    SPEED = "moved faster than the limit"
    UNNAMED = "the guest acted against and not named"


class Innocence:
    """The observations of one session; a :class:`~tests.deterministic.process.Witness`.

    Attributes:
        late: by honest device, ticks whose force acted later than the certificate covers.
        received: J that the others' ports have taken, net.
        most_received: the most that this ever was.
    """

    def __init__(self, prepared: Prepared, guest: str | None, rest: bool, tolerated: bool, told: bool) -> None:
        """Nothing is seen yet.

        Args:
            prepared: the session.
            guest: the hostile device; None where everybody is honest.
            rest: whether the honest hands rest: then all energy that others receive is the guest's.
            tolerated: whether the guest is late by what the ladder was made for: others may be softened for it, and
                what is covered is its last rung's delay.
            told: whether the others' measurements may be reported: the guest is within the allowance at times.
        """
        self._graph = topology(prepared.session)
        assert prepared.certificate is not None
        assert prepared.ladder is not None
        self._tolerated, self._told = tolerated, told
        self._tau = 1e6 * (prepared.ladder.taus[-1] if tolerated else prepared.certificate.tau)  # us
        self.guest = guest
        mine = {guest} | {link.binder for link in self._graph.links_of(guest)} if guest is not None else set()
        self.honest = [name for name in self._graph.nodes if name not in mine]
        self._devices = [name for name in self.honest if self._graph.nodes[name] is Role.DEVICE]
        ports = prepared.session.ports
        self._ports = [i for i, port in enumerate(ports) if guest is None or port.split(".")[0] != guest]
        self.late: Counter[str] = Counter()
        self.last_late = -1
        self._before: Sequence[float] | None = None
        self.received = self.most_received = 0.0
        self._rest = rest and guest is not None
        self._couplings = list(prepared.session.couplings)
        self._guests = [i for i, coupling in enumerate(self._couplings) if coupling not in self.honest]
        limits = None if guest is None else prepared.session.devices[guest].limits
        self._power, self._energy = (0.0, 0.0) if limits is None else (limits.power, limits.energy)
        if limits is not None:  # one late tick at the greatest force and speed may be worth more than half a bucket
            blocks = len(self._guests)
            tick = MOST_PERIODS * prepared.session.period * limits.force[0] * limits.speed[0]
            self._energy += blocks * max(0.0, tick - 0.5 * limits.energy / blocks)
        self._T, self._began = prepared.session.period, -1
        self._least = 0.0  # of what the guest has given less P t
        self._too_much = ""
        self._acted = -1  # the first tick with a frozen member

    def hear(self, sender: str, telemetry: Telemetry) -> None:
        """Count an honest device's late ticks."""
        if sender not in self._devices or names.TAU not in telemetry.traces:
            return
        taus = telemetry.traces[names.TAU][:, 0]
        for row, tau in enumerate(taus):
            if tau > self._tau:
                self.late[sender] += 1
                self.last_late = max(self.last_late, telemetry.tick - len(taus) + row)

    def settle(self, tick: int, f: Sequence[float], tools: Sequence[float], node: EnvironmentNode) -> None:
        """Add up the energy that the others' ports take."""
        before, self._before = self._before, list(tools)
        if before is not None:
            members = node.members
            if self._acted < 0 and members is not None and not members.all_active:
                self._acted = tick
            self.received += sum(f[i] * (tools[i] - before[i]) for i in self._ports)
            self.most_received = max(self.most_received, self.received)
        if self.guest is not None and not self._too_much:
            self._weigh(tick, node)

    def _weigh(self, tick: int, node: EnvironmentNode) -> None:
        """Hold what the others have received of the guest against its budget, over every stretch of ticks."""
        if self._began < 0:
            self._began = tick
        allowed = self._power * self._T * (tick + 1 - self._began)
        given = 0.0 if node.core is None else sum(node.core.energy.given[i] for i in self._guests)
        self._least = min(self._least, given - allowed)
        if given - allowed - self._least > self._energy + SLACK:
            self._too_much = (
                f"{given - allowed - self._least:.3g} J beyond {self._power:g} W by tick {tick}, its account says"
            )
        if self._rest and self.received - allowed > self._energy + SLACK:
            self._too_much = (
                f"{self.received - allowed:.3g} J beyond {self._power:g} W by tick {tick}, at the others' ports"
            )

    def verdict(self, world: SimulatedSession, returns: int) -> list[tuple[Wrong, str]]:
        """The violations, once the session is over; ``returns`` counts the guest's returns."""
        found: list[tuple[Wrong, str]] = []
        members = world.members
        acted = False
        absent = (
            sum(p.membership.absences for p in members.all if p.join.peer.name not in self.honest) if members else 0
        )
        allowed = len(self._guests) * (TRANSIENT + SHARE * world.tick) + AGAIN * max(absent, returns)
        for device, count in self.late.items():
            if count > allowed and self.guest is not None:  # honest ones may be late
                found.append(
                    (Wrong.LATE, f"{device} was late in {count} ticks of {allowed:.0f}, last in {self.last_late}")
                )
        for member in [] if members is None else members.all:
            name, absences = member.join.peer.name, member.membership.absences
            if name in self.honest and absences:
                found.append((Wrong.FROZEN, f"{name} was frozen {absences} times"))
            acted = acted or (name not in self.honest and absences > 0)
        core = None if world.environment is None else world.environment.core
        for i, coupling in enumerate(self._couplings) if core is not None else ():
            scaled = core.energy.scaled[i]
            if scaled and coupling in self.honest:
                found.append((Wrong.SCALED, f"{coupling} was scaled in {scaled} ticks"))
            acted = acted or (coupling not in self.honest and core.energy.stops[i] > 0)
        if self._too_much:
            found.append((Wrong.ENERGY, self._too_much))
        for coupling, rung in world.conductor.rungs.items():
            if rung and coupling in self.honest and not self._tolerated:
                found.append((Wrong.SOFTENED, f"{coupling} was softened to rung {rung}"))
        told = [
            *world.assumptions.notices.values(),
            *world.conductor.incidents.sentences,
            *world.conductor.faults,
        ]
        for sentence in told:
            if (
                self.guest is not None and not self._told and self._blames(sentence)
            ):  # otherwise the sentence may state the fact
                found.append((Wrong.NAMED, sentence))
        world.health.conclude()
        # the rows of health are where a report, the page and top name whom a promise that was not kept is about
        named = [*told, *(" ".join(row.who) for row in missed(world.health.rows()))]
        if (
            acted
            and self._told_by(world)
            and not any(self.guest is not None and self.guest in sentence for sentence in named)
        ):
            found.append((Wrong.UNNAMED, f"{self.guest} was frozen or stopped"))
        found += [(Wrong.ENDED, fault) for fault in world.conductor.faults]
        return found

    def _told_by(self, world: SimulatedSession) -> bool:
        """Whether it was so long ago that the environment has reported it."""
        return self._acted >= 0 and world.tick - self._acted > TELEMETRY

    def _blames(self, sentence: str) -> bool:
        """Whether a sentence has an honest party as its subject and does not mention the guest."""
        if self.guest is not None and self.guest in sentence:
            return False
        subject = re.match(r"(?:at [\d.-]+ s: )?(\w+)", sentence)
        return subject is not None and subject[1] in self.honest


@contextmanager
def watched_gates(scheduler: Scheduler, simulated: bool, wrong: list[tuple[Wrong, str]]) -> Iterator[None]:
    """A context in which every gate is checked against its peer's possible path in the time that truly passed."""

    class WatchedGate(Gate):
        """A gate, and what it should admit at most over any stretch of its signals."""

        __slots__ = ("_ahead", "_least", "_step_of", "_ticks", "_was")

        def __init__(self, kind: type[SignalMessage], width: int, bounds: Bounds | None = None, *more: Any) -> None:
            super().__init__(kind, width, bounds, *more)
            self._step_of = None if bounds is None else bounds.step
            self._was: tuple[float, ...] | None = None
            self._ahead = self._least = 0.0  # periods of steps admitted beyond those passed, and the least of it
            self._ticks = 0

        def forget(self) -> None:
            super().forget()
            self._was = None

        def admitted(self, frame: bytes, tick: int) -> tuple[float, ...] | None:
            values = super().admitted(frame, tick)
            if values is None or self._step_of is None:
                return values
            self._ticks += 1
            passed = float(self._ticks) if simulated else scheduler.now / period * (1.0 + DRIFT)
            was, self._was = self._was, values
            if was is None:
                self._ahead, self._least = 0.0, -passed
                return values
            self._ahead += max(abs(a - b) / step for a, b, step in zip(values, was, self._step_of, strict=True))
            ahead = self._ahead - passed
            self._least = min(self._least, ahead)
            if ahead - self._least > (1.0 if simulated else MOST_PERIODS) + 1e-3 and not told:
                told.append(True)
                wrong.append(
                    (Wrong.SPEED, f"{ahead - self._least:.1f} periods' steps ahead of the time at tick {tick}")
                )
            return values

    period = from_seconds(1e-3)
    told: list[bool] = []
    before, peer_link_module.Gate = peer_link_module.Gate, WatchedGate  # type: ignore[misc]
    try:
        yield
    finally:
        peer_link_module.Gate = before  # type: ignore[misc]
