"""An invitation: a line of text with all that a second user needs to find a session and to be known there.

    manyhands://HOST:PORT/SESSION/SEAT/DEVICE/KEY/SECRET

KEY is the public key of the session's hub, and SECRET the private key of the seat's device, each of 32 bytes in
base64url without padding. Names are percent-encoded, and no character has a meaning to a shell. What else the guest
needs, it fetches from the session when it joins (:mod:`manyhands.nodes.guest.seat_part`). So an invitation stays good
while its key does.

It is handled like a private key: it goes over a secure channel, into files of mode 0600, never onto a command line, and
no message quotes it. It grants the seat's own rights and no others: the motion of its device, and the forces at its own
ports.
"""

from __future__ import annotations

import base64
import binascii
import getpass
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final
from urllib.parse import quote, unquote

import zmq
from zmq.utils import z85

from manyhands.design.files import replacing
from manyhands.protocol.keys import KeyPair, KeyRing, private_line
from manyhands.protocol.limits import MAX_NAME
from manyhands.protocol.transport.zeromq import HUB, is_address

PREFIX: Final = "manyhands://"

MAX_CHARACTERS: Final = 4096
"""The greatest length of an invitation; one of the longest names, all percent-encoded, needs no more."""

_MOST_HOST: Final = 253  # characters of a DNS name
_SECRET_BYTES: Final = 32
_WRITER: Final = "manyhands host"
_EXPECTED: Final = f"a line that begins with {PREFIX}, as {_WRITER} writes it"


class InvitationError(Exception):
    """A text is no invitation; the message quotes no key."""


@dataclass(frozen=True)
class Invitation:
    """What one seat's user needs to reach the session.

    Attributes:
        address: where the session listens, HOST:PORT; the host may be a DNS name.
        session: the session's name.
        seat: the name of the seat, which is that of its coupling.
        device: the name of its device.
        hub: the hub's public key.
        pair: the key pair of the device.
    """

    address: str
    session: str
    seat: str
    device: str
    hub: str
    pair: KeyPair

    @property
    def ring(self) -> KeyRing:
        """The device's keys, with which the rest is fetched."""
        return KeyRing(self.device, self.pair, {HUB: self.hub})

    @property
    def line(self) -> str:
        """The invitation as text, which holds a secret."""
        names = (quote(name, safe="") for name in (self.session, self.seat, self.device))
        keys = (_encoded(self.hub), _encoded(self.pair.secret))
        return PREFIX + "/".join((self.address, *names, *keys))

    def at(self, address: str) -> Invitation:
        """The same invitation, with the session at a different address.

        Raises:
            InvitationError: the address has another form than HOST:PORT.
        """
        return replace(self, address=_address(address, "--connect"))

    def save(self, path: Path) -> None:
        """Write the line to a file (mode 0600); an existing file is replaced.

        Raises:
            OSError: the file cannot be written.
        """
        with replacing(path, mode=0o600) as file:
            file.write(self.line.encode("ascii") + b"\n")


def parsed(text: str, place: str) -> Invitation:
    """The invitation of a line; ``place`` says in errors where it stands.

    Raises:
        InvitationError: the text is none.
    """
    text = text.strip()
    fields = text.removeprefix(PREFIX).split("/")
    if not text.startswith(PREFIX) or len(text) > MAX_CHARACTERS or len(fields) != 6:
        raise InvitationError(f"{place}: found no invitation; expected {_EXPECTED}, whole")
    address = _address(fields[0], place)
    session, seat, device = (_name(field, place) for field in fields[1:4])
    if seat == device:
        raise InvitationError(f"{place}: found one name for seat and device; expected {_EXPECTED}")
    try:
        hub, secret = (_decoded(field) for field in fields[4:])
        invitation = Invitation(address, session, seat, device, hub, _pair(secret))
        invitation.ring  # noqa: B018 -- it checks the keys
    except ValueError:  # its text might quote a key
        raise InvitationError(f"{place}: found a damaged key; expected the whole line, copied once more") from None
    return invitation


def read_invitation(path: Path | None) -> Invitation:
    """Read an invitation from its file, or, without a file, the line that the user pastes or a program writes.

    Raises:
        KeyFileError: the file cannot be read, is open to others, a link or too long.
        InvitationError: the text is no invitation.
    """
    if path is None:
        if sys.stdin.isatty():
            return parsed(getpass.getpass("invitation (it is not shown): "), "the invitation")
        return parsed(sys.stdin.readline(MAX_CHARACTERS + 1), "standard input")
    if str(path).startswith(PREFIX.rstrip("/")):  # a Path has one slash of the two
        raise InvitationError(
            "found an invitation on the command line, where other users of this machine can read it; expected its "
            "file, or manyhands join alone, which asks for it"
        )
    return parsed(private_line(path, MAX_CHARACTERS, _WRITER), str(path))


def _encoded(key: str) -> str:
    return base64.urlsafe_b64encode(z85.decode(key.encode())).decode().rstrip("=")


def _decoded(text: str) -> str:
    """The key in Z85.

    Raises:
        ValueError: the text is no key.
    """
    try:
        data = base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
    except binascii.Error as error:
        raise ValueError("found no base64url") from error
    if len(data) != _SECRET_BYTES or _encoded(key := z85.encode(data).decode()) != text:
        raise ValueError(f"found {len(data)} bytes; expected {_SECRET_BYTES}")
    return key


def _pair(secret: str) -> KeyPair:
    return KeyPair(zmq.curve_public(secret.encode()).decode(), secret)


def _name(text: str, place: str) -> str:
    name = unquote(text) if text.isascii() else ""
    if not (1 <= len(name) <= MAX_NAME and name.isprintable()) or quote(name, safe="") != text:
        raise InvitationError(f"{place}: found {text!r:.100} as a name; expected {_EXPECTED}")
    return name


def is_guest_address(text: object) -> bool:
    """Whether ``text`` is HOST:PORT in characters that a terminal and an endpoint can hold; the host may be a name."""
    if not isinstance(text, str):
        return False
    host = text.rpartition(":")[0]
    return (
        is_address(text)
        and (":" not in host or (host.startswith("[") and host.endswith("]")))  # IPv6
        and len(text) <= _MOST_HOST + len(":65535")
        and text.isascii()
        and text.isprintable()
        and not any(c in text for c in " /@;")
    )


def _address(text: str, place: str) -> str:
    if not is_guest_address(text):
        raise InvitationError(f"{place}: found {text!r:.100}; expected HOST:PORT, such as ball.example.org:7400")
    return text
