"""The membership of each coupling in the session: active, held, frozen, rejoining or gone, and what changes it.

The environment waits in every tick for the couplings that are active. A coupling that does not come in time is *held*:
its tool rests for as long, and the others go on. When its signal comes it is answered at once, with the force of its
spring from a tool at rest, and with the tick that it goes on after (:mod:`manyhands.nodes.environment.clutch`). A
coupling that is late again and again is not waited for any more, and is held whenever it is late
(:mod:`manyhands.nodes.environment.late_arrivals`).

A coupling that stays silent for :data:`~manyhands.nodes.kernel.timeouts.PATIENCE_TICKS` ticks is frozen: its user feels
no force (docs/decisions/0015-the-clutch.md).

A frozen coupling that sends a signal is rejoining: the environment waits for it once more. With its signal of the
present tick it is active, and its clutch raises its force by a ramp. A coupling that sends a signal and then stays
silent, or is late again, costs the others some waiting each time. So it may rejoin only after a pause, which doubles
with each time, and its signals in the pause change nothing.

:class:`MembershipRecord` is the state machine of one coupling, by the table :data:`TRANSITIONS`. A :class:`Member`
holds a coupling's link, its membership and its block in the core's clutches. :class:`Members` are all of them: frames
and the supervisor's messages change memberships, and memberships move the clutches and permit changes of rung.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from typing import Final

import numpy as np

from manyhands.nodes.environment.core import Core
from manyhands.nodes.kernel.arithmetic import Floats, feedthrough_digest
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.kernel.log import Log, LogEvent
from manyhands.nodes.kernel.timeouts import PATIENCE_TICKS
from manyhands.nodes.link.join import Join, Received
from manyhands.nodes.link.relink import follow
from manyhands.nodes.link.supervisor_line import ControlLine, Word
from manyhands.nodes.rows.tick_events import TickEvents
from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.messages import Absent, Reaction, Refusal, RefusalCode, Rung, Shift, Values


class Membership(StrEnum):
    """The state of a coupling in the session."""

    ACTIVE = "active"
    HELD = "held"
    REJOINING = "rejoining"
    FROZEN = "frozen"
    GONE = "gone"


class MembershipEvent(StrEnum):
    """What the environment has received, or missed, of a coupling; the log has the value as ``heard``."""

    SIGNAL = "its signal of the tick"
    BEHIND = "a signal of an earlier tick"
    AHEAD = "a signal of a later tick"
    OVERDUE = "nothing in time"
    SILENT = "nothing, though others are there"
    PAUSES = "that it has lost a device"
    LOST = "that its process is gone"
    FLOODED = "more stray frames than any honest peer sends"
    RECONNECTED = "that it is back"


TRANSITIONS: Final[Mapping[tuple[Membership, MembershipEvent], Membership]] = {
    (Membership.ACTIVE, MembershipEvent.SIGNAL): Membership.ACTIVE,
    (Membership.ACTIVE, MembershipEvent.BEHIND): Membership.ACTIVE,  # the answer that it has missed is sent again
    (Membership.ACTIVE, MembershipEvent.OVERDUE): Membership.HELD,
    (Membership.ACTIVE, MembershipEvent.SILENT): Membership.FROZEN,  # nothing could hold its end
    (Membership.ACTIVE, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.ACTIVE, MembershipEvent.LOST): Membership.GONE,
    (Membership.ACTIVE, MembershipEvent.FLOODED): Membership.GONE,
    (Membership.HELD, MembershipEvent.SIGNAL): Membership.ACTIVE,
    (Membership.HELD, MembershipEvent.BEHIND): Membership.HELD,  # it is answered, and goes on after the answer's tick
    (Membership.HELD, MembershipEvent.AHEAD): Membership.HELD,
    (Membership.HELD, MembershipEvent.OVERDUE): Membership.HELD,
    (Membership.HELD, MembershipEvent.SILENT): Membership.FROZEN,
    (Membership.HELD, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.HELD, MembershipEvent.LOST): Membership.GONE,
    (Membership.HELD, MembershipEvent.FLOODED): Membership.GONE,
    (Membership.REJOINING, MembershipEvent.SIGNAL): Membership.ACTIVE,
    (Membership.REJOINING, MembershipEvent.BEHIND): Membership.REJOINING,
    (Membership.REJOINING, MembershipEvent.AHEAD): Membership.REJOINING,
    (Membership.REJOINING, MembershipEvent.SILENT): Membership.FROZEN,
    (Membership.REJOINING, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.REJOINING, MembershipEvent.LOST): Membership.GONE,
    (Membership.REJOINING, MembershipEvent.FLOODED): Membership.GONE,
    (Membership.FROZEN, MembershipEvent.SIGNAL): Membership.ACTIVE,
    (Membership.FROZEN, MembershipEvent.BEHIND): Membership.REJOINING,
    # it is awaited at that tick, where this environment process or the one before it sent the coupling
    (Membership.FROZEN, MembershipEvent.AHEAD): Membership.REJOINING,
    (Membership.FROZEN, MembershipEvent.SILENT): Membership.FROZEN,
    (Membership.FROZEN, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.FROZEN, MembershipEvent.LOST): Membership.GONE,
    (Membership.FROZEN, MembershipEvent.FLOODED): Membership.GONE,
    (Membership.GONE, MembershipEvent.LOST): Membership.GONE,
    (Membership.GONE, MembershipEvent.PAUSES): Membership.GONE,
    (Membership.GONE, MembershipEvent.RECONNECTED): Membership.FROZEN,
}
"""Every transition. An event that has no entry for a state cannot happen in it, and changes nothing."""

_THERE: Final = (Membership.ACTIVE, Membership.HELD)

_SHOWS_ITSELF: Final = (MembershipEvent.SIGNAL, MembershipEvent.BEHIND, MembershipEvent.AHEAD)

FIRST_PAUSE: Final = 8  # ticks
LONGEST_PAUSE: Final = 256
FORGIVEN: Final = 100
"""Ticks of activity after which a coupling's earlier absences no longer lengthen its pause: those of the ramp."""

