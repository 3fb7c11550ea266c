"""How files of keys are made and read, as ssh does it: exact modes, no links, nothing half-written, nothing quoted.

A key file is one JSON object with its kind, its version and the members of that kind.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any, Final

_VERSION: Final = 1
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
_OTHERS_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH


class KeyFileError(Exception):
    """A key cannot be used; names the file or whose key it is, never what a private key's file holds."""


def create(path: Path, kind: str, members: Mapping[str, Any], mode: int) -> None:
    """Write a new file of exactly this mode, on the disk when this returns, and never through a link.

    Raises:
        FileExistsError: there is something of that name, be it a link.
        OSError: it cannot be written; nothing is left of it.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(path, flags, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            os.fchmod(descriptor, mode)  # the umask may have taken from it, and never adds
            file.write(json.dumps({"format": kind, "version": _VERSION, **members}, indent=2).encode() + b"\n")
            file.flush()
            os.fsync(descriptor)
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """See to it that the names in a folder are on the disk, too."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read(path: Path, kind: str, members: Set[str], limit: int, *, private: bool) -> dict[str, Any]:
    """The members of a file of this kind, of any types.

    Args:
        path: the file.
        kind: what it says that it is.
        members: exactly those that it must have, besides its kind and version.
        limit: bytes it may have.
        private: it must be ours, not open to others, and no link; otherwise others may not write it.

    Raises:
        KeyFileError: not readable, not to be trusted, or not such a file.
    """
    data = _object(_content(path, limit, private=private))
    problem = None
    if not isinstance(data, dict) or data.pop("format", None) != kind:
        problem = f"found no file of {kind}; expected one as manyhands keys writes it"
    elif type(version := data.pop("version", None)) is not int or version != _VERSION:
        problem = f"found another version of {kind}; expected version {_VERSION}; make it with this manyhands"
    elif data.keys() != members:
        problem = f"found other members; expected format, version, {', '.join(sorted(members))}"
    if problem is not None:
        raise KeyFileError(f"{path}: {problem}")
    found: dict[str, Any] = data
    return found


def _content(path: Path, limit: int, *, private: bool) -> bytes:
    """All of a file, once it is seen to be one that can be trusted."""
    # not to wait for the other end of a pipe; the descriptor is looked at, not the name, which may change meanwhile
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | (os.O_NOFOLLOW if private else 0)
    try:
        descriptor = os.open(path, flags)
    except OSError as error:
        if private and error.errno == errno.ELOOP:
            found = "found a link; expected the file itself"
        elif error.errno == errno.ENOENT:
            found = "found no file; expected one as manyhands keys writes it"
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
    """Why a key's file is not to be trusted by a user (an effective user id); None where it is."""
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
    """Why a folder of keys, or of ``private`` ones, is not to be trusted by a user; None where it is."""
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
    """What a file's JSON says; None where it is none, without the error, which would carry the content along."""
    try:
        return json.loads(content, object_pairs_hook=_without_duplicates)
    except (ValueError, RecursionError):
        return None


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; a name given twice would show a reader another key than the one that is used."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a name is given twice")
    return found
