"""The commands about recordings: record makes one; info, export and plot show it; replay and audit recompute it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

import manyhands
from manyhands.launch.app.cli.common import (
    Json,
    RunningName,
    end,
    err,
    errors,
    one_word_of,
    out,
    refuse,
    require_one_of,
)
from manyhands.launch.app.design_report import progress_on
from manyhands.launch.app.risks import warn_of_code
from manyhands.launch.audit.prepared import prepared_of
from manyhands.launch.bridges.layouts import LAYOUTS, save_layout
from manyhands.launch.bridges.rosbag import ROSBAG, save_bag
from manyhands.launch.files import EXIT_FAILED, EXIT_OK, claimed, require_new_target
from manyhands.launch.look.display import printable, progress_bar, say, status
from manyhands.launch.look.sessions import find_session, session_in
from manyhands.launch.output import print_json
from manyhands.launch.recordings.formats import STREAMED, TABLES
from manyhands.launch.recordings.recording import require_format, require_suffix
from manyhands.launch.recordings.run import RecordedRun, chosen, missing_sentence, read_run
from manyhands.launch.recordings.run import export as write
from manyhands.launch.run.outcome import joules
from manyhands.launch.run.processes import Interrupt
from manyhands.nodes.kernel.driver_statement import outside
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.nodes.kernel.words import counted
from manyhands.protocol.channels import TOPICS
from manyhands.protocol.clock import RealtimeClock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from manyhands.launch.look.attached import AttachedCore, AttachedRecording
    from manyhands.launch.recordings.info import Info
    from manyhands.launch.recordings.integrity import Damage


commands = typer.Typer()

RecordingPath = Annotated[Path, typer.Argument(metavar="FILE", help=f"A recording ({STREAMED}).")]

_GAPS_SHOWN = 5
_EXPORTED = (*TABLES, ROSBAG)


@commands.command(epilog="Example: manyhands record -o run.mcap --duration 10")
def record(
    output: Annotated[Path, typer.Option("-o", metavar="FILE", help=f"Where the recording goes ({STREAMED}).")],
    directory: Annotated[
        Path | None,
        typer.Argument(metavar="[DIR]", help="The session's directory: that of launch --directory, or the run's own."),
    ] = None,
    session: RunningName = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", help="How long, in s of the session's time; else until its end."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Record a running session from now until its end, --duration or Ctrl-C."""
    with errors("record"):
        from manyhands.launch.look.attached import record_attached

        require_suffix(output, (STREAMED,))
        if duration is not None and not 0.0 < duration <= 1e9:
            refuse(f"--duration: found {duration:g} s; expected more than 0 s, and at most 1e9 s")
        if directory is not None and session is not None:
            refuse("give either DIR or --running NAME")
        running = find_session(session) if directory is None else session_in(directory)
        name, announced = running.about.session, False
        with claimed(output), Interrupt() as interrupt, status(err, f"waiting for {name}") as shown:

            def show(core: AttachedCore) -> None:
                nonlocal announced
                if core.beginning and not announced:
                    first = min(core.beginning.values())
                    say(
                        err,
                        f"recording {name} to {output}, from tick {first} to its end; Ctrl-C ends only the recording",
                    )
                    announced = True
                lost = f", {sum(core.missing.values())} missing" if core.missing else ""
                shown(f"recording {name}: tick {core.tick}{lost}")

            done = record_attached(running, output, duration, interrupt, RealtimeClock(), show)
        if as_json:
            say(out, json.dumps(done.as_plain()))
        _print_end(done)


def _print_end(done: AttachedRecording) -> None:
    if done.missing:
        lost = ", ".join(f"{device} {ticks}" for device, ticks in done.missing.items())
        say(err, f"warning: ticks missing from the recording: {lost}")
    if done.refused:
        say(err, f"warning: {counted(done.refused, 'frame')} could not be decoded")
    ticks = "no ticks" if done.first is None else f"ticks {done.first} to {done.ticks - 1}"
    say(err, f"{done.ending}; {ticks} written to {done.file}")


