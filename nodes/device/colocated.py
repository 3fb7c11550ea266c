"""A device and the couplings of its own ports in one process (Remark 2 of [Bianchini2010]_): two messages less a tick.

Each stays a node of its own, with its own bundle, keys, line to the supervisor, ledger and report; only the link
between them falls away. The device's loop runs the couplings as well. Where it would send x(k) to a coupling's process
and wait for f_v(k), a :class:`Within` makes the block send p(k) to the environment and waits for the answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from manyhands.nodes.coupling.block import Block
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import CouplingBundle, DeviceBundle, Peer, load
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.link.join import Join, Listener, Received, positions
from manyhands.nodes.link.peer_link import establish, hello_to
from manyhands.nodes.link.process import Node
from manyhands.nodes.link.relink import follow
from manyhands.nodes.link.supervisor_line import ControlLine
from manyhands.nodes.wave_link.ends import user_ends
from manyhands.protocol.clock import Clock, Duration, RealtimeClock
from manyhands.protocol.messages import Figures, Reaction, Report, Role, Rung, SignalMessage, Start
from manyhands.protocol.transport import Link


class CarriedBlock:
    """A :class:`manyhands.nodes.link.process.Node` for a coupling that runs in the loop of its device."""

    def __init__(self, bundle: CouplingBundle, clock: Clock | None = None) -> None:
        """Take the coupling's part of the session; :meth:`establish` makes the block.

        ``clock`` measures waiting times; by default it is the realtime clock.
        """
        self.bundle = bundle
        self.clock: Clock = clock or RealtimeClock()
        self.control: ControlLine | None = None
        self.block: Block | None = None

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with the environment, which receives D_V."""
        admits: dict[str, type[SignalMessage]] = {peer.name: Reaction for peer in self.bundle.common.peers}
        D_V, ends = self.bundle.block.D, user_ends(self.bundle, self.clock)
        (environment,), _ = establish(self.bundle.common, links, admits, self.clock, D_V, ends=ends)
        self.block = Block(self.bundle, environment)

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Begin, and return: the device's loop runs the ticks. ``control`` is the coupling's own line.

        Raises:
            ValueError: :meth:`establish` was not called before.
        """
        if self.block is None:
            raise ValueError("the coupling was started before its handshake")
        self.control = control
        if start.tick > 0:
            self.block.environment.resume()
        self.block.begin(life)

    def listen(self) -> None:
        """Follow the supervisor's messages to this coupling."""
        if self.block is None or self.control is None:
            return
        while (word := self.control.listen()) is not None:
            follow(word, [self.block.environment], self.control)

    def publish_rest(self) -> None:
        """Send the telemetry of the ticks since the last one; the loop is over, or goes on at a later tick."""
        if self.block is not None and self.control is not None:
            self.block.publish_rest(self.control)

    def report(self) -> Report:
        """Ticks, ledger, clipped and refused signals of the block; all 0 before the handshake."""
        return Report(0, Figures()) if self.block is None else self.block.report()


class Within(Join):
    """The device's link to a coupling in the same process: it calls the coupling's block in place of messages."""

    def __init__(self, carried: CarriedBlock, device: DeviceBundle, block: Block) -> None:
        """Join a device to ``block``, at those of its ports that the block couples."""
        common = device.common
        peer = Peer(carried.bundle.common.name, Role.COUPLING, carried.bundle.common.ports, binds=False)
        where = positions(common.ports, peer.ports)
        super().__init__(hello_to(common, peer, None), peer, None, where, carried.clock)
        self._carried, self._block = carried, block

    @property
    def dropped(self) -> Mapping[str, int]:
        """Nothing: there are no frames."""
        return {}

    @property
    def reachable(self) -> bool:
        """Whether there is a link to the environment, without which the block has no answer."""
        return self._block.environment.reachable

    def send(self, kind: type[SignalMessage], tick: int, stamp: int, values: Floats) -> bool:
        """Make the block send p(k) for x(k); a second call for the same tick sends the same p(k) again."""
        if tick == self._block.sent:
            self._block.send_again(tick)
        else:
            self._block.send(self.share(values), tick, stamp)
        return True

    def send_again(self) -> None:
        """Send the last p again."""
        self._block.send_again(self._block.sent)

    def hear(self, values: Floats, tick: int, timeout: Duration, listener: Listener) -> Received:
        """Listen for the environment's answer, and put the block's force into the device's ``values``."""
        result = self._block.hear(tick, timeout)
        if result is Received.SIGNAL or result is Received.DECLINED:
            self.put(values, self._block.applied)
            rung = self._block.climb(tick if result is Received.SIGNAL else self._block.environment.other_tick)
            if rung is not None:
                listener.on_notice(self, Rung(rung))
        if result is Received.SIGNAL:
            self.tick = tick
        elif result is Received.DECLINED:
            self.other_tick, self.other_zero = self._block.environment.other_tick, True
        return result

    def take_other(self, values: Floats, counted: str) -> bool:
        """Do nothing: :meth:`hear` has put the block's force into the values."""
        return True

    def _begin_life(self) -> None:
        """Do nothing: the block lives as long as its device."""

    def settle(self, tick: int) -> None:
        """Step the block once the force is applied, and send its telemetry when the rows are full."""
        self._block.settle(tick)
        if self._carried.control is not None:
            self._block.publish(self._carried.control)


class ColocatedNode(DeviceNode):
    """A device with couplings in the same process."""

    def __init__(
        self, bundle: DeviceBundle, driver: Driver, carried: Sequence[CarriedBlock], clock: Clock | None = None
    ) -> None:
        """The couplings ``carried`` must shake hands before the device does; ``clock`` is as for a device."""
        super().__init__(bundle, driver, clock)
        self._bundle, self._carried = bundle, tuple(carried)

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with the couplings in other processes, and join those in this process."""
        super().establish(links)
        for carried in self._carried:
            if carried.block is not None:
                self.joins.append(Within(carried, self._bundle, carried.block))

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Run the device's loop, and send the couplings' last telemetry after it."""
        try:
            super().loop(start, life, control)
        finally:
            for carried in self._carried:
                carried.publish_rest()

    def _jump(self, control: ControlLine) -> None:
        super()._jump(control)
        for carried in self._carried:
            carried.publish_rest()  # rows follow each other

    def _listen(self, control: ControlLine, idle: bool = False) -> None:
        super()._listen(control, idle)
        for carried in self._carried:
            carried.listen()


def colocated(
    device: DeviceBundle, driver: Driver, couplings: Sequence[Path]
) -> list[tuple[DeviceBundle | CouplingBundle, Node]]:
    """The nodes of a process with their bundles: the device, then its couplings.

    Args:
        device: the bundle of the device.
        driver: the device itself.
        couplings: the bundles of the couplings, in the order of the session.

    Raises:
        BundleError: a coupling's bundle cannot be read.
    """
    carried = [CarriedBlock(load(path, CouplingBundle)) for path in couplings]
    node = ColocatedNode(device, driver, carried)
    return [(device, node), *((one.bundle, one) for one in carried)]
