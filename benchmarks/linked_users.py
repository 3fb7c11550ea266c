"""The number of users behind wave links that one environment's process serves at 1 kHz, and what each of them costs.

    python benchmarks/linked_users.py [--users 1 4 16 ...] [--interval 1 4] [--compiled] [--json FILE] [--plot FILE]
                                      [--markdown FILE]

The environment is the real process with its real bundle, at a world rate of 1 kHz by its own clock. One other process
plays all the users' ends, with real handshakes and real waves: 64 devices with their couplings would not fit two
processors. Each user joins at rest; then its tool moves by 1 mm, and its waves carry the energy that they cost. The
environment's own count says which ticks were late: they had not ended when the next was due, or were never done. A
number of users holds while at most 1 % are. Cost is the environment's processor time, of its loop and of ZeroMQ's
thread.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import proc
from loop_ours import COMPILED, install_compiled
from page import add_outputs, fill, make_folders
from users_curve import HOLDS, curve, headline, verdict
from users_load import Broken, Served, scheduled, serving, session_text

from manyhands.nodes.link.supervisor_line import NOT_AT_ALL
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import WaveWriter, decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Telemetry

NUMBERS = (1, 4, 8, 16, 32, 48, 64, 96, 128)
TARGET = 64
IMPEDANCE = 20.0  # N*s/m
AMPLITUDE, FREQUENCY = 1e-3, 2.0  # m and Hz, of every tool
RESTING, STARTING = 1.5, 0.5  # s in which users rest while they join, and in which their motion then grows
SETTLING = RESTING + STARTING  # s before the counted ticks
AT_ONCE = 16  # waves that are read of one link at a time
MARK = "linked-users"


@dataclass(frozen=True)
class LinkedPoint:
    """How one number of linked users went.

    Attributes:
        users: how many.
        interval: ticks from one wave to the next, at both ends.
        compiled: whether the environment's tick is compiled.
        ticks: how many the environment has done.
        late: share of the ticks that had not ended when the next was due, or were never done.
        loop_us: processor time of the environment's loop, us a tick.
        zeromq_us: that of ZeroMQ's thread.
        waves: received by the users, a second in all.
        generator_cpu: processors that this process used.
        resident: the environment's memory at the end, MiB.
        silences: times that the environment heard nothing of a user for 30 ms.
    """

    users: int
    interval: int
    compiled: bool
    ticks: int
    late: float
    loop_us: float
    zeromq_us: float
    waves: float
    generator_cpu: float
    resident: float
    silences: int


def measure(users: int, interval: int, seconds: float, compiled: bool) -> LinkedPoint:
    """Serve ``users`` for ``seconds`` with a wave in every ``interval`` ticks.

    Raises:
        Broken: the environment ended, or a user is not active, so the load was not the one that was meant.
    """
    link = f", wave_link: {{b: {IMPEDANCE:g}{f', interval: {interval * 0.001:g}' if interval > 1 else ''}}}"
    with serving(session_text(users, link), package=COMPILED if compiled else None) as served:
        users_ = _Users(served, interval)
        with scheduled(users):
            users_.run(0, round(SETTLING * 1e9 / served.period))
            before, used = users_.telemetry(), _used(served.pid)
            own, began, heard = time.process_time(), time.monotonic(), users_.heard
            users_.run(users_.ticks, users_.ticks + round(seconds * 1e9 / served.period))
            lasted = time.monotonic() - began
            after = users_.telemetry()
            loop, zeromq = (now - then for now, then in zip(_used(served.pid), used, strict=True))
            own = time.process_time() - own
        heard = users_.heard - heard
        resident = proc.resident(served.pid) or 0.0
        served.finish()
    silences = sum(after.figures.table(names.of(names.WAVE_SILENCES)).values())
    if out := after.figures[names.FROZEN]:
        raise Broken(f"found {out:.0f} of {users} users that are not active; expected none")
    periods = lasted * 1e9 / served.period
    ticks, late = after.tick - before.tick, after.figures[names.LATE] - before.figures[names.LATE]
    return LinkedPoint(
        users,
        interval,
        compiled,
        ticks,
        min(1.0, late / periods),  # both are counted in messages, a tenth of a second apart
        1e6 * loop / periods,
        1e6 * zeromq / periods,
        heard / lasted,
        own / lasted,
        resident,
        int(silences),
    )


def _used(pid: int) -> tuple[float, float]:
    """Processor time of the environment's loop and of its other threads, s."""
    times = [proc.thread_seconds(pid, thread) for thread in proc.threads(pid)]
    return times[0], sum(times[1:])


