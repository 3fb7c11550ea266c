"""One run as the command line needs it: show its progress, write its files, print its faults."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from manyhands.launch.files import TargetError
from manyhands.launch.look.display import LiveTable, not_admitted, say
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.reach import Reach
from manyhands.launch.recordings.recording import STREAMED, RecordingError, one_period
from manyhands.launch.run.directory import SessionDirectory
from manyhands.launch.run.outcome import Outcome, save_json
from manyhands.launch.run.recorder import RecorderProcess
from manyhands.launch.run.supervisor import Supervisor


def run_session(
    prepared: Prepared,
    console: Console,
    *,
    clock: str,
    reach: Reach,
    ticks: int,
    record: Path | None = None,
    report: Path | None = None,
    directory: SessionDirectory | None = None,
    keep: bool = False,
    together: bool = False,
) -> Outcome:
    """Run a session, show its progress on ``console``, and write the files that were asked for.

    Args:
        prepared: the session with its coupling and certificate.
        console: where progress, notices and faults go.
        clock: "realtime" or "simulated".
        reach: how the processes reach each other.
        ticks: number of ticks; 0 runs until interrupted.
        record: the file for every x and f_v; ``.mcap`` is written while the session runs, other formats at its end.
        report: the file for the report.
        directory: a folder that keeps session, certificate, report and logs as well.
        keep: whether to return the recording in the outcome, even if it is not written.
        together: whether a guest that leaves ends the session.

    Raises:
        RecordingError, TargetError, OSError: a file cannot be written.
    """
    streamed = record is not None and record.suffix == STREAMED
    if keep or (record is not None and not streamed):
        one_period({device: prepared.session.period_of(device) for device in prepared.session.devices}, record)
    if directory is not None:
        directory.keep_session(prepared)
    title = f"{prepared.session.name} ({clock}, {reach.transport}), certificate {prepared.id[:16]}"
    with LiveTable(console, title, prepared.graph, ticks, prepared.session) as table:
        outcome = Supervisor(
            prepared,
            clock=clock,
            reach=reach,
            ticks=ticks,
            record=keep or (record is not None and not streamed),
            recorder=RecorderProcess(prepared, clock, record) if record is not None and streamed else None,
            logs=None if directory is None else directory.logs,
            together=together,
            show=table,
        ).run()
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
    if record is not None and streamed:
        cut = "stopped" in outcome.report.get("recording", {})
        say(console, f"error: the recording {record} is not whole" if cut else f"recording written to {record}")
    writes: list[tuple[Callable[[], None], str]] = []
    if record is not None and not streamed and outcome.recording is not None:
        writes.append((partial(outcome.recording.save, record), f"recording written to {record}"))
    if report is not None:
        writes.append((partial(save_json, outcome.report, report), f"report written to {report}"))
    if directory is not None:
        keep_report = partial(directory.keep_report, outcome.report)
        writes.append((keep_report, f"session, report and logs are in {directory.path}"))
    _write_each(writes, console)
    return outcome


def _write_each(writes: Sequence[tuple[Callable[[], None], str]], console: Console) -> None:
    """Write every file, even when one of them cannot be written.

    Args:
        writes: functions that write a file, each with the line to print afterwards.
        console: receives those lines, and every error except the first.

    Raises:
        RecordingError, TargetError, OSError: a file cannot be written; the first error.
    """
    failures: list[RecordingError | TargetError | OSError] = []
    for write, done in writes:
        try:
            write()
        except (RecordingError, TargetError, OSError) as error:
            failures.append(error)
        else:
            say(console, done)
    for other in failures[1:]:
        text = f"{other.filename}: {other.strerror}" if isinstance(other, OSError) else str(other)
        say(console, f"error: {text}")
    if failures:
        raise failures[0]
