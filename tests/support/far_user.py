"""Three users of Example 1 by real processes, one of them across a WAN: what the run promised, and what was kept.

    python -m tests.support.far_user [SECONDS]

The user x, its device and its coupling, is in the far namespace and reaches the world through a wave link. The users y
and z close their loops within the tick, in the near namespace, where the session is launched.

*An ideal line of the same R* is the same session in one process
(:class:`manyhands.launch.audit.simulation.Simulation`) with the same hands, the same certificate and a line that delays
every wave by a constant number of ticks, and loses none. The delays are what the run shows: the sums of waves at the
two ends are two curves, one of which is late.

*Within 1 %*: the root mean square of the difference of a local user's displacement x in both runs, over that of x in
the ideal run, from :data:`START` on, at the instants at which the device was sampled. A machine that is busy with other
work is late, makes all later ticks of the users in the tick later, and freezes who is late for long. So the table has
two more runs: one in simulated time, without a machine, and one by real processes over a wire that neither jitters nor
loses. What the last two have in common is the machine's.
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

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import RecordedRun, read_run
from manyhands.launch.session import load_session
from manyhands.nodes.rows.figures import DISPLACEMENT, FORCE, INSTANTS, WAVE, WAVE_LEDGER
from manyhands.nodes.rows.figures import of as stated_of
from manyhands.nodes.wave_link.ends import JOINING, OUTLIERS
from manyhands.nodes.wave_link.faces import UserFace, WorldFace

from .commands import MANYHANDS, run
from .wan import Side, Wan, Way, Wire, open_wan

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
"""Wave impedance, N·s/m: at R = 0.09 s it is felt as 0.34 kg, and as 167 N/m against a wall."""

PATIENCE: Final = 120.0
"""How much longer than the session a process may take, s: it joins, and the recording is written."""

ROUNDING: Final = 1e-12
"""J, of a ledger's sums."""

CLOSE: Final = 0.01
"""The most that a local user's motion may differ by, relative."""

OVERRIDES: Final = (
    f"couplings.cx.wave_link={{b: {b:g}}}",
    "design.objective=stiffest",
    "design.tau=0.001",
    "design.period_tolerance=1.0",
    *(
        f"devices.{name}.hand.{key}={value}"
        for name, amplitude, frequency in (("dx", 0.02, 0.4), ("dy", 0.015, 0.3), ("dz", -0.015, 0.5))
        for key, value in (
            ("force", "0"),
            ("stiffness", "200"),  # N/m
            ("motion", f'"step(t - {START:g})*{amplitude:g}*sin(2*pi*{frequency:g}*(t - {START:g}))"'),
        )
    ),
)
SET: Final = tuple(word for override in OVERRIDES for word in ("--set", override))


# --- the run


def run_across(one: Wan, folder: Path, seconds: float) -> tuple[RecordedRun, dict[str, Any], list[str]]:
    """Run the session, its far nodes by invitation; the recording, the report, and what was wrong with the run."""
    certificate, keys = folder / "c.json", folder / "keys"
    run("invite", EXAMPLE, *SET, "--keys", keys)
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
            *("node", name, "--bundle", str(folder / f"{name}.bundle"), "--connect", f"tcp://{place}"),
            *("--key", str(keys / "private" / f"{name}.key")),
        )
        for name in FAR
    }
    with ExitStack() as stack:
        home = stack.enter_context(process(one, "near", launch))
        guests = [stack.enter_context(process(one, "far", nodes[name])) for name in FAR]
        ended = []
        for name, of in zip(("launch", *FAR), (home, *guests), strict=True):
            _, error = of.communicate(timeout=seconds + PATIENCE)
            if of.returncode:
                ended += [line for line in error.splitlines() if name != "launch" or line.startswith("error: ")]
    if not (folder / "run.json").exists():
        raise AssertionError(f"found no report; expected one: {'; '.join(ended)}")
    return read_run(folder / "run.mcap"), json.loads((folder / "run.json").read_text()), ended


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
    _delay(simulation.links["cx"].world, there)
    _delay(simulation.links["cx"].user, back)
    traces = simulation.traces(ticks)
    simulation.run(ticks, traces=traces)
    return {(node, kept.topic.trace): kept.values for node, topics in traces.by_node.items() for kept in topics}


