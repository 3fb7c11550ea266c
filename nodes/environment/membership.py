"""Which couplings the environment waits for: a seat for each, and what moves it.

A seat whose coupling is silent is frozen: the tool stays where it is, its user feels no force, and the others go on
(docs/decisions/0015-the-clutch.md). So is a coupling that comes late again and again
(:mod:`manyhands.nodes.environment.late_arrivals`). A frozen coupling that shows itself is expected, that is waited for
once more; with its signal of the present tick it is seated, and let in by a ramp. One that shows itself and then does
not come, or comes late again, costs the others some waiting each time. So it is expected again only after a pause that
doubles, and whatever it says in the pause changes nothing.

The couplings around an environment: who is awaited, who is frozen, who comes back, and who changes its rung.

A place joins a coupling's link, its seat (:mod:`manyhands.nodes.environment.membership`) and its block in the
core's clutches. Frames and the supervisor's words move the seats, the seats move the clutches.
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

    SEATED = "seated"
    EXPECTED = "expected"
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
    MET = "that it is back"


TRANSITIONS: Final[Mapping[tuple[Membership, MembershipEvent], Membership]] = {
    (Membership.SEATED, MembershipEvent.SIGNAL): Membership.SEATED,
    (Membership.SEATED, MembershipEvent.BEHIND): Membership.SEATED,  # it is told once more what it has missed
    (Membership.SEATED, MembershipEvent.SILENT): Membership.FROZEN,
    (Membership.SEATED, MembershipEvent.LATE): Membership.FROZEN,
    (Membership.SEATED, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.SEATED, MembershipEvent.LOST): Membership.GONE,
    (Membership.EXPECTED, MembershipEvent.SIGNAL): Membership.SEATED,
    (Membership.EXPECTED, MembershipEvent.BEHIND): Membership.EXPECTED,
    (Membership.EXPECTED, MembershipEvent.AHEAD): Membership.EXPECTED,
    (Membership.EXPECTED, MembershipEvent.SILENT): Membership.FROZEN,
    (Membership.EXPECTED, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.EXPECTED, MembershipEvent.LOST): Membership.GONE,
    (Membership.FROZEN, MembershipEvent.SIGNAL): Membership.SEATED,
    (Membership.FROZEN, MembershipEvent.BEHIND): Membership.EXPECTED,
    # at that tick; it was told to go on there, by this process or the last
    (Membership.FROZEN, MembershipEvent.AHEAD): Membership.EXPECTED,
    (Membership.FROZEN, MembershipEvent.SILENT): Membership.FROZEN,
    (Membership.FROZEN, MembershipEvent.PAUSES): Membership.FROZEN,
    (Membership.FROZEN, MembershipEvent.LOST): Membership.GONE,
    (Membership.GONE, MembershipEvent.LOST): Membership.GONE,
    (Membership.GONE, MembershipEvent.PAUSES): Membership.GONE,
    (Membership.GONE, MembershipEvent.MET): Membership.FROZEN,
}
"""All that can happen to a seat. What is not here cannot be heard of a coupling that stands so, and changes nothing."""

_SHOWS_ITSELF: Final = (MembershipEvent.SIGNAL, MembershipEvent.BEHIND, MembershipEvent.AHEAD)

FIRST_PAUSE: Final = 8  # ticks
LONGEST_PAUSE: Final = 256
FORGIVEN: Final = 100
"""Ticks in its seat after which a coupling's earlier absences are forgotten: as many as the ramp has."""


class Attendance:
    """The seat of one coupling.

    Attributes:
        seat: where it stands.
        absences: times that it was frozen or lost.
        since: tick at which it was seated last.
    """

    __slots__ = ("_misses", "_until", "absences", "seat", "since")

    def __init__(self, seat: Membership = Membership.SEATED) -> None:
        self.seat = seat
        self.absences = 0
        self._misses = 0  # in a row, or nearly
        self.since = 0
        self._until = 0  # it is not expected before this tick

    def on(self, event: MembershipEvent, tick: int) -> bool:
        """Something is heard of it at ``tick``; whether its seat changed."""
        before = self.seat
        after = TRANSITIONS.get((before, event), before)
        if self.pauses(tick) and event in _SHOWS_ITSELF:
            return False
        self.seat = after
        if after is before:
            return False
        if after is Membership.SEATED:
            self.since = tick
        elif before is Membership.SEATED:
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
        return self.seat is Membership.FROZEN and tick < self._until

    def pardon(self) -> None:
        """It need not wait to be expected again: there is nobody whom it could keep waiting."""
        self._until = 0


