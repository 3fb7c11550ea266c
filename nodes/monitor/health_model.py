"""Makes the rows of a session's health from the telemetry of its nodes: pure.

The supervisor keeps one :class:`HealthModel` from the first tick on; an audit keeps another, which it feeds with the
recorded telemetry. Times are the session's own: tick times T. Telemetry comes ten times a second, and a count in it
gives no tick. So what is only counted has begun up to a tenth of a second before its row says.

**Who is named.** A node counts its own cut forces and late ticks, and does not know their cause. Its count waits until
the environment has reported the same ticks (:mod:`manyhands.nodes.monitor.causes`). A force that was cut while another
party moved the node is not the node's: the row names the mover if the environment held that one to its energy budget,
and otherwise the session as a whole. Ticks in which a coupling made the others wait are that coupling's.

**The pace** is judged by what the nodes say of their own clocks, for the supervisor may be late itself: its telemetry
then comes late, and nobody's ticks are. Only where nothing comes at all does its clock count.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from manyhands.design.models.axis import TRANSLATING, Units
from manyhands.nodes.kernel.driver_statement import IMPOSED, DriverWord, outside
from manyhands.nodes.kernel.words import counted
from manyhands.nodes.monitor.causes import BEFORE, Causes
from manyhands.nodes.monitor.given import MEASURE, WINDOW, GivenForce
from manyhands.nodes.monitor.health import (
    FREE_STATE,
    GRAVITY,
    MOVED,
    PROMISES,
    SESSION,
    UNKNOWN_MOVER,
    PromiseState,
    most_grave,
)
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.figures import Figure
from manyhands.nodes.rows.lateness import lateness_by_coupling
from manyhands.nodes.rows.own_ticks import session_tick
from manyhands.nodes.rows.promises import Promise
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.protocol.messages import Figures, PromiseStatus, Role

LEDGER_ROUNDING: Final = 1e-9
"""The largest rounding error of a long session's sums, J, of ledgers and of interface accounts."""

HOLD: Final = 2.0
"""For how long nothing must be added to a cost before a state counts as over, s of the session's time."""

PACE_WINDOW: Final = 5.0
"""The time that the pace is measured over, s: telemetry comes in batches of a tenth of a second."""

PACE_SHARE: Final = 0.05
"""The part of :data:`PACE_WINDOW` by which a session may fall behind the clock without a word."""

PACE_LEAST: Final = 0.25
"""The time in s that it must fall behind by at least, which is more than two batches of telemetry."""

PACE_SILENCE: Final = 1.0
"""The time in s, ten batches of telemetry, in which nothing must come before the silence counts as standing still."""


@dataclass(frozen=True)
class Terms:
    """What a session has promised, as far as its health depends on it.

    Attributes:
        period: T, s.
        roles: of every node.
        rates: ticks of a node in one of the session's, for nodes with a period of their own.
        realtime: whether the session keeps up with a clock.
        wall: the devices in wall time, whose interface can bound what lateness puts in.
        certified: whether it has a certificate.
        tank: E_0, J.
        bounded: whether devices keep to that bound, so that lateness is enforced and breaks nothing.
        enforced: parties whose level is enforced instead of proved.
        linked: the couplings with a wave link.
        seats: the device of each seat, by its coupling.
        drivers: the devices that drivers of other packages move, with what rests on their word.
        couplings: of each device.
        units: of each node's ports; those that are left out translate.
        turned: the devices whose hands feel a torque of their orientation, and so have an account of it.
    """

    period: float
    roles: Mapping[str, Role]
    rates: Mapping[str, float] = field(default_factory=dict)
    realtime: bool = False
    wall: tuple[str, ...] = ()
    certified: bool = False
    tank: float = 0.0
    bounded: bool = False
    enforced: tuple[str, ...] = ()
    linked: tuple[str, ...] = ()
    seats: Mapping[str, str] = field(default_factory=dict)
    drivers: Mapping[str, DriverWord] = field(default_factory=dict)
    couplings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    units: Mapping[str, Units] = field(default_factory=dict)
    turned: tuple[str, ...] = ()

    @property
    def promises(self) -> Iterator[Promise]:
        """The promises that this session makes, the gravest first."""
        late = self.certified and self.realtime
        made = {
            Promise.PASSIVITY: self.certified,
            Promise.DRIVER: bool(self.drivers),
            Promise.ORIENTATION: self.certified and bool(self.turned),
            Promise.DELAY: late,
            Promise.PERIOD: late,
            Promise.LATENESS: late and bool(self.wall),
            Promise.INERTIA: late and bool(self.wall),
            Promise.FORCE: True,
            Promise.GIVEN: self.realtime and bool(self.wall),
            Promise.LEVEL: bool(self.enforced),
            Promise.LINK: bool(self.linked),
            Promise.MOTION: True,
            Promise.PRESENCE: True,
            Promise.PUNCTUALITY: self.realtime,
            Promise.PACE: self.realtime,
        }
        return (promise for promise, given in made.items() if given)


