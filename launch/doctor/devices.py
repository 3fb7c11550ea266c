"""The devices that are plugged in, what is missing to use them, and the line to try next.

What a device is known by stands in its file of the catalogue: ``found_by`` of
:mod:`manyhands.launch.session.device_file`. Everything is read from sysfs, from the device nodes' rights, from the
folders of shared libraries, and from a service on this computer that tells its version. Nothing is opened, and no
device notices.
"""

from __future__ import annotations

import http.client
import os
import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from manyhands.extras import MissingExtra, require
from manyhands.launch.session.device_file import DeviceFile, catalogue, catalogue_file
from manyhands.nodes.kernel.factory import DRIVERS, EXTRA_OF, published

RULES: Final = "/etc/udev/rules.d/70-manyhands.rules"
"""Where a rule goes: rules with ``uaccess`` have to come before 73-seat-late.rules of systemd."""

OWN_DRIVER: Final = "my_driver:make"
"""Stands for the driver of a device of which this package has none."""

_HUB: Final = "09"  # bDeviceClass
_CONSTANT: Final = 0x52  # FF_CONSTANT of linux/input.h: a bit of capabilities/ff
_LOCAL: Final = ("127.0.0.1", "localhost", "::1")
_PATIENCE: Final = 0.5  # s, for a service of this computer
_MOST_BYTES: Final = 4096  # of its answer
_LIBRARIES: Final = (
    *("usr/local/lib", "usr/lib", "lib", "opt/*/lib"),
    *("usr/local/lib/*-linux-gnu", "usr/lib/*-linux-gnu", "lib/*-linux-gnu"),
)

_KINDS: Final = {"hidraw": "dev/{}", "tty": "dev/{}", "event": "dev/input/{}"}
"""Device nodes by the beginning of their names in sysfs."""


@dataclass(frozen=True)
class PluggedIn:
    """A device that is plugged in, or a service that answers.

    Attributes:
        place: of its port, as sysfs names it, or the service's address.
        usb: vendor and product, "1451:0402"; empty for a service.
        name: as it calls itself.
        nodes: the device nodes by which it is reached.
        known: the names in the catalogue of what it may be.
        missing: what has to be done before it can be used, a sentence each; empty where nothing is known to be missing.
        rule: of udev, which lets whoever sits at this machine use it; empty where none is needed.
        next: the command to try next; empty where there is none.
    """

    place: str
    usb: str
    name: str
    nodes: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    rule: str = ""
    next: str = ""

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


@dataclass(frozen=True)
class Survey:
    """What is plugged in.

    Attributes:
        devices: of the catalogue, or that may be one of it.
        others: the number of other USB devices, hubs apart.
        silent: services that do not answer, by the name of the device in the catalogue.
    """

    devices: tuple[PluggedIn, ...]
    others: int
    silent: dict[str, str] = field(default_factory=dict)

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "devices": [device.as_plain() for device in self.devices],
            "others": self.others,
            "silent": self.silent,
        }


@dataclass(frozen=True)
class _Usb:
    """A USB device as sysfs has it; ``forces`` are its event devices with constant forces."""

    place: str
    vendor: str
    product: str
    name: str
    node: Path
    ttys: tuple[Path, ...]
    hidraws: tuple[Path, ...]
    forces: tuple[Path, ...]

    @property
    def ids(self) -> str:
        return f"{self.vendor}:{self.product}"


def usable(path: Path) -> bool:
    """Whether this process may read and write a device node."""
    return os.access(path, os.R_OK | os.W_OK)


def survey(
    root: Path = Path("/"),
    may: Callable[[Path], bool] = usable,
    ask: Callable[[str], str | None] | None = None,
    folders: Iterable[str] | None = None,
) -> Survey:
    """Look what is plugged in.

    Args:
        root: the folder with sys, dev and the folders of libraries.
        may: whether this process may use a device node.
        ask: what a service at an address answers; None where nobody does.
        folders: more folders of shared libraries; by default those of LD_LIBRARY_PATH.

    Raises:
        SessionError: a file of the catalogue is wrong.
    """
    files = [catalogue_file(name) for name in catalogue()]
    ask = version_at if ask is None else ask
    given = os.environ.get("LD_LIBRARY_PATH", "").split(":") if folders is None else folders
    places = [path for pattern in _LIBRARIES for path in root.glob(pattern)] + [Path(one) for one in given if one]
    found, others = [], 0
    for usb in _usb_devices(root):
        known = _known(usb, files)
        if known:
            found.append(_described(usb, known, root, may, places))
        else:
            others += 1
    silent = {}
    for file in files:
        if address := file.found_by.service:
            answer = ask(address)
            if answer is None:
                silent[file.name] = address
            else:
                name = f"its service answers: {answer}"
                found.append(PluggedIn(address, "", name, (), (file.name,), _of_driver(file), "", _next(file, "")))
    return Survey(tuple(found), others, silent)


