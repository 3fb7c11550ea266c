"""A coupling block on its ladder, without its I/O: the two-port between devices and environment.

Its loop (:mod:`manyhands.nodes.coupling.block`), the simulation and the audit call it alike.
"""

from __future__ import annotations

from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import CouplingBundle
from manyhands.nodes.kernel.passivity import Ledger
from manyhands.nodes.rows.two_port import Row


class CouplingPort:
    """A :class:`manyhands.nodes.rows.two_port.TwoPort` from x to p, and from f_v to the force within the limits.

    Attributes:
        core: the block.
        rung: the present rung of the ladder.
        p: the free position of the last tick, m.
        f: the force of the last tick, within the limits, N.
    """

    def __init__(self, bundle: CouplingBundle) -> None:
        """At rest, at rung 0 of the ladder in ``bundle``."""
        of, self._rungs = bundle.rungs[0], bundle.rungs
        self.core = CouplingCore(of.block, of.K, of.level, bundle.common.period, bundle.limits.force)
        self.rung = 0
        self.p: Floats = [0.0] * len(bundle.common.ports)
        self.f: Floats = [0.0] * len(bundle.common.ports)

    @property
    def ledger(self) -> Ledger | None:
        """The block's energy ledger; None where no level is promised."""
        return self.core.ledger

    def up(self, x: Floats) -> Floats:
        """p(k), m, for the displacement x(k) of the devices, m."""
        self.p = p = self.core.free_position(x)
        return p

    def down(self, f: Floats) -> Floats:
        """The force that the devices receive, N, for f_v(k) of the environment, N; the list is kept."""
        self.f = held = self.core.limited(f)
        return held

    def change(self, rung: int) -> None:
        """Go on at ``rung``, at rest; call this between :meth:`down` and :meth:`book` of a tick without force."""
        of, self.rung = self._rungs[rung], rung
        self.core.change(of.block, of.K, of.level)

    def book(self) -> None:
        """Keep the ledger of the force, and step to the next tick."""
        self.core.absorb(self.f)

    def row(self) -> Row:
        """p, f_v and the ledger's total."""
        ledger = self.core.ledger
        return self.p, self.f, [] if ledger is None else [ledger.total]
