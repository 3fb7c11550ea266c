"""What the user of a seat needs of the session: the bundles of its device and coupling, and the coupling's keys.

The guest fetches it over the hub's encrypted connection, with the key of its device, which its invitation holds. So it
is always of the session as it runs now.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from manyhands.nodes.guest.invitation import Invitation
from manyhands.nodes.kernel.bundle import (
    REALTIME,
    BundleError,
    Common,
    CouplingBundle,
    DeviceBundle,
    decoded,
    elsewhere,
)
from manyhands.protocol.keys import KeyPair, KeyRing
from manyhands.protocol.limits import MAX_PART_BYTES
from manyhands.protocol.plain import written

SHORTEST_PERIOD: Final = 1e-5
"""The shortest period that a guest agrees to, s: no machine runs the loop faster than some tens of thousands of times a
second, and a shorter one would only keep it busy."""

_EXPECTED: Final = "what manyhands host sends to a guest"


@dataclass(frozen=True)
class SeatPart:
    """What one seat's user needs besides the invitation.

    Attributes:
        device: the bundle of the seat's device.
        coupling: that of its coupling, which has a wave link and runs in the device's process.
        pairs: the key pair of both nodes, by name.
    """

    device: DeviceBundle
    coupling: CouplingBundle
    pairs: Mapping[str, KeyPair]

    def ring(self, common: Common) -> KeyRing:
        """The keys of one of the two nodes."""
        others = {name: key for name, key in common.public.items() if name != common.name}
        return KeyRing(common.name, self.pairs[common.name], others)

    def encoded(self) -> bytes:
        """The part as it is sent; the device's key pair is not in it, for the guest has it.

        Raises:
            BundleError: it is longer than a part may be.
        """
        pair = self.pairs[self.coupling.common.name]
        members = {
            "device": written(elsewhere(self.device)),
            "coupling": written(self.coupling),
            "keys": {"public": pair.public, "secret": pair.secret},
        }
        content = json.dumps(members, allow_nan=False).encode()
        if len(content) > MAX_PART_BYTES:
            name = self.coupling.common.name
            raise BundleError(f"seat {name}: found a part of {len(content)} bytes; expected at most {MAX_PART_BYTES}")
        return content


def decoded_part(content: bytes, invitation: Invitation) -> SeatPart:
    """The part that came for an invitation, checked as far as one machine can.

    Raises:
        BundleError: something of it is wrong; the message names what, and quotes no key.
    """
    place = Path(f"what {invitation.session!r:.100} has sent")
    try:
        data = json.loads(content)
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict) or data.keys() != {"device", "coupling", "keys"}:
        raise BundleError(f"{place}: found other members; expected {_EXPECTED}")
    device = decoded(data["device"], DeviceBundle, place)
    coupling = decoded(data["coupling"], CouplingBundle, place)
    problem = _problem(device, coupling, invitation)
    if problem is not None:
        raise BundleError(f"{place}: {problem}; expected {_EXPECTED}")
    pairs = {invitation.device: invitation.pair, invitation.seat: _pair(data["keys"], coupling.common, place)}
    if device.common.public.get(invitation.device) != invitation.pair.public:
        raise BundleError(f"{place}: found a bundle of another key than the invitation's; expected that one")
    part = SeatPart(device, coupling, pairs)
    try:
        for common in (device.common, coupling.common):
            part.ring(common)
    except ValueError as error:  # its text names no secret
        raise BundleError(f"{place}: keys: {error}") from error
    return part


def _problem(device: DeviceBundle, coupling: CouplingBundle, invitation: Invitation) -> str | None:
    """What is wrong with two bundles as those of the seat; None if nothing is."""
    one, other = device.common, coupling.common
    if (one.session, one.certificate) != (other.session, other.certificate) or one.session != invitation.session:
        return "found bundles of two sessions, or of another than the invitation's"
    if (one.name, other.name) != (invitation.device, invitation.seat):
        return f"found {one.name!r:.100} and {other.name!r:.100}, which are not the invitation's"
    if one.ports != other.ports or not one.ports:
        return "found a coupling of other ports than the device's"
    if one.peers or len(other.peers) != 1 or other.peers[0].binds:
        return "found other peers than the environment"
    if coupling.wave is None:
        return "found a coupling without a wave link"
    shortest = min(one.period, other.period, coupling.wave.peer_period)
    if shortest < SHORTEST_PERIOD:
        return f"found a period of {shortest:g} s, shorter than {SHORTEST_PERIOD:g} s"
    if {one.clock, other.clock} != {REALTIME}:
        return "found a clock other than the realtime clock"
    if not (one.public and other.public):
        return "found a bundle without public keys"
    return None


def _pair(data: Any, common: Common, place: Path) -> KeyPair:
    try:
        pair = KeyPair(data["public"], data["secret"])
    except (KeyError, TypeError, ValueError, AttributeError):  # the error's text might quote the secret
        raise BundleError(f"{place}: keys: found no key pair of {common.name!r:.100}; expected one") from None
    if common.public.get(common.name) != pair.public:
        raise BundleError(f"{place}: keys: found a pair of {common.name!r:.100} that its bundle does not know")
    return pair