def version_at(address: str) -> str | None:
    """What a service on this computer tells of its version, in one line; None where nobody answers."""
    parts = urlsplit(address)
    if parts.hostname not in _LOCAL:
        return None
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=_PATIENCE)
    try:
        connection.request("GET", parts.path)
        answer = connection.getresponse()
        text = answer.read(_MOST_BYTES).decode(errors="replace")
        return " ".join(text.split())[:80] if answer.status == http.HTTPStatus.OK else f"status {answer.status}"
    except (OSError, http.client.HTTPException):
        return None
    finally:
        connection.close()


def _usb_devices(root: Path) -> Iterator[_Usb]:
    """Every USB device, hubs apart, in the order of their ports."""
    folder = root / "sys/bus/usb/devices"
    by_id = _by_id(root)
    for place in sorted(folder.iterdir()) if folder.is_dir() else ():
        vendor, product = _text(place / "idVendor"), _text(place / "idProduct")
        if not vendor or not product or _text(place / "bDeviceClass") == _HUB:
            continue  # an interface, or a hub
        nodes = list(_nodes(place))
        ttys = (by_id.get(path.name, path) for path in _of_kind(nodes, "tty", root))
        forces = [node for node in nodes if node.name.startswith("event") and _has_forces(node)]
        bus, number = _text(place / "busnum").zfill(3), _text(place / "devnum").zfill(3)
        name = " ".join(text for part in ("manufacturer", "product") if (text := _text(place / part)))
        yield _Usb(
            place.name, vendor.lower(), product.lower(), name, root / "dev/bus/usb" / bus / number,
            tuple(ttys), tuple(_of_kind(nodes, "hidraw", root)), tuple(_of_kind(forces, "event", root)),
        )  # fmt: skip


def _nodes(place: Path) -> Iterator[Path]:
    """The folders in sysfs of the device nodes below a USB device, without those of a device behind it."""
    for folder, below, _ in os.walk(place):
        path = Path(folder)
        if path != place and (path / "idVendor").exists():
            below.clear()
        elif any(path.name.startswith(kind) and path.name[len(kind) :] for kind in _KINDS):
            yield path


def _of_kind(nodes: Iterable[Path], kind: str, root: Path) -> Iterator[Path]:
    """The device nodes of a kind, in /dev; a tty is one once, though sysfs may have it twice."""
    names = dict.fromkeys(node.name for node in nodes if node.name.startswith(kind))
    return (root / _KINDS[kind].format(name) for name in sorted(names))


def _has_forces(node: Path) -> bool:
    """Whether an event device has constant forces."""
    words = _text(node.parent / "capabilities/ff").split()
    bits = 0
    for word in words:  # of 64 bits each, the highest first
        bits = bits << 64 | int(word, 16)
    return bool(bits >> _CONSTANT & 1)


def _by_id(root: Path) -> dict[str, Path]:
    """The lasting name of each serial port, by the name that it has now."""
    folder = root / "dev/serial/by-id"
    links = sorted(folder.iterdir()) if folder.is_dir() else []
    return {link.readlink().name: link for link in links if link.is_symlink()}


def _known(usb: _Usb, files: Iterable[DeviceFile]) -> list[DeviceFile]:
    """What a USB device may be: by vendor and product, else by the vendor, else by what it can do."""
    named = [file for file in files if not file.found_by.product or file.found_by.product in usb.name]
    for ids in (usb.ids, usb.vendor):
        if exact := [file for file in named if ids in file.found_by.usb]:
            return exact
    return [file for file in files if (file.found_by.input and usb.forces) or (file.found_by.serial and usb.ttys)]


