"""A slow press in real time: the stiffness that a hand feels, certified and delivered, in the tick and over wave links.

    python benchmarks/press.py [--seconds S] [--rounds N] [--only NAME ...] [--busy N] [--json FILE] [--markdown FILE]

The session is Example 1 with the stiffest couplings, and its devices live in wall time. The hand of dx pushes with a
force that rises to 5 N in 5 s and then stays. Stiffness at the hand is the force over the distance from the device to
its tool in the world, on average over the second half of the hold. Delivered is what the run gave; certified is the
static stiffness of the coupling, with the wave link's spring 2b/R in series.

A virtual machine may stand still as a whole, without any node's fault. A process of a higher priority than any node
counts that beside each run.

Every form is designed for this machine: the delays of the session at rest are measured first. The wave impedance b is
the greatest whose felt mass b R/2 is at most 50 g, with R measured in a run before.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from page import fill

from manyhands.launch.doctor.probe import Way, measure_profile
from manyhands.launch.doctor.profile import Stated, allowance, allowances_of_sites
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.run.outcome import Outcome
from manyhands.launch.run.recorder import Recorder
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import Session, load_session
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.rows import figures as names
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Figures, Observation

EXAMPLE = Path(__file__).parents[1] / "launch" / "sessions" / "example1.yaml"
PAGE = Path(__file__).parents[1] / "docs" / "remote" / "figures.md"
MARK = "press"
HAND = "dx"
FORCE = 5.0  # N
START = 1.0  # s; whoever pushes while users still join moves a tool that nothing holds
RISE = 5.0  # s
MASS = 0.05  # kg, the most that a wave link may feel like
PROBE = 3.0  # s of measuring the session at rest
PILOT = 3.0  # s of the run that measures R
FIRST_ROUND_TRIP = 0.006  # s, of the design of that run

# name, in words, and whether the loop closes in the tick, whether couplings run in their devices' processes, T of the
# site with the hand
FORMS: dict[str, tuple[str, bool, bool, float]] = {
    "tick": ("in the tick, 1 kHz", True, False, 1e-3),
    "tick-together": ("in the tick, 1 kHz, co-located", True, True, 1e-3),
    "wave-1": ("wave links, 1 kHz", False, False, 1e-3),
    "wave-1-together": ("wave links, 1 kHz, co-located", False, True, 1e-3),
    "wave-2": ("wave links, sites at 2 kHz", False, False, 5e-4),
    "wave-2-together": ("wave links, sites at 2 kHz, co-located", False, True, 5e-4),
    "wave-4": ("wave links, sites at 4 kHz", False, False, 2.5e-4),
    "wave-4-together": ("wave links, sites at 4 kHz, co-located", False, True, 2.5e-4),
    "wave-4-one": ("wave links, co-located, dx at 4 kHz, dy and dz at 1 kHz", False, True, 2.5e-4),
}
ALONE = "wave-4-one"
"""The form in which the other sites have the world's period: three at 4 kHz need more than two cores."""


@dataclass(frozen=True)
class Press:
    """One press.

    Attributes:
        form: its name.
        tau: the delay designed for, us.
        tolerance: the period tolerance designed for.
        coupling: the coupling's stiffness, N/m.
        round_trip: R of the wave link, ms; 0 in the tick.
        mass: what the wave link is felt as, g; 0 in the tick.
        certified: coupling and wave link in series, N/m.
        delivered: the measured stiffness, N/m.
        noise: standard deviation of the force at the end, mN.
        creep: motion of the device over the second half of the hold, um.
        account: the least interface account of all devices, mJ.
        bound: its bound at the end, -(E_0 + P t), mJ.
        late: the part of all ticks that were late.
        beyond: the part of the ticks of dx whose force came later than designed for.
        notices: of the run.
        stops: how often the machine itself stood still for more than 5 ms (:class:`Stops`); None where nobody watched.
    """

    form: str
    tau: float
    tolerance: float
    coupling: float
    round_trip: float
    mass: float
    certified: float
    delivered: float
    noise: float
    creep: float
    account: float
    bound: float
    late: float
    beyond: float
    notices: tuple[str, ...]
    stops: int | None = None


