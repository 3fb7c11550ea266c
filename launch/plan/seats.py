"""Seats: the users behind wave links whom a hosted session lets come and go, and the files that invite them.

    FOLDER/certificate.json, certificate.COUPLING.json …    of the world and its sites: designed once, then kept
    FOLDER/keys/                                            the session's keys (:mod:`manyhands.launch.plan.keys`)
    FOLDER/COUPLING.invitation                              mode 0600: a line for the user of that seat alone

All of it is kept from one hosting to the next. An invitation stays good until its key changes: a guest fetches its part
of the session when it joins.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from manyhands.design.files import replacing
from manyhands.launch.files import TargetError
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.keys import Keys
from manyhands.launch.plan.prepare import certificate_files
from manyhands.launch.plan.reach import Listen, ReachError, reach
from manyhands.launch.session import SUPERVISOR, Session
from manyhands.launch.session.errors import listed
from manyhands.nodes.guest.invitation import Invitation
from manyhands.nodes.guest.seat_part import SeatPart
from manyhands.nodes.kernel.bundle import REALTIME, CouplingBundle, DeviceBundle

if TYPE_CHECKING:
    from manyhands.launch.plan.prepare import Prepared

KEYS: Final = "keys"


def seats_of(session: Session) -> dict[str, str]:
    """The device of each seat, by the seat's name, which is that of its coupling.

    Raises:
        ReachError: the session has no wave link, or a seat's coupling does not run in the process of one device.
    """
    if not session.wave_links:
        raise ReachError(
            f"{session.name}: found no wave link; expected a coupling with a wave_link for each user who comes and goes"
        )
    apart = [name for name in session.wave_links if name not in session.carriers]
    if apart and session.shared_couplings:
        shared = session.shared_couplings[0]
        raise ReachError(
            f"{session.name}: found the coupling {shared!r} of the devices {listed(session.devices_of(shared))}, with "
            f"the seat {apart[0]!r}; expected couplings of one device each, for a guest runs a seat's device and "
            "coupling in one process"
        )
    if apart:
        raise ReachError(
            f"{session.name}: found colocate: false with the seat {apart[0]!r}; expected colocate: true, for a guest "
            "runs a seat's device and coupling in one process"
        )
    return {name: session.carriers[name] for name in session.wave_links}


def seat_nodes(session: Session) -> frozenset[str]:
    """The nodes of all seats.

    Raises:
        ReachError: as :func:`seats_of`.
    """
    seats = seats_of(session)
    return frozenset(seats) | frozenset(seats.values())


def require_folder(folder: Path) -> None:
    """Make the folder of a hosted session, if it is absent.

    Raises:
        TargetError: something else has its name, or there is no folder to put it in.
    """
    if not folder.absolute().parent.is_dir():
        raise TargetError(f"{folder}: found no folder {folder.parent}; expected one that exists")
    if folder.exists() and not folder.is_dir():
        raise TargetError(f"{folder}: found a file; expected the name of a folder")
    folder.mkdir(mode=0o700, exist_ok=True)


def keep_certificates(prepared: Prepared, folder: Path) -> None:
    """Write the certificates of a session with wave links into a folder.

    Raises:
        OSError: a file cannot be written.
    """
    for name, content in reversed(certificate_files(prepared).items()):  # the world last: it makes the others known
        with replacing(folder / name) as out:
            out.write(content)


def invitations(prepared: Prepared, keys: Keys, address: str) -> dict[str, Invitation]:
    """The invitation of every seat, by seat.

    Args:
        prepared: the session under its certificates.
        keys: its keys.
        address: where guests reach this machine, HOST:PORT.

    Raises:
        KeyFileError: a seat's private key is missing.
    """
    session, hub = prepared.session, keys.public.keys[SUPERVISOR]
    return {
        seat: Invitation(address, session.name, seat, device, hub, keys.pair(device))
        for seat, device in seats_of(session).items()
    }


def seat_parts(prepared: Prepared, keys: Keys) -> dict[str, bytes]:
    """What the guest at each seat fetches when it joins, by the seat's device.

    Raises:
        KeyFileError: a seat's private key is missing.
        BundleError: a part is longer than a guest may fetch.
    """
    ways = reach(prepared, "tcp", keys=keys, listen=Listen())  # only the guest knows its own addresses
    bundles = cut(prepared, RunPlan(REALTIME, None, "", reach=ways))
    parts: dict[str, bytes] = {}
    for seat, name in seats_of(prepared.session).items():
        device, coupling = bundles[name], bundles[seat]
        if not (isinstance(device, DeviceBundle) and isinstance(coupling, CouplingBundle)):
            raise AssertionError("a seat is a device and its coupling")
        parts[name] = SeatPart(device, coupling, {seat: keys.pair(seat)}).encoded()
    return parts