MOST_AHEAD = 2**16
"""Ticks by which a signal that is kept may be ahead: far more than pass between two telemetries.

A resumed environment begins at the tick of the last telemetry, and its couplings may be ahead by that much.
"""

STREAK: Final = 3
"""Ticks in which a member is held before a signal of an earlier tick counts for the tick that is awaited."""

LIGHT: Final = 0.2
"""Force at a tool, N, below which its clutch opens for a change of rung: what a finger hardly feels."""

_UNTIL_HEARD: Final = 2**62  # a tick that no session reaches

LEAD = 3
"""Ticks that a coupling has for its way back; the environment does not wait for it in them.

They are fewer than a device waits for its force, the first tick's own wait included: it would let go again otherwise.
"""

_NOTED = {Membership.FROZEN: LogEvent.FROZEN, Membership.GONE: LogEvent.LOST, Membership.ACTIVE: LogEvent.RETURNED}


class MembershipRecord:
    """The membership of one coupling.

    Attributes:
        state: active, held, rejoining, frozen or gone.
        absences: how often the coupling was frozen or lost.
        since: the tick at which it became active last.
        joins: whether it has never been active.
    """

    __slots__ = ("_misses", "_until", "absences", "joins", "since", "state")

    def __init__(self, state: Membership = Membership.ACTIVE) -> None:
        self.state = state
        self.joins = state is not Membership.ACTIVE
        self.absences = 0
        self._misses = 0  # absences with fewer than FORGIVEN ticks of activity between them
        self.since = 0
        self._until = 0  # the pause ends with this tick

    def on(self, event: MembershipEvent, tick: int) -> bool:
        """Handle ``event`` at ``tick``; returns whether the state changed."""
        before = self.state
        after = TRANSITIONS.get((before, event), before)
        if self.pauses(tick) and event in _SHOWS_ITSELF:
            return False
        self.state = after
        if after is before:
            return False
        if after in _THERE:
            if before not in _THERE:
                self.since, self.joins = tick, False
            return True
        if before in _THERE:
            self.absences += 1
            self._misses = 0 if tick - self.since >= FORGIVEN else self._misses + 1
        elif event is MembershipEvent.SILENT:
            self._misses += 1
        # the first silence brings no pause: it can happen to any process once
        if event is MembershipEvent.SILENT and self._misses:
            self._until = tick + min(FIRST_PAUSE << min(self._misses - 1, 16), LONGEST_PAUSE)
        return True

    def pauses(self, tick: int) -> bool:
        """Whether the coupling is frozen and in its pause at ``tick``: its signals do not make it rejoin yet."""
        return self.state is Membership.FROZEN and tick < self._until

    def pardon(self) -> None:
        """End the pause now: no active coupling is left that this one could keep waiting."""
        self._until = 0