@dataclass(frozen=True)
class _Counter:
    """A promise of a node that figures of its telemetry count.

    Attributes:
        promise: the promise.
        grows: the figure that grows whenever the promise is not kept by itself.
        cost: by unit, the figure with the cost.
    """

    promise: Promise
    grows: str
    cost: Mapping[str, str]


def _counters(promise_of: Callable[[Figure], Promise | None]) -> tuple[_Counter, ...]:
    """A counter for each figure that counts what is not kept of a promise; figures in J are what that costs."""
    declared = [(figure, promise) for figure in names.FIGURES.values() if (promise := promise_of(figure)) is not None]
    return tuple(
        _Counter(
            promise,
            figure.name,
            {figure.unit.value: figure.name}
            | {other.unit.value: other.name for other, its in declared if its is promise and not other.unit.whole},
        )
        for figure, promise in declared
        if figure.unit.whole
    )


_COUNTERS: Final = _counters(lambda figure: figure.promise)
"""Counters of a node about itself."""

_OF_COUPLINGS: Final = _counters(lambda figure: figure.promise_of)
"""Counters of the environment about its couplings, in tables."""

_MOST: Final = 1e300
"""No cost is greater: sums of what nodes say stay finite."""

_CAUSED: Final = (Promise.DELAY, Promise.PERIOD, Promise.FORCE)
"""Promises of which a node only counts that they were not kept; another party may be the cause."""

_UNSURE: Final = 1 / 3
"""The part of the ticks in which a coupling made the others wait that is its own besides: the environment cannot decide
it in all of them (CROSSING in nodes/environment/late_arrivals.py)."""

_THERE: Final = ("", "running", "done", "ended", FREE_STATE)
"""The states of a running session's node that is there, or has done its part; empty where none is known yet."""


@dataclass
class _Entry:
    """One promise of one party that is not, or was not, kept by itself."""

    state: PromiseState
    since: float
    last: float
    until: float | None = None  # when it was ended
    lasts: bool = False  # until it is ended, however long its cost stays the same
    cost: dict[tuple[str, str], float] = field(default_factory=dict)  # by the figure that counts it, and by unit
    remark: str = ""

    def price(self, unit: str) -> float:
        """The cost in a unit, over all figures that count it."""
        return min(sum(value for (_, of), value in self.cost.items() if of == unit), _MOST)


@dataclass(frozen=True)
class _Unexplained:
    """What a node has counted between two of its messages, and the environment has not reported on yet.

    Attributes:
        counter: what counts it.
        node: the node.
        since: the time of its message before, s.
        until: the time of the message that shows it, s.
        ticks: how many were counted.
    """

    counter: _Counter
    node: str
    since: float
    until: float
    ticks: float


