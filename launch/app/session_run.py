"""One run as the command line needs it: show its progress, print its faults, and write its files."""

from __future__ import annotations

from functools import partial

from rich.console import Console

from manyhands.launch.look.display import say
from manyhands.launch.look.live import LiveTable, not_admitted
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.reach import Reach
from manyhands.launch.recordings.formats import STREAMED
from manyhands.launch.run.broadcast import describe
from manyhands.launch.run.options import StartOptions
from manyhands.launch.run.outcome import Outcome
from manyhands.launch.run.supervised import run_prepared, write_files


def run_session(prepared: Prepared, console: Console, ways: Reach, options: StartOptions) -> Outcome:
    """Run a session, show its progress on ``console``, and write the files that were asked for.

    Args:
        prepared: the session with its couplings and certificates.
        console: where progress, notices and faults go.
        ways: how the processes reach each other.
        options: its clock, its ticks, and what is kept of it.

    Raises:
        RecordingError, TargetError, OSError: a file cannot be written.
    """
    speed, unit = prepared.loop.speed, prepared.loop.units()("m/s")
    below = "" if speed is None else f" below {speed:g} {unit}"
    title = f"{prepared.session.name} ({options.clock}, {ways.transport}), certificate {prepared.id[:16]}{below}"
    about = describe(prepared, options.clock, ways.transport, options.ticks, ways.remote, ways.seats)
    with LiveTable(console, title, about) as table:
        outcome = run_prepared(prepared, ways, options, show=table)
    for notice in outcome.notices:
        if notice not in table.announced:
            say(console, f"notice: {notice}")
    for incident in outcome.incidents:
        say(console, f"incident: {incident}")
    for fault in outcome.faults:
        say(console, f"error: {fault}")
    if outcome.lost:
        lost = ", ".join(f"{device} {ticks}" for device, ticks in outcome.lost.items())
        say(console, f"warning: ticks missing from the recording (NaN there): {lost}")
    for line in not_admitted(outcome.refused):
        say(console, f"warning: {line}")
    if options.record is not None and options.record.suffix == STREAMED:
        cut = "stopped" in outcome.report.get("recording", {})
        whole = f"recording written to {options.record}"
        say(console, f"error: the recording {options.record} is incomplete" if cut else whole)
    write_files(outcome, options, partial(say, console))
    return outcome
