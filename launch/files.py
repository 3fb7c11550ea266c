"""Writing a file whole or not at all, and refusing beforehand what cannot be written."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final


class TargetError(Exception):
    """A file cannot be written where it was asked for."""


def require_target(path: Path) -> None:
    """Refuse a file name that cannot be written to; before a run, not after it.

    Raises:
        TargetError: no such folder, or a folder of that name.
    """
    if not path.absolute().parent.is_dir():
        raise TargetError(f"{path}: found no folder {path.parent}; expected one that exists")
    if path.is_dir():
        raise TargetError(f"{path}: found a folder; expected the name of a file")


_OF_THE_DISK: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name ``path`` in an error of the disk, such as "No space left on device": Python names no file in one of a write.

    Raises:
        OSError: with ``path`` as its file name.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno in _OF_THE_DISK:
            error.filename = str(path)
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name beside ``path``, with its suffix, to write to: what is there at the end takes its place.

    On an error nothing is left of it, and an older file stays as it was.
    """
    partial = path.with_name(f".{path.name}.part{path.suffix}")
    try:
        with naming(path):
            yield partial
            partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
