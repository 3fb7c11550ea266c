"""The commands that recompute a recorded run: replay, audit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manyhands.launch.cli.common import Json, end, err, errors, out, warn_of_model
from manyhands.launch.display import say
from manyhands.launch.exits import EXIT_FAILED, EXIT_OK

if TYPE_CHECKING:
    from collections.abc import Sequence

    from manyhands.launch.recordings.integrity import Damage
    from manyhands.launch.recordings.run import Run

commands = typer.Typer()

RecordingPath = Annotated[Path, typer.Argument(metavar="FILE", help="A recording (.mcap) of launch --record.")]


@commands.command(epilog="Example: manyhands replay run.mcap")
def replay(file: RecordingPath, as_json: Json = False) -> None:
    """Run a recorded session under the simulated clock again, and compare every number bit for bit.

    Exit code 0: identical. 1: some number differs, or is not there, or the file is damaged.
    """
    with errors():
        from rich.progress import Progress

        from manyhands.launch.designing import print_json, telling
        from manyhands.launch.recordings.auditing import print_damage, print_replayed
        from manyhands.launch.recordings.prepared import prepared_of
        from manyhands.launch.recordings.replay import replay as replayed
        from manyhands.launch.recordings.replay import require_simulated

        run, damage = _read(file)
        require_simulated(file, run)
        if not as_json:
            print_damage(out, str(file), damage)
        with telling(err, "preparing the session") as telling_of:
            prepared = prepared_of(file, run, telling_of)
        warn_of_model(err, prepared.session)
        _warn_of_version(run)
        with Progress(console=err, transient=True) as bar:
            task = bar.add_task("running it again", total=run.ticks)
            found = replayed(prepared, run, lambda done: bar.update(task, completed=done))
        if as_json:
            print_json(found.as_plain() | {"file": str(file), "damage": _plain(damage)})
        else:
            print_replayed(out, str(file), found)
        end(EXIT_OK if found.identical and not damage else EXIT_FAILED)


@commands.command(epilog="Example: manyhands audit run.mcap")
def audit(file: RecordingPath, as_json: Json = False) -> None:
    """Recompute every ledger of a recording from its signals, and check it against the certificate inside the file.

    Exit code 0: all holds that could be checked. 1: something does not, or the file is damaged.
    """
    with errors():
        from rich.progress import Progress

        from manyhands.launch.designing import print_json
        from manyhands.launch.recordings.audit import audit as audited
        from manyhands.launch.recordings.audit import require_certificate, work_of
        from manyhands.launch.recordings.auditing import print_audit, print_damage

        run, damage = _read(file)
        require_certificate(file, run)
        if not as_json:
            print_damage(out, str(file), damage)
        _warn_of_version(run)
        with Progress(console=err, transient=True) as bar:
            task = bar.add_task("recomputing", total=work_of(run))
            found = audited(
                file,
                run,
                lambda text: bar.update(task, description=text),
                lambda done: bar.update(task, description="recomputing", completed=done),
            )
        if as_json:
            print_json(found.as_plain() | {"file": str(file), "damage": _plain(damage)})
        else:
            print_audit(out, str(file), found)
        end(EXIT_OK if found.holds and not damage else EXIT_FAILED)


def _read(file: Path) -> tuple[Run, Sequence[Damage]]:
    """A recording, and what is wrong with its bytes."""
    from rich.progress import Progress

    from manyhands.launch.recordings.integrity import Damage, findings
    from manyhands.launch.recordings.run import read_run

    with Progress(console=err, transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        run = read_run(file, lambda part: bar.update(task, completed=part)).require_beginning(file)
        task = bar.add_task("checking its bytes", total=1.0)
        damage = findings(file, lambda part: bar.update(task, completed=part))
    if run.cut is not None and not damage:
        size = file.stat().st_size
        damage = [Damage(size, size + 1, run.cut)]
    return run, damage


def _plain(damage: Sequence[Damage]) -> list[dict[str, object]]:
    return [{"begin": found.begin, "end": found.end, "what": found.what} for found in damage]


def _warn_of_version(run: Run) -> None:
    """Another version of this program may compute in another order."""
    import manyhands

    if run.recorded.version != manyhands.__version__:
        say(
            err,
            f"warning: recorded by manyhands {run.recorded.version}, and this is {manyhands.__version__}: where the "
            "two compute in another order, numbers differ in their last places",
        )