class _Users:
    """The users' ends of all wave links.

    Attributes:
        ticks: periods that have passed since the first.
        heard: waves that the environment has sent.
    """

    def __init__(self, served: Served, interval: int) -> None:
        self._served, self._interval = served, interval
        self._writer = WaveWriter(1)
        self._sums = math.sqrt(IMPEDANCE / 2.0)  # U of a tool without force, W^(1/2)*s/m
        self._shipped = [0.0] * len(served.links)
        self._before = [0.0] * len(served.links)
        self._latest = b""  # of the environment's messages
        self.ticks = self.heard = 0

    def telemetry(self) -> Telemetry:
        """The environment's latest.

        Raises:
            Broken: its latest message is none.
        """
        latest = decode(self._latest, MAX_CONTROL_BYTES)
        if not isinstance(latest, Telemetry):
            raise Broken(f"the environment sent {type(latest).__name__}; expected telemetry")
        return latest

    def run(self, first: int, last: int) -> None:
        """Do the ticks from ``first`` to ``last``, and read what the environment sends its supervisor."""
        served, interval = self._served, self._interval
        links, period, T = served.links, served.period, served.period / 1e9
        angle, part = 2.0 * math.pi * FREQUENCY * T, 2.0 * math.pi / len(links)
        tick = first
        while tick < last:
            served.clock.sleep_until(Instant(served.epoch + tick * period))
            grown = self._sums * AMPLITUDE * min(1.0, max(0.0, (tick * T - RESTING) / STARTING))
            for i, link in enumerate(links):
                if (tick - i) % interval == 0:
                    U = grown * math.sin(angle * tick + part * i)
                    moved = U - self._before[i]
                    self._before[i] = U
                    self._shipped[i] += moved * moved / (2.0 * T * interval)
                    link.send(self._writer.frame(tick + 1, (U,), self._shipped[i]))
            for link in links:
                for _ in range(AT_ONCE):
                    if link.recv(NOT_AT_ALL) is None:
                        break
                    self.heard += 1
            while (received := served.hub.recv()) is not None:
                self._latest = received[1]
            now = served.clock.now()
            tick = max(tick + 1, -((served.epoch - now) // period))  # a wave that this process is late for is lost
        self.ticks = tick


def described(point: LinkedPoint) -> str:
    """What a number of users gave, as progress."""
    return (
        f", {series(point.interval, point.compiled)}: late {point.late:.2%}, loop {point.loop_us:.0f} us a tick "
        f"({point.loop_us / point.users:.1f} a user), ZeroMQ {point.zeromq_us:.0f}, generator "
        f"{point.generator_cpu:.2f} processors, {point.waves:.0f} waves a second"
    )


def series(interval: int, compiled: bool) -> str:
    """The name of a curve."""
    waves = "a wave in every tick" if interval == 1 else f"a wave in {interval} ticks"
    return f"{waves}, compiled" if compiled else waves


def table(content: Mapping[str, Any]) -> str:
    """All curves."""
    lines = [
        headline(content),
        "",
        "| waves, tick | users | late | loop, us a tick | a user | ZeroMQ's thread, us a tick | waves a second "
        "| generator, processors | memory, MiB | silences |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    points = [LinkedPoint(**one) for one in content["points"]]
    lines += [
        f"| {series(p.interval, p.compiled)} | {p.users} | {p.late:.2%} | {p.loop_us:.0f} | {p.loop_us / p.users:.1f} "
        f"| {p.zeromq_us:.0f} | {p.waves:.0f} | {p.generator_cpu:.2f} | {p.resident:.0f} | {p.silences} |"
        for p in points
    ]
    lines.append("")
    for name in dict.fromkeys(series(p.interval, p.compiled) for p in points):
        held = [p.users for p in points if series(p.interval, p.compiled) == name and p.late <= HOLDS]
        lines.append(f"- {name}: {verdict(max(held, default=0), TARGET)}")
    return "\n".join(lines)


def plot(content: Mapping[str, Any], path: Path) -> None:
    """Processor time and late ticks against the number of users."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    points = [LinkedPoint(**one) for one in content["points"]]
    names_ = list(dict.fromkeys(series(p.interval, p.compiled) for p in points))
    figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(7.0, 6.0), layout="constrained")
    styles = (("#0072B2", "o"), ("#E69F00", "s"), ("#009E73", "^"), ("#D55E00", "D"))
    for name, (colour, marker) in zip(names_, styles, strict=False):
        own = [p for p in points if series(p.interval, p.compiled) == name]
        users = [p.users for p in own]
        above.plot(users, [p.loop_us + p.zeromq_us for p in own], color=colour, marker=marker, label=name)
        below.plot(users, [100.0 * max(p.late, 1e-4) for p in own], color=colour, marker=marker)
    above.axhline(1000.0, color="0.3", linestyle="--", linewidth=1.0, label="the period")
    above.set(ylabel="environment, us of its processor a tick", ylim=(0.0, None))
    below.axhline(100.0 * HOLDS, color="0.3", linestyle="--", linewidth=1.0)
    below.set(xlabel="users behind wave links", ylabel="late ticks, %", yscale="log")
    for axes in (above, below):
        axes.grid(True, alpha=0.3)
    above.legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main() -> None:
    """Measure, print a table, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--users", type=int, nargs="+", default=list(NUMBERS))
    parser.add_argument("--interval", type=int, nargs="+", default=[1, 4], help="ticks from one wave to the next")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each run (default: %(default)s)")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--compiled", action="store_true", help="with a compiled environment as well")
    parser.add_argument("--install", action="store_true", help="compile the tick, and end")
    add_outputs(parser)
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # what it has started is ended, too
    if arguments.install:
        sys.exit(0 if install_compiled() else "no compiled tick: see the messages above")
    if min(*arguments.users, *arguments.interval, arguments.repeats) < 1 or arguments.seconds <= 0.0:
        parser.error("expected at least one user, one tick and one repeat, and more than 0 seconds")
    if arguments.compiled and not any(COMPILED.glob("*.so")):
        parser.error(f"found no extension in {COMPILED.name}; expected it there: run with --install first")
    make_folders(arguments.json, arguments.plot)
    points = [
        point
        for compiled in ((False, True) if arguments.compiled else (False,))
        for interval in arguments.interval
        for point in curve(
            sorted(arguments.users),
            arguments.repeats,
            partial(measure, interval=interval, seconds=arguments.seconds, compiled=compiled),
            described,
        )
    ]
    content: dict[str, Any] = {
        "machine": proc.machine(),
        "seconds": arguments.seconds,
        "repeats": arguments.repeats,
        "points": [asdict(point) for point in points],
    }
    text = table(content)
    print(text)
    if arguments.markdown is not None:
        fill(arguments.markdown, MARK, text)
    if arguments.plot is not None and points:
        plot(content, arguments.plot)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
