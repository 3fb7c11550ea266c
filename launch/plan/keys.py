"""The keys of a session: made once in a folder, kept from then on, and handed to each process as its own ring.

    FOLDER/public.json          public keys by name: for every machine
    FOLDER/private/NAME.key     mode 0600, in a folder of mode 0700: for the machine that runs NAME alone

A run that is interrupted can be repeated: every private key is whole or absent, and the public keys, which make keys
known, are written last.

The folder in which a session's keys are kept: what is where, who may enter it, and one at a time.

What `manyhands keys` does, from a loaded session to what is printed; apart from :mod:`keys`, which runs need too.
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

from rich.console import Console
from rich.table import Table

from manyhands.launch.design_report import print_json
from manyhands.launch.files import EXIT_OK
from manyhands.launch.plan.topology import roster
from manyhands.launch.run.display import say
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


class KeyState(StrEnum):
    """What became of a process's key when keys were made."""

    NEW = "new"
    KEPT = "kept"
    RENEWED = "renewed"
    ELSEWHERE = "elsewhere"  # known, but its private key is not in this folder: moved to its machine, or lost


@dataclass(frozen=True)
class Made:
    """What making keys did, names in the order of :func:`roster`.

    Attributes:
        new: keys made for processes that had none.
        kept: keys that were there.
        renewed: keys made in place of others.
        elsewhere: public keys kept whose private keys are not in this folder.
        stale: names of keys that the session no longer has; they are left where they are.
    """

    new: tuple[str, ...]
    kept: tuple[str, ...]
    renewed: tuple[str, ...]
    elsewhere: tuple[str, ...]
    stale: tuple[str, ...]


class Keys:
    """A session's keys, from wherever they are kept.

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
        """Keys whose pairs ``find`` gives by one of ``names``, or raises :class:`KeyFileError`.

        ``private``: the folder of their files, if they have any.
        """
        self.public = public
        self._private = private
        self._names = tuple(names)
        self._find = find

    def pair(self, name: str) -> KeyPair:
        """The pair of a process.

        Raises:
            KeyFileError: no such process, no key of it here, or another than the public keys say.
        """
        if name not in self._names:  # a name from elsewhere must not become a path
            raise KeyFileError(f"{self.public.session}: found no {name!r}; expected {one_of(self._names, name)}")
        pair = self._find(name)
        if pair.public != self.public.keys.get(name):
            raise KeyFileError(_disagreement(self.public.session, name))
        return pair

    def ring(self, name: str, peers: Iterable[str]) -> KeyRing:
        """What a process holds that talks to these peers.

        Raises:
            KeyFileError: as :meth:`pair`, or a peer has no public key.
        """
        return ring_of(name, self.pair(name), self.public, peers)

    def file(self, name: str, folder: Path) -> Path:
        """The file of the private key of a process: where it is kept, or else written to ``folder`` for this run.

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
            OSError: it cannot be written.
        """
        path = folder / f"{name}{SUFFIX}"
        save_private(self.pair(name), self.public.session, name, path)
        return path


def make_keys(session: Session, folder: Path, renew: Sequence[str] = ()) -> Made:
    """Make the keys of a session that are missing in a folder, and keep those that are there.

    Everything that is there is checked before anything is written.

    Args:
        session: the session.
        folder: where its keys are; made if absent.
        renew: names whose keys are to be replaced.

    Raises:
        KeyFileError: ``renew`` names nobody; the folder is another session's, open to others, or in use by another such
            run; a key in it is no key, open to others, or not the one that the public keys say.
        OSError: something cannot be written.
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
                f"{folder / PUBLIC}: found {len(keys)} keys, {len(stale)} of them of nobody in the session; "
                f"expected at most {MAX_KEYS} with those to be made; begin in another folder"
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
    """The keys of a session from a folder; a private key is read when it is asked for.

    Raises:
        KeyFileError: the public keys are not readable, another session's, or lack one; or the private ones are open to
            others.
    """
    path, private, names = folder / PUBLIC, folder / PRIVATE, roster(session)
    public = _of_session(session, PublicKeys.load(path), path)
    missing = [name for name in names if name not in public.keys]
    if missing:
        raise KeyFileError(
            f"{path}: found no key of {missing[0]!r}{f' and {len(missing) - 1} more' if missing[1:] else ''}; expected "
            "one for everybody in the session; make them with manyhands keys, which keeps those that are there"
        )
    if os.path.lexists(private):
        require_folder(private, private=True)
    return Keys(public, names, lambda name: load_private(private_path(private, name), session.name, name), private)