def _described(
    usb: _Usb, known: list[DeviceFile], root: Path, may: Callable[[Path], bool], places: Iterable[Path]
) -> PluggedIn:
    """A USB device that is known, with what is missing."""
    first = known[0]
    found_by = first.found_by
    missing = list(_of_driver(first))
    if found_by.library and not _library(found_by.library, places):
        missing.append(
            f"found no lib{found_by.library}.so; expected the maker's library: install it, and name its folder in "
            "LD_LIBRARY_PATH or its path in the driver's parameters"
        )
    if found_by.input and not usb.forces:
        missing.append(
            "found no event device with constant forces; expected a kernel driver that has them: see that the wheel is "
            "in its mode for computers, and that the kernel has a driver for it"
        )
    own = usb.forces or usb.ttys or usb.hidraws if not found_by.library else ()
    node, rule = (own or (usb.node,))[0], ""
    shown = f"/{node.relative_to(root)}"
    if not os.path.lexists(node):
        missing.append(f"found no {shown}; expected that node: a container has to be given the device")
    elif not may(node):
        if node in usb.ttys:
            missing.append(f"{shown} may not be opened: sudo usermod -aG dialout $USER, and log in again")
        else:
            rule = _rule(usb, node)
            missing.append(
                f"{shown} may not be opened: write the rule into {RULES}, run sudo udevadm control --reload-rules, and "
                "plug it in again"
            )
    nodes = tuple(f"/{path.relative_to(root)}" for path in (usb.node, *usb.ttys, *usb.hidraws, *usb.forces))
    names = tuple(file.name for file in known)
    return PluggedIn(usb.place, usb.ids, usb.name, nodes, names, tuple(missing), rule, _next(first, shown))


def _of_driver(file: DeviceFile) -> tuple[str, ...]:
    """What is missing of the driver of a device."""
    if file.driver is None:
        return ("this package has no driver of it: write one (docs/drivers.md), or use an installed package's",)
    if file.driver not in published(DRIVERS):
        return (f"this version of manyhands has no driver {file.driver}",)
    try:
        require(*(extra for driver, extra in EXTRA_OF.items() if driver == published(DRIVERS)[file.driver]))
    except MissingExtra as error:
        return (str(error),)
    return ()


def _next(file: DeviceFile, node: str) -> str:
    """The command to try next; empty where no driver is there."""
    if file.driver is None or file.driver not in published(DRIVERS):
        return f"manyhands devices {file.name}"
    return f"manyhands check-driver {driver_options(file, node)} --no-push"


def parameters_to_give(file: DeviceFile, node: str = "") -> str:
    """The parameters that its driver requires, as YAML in a line; those that are not known have capitals.

    Args:
        file: of the device.
        node: the path by which it is reached; empty where that is not known either.
    """
    path = file.found_by.parameter
    known = {path: node} if path and node else {}
    needed = {**dict.fromkeys(file.needs, ""), **known}
    return "{" + ", ".join(f"{key}: {value or key.upper()}" for key, value in needed.items()) + "}"


def driver_options(file: DeviceFile, node: str = "") -> str:
    """The driver of a device with its options, for check-driver, probe and identify; ``node`` as above."""
    given = parameters_to_give(file, node)
    parameters = f" --parameters {shlex.quote(given)}" if given != "{}" else ""
    return f"{file.driver or OWN_DRIVER} --dof {file.keys.get('dof', 1)}{parameters}"


def _rule(usb: _Usb, node: Path) -> str:
    """The rule of udev that lets whoever sits at the machine use a device node."""
    subsystem = {"h": "hidraw", "e": "input"}.get(node.name[0], "usb")
    vendor = "ATTR" if subsystem == "usb" else "ATTRS"
    return (
        f'SUBSYSTEM=="{subsystem}", {vendor}{{idVendor}}=="{usb.vendor}", {vendor}{{idProduct}}=="{usb.product}", '
        'TAG+="uaccess"'
    )


def _library(name: str, places: Iterable[Path]) -> Path | None:
    """A shared library in one of these folders; None where there is none."""
    return next((path for place in places for path in sorted(place.glob(f"lib{name}.so*"))), None)


def _text(path: Path) -> str:
    """The content of a file of sysfs; empty where it cannot be read."""
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""
