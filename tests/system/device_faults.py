"""Faults of real devices at random instants in running sessions, and what must hold of each.

    python -m tests.system.device_faults [--faults N] [--seed S] [--device NAME] [--a-run N] [--keep FOLDER]

Every run is a session in real processes and real time (:func:`manyhands.run`). The device under test has a driver of
ours, which talks to a fake; beside it, in the same environment and tied to it by a spring, is an innocent one. A fault
is ordered at a random instant while the device is felt. Then, by the fake's own record, the session's recording and
its report:

- **zero**: the motors exert no force within the time that is stated of the fault. Time in which the fake itself had no
  turn is added, for a board of its own has every turn;
- **wire**: what the motors exert was on the wire, and not over by then;
- **given**: what they exert was given by the session, in a tick whose sample is no older than a force may be. Rows that
  died with their process cannot tell: what was exerted in such a gap is counted (``unseen``). So is what a stalled
  service exerted for longer, where a wire does not say when a force ends (``behind``);
- **named**: an incident says what happened, of this device;
- **back**: it is felt again after the fault, by itself or once the fault was ended, and its process came back once;
- **others**: nobody else is named, frozen or lost, and all accounts hold;
- **audit**: the recording's audit finds nothing broken.

What a busy machine makes late is no finding (:data:`OF_THE_MACHINE`), nor that a late force was ended early. It is
counted, and so is how often it had the innocent's coupling change its rung (``softened``): on an idle machine both are
0, but for the ticks in which a process dies. A row for each device: device_rows.py.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import re
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

import manyhands as mh
from manyhands.launch.app.background import BackgroundRun, RunFailed
from manyhands.launch.recordings.run import RecordedRun, read_run, rows_of
from manyhands.launch.run.outcome import rows_of as promises_of
from manyhands.nodes.monitor.health import missed
from manyhands.nodes.rows.figures import FORCE, INSTANTS
from manyhands.nodes.rows.promises import Promise
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.protocol.messages import PromiseStatus

from ..fakes.far_side import FarSide, Record
from ..support.commands import manyhands_command
from .device_row import KILL, LASTS, Row
from .device_rows import ROWS

TESTED, ITS_COUPLING = "tested", "ctested"
INNOCENT, INNOCENTS = "innocent", ("innocent", "cinnocent", "environment")
PATIENCE: Final = 60.0
"""s, for anything that is awaited; far more than it takes."""

PROMISE: Final = -1e-12
"""J, below which an account is broken."""

OF_THE_MACHINE: Final = {Promise.PACE, Promise.DELAY, Promise.PERIOD, Promise.PUNCTUALITY, Promise.PRESENCE}
"""What a busy machine breaks by itself: such rows are counted, and not judged. So are ticks in which the account of a
late tick lowered a force: the promise about their energy is kept by that."""

STALL: Final = 300_000_000
"""ns without a turn, after which a fake may count as gone by itself."""

SLACK: Final = 100_000
"""ns; the grain of a fake's record."""


@dataclass
class Found:
    """What a run has shown.

    Attributes:
        wrong: what did not hold, in words.
        zero: by fault, the times until the motors exerted no force, s, less those in which the fake had no turn.
        again: by fault, how long it took until the device was felt again, s.
        restarts: how often its process came back.
        forces: how many forces the motors exerted.
        unseen: of them, those of which the recording has no row.
        behind: of them, those that lasted too long since a service stalled, on a wire that says no end.
        backlog: by how much a force came late that was under way in a fault of which this is stated, s.
        late: rows of promises of the innocent that a busy machine breaks.
        softened: how often the innocent's coupling changed its rung.
        audit: the audit's verdict.
        seconds: how long the run took.
    """

    wrong: list[str] = field(default_factory=list)
    zero: dict[str, list[float]] = field(default_factory=dict)
    again: dict[str, list[float]] = field(default_factory=dict)
    restarts: int = 0
    forces: int = 0
    unseen: int = 0
    behind: int = 0
    backlog: float = 0.0
    late: int = 0
    softened: int = 0
    audit: str = ""
    seconds: float = 0.0