def far_session(folder: Path, *overrides: str) -> Prepared:
    """The session under the run's certificate."""
    return prepare(load_session(EXAMPLE, [*OVERRIDES, *overrides]), folder / "c.json")


def jittering(folder: Path, ticks: int, wire: Wire) -> Rows:
    """The same session over a WAN in simulated time: what the machine adds is missing, and nothing else."""
    simulation = Simulation(far_session(folder))
    faces = simulation.links["cx"].world, simulation.links["cx"].user
    for number, face in enumerate(faces):
        _carry(face, Way(number, wire.seed), wire)
    traces = simulation.traces(ticks)
    simulation.run(ticks, traces=traces)
    return {(node, kept.topic.trace): kept.values for node, topics in traces.by_node.items() for kept in topics}


def _carry(face: UserFace | WorldFace, way: Way, wire: Wire) -> None:
    """Put a way of a WAN before a face, which measures while it joins how late the messages are, as a node's does."""
    hear, messages = (
        face.hear,
        list[tuple[int, Sequence[float], float]](),
    )  # no buttons, and nothing turns
    began = round(2.0 * (wire.delay + wire.jitter) / T)  # by then messages come
    settled = began + round(JOINING / T)

    def put(n: int, U: Sequence[float], G: float, life: int = 0, buttons: int = 0, riders: object = ()) -> bool:
        now = len(messages)
        way.put(now.to_bytes(8, "big"), wire, now * T)
        messages.append((n, U, G))
        news = [hear(*messages[int.from_bytes(packet, "big")], life) for packet in way.arrived(now * T)]
        if now == began:
            face.measure(int(OUTLIERS * (settled - began)))
        if now == settled:
            face.set_depth(face.measured)
        return any(news)

    face.hear = put  # type: ignore[method-assign]


def _delay(face: UserFace | WorldFace, ticks: int) -> None:
    """Put a line before a face: it hears each message so many ticks later."""
    hear, line = face.hear, deque[tuple[int, Sequence[float], float]]()

    def put(n: int, U: Sequence[float], G: float, life: int = 0, buttons: int = 0, riders: object = ()) -> bool:
        line.append((n, U, G))
        return len(line) > ticks and hear(*line.popleft(), life)

    face.hear = put  # type: ignore[method-assign]


def instants(rows: Rows, node: str) -> Array:
    """When each tick of a node was, s: as its device noted it; every tick of a simulation is at its time.

    The world ticks with the users in the tick.
    """
    device = {"cx": "dx", "environment": LOCAL[0]}.get(node, node)
    if (device, INSTANTS) not in rows:
        return np.arange(len(rows[device, DISPLACEMENT])) * T
    return rows[device, INSTANTS][:, 0] * 1e-9


def delays(rows: Rows) -> tuple[float, float]:
    """How much later the waves of one end are played at the other, s: the user's at the world, the world's at the user.

    What a face has sent, and what the other has played, are the same curve, a time apart: that which leaves the least
    square between them. The clock of the far machine enters both ways, with opposite signs.
    """
    h = math.sqrt(2.0 * b)
    user, world, at_user, at_world = (rows[node, of][:, 0] for of in (WAVE, FORCE) for node in ("cx", "environment"))
    at = instants(rows, "cx"), instants(rows, "environment")
    up = _apart((at[0], user - 2.0 / h * at_user), (at[1], world))
    return up, _apart((at[1], world + 2.0 / h * at_world), (at[0], user))


