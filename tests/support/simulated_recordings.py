"""Recordings of simulated sessions, as a recorder writes them, without any process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from manyhands.design.models.coupling import SpringDamper
from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.recorded import Traces
from manyhands.launch.plan.recorded import recorded_of as described
from manyhands.launch.recordings.run import RecordedRun
from manyhands.launch.run.directory import kept_files
from manyhands.launch.session import Session, load_session
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.rows.tick_events import TickEvents
from manyhands.protocol.channels import LEDGER, TAU
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Observation, Role

from .figures import as_figures

EVERY = 100  # ticks between two telemetry messages
SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
START = 1_700_000_000_000_000_000  # ns since 1970

Rows = Mapping[tuple[str, str], np.ndarray]
"""By node and trace, ticks x columns."""


TICKS = 330
"""Of a recording that tests share; no multiple of the ticks between two telemetry messages."""


def simulated(prepared: Prepared, ticks: int, faults: Sequence[Silence] = ()) -> dict[tuple[str, str], np.ndarray]:
    """The telemetry of all nodes in a run."""
    simulation = Simulation(prepared)
    traces: Traces = simulation.traces(ticks)
    simulation.run(ticks, faults=faults, traces=traces)
    rows = {(node, kept.topic.trace): kept.values for node, topics in traces.by_node.items() for kept in topics}
    return rows | {(name, TAU): np.zeros((ticks, 1)) for name in prepared.session.devices}


def attachments_of(prepared: Prepared) -> dict[str, bytes]:
    return kept_files(prepared)


def recorded_of(prepared: Prepared, clock: str = "simulated") -> Recorded:
    return described(prepared, clock)


def written(
    path: Path,
    recorded: Recorded,
    attachments: Mapping[str, bytes],
    rows: Rows,
    more: Callable[[str, int], Mapping[str, float]] = lambda node, tick: {},
    frozen: bool = True,
) -> Path:
    """Write a recording of these rows; a node without rows in a tick sent no telemetry of it.

    Args:
        path: the file.
        recorded: the session.
        attachments: by name.
        rows: by node and trace.
        more: by node and tick, its figures besides its ledger.
        frozen: whether the environment reports a coupling without rows as frozen.
    """
    core = RecorderCore(recorded, attachments, START)
    for node, role in recorded.roles.items():
        own = {trace: values for (of, trace), values in rows.items() if of == node}
        if not own:
            continue
        there = np.isfinite(next(iter(own.values()))).all(axis=1)
        for begin in range(0, len(there), EVERY):
            end = min(begin + EVERY, len(there))
            runs = np.split(np.arange(begin, end), np.flatnonzero(np.diff(there[begin:end])) + 1)
            for ticks in runs:
                if not there[ticks[0]]:
                    continue
                until = int(ticks[-1]) + 1
                told = {trace: values[ticks[0] : until] for trace, values in own.items()}
                figures = {LEDGER: float(told[LEDGER][-1, 0])} if LEDGER in told else {}
                if frozen and role is Role.ENVIRONMENT:
                    figures |= _frozen(rows, recorded, int(ticks[0]), until)
                if ticks[0] == 0 or not there[ticks[0] - 1]:  # a process begins, and reports it
                    figures |= TickEvents().take(int(ticks[0]), until)
                if role is Role.ENVIRONMENT:
                    figures |= _lives(rows, recorded, int(ticks[0]), until)
                figures |= {"period_breaches": 0.0} if role is Role.DEVICE else {}
                core.take(
                    encode(Observation(node, until, as_figures(more(node, until)).with_numbers(figures), told)),
                    START + until * 10**6,
                )
    assert core.refused == 0
    path.write_bytes(core.cut() + core.end())
    return path


def _frozen(rows: Rows, recorded: Recorded, begin: int, end: int) -> dict[str, float]:
    """An environment's figures about the couplings without rows, in its telemetry of these ticks."""
    events = TickEvents()
    for node, role in recorded.roles.items():
        if role is Role.COUPLING:
            there = np.isfinite(rows[node, "p"]).all(axis=1)
            for tick in (np.flatnonzero(np.diff(there)) + 1).tolist():
                if begin <= tick < end:
                    (events.activate if there[tick] else events.freeze)(tick, node)
    return {name: value for name, value in events.take(0, 0).items() if ":" in name}


def _lives(rows: Rows, recorded: Recorded, begin: int, end: int) -> dict[str, float]:
    """An environment's figures about the lives of wave links that begin in these ticks: those of their couplings."""
    events = TickEvents()
    for node in recorded.linked:
        there = np.concatenate([[False], np.isfinite(rows[node, "p"]).all(axis=1)])
        for tick in np.flatnonzero(np.diff(there.astype(int)) == 1).tolist():
            if begin <= tick < end:
                events.link(tick, node)
    return {name: value for name, value in events.take(0, 0).items() if ":" in name}


def forged(path: Path, run: RecordedRun, change: Callable[[dict[tuple[str, str], np.ndarray]], None]) -> Path:
    """Write a recording again with some numbers changed; a recorder writes it, so every checksum is right.

    Args:
        path: the file.
        run: what was recorded.
        change: changes the rows in place.
    """
    rows = {(node, trace.topic.trace): trace.values.copy() for (node, _), trace in run.traces.items()}
    before = {key: values.copy() for key, values in rows.items()}
    change(rows)
    assert any(not np.array_equal(rows[key], before[key], equal_nan=True) for key in rows)
    figures = {node: dict(told) for node, told in run.figures.items()}
    return written(path, run.recorded, run.attachments, rows, lambda node, tick: figures[node].get(tick, {}))


def prepared_as(kind: str) -> Prepared:
    """A certified session of a kind: a shipped one, or Example 1 ``linear``, ``enforced`` or ``series``, no ladder."""
    if kind == "series":
        counted = ["design.series=true", "design.objective=stiffest", "design.ladder=[]"]
        return prepare(load_session(SESSIONS / "example1.yaml", counted))
    if kind == "enforced":
        return prepare(load_session(SESSIONS / "example1.yaml", ["environment.enforce=true", "design.ladder=[]"]))
    if kind != "linear":
        return prepare(load_session(SESSIONS / f"{kind}.yaml"))
    session = load_session(SESSIONS / "example1.yaml")
    block = SpringDamper(np.array([[700.0]]), np.array([[0.04]])).realisation(session.period)
    matrices = {name: {key: getattr(block, key).tolist() for key in "ABCD"} for name in session.couplings}
    plain = session.as_plain() | {"design": {"coupling": "given", "matrices": matrices, "ladder": []}}
    return prepare(Session.model_validate(plain, context={"folder": Path()}))
