"""Where a run keeps its files: a directory of its own that is gone afterwards, and the one that its user keeps.

Bundles, sockets, keys of one run and the processes' error output are in the first (mode 0700), which goes with the run.
The logs are in its folder ``log``, which leads to the second where there is one, so that they outlive a supervisor that
was killed.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import yaml

from manyhands.design.certificate import to_json
from manyhands.design.files import naming, replacing
from manyhands.launch.files import TargetError
from manyhands.launch.run.outcome import save_json
from manyhands.nodes.log import LOG_FOLDER
from manyhands.nodes.recorder.format import CERTIFICATE_FILE, SESSION_FILE

if TYPE_CHECKING:
    from manyhands.launch.plan.prepare import Prepared

_PREFIX = "manyhands-"
_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC

REPORT: Final = "report.json"


@contextmanager
def run_directory(logs: Path | None = None) -> Iterator[Path]:
    """A new directory that is gone afterwards; the logs in its folder ``log`` stay if ``logs`` is where they go."""
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
        shutil.rmtree(directory)  # a link is removed, not what it leads to
        os.close(lock)


def _new_directory() -> tuple[Path, int]:
    """A new directory, and the descriptor that holds the lock on it: for as long as its supervisor lives."""
    while True:
        directory = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
        descriptor = os.open(directory, _FOLDER)
        try:
            if _lock(descriptor) is not Lock.HELD and os.path.samestat(os.fstat(descriptor), os.stat(directory)):
                return directory, descriptor
        except FileNotFoundError:
            pass  # somebody swept it between its making and its locking
        os.close(descriptor)


def sweep_directories() -> None:
    """Remove what runs whose supervisor was killed have left in the temporary directory.

    A supervisor holds a lock on its directory, which the kernel takes from it when it ends. Its process id, which the
    directory's name bears, does not show whether it lives: containers that share a temporary directory and a user have
    process ids of their own. A directory is removed when its lock can be taken and no process here has that id (a
    supervisor of version 0.5.0 or before holds no lock).
    """
    for path, descriptor in _ours():
        pid = path.name.removeprefix(_PREFIX).split("-")[0]
        if not Path(f"/proc/{pid}").exists() and _lock(descriptor) is Lock.TAKEN:
            shutil.rmtree(path, ignore_errors=True)  # another supervisor may be sweeping too


def run_directories() -> list[Path]:
    """The directories of the runs of this user whose supervisors live."""
    return [path for path, descriptor in _ours() if _lock(descriptor, fcntl.LOCK_SH) is not Lock.TAKEN]


class Lock(Enum):
    """What came of asking for the lock of a run's directory."""

    TAKEN = "taken"  # by us: its supervisor is gone
    HELD = "held"  # by its supervisor
    NONE = "none"  # the file system has no locks: nobody can say, and nothing is removed


def _lock(descriptor: int, how: int = fcntl.LOCK_EX) -> Lock:
    try:
        fcntl.flock(descriptor, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return Lock.HELD
    except OSError:
        return Lock.NONE
    return Lock.TAKEN


def _ours() -> Iterator[tuple[Path, int]]:
    """This user's directories of runs, each with a descriptor that is open until the next one is asked for."""
    for path in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*-*"):
        if not path.name.removeprefix(_PREFIX).split("-")[0].isdigit():
            continue
        try:
            descriptor = os.open(path, _FOLDER)
        except OSError:  # it went meanwhile, is another user's, a link or a file
            continue
        try:
            if os.fstat(descriptor).st_uid == os.getuid():
                yield path, descriptor
        finally:
            os.close(descriptor)


def require_new(path: Path) -> None:
    """Refuse what cannot become a run's folder; before a run, not after it.

    Raises:
        TargetError: it is there and not empty, or no folder, or another user's, or its own folder is not there.
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
    """What is kept of a session beside its run, contents by name: itself with every override, and its certificate.

    Both are read back as what they were: :func:`manyhands.launch.session.load_session`,
    :func:`manyhands.design.certificate.load`.
    """
    text = yaml.safe_dump(prepared.session.as_plain(), sort_keys=False, allow_unicode=True)
    out = {SESSION_FILE: text.encode()}
    if prepared.certificate is not None:
        out[CERTIFICATE_FILE] = to_json(prepared.certificate).encode()
    return out


class SessionDirectory:
    """Everything of one run that its user keeps, in one place; never a key.

    Attributes:
        path: the directory.
    """

    def __init__(self, path: Path) -> None:
        """Make the directory, for its user alone (mode 0700).

        Raises:
            TargetError: as :func:`require_new`, or it cannot be made.
        """
        self.path = path
        try:
            require_new(path)
            path.mkdir(mode=0o700, exist_ok=True)
            path.chmod(0o700)  # whatever the umask, and for one that was there
            self.logs.mkdir(mode=0o700)
        except OSError as error:
            raise TargetError(f"{path}: cannot be made a run's folder: {error.strerror}") from error

    @property
    def logs(self) -> Path:
        """Where the processes' logs are."""
        return self.path / LOG_FOLDER

    def keep_session(self, prepared: Prepared) -> None:
        """Write the session as it is run, overrides applied, and its certificate if it has one.

        Raises:
            OSError: they cannot be written.
        """
        for name, data in kept_files(prepared).items():
            with replacing(self.path / name) as file:
                file.write(data)

    def keep_report(self, report: Mapping[str, Any]) -> None:
        """Write the report.

        Raises:
            OSError: it cannot be written.
        """
        save_json(report, self.path / REPORT)


def is_bare(file: Path) -> bool:
    """Whether a file is named without a folder, and so belongs in a run's directory where there is one."""
    return file.name == str(file)