def _apart(sent: tuple[Array, Array], played: tuple[Array, Array]) -> float:
    """By how much, s, the sum of one wave is later than that of the other, each with its instants; to 0.1 ms."""
    (t, earlier), (t_played, later) = (_sum(*wave) for wave in (sent, played))
    grid = np.arange(START, min(t[-1], t_played[-1]), 1e-3)
    expected = np.interp(grid, t_played, later)

    def left(late: float) -> float:
        return float(np.std(expected - np.interp(grid - late, t, earlier)))

    coarse = min(np.arange(0.0, 0.5, 0.002), key=left)
    return float(min(np.arange(coarse - 0.003, coarse + 0.003, 0.0001), key=left))


def _sum(t: Array, wave: Array) -> tuple[Array, Array]:
    size = min(len(t), len(wave))
    whole = np.isfinite(t[:size]) & np.isfinite(wave[:size])
    return t[:size][whole], T * np.cumsum(wave[:size][whole])


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


def bounds(run: RecordedRun, rows: Rows, report: Mapping[str, Any], tank: float) -> list[Line]:
    """Every ledger and interface account, and the two-port; ``tank`` is the wave link's, J.

    What has entered the two-port at both ends is added up at the instants of the user's figures. The two clocks differ
    by less than a wave needs, so neither end has heard of anything that the other had not done by then.
    """
    nodes = report["nodes"]
    gone = run.recorded.roles.keys() - nodes.keys()
    lines = [Line("nodes that were given up", ", ".join(sorted(gone)) or "none", "none", not gone)]
    for name, node in nodes.items():
        if "ledger" in node:
            ledger = node["ledger"]
            lines.append(_at_least(f"{name}: least ledger", ledger["min"], ledger["min"] - ledger["margin"]))
        if "interface" in node:
            account = node["interface"]
            lines.append(
                _at_least(f"{name}: least interface account", account["min"], account["min"] - account["margin"])
            )
    at_cx = [(tick, of.get(WAVE_LEDGER)) for tick, of in run.figures["cx"]]
    at_environment = [(tick, of.table(stated_of(WAVE_LEDGER)).get("cx")) for tick, of in run.figures["environment"]]
    (t, at_user), (t_world, at_world) = (
        (
            _at(rows, node, [tick for tick, energy in told if energy is not None]),
            [energy for _, energy in told if energy is not None],
        )
        for node, told in (("cx", at_cx), ("environment", at_environment))
    )
    both = np.array(at_user) + np.interp(t, t_world, at_world)
    lines.append(_at_least("wave link: least energy that has entered it", float(both.min()), -2.0 * tank))
    return lines


def _at(rows: Rows, node: str, ticks: Sequence[int]) -> Array:
    """When these ticks of a node were, s."""
    t = instants(rows, node)
    known = np.flatnonzero(np.isfinite(t))
    return np.asarray(np.interp(ticks, known, t[known]))


def _at_least(what: str, energy: float, bound: float) -> Line:
    return Line(what, f"{1e3 * energy:.4g} mJ", f"at least {1e3 * bound:.4g} mJ", energy >= bound - ROUNDING)


def motion(device: str, rows: Rows, expected_rows: Rows) -> float:
    """By how much the x of a device differs in two runs, relative to that in the second, root mean square.

    It is compared at the instants of the first one. A late tick of the users in the tick makes all later ones later.
    """
    t, x = instants(rows, device), rows[device, DISPLACEMENT][:, 0]
    expected = np.interp(t, instants(expected_rows, device), expected_rows[device, DISPLACEMENT][:, 0])
    there = np.isfinite(x) & (t >= START)
    return float(np.sqrt(np.mean((x - expected)[there] ** 2) / np.mean(expected[there] ** 2)))


