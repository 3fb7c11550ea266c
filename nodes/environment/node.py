"""The environment's process: it receives p of every coupling, and sends each coupling f_v of its own ports.

**What a tick waits for.** The forces of a tick need p of every active coupling
(:mod:`manyhands.nodes.environment.membership`), so it closes in one of three ways (:meth:`EnvironmentNode._gather`):

- All are active and in time: one receive for each, in the order in which they came of late, and nothing else.
- One is missing, or was away: the node listens to all of them in turn, until none that is awaited is missing.
  :mod:`manyhands.nodes.environment.deadline` decides how long that may last, and who is given up.
- None is awaited, for all that are active are there by wave links: the world's clock closes the tick
  (:mod:`manyhands.nodes.environment.pace`). What has come is read after the sleep, so that it counts in this tick.

**What the couplings wait for** is the answer, so it comes as early as it can. Once the forces are found, they are sent;
only then does the core step, and telemetry is written down. Who was late, and is held or not waited for any more, is
decided before the forces, for it changes them.

**Two instants** are kept from tick to tick. ``_due`` is when the devices sample the tick, from which lateness counts.
``_now`` is when the last signal was there; reading the clock once more would charge this node's own work to the
couplings.

:class:`EnvironmentTelemetry` writes down the positions of tools and masses and the ledger of each tick, as numbers at
once; they are sent once in ``telemetry_ticks`` ticks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from manyhands.nodes.environment.chatter import contact_tables
from manyhands.nodes.environment.core import Core, environment_core, respond, row_of
from manyhands.nodes.environment.deadline import Deadline, Step
from manyhands.nodes.environment.energy import energy_tables
from manyhands.nodes.environment.late_arrivals import AT_ONCE, CROSSING, LateArrivals, allowance
from manyhands.nodes.environment.membership import Member, Members, Membership
from manyhands.nodes.environment.pace import Pace
from manyhands.nodes.joins import establish
from manyhands.nodes.kernel.arithmetic import Floats, feedthrough_digest
from manyhands.nodes.kernel.bundle import REALTIME, Common, EnvironmentBundle
from manyhands.nodes.kernel.buttons import Buttons
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.kernel.realtime import way_giver
from manyhands.nodes.kernel.timeouts import LISTEN_TICKS, timeouts
from manyhands.nodes.link.join import Join, JoinKind, OwnEnd, Received, WaveRow, dropped_frames, stray_frames
from manyhands.nodes.link.peer_link import bounds_by_peer
from manyhands.nodes.link.supervisor_line import NOT_AT_ALL, ControlLine
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.lateness import CouplingLateness, lateness_tables
from manyhands.nodes.rows.tick_events import TickEvents
from manyhands.nodes.rows.two_port import RowBuffer
from manyhands.nodes.wave_link.faces import wave_feedthrough
from manyhands.nodes.wave_link.rows import world_row
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds
from manyhands.protocol.handshake import HandshakeRefused
from manyhands.protocol.messages import Figures, LinkHello, Reaction, Report, Role, Start, Telemetry, Values
from manyhands.protocol.transport import Link


class TelemetryLater:
    """Sends telemetry in the ticks after that in which it was made, a step in each.

    With 64 links all of it takes longer than one tick leaves.
    """

    def __init__(self, control: ControlLine) -> None:
        """Send over ``control``, the line to the supervisor."""
        self._control = control
        self._waiting: Telemetry | None = None
        self._frame: bytes | None = None

    def publish(self, telemetry: Telemetry) -> None:
        """Send ``telemetry`` with the next calls of :meth:`step`, and what was made before it now."""
        self.finish()
        self._waiting = telemetry

    def step(self) -> None:
        """Make the frame of what waits, or send the frame."""
        if self._frame is not None:
            frame, self._frame = self._frame, None
            self._control.post(frame)
        elif self._waiting is not None:
            telemetry, self._waiting = self._waiting, None
            self._frame = self._control.frame(telemetry)

    def finish(self) -> None:
        """Send all that waits."""
        self.step()
        self.step()


class EnvironmentTelemetry:
    """The traces of the environment.

    Attributes:
        ticks: the tick after the latest.
    """

    def __init__(self, common: Common, links: Sequence[str] = ()) -> None:
        """No row yet; ``links`` are the couplings with a wave link."""
        self._links = links
        self._rows = RowBuffer(Role.ENVIRONMENT, common.telemetry_first, common.telemetry_ticks)
        self._begun: list[tuple[int, str]] = []  # ticks and wave links of which a life began in them
        self.ticks = 0

    def tick(self, tick: int, core: Core, waves: Sequence[WaveRow] = ()) -> None:
        """Keep the row of ``tick``, which ``core`` has settled; ``waves`` are those of its wave links."""
        self._rows.add((*row_of(core), *world_row(waves)))
        if waves:
            for name, end in zip(self._links, waves, strict=True):
                if end.begins:
                    self._begun.append((tick, name))
        self.ticks = tick + 1

    @property
    def due(self) -> bool:
        """Whether the rows fill a telemetry message."""
        return self._rows.full

    def publish(
        self,
        control: ControlLine | TelemetryLater,
        core: Core,
        numbers: Mapping[str, float],
        tables: Mapping[str, Mapping[str, float]],
        late: Sequence[tuple[int, int]],
        events: TickEvents,
    ) -> bool:
        """Send the telemetry of the ticks since the last one; returns whether there were any.

        Args:
            control: the line to the supervisor, or what sends a tick later.
            core: the environment.
            numbers: of the telemetry's figures.
            tables: likewise.
            late: the ticks since the last telemetry in which a coupling was late, each with its place.
            events: what happened since the last telemetry.
        """
        rows = self._rows.filled
        if rows == 0:
            return False
        traces = {
            **self._rows.take(),
            **({names.WAITED_IN: np.array(late, dtype=np.float64)} if late else {}),
        }
        for tick, name in self._begun:
            events.link(tick, name)
        self._begun.clear()
        happened = events.take(self.ticks - rows, self.ticks)
        control.publish(Telemetry(self.ticks, Figures({**numbers, **happened}, tables), traces))
        return True


_TURN = from_seconds(0.001)  # the wait for one coupling where several are missing
_GOODBYE = from_seconds(0.05)  # several times as long as a coupling waits before it sends its signal again


class EnvironmentNode:
    """A :class:`manyhands.nodes.link.process.Node` for the shared environment.

    Attributes:
        joins: the links to the couplings, once every handshake is done.
        core: the environment's loop; None until every feedthrough D_V is known.
        members: the couplings with their membership; None until then.
    """

    def __init__(
        self,
        bundle: EnvironmentBundle,
        clock: Clock | None = None,
        await_links: Callable[[Sequence[Link], Duration], None] | None = None,
    ) -> None:
        """Take the environment's part of the session; :meth:`establish` makes the core, which needs D_V.

        Args:
            bundle: the environment's part of the session.
            clock: measures waiting times; by default it is the realtime clock.
            await_links: waits until any of some links has a frame, or a time is over; None where the transport cannot.
        """
        self._await_links = await_links
        self._bundle, self._common = bundle, bundle.common
        self._clock: Clock = clock or RealtimeClock()
        self._timeouts = timeouts(bundle.common)
        self._period = from_seconds(bundle.common.period)
        self._epoch = self._due = self._now = Instant(0)
        self.joins: list[Join] = []
        self._kinds: list[JoinKind] = []
        self._ends: list[Join] = []  # the joins that have rows of their own
        self._parties: tuple[str, ...] = ()
        self._feedthrough: dict[str, Values] = {}
        self.core: Core | None = None
        self.members: Members | None = None
        self._account = EnvironmentTelemetry(bundle.common, tuple(bundle.waves))
        self._frozen_ticks = 0
        self._clocked = False  # whether no tick waits for anybody, so that the clock alone paces them
        self._later: TelemetryLater | None = None  # there alone
        self._pace = Pace(Instant(0), self._period, Instant(0))
        self._p: Floats = [0.0] * bundle.common.width
        self._nothing_rides = [0.0] * (bundle.common.width - len(bundle.common.ports))
        self._buttons = Buttons(bundle.common.buttons, bundle.common.period)
        self._passed: tuple[Member, ...] = ()  # the member that did not come at its turn in this tick
        # without a covered delay no certificate can be lost by a longer allowance, so the period serves
        covered = from_seconds(bundle.longest_tau or bundle.common.period)
        self._late = LateArrivals(len(bundle.common.peers), self._period, allowance(self._period, covered))

    @property
    def by_itself(self) -> tuple[str, ...]:
        """Nothing: it is no device."""
        return ()

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with every coupling, and close the algebraic loop with their D_V.

        Raises:
            HandshakeRefused: the two ends disagree, or a coupling's D_V is not the one of the certificate.
            HandshakeTimeout: a coupling has not finished its handshake in time.
        """
        bundle, common = self._bundle, self._common
        bounds = bounds_by_peer(common, Role.COUPLING, bundle.tool_magnitude, bundle.tool_step)
        self.joins, self._kinds = establish(OwnEnd(common, self._clock, bounds, waves=bundle.waves), links)
        self._parties = tuple(join.peer.name for join in self.joins)
        self._ends = [join for join in self.joins if join.row is not None]
        self._clocked = bool(self.joins) and not any(join.waited_for for join in self.joins)
        m = len(common.ports)
        D_V = np.zeros((m, m))
        for join in self.joins:
            ports, wave = np.arange(m)[join.indices], bundle.waves.get(join.peer.name)
            if join.hello is not None:
                self._require_feedthrough(join.hello)
                own = self._feedthrough[join.peer.name] = np.array(join.hello.feedthrough)
            elif wave is not None:  # a seat that nobody has taken: the face here is what the world meets
                own = np.array(wave_feedthrough(wave.b, common.period))
            else:  # absent; its hello brings D_V when it comes
                continue
            D_V[np.ix_(ports, ports)] = own
        blocks = [join.indices for join in self.joins]
        self.core = environment_core(self._bundle, D_V, blocks)

    def _require_feedthrough(self, hello: LinkHello) -> None:
        found, expected = feedthrough_digest(hello.feedthrough or ()), self._bundle.feedthrough[hello.name]
        if found != expected:
            raise HandshakeRefused(
                f"{self._common.name} refused {hello.name}: found a feedthrough D_V with the digest {found[:16]}; "
                f"expected {expected[:16]}, that of the block in the certificate; start {hello.name} with the bundle "
                "that was cut for this session"
            )

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Run the ticks, paced by the couplings, until the session's last tick or the end of the node's life.

        Args:
            start: first tick, number of ticks and epoch.
            life: whether the node should still run.
            control: the line to the supervisor.

        Raises:
            ValueError: :meth:`establish` was not called before.
        """
        members, later = self._begin(start, life, control), self._later
        tick = self._run(members, start, life, control)
        self._publish(control, members)
        if later is not None:
            later.finish()
        if tick == start.ticks and not members.all_active:
            self._say_goodbye(members, tick)
        for kind in self._kinds:
            kind.close()

    def _begin(self, start: Start, life: Life, control: ControlLine) -> Members:
        """Take all couplings in. The first wait begins with the epoch: before it silence has no meaning."""
        core, bundle, resumes = self.core, self._bundle, start.tick > 0
        if core is None:
            raise ValueError("the environment was started before its handshakes")
        members = Members(self.joins, core, bundle.feedthrough_rungs, life, resumes, bundle.independent)
        if resumes:
            for join in self.joins:
                join.resume()
        else:
            members.begin(start.tick)
        members.last, members.log = start.ticks, control.log
        members.know(self._feedthrough, bundle.feedthrough)
        clock, lead = self._clock, CROSSING * self._period
        members.over = lambda: clock.now() > self._due - lead
        self.members, self._later = members, TelemetryLater(control) if self._clocked else None
        self._epoch = Instant(start.epoch)
        self._due = self._now = max(clock.now(), self._epoch)
        self._pace = Pace(self._epoch, self._period, self._now)
        return members

    def _run(self, members: Members, start: Start, life: Life, control: ControlLine) -> int:
        """Run the ticks; returns the one after the last."""
        core, account, late, p = members.core, self._account, self._late, self._p
        period, epoch, patience, give_way = self._period, self._epoch, self._timeouts.patience, way_giver()
        tick, answered, buttons = start.tick, Instant(2**62), self._buttons
        while not life.stopping and (start.ticks == 0 or tick < start.ticks):
            life.look(self._now)
            if tick % LISTEN_TICKS == 0 and (word := control.listen()) is not None:
                members.obey(word, control, tick)
            gathered = self._gather(members, tick, start.tick, life, control)
            if gathered is None:
                break
            tick, now = gathered, self._now
            if patience is not None:
                if now - self._due > late.allowance:  # otherwise no coupling was late
                    self._judge(members, tick, self._due - answered < CROSSING * period)
                if now - answered > patience:
                    members.let_in_again(tick)
                if members.waives or not members.all_active:
                    members.hold(tick, late.full)
            if buttons.names and (changed := buttons.take(tick, members.pressed)):
                for button, held_down in buttons.changes(changed):
                    members.events.press(tick, button, held_down)
                core.press(buttons.state)
            f = respond(core, p, tick)
            if self._nothing_rides:  # what rode with a signal is of its own tick alone
                p[-len(self._nothing_rides) :] = self._nothing_rides
            if core.failure is not None:
                life.fail(f"{self._common.name}: {core.failure}")
            members.shift()
            for member in members.active:
                member.join.send(Reaction, tick, member.join.stamp, f)
            answered = now
            self._due = Instant(now + (epoch - now) % period)  # the next multiple of T, at which devices sample
            give_way()  # ZeroMQ's thread sends the forces first; what does not depend on them is done after
            core.settle()
            self._frozen_ticks += members.anybody_out
            account.tick(tick, core, [row for end in self._ends if (row := end.finished(tick)) is not None])
            tick += 1
            if self._later is not None:
                self._later.step()
            if account.due:
                self._publish(control, members)
        return tick

    def _gather(self, members: Members, tick: int, first: int, life: Life, control: ControlLine) -> int | None:
        """Have the signals of a tick in ``_p``, m, and in ``_now`` the instant at which they were all there.

        Args:
            members: the couplings.
            tick: k.
            first: the tick with which this process began.
            life: whether the node should still run.
            control: the line to the supervisor.

        Returns:
            The tick whose signals are there: ``tick``, or a later one, as :meth:`_wait` finds it. None if the node
            should end.
        """
        clock, pace, p = self._clock, self._pace, self._p
        if not members.awaited and members.linked:
            clock.sleep_until(pace.due(clock.now()))
            self._read()
            for member in members.order:
                members.hear(member, p, tick, NOT_AT_ALL)
            members.resumed()
            self._now = self._due = clock.now()
            pace.begun(self._now)
            return tick
        self._read()
        if members.all_active and self._all_heard(members, tick):
            self._now = members.order[-1].arrived
            return tick
        found = self._wait(members, tick, life, control)
        self._passed = ()
        if found is None:
            return None
        if found != tick:
            self._publish(control, members)  # rows follow each other
            self._due = clock.now()
        if found > first:
            # a coupling that returns in this tick cannot be in time: the others waited, but it is not charged
            self._late.gone(found, [member.index for member in members.active if member.membership.since == found])
        self._now = clock.now()
        return found

    def _read(self) -> None:
        for kind in self._kinds:
            kind.read()

    def _say_goodbye(self, members: Members, tick: int) -> None:
        """Answer the frozen couplings after the last tick, for a short time, so that they end with the others.

        A frozen coupling sends its signal again and again until it is answered. The zero force of the last tick is the
        answer after which it ends; without it the coupling would wait for ticks that never come.
        """
        end = self._clock.now() + _GOODBYE
        behind = [
            member for member in members.all if member.membership.state is not Membership.ACTIVE and member.join.here
        ]
        for member in behind:
            member.join.send_zero(Reaction, tick - 1)
        while behind and self._clock.now() < end:
            for member in behind:
                members.hear(member, self._p, tick, _TURN)
                member.join.send_zero(Reaction, tick - 1)

    def _all_heard(self, members: Members, tick: int) -> bool:
        """Read the signals of an ordinary tick, one after the other; returns False at the first that does not come."""
        turn, clock, p = self._timeouts.turn, self._clock, self._p
        for member in members.order:
            if member.waived:
                if members.hear(member, p, tick, NOT_AT_ALL) is Received.SIGNAL:
                    member.arrived = clock.now()
            elif members.hear(member, p, tick, turn) is not Received.SIGNAL:
                self._pass_over(member, members, tick)
                return False
            member.arrived = clock.now()
        return True

    def _pass_over(self, absent: Member, members: Members, tick: int) -> None:
        """Read the members after ``absent`` at once, and read ``absent`` last from now on.

        A member read after it may have been there for as long as the node waited for ``absent``. So its signal counts
        as there since the one before ``absent`` was read. Where ``absent`` was the first to be read, the node cannot
        know how long the others have waited: then the tick counts as due only now.
        """
        at = members.order.index(absent)
        if at == 0:
            self._due = max(self._due, self._clock.now())
        since = members.order[at - 1].arrived if at else self._due
        for member in members.order[at + 1 :]:
            if members.hear(member, self._p, tick, NOT_AT_ALL) is Received.SIGNAL:
                member.arrived = since
        members.read_last(absent)
        self._passed = (absent,)

    def _judge(self, members: Members, tick: int, crossed: bool) -> None:
        """Charge the members that were late, freeze those that are late again and again, and read the latest last."""
        late = self._late
        arrivals = [
            (member.arrived, member.index)
            for member in members.order
            if member.membership.state is Membership.ACTIVE and not member.linked and member.join.tick == tick
        ]
        if not arrivals:
            return
        arrivals.sort(key=lambda arrival: arrival[0])  # stable: of equal instants the one that was read first is first
        for member in members.active:
            late.begin(member.index, member.membership.since)
        for index in late.judge(tick, self._due, crossed, arrivals):
            members.waive(members.all[index])
        # a signal that was read at once may have come at any time before, so such members keep their order
        least = AT_ONCE * self._period
        members.order.sort(key=lambda member: max(least, late.added[member.index]))

    def _wait(self, members: Members, tick: int, life: Life, control: ControlLine) -> int | None:
        """Wait until no awaited coupling is missing; listen to the others as well, and freeze those that stay silent.

        Each round looks who is missing, lets :mod:`manyhands.nodes.environment.deadline` decide, and acts on the
        decision. Every wait of a round is short: a message of the supervisor or a coupling that comes back may change
        in any round who is awaited, and even the tick.

        Args:
            members: the couplings.
            tick: k.
            life: whether the node should still run.
            control: the line to the supervisor.

        Returns:
            The tick for which every awaited coupling has sent its signal. It is later than ``tick`` where an
            environment resumes, or where no coupling was awaited before. None if the node should end.
        """
        deadline = Deadline(self._timeouts, self._period, self._due, self._now)
        awaited = set(self._passed)  # every member that this tick has waited for, those lost since included
        while not life.stopping:
            missing = [member for member in members.order if member.missing(tick)]
            present = any(member.join.tick == tick for member in members.all)
            awaited.update(missing)
            if deadline.complete(present, bool(missing)):
                self._late.gone(tick, [member.index for member in awaited if member.join.tick != tick])
                members.resumed()
                return tick
            now = self._clock.now()
            soonest = tick if present else members.soonest(tick)
            decision = deadline.decide(now, present, bool(missing), soonest != tick, members.anybody_early)
            if decision.forget:
                members.forget()
            if decision.pardon:
                members.pardon()
            match decision.step:
                case Step.MOVE:
                    tick = soonest
                    awaited.clear()
                case Step.GIVE_UP:
                    self._late.missed(tick, [member.index for member in missing], decision.waited)
                    for member in missing:
                        members.overdue(member, tick)
                case Step.LISTEN:
                    life.look(now)
                    while (word := control.listen()) is not None:
                        members.obey(word, control, tick)
                    anybody = self._listen(members, tick, missing, now if present else None)
                    deadline.listened = True
                    if anybody and members.ahead > tick:
                        # a resumed environment began at the last telemetry; its couplings are further on, and are right
                        tick = members.ahead
                        deadline.restart(now)
                        awaited.clear()
                        members.catch_up(tick)
                    elif not (anybody or present):  # no peer is left: only the supervisor can report that one is back
                        word = control.listen(self._timeouts.look)
                        if word is not None:
                            members.obey(word, control, tick)
        return None

    def _listen(self, members: Members, tick: int, missing: Sequence[Member], since: Instant | None) -> bool:
        """Listen once to every coupling whose signal of ``tick`` is not there, to the missing ones first.

        Where the transport can wait for all links, it does. Otherwise only the first coupling is waited for, and by the
        end of that wait the signals of the others can be read at once.

        Args:
            members: the couplings.
            tick: k.
            missing: the couplings that are waited for.
            since: the present time where the signal of any coupling is there; None where none is.

        Returns:
            Whether there was any coupling to listen to.
        """
        turn, anybody = _TURN if missing or since is None else NOT_AT_ALL, False
        if turn and self._await_links is not None:
            # a coupling that is held is answered as soon as its signal is there, whoever is waited for
            open_ = [member.join.link for member in members.all if member.join.tick != tick]
            self._await_links([link for link in open_ if link is not None], turn)
            turn = NOT_AT_ALL
        for member in (*missing, *members.all):
            join = member.join
            if not join.reachable or (join.tick == tick and join.here):
                continue  # nothing to read; but a coupling that was lost after its signal may be shaking hands anew
            if members.hear(member, self._p, tick, turn) is Received.SIGNAL:
                # a signal read after the wait for a different coupling counts as there since that wait began
                member.arrived = since if since is not None and turn == NOT_AT_ALL else self._clock.now()
            turn, anybody = NOT_AT_ALL, True
            if members.ahead > tick:
                break
        return anybody

    def report(self) -> Report:
        """Ticks, ledger, how often couplings were frozen, and how long each made the others wait."""
        members = self.members
        numbers = {
            names.FROZEN_TICKS: float(self._frozen_ticks),
            names.ABSENCES: 0.0 if members is None else float(members.absences),
            **self._late_ticks(),
            **self._numbers(),
        }
        tables = {**self._tables(members), names.DROPPED: dropped_frames(self.joins)}
        return Report(self._account.ticks, Figures(numbers, tables))

    def _late_ticks(self) -> dict[str, float]:
        """The late ticks of a world whose users are all behind wave links; elsewhere the devices count them."""
        return {names.LATE: float(self._pace.late)} if self._clocked else {}

    def _lateness(self, members: Members | None) -> dict[str, CouplingLateness]:
        """The lateness of each coupling that made the others wait, by its name."""
        late, all_ = self._late, () if members is None else members.all
        return {
            member.join.peer.name: CouplingLateness(
                late.ticks[member.index],
                late.waited[member.index] / 1e3,
                member.frozen_late,
                member.held,
                member.waivers,
            )
            for member in all_
            if late.ticks[member.index] or member.held
        }

    def _numbers(self) -> dict[str, float]:
        """What telemetry and report have alike."""
        core = self.core
        if core is None:
            return {}
        unowned = {names.UNOWNED: core.energy.unowned} if core.energy.unowned else {}
        ledger, controller = names.ledger_figures(core.ledger), names.enforcement_figures(core.controller)
        return {**ledger, **controller, **core.figures, **unowned}

    def _tables(self, members: Members | None) -> dict[str, dict[str, float]]:
        """Likewise, what has a number for each coupling; tables without any are left out."""
        found: dict[str, dict[str, float]] = lateness_tables(self._lateness(members))
        for join in self.joins:
            for name, value in join.figures().items():
                found.setdefault(names.of(name), {})[join.peer.name] = value
        if (core := self.core) is not None:
            found |= contact_tables(core.held, core.chatter, self._parties)
            found |= energy_tables(core.energy, self._parties)
        return {name: table for name, table in found.items() if table}

    def _publish(self, control: ControlLine, members: Members) -> None:
        numbers = {
            names.FROZEN: float(members.frozen),
            names.FROZEN_TICKS: float(self._frozen_ticks),
            **self._late_ticks(),
            **({names.ELAPSED: (self._now - self._epoch) / 1e3} if self._common.clock == REALTIME else {}),
            **({names.CHANGING: float(members.changing)} if members.changing else {}),
            **self._numbers(),
            **stray_frames(self.joins),
        }
        rungs = {member.join.peer.name: float(member.rung) for member in members.all if member.rung}
        tables = {**self._tables(members), **({names.of(names.RUNG): rungs} if rungs else {})}
        late = [(tick, member.index) for member in members.all for tick in self._late.lately[member.index]]
        if self._account.publish(self._later or control, members.core, numbers, tables, late, members.events):
            for member in members.all:
                self._late.lately[member.index].clear()
