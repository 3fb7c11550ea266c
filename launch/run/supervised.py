"""One prepared session under a supervisor, with what is recorded and kept of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial

from manyhands.launch.files import TargetError, claimed, require_target
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.reach import Reach
from manyhands.launch.recordings.formats import RUN_SUFFIXES, STREAMED
from manyhands.launch.recordings.recording import RecordingError, one_period, require_format, require_suffix
from manyhands.launch.run.directory import REPORT, SessionDirectory, require_new
from manyhands.launch.run.options import StartOptions
from manyhands.launch.run.outcome import Outcome, Progress, save_json
from manyhands.launch.run.processes import EndRequest
from manyhands.launch.run.recorder import Recorder, RecorderProcess
from manyhands.launch.run.supervisor import Supervisor


def require_files(options: StartOptions) -> None:
    """Refuse files and folders that cannot be written, before the session is designed.

    Raises:
        RecordingError, MissingExtra: there are no recordings of this format, or not without an extra.
        TargetError: a file or the folder cannot be written there.
    """
    record, suffixes = options.record, RUN_SUFFIXES if options.hosting is None else (STREAMED,)
    if options.directory is not None:
        require_new(options.directory)
    if record is not None and record.parent == options.directory:  # the folder is made when the session runs
        require_format(record, suffixes)
    elif record is not None:
        require_suffix(record, suffixes)
    if options.report is not None:
        require_target(options.report)


@contextmanager
def claimed_files(options: StartOptions) -> Iterator[None]:
    """While entered, no other run writes to the files of this one.

    Raises:
        RecordingError, MissingExtra, TargetError: as :func:`require_files`; or another run writes to a file.
    """
    require_files(options)
    with ExitStack() as claims:
        for file in (options.record, options.report):
            if file is not None and file.parent != options.directory:
                claims.enter_context(claimed(file))
        yield


def run_prepared(
    prepared: Prepared,
    ways: Reach,
    options: StartOptions,
    *,
    show: Callable[[Progress], str | None] | None = None,
    interrupt: EndRequest | None = None,
    recorder: Recorder | None = None,
    places: Mapping[str, int] | None = None,
) -> Outcome:
    """Run a session to its end; what is written after it, :func:`write_files` writes.

    Args:
        prepared: the session with its couplings and certificates.
        ways: how its processes reach each other.
        options: its clock, its ticks, and what is kept of it.
        show: called with the progress a few times a second; returns an incident of the display, if there is one.
        interrupt: what ends the run early; by default the signals of the terminal, in a main thread.
        recorder: takes the telemetry, where no recording is asked for.
        places: the processor of each node that is pinned to one; by default the usual ones.

    Raises:
        RecordingError, TargetError, OSError: a file or folder cannot be made.
    """
    session, record = prepared.session, options.record
    at_its_end = record is not None and record.suffix != STREAMED
    if at_its_end:
        one_period({device: session.period_of(device) for device in session.devices}, record)
    elif record is not None:
        recorder = RecorderProcess(prepared, options.clock, record)
    kept = None if options.directory is None else SessionDirectory(options.directory)
    if kept is not None:
        kept.keep_session(prepared)
    return Supervisor(
        prepared,
        clock=options.clock,
        reach=ways,
        ticks=options.ticks,
        record=at_its_end,
        recorder=recorder,
        logs=None if kept is None else kept.logs,
        together=options.together,
        show=show,
        places=places,
        interrupt=interrupt,
    ).run()


def write_files(outcome: Outcome, options: StartOptions, say: Callable[[str], None]) -> None:
    """Write every file of a run that is over, even when one of them cannot be written.

    Args:
        outcome: of the run.
        options: what it was started with.
        say: called with a sentence about each file, and about every error except the first.

    Raises:
        RecordingError, TargetError, OSError: a file cannot be written; the first error.
    """
    writes: list[tuple[Callable[[], None], str]] = []
    if options.record is not None and outcome.recording is not None:
        writes.append((partial(outcome.recording.save, options.record), f"recording written to {options.record}"))
    if options.report is not None:
        writes.append((partial(save_json, outcome.report, options.report), f"report written to {options.report}"))
    if (folder := options.directory) is not None:
        keep = partial(save_json, outcome.report, folder / REPORT)
        writes.append((keep, f"session, report and logs are in {folder}"))
    failures: list[RecordingError | TargetError | OSError] = []
    for write, done in writes:
        try:
            write()
        except (RecordingError, TargetError, OSError) as error:
            failures.append(error)
        else:
            say(done)
    for other in failures[1:]:
        text = f"{other.filename}: {other.strerror}" if isinstance(other, OSError) else str(other)
        say(f"error: {text}")
    if failures:
        raise failures[0]
