"""Which couplings the environment waits for: a membership for each, and what changes it.

A coupling that is silent is frozen: the tool stays where it is, its user feels no force, and the others go on
(docs/decisions/0015-the-clutch.md). So is a coupling that comes late again and again
(:mod:`manyhands.nodes.environment.late_arrivals`). A frozen coupling that shows itself is rejoining, that is waited for
once more; with its signal of the present tick it is active, and let in by a ramp. One that shows itself and then does
not come, or comes late again, costs the others some waiting each time. So it rejoins again only after a pause that
doubles, and whatever it says in the pause changes nothing.

The couplings around an environment: who is awaited, who is frozen, who comes back, and who changes its rung.

A member joins a coupling's link, its membership (:mod:`manyhands.nodes.environment.membership`) and its block in the
core's clutches. Frames and the supervisor's words change memberships, and memberships move the clutches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Final

import numpy as np

from manyhands.nodes.arithmetic import Floats, feedthrough_digest
from manyhands.nodes.environment.enforced import Core
from manyhands.nodes.lifetime import Life
from manyhands.nodes.log import Log, LogEvent
from manyhands.nodes.peer_link import PeerLink, Received
from manyhands.nodes.rejoin import follow
from manyhands.nodes.supervisor_line import ControlLine, Word
from manyhands.nodes.tick_events import TickEvents
from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.messages import Absent, Reaction, Rung, Shift, Values


class Membership(StrEnum):
    """Where a coupling stands."""

    ACTIVE = "active"
    REJOINING = "rejoining"
    FROZEN = "frozen"
    GONE = "gone"


class MembershipEvent(StrEnum):
    """What is heard of a coupling."""

    SIGNAL = "its signal of the tick"
    BEHIND = "a signal of an earlier tick"
    AHEAD = "a signal of a later tick"
    SILENT = "nothing, though others are there"
    LATE = "its signal, after all others again and again"
    PAUSES = "that it has lost a device"
    LOST = "that its process is gone"
    RECONNECTED = "that it is back"


TRANSITIONS: Final[Mapping[tuple[Membership, MembershipEvent], Membership]] = {
    (Membership.ACTIVE, MembershipEvent.SIGNAL): Membership.ACTIVE,
    (Membership.ACTIVE, MembershipEvent.BEHIND): Membership.ACTIVE,  # it is told once more what it has missed
    (Membership.ACTIVE, MembershipEvent.SILENT): Membership.FROZEN,
    (Membership.ACTIVE, MembershipEvent.LATE): Membership.FROZEN,
    (Membership.ACTIVE, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.ACTIVE, MembershipEvent.LOST): Membership.GONE,
    (Membership.REJOINING, MembershipEvent.SIGNAL): Membership.ACTIVE,
    (Membership.REJOINING, MembershipEvent.BEHIND): Membership.REJOINING,
    (Membership.REJOINING, MembershipEvent.AHEAD): Membership.REJOINING,
    (Membership.REJOINING, MembershipEvent.SILENT): Membership.FROZEN,
    (Membership.REJOINING, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.REJOINING, MembershipEvent.LOST): Membership.GONE,
    (Membership.FROZEN, MembershipEvent.SIGNAL): Membership.ACTIVE,
    (Membership.FROZEN, MembershipEvent.BEHIND): Membership.REJOINING,
    # at that tick; it was told to go on there, by this process or the last
    (Membership.FROZEN, MembershipEvent.AHEAD): Membership.REJOINING,
    (Membership.FROZEN, MembershipEvent.SILENT): Membership.FROZEN,
    (Membership.FROZEN, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.FROZEN, MembershipEvent.LOST): Membership.GONE,
    (Membership.GONE, MembershipEvent.LOST): Membership.GONE,
    (Membership.GONE, MembershipEvent.PAUSES): Membership.GONE,
    (Membership.GONE, MembershipEvent.RECONNECTED): Membership.FROZEN,
}
"""All that can happen to a membership. What is not here cannot be heard of a coupling that stands so, and changes
nothing."""

_SHOWS_ITSELF: Final = (MembershipEvent.SIGNAL, MembershipEvent.BEHIND, MembershipEvent.AHEAD)

FIRST_PAUSE: Final = 8  # ticks
LONGEST_PAUSE: Final = 256
FORGIVEN: Final = 100
"""Ticks of activity after which a coupling's earlier absences are forgotten: as many as the ramp has."""


