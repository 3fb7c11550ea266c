"""Files that commands write: their checks and locks, and the exit codes, on which other programs rely.

A command checks an output file before it begins, not after a run. While it writes the file, a lock keeps other runs
from it.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

_MOST_WORDS: Final = 300
_NO_LOCKS: Final = (errno.EBADF, errno.ENOLCK, errno.EOPNOTSUPP)
"""Errors of file systems without locks, such as some network file systems."""


class TargetError(Exception):
    """An output file cannot be written at the place that the user named."""


def require_target(path: Path) -> None:
    """Refuse an output file that cannot be written; a command calls this before its run.

    Raises:
        TargetError: its folder does not exist, or something other than a regular file has its name.
    """
    if not path.absolute().parent.is_dir():
        raise TargetError(f"{path}: found no folder {path.parent}; expected one that exists")
    if path.is_dir():
        raise TargetError(f"{path}: found a folder; expected the name of a file")
    if path.exists() and not path.is_file():
        raise TargetError(f"{path}: found something other than a file; expected a file, or nothing")


def require_new_target(path: Path, overwrite: bool) -> None:
    """Refuse an output file that cannot be written, or one that is there and was not given up.

    Args:
        path: of the file.
        overwrite: whether the user has given up one that is there, by ``--overwrite``.

    Raises:
        TargetError: it cannot be written, or is there.
    """
    require_target(path)
    if path.exists() and not overwrite:
        raise TargetError(f"{path}: found a file that exists; expected a new name, or --overwrite")


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """While entered, no other run writes to this file; of two launches with one file the second is refused.

    The lock is on a file ``.NAME.lock`` beside it, which names its owner and is removed at the end of the run. A lock
    file that a killed run left behind is not locked, and the next run takes it over.

    Raises:
        TargetError: another run writes to the file, or nothing can be written there.
    """
    lock = path.with_name(f".{path.name}.lock")
    try:
        descriptor = _locked(lock)
    except _Held as held:
        raise TargetError(
            f"{path}: found another run that writes to it{held.who}; expected a file of this run alone; wait for that "
            "run, or name another file"
        ) from held
    except OSError as error:
        raise TargetError(f"{path}: cannot be written: {lock.name}: {error.strerror}") from error
    try:
        yield
    finally:
        with suppress(OSError):  # another user's lock, in a folder where users may remove only their own files
            lock.unlink()  # before it is unlocked: a run that opened this file meanwhile finds it gone, and opens anew
        os.close(descriptor)


class _Held(Exception):
    """Another run holds the lock; ``who`` is a text for a message, or empty."""

    def __init__(self, who: str) -> None:
        super().__init__(who)
        self.who = who


def _locked(lock: Path) -> int:
    """The descriptor of the lock file at this path, locked; the file then names this process.

    Two runs may open, lock and remove the file in any order. A descriptor therefore counts only if, once locked, it is
    still the file at this path; otherwise the loop begins again.
    """
    while True:
        descriptor = _opened(lock)
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise OSError(errno.EINVAL, "found something other than a file; expected a file, or nothing", str(lock))
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise _Held(_who(descriptor)) from error
            except OSError as error:
                if error.errno not in _NO_LOCKS:  # without locks, the later of two simultaneous runs replaces the file
                    raise
            if _is_at(descriptor, lock):
                with suppress(OSError):  # another user's file cannot be written, but it is locked
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # the run that held it removed it before this process locked it


def _opened(lock: Path) -> int:
    # neither follow a link, nor wait for the other end of a pipe
    flags = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        return os.open(lock, os.O_RDWR | os.O_CREAT | flags, 0o644)
    except PermissionError:
        return os.open(lock, os.O_RDONLY | flags)  # another user's file: read access is enough to lock it


def _is_at(descriptor: int, lock: Path) -> bool:
    try:
        there = os.lstat(lock)
    except FileNotFoundError:
        return False
    return os.path.samestat(os.fstat(descriptor), there)


def _who(descriptor: int) -> str:
    """What the lock's owner wrote into it, made safe for a message, as any user may have written it."""
    from manyhands.protocol.messages import presentable  # its module takes a tenth of a second, which --help has not

    with suppress(OSError):
        words = os.pread(descriptor, _MOST_WORDS, 0).decode(errors="replace")
        return f" ({presentable(' '.join(words.split()))})" if words else ""
    return ""


EXIT_OK = 0
EXIT_FAILED = 1  # a process failed, or a file could not be written
EXIT_BAD_INPUT = 2
EXIT_NOT_CERTIFIED = 3
EXIT_INTERRUPTED = 130  # Ctrl-C; other signals give 128 + their number
