"""The keys by which processes recognise each other: CURVE pairs, the key ring of one process, and their files.

A link is as trustworthy as the storage of its keys. So this module prevents three mistakes: a secret that is printed,
pickled or copied by accident; a private file that others can read, or that a link replaced; a public key that is not
its owner's. A key is the 40 characters of Z85 in which ZeroMQ writes 32 bytes.

Key files follow the rules of ssh: exact modes, no links, no half-written files, and no content in messages. A key file
is one JSON object with its kind, its version and the members of that kind.
"""

from __future__ import annotations

import errno
import json
import os
import stat
import struct
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NoReturn, Self

import zmq
from zmq.utils import z85

from manyhands.protocol.limits import MAX_NAME

_VERSION: Final = 1
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
_OTHERS_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH


class KeyFileError(Exception):
    """A key cannot be used; the message names the file or the key's owner, and never quotes a private key's file."""


def create(path: Path, kind: str, members: Mapping[str, Any], mode: int) -> None:
    """Write a new key file of exactly this mode, never through a link; it is on the disk when this returns.

    Args:
        path: the file.
        kind: its kind, which the file states.
        members: its members besides kind and version.
        mode: its permissions, whatever the umask.

    Raises:
        FileExistsError: the path exists, possibly as a link.
        OSError: the file cannot be written; no part of it is left.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(path, flags, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            os.fchmod(descriptor, mode)  # the umask may have removed permissions
            file.write(json.dumps({"format": kind, "version": _VERSION, **members}, indent=2).encode() + b"\n")
            file.flush()
            os.fsync(descriptor)
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Write the names in a folder to the disk (fsync)."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read(
    path: Path, kind: str, members: Set[str], limit: int, *, private: bool, writer: str = "manyhands invite"
) -> dict[str, Any]:
    """Read a key file; returns its members, whose types are not checked.

    Args:
        path: the file.
        kind: the kind that the file must state.
        members: exactly the members that it must have, besides its kind and version.
        limit: its greatest length, bytes.
        private: whether the file must belong to the user, be closed to others, and be no link; a file that is not
            private must only be closed to writing by others.
        writer: the command that writes such files, for the messages.

    Raises:
        KeyFileError: the file cannot be read, cannot be trusted, or is no such file.
    """
    data = _object(_content(path, limit, private=private, writer=writer))
    problem = None
    if not isinstance(data, dict) or data.pop("format", None) != kind:
        problem = f"found no file of {kind}; expected one as {writer} writes it"
    elif type(version := data.pop("version", None)) is not int or version != _VERSION:
        problem = f"found another version of {kind}; expected version {_VERSION}; make it with this manyhands"
    elif data.keys() != members:
        problem = f"found other members; expected format, version, {', '.join(sorted(members))}"
    if problem is not None:
        raise KeyFileError(f"{path}: {problem}")
    found: dict[str, Any] = data
    return found


def private_line(path: Path, limit: int, writer: str) -> str:
    """The text of a file of one line that holds a key, after the checks of a private key's file.

    Args:
        path: the file.
        limit: its greatest length, bytes.
        writer: the command that writes such files, for the messages.

    Raises:
        KeyFileError: the file cannot be read, cannot be trusted, or is no text of ASCII.
    """
    try:
        return _content(path, limit, private=True, writer=writer).decode("ascii").strip()
    except UnicodeDecodeError:  # its text would quote the content
        raise KeyFileError(f"{path}: found no text; expected a file as {writer} writes it") from None


def _content(path: Path, limit: int, *, private: bool, writer: str) -> bytes:
    """The content of a file, after a check that it can be trusted."""
    # O_NONBLOCK: a pipe of that name must not block. The check is of the descriptor, for the name may change meanwhile
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | (os.O_NOFOLLOW if private else 0)
    try:
        descriptor = os.open(path, flags)
    except OSError as error:
        if private and error.errno == errno.ELOOP:
            found = "found a link; expected the file itself"
        elif error.errno == errno.ENOENT:
            found = f"found no file; expected one as {writer} writes it"
        else:
            found = f"cannot be read: {error.strerror}"
        raise KeyFileError(f"{path}: {found}") from error
    try:
        status = os.fstat(descriptor)
        problem = problem_of_file(status, os.geteuid(), private=private)
        if problem is None and status.st_size > limit:
            problem = f"found {status.st_size} bytes; expected at most {limit}"
        if problem is not None:
            raise KeyFileError(f"{path}: {problem}")
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            content = file.read(limit + 1)  # it may have grown
    finally:
        os.close(descriptor)
    if len(content) > limit:
        raise KeyFileError(f"{path}: found more than {limit} bytes; expected at most that")
    return content


def problem_of_file(status: os.stat_result, user: int, *, private: bool) -> str | None:
    """The reason why a user (an effective user id) cannot trust a key's file; None if the user can."""
    mode = stat.S_IMODE(status.st_mode)
    if not stat.S_ISREG(status.st_mode):
        return "found something other than a file; expected a file"
    if private and status.st_uid not in (user, 0):
        return f"found a file of user {status.st_uid}; expected one of user {user}, who is to use it"
    if private and mode & _OTHERS:
        return f"found mode {mode:04o}, which lets others in; expected 0600; do chmod 600, and renew the key"
    if mode & _OTHERS_WRITE:
        return f"found mode {mode:04o}, which lets others add keys; expected 0644; do chmod 644, and compare the keys"
    return None