def session_of(row: Row, far: FarSide, changes: Mapping[str, Any]) -> dict[str, Any]:
    """The session: the device, the innocent, and springs between them and to the ground."""
    stated = row.keys.get("axes", "translation")
    names = [str(axis) for axis in range(row.keys["dof"])] if isinstance(stated, str) else list(stated)
    kinds = dict.fromkeys(names, stated) if isinstance(stated, str) else stated
    axes = [f"{TESTED}.{name}" for name in names]
    turns = isinstance(kinds, Mapping) and kinds[names[0]] == "rotation"
    lever = {"lever": {axes[0]: 1.0}} if turns else {}  # the innocent translates
    k = row.stiffness
    return {
        "session": "device-faults",
        "period": row.period,
        "devices": {
            TESTED: {**row.keys, "parameters": {**row.parameters, **far.parameters}, **changes},
            INNOCENT: {
                "dof": 1,
                "osp": 1.37,
                "driver": "simulated",
                "mass": 0.2,
                "limits": {"force": 5, "displacement": 2, "speed": 2},
                "hand": {"operator": {"num": [0.02, 1.2, 20], "den": [1, 10.3, 100]}, "force": "1.2*sin(2*pi*0.9*t)"},
            },
        },
        "couplings": {ITS_COUPLING: {"devices": [TESTED]}, INNOCENTS[1]: {"devices": [INNOCENT]}},
        "environment": {
            "type": "network",
            "links": [
                *({"between": [axis, "ground"], "stiffness": k} for axis in axes),
                {"between": [axes[0], f"{INNOCENT}.0"], "stiffness": k / 2, **lever},
                {"between": [f"{INNOCENT}.0", "ground"], "stiffness": row.ground or k},
            ],
        },
        "design": dict(row.design),
        "faults": {"restarts": 100},
    }


class Stage:
    """A session that runs, and its fake.

    Attributes:
        found: what it has shown.
        incidents: all that it has reported, oldest first.
    """

    def __init__(self, row: Row, far: FarSide, run: BackgroundRun, chance: random.Random, patience: float) -> None:
        self._row, self._far, self._run, self._chance, self._patience = row, far, run, chance, patience
        self.found = Found()
        self.incidents: list[str] = []
        self.ordered: list[str] = []
        self._last: dict[str, float] = {}
        self._times: list[float] = []  # by incident, the session's time at which it was heard, s

    def fault(self, name: str) -> bool:
        """Order one fault, and see it through; False where the session cannot go on after it."""
        of, number = self._row.faults[name], len(self.ordered)
        # within QUIET of an incident a second one of its kind is not said, whatever fault the first one was of
        self._until(lambda: self._now() >= max(self._last.get(name, -math.inf), self._heard(of.said)) + of.apart)
        self._felt(f"before {name} {number}")
        time.sleep(self._chance.uniform(0.1, 1.1))  # the hand moves on
        self._incidents()
        known = len(self.incidents)
        self.ordered.append(name)
        self._last[name] = self._now()
        if KILL in of.orders:
            os.kill(self._run.progress.pids[TESTED], signal.SIGKILL)
        self._far.mark(number, *(order for order in of.orders if order != KILL))
        what = f"{name} {number}"
        for words in filter(None, (of.said, of.after)):
            if not self._until(lambda words=words: self._told(known, words)):  # type: ignore[misc]
                self.found.wrong.append(f"{what}: named: found {self.incidents[known:]}; expected {words!r}")
        if not of.said:
            time.sleep(of.lasts)
        self._far.order(*of.then)
        ended = time.monotonic()
        if of.dies and not self._until(lambda: self._told(known, f"{TESTED} is back")):
            self.found.wrong.append(f"{what}: back: found {self.incidents[known:]}; expected that it is back")
            return False
        if self._felt(f"after {what}"):
            self.found.again.setdefault(name, []).append(time.monotonic() - ended)
            return True
        return False

    def finish(self) -> None:
        """Let the last force end, and take what is still reported."""
        self._run.stop()
        self._run.wait(PATIENCE)
        self._incidents()

    def _now(self) -> float:
        """The session's time, s: on a busy machine it is behind."""
        told = self._run.progress.telemetry.get(INNOCENT)
        return 0.0 if told is None else told.tick * self._row.period

    def _told(self, known: int, words: str) -> bool:
        self._incidents()
        return any(words in one and re.search(rf"\b{TESTED}\b", one) for one in self.incidents[known:])

    def _incidents(self) -> None:
        latest, known = self._run.progress.incidents, self.incidents[-200:]
        new = [one for one in latest if one not in known and one[:1] != "!"]
        self.incidents += new
        self._times += [self._now()] * len(new)

    def _heard(self, words: str) -> float:
        """When an incident with these words was heard last, s of the session's time."""
        self._incidents()
        times = (at for at, one in zip(self._times, self.incidents, strict=True) if words in one)
        return max(times, default=-math.inf)

    def _felt(self, when: str) -> bool:
        felt = self._until(
            lambda: (
                self._run.progress.states[TESTED] == "running"
                and any(abs(force) > self._row.felt for force in self._far.force())
            )
        )
        if not felt:
            self.found.wrong.append(f"{when}: back: found no force on its motors; expected that it is felt")
        return felt

    def _until(self, true: Callable[[], bool]) -> bool:
        end = time.monotonic() + self._patience
        while not true():
            if time.monotonic() > end or self._run.wait(0.0):
                return False
            time.sleep(0.01)
        return True


