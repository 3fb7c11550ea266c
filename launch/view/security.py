"""Who may open the page: by which address, from which page, with which token; and what every answer says of itself.

On the loopback address the machine's users are trusted and no others can come, but for web pages of elsewhere that are
open in a user's browser: those are told by their Host (DNS rebinding) and Origin (a foreign page's socket), which a
browser does not let them choose. On any other address a token is asked for as well.
"""

from __future__ import annotations

import hmac
import ipaddress
import os
import secrets
import socket
import stat
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from manyhands.design.files import open_regular

HEADERS: Final = (
    (
        b"content-security-policy",
        b"default-src 'self'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        b"object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
"""What every answer says of itself: it is this page's own, runs nothing else, and is kept by nobody."""

LEAST_TOKEN: Final = 16
MOST_TOKEN: Final = 256

Headers = Iterable[tuple[bytes, bytes]]


class ViewError(Exception):
    """The page cannot be served as it was asked for; says what was found and what would be right."""


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a page that listens there; a name counts if it is ``localhost``."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def header(headers: Headers, name: bytes) -> str | None:
    """The value of a header that is there once; None if it is not, or several times."""
    values = [value for key, value in headers if key.lower() == name]
    return values[0].decode("latin-1") if len(values) == 1 else None


@dataclass(frozen=True)
class Doorstep:
    """By which names the page may be asked for.

    Attributes:
        host: what it listens at.
        port: likewise.
    """

    host: str
    port: int

    def host_is_ours(self, headers: Headers) -> bool:
        """Whether a request names this page as its host.

        A page of elsewhere whose name was made to lead here (DNS rebinding) bears that name; an address cannot be made
        to lead anywhere else, so on an outside address every address is ours, and every name but this machine's is not.
        """
        given = header(headers, b"host")
        if given is None:
            return False
        try:
            parts = urlsplit(f"//{given}")
            name, port = parts.hostname, parts.port or 80
        except ValueError:
            return False
        if name is None or port != self.port or parts.path or parts.username is not None:
            return False
        if name == "localhost" or is_loopback(name):
            return True
        if is_loopback(self.host):
            return False
        return _is_address(name) or name in (self.host.lower(), socket.gethostname().lower())

    def origin_is_ours(self, headers: Headers) -> bool:
        """Whether the page that opens a socket is this one; what says nothing of where it is from is not."""
        host, origin = header(headers, b"host"), header(headers, b"origin")
        return host is not None and origin == f"http://{host}"


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class Token:
    """What opens the page where not only this machine can reach it; never shown but by :meth:`told`."""

    def __init__(self, text: str) -> None:
        self._text = text

    def fits(self, given: object) -> bool:
        """Whether this is it; the time that takes tells nothing."""
        return isinstance(given, str) and hmac.compare_digest(given.encode(), self._text.encode())

    def told(self) -> str:
        """As it stands in the address that is printed once."""
        return self._text

    def __repr__(self) -> str:
        return "Token(...)"


def new_token() -> Token:
    """A token that nobody can guess."""
    return Token(secrets.token_urlsafe(24))


def read_token(path: Path) -> Token:
    """The token in a file that only its user may read.

    Raises:
        ViewError: the file is not there, is others' to read, or holds no token.
    """
    try:
        with open_regular(path) as file:
            about = os.fstat(file.fileno())
            if not stat.S_ISREG(about.st_mode) or about.st_uid != os.getuid() or about.st_mode & 0o077:
                found = f"mode {stat.S_IMODE(about.st_mode):04o} of user {about.st_uid}"
                raise ViewError(f"{path}: found {found}; expected a file of yours that only you may read: chmod 600")
            text = file.read(MOST_TOKEN + 2).decode("ascii").strip()
    except OSError as error:
        raise ViewError(f"{path}: cannot be read: {error.strerror}; expected a file with a token") from error
    except UnicodeDecodeError as error:
        raise ViewError(f"{path}: found other characters than ASCII; expected a token") from error
    if not LEAST_TOKEN <= len(text) <= MOST_TOKEN or not all("!" <= character <= "~" for character in text):
        raise ViewError(
            f"{path}: found {len(text)} characters; expected a token of {LEAST_TOKEN} to {MOST_TOKEN} printable ones"
        )
    return Token(text)