def problem_of_folder(status: os.stat_result, user: int, *, private: bool) -> str | None:
    """The reason why a user cannot trust a folder of keys, or of ``private`` keys; None if the user can."""
    mode = stat.S_IMODE(status.st_mode)
    if not stat.S_ISDIR(status.st_mode):
        return "found something other than a folder; expected a folder"
    if status.st_uid not in (user, 0):
        return f"found a folder of user {status.st_uid}; expected one of user {user}, who is to use it"
    if private and mode & _OTHERS:
        return f"found mode {mode:04o}, which lets others in; expected 0700; do chmod 700"
    if mode & _OTHERS_WRITE:
        return f"found mode {mode:04o}, which lets others replace keys; expected 0755; do chmod 755"
    return None


def _object(content: bytes) -> Any:
    """The JSON value of ``content``; None where it is no JSON. The error is dropped, for it would quote the content."""
    try:
        return json.loads(content, object_pairs_hook=_without_duplicates)
    except (ValueError, RecursionError):
        return None


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; a name given twice is refused, for a person might then read a key that is not in use."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a name is given twice")
    return found


KEY_LENGTH: Final = 40
"""The number of characters of a key."""

MAX_KEYS: Final = 4096
"""The most public keys of one session: those of nodes, observers and supervisor, and some of former nodes."""

MAX_PRIVATE_BYTES: Final = 4096
"""The greatest length of a private key's file."""

MAX_PUBLIC_BYTES: Final = 8 * 2**20
"""The greatest length of a file of public keys; :data:`MAX_KEYS` names of the greatest length need 5 MiB."""

_PRIVATE_KIND: Final = "manyhands private key"
_PUBLIC_KIND: Final = "manyhands public keys"