class HealthModel:
    """How the promises of one session stand.

    Attributes:
        now: the session's time, s: that of the latest tick that any node has reported.
        by_itself: by device, what it does by itself, as its session and its driver state.
    """

    def __init__(self, terms: Terms) -> None:
        """All promises are kept; ``terms`` states which there are."""
        self._terms, self.now = terms, 0.0
        self._entries: dict[tuple[Promise, str], _Entry] = {}
        # by node, figure and key of its table: of former processes, latest
        self._counts: dict[tuple[str, str, str], tuple[float, float]] = {}
        self._seen: dict[tuple[str, str, str], float] = {}
        self._worst: dict[tuple[str, str], float] = {}  # by node and figure, over all processes
        self._paces: dict[str, _Pace] = {}  # by node, of its present process
        self._unbegun = _Pace(terms.period)  # while nobody has told of a tick
        self._free: frozenset[str] = frozenset()
        self._made = {*terms.promises, Promise.BUDGET}
        self._stated: set[Promise] = set()  # of which only a device's telemetry says that they are made
        self._given = {name: _Given() for name in terms.wall}
        self._put_in = dict.fromkeys(terms.drivers, 0.0)  # by the users of these devices at least, J
        self.by_itself = {name: word.by_itself for name, word in terms.drivers.items() if word.by_itself}
        self._measure: set[str] = set()  # devices whose driver measures the force that they exert
        self._causes = Causes()
        self._told: dict[str, float] = {}  # by node, the time of its latest message, s
        self._unexplained: deque[_Unexplained] = deque()

    def forget(self, node: str) -> None:
        """``node`` has a new process, which counts from 0."""
        for key, (before, latest) in self._counts.items():
            if key[0] == node:
                self._counts[key] = before + latest, 0.0
        if node in self._given:
            self._given[node] = _Given()
        self._paces.pop(node, None)
        if self._terms.roles.get(node) is Role.ENVIRONMENT:
            self._causes.forget()

    def hear(self, node: str, by_itself: tuple[str, ...]) -> None:
        """``node`` is a device whose driver has stated what it does by itself; of other nodes nothing changes."""
        if node in self._terms.drivers:
            found = tuple(dict.fromkeys((*self._terms.drivers[node].by_itself, *by_itself)))
            self.by_itself.pop(node, None)  # another process of a device may state less
            self.by_itself |= {node: found} if found else {}

    def take(self, node: str, tick: int, figures: Figures) -> None:
        """Take in the figures of a node's telemetry; unknown nodes and figures that make no sense change nothing.

        Args:
            node: its name.
            tick: the tick after its last.
            figures: its figures.
        """
        role = self._terms.roles.get(node)
        if role is None:
            return
        events = list(events_in({name: value for name, value in figures.items() if "@" in name}))
        if any(event.kind is Kind.BEGAN and event.tick > 0 for event in events):
            self.forget(node)
        at = self._time(node, tick)
        self.now = max(self.now, at)
        if 0.0 <= (elapsed := figures.get(names.ELAPSED, math.nan)) <= _MOST:
            self._paces.setdefault(node, _Pace(self._terms.period, elapsed / 1e6, at)).take(elapsed / 1e6, at)
        since = min(at, self._told.get(node, 0.0))
        self._told[node] = at
        if names.BEYOND in figures and Promise.SPEED not in self._stated:
            self._stated.add(Promise.SPEED)
            self._made.add(Promise.SPEED)
        for counter in _COUNTERS:
            if counter.grows not in figures:
                continue
            if counter.promise in _CAUSED:
                before, total = self._grow(node, counter.grows, figures)
                if total > before and counter.promise in self._made:
                    self._unexplained.append(_Unexplained(counter, node, since, at, total - before))
                continue
            cost = {unit: self._total(node, figure, figures) for unit, figure in counter.cost.items()}
            self._count(counter.promise, node, counter.grows, self._grown(node, counter.grows, figures), at, cost)
        if (entry := self._entries.get((Promise.SPEED, node))) is not None:
            fastest = self._most(node, names.FASTEST, figures.get(names.FASTEST, math.nan))
            moved = "may have moved" if node in self._terms.drivers else "moved"  # measured, to a step
            unit = self._terms.units.get(node, TRANSLATING)("m/s")
            entry.remark = f"{node} {moved} at up to {fastest:.3g} {unit} on an axis" if fastest else ""
        if figures.get(names.WAVE_HOLDING, 0.0) > 0.0:
            self._go_on(Promise.LINK, node, at)
        self._energy(node, at, figures)
        if node in self._given and Promise.GIVEN in self._made:
            self._judge_given(node, at, figures)
        if node in self._terms.drivers:
            self._driver(node, at, figures)
        if role is Role.ENVIRONMENT:
            self._causes.take(at, figures)
            self._couplings(node, since, at, figures)
            for event in events:
                if event.kind is Kind.FROZEN and event.peer in self._terms.roles:
                    self._freeze(event.peer, self._time(node, event.tick))
                elif event.kind is Kind.RETURNED:
                    self._end(Promise.PRESENCE, event.peer, self._time(node, event.tick))
        self._explain(lambda one: one.until <= self._causes.until or self.now - one.until > HOLD)

    def conclude(self) -> None:
        """No more telemetry comes: what the environment has not reported on has no cause that is known."""
        self._explain(lambda _: True)

    def look(self, states: Mapping[str, str], silent: Collection[str], unheard: float = 0.0) -> None:
        """Take in what the supervisor knows while the session runs.

        Args:
            states: of each node, as the supervisor names them.
            silent: the nodes that run, and have sent no telemetry for a while, in which the others went on.
            unheard: for how long the supervisor has listened without a word of any node, s.
        """
        self._free = frozenset(name for name, state in states.items() if state == FREE_STATE)
        for name in self._free:
            for promise in Promise:
                self._end(promise, name, self.now)
        seats = {*self._terms.seats, *self._terms.seats.values()}  # their users come when they like
        for name, state in states.items():
            away = name in silent or (state not in _THERE and name not in seats)
            entry = self._entries.get((Promise.PRESENCE, name))
            if away and (entry is None or entry.state is not PromiseState.BROKEN or not entry.lasts):
                self._begin(Promise.PRESENCE, name, PromiseState.BROKEN, self.now)
            elif not away and state == "running" and entry is not None and entry.state is PromiseState.BROKEN:
                self._end(Promise.PRESENCE, name, self.now)
            if away:
                word = "no telemetry has come from it for a while" if name in silent else state
                self._entries[Promise.PRESENCE, name].remark = f"{name}: {word}"
        if self._terms.realtime:
            self._keep_pace(unheard)

    def rows(self, remarks: Mapping[Promise, str] = MappingProxyType({})) -> tuple[PromiseStatus, ...]:
        """How each promise stands: a row for each party that does not keep it by itself, and one for all others.

        Args:
            remarks: what has happened to a promise and what to do, where the session has a sentence about that.
        """
        out: list[PromiseStatus] = []
        made = {*self._terms.promises, *self._stated, *(promise for promise, _ in self._entries)}
        for promise in (promise for promise in PROMISES if promise in made):
            if promise is not Promise.DRIVER:  # nobody knows that it is kept
                out.append(PromiseStatus(promise.value, PromiseState.KEPT.value, since=0.0))
            for party in (*self._terms.roles, SESSION):
                entry = self._entries.get((promise, party))
                if entry is not None:
                    out.append(self._row(promise, party, entry, remarks.get(promise, "")))
                elif party in self._terms.drivers and party not in self._free:
                    out += self._unjudged(promise, party)
        return most_grave(out)

    def _unjudged(self, promise: Promise, device: str) -> Iterator[PromiseStatus]:
        """The row of what cannot be judged of a device with a driver of another package."""
        cost: dict[str, float] = {}
        if promise is Promise.DRIVER:
            remark = self._beside(self._terms.drivers[device].sentence(device, device in self._measure), device)
        elif promise is Promise.PASSIVITY:
            put_in = self._put_in[device]
            cost = {"J": put_in} if put_in > 0.0 else {}
            so_far = f"it has put in at least {put_in:.3g} J so far"
            if IMPOSED in self.by_itself.get(device, ()):
                remark = f"no force moves {device}, so this run shows nothing about stability with a hand; {so_far}"
            else:
                remark = (
                    f"a person's hand holds {device}, and its work is its own; {so_far}. Account, limits and budgets "
                    "judge the device"
                )
        else:
            return
        yield PromiseStatus(promise.value, PromiseState.UNJUDGED.value, (device,), 0.0, None, cost, remark)

    def _judge_orientation(self, node: str, at: float, margin: float) -> None:
        """Judge the account of an orientation by its least distance from its bound, J."""
        if not math.isfinite(margin):
            self._senseless(Promise.ORIENTATION, node, at, "the account of its orientation")
        elif margin < -LEDGER_ROUNDING:
            entry = self._entries.get((Promise.ORIENTATION, node))
            entry = entry or self._begin(Promise.ORIENTATION, node, PromiseState.BROKEN, at)
            entry.cost[node, "J"] = max(entry.cost.get((node, "J"), 0.0), -margin)
            entry.remark = f"{node}: the account of its orientation fell {entry.price('J'):.3g} J below its bound"

    def _row(self, promise: Promise, party: str, entry: _Entry, remark: str) -> PromiseStatus:
        quiet = not entry.lasts and self.now - entry.last > HOLD
        cost = {unit: entry.price(unit) for unit in dict.fromkeys(unit for _, unit in entry.cost)}
        if promise is Promise.PRESENCE and entry.lasts:
            cost["s"] = cost.get("s", 0.0) + self.now - entry.since
        cost = {unit: value for unit, value in cost.items() if value > 0.0}
        until = entry.last if entry.until is None and quiet else entry.until
        remark = self._beside(remark or entry.remark, party) if promise is Promise.DRIVER else remark or entry.remark
        return PromiseStatus(promise.value, entry.state.value, (party,), entry.since, until, cost, remark)

    def _beside(self, remark: str, device: str) -> str:
        """A remark about a driver, with what its device does by itself."""
        return "; ".join(text for text in (remark, outside(device, self.by_itself.get(device, ()))) if text)

    def _time(self, node: str, tick: int) -> float:
        return session_tick(tick, self._terms.rates.get(node, 1.0)) * self._terms.period

    def _total(self, node: str, figure: str, figures: Figures, key: str = "") -> float:
        """A figure that only grows, over all processes of the node; ``key`` is that of a number in a table."""
        before, latest = self._counts.get((node, figure, key), (0.0, 0.0))
        value = (figures.table(figure) if key else figures).get(key or figure, latest)
        if not 0.0 <= value <= _MOST:
            value = latest
        if value < latest:  # a new process, of which no event came
            before += latest
        self._counts[node, figure, key] = before, value
        return before + value

    def _most(self, node: str, figure: str, value: float) -> float:
        """The greatest finite value from 0 on, over all processes of the node."""
        if math.isfinite(value):
            self._worst[node, figure] = max(self._worst.get((node, figure), 0.0), value)
        return self._worst.get((node, figure), 0.0)

    def _grown(self, node: str, figure: str, figures: Figures, key: str = "") -> bool:
        """Whether a figure has grown since this was last asked."""
        before, total = self._grow(node, figure, figures, key)
        return total > before

    def _grow(self, node: str, figure: str, figures: Figures, key: str = "") -> tuple[float, float]:
        """The sum of a figure when this was last asked, and now."""
        before, total = self._seen.get((node, figure, key), 0.0), self._total(node, figure, figures, key)
        self._seen[node, figure, key] = total
        return before, total

    def _explain(self, ready: Callable[[_Unexplained], bool]) -> None:
        """Book what is ``ready`` on the party that is the cause."""
        while self._unexplained and ready(self._unexplained[0]):
            one = self._unexplained.popleft()
            if one.counter.promise is Promise.FORCE:
                self._explain_cut(one)
            else:
                self._explain_late(one)

    def _explain_cut(self, one: _Unexplained) -> None:
        """Book ticks whose force was cut: on who moved the node, or on the node itself."""
        if -math.inf < self._causes.until < one.since - BEFORE:
            self._book(one, SESSION, one.ticks, f"{UNKNOWN_MOVER} {one.node}, whose force was cut to its limit")
            return
        mover = self._causes.mover(self._own_couplings(one.node), one.since, one.until)
        if mover is None:
            self._book(one, one.node, one.ticks)
            return
        party = mover.party if mover.beyond else SESSION
        energy = f"{mover.energy:.3g} J" if mover.energy >= 1.0 else f"{1e3 * mover.energy:.3g} mJ"
        self._book(one, party, one.ticks, f"{MOVED}: {mover.party} put {energy} into {one.node}, whose force was cut")

    def _explain_late(self, one: _Unexplained) -> None:
        """Book late ticks: on the couplings that made the others wait in them, and the rest on the node itself."""
        own, left = self._own_couplings(one.node), one.ticks
        for party, ticks in sorted(self._causes.waited_for(own, one.since, one.until).items(), key=lambda by: -by[1]):
            share = min(left, ticks * (1.0 + _UNSURE))
            if share > 0.0 and party in self._terms.roles and one.node not in self._terms.linked:
                left -= share
                self._book(one, party, share, f"the others waited for {party}")
        if left > 0.0:
            self._book(one, one.node, left)

    def _own_couplings(self, node: str) -> tuple[str, ...]:
        return self._terms.couplings.get(node, (node,))

    def _book(self, one: _Unexplained, party: str, ticks: float, remark: str = "") -> None:
        promise, key = one.counter.promise, (one.counter.grows, "ticks")
        state = self._state(promise, one.node)
        entry = self._entries.get((promise, party))
        if entry is None or GRAVITY[state] > GRAVITY[entry.state]:
            entry = self._begin(promise, party, state, one.until, lasts=False)
        entry.last, entry.until = max(entry.last, one.until), None
        entry.cost[key] = entry.cost.get(key, 0.0) + ticks
        entry.remark = remark or entry.remark

    def _count(
        self, promise: Promise, party: str, figure: str, grown: bool, at: float, cost: Mapping[str, float]
    ) -> None:
        """Count what a figure reports of a promise of ``party``, whose cost may have grown."""
        entry = self._entries.get((promise, party))
        if grown and promise in self._made:
            entry = entry or self._begin(promise, party, self._state(promise, party), at, lasts=False)
            entry.last, entry.until = at, None
        if entry is not None:
            entry.cost |= {(figure, unit): value for unit, value in cost.items()}

    def _go_on(self, promise: Promise, party: str, at: float) -> None:
        """A state that was counted goes on, though nothing is added to its cost."""
        entry = self._entries.get((promise, party))
        if entry is not None and party not in self._free:
            entry.last, entry.until = at, None

    def _state(self, promise: Promise, party: str) -> PromiseState:
        """The state of a promise that is not kept by itself."""
        terms = self._terms
        if promise in (Promise.DELAY, Promise.PERIOD, Promise.SPEED):
            return PromiseState.ENFORCED if terms.bounded and party in terms.wall else PromiseState.BROKEN
        if promise is Promise.FORCE:  # the limit itself holds; without a certificate nothing else was promised
            return PromiseState.BROKEN if terms.certified else PromiseState.ENFORCED
        return PromiseState.ENFORCED

    def _energy(self, node: str, at: float, figures: Figures) -> None:
        """The ledger of a party, and the interface account of a device."""
        if not self._terms.certified:
            return
        margin = figures.get(names.LEDGER_MARGIN, 0.0)
        if not math.isfinite(margin):
            self._senseless(Promise.PASSIVITY, node, at, "its ledger")
        elif node not in self._terms.drivers and margin < -LEDGER_ROUNDING:
            entry = self._entries.get((Promise.PASSIVITY, node))
            entry = entry or self._begin(Promise.PASSIVITY, node, PromiseState.BROKEN, at)
            entry.cost[node, "J"] = max(entry.cost.get((node, "J"), 0.0), -margin)
            entry.remark = f"{node}: its ledger fell {entry.price('J'):.3g} J below its bound"
        if Promise.ORIENTATION in self._made:
            self._judge_orientation(node, at, figures.get(names.ORIENTATION_MARGIN, 0.0))
        least = figures.get(names.INTERFACE_LEAST, 0.0)
        if not math.isfinite(least) and Promise.LATENESS in self._made:
            self._senseless(Promise.LATENESS, node, at, "its interface account")
        put_in = self._most(node, names.INTERFACE_LEAST, -least)
        cost = {"ticks": self._total(node, names.INTERFACE_TICKS, figures), "J": put_in}
        if self._terms.bounded:
            self._count(Promise.LATENESS, node, node, self._grown(node, names.INTERFACE_TICKS, figures), at, cost)
        if Promise.INERTIA in self._made and figures.get(names.QUICKER, 0.0) > 0.0:
            entry = self._entries.get((Promise.INERTIA, node)) or self._begin(
                Promise.INERTIA, node, PromiseState.BROKEN, at
            )
            entry.remark = f"{node} moved further in a tick than its stated mass and its hand's force allow"
        margin = figures.get(names.INTERFACE_MARGIN, self._terms.tank - put_in)
        if Promise.LATENESS in self._made and margin < -LEDGER_ROUNDING:
            entry = self._entries.get((Promise.LATENESS, node))
            if entry is None or entry.state is not PromiseState.BROKEN:
                entry = self._begin(Promise.LATENESS, node, PromiseState.BROKEN, at)
            entry.cost |= {(node, unit): value for unit, value in cost.items()}
            kept_to = (
                "that its interface has to keep to"
                if self._terms.bounded
                else "of faults.tank; it is counted and not bounded"
            )
            bound = f"{self._terms.tank:.3g} J {kept_to}"
            entry.remark = f"{node}: lateness has put {put_in:.3g} J into the loop, more than the {bound}"

    def _judge_given(self, node: str, at: float, figures: Figures) -> None:
        """How much of the force that was asked for a device was given lately."""
        now = GivenForce.of(figures)
        if now is None:
            return
        since, lately = self._given[node].take(at, now)
        if lately.enough:
            self._end(Promise.GIVEN, node, at)
            return
        entry = self._entries.get((Promise.GIVEN, node))
        if entry is None or not entry.lasts:
            entry = self._begin(Promise.GIVEN, node, PromiseState.BROKEN, at)
        own = self._own_couplings(node)
        entry.cost["", "s"] = entry.cost.get(("", "s"), 0.0) + self._given[node].lacked
        entry.remark = lately.sentence(node, self._causes.frozen(own, since, at))

    def _driver(self, node: str, at: float, figures: Figures) -> None:
        """What a device's ledger shows of its user's work, and what its driver has measured of its force."""
        # what neither the device's promise nor lateness explains came from the hand; each process counts from 0
        late = min(0.0, figures.get(names.INTERFACE_LEAST, 0.0))
        lacks = late - figures.get(names.LEDGER_MIN, 0.0)
        if 0.0 < lacks < math.inf:
            self._put_in[node] = max(self._put_in[node], lacks)
        if figures.get(names.MEASURED, 0.0) > 0.0:
            self._measure.add(node)
        if node not in self._terms.drivers:
            return
        if (untrue := self._total(node, names.UNTRUE, figures)) > 0.0:
            driver = self._terms.drivers[node].factory
            measured = f"by its own measurement the driver {driver} exerted forces that it had not been given"
            self._other_force(node, at, PromiseState.BROKEN, measured, untrue, figures.get(names.UNTRUE_MOST, 0.0))
        elif (ticks := self._total(node, names.LIMP, figures)) > 0.0:
            measured = "its device exerted no force, as its driver measured, though it was given some"
            self._other_force(node, at, PromiseState.ENFORCED, measured, ticks, figures.get(names.LIMP_MOST, 0.0))

    def _other_force(self, node: str, at: float, state: PromiseState, what: str, ticks: float, most: float) -> None:
        """A driver has measured other forces than it was given."""
        entry = self._entries.get((Promise.DRIVER, node))
        if entry is None or entry.state is not state:
            entry = self._begin(Promise.DRIVER, node, state, at)
            entry.cost.clear()
        unit = self._terms.units.get(node, TRANSLATING)("N")
        most = max(entry.cost.get((node, unit), 0.0), most)
        entry.cost |= {(node, "ticks"): ticks, (node, unit): most if math.isfinite(most) else 0.0}
        entry.remark = f"{node}: {what}, in {counted(ticks, 'tick')} and by up to {most:.3g} {unit}"

    def _senseless(self, promise: Promise, node: str, at: float, what: str) -> None:
        """An account that is no finite number shows nothing, so nobody may say that its promise is kept."""
        entry = self._entries.get((promise, node))
        if entry is None or entry.state is not PromiseState.BROKEN:
            entry = self._begin(promise, node, PromiseState.BROKEN, at)
        entry.remark = entry.remark or f"{node}: {what} is no finite number"

    def _couplings(self, node: str, since: float, at: float, figures: Figures) -> None:
        """What the environment reports of its couplings."""
        for counter in _OF_COUPLINGS:
            for party in figures.table(counter.grows):
                if party not in self._terms.roles or party in self._free:
                    continue
                cost = {unit: self._total(node, of, figures, party) for unit, of in counter.cost.items()}
                grown = self._grown(node, counter.grows, figures, party)
                self._count(counter.promise, party, f"{node} {counter.grows}", grown, at, cost)
                if grown and counter.promise is Promise.BUDGET:
                    mover = self._causes.mover((party,), since, at)
                    remark = "" if mover is None else f"{party} passed on energy that {mover.party} had put into it"
                    self._entries[Promise.BUDGET, party].remark = remark
        for party in self._terms.linked:
            if figures.table(names.of(names.WAVE_HOLDING)).get(party, 0.0) > 0.0:
                self._go_on(Promise.LINK, party, at)
        for party, late in lateness_by_coupling(figures).items():
            if (late.frozen or late.waived) and party in self._terms.roles:
                grown = self._grown(node, names.WAITED_TICKS, figures, party)
                cost = {"ticks": float(late.ticks), "s": late.time / 1e6, "times": float(late.frozen)}
                self._count(Promise.PUNCTUALITY, party, node, grown, at, cost)
                if (entry := self._entries.get((Promise.PUNCTUALITY, party))) is not None:
                    entry.remark = late.sentence(party)

    def _freeze(self, coupling: str, at: float) -> None:
        entry = self._entries.get((Promise.PRESENCE, coupling))
        if coupling not in self._free and (entry is None or not entry.lasts):
            entry = self._begin(Promise.PRESENCE, coupling, PromiseState.ENFORCED, at)
            entry.cost["", "times"] = entry.cost.get(("", "times"), 0.0) + 1.0
            entry.remark = f"{coupling} is frozen: it takes no part, and the others go on"

    def _begin(self, promise: Promise, party: str, state: PromiseState, at: float, *, lasts: bool = True) -> _Entry:
        """Begin a state; what it has cost before is kept."""
        before = self._entries.get((promise, party))
        cost = {} if before is None else dict(before.cost)
        if before is not None and before.lasts:  # what it was until now, and is now in a graver way
            at = before.since
        entry = self._entries[promise, party] = _Entry(state, at, at, lasts=lasts, cost=cost)
        return entry

    def _end(self, promise: Promise, party: str, at: float) -> None:
        entry = self._entries.get((promise, party))
        if (
            entry is None
            or entry.until is not None
            or (entry.state is PromiseState.BROKEN and PROMISES[promise].needed)
        ):
            return  # what the certificate needs and was broken stays broken
        if promise is Promise.PRESENCE:
            entry.cost["", "s"] = entry.cost.get(("", "s"), 0.0) + max(at, entry.since) - entry.since
        entry.lasts, entry.until = False, max(at, entry.since)

    def _keep_pace(self, unheard: float) -> None:
        """Judge the session by the node that is furthest: one that is held up alone is judged by its presence."""
        key = (Promise.PACE, SESSION)
        pace = max(self._paces.values(), key=lambda pace: pace.now, default=self._unbegun)
        found = pace.look(unheard if unheard > PACE_SILENCE else 0.0)
        if found is None:
            self._end(*key, self.now)
            return
        if key not in self._entries or not self._entries[key].lasts:
            before = self._entries.get(key)
            entry = self._begin(*key, PromiseState.BROKEN, self.now)
            entry.remark = pace.sentence() if before is None else before.remark  # it is reported once
        self._entries[key].cost = {("", "x"): found, ("", "s"): pace.behind}


