"""The folder in which a session's keys are kept: what is where, who may enter it, and one at a time."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from manyhands.protocol.key_files import problem_of_folder
from manyhands.protocol.keys import KeyFileError

PUBLIC: Final = "public.json"
PRIVATE: Final = "private"
SUFFIX: Final = ".key"


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """While entered, no other run makes keys in this folder, which is made if absent.

    Raises:
        KeyFileError: another one does, others can write to it, or there is something other than a folder.
    """
    try:
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise KeyFileError(f"{folder}: found a file; expected the name of a folder") from error
    require_folder(folder, private=False)
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise KeyFileError(f"{folder}: found another run that makes keys there; expected to be alone") from error
        except OSError as error:
            # some network file systems lock no folders; two runs at once would then end in keys that disagree, which
            # every reader reports
            if error.errno not in (errno.EBADF, errno.ENOLCK, errno.EOPNOTSUPP):
                raise
        yield
    finally:
        os.close(descriptor)


def require_folder(folder: Path, *, private: bool) -> None:
    """Refuse a folder that others could enter, where it is of private keys, or write to.

    Raises:
        KeyFileError: it is such a folder, or none.
    """
    # the private folder must be one itself; the outer one may be a link to wherever the user keeps it
    problem = problem_of_folder(os.lstat(folder) if private else os.stat(folder), os.geteuid(), private=private)
    if problem is not None:
        raise KeyFileError(f"{folder}: {problem}")


def private_folder(folder: Path) -> Path:
    """The folder of private keys in a folder of keys, made if absent.

    Raises:
        KeyFileError: there is something else, or others can enter it.
    """
    private = folder / PRIVATE
    if not os.path.lexists(private):
        private.mkdir(mode=0o700)
        private.chmod(0o700)  # the umask may have taken from it
    require_folder(private, private=True)
    return private


def held_names(private: Path) -> frozenset[str]:
    """The names in a folder of private keys, as far as they can be shown."""
    names = (path.name.removesuffix(SUFFIX) for path in private.iterdir() if path.name.endswith(SUFFIX))
    return frozenset(name for name in names if name.isprintable() and not name.startswith("."))


def private_path(private: Path, name: str) -> Path:
    """The file of a private key."""
    return private / f"{name}{SUFFIX}"