class Member:
    """One coupling: its link, its membership and its rung.

    Attributes:
        join: the link to the coupling.
        index: the coupling's block in the core.
        membership: its state in the session.
        rung: the rung of the ladder that it runs.
        wanted: the rung that it is to run.
        due: while it is held or rejoining, the first tick in which the environment waits for it.
        early: a later tick and the frame of the signal that came for it too early; None where there is none.
        arrived: when its latest signal was read, ns.
        frozen_late: how often it was frozen for being silent.
        waived: whether it is not waited for at present, for it was late too often.
        waivers: how often that began.
        held: the ticks in which it was held.
        streak: of them, those since its tool moved last.
        silent: of them, those since it was heard last.
        linked: whether it is there by a wave link in real time: it is never waited for.
    """

    __slots__ = (
        "arrived",
        "due",
        "early",
        "frozen_late",
        "held",
        "index",
        "join",
        "linked",
        "membership",
        "rung",
        "silent",
        "streak",
        "waived",
        "waivers",
        "wanted",
    )

    def __init__(self, join: Join, index: int, state: Membership) -> None:
        self.join, self.index, self.membership = join, index, MembershipRecord(state)
        self.linked = not join.waited_for
        self.rung = self.wanted = 0
        self.due = 0
        self.early: tuple[int, bytes] | None = None
        self.arrived = Instant(0)
        self.waivers = self.frozen_late = self.held = self.streak = self.silent = 0
        self.waived = False

    def missing(self, tick: int) -> bool:
        """Whether the environment waits for its signal of ``tick``."""
        if self.join.tick == tick or self.linked:
            return False
        if self.membership.state in _THERE and self.waived:
            return False
        return self.membership.state is Membership.ACTIVE or (
            self.membership.state in (Membership.HELD, Membership.REJOINING) and self.due <= tick
        )


def _never() -> bool:
    return False