@commands.command(epilog="Example: manyhands info run.mcap")
def info(
    file: RecordingPath,
    as_json: Json = False,
) -> None:
    """Report what a recording holds, what is missing from it, and whether any of its bytes was changed.

    Exit code 1: the file is damaged or cut.
    """
    with errors("record"):
        from manyhands.launch.recordings.info import read_info
        from manyhands.launch.recordings.integrity import findings

        with progress_bar(err, "reading") as progress:
            found = read_info(file, lambda part: progress(part / 2))
            damages = findings(file, lambda part: progress((1 + part) / 2))
        if as_json:
            damaged = [damage.as_plain() for damage in damages]
            say(out, json.dumps({"file": str(file), **found.as_plain(), "damaged": damaged}))
        else:
            _print(found, damages)
        end(EXIT_FAILED if damages else 0)


def _print(found: Info, damages: list[Damage]) -> None:
    recorded = found.recorded
    say(out, f"session {recorded.session}, certificate {recorded.certificate}, manyhands {recorded.version}")
    begin = f", from tick {found.first}" if found.first else ""
    say(
        out,
        f"{counted(found.ticks - (found.first or 0), 'tick')} of {recorded.period:g} s{begin}: {found.duration:g} s; "
        f"{recorded.clock} clock; {counted(found.size, 'byte')}",
    )
    for period in sorted(set(recorded.periods.values())):
        own = ", ".join(name for name, one in recorded.periods.items() if one == period)
        say(out, f"ticks of {period:g} s: {own}")
    table = Table("channel", box=None)
    table.add_column("messages", justify="right")
    table.add_column("rate [Hz]", justify="right")
    for channel in found.channels:
        rate = "" if channel.rate is None else f"{channel.rate:.6g}"
        table.add_row(Text(printable(channel.topic)), str(channel.messages), rate)
    out.print(table)
    for name, size in found.attachments.items():
        say(out, f"attachment {name}: {counted(size, 'byte')}")
    for device, ticks in found.missing.items():
        gaps = found.gaps[device]
        listed = ", ".join(f"{gap.begin}..{gap.end - 1}" for gap in gaps[:_GAPS_SHOWN])
        say(out, f"missing of {device}: {counted(ticks, 'tick')}: {listed}{', …' if len(gaps) > _GAPS_SHOWN else ''}")
    for device, least in found.accounts.items():
        say(out, f"least interface account of {device}: {joules(least)}")
    for button, presses in found.presses.items():
        say(out, f"button {printable(button)}: pressed {counted(presses, 'time')}")
    for device, by_itself in found.by_itself.items():
        say(out, outside(device, by_itself))
    if found.cut is not None:
        say(out, f"incomplete: {found.cut}")
    for damage in damages:
        say(out, f"damaged: bytes {damage.begin} to {damage.end}: {damage.what}")
    if not damages:
        say(out, "intact: all checksums match")


