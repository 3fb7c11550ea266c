"""Forgeries of a recording: numbers and rows are changed, and a recorder writes the file with right checksums."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from manyhands.launch.recordings.run import RecordedRun
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Figures, Observation

from .simulated_recordings import START

FROM = 51
"""The tick from which on most forgeries change numbers."""


@dataclass
class Forged:
    """The content of a recording while it is changed.

    Attributes:
        rows: by node and trace, ticks x columns.
        figures: by node, tick and figures of each telemetry message.
        gone: by node, the ticks whose rows the file does not have.
    """

    rows: dict[tuple[str, str], np.ndarray]
    figures: dict[str, list[tuple[int, Figures]]]
    gone: dict[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def of(cls, run: RecordedRun) -> Forged:
        """What a recording holds; nothing is changed yet."""
        rows = {(node, trace.topic.trace): trace.values.copy() for (node, _), trace in run.traces.items()}
        figures = {node: [*told] for node, told in run.figures.items()}
        gone = {
            node: ~np.any([np.isfinite(values).any(axis=1) for (of, _), values in rows.items() if of == node], axis=0)
            for node in run.recorded.roles
        }
        return cls(rows, figures, gone)

    def write(self, path: Path, run: RecordedRun) -> Path:
        """Write the file, in telemetry messages of the same ticks."""
        core = RecorderCore(run.recorded, run.attachments, START)
        for node, told in self.figures.items():
            traces = {trace: values for (of, trace), values in self.rows.items() if of == node}
            begin = 0
            for tick, figures in told:
                here = np.arange(begin, tick)[~self.gone[node][begin:tick]]
                pieces = [ticks for ticks in np.split(here, np.flatnonzero(np.diff(here) != 1) + 1) if len(ticks)]
                for ticks in pieces[:-1]:
                    own = {trace: values[ticks] for trace, values in traces.items()}
                    core.take(encode(Observation(node, int(ticks[-1]) + 1, Figures(), own)), START)
                own = {trace: values[pieces[-1]] for trace, values in traces.items()} if pieces else {}
                core.take(encode(Observation(node, int(pieces[-1][-1]) + 1 if pieces else tick, figures, own)), START)
                begin = tick
        assert core.refused == 0
        path.write_bytes(core.cut() + core.end())
        return path


Deed = Callable[[Forged], None]


def put(value: float, *keys: tuple[str, str], begin: int = FROM, end: int | None = None) -> Deed:
    """Every number of these traces becomes ``value``."""

    def deed(forged: Forged) -> None:
        for key in keys:
            forged.rows[key][begin:end] = value

    return deed


def everything(value: float, begin: int) -> Deed:
    """Every number of every trace becomes ``value``."""

    def deed(forged: Forged) -> None:
        for values in forged.rows.values():
            values[begin:] = value

    return deed


def lose(*nodes: str, begin: int = FROM, end: int | None = None, **events: float) -> Deed:
    """Rows are gone; ``events`` are figures of the first node that excuse it, with ``_at_`` in place of ``@``."""

    def deed(forged: Forged) -> None:
        for node in nodes or forged.gone:
            forged.gone[node][begin:end] = True
        if events:
            tick, figures = forged.figures[nodes[0]][-1]
            happened = {name.replace("_at_", "@"): value for name, value in events.items()}
            forged.figures[nodes[0]][-1] = tick, figures.with_numbers(happened)

    return deed


def scale(by: float, *keys: tuple[str, str], begin: int = FROM) -> Deed:
    """Every number is multiplied."""

    def deed(forged: Forged) -> None:
        for key in keys:
            forged.rows[key][begin:] *= by

    return deed


def add(by: float, *keys: tuple[str, str], begin: int = FROM) -> Deed:
    """A number is added to every number."""

    def deed(forged: Forged) -> None:
        for key in keys:
            forged.rows[key][begin:] += by

    return deed


def delay(ticks: int, *keys: tuple[str, str], begin: int = FROM) -> Deed:
    """Every row stands so many ticks later."""

    def deed(forged: Forged) -> None:
        for key in keys:
            values = forged.rows[key]
            values[begin + ticks :] = values[begin:-ticks].copy()

    return deed


def swap(one: tuple[str, str], other: tuple[str, str], begin: int = FROM) -> Deed:
    """Two traces change their places."""

    def deed(forged: Forged) -> None:
        a, b = forged.rows[one], forged.rows[other]
        a[begin:], b[begin:] = b[begin:].copy(), a[begin:].copy()

    return deed


def both(*deeds: Deed) -> Deed:
    """One deed after the other."""

    def deed(forged: Forged) -> None:
        for one in deeds:
            one(forged)

    return deed


def columns(node: str, trace: str, begin: int = FROM) -> Deed:
    """The first two columns of a trace change their places."""

    def deed(forged: Forged) -> None:
        forged.rows[node, trace][begin:, [0, 1]] = forged.rows[node, trace][begin:, [1, 0]]

    return deed


NAN, INF = float("nan"), float("inf")
DX, DY, CX, CY, ENV = "dx", "dy", "cx", "cy", "environment"
ALL_X = [(name, "x") for name in ("dx", "dy", "dz")]

SIMULATED: Mapping[str, Deed] = {
    "every x is NaN": put(NAN, *ALL_X),
    "every x is NaN from the beginning": put(NAN, *ALL_X, begin=0),
    "every number is NaN": everything(NAN, FROM),
    "every number is NaN from the beginning": everything(NAN, 0),
    "one x is NaN": put(NAN, (DX, "x"), end=FROM + 1),
    "a device's forces are NaN": put(NAN, (DX, "f_v")),
    "a device's ledger is NaN": put(NAN, (DX, "ledger")),
    "a device's delays are NaN": put(NAN, (DX, "tau_us")),
    "a coupling's p is NaN": put(NAN, (CX, "p")),
    "a coupling's forces are NaN": put(NAN, (CX, "f_v")),
    "a coupling's ledger is NaN from the beginning": put(NAN, (CX, "ledger"), begin=0),
    "tools are NaN": put(NAN, (ENV, "x_e")),
    "masses are NaN": put(NAN, (ENV, "q")),
    "the environment's ledger is NaN": put(NAN, (ENV, "ledger")),
    "x is infinite": put(INF, (DX, "x")),
    "a force is minus infinite in both": put(-INF, (DX, "f_v"), (CX, "f_v")),
    "a ledger is infinite": put(INF, (ENV, "ledger")),
    "a device's rows are gone for ten ticks": lose(DX, end=FROM + 10),
    "a device's rows are gone for good": lose(DX),
    "a device's first rows are gone": lose(DX, begin=0, end=10),
    "a device's rows are gone, and it says that it jumped": lose(DX, end=61, jumped_at_61=51.0),
    "a coupling's rows are gone for ten ticks": lose(CX, end=FROM + 10),
    "a user's rows are gone for good": lose(DX, CX),
    "the environment's rows are gone for ten ticks": lose(ENV, end=FROM + 10),
    "the environment's rows are gone for good": lose(ENV),
    "all rows are gone for ten ticks": lose(end=FROM + 10),
    "all first rows are gone": lose(begin=0, end=FROM),
    "x is scaled": scale(1.0 + 1e-9, (DX, "x")),
    "a force is scaled in both": scale(1.01, (DX, "f_v"), (CX, "f_v")),
    "p is scaled": scale(1.0 + 1e-9, (CX, "p")),
    "a ledger is scaled": scale(2.0, (CX, "ledger")),
    "tools and masses are scaled": scale(1.0 + 1e-9, (ENV, "x_e"), (ENV, "q")),
    "a ledger is shifted": add(1e-3, (DX, "ledger")),
    "x is late by a tick": delay(1, (DX, "x")),
    "forces are late by a tick in both": delay(1, (DX, "f_v"), (CX, "f_v")),
    "the environment's ledger is late by three ticks": delay(3, (ENV, "ledger")),
    "two devices are swapped": both(swap((DX, "x"), (DY, "x")), swap((DX, "f_v"), (DY, "f_v"))),
    "two couplings are swapped": both(swap((CX, "p"), (CY, "p")), swap((CX, "f_v"), (CY, "f_v"))),
    "a device's ledger is that of its coupling": swap((DX, "ledger"), (CX, "ledger")),
    "two tools are swapped": columns(ENV, "x_e"),
}
"""Forgeries of a recording of Example 1 under the simulated clock."""

REALTIME: Mapping[str, Deed] = {
    "every number is NaN": everything(NAN, FROM),
    "every x is NaN": put(NAN, *ALL_X),
    "instants are NaN": put(NAN, (DX, "instants")),
    "instants are NaN from the beginning": put(NAN, (DX, "instants"), begin=0),
    "an account is NaN": put(NAN, (DX, "interface")),
    "x at the instants of forces is NaN": put(NAN, (DX, "x_a")),
    "delays are NaN": put(NAN, (DX, "tau_us")),
    "a device's forces are NaN": put(NAN, (DX, "f_v")),
    "a device's rows are gone for ten ticks": lose(DX, end=FROM + 10),
    "a user's rows are gone, and both say that they jumped": both(
        lose(DX, end=61, jumped_at_61=51.0), lose(CX, end=61, jumped_at_61=51.0)
    ),
    "instants are a microsecond late": add(1e3, (DX, "instants")),
    "an account is scaled": scale(1.0 + 1e-6, (DX, "interface")),
    "x at the instants of forces is shifted": add(1e-9, (DX, "x_a")),
    "two devices' instants are swapped": swap((DX, "instants"), (DY, "instants")),
}
"""Forgeries of a recording of Example 1 in real time."""
