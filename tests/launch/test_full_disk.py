"""A full disk, by the limit of a file's size: the error names the file, and no partial file is left."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from manyhands.launch.app.cli import app
from manyhands.launch.run.directory import run_directory
from manyhands.launch.run.outcome import save_json


@contextmanager
def no_room() -> Iterator[None]:
    """No file of this process can grow."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def write_report(path: Path) -> None:
    save_json({"session": "s"}, path)


def write_into_the_run(path: Path) -> None:
    with run_directory() as directory:
        path.symlink_to(directory)
        (directory / "bundle").write_text("x")


@pytest.mark.parametrize("write", [write_report, write_into_the_run])
def test_the_error_names_what_could_not_be_written(write: Callable[[Path], None], tmp_path: Path) -> None:
    target = tmp_path / "target"
    with pytest.raises(OSError, match="File too large") as found, no_room():
        write(target)
    assert found.value.filename == str(target.readlink() if target.is_symlink() else target)
    assert not target.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == [target.name] * target.is_symlink()


def test_so_does_the_message_of_a_command(tmp_path: Path) -> None:
    target = tmp_path / "graph.svg"
    with no_room():
        result = CliRunner().invoke(app, ["graph", "example1.yaml", "-o", str(target)])
    assert (result.exit_code, result.stderr) == (1, f"error: {target}: File too large\n")
    assert not [*tmp_path.iterdir()]
