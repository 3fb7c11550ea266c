"""The whole of `manyhands doctor`: look, measure, say what it means."""

from __future__ import annotations

import math
from typing import Any

from rich.console import Console

from manyhands.launch.designing import print_json
from manyhands.launch.display import say
from manyhands.launch.doctor.display import measuring, print_machine, print_measured, print_worth
from manyhands.launch.doctor.machine import Machine, examine
from manyhands.launch.doctor.meaning import Advice, Worth, advice, stiffness_object
from manyhands.launch.doctor.probe import MOST_PROCESSES, Interrupted, Measured, ProbeFailed, measure
from manyhands.launch.exits import EXIT_BAD_INPUT, EXIT_FAILED, EXIT_OK
from manyhands.launch.loop import haptic_loop
from manyhands.launch.placement import chains_of
from manyhands.launch.plan import Plan
from manyhands.launch.session import Session
from manyhands.launch.topology import require_runnable

LEAST_SECONDS = 1.0
MOST_SECONDS = 600.0


def run_doctor(session: Session, seconds: float, out: Console, err: Console, as_json: bool) -> int:
    """Examine this machine for a session.

    Args:
        session: whose graph, period and devices' levels are taken.
        seconds: how long to measure, s.
        out: for the results.
        err: for progress and messages.
        as_json: print one JSON object instead of tables.

    Returns:
        The exit code.
    """
    plan = Plan(session)
    graph = plan.graph
    if not (math.isfinite(seconds) and LEAST_SECONDS <= seconds <= MOST_SECONDS):
        say(err, f"error: --seconds: found {seconds:g}; expected {LEAST_SECONDS:g} to {MOST_SECONDS:g} s")
        return EXIT_BAD_INPUT
    if len(graph.nodes) > MOST_PROCESSES:
        found = f"found {len(graph.nodes)} processes; expected at most {MOST_PROCESSES} for a probe"
        say(err, f"error: {session.name}: {found}; give a smaller session of the same kind")
        return EXIT_BAD_INPUT
    require_runnable(graph)
    machine, worth = examine(), Worth.of(haptic_loop(session))
    try:
        with measuring(err) as show:
            measured = measure(plan, seconds, machine.usable, machine.curve, show)
    except Interrupted as error:
        say(err, "interrupted before the measurement was done")
        return 128 + error.signal
    except ProbeFailed as error:
        say(err, f"error: the probe failed: {error}")
        return EXIT_FAILED
    advised = advice(machine, measured, worth, len(chains_of(graph)))
    if as_json:
        print_json(doctor_object(machine, measured, worth, advised))
        return EXIT_OK
    print_machine(out, machine, measured.waking.granted)
    print_measured(out, measured, session.period)
    print_worth(out, measured, worth, advised)
    return EXIT_OK


def doctor_object(machine: Machine, measured: Measured, worth: Worth, found: tuple[Advice, ...]) -> dict[str, Any]:
    """The object that ``--json`` prints; durations in us, the period in s, stiffness in N/m."""
    waking = measured.waking
    return {
        "machine": machine.plain(),
        "granted": {name: {"granted": grant.granted, "said": grant.said} for name, grant in waking.granted.items()},
        "session": worth.loop.session,
        "period": worth.loop.period,
        "waking_us": {way: spread.plain() for way, spread in waking.late.items()},
        "tick": {
            t.way.key: {"placement": dict(t.way.places), "tau_us": t.tau.plain(), "ticks": t.ticks, "late": t.late}
            for t in measured.ticking
        },
        "stiffness": stiffness_object(worth, measured.ticking),
        "advice": [{"change": one.change, "buys": one.buys} for one in found],
    }
