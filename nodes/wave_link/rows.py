"""What the ends of wave links report of a tick: the parts of a :data:`manyhands.nodes.rows.two_port.Row`."""

from __future__ import annotations

from collections.abc import Sequence

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.link.join import WaveRow
from manyhands.nodes.rows.two_port import Row

_NONE: Floats = []


def user_row(end: WaveRow | None) -> Row:
    """The wave and the tank of a user's end; without numbers where there is no wave link."""
    return (_NONE, _NONE) if end is None else (end.c, end.tank)


def world_row(ends: Sequence[WaveRow]) -> Row:
    """Positions, forces, waves and tanks of all world's ends; the same links in every row."""
    return (
        [at for end in ends for at in end.p],
        [force for end in ends for force in end.f],
        [wave for end in ends for wave in end.c],
        [energy for end in ends for energy in end.tank],
    )