def run(
    row: Row, names: Sequence[str], seed: int, folder: Path, changes: Mapping[str, Any] | None = None,
    orders: Sequence[str] = (), patience: float = PATIENCE,
) -> Found:  # fmt: skip
    """One session with these faults, one after the other.

    Args:
        row: the device.
        names: of its faults.
        seed: of the instants.
        folder: for the files of session and fake.
        changes: other keys of the device in the session.
        orders: to the fake, before the session.
        patience: how long anything is awaited, s.
    """
    began, recording = time.monotonic(), folder / "run.mcap"
    session = folder / "session.yaml"
    with row.opened(folder) as far:
        session.write_text(json.dumps(session_of(row, far, changes or {})))
        far.order(*orders)
        background = mh.run(session, record=recording)
        stage = Stage(row, far, background, random.Random(seed), patience)
        try:
            with background:
                for name in names:
                    if not stage.fault(name):
                        break
                stage.finish()
        except RunFailed as failed:
            stage.found.wrong += [f"the session failed: {text}" for text in failed.faults]
        record = far.record()
    found = stage.found
    _judge_zero(row, stage.ordered, record, found)
    _judge_wire(record, found)
    recorded = read_run(recording)
    _judge_given(row, stage.ordered, recorded, record, found)
    _judge_report(row, stage, background.report, recorded, record)
    _judge_audit(recording, found)
    found.seconds = time.monotonic() - began
    return found


# --- what must hold


def _judge_zero(row: Row, ordered: Sequence[str], record: Record, found: Found) -> None:
    for number, name in enumerate(ordered):
        of, zero = row.faults[name], record.to_zero(number)
        if zero is None:
            found.wrong.append(f"{name} {number}: zero: found a force to the end; expected none after {of.within:g} s")
            continue
        taken, busy = zero
        found.zero.setdefault(name, []).append(1e-9 * max(0, taken - busy))
        if taken - busy > 1e9 * of.within + SLACK:
            found.wrong.append(
                f"{name} {number}: zero: found a force for {1e-6 * taken:.2f} ms, in {1e-6 * busy:.2f} of which the "
                f"fake had no turn; expected none after {1e3 * of.within:g} ms"
            )


def _judge_wire(record: Record, found: Found) -> None:
    exerted = record.exerted()
    found.forces = len(exerted)
    if record.given is None:
        return
    of: dict[tuple[float, ...], list[Any]] = {}
    for given in record.given:
        of.setdefault(given.f, []).append(given)
    strange, stale = [], []
    for _, end, f in exerted:
        lasts = max((given.until for given in of.get(f, ()) if given.at <= end), default=None)
        if lasts is None:
            strange.append(f)
        elif end > lasts + SLACK:
            stale.append(1e-6 * (end - lasts))
    if strange:
        found.wrong.append(f"wire: found {len(strange)} forces, as {strange[0]} N, that had not come over the wire")
    if stale:
        found.wrong.append(f"wire: found {len(stale)} forces up to {max(stale):.2f} ms after their end; expected none")