@commands.command(epilog="Example: manyhands export run.mcap --format csv --topics dx/force")
def export(
    file: RecordingPath,
    to: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="|".join(_EXPORTED),
            help="The format; that of OUT's suffix unless given. One of the two is required.",
            autocompletion=one_word_of(_EXPORTED),
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", metavar="OUT", help="Where the table or the bag goes; by default beside FILE.")
    ] = None,
    topics: Annotated[
        list[str],
        typer.Option(
            "--topics",
            metavar="PATTERN",
            autocompletion=one_word_of(sorted({topic.name for topics in TOPICS.values() for topic in topics})),
            help="Export only these: /SESSION/NODE/TOPIC, NODE/TOPIC, a node or a topic, with * and ?; repeatable, or "
            "separated by commas.",
        ),
    ] = [],  # noqa: B006
    layout: Annotated[
        Path | None,
        typer.Option(
            "--layout", metavar="LAYOUT", help="Write a layout for FILE here: .json for Foxglove, .xml for PlotJuggler."
        ),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a table or a layout that exists.")] = False,
) -> None:
    """Write a recording as a table, one row a tick, every number exact; or as a bag of ROS 2.

    Where a node has a period of its own, each row has the newest of its ticks.
    """
    with errors("record"):
        if layout is not None:
            require_new_target(layout, overwrite)
            with progress_bar(err, "reading") as progress:
                run = read_run(file, progress)
            save_layout(layout, run.recorded, run.topics)
            say(err, f"layout written to {layout}")
            if to is None and output is None:
                return
        format_ = to or (output.suffix[1:] if output is not None else "")
        if not format_:
            refuse(f"found neither --format nor -o; expected one of {', '.join(_EXPORTED)}, or a file with that suffix")
        if to is None and output is not None and output.suffix in LAYOUTS:
            refuse(f"-o: found {output}, which is a layout's suffix; expected --layout {output}, or a table or a bag")
        require_one_of("--format" if to is not None else "-o", format_, _EXPORTED)
        target = output or file.with_suffix(f".{format_}")
        require_format(target, (f".{format_}",))
        if format_ != ROSBAG:
            require_new_target(target, overwrite)
        elif overwrite:
            refuse("--overwrite: found a bag, which is a folder and never replaced; expected a new name with -o")
        with progress_bar(err, "exporting") as progress:
            run = read_run(file, lambda part: progress(part / 2))
            patterns = [pattern for given in topics for pattern in given.split(",")]
            if format_ == ROSBAG:
                messages = save_bag(run, target, patterns, lambda part: progress((1 + part) / 2))
            else:
                write(run, target, format_, patterns, lambda part: progress((1 + part) / 2))
        if run.cut is not None:
            say(err, f"warning: {file}: {run.cut}")
        of_devices = {key: kept for key, kept in chosen(run, patterns).items() if key[0] in run.recorded.devices}
        missing = missing_sentence(run, of_devices if format_ == ROSBAG else chosen(run, patterns))
        if missing is not None:
            there = "the bag has no message" if format_ == ROSBAG else "the table has NaN"
            say(err, f"warning: {file}: {missing}; {there} there")
        what = counted(messages, "message") if format_ == ROSBAG else counted(run.ticks, "tick")
        say(err, f"{what} written to {target}")


McapPath = Annotated[Path, typer.Argument(metavar="FILE", help="A recording (.mcap) of launch --record.")]


