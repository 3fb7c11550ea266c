"""Computes a recorded coupling block again, by its own core, from the signals of its devices and the environment.

The state xi follows from the forces that the block handed on, and p follows from xi and the devices' displacement, to
the last bit. A process that came back begins at rest. So does a block that has changed its rung, at a tick without
force. Both are recorded as events, with their ticks (:mod:`manyhands.launch.audit.events`).

A device that runs free samples anew for the same tick, and records the last sample, while p is computed from the first.
So in a row after free periods, and in the first row after a gap, p may differ; such rows are listed as unchecked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import Happening
from manyhands.launch.audit.findings import UncheckedTicks, gaps_of
from manyhands.launch.audit.recompute import Array, FollowedParty
from manyhands.launch.recordings.run import there
from manyhands.nodes.coupling.port import CouplingPort
from manyhands.nodes.kernel.bundle import CouplingBundle
from manyhands.nodes.rows.figures import FREE_POSITION, LEDGER

_SAID_BEFORE: Final = "a device of it had sampled again after p was computed: p is not checked"


class FollowedCoupling(FollowedParty):
    """The p and the ledger of a coupling block, from the displacements and the forces of its ports."""

    def __init__(
        self, bundle: CouplingBundle, x: Array, p: Array, f: Array, resampled: NDArray[np.bool_] | None = None
    ) -> None:
        """Take what was recorded.

        Args:
            bundle: the coupling's part of the session.
            x: by its devices, ticks x ports, m; NaN where one of them has no row.
            p: ticks x ports, m; used only to see whether a device had sampled again.
            f: the force that was handed on, ticks x ports, N.
            resampled: the ticks in which the coupling or a device of it may have been elsewhere when it sent its
                signal than its row states; None for none.
        """
        self._bundle, self._x, self._p, self._f, self._sampled = bundle, x, p, f, there(x)
        self.ticks, ports = p.shape
        self._resampled = np.zeros(self.ticks, dtype=np.bool_) if resampled is None else resampled
        self._excused = np.zeros(self.ticks, dtype=np.bool_)
        self.rows = np.flatnonzero(there(p) & there(f)).tolist()
        self.fields = {FREE_POSITION: ports, LEDGER: 1}

    @property
    def excused(self) -> list[UncheckedTicks]:
        """The ticks whose p is not that of the recorded displacement, since a device had sampled again."""
        return gaps_of(self._excused, _SAID_BEFORE)

    def begin(self, joins: bool) -> None:
        """The block begins at rest, at rung 0."""
        self._port = CouplingPort(self._bundle)

    def change(self, rung: int) -> None:
        """The block goes on at another rung, at rest."""
        self._port.change(rung)

    def row(self, k: int, happened: Happening, rung: int | None) -> Mapping[str, Sequence[float]]:
        """p(k) and the ledger."""
        port, out = self._port, dict[str, Sequence[float]]()
        if self._sampled[k]:
            p = port.up(self._x[k].tolist())
            self._excused[k] = self._resampled[k] and p != self._p[k].tolist()
            if not self._excused[k]:
                out[FREE_POSITION] = p
        if rung is not None:
            port.change(rung)
        port.f = self._f[k].tolist()  # as it was handed on, within the limits or not
        port.book()
        if port.ledger is not None:
            out[LEDGER] = [port.ledger.total]
        return out