def _judge_given(row: Row, ordered: Sequence[str], recorded: RecordedRun, record: Record, found: Found) -> None:
    """Compare what the motors exerted with the rows of the recording, whose instants are since tick 0.

    Both clocks are this machine's, and only where tick 0 was is not known: it follows from the forces themselves, most
    of which occur once. The middle of what they say is later than the truth by the way of a force, so no force counts
    as stale that is not.
    """
    f = row.scale * rows_of(recorded, TESTED, FORCE)
    instants = rows_of(recorded, TESTED, INSTANTS)
    sampled, applied = instants[:, 0], instants[:, 1]
    known = np.isfinite(sampled) & np.isfinite(f).all(axis=1)
    f, sampled, applied = f[known], sampled[known], applied[known]
    exerted = record.exerted()
    if not len(f) or not exerted:
        found.wrong.append(f"given: found {len(f)} rows and {len(exerted)} forces; expected both")
        return
    near = row.precision * max(1.0, float(np.abs(f).max()))
    matches = [np.flatnonzero((np.abs(f - np.array(force)) <= near).all(axis=1)) for _, _, force in exerted]
    once = [begin - applied[of[0]] for (begin, _, _), of in zip(exerted, matches, strict=True) if len(of) == 1]
    if not once:
        found.wrong.append("given: found no force of the recording on its motors; expected them")
        return
    tick_0 = float(np.median(once))
    lasting, way = 1e9 * (LASTS * row.period + row.late), 1e9 * row.way
    delayed = [(record.marks[number], 1e9 * row.faults[name].late) for number, name in enumerate(ordered)]
    wanted = np.flatnonzero(np.diff(sampled) > 1.5e9 * row.period)
    gaps = [(sampled[i], sampled[i + 1]) for i in wanted]
    strange, stale = [], []
    for (begin, end, force), of in zip(exerted, matches, strict=True):
        sent = [i for i in of if applied[i] <= end - tick_0 + SLACK]
        if any(end <= tick_0 + sampled[i] + lasting + SLACK for i in sent):
            continue
        if row.way and any(
            end - record.without_turn(tick_0 + applied[i], begin) <= tick_0 + sampled[i] + lasting + way for i in sent
        ):
            continue
        if _in_a_gap(begin - tick_0, sampled, gaps, lasting):
            found.unseen += 1
        elif len(of) and record.stalled(begin, end):
            found.behind += 1
        elif len(of) and any(at < end <= at + late for at, late in delayed):
            overdue = 1e-9 * min(end - tick_0 - float(sampled[i]) - lasting for i in of)
            found.backlog = max(found.backlog, overdue)
        elif len(of):
            stale.append(1e-6 * min(end - tick_0 - sampled[i] - lasting for i in of))
        else:
            strange.append(force)
    if strange:
        found.wrong.append(f"given: found {len(strange)} forces, as {strange[0]} N, that the session had not given")
    if stale:
        found.wrong.append(f"given: found {len(stale)} forces up to {max(stale):.2f} ms after their end; expected none")


def _in_a_gap(at: float, sampled: Any, gaps: Sequence[tuple[float, float]], lasting: float) -> bool:
    """Whether rows are missing at an instant since tick 0, ns, or so shortly before that their force may act then."""
    return not sampled[0] <= at <= sampled[-1] or any(begin < at <= end + lasting for begin, end in gaps)


def _judge_report(row: Row, stage: Stage, report: Mapping[str, Any], recorded: RecordedRun, record: Record) -> None:
    found, nodes = stage.found, report["nodes"]
    dying = sum(row.faults[name].dies for name in stage.ordered)
    stalls = sum(end - begin > STALL for begin, end in record.stretches())  # a fake without turns counts as gone
    restarts = {name: node.get("incidents", {}).get("restarts", 0) for name, node in nodes.items()}
    found.restarts = restarts.get(TESTED, 0)
    for name in (TESTED, ITS_COUPLING, *INNOCENTS):
        wanted, more = (dying, stalls) if name in (TESTED, ITS_COUPLING) else (0, 0)
        if not wanted <= restarts.get(name, -1) <= wanted + more:
            ends = [one for one in stage.incidents if re.search(rf"\b{name}\b.* (failed|ended|killed)", one)]
            found.wrong.append(f"back: found {restarts.get(name)} restarts of {name}; expected {wanted}: {ends}")
    for name, node in nodes.items():
        for account in ("ledger", "interface"):
            if account in node and node[account]["margin"] < PROMISE and name != TESTED:
                found.wrong.append(f"others: found {name}'s {account} {node[account]['margin']:g} J below its bound")
    for name in INNOCENTS:
        named = [one for one in stage.incidents if re.search(rf"\b{name}\b", one)]
        found.wrong += [f"others: found {name} in the incident {one!r}; expected nobody but {TESTED}" for one in named]
    rows: list[PromiseStatus] = missed(promises_of(report))
    for status in rows:
        if {*status.who} & {*INNOCENTS}:
            if status.promise in OF_THE_MACHINE or (status.promise, status.state) == (Promise.LATENESS, "enforced"):
                found.late += 1
            else:
                found.wrong.append(f"others: found {status}; expected nobody but {TESTED}")
        if status.promise == Promise.DRIVER and status.state == "broken":
            found.wrong.append(f"given: found the driver's word broken: {status.remark}")
    happened = Counter(
        (event.kind, event.peer or node)
        for node in INNOCENTS
        for _, figures in recorded.figures.get(node, ())
        for event in events_in(figures)
    )
    if times := happened[Kind.FROZEN, INNOCENTS[1]]:
        found.wrong.append(f"others: found {INNOCENTS[1]} frozen {times} times; expected never")
    found.softened = happened[Kind.RUNG, INNOCENTS[1]]