class Member:
    """One coupling's.

    Attributes:
        joint: the link to it.
        index: its block in the core.
        attendance: its seat.
        rung: the coupling of the ladder that it runs.
        wanted: the one that it is to run.
        due: the tick at which it is expected, where it is.
        early: a signal of a tick whose turn has not come, and that tick.
        arrived: when its latest signal was read, ns.
        frozen_late: times that it was frozen for being late, or silent.
    """

    __slots__ = ("arrived", "attendance", "due", "early", "frozen_late", "index", "joint", "rung", "wanted")

    def __init__(self, joint: PeerLink, index: int, seat: Membership) -> None:
        self.joint, self.index, self.attendance = joint, index, Attendance(seat)
        self.rung = self.wanted = 0
        self.due = 0
        self.early: tuple[int, bytes] | None = None
        self.arrived = Instant(0)
        self.frozen_late = 0

    def missing(self, tick: int) -> bool:
        """Whether its signal of ``tick`` is waited for."""
        if self.joint.tick == tick:
            return False
        return self.attendance.seat is Membership.SEATED or (
            self.attendance.seat is Membership.EXPECTED and self.due <= tick
        )


class Members:
    """All of them; the :class:`manyhands.nodes.peer_link.Listener` on their links.

    Attributes:
        all: one for each coupling.
        order: the same, in the order in which they are read: who was waited for longest comes last.
        seated: those who are sent a tick's forces; kept, so that a tick need not look for them.
        all_seated: whether that is everybody.
        last: the tick after the session's last; 0 for none.
        log: where it is noted who was frozen, lost or back; None for nowhere.
        events: the same with ticks, for the recording.
        ahead: the latest tick heard from who is ahead of a resumed environment.
    """

    def __init__(
        self,
        joints: Sequence[PeerLink],
        core: Core,
        rungs: Mapping[str, Sequence[Values]],
        life: Life,
        resumes: bool,
        independent: bool = True,
    ) -> None:
        """Seat everybody; in a session that goes on already everybody is expected, and let in by the ramp.

        Args:
            joints: the couplings, in the order of the core's blocks.
            core: the environment.
            rungs: by coupling, D_V of its rungs from 1 on.
            life: fails when a coupling floods its link.
            resumes: whether the session goes on already.
            independent: whether each coupling may change its rung by itself; otherwise all change in one tick.
        """
        self._core, self._rungs, self._independent = core, rungs, independent
        self._digests: dict[str, str] = {}
        self.all = [
            Member(joint, i, Membership.EXPECTED if resumes else Membership.SEATED) for i, joint in enumerate(joints)
        ]
        self.order = list(self.all)
        self._of = {place.joint.peer.name: place for place in self.all}
        self._resumes, self._tick = resumes, 0
        self.ahead = self.last = 0
        self.log: Log | None = None
        self.events = TickEvents()
        if resumes:
            for place in self.all:
                core.clutches.freeze(place.index)
        self._shifting = False
        self._life = life
        self._sort()

    @property
    def frozen(self) -> int:
        """How many couplings are not seated."""
        return sum(place.attendance.seat is not Membership.SEATED for place in self.all)

    @property
    def absences(self) -> int:
        """Times that any of them was frozen or lost."""
        return sum(place.attendance.absences for place in self.all)

    @property
    def anybody_early(self) -> bool:
        """Whether anybody has said what he has to say, of a tick that has not come."""
        return any(place.early is not None for place in self.all)

    def hear(self, place: Member, p: Floats, tick: int, patience: Duration) -> Received:
        """Listen to one of them for its signal of ``tick``."""
        self._tick = tick
        early = place.early
        if early is not None and early[0] <= tick:
            place.early = None
            heard = Received.NOTHING
            if early[0] < tick:
                self.astray(place.joint, early[0], tick)
            elif place.joint.take(early[1], p, tick):
                heard = Received.SIGNAL
        else:
            heard = place.joint.hear(p, tick, patience, self)
        if heard is Received.SIGNAL:
            if place.attendance.seat is not Membership.SEATED and not self._seated(place, tick):
                heard = Received.NOTHING
        elif heard is Received.MET:
            self._welcome_back(place, tick)
        return heard

    def give_up(self, place: Member, tick: int) -> None:
        """It is silent while others are there: freeze it."""
        place.frozen_late += 1
        self._event(place, MembershipEvent.SILENT, tick)

    def exclude(self, place: Member, tick: int) -> None:
        """It comes late again and again: freeze it. Its signal of ``tick`` is not answered, so that it pauses."""
        place.frozen_late += 1
        place.joint.tick = -1
        self._event(place, MembershipEvent.LATE, tick)

    def read_last(self, place: Member) -> None:
        """It was waited for before the others were read, and nobody knows who else was late: read it last now."""
        self.order.remove(place)
        self.order.append(place)

    def pardon(self) -> None:
        """Nobody has come for so long that those who were given up keep nobody waiting."""
        for place in self.all:
            place.attendance.pardon()

    def forget(self) -> None:
        """The devices have waited so long that they have let go, and have moved on unheard."""
        for place in self.all:
            place.joint.gate.forget()

    def let_go(self, tick: int) -> None:
        """The devices have waited too long and exert no force by now: let everybody in by the ramp again."""
        for place in self.all:
            if place.attendance.seat is Membership.SEATED and place.wanted == place.rung:
                self._core.clutches.freeze(place.index)
                self._core.clutches.engage(place.index)
        self.forget()

    def obey(self, word: Word, control: ControlLine, tick: int) -> None:
        """Do as the supervisor says."""
        if isinstance(word, Shift):
            place = self._of.get(word.node)
            if place is not None and word.rung <= len(self._rungs.get(word.node, ())):
                place.wanted = word.rung
                self._shifting = True
                if place.wanted == place.rung and place.attendance.seat is Membership.SEATED:
                    self._core.clutches.engage(place.index)  # had it been about to change
            return
        lost = follow(word, [place.joint for place in self.all], control)
        if lost is not None:
            place = self._of[lost.peer.name]
            place.early = None
            self._event(place, MembershipEvent.LOST, tick)

    def shift(self) -> None:
        """After the forces of a tick were found and before they are sent: change rungs, where s has been 0 for two.

        A tick at s = 0 is not enough: the step to it of the force would be of one rung and its delay of another.
        Where only a whole rung is certified, and no mixture, nobody changes before all who are to change rest.
        """
        if not self._shifting:
            return
        core = self._core
        changing = [place for place in self.seated if place.wanted != place.rung]
        resting = [place for place in changing if core.clutches.rests(place.index)]
        for place in changing:
            if place not in resting:
                core.clutches.disengage(place.index)
        if not self._independent and (resting != changing or len({place.wanted for place in self.all}) > 1):
            return
        for place in resting:
            name = place.joint.peer.name
            core.clutches.freeze(place.index)  # had it been about to join
            core.exchange(place.index, self._rungs[name][place.wanted - 1] if place.wanted else self._first(place))
            place.joint.say(Rung(place.wanted))
            if self.log is not None:
                self.log.note(LogEvent.RUNG, peer=name, rung=place.wanted, tick=self._tick)
            place.rung = place.wanted
            core.clutches.engage(place.index)
        self._shifting = any(place.wanted != place.rung for place in self.all)

    def astray(self, joint: PeerLink, told: int, awaited: int) -> bool:
        """A signal of another tick: who is behind is told where the session is, if it may come again."""
        place = self._of[joint.peer.name]
        if told > awaited:
            return self._hear_ahead(place, told, awaited)
        if told == awaited - 1 and joint.tick == told:
            joint.send_again()  # it was answered, and the answer was lost
            return False
        if not self.seated:
            place.attendance.pardon()
        if self._event(place, MembershipEvent.BEHIND, awaited):
            # not beyond the last tick: those who are seated may wait for a device that waits for this one
            place.due = min(awaited + LEAD, self.last - 1) if self.last else awaited + LEAD
        if place.attendance.seat is Membership.EXPECTED:
            joint.send_zero(Reaction, max(place.due, awaited) - 1)
        return False

    def aside(self, joint: PeerLink, message: Rung | Absent) -> bool:
        """A coupling has lost a device: it will be silent."""
        if isinstance(message, Absent):
            place = self._of[joint.peer.name]
            self._event(place, MembershipEvent.PAUSES, self._tick)
            if place.early is not None:  # it has no more to say: it need not wait until this one's turn has come
                joint.send_zero(Reaction, place.early[0])
                place.early = None
            return True
        return False

    def flooded(self, text: str) -> None:
        """A coupling floods its link: there is no telling its signals from the rest in time."""
        self._life.fail(text)

    def soonest(self, tick: int) -> int:
        """The tick to wait at: ``tick``, or where nobody is awaited before, the first at which somebody is expected."""
        dues = [place.due for place in self.all if place.attendance.seat is Membership.EXPECTED]
        return tick if self.seated or self._resumes or not dues else max(tick, min(dues))

    def catch_up(self, tick: int) -> None:
        """A resumed environment goes on at ``tick``: who has said less is told so."""
        for place in self.all:
            if 0 <= place.joint.tick < tick:
                place.joint.send_zero(Reaction, tick - 1)

    def resumed(self) -> None:
        """From now on the ticks are the environment's."""
        self._resumes = False

    def _hear_ahead(self, place: Member, told: int, awaited: int) -> bool:
        """A signal of a later tick, from who was told to go on there: it is kept until then."""
        attendance = place.attendance
        if attendance.seat is Membership.SEATED or attendance.pauses(awaited) or told - awaited > MOST_AHEAD:
            return False
        self._event(place, MembershipEvent.AHEAD, awaited)
        place.early, place.due = (told, place.joint.stray), told
        place.joint.gate.dropped["future_tick"] -= 1  # it was counted as a stray, and is none
        if self._resumes:
            self.ahead = max(self.ahead, told)
        return True

    def _seated(self, place: Member, tick: int) -> bool:
        """Whether its signal of ``tick`` seats it."""
        if place.attendance.seat is Membership.EXPECTED and tick < place.due:
            place.joint.tick = -1  # said before it heard that it is to go on later, as it does
            return False
        if place.attendance.pauses(tick):
            place.joint.tick = -1  # nobody waits for it; it says so again when the pause is over
            return False
        # otherwise it changes its rung first
        if self._event(place, MembershipEvent.SIGNAL, tick) and place.wanted == place.rung:
            self._core.clutches.engage(place.index)
        return True

    def _welcome_back(self, place: Member, tick: int) -> None:
        """It has shaken hands again: whether it is a new process, at the first rung, or the old one is all the same."""
        hello = place.joint.hello
        name = place.joint.peer.name
        if hello is None or feedthrough_digest(hello.feedthrough or ()) != self._digests.get(name):
            place.joint.lose()
            return
        self._event(place, MembershipEvent.MET, tick)
        self._core.clutches.freeze(place.index)
        if place.rung or name not in self._feedthrough:
            self._feedthrough[name] = np.array(hello.feedthrough, dtype=np.float64)
            self._core.exchange(place.index, self._feedthrough[name])
            place.rung = 0
            self._shifting = place.wanted != 0 or self._shifting
        place.joint.send_zero(Reaction, tick - 1)

    def _first(self, place: Member) -> Values:
        """D_V of rung 0."""
        return self._feedthrough[place.joint.peer.name]

    def know(self, feedthrough: Mapping[str, Values], digests: Mapping[str, str]) -> None:
        """By coupling: D_V of rung 0 of those that have said it, and the digest by which each is known."""
        self._feedthrough, self._digests = dict(feedthrough), dict(digests)

    def _event(self, place: Member, event: MembershipEvent, tick: int) -> bool:
        was_seated = place.attendance.seat is Membership.SEATED
        if not place.attendance.on(event, tick):
            return False
        if place.attendance.seat is Membership.SEATED:
            self.events.seat(tick, place.joint.peer.name)
        elif was_seated:
            self.events.freeze(tick, place.joint.peer.name)
        if self.log is not None and (noted := _NOTED.get(place.attendance.seat)) is not None:
            self.log.note(noted, peer=place.joint.peer.name, tick=tick, heard=event.value)
        if place.attendance.seat is not Membership.SEATED:
            self._core.clutches.freeze(place.index)
            place.joint.gate.forget()  # it is let in from where it is then
        self._sort()
        return True

    def _sort(self) -> None:
        self.seated = [place for place in self.all if place.attendance.seat is Membership.SEATED]
        self.all_seated = len(self.seated) == len(self.all)


_NOTED = {Membership.FROZEN: LogEvent.FROZEN, Membership.GONE: LogEvent.LOST, Membership.SEATED: LogEvent.RETURNED}

MOST_AHEAD = 2**16
"""Ticks by which a signal that is kept may be ahead: far more than pass between two telemetries.

By those a resumed environment begins.
"""

LEAD = 3
"""Ticks that a coupling is given to come back in: nobody waits for it in them.

More than a device waits for its force, with the first tick's own, and it would have let go again meanwhile.
"""
