"""`manyhands doctor` as a whole: examine the machine, measure, and print tables with advice."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from manyhands.launch.doctor.advice import QUANTILES, Advice, Worth, advice, stiffness_object
from manyhands.launch.doctor.colocation import Where, choose, settle_colocation
from manyhands.launch.doctor.compiled import TURNS, CompiledWorth, measure_worth
from manyhands.launch.doctor.machine import Machine, examine
from manyhands.launch.doctor.probe import MOST_PROCESSES, Form, Measured, measure
from manyhands.launch.doctor.profile import (
    LEAST_KEPT,
    ProbeFailed,
    ProbeInterrupted,
    Profile,
    Stated,
    cache_folder,
    keep_profile,
)
from manyhands.launch.doctor.rates import form_advice, form_figures, print_rates, rates_object
from manyhands.launch.doctor.wakeup import Spread
from manyhands.launch.files import EXIT_BAD_INPUT, EXIT_FAILED, EXIT_OK
from manyhands.launch.look.display import say, titled_table
from manyhands.launch.output import print_json
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.topology import chains_of, require_runnable
from manyhands.launch.session import Session
from manyhands.nodes.kernel.realtime import Grant

_WAYS = {
    "default_slack": "timer slack 50 us (the default)",
    "least_slack": "timer slack 1 ns (requested by nodes)",
    "fifo": "SCHED_FIFO",
}


@contextmanager
def measuring(console: Console) -> Iterator[Callable[[str], None]]:
    """Show what is being measured; yields a function that takes the text.

    The line is drawn only when the text changes: the thread of a spinner would disturb the measurement.
    """
    if not console.is_terminal:
        yield lambda text: say(console, f"measuring {text}")
        return
    with Live(console=console, auto_refresh=False, transient=True) as live:
        yield lambda text: live.update(Text(f"measuring {text} ..."), refresh=True)


def print_machine(console: Console, machine: Machine, granted: Mapping[str, Grant]) -> None:
    """Print the machine's properties and what it permits."""
    table = Table(title="this machine", title_justify="left", show_header=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for name, text in machine_rows(machine).items():
        table.add_row(name, escape(text))
    table.add_section()
    for name, grant in granted.items():
        mark = "[green]yes[/green]" if grant.granted else "[yellow]no[/yellow]"
        table.add_row(name.replace("_", " "), f"{mark}: {escape(grant.answer)}")
    console.print(table)


def machine_rows(machine: Machine) -> dict[str, str]:
    """The machine's properties as texts, by the name of the row."""
    unknown = "unknown"
    memory = "unlimited" if machine.memory_limit is None else f"{machine.memory_limit / 2**20:g} MiB"
    raises, locks = _capability("CAP_SYS_NICE", machine.may_raise), _capability("CAP_IPC_LOCK", machine.may_lock)
    share = "unbounded" if machine.realtime_share is None else f"{machine.realtime_share:.0%} of a processor"
    where = "a container, " if machine.container else ""
    return {
        "kernel": f"{machine.kernel}, {machine.preemption}",
        "runs on": where
        + ("hardware, as far as can be seen" if machine.virtual is None else f"{machine.virtual} (virtual)"),
        "processors": f"{machine.processors}; usable: {', '.join(map(str, machine.usable))}",
        "frequency governor": unknown if machine.governors is None else ", ".join(machine.governors),
        "clock source": machine.clock_source or unknown,
        "real-time priority": f"RLIMIT_RTPRIO {machine.priority_limit}, {raises}",
        "real-time threads get": share,
        "locked memory": f"RLIMIT_MEMLOCK {memory}, {locks}",
        "Python": f"{machine.python}, {'with' if machine.gil else 'without'} a global lock",
        "tick": "compiled" if machine.compiled else "pure Python; a wheel built beside a C compiler has it compiled",
        "ZeroMQ": f"{machine.zeromq} (pyzmq {machine.pyzmq}), CURVE {_yes(machine.curve)}, ipc {_yes(machine.ipc)}",
    }


def print_measured(console: Console, measured: Measured, period: float) -> None:
    """Print how late a process wakes, and how long a tick takes."""
    title, columns = f"how late a process wakes, T = {period * 1e3:g} ms [µs]", ("median", "p99", "p99.9", "max")
    table = titled_table(title, ["way"], columns)
    for way, spread in measured.waking.late.items():
        table.add_row(_WAYS[way], *_row(spread))
    console.print(table)
    table = titled_table("a tick from sample to force, of a session at rest [µs]", ["way"], (*columns, "late"))
    for found in measured.ticking:
        table.add_row(found.way.text, *_row(found.tau), f"{found.late / found.ticks:.2%}")
    console.print(table)


def print_worth(console: Console, measured: Measured, worth: Worth, found: tuple[Advice, ...]) -> None:
    """Print the stiffness that can be certified with the measured delays, and the advice."""
    loop = worth.loop
    title = f"{loop.session}: weakest device, T = {loop.period * 1e3:g} ms"
    table = titled_table(title, [f"certified stiffness below [{loop.units()('N/m')}]"], ("at the median", "at p99.9"))
    limit = f"{worth.no_delay:.0f}"
    table.add_row("no delay", limit, limit)
    for ticking in measured.ticking:
        values = (worth.weakest_of_tick(getattr(ticking.tau, q)) for q in QUANTILES)
        table.add_row(ticking.way.text, *(f"{value:.0f}" if value > 0.0 else "none" for value in values))
    console.print(table)
    say(console, "This session is at rest among springs; the report of a run has its own delays (manyhands launch).")
    for one in found:
        say(console, f"- {one.change}\n    {'buys' if one.tried else 'could buy (not tried here)'}: {one.buys}")


def compiled_sentence(found: CompiledWorth, worth: Worth) -> str:
    """What the compiled tick is worth here, as a sentence."""
    (compiled, pure), (least, most) = found.medians, found.spread
    unit = worth.loop.units()("N/m")
    times = f"{least:.2f} to {most:.2f}"
    turns = f"in {TURNS} turns; medians {compiled:.0f} µs and {pure:.0f} µs"
    if least < 1.0 < most:
        return (
            "Which of the compiled tick and pure Python is faster here was not to be seen: the first takes "
            f"{times} of the other's time {turns}."
        )
    gain = " in place of ".join(f"{worth.weakest_of_tick(median):.0f} {unit}" for median in (compiled, pure))
    return (
        f"The compiled tick takes {found.ratio:.2f} of the time of pure Python here ({times} {turns}): {gain} at the "
        "median."
    )


def compiled_object(found: CompiledWorth | None, worth: Worth) -> dict[str, Any] | None:
    """The same for ``--json``; None where there is no compiled tick to measure."""
    if found is None:
        return None
    medians = dict(zip(("compiled", "pure"), found.medians, strict=True))
    return {
        "ratio": found.ratio,
        "ratio_of_turns": list(found.spread),
        "tau_us": medians,
        "stiffness": {tick: worth.weakest_of_tick(median) for tick, median in medians.items()},
    }


def _row(spread: Spread) -> list[str]:
    return [f"{value:.0f}" for value in (spread.p50, spread.p99, spread.p999, spread.max)]


def _capability(name: str, held: bool) -> str:
    return name if held else f"no {name}"


def _yes(value: bool) -> str:
    return "yes" if value else "no"


_COMPILED_PART = 0.2
"""Of the measuring time: what the compiled tick is worth, where there is one."""

LEAST_SECONDS = 1.0
MOST_SECONDS = 600.0


def run_doctor(session: Session, seconds: float, out: Console, err: Console, as_json: bool) -> int:
    """Examine this machine for a session.

    Args:
        session: the session, of which the graph, the period and the devices' levels are used.
        seconds: how long to measure, s.
        out: for the results.
        err: for progress and messages.
        as_json: print one JSON object instead of tables.

    Returns:
        The exit code.
    """
    stated = session
    session, _ = settle_colocation(stated, Where.HERE)
    plan = Plan(session)
    graph = plan.graph
    if not (math.isfinite(seconds) and LEAST_SECONDS <= seconds <= MOST_SECONDS):
        say(err, f"error: --duration: found {seconds:g}; expected {LEAST_SECONDS:g} to {MOST_SECONDS:g} s")
        return EXIT_BAD_INPUT
    if len(graph.nodes) > MOST_PROCESSES:
        found = f"found {len(graph.nodes)} processes; expected at most {MOST_PROCESSES} for a probe"
        say(err, f"error: {session.name}: {found}; give a smaller session of the same kind")
        return EXIT_BAD_INPUT
    require_runnable(graph)
    machine, worth = examine(), Worth.of(haptic_loop(session.with_delay(0.0)), Stated.of(session))
    part, compiled = _COMPILED_PART if machine.compiled else 0.0, None
    try:
        with measuring(err) as show:
            measured = measure(plan, seconds * (1.0 - part), machine.usable, machine.curve, show)
            if machine.compiled:
                show("the compiled tick and pure Python, by turns")
                compiled = measure_worth(plan, seconds * part)
    except ProbeInterrupted as error:
        say(err, "interrupted before the measurement was complete")
        return 128 + error.signal
    except ProbeFailed as error:
        say(err, f"error: the probe failed: {error}")
        return EXIT_FAILED
    now = time.time()
    profiles = {
        form: found if isinstance(found, str) else found.profile(form.plan(session), measured.each, now)
        for form, found in measured.forms.items()
    }
    chosen = choose(stated, Where.HERE, len(machine.usable), of_both_forms(profiles, session.period))
    rates = list(form_figures(worth, profiles))
    advised = (*form_advice(session, rates), *advice(machine, measured, worth, len(chains_of(graph))))
    kept = _keep(profiles.values(), err)
    if as_json:
        print_json(
            doctor_object(machine, measured, worth, advised)
            | {"rates": rates_object(rates), "compiled_tick": compiled_object(compiled, worth)}
        )
        return EXIT_OK
    print_machine(out, machine, measured.waking.granted)
    print_measured(out, measured, session.period)
    print_rates(out, session.name, session.units(), rates)
    if chosen.reason:
        say(out, f"{session.name}, launched: {chosen.reason}")
    print_worth(out, measured, worth, advised)
    if compiled is not None:
        say(out, compiled_sentence(compiled, worth))
    say(out, kept)
    return EXIT_OK


def of_both_forms(profiles: Mapping[Form, Profile | str], period: float) -> dict[bool, Profile]:
    """The profiles of a period that are long enough to be kept, by whether couplings were co-located."""
    return {
        form.colocated: profile
        for form, profile in profiles.items()
        if form.period == period and isinstance(profile, Profile) and profile.seconds >= LEAST_KEPT
    }


def _keep(profiles: Iterable[Profile | str], err: Console) -> str:
    """Keep the profiles for `manyhands launch` and `manyhands budget`; returns a line about it."""
    kept = 0
    try:
        for profile in profiles:
            if isinstance(profile, Profile):
                kept += keep_profile(profile)
    except OSError as error:
        say(err, f"warning: the profile of this machine is not kept: {error.filename}: {error.strerror}")
    if kept:
        return f"kept for a day in {cache_folder()}; manyhands launch and budget use it"
    return f"no profile is kept: each was measured for less than {LEAST_KEPT:g} s; give more --duration"


def doctor_object(machine: Machine, measured: Measured, worth: Worth, found: tuple[Advice, ...]) -> dict[str, Any]:
    """The object that ``--json`` prints; durations in us, the period in s, stiffness in N/m."""
    waking = measured.waking
    return {
        "machine": machine.plain(),
        "granted": {name: {"granted": grant.granted, "said": grant.answer} for name, grant in waking.granted.items()},
        "session": worth.loop.session,
        "period": worth.loop.period,
        "waking_us": {way: spread.plain() for way, spread in waking.late.items()},
        "tick": {
            t.way.key: {"placement": dict(t.way.places), "tau_us": t.tau.plain(), "ticks": t.ticks, "late": t.late}
            for t in measured.ticking
        },
        "stiffness": stiffness_object(worth, measured.ticking),
        "advice": [{"change": one.change, "buys": one.buys, "tried": one.tried} for one in found],
    }