def _judge_audit(recording: Path, found: Found) -> None:
    told = json.loads(manyhands_command("audit", recording, "--json").stdout)
    found.audit = told["found"]
    for check in told["checks"]:
        if check["verdict"] == "broken":
            found.wrong.append(f"audit: found {check['party']}: {check['name']}: {check['first']} {check['told']}")


# --- the campaign


def drawn(row: Row, faults: int, chance: random.Random) -> list[str]:
    """So many faults in any order, each kind about equally often."""
    names = list(row.faults) * (faults // len(row.faults) + 1)
    names = names[: faults - faults % len(row.faults)] + chance.sample(list(row.faults), faults % len(row.faults))
    chance.shuffle(names)
    return names


def table(row: Row, runs: Sequence[Found]) -> str:
    """A line for each kind of faults."""
    lines = [
        "| fault | times | greatest time to zero [ms] | stated [ms] | felt again after [s] |",
        "|---|---|---|---|---|",
    ]
    for name, of in row.faults.items():
        zero = [time_ for one in runs for time_ in one.zero.get(name, ())]
        again = [time_ for one in runs for time_ in one.again.get(name, ())]
        most, last = max(zero, default=float("nan")), max(again, default=float("nan"))
        lines.append(f"| {name} | {len(zero)} | {1e3 * most:.2f} | {1e3 * of.within:g} | {last:.1f} |")
    return "\n".join(lines)


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", type=int, default=104, help="of each device")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--device", choices=ROWS, help="one alone; all by default")
    parser.add_argument("--a-run", type=int, default=26, help="faults in a session, at most")
    parser.add_argument("--keep", type=Path, help="a folder in which the recordings of sessions with findings stay")
    given = parser.parse_args()
    failing = 0
    with TemporaryDirectory() as compiled:
        os.environ.setdefault("MANYHANDS_COMPILED", compiled)
        for device in [given.device] if given.device else ROWS:
            row, runs = ROWS[device], list[Found]()
            names = drawn(row, given.faults, random.Random(given.seed))
            for begin in range(0, len(names), given.a_run):
                with TemporaryDirectory() as folder:
                    one = run(row, names[begin : begin + given.a_run], given.seed * 1000 + begin, Path(folder))
                    if given.keep and one.wrong:
                        shutil.copy(Path(folder) / "run.mcap", given.keep / f"{device}-{given.seed}-{begin}.mcap")
                runs.append(one)
                print(  # noqa: T201 -- a campaign
                    f"{device}: faults {begin} to {begin + sum(map(len, one.zero.values()))}, {one.restarts} restarts, "
                    f"{one.forces} forces ({one.unseen} unseen, {one.behind} behind, {1e3 * one.backlog:.1f} ms of "
                    f"backlog), audit {one.audit}, {one.late} late rows of others, softened {one.softened} times, "
                    f"{one.seconds:.0f} s: {'; '.join(one.wrong) or 'sound'}",
                    flush=True,
                )
            wrong = sum(len(one.wrong) for one in runs)
            failing += bool(wrong)
            print(f"{table(row, runs)}\n\n{device}: {len(names)} faults, {wrong} findings")  # noqa: T201 -- likewise
    return 1 if failing else 0


if __name__ == "__main__":
    sys.exit(main())
