"""Opening the files of others, and replacing one's own: regular files only, whole or not at all, through no link.

A path may come from a session file, a bundle or a stranger, and a folder may be shared. So what is read is seen to be a
regular file of bounded size before a byte of it is used, and what is written has a name that nobody can guess until it
is whole. (Key files have rules of their own: :mod:`manyhands.protocol.keys`.)
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
        path: the file; it may be a link to one.
        most: the bytes that it may have; None for any number.

    Raises:
        OSError: it cannot be opened, is no regular file, or is too long; ``strerror`` says what was found.
        ValueError: the path has a zero byte in it.
    """
    _require_regular(path, os.stat(path))  # first by name: a pipe that is opened wakes its writer
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        status = os.fstat(descriptor)  # the name may lead elsewhere meanwhile
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
    if len(content) > most:  # it grew, or it is one of those files in /proc that have no size
        raise OSError(errno.EFBIG, f"Is longer than {most} bytes", str(path))
    return content


def open_new(path: Path, mode: int | None = None) -> BinaryIO:
    """Make a new file and open it for writing, never through a link.

    Args:
        path: where nothing may be yet, not even a link that leads nowhere.
        mode: its mode, whatever the umask; None for what the umask leaves of 0666.

    Raises:
        FileExistsError: there is something of that name.
        OSError: it cannot be made.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    file = os.fdopen(os.open(path, flags, 0o666 if mode is None else mode & 0o600), "wb")
    if mode is not None:
        os.fchmod(file.fileno(), mode)
    return file


def open_beside(path: Path, mode: int | None = None) -> tuple[Path, BinaryIO]:
    """Make a new file in the folder of ``path``, of a name that nobody can guess; whoever asked for it renames it.

    Raises:
        OSError: it cannot be made, or what is at ``path`` is no regular file and must not be replaced by one.
    """
    with contextlib.suppress(FileNotFoundError):  # nothing is there, or a link that leads nowhere and is replaced
        _require_regular(path, os.stat(path))
    partial = path.with_name(f".{secrets.token_hex(16)}.part")
    return partial, open_new(partial, mode)


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
def replacing(path: Path, mode: int | None = None) -> Iterator[BinaryIO]:
    """A new file to write to: at the end it is on the disk and takes the place of ``path``, whole or not at all.

    On an error nothing is left of it, and an older file stays as it was. A link at ``path`` is replaced, not followed.

    Args:
        path: the file.
        mode: as of :func:`open_new`.

    Raises:
        OSError: as :func:`open_beside`, or it cannot be written; names ``path``.
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
