"""A device's join to a coupling in its own process (Remark 2 of [Bianchini2010]_): two messages less a tick.

Each stays a node of its own, with its own bundle, keys, line to the supervisor, ledger and report; only the link
between them falls away. The device's loop runs the ticks of both. Where it would send x(k) and wait for f_v(k), a
:class:`Within` makes the block send p(k) to the environment and waits for the answer.
"""

from __future__ import annotations

from collections.abc import Mapping

from manyhands.nodes.coupling.block import Block
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import Peer
from manyhands.nodes.link.join import Join, Listener, OwnEnd, Received, positions
from manyhands.nodes.link.peer_link import hello_to
from manyhands.nodes.link.relink import follow
from manyhands.nodes.link.supervisor_line import ControlLine
from manyhands.protocol.clock import Duration
from manyhands.protocol.messages import Rung, SignalMessage


class Within(Join):
    """The device's link to a coupling in the same process: it calls the coupling's block in place of messages.

    Attributes:
        control: the coupling's line to the supervisor; None before the coupling's loop begins.
    """

    def __init__(self, own: OwnEnd, peer: Peer, block: Block) -> None:
        """Join the device whose end is ``own`` to the ``block`` of ``peer``, at those of its ports that it couples."""
        where = positions(own.common.ports, peer.ports)
        riders = own.common.riders(peer.riding)
        super().__init__(hello_to(own.common, peer, None), peer, None, where, own.clock, riders)
        self._block = block
        self.control: ControlLine | None = None

    @property
    def dropped(self) -> Mapping[str, int]:
        """Nothing: there are no frames."""
        return {}

    @property
    def reachable(self) -> bool:
        """Whether there is a link to the environment, without which the block has no answer."""
        return self._block.environment.reachable

    def send(self, kind: type[SignalMessage], tick: int, stamp: int, values: Floats, pressed: int = 0) -> bool:
        """Make the block send p(k) for x(k); a second call for the same tick sends the same p(k) again."""
        if tick == self._block.sent:
            self._block.send_again(tick)
        else:
            self._block.send(self.share(values), tick, stamp, self.share_of_buttons(pressed))
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

    def settle(self, tick: int) -> None:
        """Step the block once the force is applied, and send its telemetry when the rows are full."""
        self._block.settle(tick)
        if self.control is not None:
            self._block.publish(self.control)

    def listen(self) -> None:
        """Follow the supervisor's messages to the coupling."""
        if self.control is not None:
            while (word := self.control.listen()) is not None:
                follow(word, [self._block.environment], self.control)

    def publish_rest(self) -> None:
        """Send the coupling's telemetry of the ticks since the last one."""
        if self.control is not None:
            self._block.publish_rest(self.control)

    def _begin_life(self) -> None:
        """Do nothing: the block lives as long as its device."""
