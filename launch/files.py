"""Refusing beforehand what cannot be written, and keeping others from the same file while it is being written.

The exit codes of the command line, which other programs rely on.

The sessions that come with the package, by name.
"""

from __future__ import annotations

import errno
import fcntl
import importlib.resources
import os
import socket
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from manyhands.launch.session import Session, load_session
from manyhands.protocol.messages import presentable

_MOST_WORDS: Final = 300
_NO_LOCKS: Final = (errno.EBADF, errno.ENOLCK, errno.EOPNOTSUPP)
"""What a file system says that has no locks, as some on a network."""


class TargetError(Exception):
    """A file cannot be written where it was asked for."""


def require_target(path: Path) -> None:
    """Refuse a file name that cannot be written to; before a run, not after it.

    Raises:
        TargetError: no such folder, or something other than a regular file of that name.
    """
    if not path.absolute().parent.is_dir():
        raise TargetError(f"{path}: found no folder {path.parent}; expected one that exists")
    if path.is_dir():
        raise TargetError(f"{path}: found a folder; expected the name of a file")
    if path.exists() and not path.is_file():
        raise TargetError(f"{path}: found something other than a file; expected a file, or nothing")


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """While entered, no other run writes to this file: the second of two launches is refused, not lost.

    The lock is on a file ``.NAME.lock`` beside it, which says whose it is and goes with the run. One that a killed run
    left behind is not locked, and is taken over.

    Raises:
        TargetError: another run writes to it, or nothing can be written there.
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
        with suppress(OSError):  # another user's lock in a folder where each may remove his own alone
            lock.unlink()  # while it is held: whoever opened it meanwhile sees that it is another by now
        os.close(descriptor)


class _Held(Exception):
    """Somebody holds a lock; ``who`` is a text for a message."""

    def __init__(self, who: str) -> None:
        super().__init__(who)
        self.who = who


def _locked(lock: Path) -> int:
    """The descriptor of the lock file at this path, locked, with our name in it."""
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
                if error.errno not in _NO_LOCKS:  # with them, two runs at once end as two that follow each other
                    raise
            if _is_at(descriptor, lock):
                with suppress(OSError):  # another user's file: it is locked all the same
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # its run ended between our opening and our locking it


def _opened(lock: Path) -> int:
    # not through a link, and not to wait for the other end of a pipe
    flags = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        return os.open(lock, os.O_RDWR | os.O_CREAT | flags, 0o644)
    except PermissionError:
        return os.open(lock, os.O_RDONLY | flags)  # another user's; whoever may read it may lock it


def _is_at(descriptor: int, lock: Path) -> bool:
    try:
        there = os.lstat(lock)
    except FileNotFoundError:
        return False
    return os.path.samestat(os.fstat(descriptor), there)


def _who(descriptor: int) -> str:
    """What the lock's holder wrote into it, as a text for a message: anybody may have written it."""
    with suppress(OSError):
        words = os.pread(descriptor, _MOST_WORDS, 0).decode(errors="replace")
        return f" ({presentable(' '.join(words.split()))})" if words else ""
    return ""


EXIT_OK = 0
EXIT_FAILED = 1  # a process failed, or a file could not be written
EXIT_BAD_INPUT = 2
EXIT_NOT_CERTIFIED = 3
EXIT_INTERRUPTED = 130  # Ctrl-C; other signals likewise, 128 + their number


def load_named(name: Path | str, overrides: Sequence[str] = ()) -> Session:
    """The session at a path, or the shipped one of that name, with or without its suffix.

    Args:
        name: a path; one that does not exist and names no folder may be a shipped session.
        overrides: ``KEY.PATH=VALUE`` each.

    Raises:
        SessionError: whatever is wrong with either.
    """
    path = Path(name)
    if not path.exists() and len(path.parts) == 1:
        shipped = importlib.resources.files("manyhands.launch") / "sessions" / f"{path.name.removesuffix('.yaml')}.yaml"
        with importlib.resources.as_file(shipped) as file:
            if file.exists():
                return load_session(file, overrides)
    return load_session(path, overrides)
