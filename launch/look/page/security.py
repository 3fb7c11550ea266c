"""Who may open the page: the checks of Host, Origin and token, and the security headers of every answer.

On the loopback address, only users of this machine can connect, and they are trusted. Foreign web pages that are open
in a user's browser are not trusted. The Host header reveals DNS rebinding, and the Origin header reveals a foreign page
that opens a socket; a browser does not let a page choose these headers. On any other address, a token is required as
well.
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
"""Headers of every answer: load and run nothing but the page's own files, show it in no frame, store it nowhere."""

LEAST_TOKEN: Final = 16
MOST_TOKEN: Final = 256

Headers = Iterable[tuple[bytes, bytes]]


class ViewError(Exception):
    """The page cannot be served with these options; the message states what was found and what would be right."""


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach ``host``; of all names, only ``localhost`` counts."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def header(headers: Headers, name: bytes) -> str | None:
    """The value of a header that occurs exactly once; None if it is absent or repeated."""
    values = [value for key, value in headers if key.lower() == name]
    return values[0].decode("latin-1") if len(values) == 1 else None


@dataclass(frozen=True)
class Doorstep:
    """The address of the page, and the check that a request is meant for it.

    Attributes:
        host: the name or address at which the server listens.
        port: the port at which it listens.
    """

    host: str
    port: int

    def host_is_ours(self, headers: Headers) -> bool:
        """Whether a request names this page as its host.

        A foreign page whose DNS name was redirected to this machine (DNS rebinding) still has that name as its host. An
        address cannot be redirected. Beyond loopback, any address is therefore accepted, and of names only this
        machine's.
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
        """Whether this page opens the socket; a request without an Origin is refused."""
        host, origin = header(headers, b"host"), header(headers, b"origin")
        return host is not None and origin == f"http://{host}"


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class Token:
    """The secret that opens the page where other machines can reach it; only :meth:`reveal` shows it."""

    def __init__(self, text: str) -> None:
        self._text = text

    def fits(self, given: object) -> bool:
        """Whether ``given`` is this token; the comparison takes the same time for every wrong token of its length."""
        if not isinstance(given, str):
            return False
        # JSON may hold half of a surrogate pair, which is no character and has no UTF-8
        return hmac.compare_digest(given.encode(errors="surrogatepass"), self._text.encode())

    def reveal(self) -> str:
        """The token as text, for the address that is printed once."""
        return self._text

    def __repr__(self) -> str:
        return "Token(...)"


def new_token() -> Token:
    """A new random token of 24 bytes."""
    return Token(secrets.token_urlsafe(24))


def read_token(path: Path) -> Token:
    """The token in a file that only its user may read.

    Raises:
        ViewError: the file cannot be read, other users may read it, or it holds no token.
    """
    try:
        with open_regular(path) as file:
            about = os.fstat(file.fileno())
            if not stat.S_ISREG(about.st_mode) or about.st_uid != os.getuid() or about.st_mode & 0o077:
                found = f"mode {stat.S_IMODE(about.st_mode):04o} of user {about.st_uid}"
                raise ViewError(f"{path}: found {found}; expected a file that you own and only you may read: chmod 600")
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