class Members:
    """All couplings of an environment; the :class:`manyhands.nodes.link.join.Listener` on their links.

    Attributes:
        core: the environment, in which each has a block.
        all: one member for each coupling.
        order: the same members in the order in which they are read; the coupling that was waited for longest is last.
        active: the members to which a tick's forces are sent; kept, so that a tick need not search for them.
        all_active: whether every member is active.
        anybody_out: whether any member is not active that has been before, or was from the start.
        awaited: whether the signals of any active member close the tick; otherwise the clock does.
        linked: whether any member is there by a wave link in real time.
        last: the tick after the session's last; 0 for a session without an end.
        log: receives the members that were frozen, lost or returned; None for no log.
        events: the same with their ticks, for the recording.
        waives: whether any member is not waited for.
        over: whether the devices have sampled the tick that is awaited, or will before an answer reaches them.
        ahead: the latest tick of a signal that came from ahead of a resumed environment.
    """

    def __init__(
        self,
        joins: Sequence[Join],
        core: Core,
        rungs: Mapping[str, Sequence[Values]],
        life: Life,
        resumes: bool,
        independent: bool = True,
    ) -> None:
        """All members are active; where the environment resumes a session, all are rejoining and join by the ramp.

        So do members that no tick waits for: those that are there by wave links in real time, once their waves come.

        Args:
            joins: the links to the couplings, in the order of the core's blocks.
            core: the environment.
            rungs: by coupling, D_V of its rungs from 1 on, m_i x m_i, m/N.
            life: fails when a coupling floods its link.
            resumes: whether the session runs already, and this process replaces one that was lost.
            independent: whether each coupling may change its rung by itself; otherwise all change in one tick.
        """
        self.core, self._rungs, self._independent = core, rungs, independent
        self._digests: dict[str, str] = {}
        self.all = [
            Member(join, i, Membership.REJOINING if resumes or not join.waited_for else Membership.ACTIVE)
            for i, join in enumerate(joins)
        ]
        self.order = list(self.all)
        self._of = {member.join.peer.name: member for member in self.all}
        self._resumes, self._tick = resumes, 0
        self._p: Floats = []  # of all ports, of the call of hear
        self._answer: Floats = []
        self.over: Callable[[], bool] = _never
        self.waives = False
        self.ahead = self.last = 0
        self.log: Log | None = None
        self.events = TickEvents()
        for member in self.all:
            if member.membership.state is Membership.REJOINING:
                core.clutches.freeze(member.index)
        self._shifting = False
        self._life = life
        self.linked = any(member.linked for member in self.all)
        self._sort()

    @property
    def frozen(self) -> int:
        """How many couplings are not active."""
        return sum(member.membership.state not in _THERE for member in self.all)

    @property
    def absences(self) -> int:
        """How often couplings were frozen or lost, in all."""
        return sum(member.membership.absences for member in self.all)

    @property
    def anybody_early(self) -> bool:
        """Whether the signal of a later tick is kept for any coupling."""
        return any(member.early is not None for member in self.all)

    @property
    def pressed(self) -> int:
        """The buttons that are held down, of all members that are there: who is frozen or gone holds none."""
        found = 0
        for member in self.all:
            if member.membership.state in _THERE:
                found |= member.join.pressed
        return found

    def hear(self, member: Member, p: Floats, tick: int, timeout: Duration) -> Received:
        """Listen to one member for its signal of ``tick``, at most ``timeout``, and put it into ``p``, m."""
        self._tick, self._p = tick, p
        early = member.early
        if early is not None and early[0] <= tick:
            member.early = None
            received = Received.NOTHING
            if early[0] < tick:
                member.join.other_tick, member.join.other_frame = early
                member.join.recount("old_tick", 1)  # it is late now, and is counted where it is of no use
                if self.on_other_tick(member.join, early[0], tick):
                    received = Received.DECLINED
            elif member.join.take(early[1], p, tick):
                received = Received.SIGNAL
        else:
            received = member.join.hear(p, tick, timeout, self)
        if received is Received.SIGNAL:
            if member.membership.state is not Membership.ACTIVE and not self._activated(member, tick):
                received = Received.NOTHING
        elif received is Received.DECLINED and member.join.tick == tick:  # it came for an earlier tick
            received = Received.SIGNAL
            self._activated(member, tick)
        elif received is Received.RECONNECTED:
            self._welcome_back(member, tick)
        elif received is Received.FLOODED:
            self._event(member, MembershipEvent.FLOODED, tick)
        return received

    def overdue(self, member: Member, tick: int) -> None:
        """Wait no longer for a member that is silent while the signals of others are there.

        It is held until it is heard. A member that is rejoining is frozen, and so is one whose block has no force that
        could hold its end.
        """
        if member.membership.state is Membership.REJOINING or not self.core.holdable(member.index):
            self.give_up(member, tick)
        else:
            self._event(member, MembershipEvent.OVERDUE, tick)
            member.due = _UNTIL_HEARD

    def give_up(self, member: Member, tick: int) -> None:
        """Freeze a silent member."""
        member.frozen_late += 1
        self._event(member, MembershipEvent.SILENT, tick)

    def waive(self, member: Member) -> None:
        """Wait for a member no longer: it is late again and again, and is held whenever it is."""
        member.waivers += not member.waived
        member.waived = self.waives = True

    def hold(self, tick: int, still: Callable[[int, int], bool]) -> None:
        """Hold every member whose signal of ``tick`` has not come; freeze those that were silent for too long.

        Args:
            tick: k.
            still: whether a member, by its index, was late too often for the environment to wait for it at a tick.
        """
        if self.waives:
            for member in self.all:
                member.waived = member.waived and still(member.index, tick)
            self.waives = any(member.waived for member in self.all)
        for member in self.all:
            if member.linked:
                continue
            if member.membership.state is Membership.ACTIVE and member.join.tick != tick:
                self.overdue(member, tick)
            if member.membership.state is not Membership.HELD:
                continue
            member.held += 1
            member.streak += 1
            member.silent += 1
            if member.silent > PATIENCE_TICKS:
                self.give_up(member, tick)
            else:
                self.core.clutches.hold(member.index)
                self.events.hold(tick, member.join.peer.name)

    def read_last(self, member: Member) -> None:
        """Read ``member`` last from now on: as long as the node waits for it first, other late members go unseen."""
        self.order.remove(member)
        self.order.append(member)

    def pardon(self) -> None:
        """End all pauses: no signal has come for so long that a frozen member keeps no other waiting."""
        for member in self.all:
            member.membership.pardon()

    def forget(self) -> None:
        """Take the next signals as first ones: the devices have let go meanwhile, and have moved without signals."""
        for member in self.all:
            member.join.forget()

    def let_in_again(self, tick: int) -> None:
        """Raise every force by the ramp again: the devices have waited too long, and exert no force by now.

        Devices behind wave links have not waited.
        """
        self.events.raise_again(tick)
        for member in self.all:
            if not member.linked and member.membership.state in _THERE and member.wanted == member.rung:
                self.core.clutches.freeze(member.index)
                self.core.clutches.engage(member.index)
        self.forget()

    def obey(self, word: Word, control: ControlLine, tick: int) -> None:
        """Follow a message of the supervisor: a change of rung, a peer that is lost, or a peer that is back."""
        if isinstance(word, Shift):
            member = self._of.get(word.node)
            if member is not None and word.rung <= len(self._rungs.get(word.node, ())):
                member.wanted = word.rung
                self._shifting = True
                if member.wanted == member.rung and member.membership.state is Membership.ACTIVE:
                    self.core.clutches.engage(member.index)  # its ratio may be falling for a change now withdrawn
            return
        lost = follow(word, [member.join for member in self.all], control)
        if lost is not None:
            member = self._of[lost.peer.name]
            member.early = None
            self._event(member, MembershipEvent.LOST, tick)

    @property
    def changing(self) -> int:
        """Number of couplings that are to change their rung, and have not yet."""
        return sum(member.wanted != member.rung for member in self.all) if self._shifting else 0

    def shift(self) -> None:
        """Change the rung of each coupling that is to change and had s = 0 in the last two ticks.

        The node calls this after the forces of a tick are found and before they are sent. One tick at s = 0 is not
        enough: the force's step to 0 would then belong to one rung, and its delay to the next.
        A clutch opens for a change only while its tool meets less than :data:`LIGHT`. Who leans on a wall would fall
        through it meanwhile; until then the device's interface bounds what lateness costs.
        Where the certificate covers no mixture of rungs, no coupling changes before all that are to change rest.
        """
        if not self._shifting:
            return
        core = self.core
        changing = [member for member in self.active if member.wanted != member.rung]
        resting = [member for member in changing if core.clutches.all[member.index].rests]
        opening = [member for member in changing if member not in resting]
        pressed = [core.clutches.presses(member.index) and core.load(member.index) > LIGHT for member in opening]
        for member, presses in zip(opening, pressed, strict=True):
            # where all change in one tick, no clutch opens before all can
            if not (presses if self._independent else any(pressed)):
                core.clutches.disengage(member.index)
        if not self._independent and (resting != changing or len({member.wanted for member in self.all}) > 1):
            return
        for member in resting:
            name = member.join.peer.name
            core.clutches.freeze(member.index)  # it may have been about to join; only a frozen block is exchanged
            core.exchange(member.index, self._rungs[name][member.wanted - 1] if member.wanted else self._first(member))
            member.join.notify(Rung(member.wanted))
            if self.log is not None:
                self.log.note(LogEvent.RUNG, peer=name, rung=member.wanted, tick=self._tick)
            member.rung = member.wanted
            core.clutches.engage(member.index)
        self._shifting = any(member.wanted != member.rung for member in self.all)

    def on_other_tick(self, join: Join, other: int, awaited: int) -> bool:
        """A coupling sent the signal of tick ``other``: answer again if it is behind, keep its signal if it is ahead.

        A coupling that is behind and may rejoin receives a zero force of a later tick, and goes on after that tick.
        """
        member = self._of[join.peer.name]
        if other > awaited:
            return self._keep_ahead(member, other, awaited)
        held = member.membership.state is Membership.HELD
        if join.tick == other and (held or other == awaited - 1):
            join.send_again()  # the answer was sent, and lost on its way
            return False
        if held:
            return other > join.tick and self._go_on(member, awaited)  # an honest coupling's ticks rise
        if not self.active:
            member.membership.pardon()
        if self._event(member, MembershipEvent.BEHIND, awaited):
            # not beyond the last tick: an active coupling may wait for a device that waits for this coupling
            member.due = min(awaited + LEAD, self.last - 1) if self.last else awaited + LEAD
        if member.membership.state is Membership.REJOINING:
            join.send_zero(Reaction, max(member.due, awaited) - 1)
        return False

    def _go_on(self, member: Member, awaited: int) -> bool:
        """Answer a held member, whose signal of an earlier tick has come; it goes on after the tick of the answer.

        It is held in ``awaited`` as well where its device would sample too late for it. A member that is a little late
        in every tick would be held for ever. So after :data:`STREAK` ticks its signal counts for ``awaited``, and it
        waits for the others.

        Returns:
            Whether its signal counts for ``awaited``.
        """
        join = member.join
        if not join.take_other(self._p, "old_tick"):
            return False
        if member.streak >= STREAK:
            member.due, join.tick = awaited, awaited
            return True
        through = awaited if self.over() else awaited - 1
        member.due, member.silent = through + 1, 0
        if not self._answer:
            self._answer = [0.0] * len(self._p)
        join.put_ports(self._answer, self.core.holding_force(member.index, join.share_of_ports(self._p)))
        join.send(Reaction, through, join.stamp, self._answer)
        return False

    def on_notice(self, join: Join, message: Rung | Absent) -> bool:
        """A coupling reports that it has lost a device: it will be silent, and is frozen."""
        if isinstance(message, Absent):
            member = self._of[join.peer.name]
            self._event(member, MembershipEvent.PAUSES, self._tick)
            # its device is gone, so nothing follows the signal that is kept: release the coupling from that tick now
            if member.early is not None:
                join.send_zero(Reaction, member.early[0])
                member.early = None
            return True
        return False

    def flooded(self, text: str) -> None:
        """End the node: a coupling floods its link, and its signals cannot be found among other frames in time.

        Behind a wave link nobody waits for it, so there its link is closed instead (``Received.FLOODED``).
        """
        self._life.fail(text)

    def begin(self, tick: int) -> None:
        """Record which wave links have nobody at them where the session begins, in ``tick``.

        A process that takes the place of another has no need to: that it began says so of all couplings.
        """
        for member in self.all:
            if member.linked and member.membership.joins:
                self.events.begin_free(tick, member.join.peer.name)

    def soonest(self, tick: int) -> int:
        """The tick to wait at: ``tick``, or the first that a member was told, where none is awaited before."""
        told = (Membership.HELD, Membership.REJOINING)
        dues = [
            member.due
            for member in self.all
            if member.membership.state in told and member.due < _UNTIL_HEARD and not member.linked
        ]
        return tick if self.active or self._resumes or not dues else max(tick, min(dues))

    def catch_up(self, tick: int) -> None:
        """A resumed environment goes on at ``tick``: send every coupling that is behind a zero force up to there."""
        for member in self.all:
            if 0 <= member.join.tick < tick:
                member.join.send_zero(Reaction, tick - 1)

    def resumed(self) -> None:
        """The first tick of a resumed environment is complete: from now on it counts the ticks itself."""
        self._resumes = False

    def _keep_ahead(self, member: Member, other: int, awaited: int) -> bool:
        """Keep the signal of a later tick until that tick, where the coupling was sent on to it."""
        membership = member.membership
        if membership.state is Membership.ACTIVE or membership.pauses(awaited) or other - awaited > MOST_AHEAD:
            return False
        self._event(member, MembershipEvent.AHEAD, awaited)
        member.early, member.due = (other, member.join.other_frame), other
        member.join.recount("future_tick", -1)  # the gate counted it as a stray frame, which it is not
        if self._resumes:
            self.ahead = max(self.ahead, other)
        return True

    def _activated(self, member: Member, tick: int) -> bool:
        """Whether its signal of ``tick`` activates it."""
        state = member.membership.state
        sent_on = state is Membership.REJOINING or (state is Membership.HELD and member.due < _UNTIL_HEARD)
        if sent_on and tick < member.due:
            # sent before the coupling received the force that sends it on to a later tick
            member.join.tick = -1
            return False
        if member.membership.pauses(tick):
            member.join.tick = -1  # ignored; the coupling sends it again, also after the pause
            return False
        member.silent = member.streak = 0
        # where another rung is wanted the clutch stays open: the rung is changed first
        if self._event(member, MembershipEvent.SIGNAL, tick) and member.wanted == member.rung:
            self.core.clutches.engage(member.index)
        return True

    def _welcome_back(self, member: Member, tick: int) -> None:
        """A coupling has shaken hands again: it begins at rung 0, whether its process is a new one or the old one."""
        hello = member.join.hello
        name = member.join.peer.name
        found, expected = "" if hello is None else feedthrough_digest(hello.feedthrough or ()), self._digests.get(name)
        if hello is None or found != expected:
            text = (
                f"the environment refused {name}: found a feedthrough D_V with the digest {found[:16]}; expected "
                f"{(expected or '')[:16]}, that of this session; start {name} with the bundle that was cut for it"
            )
            member.join.refuse(Refusal(RefusalCode.FEEDTHROUGH, text))
            return
        self._event(member, MembershipEvent.RECONNECTED, tick)
        self.core.clutches.freeze(member.index)
        if member.rung or name not in self._feedthrough:
            self._feedthrough[name] = np.array(hello.feedthrough, dtype=np.float64)
            self.core.exchange(member.index, self._feedthrough[name])
            member.rung = 0
            self._shifting = member.wanted != 0 or self._shifting
        member.join.send_zero(Reaction, tick - 1)

    def _first(self, member: Member) -> Values:
        """D_V of rung 0."""
        return self._feedthrough[member.join.peer.name]

    def know(self, feedthrough: Mapping[str, Values], digests: Mapping[str, str]) -> None:
        """Take what the handshakes and the bundle say of rung 0.

        Args:
            feedthrough: by coupling, D_V, m_i x m_i, m/N; couplings that were absent are missing.
            digests: by coupling, the digest of the D_V that it must have.
        """
        self._feedthrough, self._digests = dict(feedthrough), dict(digests)

    def _event(self, member: Member, event: MembershipEvent, tick: int) -> bool:
        was_there = member.membership.state in _THERE
        if not member.membership.on(event, tick):
            return False
        is_there = member.membership.state in _THERE
        if was_there and is_there:
            self._sort()
            return True
        if is_there:
            self.events.activate(tick, member.join.peer.name)
        elif was_there:
            self.events.freeze(tick, member.join.peer.name)
        if self.log is not None and (noted := _NOTED.get(member.membership.state)) is not None:
            self.log.note(noted, peer=member.join.peer.name, tick=tick, heard=event.value)
        if member.membership.state is not Membership.ACTIVE:
            self.core.clutches.freeze(member.index)
            member.join.forget()  # it joins from wherever it is then, so its next signal has no step bound
        self._sort()
        return True

    def _sort(self) -> None:
        self.active = [member for member in self.all if member.membership.state is Membership.ACTIVE]
        self.all_active = len(self.active) == len(self.all)
        self.anybody_out = any(
            member.membership.state not in _THERE and not (member.linked and member.membership.joins)
            for member in self.all
        )
        self.awaited = any(not member.linked for member in self.active)