class KeyPair:
    """A public key and the secret that belongs to it.

    The constructor computes the public key from the secret, so the two always fit. A pair cannot be printed with its
    secret, pickled or copied. Two pairs are equal if their public keys are.

    Attributes:
        public: the key by which others recognise this process.
        secret: the key that no other process may have.
    """

    __slots__ = ("_public", "_secret")

    def __init__(self, public: str, secret: str) -> None:
        """Take a pair.

        Raises:
            ValueError: a value is no key, or the public key does not belong to the secret.
        """
        for value, what in ((public, "public"), (secret, "secret")):
            if not is_key(value):
                raise ValueError(f"found a {what} key that is no key; expected {KEY_LENGTH} characters of Z85")
        if zmq.curve_public(secret.encode()).decode() != public:
            raise ValueError("found a public key that does not belong to the secret; expected the two of one pair")
        self._public, self._secret = public, secret

    @property
    def public(self) -> str:
        """The key by which others recognise this process."""
        return self._public

    @property
    def secret(self) -> str:
        """The key that no other process may have; use it for a socket's option, and for nothing else."""
        return self._secret

    def __repr__(self) -> str:
        return f"KeyPair(public={self._public!r}, secret hidden)"

    def __eq__(self, other: object) -> bool:
        return self._public == other._public if isinstance(other, KeyPair) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._public)

    # pickle, copy and dataclasses.asdict all call this
    def __reduce__(self) -> NoReturn:
        raise TypeError("found a key pair to be pickled or copied; expected it to stay in its process")

    def __getstate__(self) -> NoReturn:
        self.__reduce__()


@dataclass(frozen=True)
class KeyRing:
    """The keys of one process: its own pair, and the public keys of the peers that it may talk to.

    Attributes:
        name: the name of the process.
        pair: its own pair.
        peers: by peer, its public key.

    Raises:
        ValueError: a name or a key is not valid, two keys are the same, or the process is among its own peers.
    """

    name: str
    pair: KeyPair
    peers: Mapping[str, str]

    def __post_init__(self) -> None:
        problem = _problem_of_keys({**self.peers, self.name: self.pair.public})
        if problem is None and self.name in self.peers:
            problem = f"found {self.name!r} among its own peers; expected others"
        if problem is not None:
            raise ValueError(problem)
        object.__setattr__(self, "peers", MappingProxyType(dict(self.peers)))


