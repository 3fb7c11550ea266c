"""Three users of Example 1 by real processes, one of them across a WAN: what the run promised, and what was kept.

    python -m tests.support.far_user [SECONDS]

The user x, its device and its coupling, is in the far namespace and reaches the world through a wave link. The users y
and z close their loops within the tick, in the near namespace, where the session is launched.

*An ideal line of the same R* is the same session in one process (:class:`manyhands.launch.simulation.Simulation`) with
the same hands, the same certificate and a line that delays every wave by a constant number of ticks, and loses none.
The delays are what the run shows: the sums of waves at the two ends are two curves, one of which is late.

*Within 1 %*: the root mean square of the difference of a local user's displacement x in both runs, over that of x in
the ideal run, from :data:`START` on. A machine that is busy with other work is late, and a late user is frozen: so the
table has the same run over a quiet wire beside it, for what of the difference is the machine's.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import RecordedRun, read_run
from manyhands.launch.session import load_session
from manyhands.launch.simulation import Simulation
from manyhands.nodes.telemetry import DISPLACEMENT, FORCE, WAVE, WAVE_LEDGER
from manyhands.nodes.wave_link.faces import UserFace, WorldFace

from .commands import MANYHANDS, run
from .wan import Side, Wan, Wire, open_wan

Array = NDArray[np.float64]
Rows = Mapping[tuple[str, str], Array]
"""By node and trace: ticks x columns."""

EXAMPLE: Final = Path(__file__).parents[2] / "launch" / "sessions" / "example1.yaml"
WIRE: Final = Wire(delay=0.03, jitter=0.02, loss=0.02)
"""40 ms +- 10 ms one way, and 2 % loss."""

QUIET: Final = Wire(delay=0.044)
"""Its like without jitter and loss, for what the machine adds: under jitter the newest wave is 44 ms old."""

FAR: Final = ("dx", "cx")
LOCAL: Final = ("dy", "dz")
PORT: Final = 7400
START: Final = 3.0
"""When the hands begin, s. Who joins is let in by a ramp, and a hand that pushed earlier would not be held."""

T: Final = 1e-3  # s

b: Final = 7.5
"""Wave impedance, N·s/m: at R = 0.12 s it is felt as 0.45 kg, and as 125 N/m against a wall."""

PATIENCE: Final = 120.0
"""How much longer than the session a process may take, s: it joins, and the recording is written."""

CLOSE: Final = 0.01
"""The most that a local user's motion may differ by, relative."""

OVERRIDES: Final = (
    f"couplings.cx.wave_link={{b: {b:g}}}",
    "design.objective=stiffest",
    "design.tau=0.001",
    "design.period_tolerance=1.0",
    f'devices.dx.hand.force="step(t - {START:g})*1.5*sin(2*pi*0.4*(t - {START:g}))"',
    f'devices.dy.hand.force="step(t - {START:g})*2*sin(2*pi*0.3*(t - {START:g}))"',
    f'devices.dz.hand.force="step(t - {START:g})*-1.5*sin(2*pi*0.5*(t - {START:g}))"',
)
SET: Final = tuple(word for override in OVERRIDES for word in ("--set", override))


# --- the run


def run_across(one: Wan, folder: Path, seconds: float) -> tuple[RecordedRun, dict[str, Any]]:
    """Run the session, its far nodes by invitation; the recording, and the report."""
    certificate, keys = folder / "c.json", folder / "keys"
    run("design", EXAMPLE, *SET, "-o", certificate)
    run("keys", EXAMPLE, *SET, "-o", keys)
    shared = ("--keys", str(keys), "--certificate", str(certificate), *SET)
    for name in FAR:
        run("invite", EXAMPLE, name, *shared, "-o", folder / f"{name}.bundle")
    place = f"{one.address('near')}:{PORT}"
    launch = (
        *("launch", str(EXAMPLE), *shared, "--transport", "tcp", "--listen", place, "--duration", f"{seconds:g}"),
        *("--record", str(folder / "run.mcap"), "--report", str(folder / "run.json")),
        *(word for name in FAR for word in ("--remote", name)),
    )
    nodes = {
        name: (
            *("node", name, "--session", str(folder / f"{name}.bundle"), "--connect", f"tcp://{place}"),
            *("--key", str(keys / "private" / f"{name}.key")),
        )
        for name in FAR
    }
    with ExitStack() as stack:
        home = stack.enter_context(process(one, "near", launch))
        guests = [stack.enter_context(process(one, "far", nodes[name])) for name in FAR]
        for name, of in zip(("launch", *FAR), (home, *guests), strict=True):
            _, error = of.communicate(timeout=seconds + PATIENCE)
            if of.returncode:
                raise AssertionError(f"{name} ended with {of.returncode}; expected 0: {error}")
    return read_run(folder / "run.mcap"), json.loads((folder / "run.json").read_text())


