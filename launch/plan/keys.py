"""The keys of a session, which `manyhands invite` makes: the folder that holds them, and each process's own key ring.

    FOLDER/public.json          public keys by name: for every machine
    FOLDER/private/NAME.key     mode 0600, in a folder of mode 0700: for the machine that runs NAME alone

Keys are made once and then kept. Only one process at a time makes keys in a folder, and no other user may enter the
private folder. An interrupted `manyhands invite` can be repeated: every private key is whole or absent, and the public
keys, which make the keys known, are written last.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

from manyhands.launch.plan.topology import roster
from manyhands.launch.session import Session
from manyhands.launch.session.errors import one_of
from manyhands.protocol.keys import (
    MAX_KEYS,
    KeyFileError,
    KeyPair,
    KeyRing,
    PublicKeys,
    load_private,
    new_pair,
    problem_of_folder,
    ring_of,
    save_private,
    sync_folder,
)

PUBLIC: Final = "public.json"
PRIVATE: Final = "private"
SUFFIX: Final = ".key"


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """While entered, no other process makes keys in this folder, which is made if absent.

    Raises:
        KeyFileError: another process does, other users can write to the folder, or the path is no folder.
    """
    try:
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        found = "a link that leads to no folder" if folder.is_symlink() else "a file"
        raise KeyFileError(f"{folder}: found {found}; expected the name of a folder") from error
    require_folder(folder, private=False)
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise KeyFileError(
                f"{folder}: found another command that makes keys there; expected to be alone"
            ) from error
        except OSError as error:
            # some network file systems lock no folders; two simultaneous runs could then make keys that disagree,
            # which every reader reports
            if error.errno not in (errno.EBADF, errno.ENOLCK, errno.EOPNOTSUPP):
                raise
        yield
    finally:
        os.close(descriptor)


def require_folder(folder: Path, *, private: bool) -> None:
    """Refuse a folder to which other users can write, or a ``private`` one that they can enter.

    Raises:
        KeyFileError: it is such a folder, or no folder.
    """
    # the private folder must not be a link; the outer one may link to any place where the user keeps it
    problem = problem_of_folder(os.lstat(folder) if private else os.stat(folder), os.geteuid(), private=private)
    if problem is not None:
        raise KeyFileError(f"{folder}: {problem}")


def private_folder(folder: Path) -> Path:
    """The folder of private keys in a folder of keys, made if absent.

    Raises:
        KeyFileError: something else has its name, or other users can enter it.
    """
    private = folder / PRIVATE
    if not os.path.lexists(private):
        private.mkdir(mode=0o700)
        private.chmod(0o700)  # the umask may have removed bits
    require_folder(private, private=True)
    return private


def held_names(private: Path) -> frozenset[str]:
    """The names of the keys in a folder of private keys, without names that cannot be printed."""
    names = (path.name.removesuffix(SUFFIX) for path in private.iterdir() if path.name.endswith(SUFFIX))
    return frozenset(name for name in names if name.isprintable() and not name.startswith("."))


def private_path(private: Path, name: str) -> Path:
    """The file of a private key."""
    return private / f"{name}{SUFFIX}"


class KeyState(StrEnum):
    """What `manyhands invite` did with a process's key."""

    NEW = "new"
    KEPT = "kept"
    RENEWED = "renewed"
    ELSEWHERE = "elsewhere"  # only the public key is in this folder: the private key was moved to its machine, or lost


@dataclass(frozen=True)
class Made:
    """What :func:`make_keys` did; names in the order of :func:`roster`.

    Attributes:
        new: processes that had no key and got one.
        kept: processes whose keys were kept.
        renewed: processes whose keys were replaced.
        elsewhere: processes whose public keys were kept, and whose private keys are not in this folder.
        stale: names of keys that the session no longer has; their files are left in place.
    """

    new: tuple[str, ...]
    kept: tuple[str, ...]
    renewed: tuple[str, ...]
    elsewhere: tuple[str, ...]
    stale: tuple[str, ...]


class Keys:
    """A session's keys, from a folder or from memory.

    Attributes:
        public: the public keys.
    """

    def __init__(
        self,
        public: PublicKeys,
        names: Iterable[str],
        find: Callable[[str], KeyPair],
        private: Path | None = None,
    ) -> None:
        """Keys of the processes ``names``.

        Args:
            public: the public keys.
            names: the processes that have keys.
            find: returns the pair of a name, or raises :class:`KeyFileError`.
            private: the folder of the private keys' files; None for keys in memory.
        """
        self.public = public
        self._private = private
        self._names = tuple(names)
        self._find = find

    def pair(self, name: str) -> KeyPair:
        """The pair of a process.

        Raises:
            KeyFileError: there is no such process or no key of it here, or its key is not that of the public keys.
        """
        if name not in self._names:  # an unchecked name must not become a path
            raise KeyFileError(f"{self.public.session}: found no {name!r}; expected {one_of(self._names, name)}")
        pair = self._find(name)
        if pair.public != self.public.keys.get(name):
            raise KeyFileError(_disagreement(self.public.session, name))
        return pair

    def ring(self, name: str, peers: Iterable[str]) -> KeyRing:
        """The key ring of a process that communicates with these peers.

        Raises:
            KeyFileError: as :meth:`pair`, or a peer has no public key.
        """
        return ring_of(name, self.pair(name), self.public, peers)

    def file(self, name: str, folder: Path) -> Path:
        """The file of a process's private key: in the folder of keys, or written to ``folder`` for this run.

        Raises:
            KeyFileError, OSError: as :meth:`write`.
        """
        if self._private is None:
            return self.write(name, folder)
        self.pair(name)
        return private_path(self._private, name)

    def write(self, name: str, folder: Path) -> Path:
        """Write the private key of a process into a folder, as a new file; returns its path.

        Raises:
            KeyFileError: as :meth:`pair`.
            OSError: the file cannot be written.
        """
        path = folder / f"{name}{SUFFIX}"
        save_private(self.pair(name), self.public.session, name, path)
        return path