@dataclass(frozen=True)
class PublicKeys:
    """The public keys of a session.

    Attributes:
        session: the session's name.
        keys: by process, its public key; no two are the same.

    Raises:
        ValueError: a name or a key is not valid, there are too many, or two names have the same key.
    """

    session: str
    keys: Mapping[str, str]

    def __post_init__(self) -> None:
        problem = _problem_of_keys(self.keys)
        if problem is None and not _is_name(self.session):
            problem = f"found no name of the session; expected 1 to {MAX_NAME} printable characters"
        if problem is not None:
            raise ValueError(problem)
        object.__setattr__(self, "keys", MappingProxyType(dict(self.keys)))

    def save(self, path: Path) -> None:
        """Write the keys as a whole to a file that all may read (mode 0644).

        Raises:
            OSError: the file cannot be written.
        """
        partial = path.with_name(f".{path.name}.part")
        partial.unlink(missing_ok=True)  # it may be left from a process that was killed
        try:
            create(partial, _PUBLIC_KIND, {"session": self.session, "keys": dict(self.keys)}, 0o644)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
        sync_folder(path.parent)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read the keys of a file.

        Raises:
            KeyFileError: the file cannot be read, others may write it, or it is no such file.
        """
        data = read(path, _PUBLIC_KIND, {"session", "keys"}, MAX_PUBLIC_BYTES, private=False)
        try:
            return cls(data["session"], data["keys"])
        except ValueError as error:
            raise KeyFileError(f"{path}: {error}") from error


def new_pair() -> KeyPair:
    """A new pair, from the system's source of randomness.

    Raises:
        KeyFileError: the installed libzmq has no CURVE.
    """
    _require_curve()
    public, secret = zmq.curve_keypair()
    return KeyPair(public.decode(), secret.decode())


def is_key(value: object) -> bool:
    """Whether ``value`` is the text of a key: 40 characters of Z85, which are 32 bytes."""
    if type(value) is not str or len(value) != KEY_LENGTH or not value.isascii():
        return False
    try:
        return len(z85.decode(value)) == 32
    except (KeyError, struct.error):  # a character that is no digit of Z85; five digits beyond 32 bits
        return False


def ring_of(name: str, pair: KeyPair, public: PublicKeys, peers: Iterable[str]) -> KeyRing:
    """The ring of a process.

    Args:
        name: the name of the process.
        pair: its own pair.
        public: the session's public keys, as far as this process knows them.
        peers: the peers that it may talk to.

    Raises:
        KeyFileError: a peer's key is missing, or ``public`` has a key of ``name`` that is not that of ``pair``.
    """
    peers = tuple(peers)
    for peer in peers:
        if peer not in public.keys:
            raise KeyFileError(
                f"{public.session}: found no public key of {peer!r}, which {name!r} talks to; expected one; "
                "make it with manyhands invite and hand the public keys out again"
            )
    if public.keys.get(name, pair.public) != pair.public:
        raise KeyFileError(
            f"{public.session}: found another public key of {name!r} than the one of its pair; expected the same; "
            "hand the public keys out again, or make the key anew with manyhands invite SESSION --keys DIR --renew "
            f"{name}"
        )
    try:
        return KeyRing(name, pair, {peer: public.keys[peer] for peer in peers})
    except ValueError as error:
        raise KeyFileError(f"{public.session}: {error}") from error


def save_private(pair: KeyPair, session: str, name: str, path: Path) -> None:
    """Write a new file of a private key, of mode 0600 whatever the umask; it is on the disk when this returns.

    Raises:
        FileExistsError: the path exists, possibly as a link.
        OSError: the file cannot be written; no part of it is left.
        ValueError: the name of the session or the process is not valid.
    """
    if not (_is_name(session) and _is_name(name)):
        raise ValueError(f"found no proper name of session or process; expected 1 to {MAX_NAME} printable characters")
    members = {"session": session, "name": name, "public": pair.public, "secret": pair.secret}
    create(path, _PRIVATE_KIND, members, 0o600)


def load_private(path: Path, session: str, name: str) -> KeyPair:
    """Read the private key of a process of a session.

    Raises:
        KeyFileError: the file cannot be read, belongs to a different user, is open to others, is a link, or is no such
            file; its keys are no pair, or of a different process; or the installed libzmq has no CURVE.
    """
    _require_curve()
    members = {"session", "name", "public", "secret"}
    data = read(path, _PRIVATE_KIND, members, MAX_PRIVATE_BYTES, private=True)
    # the messages quote nothing of the file, for any member may hold the secret by mistake
    if data["session"] != session:
        raise KeyFileError(f"{path}: found a key of another session; expected one of {session!r}")
    if data["name"] != name:
        raise KeyFileError(f"{path}: found the key of another process; expected that of {name!r}")
    try:
        return KeyPair(data["public"], data["secret"])
    except ValueError as error:
        raise KeyFileError(f"{path}: {error}") from error


def _require_curve() -> None:
    if not zmq.has("curve"):
        raise KeyFileError("libzmq: found one without CURVE; expected one with it; install pyzmq from its own wheel")


def _problem_of_keys(keys: Any) -> str | None:
    """The reason why ``keys`` are not public keys by name; None if they are."""
    if not isinstance(keys, Mapping):
        return "found no mapping of keys; expected public keys by name"
    if len(keys) > MAX_KEYS:
        return f"found {len(keys)} keys; expected at most {MAX_KEYS}"
    owner: dict[str, str] = {}
    for name, key in keys.items():
        if not _is_name(name):
            return f"found something other than a name for a key; expected 1 to {MAX_NAME} printable characters"
        if not is_key(key):
            return f"found no public key for {name!r}; expected {KEY_LENGTH} characters of Z85"
        if key in owner:
            return f"found the same public key for {owner[key]!r} and {name!r}; expected one for each"
        owner[key] = name
    return None


def _is_name(value: object) -> bool:
    return type(value) is str and 1 <= len(value) <= MAX_NAME and value.isprintable()
