"""The keys by which processes know each other: CURVE pairs, the ring that one process holds, and their files.

A link is as trustworthy as the way its keys are kept, so this module is about what must not happen: a secret that is
printed, pickled or copied by accident, a private file that others can read or that a link replaced, a public key that
is not the one its owner has. Keys are the 40 characters of Z85 in which ZeroMQ writes 32 bytes.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NoReturn, Self

import zmq
from zmq.utils import z85

from manyhands.protocol import key_files
from manyhands.protocol.key_files import KeyFileError as KeyFileError
from manyhands.protocol.limits import MAX_NAME

KEY_LENGTH: Final = 40
"""Characters of a key."""

MAX_KEYS: Final = 4096
"""Most public keys of one session: every node, observer and supervisor, and some that it no longer has."""

MAX_PRIVATE_BYTES: Final = 4096
"""Longest file of a private key."""

MAX_PUBLIC_BYTES: Final = 8 * 2**20
"""Longest file of public keys; :data:`MAX_KEYS` names of the greatest length need 5 MiB."""

_PRIVATE_KIND: Final = "manyhands private key"
_PUBLIC_KIND: Final = "manyhands public keys"


class KeyPair:
    """A public key and the secret that belongs to it.

    A pair that exists is a pair: the constructor computes the public key from the secret. It cannot be printed with its
    secret, pickled or copied, and it is equal to another where their public keys are.

    Attributes:
        public: what others know this process by.
        secret: what nobody else may have.
    """

    __slots__ = ("_public", "_secret")

    def __init__(self, public: str, secret: str) -> None:
        """Take a pair.

        Raises:
            ValueError: not two keys, or the public key does not belong to the secret.
        """
        for value, what in ((public, "public"), (secret, "secret")):
            if not is_key(value):
                raise ValueError(f"found a {what} key that is no key; expected {KEY_LENGTH} characters of Z85")
        if zmq.curve_public(secret.encode()).decode() != public:
            raise ValueError("found a public key that does not belong to the secret; expected the two of one pair")
        self._public, self._secret = public, secret

    @property
    def public(self) -> str:
        """What others know this process by."""
        return self._public

    @property
    def secret(self) -> str:
        """What nobody else may have: for a socket's option, and for nothing else."""
        return self._secret

    def __repr__(self) -> str:
        return f"KeyPair(public={self._public!r}, secret hidden)"

    def __eq__(self, other: object) -> bool:
        return self._public == other._public if isinstance(other, KeyPair) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._public)

    # pickle, copy and dataclasses.asdict all come here
    def __reduce__(self) -> NoReturn:
        raise TypeError("found a key pair to be pickled or copied; expected it to stay in its process")

    def __getstate__(self) -> NoReturn:
        self.__reduce__()


@dataclass(frozen=True)
class KeyRing:
    """What one process holds: its own pair, and the public keys of those it may talk to.

    Attributes:
        name: the process.
        pair: its own.
        peers: public key of each peer.

    Raises:
        ValueError: a peer's key is no key, or two of them are the same.
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
        keys: public key of each process; no two are the same.

    Raises:
        ValueError: a name or a key is none, there are too many, or two names have the same key.
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
        """Write them to a file that all may read (mode 0644), whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        partial = path.with_name(f".{path.name}.part")
        partial.unlink(missing_ok=True)  # of a run that was killed
        try:
            key_files.create(partial, _PUBLIC_KIND, {"session": self.session, "keys": dict(self.keys)}, 0o644)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
        key_files.sync_folder(path.parent)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read them.

        Raises:
            KeyFileError: not readable, writable by others, or not such a file.
        """
        data = key_files.read(path, _PUBLIC_KIND, {"session", "keys"}, MAX_PUBLIC_BYTES, private=False)
        try:
            return cls(data["session"], data["keys"])
        except ValueError as error:
            raise KeyFileError(f"{path}: {error}") from error


def new_pair() -> KeyPair:
    """A pair that nobody has had before, from the system's source of randomness.

    Raises:
        KeyFileError: the installed libzmq has no CURVE.
    """
    _require_curve()
    public, secret = zmq.curve_keypair()
    return KeyPair(public.decode(), secret.decode())


def is_key(value: object) -> bool:
    """Whether this is a key's text: 40 characters of Z85 that are 32 bytes."""
    if type(value) is not str or len(value) != KEY_LENGTH or not value.isascii():
        return False
    try:
        return len(z85.decode(value)) == 32
    except (KeyError, struct.error):  # a character of no digit; five digits beyond 32 bits
        return False


def ring_of(name: str, pair: KeyPair, public: PublicKeys, peers: Iterable[str]) -> KeyRing:
    """The ring of a process.

    Args:
        name: the process.
        pair: its own.
        public: the session's public keys, as far as this process knows them.
        peers: those that it may talk to.

    Raises:
        KeyFileError: a peer's key is missing, or its own is known under another public key.
    """
    peers = tuple(peers)
    for peer in peers:
        if peer not in public.keys:
            raise KeyFileError(
                f"{public.session}: found no public key of {peer!r}, which {name!r} talks to; expected one; "
                "make it with manyhands keys and hand the public keys out again"
            )
    if public.keys.get(name, pair.public) != pair.public:
        raise KeyFileError(
            f"{public.session}: found another public key of {name!r} than the one of its pair; expected the same; "
            f"hand the public keys out again, or make the key anew with manyhands keys --renew {name}"
        )
    try:
        return KeyRing(name, pair, {peer: public.keys[peer] for peer in peers})
    except ValueError as error:
        raise KeyFileError(f"{public.session}: {error}") from error


def save_private(pair: KeyPair, session: str, name: str, path: Path) -> None:
    """Write a private key's file: new, mode 0600 whatever the umask, on the disk when this returns.

    Raises:
        FileExistsError: there is something of that name, be it a link.
        OSError: it cannot be written; nothing is left of it.
        ValueError: the session or the process has no proper name.
    """
    if not (_is_name(session) and _is_name(name)):
        raise ValueError(f"found no proper name of session or process; expected 1 to {MAX_NAME} printable characters")
    members = {"session": session, "name": name, "public": pair.public, "secret": pair.secret}
    key_files.create(path, _PRIVATE_KIND, members, 0o600)


def load_private(path: Path, session: str, name: str) -> KeyPair:
    """Read the private key of a process of a session.

    Raises:
        KeyFileError: not readable, not ours, open to others, a link, not such a file, another's key, or no pair; or the
            installed libzmq has no CURVE.
    """
    _require_curve()
    members = {"session", "name", "public", "secret"}
    data = key_files.read(path, _PRIVATE_KIND, members, MAX_PRIVATE_BYTES, private=True)
    # what the file says is never quoted: whatever stands there may be the secret, in the wrong place
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
    """Why these are not public keys by name."""
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
