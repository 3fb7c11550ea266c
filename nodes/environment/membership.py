"""The couplings around an environment: who is awaited, who is frozen, who comes back, and who changes its rung.

A place joins a coupling's link, its seat (:mod:`manyhands.nodes.environment.attendance`) and its block in the
core's clutches. Frames and the supervisor's words move the seats, the seats move the clutches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from manyhands.nodes.control import ControlLine, Word
from manyhands.nodes.environment.attendance import Attendance, Event, Seat
from manyhands.nodes.environment.cores import Core
from manyhands.nodes.exchange import Heard, Joint
from manyhands.nodes.feedthrough import feedthrough_digest
from manyhands.nodes.life import Life
from manyhands.nodes.linear_map import Floats
from manyhands.nodes.log import Event as LogEvent
from manyhands.nodes.log import Log
from manyhands.nodes.reunion import follow
from manyhands.nodes.tick_events import TickEvents
from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.messages import Absent, Reaction, Rung, Shift, Values


class Place:
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

    def __init__(self, joint: Joint, index: int, seat: Seat) -> None:
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
        return self.attendance.seat is Seat.SEATED or (self.attendance.seat is Seat.EXPECTED and self.due <= tick)


class Places:
    """All of them; the :class:`manyhands.nodes.exchange.Listener` on their links.

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
        joints: Sequence[Joint],
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
        self.all = [Place(joint, i, Seat.EXPECTED if resumes else Seat.SEATED) for i, joint in enumerate(joints)]
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
        return sum(place.attendance.seat is not Seat.SEATED for place in self.all)

    @property
    def absences(self) -> int:
        """Times that any of them was frozen or lost."""
        return sum(place.attendance.absences for place in self.all)

    @property
    def anybody_early(self) -> bool:
        """Whether anybody has said what he has to say, of a tick that has not come."""
        return any(place.early is not None for place in self.all)

    def hear(self, place: Place, p: Floats, tick: int, patience: Duration) -> Heard:
        """Listen to one of them for its signal of ``tick``."""
        self._tick = tick
        early = place.early
        if early is not None and early[0] <= tick:
            place.early = None
            heard = Heard.NOTHING
            if early[0] < tick:
                self.astray(place.joint, early[0], tick)
            elif place.joint.take(early[1], p, tick):
                heard = Heard.SIGNAL
        else:
            heard = place.joint.hear(p, tick, patience, self)
        if heard is Heard.SIGNAL:
            if place.attendance.seat is not Seat.SEATED and not self._seated(place, tick):
                heard = Heard.NOTHING
        elif heard is Heard.MET:
            self._welcome_back(place, tick)
        return heard

    def give_up(self, place: Place, tick: int) -> None:
        """It is silent while others are there: freeze it."""
        place.frozen_late += 1
        self._event(place, Event.SILENT, tick)

    def exclude(self, place: Place, tick: int) -> None:
        """It comes late again and again: freeze it. Its signal of ``tick`` is not answered, so that it pauses."""
        place.frozen_late += 1
        place.joint.tick = -1
        self._event(place, Event.LATE, tick)

    def read_last(self, place: Place) -> None:
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
            if place.attendance.seat is Seat.SEATED and place.wanted == place.rung:
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
                if place.wanted == place.rung and place.attendance.seat is Seat.SEATED:
                    self._core.clutches.engage(place.index)  # had it been about to change
            return
        lost = follow(word, [place.joint for place in self.all], control)
        if lost is not None:
            place = self._of[lost.peer.name]
            place.early = None
            self._event(place, Event.LOST, tick)

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

    def astray(self, joint: Joint, told: int, awaited: int) -> bool:
        """A signal of another tick: who is behind is told where the session is, if it may come again."""
        place = self._of[joint.peer.name]
        if told > awaited:
            return self._hear_ahead(place, told, awaited)
        if told == awaited - 1 and joint.tick == told:
            joint.send_again()  # it was answered, and the answer was lost
            return False
        if not self.seated:
            place.attendance.pardon()
        if self._event(place, Event.BEHIND, awaited):
            # not beyond the last tick: those who are seated may wait for a device that waits for this one
            place.due = min(awaited + LEAD, self.last - 1) if self.last else awaited + LEAD
        if place.attendance.seat is Seat.EXPECTED:
            joint.send_zero(Reaction, max(place.due, awaited) - 1)
        return False

    def aside(self, joint: Joint, message: Rung | Absent) -> bool:
        """A coupling has lost a device: it will be silent."""
        if isinstance(message, Absent):
            place = self._of[joint.peer.name]
            self._event(place, Event.PAUSES, self._tick)
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
        dues = [place.due for place in self.all if place.attendance.seat is Seat.EXPECTED]
        return tick if self.seated or self._resumes or not dues else max(tick, min(dues))

    def catch_up(self, tick: int) -> None:
        """A resumed environment goes on at ``tick``: who has said less is told so."""
        for place in self.all:
            if 0 <= place.joint.tick < tick:
                place.joint.send_zero(Reaction, tick - 1)

    def resumed(self) -> None:
        """From now on the ticks are the environment's."""
        self._resumes = False

    def _hear_ahead(self, place: Place, told: int, awaited: int) -> bool:
        """A signal of a later tick, from who was told to go on there: it is kept until then."""
        attendance = place.attendance
        if attendance.seat is Seat.SEATED or attendance.pauses(awaited) or told - awaited > MOST_AHEAD:
            return False
        self._event(place, Event.AHEAD, awaited)
        place.early, place.due = (told, place.joint.stray), told
        place.joint.gate.dropped["future_tick"] -= 1  # it was counted as a stray, and is none
        if self._resumes:
            self.ahead = max(self.ahead, told)
        return True

    def _seated(self, place: Place, tick: int) -> bool:
        """Whether its signal of ``tick`` seats it."""
        if place.attendance.seat is Seat.EXPECTED and tick < place.due:
            place.joint.tick = -1  # said before it heard that it is to go on later, as it does
            return False
        if place.attendance.pauses(tick):
            place.joint.tick = -1  # nobody waits for it; it says so again when the pause is over
            return False
        if self._event(place, Event.SIGNAL, tick) and place.wanted == place.rung:  # otherwise it changes its rung first
            self._core.clutches.engage(place.index)
        return True

    def _welcome_back(self, place: Place, tick: int) -> None:
        """It has shaken hands again: whether it is a new process, at the first rung, or the old one is all the same."""
        hello = place.joint.hello
        name = place.joint.peer.name
        if hello is None or feedthrough_digest(hello.feedthrough or ()) != self._digests.get(name):
            place.joint.lose()
            return
        self._event(place, Event.MET, tick)
        self._core.clutches.freeze(place.index)
        if place.rung or name not in self._feedthrough:
            self._feedthrough[name] = np.array(hello.feedthrough, dtype=np.float64)
            self._core.exchange(place.index, self._feedthrough[name])
            place.rung = 0
            self._shifting = place.wanted != 0 or self._shifting
        place.joint.send_zero(Reaction, tick - 1)

    def _first(self, place: Place) -> Values:
        """D_V of rung 0."""
        return self._feedthrough[place.joint.peer.name]

    def know(self, feedthrough: Mapping[str, Values], digests: Mapping[str, str]) -> None:
        """By coupling: D_V of rung 0 of those that have said it, and the digest by which each is known."""
        self._feedthrough, self._digests = dict(feedthrough), dict(digests)

    def _event(self, place: Place, event: Event, tick: int) -> bool:
        was_seated = place.attendance.seat is Seat.SEATED
        if not place.attendance.on(event, tick):
            return False
        if place.attendance.seat is Seat.SEATED:
            self.events.seat(tick, place.joint.peer.name)
        elif was_seated:
            self.events.freeze(tick, place.joint.peer.name)
        if self.log is not None and (noted := _NOTED.get(place.attendance.seat)) is not None:
            self.log.note(noted, peer=place.joint.peer.name, tick=tick, heard=event.value)
        if place.attendance.seat is not Seat.SEATED:
            self._core.clutches.freeze(place.index)
            place.joint.gate.forget()  # it is let in from where it is then
        self._sort()
        return True

    def _sort(self) -> None:
        self.seated = [place for place in self.all if place.attendance.seat is Seat.SEATED]
        self.all_seated = len(self.seated) == len(self.all)


_NOTED = {Seat.FROZEN: LogEvent.FROZEN, Seat.GONE: LogEvent.LOST, Seat.SEATED: LogEvent.RETURNED}

MOST_AHEAD = 2**16
"""Ticks by which a signal that is kept may be ahead: far more than pass between two telemetries.

By those a resumed environment begins.
"""

LEAD = 3
"""Ticks that a coupling is given to come back in: nobody waits for it in them.

More than a device waits for its force, with the first tick's own, and it would have let go again meanwhile.
"""