def ephemeral(names: Iterable[str], session_name: str) -> Keys:
    """New keys for one run, in memory.

    Raises:
        KeyFileError: the installed libzmq has no CURVE.
    """
    pairs = {name: new_pair() for name in names}
    public = PublicKeys(session_name, {name: pair.public for name, pair in pairs.items()})
    return Keys(public, pairs, pairs.__getitem__)


def _known_keys(session: Session, folder: Path) -> Mapping[str, str]:
    """The public keys that are in a folder already."""
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
    """What is to become of a key; one that is kept enters ``keys``."""
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
    """Make a pair, put its private key in its place, whole or not at all, and return the public one."""
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
        f"{place}: found a private key of {name!r} that is not the one of its public key in {PUBLIC}; expected a pair; "
        f"put back what was replaced, or make both anew with manyhands keys --renew {name}"
    )


def run_keys(session: Session, folder: Path, renew: Sequence[str], out: Console, err: Console, as_json: bool) -> int:
    """Make a session's keys, and tell what was made and what to do with it.

    Args:
        session: the session.
        folder: where its keys are, or are to be.
        renew: names whose keys are to be replaced.
        out: for the table.
        err: for what to do next.
        as_json: print one JSON object instead of the table.

    Returns:
        The exit code.

    Raises:
        KeyFileError: as :func:`make_keys`.
        OSError: something cannot be written.
    """
    made = make_keys(session, folder, renew)
    states = {name: state for state in KeyState for name in getattr(made, state.value)}
    if as_json:
        print_json(_object(session, folder, made, states))
    else:
        table = Table(title=f"{session.name}: keys", title_justify="left")
        for column in ("name", "role", "key"):
            table.add_column(column)
        for name, role in roster(session).items():
            table.add_row(name, role.value, states[name].value)
        out.print(table)
    _say_next(session, folder, made, err)
    return EXIT_OK


def _object(session: Session, folder: Path, made: Made, states: dict[str, KeyState]) -> dict[str, object]:
    """The object that ``--json`` prints; it names files, and no key."""
    private = folder / PRIVATE
    return {
        "session": session.name,
        "public": str(folder / PUBLIC),
        "keys": {
            name: {
                "role": role.value,
                "key": states[name].value,
                "private": None if states[name] is KeyState.ELSEWHERE else str(private_path(private, name)),
            }
            for name, role in roster(session).items()
        },
        "stale": list(made.stale),
    }


def _say_next(session: Session, folder: Path, made: Made, err: Console) -> None:
    private = folder / PRIVATE
    say(err, f"to machines that launch the session: {folder / PUBLIC}")
    say(
        err,
        f"to the machine that runs NAME, and to no other: {private}/NAME{SUFFIX} (mode 0600; over a secure channel), "
        "with its bundle (manyhands invite)",
    )
    if made.new or made.renewed:
        say(
            err, f"the public keys have changed: an older {PUBLIC} elsewhere, and older bundles, are of no use any more"
        )
    for name in made.elsewhere:
        say(err, f"{name}: its private key is not here: on its own machine, or lost; then make it anew: --renew {name}")
    if made.stale:
        say(err, f"not in {session.name} any more, and left where they are: {', '.join(made.stale)}")