WATCH = """
import os, signal, sys
from array import array
from manyhands.launch.doctor.wakeup import wake_block
from manyhands.nodes.kernel.realtime import RealtimeWishes, prepare
from manyhands.protocol.clock import RealtimeClock
ends, late = [], array("q")
signal.signal(signal.SIGTERM, lambda *_: ends.append(1))
os.sched_setaffinity(0, {int(sys.argv[1])})
above = prepare(RealtimeWishes(memory=False, priority=96)).fifo.granted
clock = RealtimeClock()
while not ends:
    wake_block(2_000_000, clock, late)
print(sum(one > 5_000_000 for one in late) if above else "none")
"""
"""A process above every node: where it wakes late, no node could have woken either."""


class Stops:
    """Watches whether the machine itself stands still, for instance for another guest of its host."""

    def __init__(self) -> None:
        """Watch each processor from now on."""
        self._watching = [
            subprocess.Popen(  # noqa: S603 -- this interpreter, and the text above
                [sys.executable, "-c", WATCH, str(processor)], stdout=subprocess.PIPE, text=True
            )
            for processor in sorted(os.sched_getaffinity(0))
        ]

    def end(self) -> int | None:
        """Stop watching; how often it stood still, None where no such priority is permitted."""
        for one in self._watching:
            one.terminate()
        said = [one.communicate()[0].strip() for one in self._watching]
        return sum(map(int, said)) if all(word.isdecimal() for word in said) else None


class Traces(Recorder):
    """Keeps the traces of some nodes, by node and trace."""

    def __init__(self) -> None:
        self.rows: dict[tuple[str, str], list[np.ndarray[Any, np.dtype[np.float64]]]] = {}
        self.figures: dict[str, Figures] = {}

    def take(self, frame: bytes | None) -> None:
        """See :class:`Recorder`."""
        message = None if frame is None else decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Observation):
            for name, trace in message.traces.items():
                self.rows.setdefault((message.node, name), []).append(trace)
            self.figures[message.node] = message.figures

    def whole(self, node: str, trace: str) -> np.ndarray[Any, np.dtype[np.float64]]:
        """All rows of a trace."""
        return np.vstack(self.rows[node, trace])


def session_of(form: str, round_trip: float, rise: float) -> Session:
    """The session of a press that is not designed for any delay yet."""
    _, in_tick, together, period = FORMS[form]
    overrides = ["design.objective=stiffest", f"colocate={str(together).lower()}",
                 f'devices.{HAND}.hand.force="{FORCE:g}*max(min((t - {START:g})/{rise:g}, 1), 0)"',
                 "devices.dy.hand.force=0", "devices.dz.hand.force=0"]  # fmt: skip
    if not in_tick:
        for name in ("cx", "cy", "cz"):
            own = 1e-3 if form == ALONE and name != "cx" else period
            link = f"{{mass: {MASS}, round_trip: {round_trip:.6g}, period: {own:g}}}"
            overrides.append(f"couplings.{name}.wave_link={link}")
    return load_session(EXAMPLE, overrides)


def designed(session: Session) -> Prepared:
    """The session, designed for what its ticks take on this machine now."""
    plan = Plan(session)
    profile = measure_profile(plan, Way.of_run(plan), PROBE)
    chosen = allowance(profile, session.device_period, Stated.of(session))
    sites = {name: one.tau for name, one in allowances_of_sites(profile, session).items()}
    return prepare(session.with_delay(chosen.tau, chosen.period_tolerance, sites))


def run(prepared: Prepared, seconds: float) -> tuple[Outcome, Traces]:
    """The session for so long, with its traces."""
    traces = Traces()
    outcome = Supervisor(
        prepared,
        clock=REALTIME,
        reach=reach(prepared, "ipc", insecure=False),
        ticks=round(seconds / prepared.session.period),
        record=False,
        recorder=traces,
    ).run()
    if outcome.faults:
        raise SystemExit("; ".join(outcome.faults))
    return outcome, traces


def round_trip(traces: Traces) -> float:
    """R of dx's wave link, s."""
    return 1e-6 * (
        traces.figures["cx"][names.WAVE_LAG] + traces.figures["environment"].table(names.of(names.WAVE_LAG))["cx"]
    )