_NOTHING_GIVEN: Final = GivenForce(0.0, 0.0, 0.0)


class _Given:
    """The force that one process of a device was asked for and gave, over the last :data:`WINDOW` of its time.

    Attributes:
        lacked: the time between the last two messages in which not all was given, s.
    """

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._seen = deque([(0.0, _NOTHING_GIVEN)])
        self.lacked = 0.0

    def take(self, at: float, now: GivenForce) -> tuple[float, GivenForce]:
        """Take in the sums up to ``at``, s; returns since when the window is, s, and what was given in it."""
        if now.time < self._seen[-1][1].time:  # another process, of which no event came
            self._seen = deque([(at, _NOTHING_GIVEN)])
        seen = self._seen
        self.lacked = max(0.0, now.lacking - seen[-1][1].lacking)
        seen.append((at, now))
        while len(seen) > 2 and now.time - seen[1][1].time >= WINDOW:
            seen.popleft()
        return seen[0][0], now.since(seen[0][1])


class _Pace:
    """How fast one process goes, by the clock of its own machine.

    Attributes:
        now: the session's time up to which it has told its ticks, s.
        behind: by how much it has fallen behind since its first telemetry, s.
    """

    def __init__(self, period: float, elapsed: float = 0.0, now: float = 0.0) -> None:
        """Its first telemetry tells its ticks up to the session's time ``now``, at ``elapsed`` of its own, s."""
        self._period = period
        self._first = elapsed, now
        self._seen = deque([self._first])
        self.now, self.behind = now, 0.0
        self._ratio = 1.0

    def take(self, elapsed: float, now: float) -> None:
        """Take in that it has done its ticks up to the session's time ``now`` when its own was ``elapsed``, s."""
        if elapsed <= self._seen[-1][0] or now < self.now:
            return
        self._seen.append((elapsed, now))
        self.now = now
        while len(self._seen) > 2 and elapsed - self._seen[1][0] >= PACE_WINDOW:
            self._seen.popleft()

    def look(self, silence: float) -> float | None:
        """The part of its own speed at which it went lately; None while that is enough.

        Args:
            silence: the time since its last telemetry in which it has stood still, s.
        """
        (then, began), elapsed = self._seen[0], self._seen[-1][0] + silence
        over, done = elapsed - then, self.now - began
        first, start = self._first
        self.behind = max(0.0, elapsed - first - (self.now - start))
        slow = over - done > max(PACE_SHARE * over, PACE_LEAST)
        self._ratio = done / over if slow else 1.0
        return self._ratio if slow else None

    def sentence(self) -> str:
        """The pace, and what tells what helps, as a sentence."""
        rate = 1.0 / self._period
        return (
            f"the session runs slower than its period: {self._ratio:.2f} of real time, {self._ratio * rate:.4g} of "
            f"{rate:.4g} ticks a second; delay and period say what is still certified. {MEASURE}"
        )
