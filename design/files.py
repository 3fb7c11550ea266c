"""Safe reading and writing: only regular files are read; files are written whole or not at all, never through a link.

A path may come from a session file, from a bundle or from an untrusted person, and a folder may be shared. So a file
is checked to be regular and of bounded size before any of its bytes are used. A file under construction has a name
that nobody can guess until it is complete. (Key files have rules of their own: :mod:`manyhands.protocol.keys`.)
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

_KINDS: Final = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def open_regular(path: Path, most: int | None = None) -> BinaryIO:
    """Open a regular file for reading; a pipe, a device or a folder is refused at once, without waiting for it.

    Args:
        path: the file, or a link to a regular file.
        most: greatest number of bytes; None for no limit.

    Raises:
        OSError: the file cannot be opened, is not a regular file, or is too long; ``strerror`` states what was found.
        ValueError: the path contains a zero byte.
    """
    _require_regular(path, os.stat(path))  # first by name, because opening a pipe wakes its writer
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        status = os.fstat(descriptor)  # the name may refer to a different file by now
        _require_regular(path, status)
        if most is not None and status.st_size > most:
            raise OSError(errno.EFBIG, f"Is longer than {most} bytes", str(path))
        return os.fdopen(descriptor, "rb")
    except OSError:
        os.close(descriptor)
        raise


def read_regular(path: Path, most: int) -> bytes:
    """All of a regular file of at most ``most`` bytes.

    Raises:
        OSError, ValueError: as :func:`open_regular`.
    """
    with open_regular(path, most) as file:
        content = file.read(most + 1)
    if len(content) > most:  # the file has grown, or it is a file in /proc, which states no size
        raise OSError(errno.EFBIG, f"Is longer than {most} bytes", str(path))
    return content


def open_new(path: Path, mode: int | None = None) -> BinaryIO:
    """Make a new file and open it for writing, never through a link.

    Args:
        path: the new file; nothing of this name may exist, not even a dangling link.
        mode: its mode, independent of the umask; None for 0666 reduced by the umask.

    Raises:
        FileExistsError: something of that name exists.
        OSError: the file cannot be made.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    file = os.fdopen(os.open(path, flags, 0o666 if mode is None else mode & 0o600), "wb")
    if mode is not None:
        os.fchmod(file.fileno(), mode)
    return file


def open_beside(path: Path, mode: int | None = None) -> tuple[Path, BinaryIO]:
    """Make a new file in the folder of ``path``, with a name that nobody can guess; the caller renames it.

    Raises:
        OSError: the file cannot be made; or ``path`` is something other than a regular file, which must not be
            replaced.
    """
    with contextlib.suppress(FileNotFoundError):  # nothing exists there, or a dangling link, which is replaced
        _require_regular(path, os.stat(path))
    partial = path.with_name(f".{secrets.token_hex(16)}.part")
    return partial, open_new(partial, mode)


_OF_THE_DISK: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name ``path`` in an error of the disk, such as "No space left on device"; Python names no file if a write fails.

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
def replacing(path: Path, mode: int | None = None) -> Iterator[BinaryIO]:
    """A new file to write to. At the end it is flushed to the disk and replaces ``path``, whole or not at all.

    On an error the new file is removed, and an older file stays unchanged. A link at ``path`` is replaced, not
    followed.

    Args:
        path: the file.
        mode: as for :func:`open_new`.

    Raises:
        OSError: as for :func:`open_beside`; or the file cannot be written, and the error names ``path``.
    """
    partial, file = open_beside(path, mode)
    try:
        with naming(path), file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _require_regular(path: Path, status: os.stat_result) -> None:
    if stat.S_ISREG(status.st_mode):
        return
    found = next((text for fits, text in _KINDS if fits(status.st_mode)), "something else")
    raise OSError(errno.EINVAL, f"Is {found}, not a regular file", str(path))
