"""The way from a recording's file to its picture's, telling on the way how far it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from manyhands.launch.recordings.pictures import Picture, between, picture_of_recording, picture_of_run
from manyhands.launch.recordings.plots import require_picture, write_picture
from manyhands.launch.recordings.recording import RUN_SUFFIXES, STREAMED, require_format
from manyhands.launch.recordings.run import read_run
from manyhands.launch.recordings.saved import read_saved


def draw(
    file: Path,
    target: Path,
    console: Console,
    quantities: Sequence[str] | None = None,
    start: float | None = None,
    end: float | None = None,
) -> None:
    """Draw the recording in ``file`` into ``target``.

    Args:
        file: .mcap, .npz or .csv.
        target: .png or .svg.
        console: for progress.
        quantities: what to show; None for what there usually is.
        start: s since tick 0; None for the beginning.
        end: likewise; None for the end.

    Raises:
        RecordingError: no recording, or nothing of what was asked for is in it.
        TargetError: the picture cannot be written there.
    """
    require_format(file, RUN_SUFFIXES)
    require_picture(target)
    with _progress(console, f"reading {file.name}") as tell:
        picture = between(_picture(file, quantities, tell), start, end)
    with _progress(console, f"drawing {target.name}"):
        write_picture(picture, target)


def _picture(file: Path, quantities: Sequence[str] | None, tell: Callable[[float], None]) -> Picture:
    if file.suffix == STREAMED:
        return picture_of_run(read_run(file, tell), quantities)
    return picture_of_recording(read_saved(file, tell), quantities)


@contextmanager
def _progress(console: Console, text: str) -> Iterator[Callable[[float], None]]:
    """A bar on a terminal, gone afterwards; yields what is told how far it is, 0 ... 1."""
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(text, total=1.0)
        yield lambda part: progress.update(task, completed=part)