@contextmanager
def process(one: Wan, side: Side, arguments: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    """A command of manyhands in a namespace; killed if it has not ended."""
    command = [*one.within(side), *MANYHANDS, *arguments]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as started:
        try:
            yield started
        finally:
            started.kill()


# --- an ideal line


def ideal(folder: Path, ticks: int, there: int = 0, back: int = 0) -> Rows:
    """The same session over a line that delays every wave by a constant number of ticks, and needs no play-out."""
    prepared = far_session(folder, "couplings.cx.wave_link.depth=0")
    simulation = Simulation(prepared)
    _delay(simulation.world_faces["cx"], there)
    _delay(simulation.user_faces["cx"], back)
    traces = simulation.traces(ticks)
    simulation.run(ticks, traces=traces)
    return {(node, kept.topic.trace): kept.values for node, topics in traces.by_node.items() for kept in topics}


def far_session(folder: Path, *overrides: str) -> Prepared:
    """The session under the run's certificate."""
    return prepare(load_session(EXAMPLE, [*OVERRIDES, *overrides]), folder / "c.json")


def _delay(face: UserFace | WorldFace, ticks: int) -> None:
    """Put a line before a face: it hears each message so many ticks later."""
    hear, line = face.hear, deque[tuple[int, Sequence[float], float]]()

    def put(n: int, U: Sequence[float], G: float, life: int = 0) -> bool:
        line.append((n, U, G))
        return len(line) > ticks and hear(*line.popleft(), life)

    face.hear = put  # type: ignore[method-assign]


def delays(rows: Rows) -> tuple[float, float]:
    """How many ticks later the waves of one end are played at the other: the user's at the world, the world's at the
    user.

    What a face has sent, and what the other has played, are the same curve, a time apart: that which leaves the least
    square between them. The clock of the far machine enters both ways, with opposite signs.
    """
    h = math.sqrt(2.0 * b)
    user, world, at_user, at_world = (rows[node, of][:, 0] for of in (WAVE, FORCE) for node in ("cx", "environment"))
    ticks = min(len(user), len(world))
    from_user, from_world = (user - 2.0 / h * at_user)[:ticks], (world + 2.0 / h * at_world)[:ticks]
    return _apart(from_user, world[:ticks]), _apart(from_world, user[:ticks])


def _apart(sent: Array, played: Array) -> float:
    """By how many ticks the sum of one wave is later than that of the other, to a tenth of a tick."""
    earlier, later = (np.cumsum(np.nan_to_num(wave)) for wave in (sent, played))
    k = np.arange(len(earlier))

    def left(ticks: float) -> float:
        return float(np.std((later - np.interp(k - ticks, k, earlier))[round(START / T) :]))

    coarse = min(np.arange(0.0, 300.0, 2.0), key=left)
    return float(min(np.arange(coarse - 3.0, coarse + 3.0, 0.1), key=left))


# --- what was promised, and kept


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Attributes:
        what: in words.
        found: the figure.
        bound: what it is held to.
        holds: whether it is.
    """

    what: str
    found: str
    bound: str
    holds: bool


def bounds(run: RecordedRun, report: Mapping[str, Any], tanks: Sequence[float]) -> list[Line]:
    """Every ledger and interface account, and the two-port; ``tanks`` are the session's and the wave link's, J."""
    lines = []
    for name, node in report["nodes"].items():
        if "ledger" in node:
            ledger = node["ledger"]
            lines.append(_at_least(f"{name}: least ledger", ledger["min"], -ledger["margin"]))
        if "interface" in node:
            lines.append(_at_least(f"{name}: least interface account", node["interface"]["min"], -tanks[0]))
    ends = [dict(run.figures[node]) for node in ("cx", "environment")]
    entered = [
        np.array([(at, figures[key]) for at, figures in of.items() if key in figures])
        for of, key in zip(ends, (WAVE_LEDGER, f"{WAVE_LEDGER}_cx"), strict=True)
    ]
    both = entered[0][:, 1] + np.interp(entered[0][:, 0], *entered[1].T)
    lines.append(_at_least("wave link: least energy that has entered it", float(both.min()), -2.0 * tanks[1]))
    return lines


def _at_least(what: str, energy: float, bound: float) -> Line:
    return Line(what, f"{1e3 * energy:.4g} mJ", f"at least {1e3 * bound:.4g} mJ", energy >= bound)


def motion(device: str, rows: Rows, expected_rows: Rows) -> float:
    """By how much the x of a device differs in two runs, relative to that in the second, root mean square."""
    x, expected = (of[device, DISPLACEMENT][round(START / T) :, 0] for of in (rows, expected_rows))
    ticks = min(len(x), len(expected))
    here = np.isfinite(x[:ticks])
    apart = (x[:ticks] - expected[:ticks])[here]
    return float(np.sqrt(np.mean(apart**2) / np.mean(expected[:ticks][here] ** 2)))


@dataclass(frozen=True)
class Found:
    """What a run across a WAN has shown.

    Attributes:
        bounds: what was promised.
        close: of each local user, how close its motion is to that over the ideal line.
        besides: figures without a bound.
    """

    bounds: Sequence[Line]
    close: Sequence[Line]
    besides: Sequence[Line]

    @property
    def held(self) -> bool:
        """Whether all of it holds."""
        return all(line.holds for line in (*self.bounds, *self.close))


def examine(wire: Wire, folder: Path, seconds: float) -> Found:
    """Run the session across a WAN, and compare it with the ideal line of its R.

    Raises:
        Refused: the machine permits no namespaces.
    """
    with open_wan(wire) as one:
        run, report = run_across(one, folder, seconds)
    rows = {(node, kept.topic.trace): kept.values for (node, _), kept in run.traces.items()}
    ways = delays(rows)
    least = delays(ideal(folder, round(2.0 * START / T)))  # what the faces take without a line
    there, back = (max(0, round(way - own)) for way, own in zip(ways, least, strict=True))
    expected = ideal(folder, run.ticks, there, back)
    session, nodes = far_session(folder).session, report["nodes"]
    close = [
        Line(f"{name}: motion, from that over the ideal line", f"{apart:.3%}", f"at most {CLOSE:.0%}", apart <= CLOSE)
        for name in LOCAL
        for apart in (motion(name, rows, expected),)
    ]
    link = report["wave_links"]["cx"]
    besides = {
        "R, from tick to tick": f"{sum(ways):.1f} ms, of which {ways[0]:.1f} to the world (the far clock included)",
        "ideal line": f"{there} and {back} ticks",
        "dx: motion, from that over the ideal line": f"{motion('dx', rows, expected):.3%}",
        "play-out of both ends": f"{1e3 * (link['round_trip'] - T):.1f} ms",
        "silences of both ends": str(link["silences"]),
        "late ticks": ", ".join(f"{name} {nodes[name]['late'] / nodes[name]['ticks']:.2%}" for name in ("dx", *LOCAL)),
        "ticks of frozen users": str(nodes["environment"].get("incidents", {}).get("frozen", 0)),
    }
    tanks = (session.faults.tank, session.wave_links["cx"].tank)
    return Found(bounds(run, report, tanks), close, [Line(what, found, "", True) for what, found in besides.items()])


def main() -> None:
    """Print a table of both runs; the exit code is 1 if anything does not hold across the WAN."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    runs = []
    for wire in (WIRE, QUIET):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(examine(wire, Path(folder), seconds))
    sys.stdout.write("| | 40 ms ± 10 ms, 2 % lost | 44 ms, nothing lost | |\n|---|---:|---:|---|\n")
    for lines in zip(*([*one.bounds, *one.close, *one.besides] for one in runs), strict=True):
        cells = [f"{line.found}{'' if line.holds else ' (broken)'}" for line in lines]
        sys.stdout.write(f"| {lines[0].what} | {cells[0]} | {cells[1]} | {lines[0].bound} |\n")
    sys.exit(not runs[0].held)


if __name__ == "__main__":
    main()
