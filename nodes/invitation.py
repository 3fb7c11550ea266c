"""An invitation: one file with all that a second user needs to take a seat of a session on a different machine.

It holds where the session listens, the bundles of the seat's device and coupling, and their private keys. So it is
handled like a private key: mode 0600, no links, of bounded length, and no message quotes it. It grants the seat's own
rights and no others: the motion of its device, and the forces at its own ports.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from manyhands.design.files import replacing
from manyhands.nodes.bundle import (
    REALTIME,
    BundleError,
    Common,
    CouplingBundle,
    DeviceBundle,
    decoded,
    encoded,
)
from manyhands.protocol.keys import KeyPair, KeyRing, read
from manyhands.protocol.transport.zeromq import is_address

MAX_BYTES: Final = 16 * 2**20
"""The greatest length of an invitation: that of two bundles, one with a recorded motion of minutes."""

_KIND: Final = "manyhands invitation"
_VERSION: Final = 1
_MOST_HOST: Final = 253  # characters of a DNS name


@dataclass(frozen=True)
class Invitation:
    """What one seat's user needs.

    Attributes:
        address: where the session listens, HOST:PORT; the host may be a DNS name.
        device: the bundle of the seat's device.
        coupling: that of its coupling, which has a wave link and runs in the device's process.
        pairs: the key pair of both nodes, by name.
    """

    address: str
    device: DeviceBundle
    coupling: CouplingBundle
    pairs: Mapping[str, KeyPair]

    @property
    def session(self) -> str:
        """The session's name."""
        return self.coupling.common.session

    @property
    def seat(self) -> str:
        """The name of the seat, which is that of its coupling."""
        return self.coupling.common.name

    def at(self, address: str) -> Invitation:
        """The same invitation, with the session at a different address.

        Raises:
            BundleError: the address has another form than HOST:PORT.
        """
        return replace(self, address=_address(address, "--address"))

    def ring(self, common: Common) -> KeyRing:
        """The keys of one of the two nodes."""
        others = {name: key for name, key in common.public.items() if name != common.name}
        return KeyRing(common.name, self.pairs[common.name], others)

    def save(self, path: Path) -> None:
        """Write the invitation (mode 0600); an existing file is replaced.

        Raises:
            BundleError: it is longer than an invitation may be.
            OSError: the file cannot be written.
        """
        members = {
            "format": _KIND,
            "version": _VERSION,
            "address": self.address,
            "device": json.loads(encoded(self.device)),
            "coupling": json.loads(encoded(self.coupling)),
            "keys": {name: {"public": pair.public, "secret": pair.secret} for name, pair in self.pairs.items()},
        }
        content = json.dumps(members, allow_nan=False).encode() + b"\n"
        if len(content) > MAX_BYTES:
            raise BundleError(f"{path}: found an invitation of {len(content)} bytes; expected at most {MAX_BYTES}")
        with replacing(path, mode=0o600) as file:
            file.write(content)


def load_invitation(path: Path) -> Invitation:
    """Read an invitation, and check it as far as one machine can.

    Raises:
        KeyFileError: the file cannot be read, is open to others, a link or too long, or is no invitation.
        BundleError: a part of it is wrong; the message names the part, and quotes no key.
    """
    members = {"address", "device", "coupling", "keys"}
    data = read(path, _KIND, members, MAX_BYTES, private=True, writer="manyhands host")
    address = _address(data["address"], f"{path}: address")
    device = decoded(data["device"], DeviceBundle, path)
    coupling = decoded(data["coupling"], CouplingBundle, path)
    problem = _problem(device, coupling)
    if problem is not None:
        raise BundleError(f"{path}: {problem}; expected an invitation as manyhands host writes it")
    keys = data["keys"]
    nodes = (device.common, coupling.common)
    if not isinstance(keys, dict) or keys.keys() != {common.name for common in nodes}:
        raise BundleError(f"{path}: keys: found other members; expected a key of the device and one of the coupling")
    invitation = Invitation(address, device, coupling, {c.name: _pair(keys[c.name], c, path) for c in nodes})
    try:
        for common in nodes:
            invitation.ring(common)
    except ValueError as error:  # its text names no secret
        raise BundleError(f"{path}: keys: {error}") from error
    return invitation


def _problem(device: DeviceBundle, coupling: CouplingBundle) -> str | None:
    """What is wrong with two bundles as those of a seat; None if nothing is."""
    one, other = device.common, coupling.common
    if (one.session, one.certificate) != (other.session, other.certificate):
        return "found bundles of two sessions"
    if one.name == other.name:
        return "found one name for two nodes"
    if one.ports != other.ports or not one.ports:
        return "found a coupling of other ports than the device's"
    if one.peers or len(other.peers) != 1 or other.peers[0].binds:
        return "found other peers than the environment"
    if coupling.wave is None:
        return "found a coupling without a wave link"
    if {one.clock, other.clock} != {REALTIME}:
        return "found a clock other than the realtime clock"
    if not (one.public and other.public):
        return "found a bundle without public keys"
    return None


def _pair(data: Any, common: Common, path: Path) -> KeyPair:
    try:
        pair = KeyPair(data["public"], data["secret"])
    except (KeyError, TypeError, ValueError, AttributeError):  # the error's text might quote the secret
        raise BundleError(f"{path}: keys: found no key pair of {common.name!r:.100}; expected one") from None
    if common.public.get(common.name) != pair.public:
        raise BundleError(f"{path}: keys: found a pair of {common.name!r:.100} that its bundle does not know")
    return pair


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


def _address(text: object, place: str) -> str:
    if not isinstance(text, str) or not is_guest_address(text):
        raise BundleError(f"{place}: found {text!r:.100}; expected HOST:PORT, such as ball.example.org:7400")
    return text
