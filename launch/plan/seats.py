"""Seats: the users behind wave links whom a hosted session lets come and go, and the files that invite them.

    FOLDER/certificate.json, certificate.COUPLING.json …    of the world and its sites: designed once, then kept
    FOLDER/keys/                                            the session's keys (:mod:`manyhands.launch.plan.keys`)
    FOLDER/COUPLING.invitation                              mode 0600: for the user of that seat alone

All of it is kept from one hosting to the next, so an invitation stays good until the session's file or a key changes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from manyhands.design.certificate import to_json
from manyhands.design.files import replacing
from manyhands.design.world import world_json
from manyhands.launch.files import TargetError
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.keys import Keys
from manyhands.launch.plan.reach import Listen, ReachError, reach
from manyhands.launch.plan.sites import part_file
from manyhands.launch.session import Session
from manyhands.nodes.bundle import REALTIME, CouplingBundle, DeviceBundle
from manyhands.nodes.invitation import Invitation

if TYPE_CHECKING:
    from manyhands.launch.plan.prepare import Prepared

CERTIFICATE: Final = "certificate.json"
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
    path = folder / CERTIFICATE
    files = {part_file(path, name): to_json(part) for name, part in prepared.parts.items()}
    if prepared.world is not None:
        files[path] = world_json(prepared.world)  # last: it makes the others known
    for file, text in files.items():
        with replacing(file) as out:
            out.write(text.encode())


def write_invitations(prepared: Prepared, keys: Keys, address: str, folder: Path) -> dict[str, Path]:
    """Write the invitation of every seat; returns their files, by seat.

    Args:
        prepared: the session under its certificates.
        keys: its keys.
        address: where guests reach this machine, HOST:PORT.
        folder: where to write them.

    Raises:
        KeyFileError: a seat's private key is missing.
        BundleError, OSError: an invitation cannot be written.
    """
    ways = reach(prepared, "tcp", keys=keys, listen=Listen())  # only the guest knows its own addresses
    bundles = cut(prepared, RunPlan(REALTIME, None, "", reach=ways))
    written: dict[str, Path] = {}
    for seat, name in seats_of(prepared.session).items():
        device, coupling = bundles[name], bundles[seat]
        if not (isinstance(device, DeviceBundle) and isinstance(coupling, CouplingBundle)):
            raise AssertionError("a seat is a device and its coupling")
        path = written[seat] = folder / f"{seat}.invitation"
        Invitation(address, device, coupling, {one: keys.pair(one) for one in (name, seat)}).save(path)
    return written