class MembershipRecord:
    """The membership of one coupling.

    Attributes:
        state: where it stands.
        absences: times that it was frozen or lost.
        since: tick at which it became active last.
    """

    __slots__ = ("_misses", "_until", "absences", "since", "state")

    def __init__(self, state: Membership = Membership.ACTIVE) -> None:
        self.state = state
        self.absences = 0
        self._misses = 0  # in a row, or nearly
        self.since = 0
        self._until = 0  # it is not expected before this tick

    def on(self, event: MembershipEvent, tick: int) -> bool:
        """Something is heard of it at ``tick``; whether its state changed."""
        before = self.state
        after = TRANSITIONS.get((before, event), before)
        if self.pauses(tick) and event in _SHOWS_ITSELF:
            return False
        self.state = after
        if after is before:
            return False
        if after is Membership.ACTIVE:
            self.since = tick
        elif before is Membership.ACTIVE:
            self.absences += 1
            self._misses = 0 if tick - self.since >= FORGIVEN else self._misses + 1
            if event is MembershipEvent.LATE:  # many late ticks, and not the first
                self._misses = max(1, self._misses)
        elif event is MembershipEvent.SILENT:
            self._misses += 1
        if event in (MembershipEvent.SILENT, MembershipEvent.LATE) and self._misses:  # the first silence is everybody's
            self._until = tick + min(FIRST_PAUSE << min(self._misses - 1, 16), LONGEST_PAUSE)
        return True

    def pauses(self, tick: int) -> bool:
        """Whether it is frozen, and not expected yet at ``tick`` whatever it says."""
        return self.state is Membership.FROZEN and tick < self._until

    def pardon(self) -> None:
        """It need not wait to be expected again: there is nobody whom it could keep waiting."""
        self._until = 0


class Member:
    """One coupling's.

    Attributes:
        peer_link: the link to it.
        index: its block in the core.
        membership: its seat.
        rung: the coupling of the ladder that it runs.
        wanted: the one that it is to run.
        due: the tick at which it is expected, where it is.
        early: a signal of a tick whose turn has not come, and that tick.
        arrived: when its latest signal was read, ns.
        frozen_late: times that it was frozen for being late, or silent.
    """

    __slots__ = ("arrived", "due", "early", "frozen_late", "index", "membership", "peer_link", "rung", "wanted")

    def __init__(self, peer_link: PeerLink, index: int, state: Membership) -> None:
        self.peer_link, self.index, self.membership = peer_link, index, MembershipRecord(state)
        self.rung = self.wanted = 0
        self.due = 0
        self.early: tuple[int, bytes] | None = None
        self.arrived = Instant(0)
        self.frozen_late = 0

    def missing(self, tick: int) -> bool:
        """Whether its signal of ``tick`` is waited for."""
        if self.peer_link.tick == tick:
            return False
        return self.membership.state is Membership.ACTIVE or (
            self.membership.state is Membership.REJOINING and self.due <= tick
        )