@dataclass(frozen=True)
class Found:
    """What a run across a WAN has shown.

    Attributes:
        bounds: what was promised; none in simulated time.
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


def certified(folder: Path) -> None:
    """Design the session; the certificate goes into ``folder``."""
    run("design", EXAMPLE, *SET, "-o", folder / "c.json")


def in_simulated_time(wire: Wire, folder: Path, seconds: float) -> Found:
    """The session across a WAN in simulated time, beside the ideal line of its R."""
    return Found((), *compared(folder, jittering(folder, round(seconds / T), wire)))


def in_real_time(wire: Wire, folder: Path, seconds: float) -> Found:
    """The session across a WAN by real processes, beside the ideal line of its R.

    Raises:
        Refused: the machine permits no namespaces.
    """
    with open_wan(wire) as one:
        recorded, report, ended = run_across(one, folder, seconds)
    rows = {(node, kept.topic.trace): kept.values for (node, _), kept in recorded.traces.items()}
    session, nodes, link = far_session(folder).session, report["nodes"], report["wave_links"]["cx"]
    here = [name for name in ("dx", *LOCAL) if name in nodes]
    behind = {name: (np.nanmax(instants(rows, name)) - recorded.ticks * T) / T for name in here}
    besides = {
        "play-out of both ends": f"{1e3 * (link['round_trip'] - T):.1f} ms",
        "silences of both ends": str(link["silences"]),
        "ticks behind the clock in the end": ", ".join(f"{name} {ticks:.0f}" for name, ticks in behind.items()),
        "late ticks": ", ".join(f"{name} {nodes[name]['late'] / nodes[name]['ticks']:.2%}" for name in here),
        "ticks of frozen users": str(nodes["environment"].get("incidents", {}).get("frozen", 0)),
    }
    close, common = compared(folder, rows)
    promised = bounds(recorded, rows, report, session.wave_links["cx"].tank)
    promised.insert(0, Line("faults of the run", "; ".join(ended) or "none", "none", not ended))
    return Found(promised, close, [*common, *(Line(what, figure, "", True) for what, figure in besides.items())])


def compared(folder: Path, rows: Rows) -> tuple[list[Line], list[Line]]:
    """How close the motions of a run are to those over the ideal line of its R, and figures of both."""
    ways = delays(rows)
    least = delays(ideal(folder, round(2.0 * START / T)))  # what the faces take without a line
    there, back = (max(0, round((way - own) / T)) for way, own in zip(ways, least, strict=True))
    last = max(float(np.nanmax(instants(rows, name))) for name in ("dx", *LOCAL))
    expected = ideal(folder, round(last / T) + 2, there, back)
    apart = {name: motion(name, rows, expected) for name in ("dx", *LOCAL)}
    what = "motion, from that over the ideal line"
    close = [
        Line(f"{name}: {what}", f"{apart[name]:.3%}", f"at most {CLOSE:.0%}", apart[name] <= CLOSE) for name in LOCAL
    ]
    return close, [
        Line(f"dx: {what}", f"{apart['dx']:.3%}", "", True),
        Line("R, from tick to tick", f"{1e3 * sum(ways):.1f} ms", "", True),
        Line("way to the world, of that (with the far clock)", f"{1e3 * ways[0]:.1f} ms", "", True),
        Line("ideal line", f"{there} and {back} ticks", "", True),
    ]


def main() -> None:
    """Print a table of all runs; the exit code is 1 if anything does not hold across the WAN."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        certified(folder)
        runs = {"simulated time": in_simulated_time(WIRE, folder, seconds)}
        for title, wire in (("processes", WIRE), ("processes, 44 ms and nothing lost", QUIET)):
            runs[title] = in_real_time(wire, folder, seconds)
    sys.stdout.write(f"| | {' | '.join(runs)} | |\n|---|{'---:|' * len(runs)}---|\n")
    lines = [{line.what: line for line in (*one.bounds, *one.close, *one.besides)} for one in runs.values()]
    for what in lines[-1]:
        cells = [f"{of[what].found}{'' if of[what].holds else ' (broken)'}" if what in of else "–" for of in lines]
        sys.stdout.write(f"| {what} | {' | '.join(cells)} | {lines[-1][what].bound} |\n")
    sys.exit(not all(runs[title].held for title in ("simulated time", "processes")))


if __name__ == "__main__":
    main()
