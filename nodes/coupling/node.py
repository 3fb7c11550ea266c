"""The coupling block's process, between its devices and the environment.

It receives x of its own ports from the devices and sends p to the environment. It then receives f_v of its own ports
and sends it to the devices. It keeps no time of its own: the devices pace it. Where the environment has gone on without
this coupling, it sends the force of a later tick: zero, or what the spring exerts from a tool at rest. The coupling
sends that force to its devices, and goes on at the tick after.

A coupling in its device's process has no loop of its own: the device's runs its block
(:class:`manyhands.nodes.coupling.within.Within`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from manyhands.nodes.coupling.block import Block
from manyhands.nodes.coupling.within import Within
from manyhands.nodes.joins import establish
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import CouplingBundle, Peer
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.kernel.realtime import way_giver
from manyhands.nodes.kernel.timeouts import LISTEN_TICKS, timeouts
from manyhands.nodes.link.join import Join, OwnEnd, Received, await_all
from manyhands.nodes.link.peer_link import bounds_by_peer
from manyhands.nodes.link.relink import follow
from manyhands.nodes.link.repeats import Repeats
from manyhands.nodes.link.supervisor_line import NOT_AT_ALL, ControlLine, Word
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock
from manyhands.protocol.messages import Absent, Figures, Force, Report, Role, Rung, Start
from manyhands.protocol.transport import Link


class CouplingNode:
    """A :class:`manyhands.nodes.link.process.Node` for one block of V, and the :class:`Listener` on its devices' links.

    Attributes:
        joins: the links to the devices and the environment, once every handshake is done.
    """

    def __init__(self, bundle: CouplingBundle, clock: Clock | None = None) -> None:
        """Take the coupling's part of the session; :meth:`establish` makes the block.

        ``clock`` measures waiting times; by default it is the realtime clock.
        """
        self._bundle, self._common = bundle, bundle.common
        self._clock: Clock = clock or RealtimeClock()
        self._timeouts = timeouts(bundle.common)
        self.joins: list[Join] = []
        self._devices: tuple[Join, ...] = ()
        self._block: Block | None = None
        self._within: Within | None = None  # the join from a node whose loop runs this one's ticks
        self._life: Life | None = None  # until the loop begins
        self._resumes = False  # whether the session ran before this process, whose first tick may be behind or ahead
        self._nothing: Floats = [0.0] * bundle.common.width  # takes the values of links that only shake hands

    @property
    def by_itself(self) -> tuple[str, ...]:
        """Nothing: it is no device."""
        return ()

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with the block's devices and with the environment, which receives D_V."""
        bundle, common, limits = self._bundle, self._common, self._bundle.limits
        step = [common.period * speed for speed in limits.speed]
        bounds = bounds_by_peer(common, Role.DEVICE, limits.displacement, step)
        worlds = [peer.name for peer in common.peers if peer.role is Role.ENVIRONMENT]
        waves = {} if bundle.wave is None else dict.fromkeys(worlds, bundle.wave)
        self.joins, _ = establish(OwnEnd(common, self._clock, bounds, bundle.block.D, waves), links)
        self._devices = tuple(j for j in self.joins if j.peer.role is Role.DEVICE)
        (environment,) = (j for j in self.joins if j.peer.role is Role.ENVIRONMENT)
        self._block = Block(bundle, environment)

    @property
    def as_peer(self) -> Peer:
        """This node, as a device in the same process is joined to it."""
        common = self._common
        buttons = (0, len(common.buttons))
        return Peer(common.name, Role.COUPLING, common.ports, binds=False, buttons=buttons, riding=common.riding)

    def join_from(self, own: OwnEnd) -> Within:
        """Join this node to a device in the same process, whose loop runs the block's ticks from then on.

        Raises:
            ValueError: :meth:`establish` was not called before.
        """
        if self._block is None:
            raise ValueError("the coupling was joined to its device before its handshake")
        self._within = Within(own, self.as_peer, self._block)
        return self._within

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Run the ticks, paced by the devices' samples; begin and return where a device in this process runs them.

        Args:
            start: first tick, number of ticks and epoch.
            life: whether the node should still run.
            control: the line to the supervisor.

        Raises:
            ValueError: :meth:`establish` was not called before.
        """
        block = self._block
        if block is None:
            raise ValueError("the coupling was started before its handshakes")
        self._life = life
        block.begin(life)
        self._resumes = start.tick > 0
        if self._resumes:
            block.environment.resume()
        if self._within is not None:
            self._within.control = control
        else:
            self._run(block, start, life, control)

    def _run(self, block: Block, start: Start, life: Life, control: ControlLine) -> None:
        devices, x = self._devices, [0.0] * self._common.width
        clock, turn, give_way = self._clock, self._timeouts.turn, way_giver()
        tick = start.tick
        while not life.stopping and (start.ticks == 0 or tick < start.ticks):
            life.look(clock.now())
            if tick % LISTEN_TICKS == 0 and (word := control.listen()) is not None:
                self._obey(word, block, control)
            sampled: int | None = tick
            for join in devices:
                received = join.hear(x, tick, turn, self)
                if received is not Received.SIGNAL:
                    sampled = self._await_samples(join, received, x, tick, block, life, control)
                    break
            if sampled is None:
                break
            tick = sampled
            stamp = devices[0].stamp
            pressed = 0
            for join in devices:
                pressed |= join.pressed
            block.send(x, tick, stamp, pressed)
            received = block.hear(tick, turn)
            if received is not Received.SIGNAL:
                answered = self._await_reaction(received, tick, block, life, control)
                if answered is None:
                    break
                if answered > tick:
                    self._forget()
                    block.publish_rest(control, devices)  # rows follow each other
                    tick = answered
            rung = block.climb(tick)
            for join in devices:
                if rung is not None:
                    join.notify(Rung(rung))
                join.send(Force, tick, stamp, block.applied)
            give_way()
            block.settle(tick)
            self._resumes = False
            for join in devices:
                # a device that came back after its sample was read has sent no signal on the new link yet
                join.new = join.new and join.tick < 0
            tick += 1
            block.publish(control, devices)
        block.publish_rest(control, devices)

    def report(self) -> Report:
        """Ticks, ledger, clipped and refused signals of the block; all 0 before the handshakes."""
        return Report(0, Figures()) if self._block is None else self._block.report(self._devices)

    def on_other_tick(self, join: Join, other: int, awaited: int) -> bool:
        """Handle the sample of a different tick.

        A device that is behind receives its last force again, or a zero force that sends it on. A device that is ahead
        is followed only where this coupling resumes or the device came back: then the device's tick is the true one.
        """
        if other > awaited:
            return self._resumes or join.new
        if other == awaited - 1 and join.tick == other:  # this process has answered it, and the answer was lost
            join.send_again()
        else:
            join.send_zero(Force, awaited - 1)
        return False

    def on_notice(self, join: Join, message: Rung | Absent) -> bool:
        """Follow a device of several blocks to a later tick, where a different block has sent it on."""
        join.new = join.new or isinstance(message, Absent)
        return False

    def flooded(self, text: str) -> None:
        """End the node: a device floods its link, and its samples cannot be found among other frames in time."""
        if self._life is not None:
            self._life.fail(text)

    def _await_samples(
        self, last: Join, received: Received, x: Floats, tick: int, block: Block, life: Life, control: ControlLine
    ) -> int | None:
        """Wait for the sample of every device, after listening to ``last`` gave ``received`` in place of its sample.

        The wait has no end of its own: without its devices a coupling has nothing to send. The environment freezes the
        coupling meanwhile. What must go on in every round is the handshake with an environment that comes back, for it
        may be what the devices wait for.

        Returns:
            The tick of the samples; for a coupling that resumes it is that of the devices. None if the node should end.
        """
        began = self._clock.now()

        def react(join: Join, received: Received, tick: int) -> int:
            # the device's tick is the true one: no device will ever send the tick that was awaited
            if received is Received.DECLINED:
                if block.environment.tick == tick - 1:  # the environment awaits this block's ticks in between
                    block.environment.notify(Absent(join.peer.name))
                self._forget()
                block.publish_rest(control, self._devices)  # rows follow each other
                for other in self._devices:
                    if other.tick == tick:
                        other.send_zero(Force, join.other_tick - 1)
                tick = join.other_tick
                join.take(join.other_frame, x, tick)
            elif received is Received.RECONNECTED:
                join.send_zero(Force, tick - 1)
            return tick

        def pause(tick: int) -> Duration | None:
            self._forget_after(began)
            self._pause(block, life, control, idle=not any(join.link for join in self._devices))
            if block.environment.handshake is not None and block.hear(tick, NOT_AT_ALL) is Received.RECONNECTED:
                # report every device without a sample as absent, even one that is connected: it may wait for a
                # different block, which waits for this environment in turn, and no sample would ever come
                self._report_absences(block, [join for join in self._devices if join.tick == tick])
            return None if life.stopping else self._timeouts.look

        found = await_all(self._devices, last, x, react(last, received, tick), self, react, pause)
        return None if life.stopping else found

    def _await_reaction(
        self, received: Received, tick: int, block: Block, life: Life, control: ControlLine
    ) -> int | None:
        """Wait for the environment's answer, and send p again after a while without one.

        The signal or its answer may have been lost, and only a repeated signal shows the environment that this coupling
        is behind. Devices that come back are greeted in every round: the environment may wait for exactly them.

        Args:
            received: the outcome of listening to the environment so far.
            tick: k.
            block: the block.
            life: whether the node should still run.
            control: the line to the supervisor.

        Returns:
            The tick answered: ``tick``, or a later one. None if the node should end.
        """
        began = self._clock.now()
        repeats = Repeats(self._timeouts.again, began)
        while True:
            self._forget_after(began)
            if received is Received.SIGNAL:
                return tick
            if received is Received.DECLINED:
                return block.environment.other_tick
            if received is Received.RECONNECTED:
                self._report_absences(block, [join for join in self._devices if join.here])
            for join in self._devices:
                if join.handshake is not None:
                    join.hear(self._nothing, tick, NOT_AT_ALL, self)
            self._pause(block, life, control, idle=block.environment.link is None)
            if life.stopping:
                return None
            if repeats.due(self._clock.now()):
                block.send_again(tick)
            received = block.hear(tick, self._timeouts.look)

    def _forget_after(self, began: Instant) -> None:
        """Forget the last samples after a wait in which the devices have let go, and have moved without signals."""
        if self._timeouts.stale is not None and self._clock.now() - began > self._timeouts.stale:
            self._forget()

    def _forget(self) -> None:
        """Take the next samples as first ones, without a bound on their step: the block joins from there by a ramp."""
        for join in self._devices:
            join.forget()

    def _report_absences(self, block: Block, present: Collection[Join]) -> None:
        """Report to an environment that is back which devices are missing; it would wait for their samples."""
        for join in self._devices:
            if join not in present:
                block.environment.notify(Absent(join.peer.name))

    def _pause(self, block: Block, life: Life, control: ControlLine, idle: bool) -> None:
        """After a wait without a signal: check the node's life and follow the supervisor's messages.

        Where ``idle``, no peer is connected, and the wait for the supervisor replaces the wait for a peer.
        """
        life.check()
        word = control.listen(self._timeouts.look) if idle else control.listen()
        while word is not None:
            self._obey(word, block, control)
            word = control.listen()

    def _obey(self, word: Word, block: Block, control: ControlLine) -> None:
        lost = follow(word, [*self._devices, block.environment], control)
        if lost in self._devices:
            block.environment.notify(Absent(lost.peer.name))
