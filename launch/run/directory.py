"""The directories of a run: a temporary one that is removed afterwards, and the one that its user keeps.

The temporary directory (mode 0700) holds bundles, sockets, keys of the run and the processes' error output. Its folder
``log`` holds the logs. If the user keeps a directory, ``log`` is a link into it, so that the logs survive a supervisor
that is killed.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Final

import yaml

from manyhands.design.files import naming, replacing
from manyhands.launch.files import TargetError
from manyhands.launch.plan.prepare import certificate_files
from manyhands.nodes.kernel.log import LOG_FOLDER
from manyhands.nodes.recorder.format import SESSION_FILE

if TYPE_CHECKING:
    from manyhands.launch.plan.prepare import Prepared

_PREFIX = "manyhands-"
_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC

REPORT: Final = "report.json"


@contextmanager
def run_directory(logs: Path | None = None) -> Iterator[Path]:
    """A new directory that is removed afterwards; ``logs`` is the folder that its ``log`` links to, and stays."""
    sweep_directories()
    directory, lock = _new_directory()
    try:
        if logs is None:
            (directory / LOG_FOLDER).mkdir(mode=0o700)
        else:
            (directory / LOG_FOLDER).symlink_to(logs.absolute(), target_is_directory=True)
        with naming(directory):
            yield directory
    finally:
        shutil.rmtree(directory)  # of a link this removes the link, not the folder behind it
        os.close(lock)


def _new_directory() -> tuple[Path, int]:
    """A new directory, and the file descriptor that holds its lock for as long as its supervisor lives."""
    while True:
        directory = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
        descriptor = os.open(directory, _FOLDER)
        try:
            if _lock(descriptor) is not Lock.HELD and os.path.samestat(os.fstat(descriptor), os.stat(directory)):
                return directory, descriptor
        except FileNotFoundError:
            pass  # another supervisor swept it before it was locked here: make a new one
        os.close(descriptor)


def sweep_directories() -> None:
    """Remove the directories that killed supervisors have left in the temporary directory.

    A supervisor holds a lock on its directory, and the kernel releases it when the process ends. The process id in the
    directory's name does not show whether the supervisor lives: containers that share a temporary directory and a user
    have process ids of their own. A directory is removed when its lock can be taken and no process here has that id. (A
    supervisor of version 0.5.0 or before holds no lock.)
    """
    for path, descriptor in _ours():
        pid = path.name.removeprefix(_PREFIX).split("-")[0]
        if not Path(f"/proc/{pid}").exists() and _lock(descriptor) is Lock.TAKEN:
            shutil.rmtree(path, ignore_errors=True)  # another supervisor may be sweeping too


def run_directories() -> list[Path]:
    """The directories of this user's runs whose supervisors live."""
    return [path for path, descriptor in _ours() if _lock(descriptor, fcntl.LOCK_SH) is not Lock.TAKEN]


class Lock(Enum):
    """The result of asking for the lock of a run's directory."""

    TAKEN = "taken"  # we hold it now: its supervisor is gone
    HELD = "held"  # its supervisor holds it
    NONE = "none"  # the file system has no locks: the state is unknown, and nothing is removed


def _lock(descriptor: int, how: int = fcntl.LOCK_EX) -> Lock:
    try:
        fcntl.flock(descriptor, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return Lock.HELD
    except OSError:
        return Lock.NONE
    return Lock.TAKEN


def _ours() -> Iterator[tuple[Path, int]]:
    """This user's run directories, each with a file descriptor that is open until the next one is asked for."""
    for path in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*-*"):
        if not path.name.removeprefix(_PREFIX).split("-")[0].isdigit():
            continue
        try:
            descriptor = os.open(path, _FOLDER)
        except OSError:  # it is gone meanwhile, belongs to another user, or is a link or a file
            continue
        try:
            if os.fstat(descriptor).st_uid == os.getuid():
                yield path, descriptor
        finally:
            os.close(descriptor)


def require_new(path: Path) -> None:
    """Refuse a path that cannot become a run's folder, before the run begins.

    Raises:
        TargetError: the path is a file, a folder that is not empty or belongs to another user, or its parent does not
            exist.
    """
    if not path.absolute().parent.is_dir():
        raise TargetError(f"{path}: found no folder {path.parent}; expected one that exists")
    if not path.exists():
        return
    if not path.is_dir():
        raise TargetError(f"{path}: found a file; expected the name of a new folder")
    if path.stat().st_uid != os.getuid():
        raise TargetError(f"{path}: found another user's folder; expected the name of a new one")
    if any(path.iterdir()):
        raise TargetError(f"{path}: found a folder that is not empty; expected a new one for each run")


def kept_files(prepared: Prepared) -> dict[str, bytes]:
    """The files that are kept of a session, contents by name: the session with every override, and its certificate.

    Both can be read again by :func:`manyhands.launch.session.load_session` and
    :func:`manyhands.design.certificate.load`.
    """
    text = yaml.safe_dump(prepared.session.as_plain(), sort_keys=False, allow_unicode=True)
    return {SESSION_FILE: text.encode(), **certificate_files(prepared)}


class SessionDirectory:
    """The folder that a user keeps of one run; it never holds a key.

    Attributes:
        path: of the folder.
    """

    def __init__(self, path: Path) -> None:
        """Make the folder, for its user alone (mode 0700).

        Raises:
            TargetError: as :func:`require_new`, or the folder cannot be made.
        """
        self.path = path
        try:
            require_new(path)
            path.mkdir(mode=0o700, exist_ok=True)
            path.chmod(0o700)  # despite the umask, and for a folder that existed
            self.logs.mkdir(mode=0o700)
        except OSError as error:
            raise TargetError(f"{path}: cannot be made a run's folder: {error.strerror}") from error

    @property
    def logs(self) -> Path:
        """The folder of the processes' logs."""
        return self.path / LOG_FOLDER

    def keep_session(self, prepared: Prepared) -> None:
        """Write the session as it runs, overrides applied, and its certificate if it has one.

        Raises:
            OSError: a file cannot be written.
        """
        for name, data in kept_files(prepared).items():
            with replacing(self.path / name) as file:
                file.write(data)


def is_bare(file: Path) -> bool:
    """Whether a file is named without a folder, and so belongs into the run's folder where there is one."""
    return file.name == str(file)