class Members:
    """All of them; the :class:`manyhands.nodes.peer_link.Listener` on their links.

    Attributes:
        all: one for each coupling.
        order: the same, in the order in which they are read: who was waited for longest comes last.
        active: those who are sent a tick's forces; kept, so that a tick need not look for them.
        all_active: whether that is everybody.
        last: the tick after the session's last; 0 for none.
        log: where it is noted who was frozen, lost or back; None for nowhere.
        events: the same with ticks, for the recording.
        ahead: the latest tick heard from who is ahead of a resumed environment.
    """

    def __init__(
        self,
        peer_links: Sequence[PeerLink],
        core: Core,
        rungs: Mapping[str, Sequence[Values]],
        life: Life,
        resumes: bool,
        independent: bool = True,
    ) -> None:
        """Everybody is active; in a session that goes on already everybody is rejoining, and let in by the ramp.

        Args:
            peer_links: the couplings, in the order of the core's blocks.
            core: the environment.
            rungs: by coupling, D_V of its rungs from 1 on.
            life: fails when a coupling floods its link.
            resumes: whether the session goes on already.
            independent: whether each coupling may change its rung by itself; otherwise all change in one tick.
        """
        self._core, self._rungs, self._independent = core, rungs, independent
        self._digests: dict[str, str] = {}
        self.all = [
            Member(peer_link, i, Membership.REJOINING if resumes else Membership.ACTIVE)
            for i, peer_link in enumerate(peer_links)
        ]
        self.order = list(self.all)
        self._of = {member.peer_link.peer.name: member for member in self.all}
        self._resumes, self._tick = resumes, 0
        self.ahead = self.last = 0
        self.log: Log | None = None
        self.events = TickEvents()
        if resumes:
            for member in self.all:
                core.clutches.freeze(member.index)
        self._shifting = False
        self._life = life
        self._sort()

    @property
    def frozen(self) -> int:
        """How many couplings are not active."""
        return sum(member.membership.state is not Membership.ACTIVE for member in self.all)

    @property
    def absences(self) -> int:
        """Times that any of them was frozen or lost."""
        return sum(member.membership.absences for member in self.all)

    @property
    def anybody_early(self) -> bool:
        """Whether anybody has said what he has to say, of a tick that has not come."""
        return any(member.early is not None for member in self.all)

    def hear(self, member: Member, p: Floats, tick: int, timeout: Duration) -> Received:
        """Listen to one of them for its signal of ``tick``."""
        self._tick = tick
        early = member.early
        if early is not None and early[0] <= tick:
            member.early = None
            received = Received.NOTHING
            if early[0] < tick:
                self.on_other_tick(member.peer_link, early[0], tick)
            elif member.peer_link.take(early[1], p, tick):
                received = Received.SIGNAL
        else:
            received = member.peer_link.hear(p, tick, timeout, self)
        if received is Received.SIGNAL:
            if member.membership.state is not Membership.ACTIVE and not self._activated(member, tick):
                received = Received.NOTHING
        elif received is Received.RECONNECTED:
            self._welcome_back(member, tick)
        return received

    def give_up(self, member: Member, tick: int) -> None:
        """It is silent while others are there: freeze it."""
        member.frozen_late += 1
        self._event(member, MembershipEvent.SILENT, tick)

    def exclude(self, member: Member, tick: int) -> None:
        """It comes late again and again: freeze it. Its signal of ``tick`` is not answered, so that it pauses."""
        member.frozen_late += 1
        member.peer_link.tick = -1
        self._event(member, MembershipEvent.LATE, tick)

    def read_last(self, member: Member) -> None:
        """It was waited for before the others were read, and nobody knows who else was late: read it last now."""
        self.order.remove(member)
        self.order.append(member)

    def pardon(self) -> None:
        """Nobody has come for so long that those who were given up keep nobody waiting."""
        for member in self.all:
            member.membership.pardon()

    def forget(self) -> None:
        """The devices have waited so long that they have let go, and have moved on unheard."""
        for member in self.all:
            member.peer_link.gate.forget()

    def let_go(self, tick: int) -> None:
        """The devices have waited too long and exert no force by now: let everybody in by the ramp again."""
        for member in self.all:
            if member.membership.state is Membership.ACTIVE and member.wanted == member.rung:
                self._core.clutches.freeze(member.index)
                self._core.clutches.engage(member.index)
        self.forget()

    def obey(self, word: Word, control: ControlLine, tick: int) -> None:
        """Do as the supervisor says."""
        if isinstance(word, Shift):
            member = self._of.get(word.node)
            if member is not None and word.rung <= len(self._rungs.get(word.node, ())):
                member.wanted = word.rung
                self._shifting = True
                if member.wanted == member.rung and member.membership.state is Membership.ACTIVE:
                    self._core.clutches.engage(member.index)  # had it been about to change
            return
        lost = follow(word, [member.peer_link for member in self.all], control)
        if lost is not None:
            member = self._of[lost.peer.name]
            member.early = None
            self._event(member, MembershipEvent.LOST, tick)

    def shift(self) -> None:
        """After the forces of a tick were found and before they are sent: change rungs, where s has been 0 for two.

        A tick at s = 0 is not enough: the step to it of the force would be of one rung and its delay of another.
        Where only a whole rung is certified, and no mixture, nobody changes before all who are to change rest.
        """
        if not self._shifting:
            return
        core = self._core
        changing = [member for member in self.active if member.wanted != member.rung]
        resting = [member for member in changing if core.clutches.rests(member.index)]
        for member in changing:
            if member not in resting:
                core.clutches.disengage(member.index)
        if not self._independent and (resting != changing or len({member.wanted for member in self.all}) > 1):
            return
        for member in resting:
            name = member.peer_link.peer.name
            core.clutches.freeze(member.index)  # had it been about to join
            core.exchange(member.index, self._rungs[name][member.wanted - 1] if member.wanted else self._first(member))
            member.peer_link.say(Rung(member.wanted))
            if self.log is not None:
                self.log.note(LogEvent.RUNG, peer=name, rung=member.wanted, tick=self._tick)
            member.rung = member.wanted
            core.clutches.engage(member.index)
        self._shifting = any(member.wanted != member.rung for member in self.all)

    def on_other_tick(self, peer_link: PeerLink, told: int, awaited: int) -> bool:
        """A signal of another tick: who is behind is told where the session is, if it may come again."""
        member = self._of[peer_link.peer.name]
        if told > awaited:
            return self._hear_ahead(member, told, awaited)
        if told == awaited - 1 and peer_link.tick == told:
            peer_link.send_again()  # it was answered, and the answer was lost
            return False
        if not self.active:
            member.membership.pardon()
        if self._event(member, MembershipEvent.BEHIND, awaited):
            # not beyond the last tick: those who are active may wait for a device that waits for this one
            member.due = min(awaited + LEAD, self.last - 1) if self.last else awaited + LEAD
        if member.membership.state is Membership.REJOINING:
            peer_link.send_zero(Reaction, max(member.due, awaited) - 1)
        return False

    def on_notice(self, peer_link: PeerLink, message: Rung | Absent) -> bool:
        """A coupling has lost a device: it will be silent."""
        if isinstance(message, Absent):
            member = self._of[peer_link.peer.name]
            self._event(member, MembershipEvent.PAUSES, self._tick)
            if member.early is not None:  # it has no more to say: it need not wait until this one's turn has come
                peer_link.send_zero(Reaction, member.early[0])
                member.early = None
            return True
        return False

    def flooded(self, text: str) -> None:
        """A coupling floods its link: there is no telling its signals from the rest in time."""
        self._life.fail(text)

    def soonest(self, tick: int) -> int:
        """The tick to wait at: ``tick``, or where nobody is awaited before, the first at which somebody is expected."""
        dues = [member.due for member in self.all if member.membership.state is Membership.REJOINING]
        return tick if self.active or self._resumes or not dues else max(tick, min(dues))

    def catch_up(self, tick: int) -> None:
        """A resumed environment goes on at ``tick``: who has said less is told so."""
        for member in self.all:
            if 0 <= member.peer_link.tick < tick:
                member.peer_link.send_zero(Reaction, tick - 1)

    def resumed(self) -> None:
        """From now on the ticks are the environment's."""
        self._resumes = False

    def _hear_ahead(self, member: Member, told: int, awaited: int) -> bool:
        """A signal of a later tick, from who was told to go on there: it is kept until then."""
        membership = member.membership
        if membership.state is Membership.ACTIVE or membership.pauses(awaited) or told - awaited > MOST_AHEAD:
            return False
        self._event(member, MembershipEvent.AHEAD, awaited)
        member.early, member.due = (told, member.peer_link.other_frame), told
        member.peer_link.gate.dropped["future_tick"] -= 1  # it was counted as a stray, and is none
        if self._resumes:
            self.ahead = max(self.ahead, told)
        return True

    def _activated(self, member: Member, tick: int) -> bool:
        """Whether its signal of ``tick`` activates it."""
        if member.membership.state is Membership.REJOINING and tick < member.due:
            member.peer_link.tick = -1  # said before it heard that it is to go on later, as it does
            return False
        if member.membership.pauses(tick):
            member.peer_link.tick = -1  # nobody waits for it; it says so again when the pause is over
            return False
        # otherwise it changes its rung first
        if self._event(member, MembershipEvent.SIGNAL, tick) and member.wanted == member.rung:
            self._core.clutches.engage(member.index)
        return True

    def _welcome_back(self, member: Member, tick: int) -> None:
        """It has shaken hands again: whether it is a new process, at the first rung, or the old one is all the same."""
        hello = member.peer_link.hello
        name = member.peer_link.peer.name
        if hello is None or feedthrough_digest(hello.feedthrough or ()) != self._digests.get(name):
            member.peer_link.lose()
            return
        self._event(member, MembershipEvent.RECONNECTED, tick)
        self._core.clutches.freeze(member.index)
        if member.rung or name not in self._feedthrough:
            self._feedthrough[name] = np.array(hello.feedthrough, dtype=np.float64)
            self._core.exchange(member.index, self._feedthrough[name])
            member.rung = 0
            self._shifting = member.wanted != 0 or self._shifting
        member.peer_link.send_zero(Reaction, tick - 1)

    def _first(self, member: Member) -> Values:
        """D_V of rung 0."""
        return self._feedthrough[member.peer_link.peer.name]

    def know(self, feedthrough: Mapping[str, Values], digests: Mapping[str, str]) -> None:
        """By coupling: D_V of rung 0 of those that have said it, and the digest by which each is known."""
        self._feedthrough, self._digests = dict(feedthrough), dict(digests)

    def _event(self, member: Member, event: MembershipEvent, tick: int) -> bool:
        was_seated = member.membership.state is Membership.ACTIVE
        if not member.membership.on(event, tick):
            return False
        if member.membership.state is Membership.ACTIVE:
            self.events.activate(tick, member.peer_link.peer.name)
        elif was_seated:
            self.events.freeze(tick, member.peer_link.peer.name)
        if self.log is not None and (noted := _NOTED.get(member.membership.state)) is not None:
            self.log.note(noted, peer=member.peer_link.peer.name, tick=tick, heard=event.value)
        if member.membership.state is not Membership.ACTIVE:
            self._core.clutches.freeze(member.index)
            member.peer_link.gate.forget()  # it is let in from where it is then
        self._sort()
        return True

    def _sort(self) -> None:
        self.active = [member for member in self.all if member.membership.state is Membership.ACTIVE]
        self.all_active = len(self.active) == len(self.all)


_NOTED = {Membership.FROZEN: LogEvent.FROZEN, Membership.GONE: LogEvent.LOST, Membership.ACTIVE: LogEvent.RETURNED}

MOST_AHEAD = 2**16
"""Ticks by which a signal that is kept may be ahead: far more than pass between two telemetries.

By those a resumed environment begins.
"""

LEAD = 3
"""Ticks that a coupling is given to come back in: nobody waits for it in them.

More than a device waits for its force, with the first tick's own, and it would have let go again meanwhile.
"""