def make_keys(session: Session, folder: Path, renew: Sequence[str] = ()) -> Made:
    """Make the keys of a session that a folder lacks, and keep those that it has.

    All existing keys are checked before anything is written.

    Args:
        session: the session.
        folder: the folder of its keys; made if absent.
        renew: names whose keys are to be replaced.

    Raises:
        KeyFileError: a name in ``renew`` is not in the session. Or the folder is another session's, open to other
            users, or in use by another process that makes keys. Or a key in it is invalid, open to other users, or not
            that of the public keys.
        OSError: a file cannot be written.
    """
    names = roster(session)
    for name in renew:
        if name not in names:
            raise KeyFileError(f"--renew: found {name!r}; expected {one_of(names, name)}")
    with alone_in(folder):
        keys = dict(_known_keys(session, folder))
        private = private_folder(folder)
        stale = sorted((keys.keys() | held_names(private)) - names.keys())
        states = {name: _state(session, name, private, keys, renew) for name in names}
        _public(session, folder, keys)
        if len(keys.keys() | names.keys()) > MAX_KEYS:
            raise KeyFileError(
                f"{folder / PUBLIC}: found {len(keys)} keys, {len(stale)} of them with names that the session does not "
                f"have; expected at most {MAX_KEYS} together with the new ones; begin in another folder"
            )
        for name, state in states.items():
            if state in (KeyState.NEW, KeyState.RENEWED):
                keys[name] = _place_new(session.name, name, private_path(private, name))
        sync_folder(private)
        _public(session, folder, keys).save(folder / PUBLIC)

    def those(state: KeyState) -> tuple[str, ...]:
        return tuple(name for name in names if states[name] is state)

    return Made(
        new=those(KeyState.NEW),
        kept=those(KeyState.KEPT),
        renewed=those(KeyState.RENEWED),
        elsewhere=those(KeyState.ELSEWHERE),
        stale=tuple(stale),
    )


def load_folder(session: Session, folder: Path) -> Keys:
    """The keys of a session from a folder; a private key is read at its first use.

    Raises:
        KeyFileError: the public keys are not readable, another session's, or incomplete; or other users can enter the
            folder of private keys.
    """
    path, private, names = folder / PUBLIC, folder / PRIVATE, roster(session)
    public = _of_session(session, PublicKeys.load(path), path)
    missing = [name for name in names if name not in public.keys]
    if missing:
        raise KeyFileError(
            f"{path}: found no key of {missing[0]!r}{f' and {len(missing) - 1} more' if missing[1:] else ''}; expected "
            "one for every process of the session; make them with manyhands invite, which keeps existing keys"
        )
    if os.path.lexists(private):
        require_folder(private, private=True)
    return Keys(public, names, lambda name: load_private(private_path(private, name), session.name, name), private)


def ephemeral(names: Iterable[str], session_name: str) -> Keys:
    """New keys for one run, which exist in memory only.

    Raises:
        KeyFileError: the installed libzmq has no CURVE.
    """
    pairs = {name: new_pair() for name in names}
    public = PublicKeys(session_name, {name: pair.public for name, pair in pairs.items()})
    return Keys(public, pairs, pairs.__getitem__)


def _known_keys(session: Session, folder: Path) -> Mapping[str, str]:
    """The public keys that a folder already has."""
    path = folder / PUBLIC
    return _of_session(session, PublicKeys.load(path), path).keys if os.path.lexists(path) else {}


def _of_session(session: Session, public: PublicKeys, path: Path) -> PublicKeys:
    if public.session != session.name:
        raise KeyFileError(
            f"{path}: found the keys of session {public.session!r}; expected those of {session.name!r}; "
            "keep each session's keys in a folder of its own"
        )
    return public


def _public(session: Session, folder: Path, keys: Mapping[str, str]) -> PublicKeys:
    try:
        return PublicKeys(session.name, keys)
    except ValueError as error:
        raise KeyFileError(f"{folder}: {error}") from error


def _state(session: Session, name: str, private: Path, keys: dict[str, str], renew: Sequence[str]) -> KeyState:
    """What to do with a process's key; the public key of one that is kept is added to ``keys``."""
    path = private_path(private, name)
    there = os.path.lexists(path)
    if name in renew:
        if there and not stat.S_ISREG(os.lstat(path).st_mode):
            raise KeyFileError(f"{path}: found something other than a file; expected a key, or nothing")
        return KeyState.RENEWED if there or name in keys else KeyState.NEW
    if there:
        public = load_private(path, session.name, name).public
        if keys.setdefault(name, public) != public:
            raise KeyFileError(_disagreement(path, name))
        return KeyState.KEPT
    return KeyState.ELSEWHERE if name in keys else KeyState.NEW


def _place_new(session: str, name: str, path: Path) -> str:
    """Make a pair, write its private key to ``path``, whole or not at all, and return the public key."""
    pair = new_pair()
    partial = path.with_name(f".{path.name}.part")
    partial.unlink(missing_ok=True)  # of a run that was killed
    try:
        save_private(pair, session, name, partial)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    return pair.public


def _disagreement(place: Path | str, name: str) -> str:
    return (
        f"{place}: found a private key of {name!r} that does not match its public key in {PUBLIC}; expected a pair; "
        "restore the file that was replaced, or make a new pair with manyhands invite SESSION --keys DIR --renew "
        f"{name}"
    )