def press(form: str, hold: float) -> Press:
    """Design for this machine, press, and measure."""
    R = FIRST_ROUND_TRIP
    if not FORMS[form][1]:
        pilot = designed(session_of(form, R, RISE))
        R = round_trip(run(pilot, PILOT)[1])
    prepared = designed(session_of(form, R, RISE))
    watching = Stops()
    try:
        outcome, traces = run(prepared, START + RISE + hold)
    finally:
        stops = watching.end()
    certificate = prepared.certificate_of("cx")
    if certificate is None or certificate.spring_damper is None:
        raise SystemExit(f"{form}: found no certified spring; expected one")
    coupling = float(certificate.spring_damper.stiffness[0, 0])
    link = prepared.session.wave_links.get("cx")
    R = 0.0 if link is None else round_trip(traces)
    b = 0.0 if link is None else float(link.impedance(1)[0, 0])
    own, world = prepared.session.period_of(HAND), prepared.session.period
    x, f = traces.whole(HAND, names.DISPLACEMENT)[:, 0], traces.whole(HAND, names.FORCE)[:, 0]
    tool = traces.whole("environment", names.TOOL_POSITION)[:, 0]
    tau = traces.whole(HAND, names.TAU)[:, 0]
    half, half_world = round(0.5 * hold / own), round(0.5 * hold / world)
    apart = float(np.mean(x[-half:]) - np.mean(tool[-half_world:]))
    second = max(1, round(1.0 / own))
    nodes = outcome.report["nodes"]
    devices = [node for node in nodes.values() if node["role"] == "device"]
    return Press(
        form,
        certificate.tau * 1e6,
        certificate.period_tolerance,
        coupling,
        R * 1e3,
        0.5 * b * R * 1e3,
        1.0 / (1.0 / coupling + (0.5 * R / b if b else 0.0)),
        float(-np.mean(f[-half:])) / apart,
        float(np.std(f[-half:])) * 1e3,
        float(np.mean(x[-second:]) - np.mean(x[-half : -half + second])) * 1e6,
        min(node["interface"]["min"] for node in devices) * 1e3,
        -1e3 * prepared.session.faults.tank.by(START + RISE + hold),
        sum(node["late"] for node in devices) / sum(node["ticks"] for node in devices),
        float(np.mean(tau > certificate.tau * 1e6)),
        outcome.notices,
        stops,
    )


@contextmanager
def beside(count: int) -> Iterator[None]:
    """So many programs that compute without a pause."""
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def table(rounds: Sequence[Press]) -> str:
    """The figures by form, as Markdown."""
    lines = [
        "| form | τ designed for, us | ρ | coupling, N/m | R, ms | felt mass, g | certified, N/m | delivered, N/m "
        "| force noise, mN | creep, um | least account, mJ | late | later than τ | stops of the machine |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for form, (words, *_) in FORMS.items():
        own = [one for one in rounds if one.form == form]
        if not own:
            continue

        def mid(name: str, own: list[Press] = own) -> float:
            return median(getattr(one, name) for one in own)

        spread = f"{min(one.delivered for one in own):.0f}-{max(one.delivered for one in own):.0f}"
        cells = [
            words, f"{mid('tau'):.0f}", f"{mid('tolerance'):.2f}", f"{mid('coupling'):.0f}", f"{mid('round_trip'):.2f}",
            f"{mid('mass'):.0f}", f"{mid('certified'):.0f}", f"**{mid('delivered'):.0f}** ({spread})",
            f"{mid('noise'):.1f}", f"{mid('creep'):.1f}",
            f"{min(one.account for one in own):.3g} of {own[0].bound:g}", f"{mid('late'):.2%}", f"{mid('beyond'):.2%}",
            ", ".join("?" if one.stops is None else str(one.stops) for one in own),
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> int:
    """Press in every form, by turns."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="how long the force is held")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", nargs="*", choices=list(FORMS), default=list(FORMS))
    parser.add_argument("--busy", type=int, default=0, help="how many programs compute without a pause beside it")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    done: list[Press] = []
    for number in range(given.rounds):
        for form in random.sample(given.only, len(given.only)):
            began = time.monotonic()
            with beside(given.busy):
                done.append(press(form, given.seconds))
            last = done[-1]
            took = time.monotonic() - began
            print(f"round {number + 1}, {form}: {last.delivered:.0f} N/m of {last.certified:.0f} ({took:.0f} s)")
            for notice in last.notices:
                print(f"  {notice}")
    print(table(done))
    if given.json:
        given.json.write_text(json.dumps([asdict(one) for one in done], indent=1) + "\n")
    if given.markdown:
        fill(given.markdown, MARK, table(done))
    return 0


if __name__ == "__main__":
    sys.exit(main())