@commands.command(epilog="Example: manyhands replay run.mcap")
def replay(
    file: McapPath,
    code_in: Annotated[
        Path | None,
        typer.Option(
            "--code-in",
            metavar="DIR",
            exists=True,
            file_okay=False,
            help="Where the model's module is, such as the session file's folder; searched after Python's path.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a session again that was recorded under the simulated clock, and compare every number bit for bit.

    A recording names a model of the environment and no folder: --code-in names it. Exit code 0: identical. 1: some
    number differs or is missing, or the file is damaged.
    """
    with errors("record", "design"):
        from manyhands.launch.app.audit_report import print_damage, print_replayed
        from manyhands.launch.audit.replay import replay as replayed
        from manyhands.launch.audit.replay import require_simulated

        run, damage = _read(file)
        require_simulated(file, run)
        if not as_json:
            print_damage(out, str(file), damage)
        with progress_on(err, "preparing the session") as progress:
            prepared = prepared_of(file, run, progress)
        if code_in is not None:
            prepared = replace(prepared, session=prepared.session.with_code_in(code_in))
        warn_of_code(err, prepared.session, prepared.session.devices)  # what drivers did is in the file
        _warn_of_version(run)
        try:
            with progress_bar(err, "running it again", run.ticks) as tell:
                found = replayed(prepared, run, tell)
        except FactoryError as error:
            if code_in is None:
                refuse(f"{error}; a module beside the session's file is found with --code-in DIR, that file's folder")
            raise
        if as_json:
            print_json(found.as_plain() | {"file": str(file), "damage": [one.as_plain() for one in damage]})
        else:
            print_replayed(out, str(file), found)
        end(EXIT_OK if found.identical and not damage else EXIT_FAILED)


@commands.command(epilog="Example: manyhands audit run.mcap")
def audit(file: McapPath, as_json: Json = False) -> None:
    """Recompute every ledger of a recording from its signals, and check it against the certificate inside the file.

    Exit code 0: it holds, so all that the certificate needs was checked, and was kept or enforced. 1: it does not hold,
    or something of that is not checked, since the recording lacks it.
    """
    with errors("record", "design"):
        from manyhands.launch.app.audit_report import print_audit, print_damage
        from manyhands.launch.audit.audit import audit as audited
        from manyhands.launch.audit.audit import require_certificate, work_of

        run, damage = _read(file)
        require_certificate(file, run)
        if not as_json:
            print_damage(out, str(file), damage)
        _warn_of_version(run)
        with progress_bar(err, "recomputing", work_of(run)) as tell:
            found = audited(file, run, lambda text: tell(text=text), lambda done: tell(done, "recomputing"), damage)
        if as_json:
            print_json(found.as_plain() | {"file": str(file), "damage": [one.as_plain() for one in damage]})
        else:
            print_audit(out, str(file), found)
        end(EXIT_OK if found.holds else EXIT_FAILED)


def _read(file: Path) -> tuple[RecordedRun, Sequence[Damage]]:
    """A recording, and the damaged ranges of its bytes."""
    from manyhands.launch.recordings.integrity import Damage, findings

    with progress_bar(err, "reading") as tell:
        run = read_run(file, tell).require_beginning(file)
    with progress_bar(err, "checking its bytes") as tell:
        damage = findings(file, tell)
    if run.cut is not None and not damage:
        size = file.stat().st_size
        damage = [Damage(size, size + 1, run.cut, cut=True)]
    return run, damage


def _warn_of_version(run: RecordedRun) -> None:
    """Warn if another version of this program made the recording: it may compute in another order."""
    if run.recorded.version != manyhands.__version__:
        say(
            err,
            f"warning: recorded by manyhands {run.recorded.version}, and this is {manyhands.__version__}: where the "
            "two compute in another order, numbers differ in their last places",
        )


_QUANTITIES = "sample, velocity, force, tool, reaction, tools, masses, ledger, tau, interface"


@commands.command(epilog="Example: manyhands plot run.mcap --show velocity,force --from 2 --until 3 -o steps.svg")
def plot(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recording: .mcap, or a table: .csv, .npz or .parquet.")
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", metavar="OUT", help="Write the plot here (.png, .svg or .pdf); by default beside FILE."),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="png|svg",
            help="The format, where OUT is not given.",
            autocompletion=one_word_of(("png", "svg")),
        ),
    ] = None,
    topics: Annotated[
        str | None,
        typer.Option(
            "--show",
            metavar="LIST",
            help=f"What to show, separated by commas, of {_QUANTITIES}.",
            autocompletion=one_word_of(_QUANTITIES.split(", ")),
        ),
    ] = None,
    start: Annotated[float | None, typer.Option("--from", metavar="S", help="Begin at this time, s.")] = None,
    end: Annotated[float | None, typer.Option("--until", metavar="S", help="End at this time, s.")] = None,
) -> None:
    """Draw a recording: positions, velocities, forces, energy ledgers, delays, and events.

    Gaps are grey, every extreme value is drawn however long the run is, and the plot of a file that was cut says so.
    The delays inside the tick are drawn for runs in real time.
    """
    with errors("plot"):
        from manyhands.launch.look.plots import draw

        if to is not None:
            require_one_of("--format", to, ("png", "svg"))
            if output is not None:
                refuse("give either --format or -o FILE, whose suffix is the format")
        target = output if output is not None else file.with_suffix(f".{to or 'png'}")
        wanted = None if topics is None else tuple(name.strip() for name in topics.split(","))
        draw(file, target, err, wanted, start, end)
        say(out, str(target))
