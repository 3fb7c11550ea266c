"""Device files: what is known of a device, each number with its source, and the catalogue of them in this package.

A device of a session names one by ``from``: a name of the catalogue, or the path of a file of one's own. The keys of
the file are then defaults of the device, and those of the session win. They are put in place before anything is
checked, so that everything behind the reader sees plain keys, and an error of theirs names the file and the line
(:func:`with_device_files`). docs/devices.md describes the format.

Every key has a source. No file of the catalogue has an ``osp`` without a citation or an identification, for a
certificate rests on it.
"""

from __future__ import annotations

import functools
import importlib.resources
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from manyhands.design.models.axis import AxisKind, Units
from manyhands.launch.session.device import OF_A_PLUGIN, Device
from manyhands.launch.session.errors import SessionError, key_text, one_of, show
from manyhands.launch.session.fields import Problem, first_error, nulls_in
from manyhands.launch.session.forms import JsonSchema, either
from manyhands.launch.session.yaml import KeyPath, SessionTree, read_tree
from manyhands.protocol.limits import MAX_BY_ITSELF, MAX_SENTENCE, MAX_TEXT

FROM: Final = "from"
"""The key of a session's device that names a device file."""

BY_ITSELF: Final = "by_itself"
"""The key of what a device does by itself, in a device file and in a session."""

OWN_ENTRIES: Final = ("limits", "parameters")
"""Keys whose entries a session states one by one: each that it does not state is the file's."""

SUFFIX: Final = ".yaml"
_SUFFIXES: Final = (SUFFIX, ".yml")
_KEYS: Final = tuple(key for key in Device.model_fields if key not in ("trace", "hand", BY_ITSELF))
"""What a device file may say of a device: not how somebody holds it."""

_PARTS: Final = ("device", "keys", "sources", BY_ITSELF, "identification", "needs", "notes", "found_by")
_REQUIRED: Final = ("device", "keys", "sources")
_CITED: Final = re.compile(r"\bdoi\b|https?://|\bidentif", re.IGNORECASE)
_USB: Final = re.compile(r"[0-9a-f]{4}(:[0-9a-f]{4})?")
_FLAGS: Final = ("input", "serial")
_FOUND_BY: Final = ("usb", "product", "library", "service", *_FLAGS, "parameter", "source")
_TO_DO: Final = "the damping that your device surely has; measure it with manyhands identify, or state it"


@dataclass(frozen=True)
class FoundBy:
    """By what a plugged-in device is known.

    Attributes:
        usb: vendor and product, "1451:0402", or the vendor alone, in lowercase hexadecimal.
        product: a part of its USB product's name, where many products share the ids; empty for any.
        library: the shared library that talks to it, by its name without "lib" and ".so"; empty for none.
        service: the address at which its maker's service tells its version; empty for none.
        input: whether it is a device of Linux' input subsystem with force feedback.
        serial: whether any USB serial port may be one.
        parameter: of its driver, which takes the path of the port; empty where it takes none.
        source: where the ids are from.
    """

    usb: tuple[str, ...] = ()
    product: str = ""
    library: str = ""
    service: str = ""
    input: bool = False
    serial: bool = False
    parameter: str = ""
    source: str = ""


@dataclass(frozen=True)
class DeviceFile:
    """A checked device file; of its keys only the names are, for their values depend on the session.

    Attributes:
        name: by which a session names it.
        device: what it is about, in one line.
        keys: of a session's device.
        sources: where each of them is from, a text for each key.
        by_itself: what the device does by itself, a sentence each.
        identification: how its numbers were measured, plain data.
        needs: the parameters that its driver requires of whoever has it, and what each is.
        notes: sentences about it.
        found_by: how it is known when it is plugged in.
        tree: the file, with its places.
    """

    name: str
    device: str
    keys: Mapping[str, Any]
    sources: Mapping[str, str]
    by_itself: tuple[str, ...] = ()
    identification: Mapping[str, Any] = field(default_factory=dict)
    needs: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    found_by: FoundBy = FoundBy()
    tree: SessionTree = field(default_factory=lambda: SessionTree("", {}, {}), repr=False, compare=False)

    @property
    def driver(self) -> str | None:
        """The driver that its keys name; None where they name none."""
        driver = self.keys.get("driver")
        return driver if isinstance(driver, str) else None

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {"name": self.name, **self.tree.data}


@functools.cache
def catalogue() -> Mapping[str, Path]:
    """The files of the catalogue by name, in alphabetical order."""
    folder = Path(str(importlib.resources.files("manyhands"))) / "devices" / "catalogue"
    return {path.name.removesuffix(SUFFIX): path for path in sorted(folder.glob(f"*{SUFFIX}"))}


def catalogue_file(name: str) -> DeviceFile:
    """The file of the catalogue with this name.

    Raises:
        SessionError: there is none, or it is wrong.
    """
    files = catalogue()
    if name not in files:
        raise SessionError(name, None, "", "no such device in the catalogue", one_of(files, name))
    return _read(files[name], name, shipped=True)


def device_file(path: Path) -> DeviceFile:
    """The file of a device of one's own.

    Raises:
        SessionError: it cannot be read, or is no device file.
    """
    return _read(path, str(path), shipped=False)


def with_device_files(tree: SessionTree, folder: Path) -> SessionTree:
    """The tree of a session with the keys of the device files that its devices name, and without ``from``.

    Args:
        tree: the session.
        folder: relative paths are below it.

    Raises:
        SessionError: a device names no such file, or the file is wrong.
    """
    devices = tree.data.get("devices")
    if not isinstance(devices, dict):
        return tree
    for name, device in devices.items():
        if isinstance(device, dict) and FROM in device:
            tree = _with_file(tree, name, device, _named(tree, name, device[FROM], folder))
    return tree


def parts_to_begin(tree: SessionTree) -> frozenset[KeyPath]:
    """The parts of devices with ``from`` that an override may begin, for the file may have them already."""
    devices = tree.data.get("devices")
    own = devices.items() if isinstance(devices, dict) else ()
    named = [name for name, device in own if isinstance(device, dict) and FROM in device]
    return frozenset(("devices", name, part) for name in named for part in OWN_ENTRIES)


def _named(tree: SessionTree, name: str, value: object, folder: Path) -> DeviceFile:
    """The file that a device of the session names."""
    at = ("devices", name, FROM)
    if isinstance(value, str) and value in catalogue():
        return catalogue_file(value)
    _, place = tree.locate(at)
    if isinstance(value, str) and value.endswith(_SUFFIXES):
        if not (folder / value).exists():
            expected = f"a device file, relative to {place.source}"
            raise SessionError(place.source, place.line, key_text(at), f"{show(value)}, which is no file", expected)
        return device_file(folder / value)
    expected = f"{one_of(catalogue(), value)}, or the path of a device file, such as ./my-stick{SUFFIX}"
    raise SessionError(place.source, place.line, key_text(at), show(value), expected)


def _with_file(tree: SessionTree, name: str, device: Mapping[str, Any], file: DeviceFile) -> SessionTree:
    """The tree with a device's keys merged; those of the file have the file's places."""
    at: KeyPath = ("devices", name)
    own = {key: value for key, value in device.items() if key != FROM}
    given = dict(file.keys)
    if "driver" in own and own["driver"] != file.driver:  # what the file says of its driver is not true of another
        given = {key: value for key, value in given.items() if key not in OF_A_PLUGIN}
    elif file.by_itself:
        given[BY_ITSELF] = list(file.by_itself)
    merged = {**given, **own}
    for key in (*OWN_ENTRIES, BY_ITSELF):
        match given.get(key), own.get(key):
            case dict(theirs), dict(ours):
                merged[key] = {**theirs, **ours}
            case list(theirs), list(ours):
                merged[key] = [*theirs, *ours]
    places = {
        inner: place
        for path, place in file.tree.places.items()
        if len(inner := _inner(at, path)) > len(at) and inner[2] in given
    } | {path: place for path, place in tree.places.items() if path != (*at, FROM)}
    if "osp" not in merged:
        _, where = tree.locate((*at, FROM))
        found, expected = f"no osp, and none in {file.name}", f"osp in {_unit_of_osp(merged.get('axes'))}: {_TO_DO}"
        raise SessionError(where.source, where.line, key_text(at), found, expected)
    devices = {**_entries(tree.data["devices"]), name: merged}
    return SessionTree(tree.source, {**tree.data, "devices": devices}, places)


def _unit_of_osp(axes: object) -> str:
    """By what a session or a file says of the axes, which is not checked yet."""
    kinds = axes.values() if isinstance(axes, Mapping) else [axes]
    turn = AxisKind.ROTATION
    return Units.of(turn if kind == turn.value else AxisKind.TRANSLATION for kind in kinds)("N·s/m")


def _inner(at: KeyPath, path: KeyPath) -> KeyPath:
    """The path in a session's device of a path in a device file; ``at`` for what stays in the file."""
    if path[:1] == (BY_ITSELF,):
        return (*at, *path)
    return (*at, *path[1:]) if path[:1] == ("keys",) else at


def _read(path: Path, name: str, *, shipped: bool) -> DeviceFile:
    """A checked device file.

    Raises:
        SessionError: it cannot be read, or is wrong; the message has the first problem in the order of the file.
    """
    tree = read_tree(path, "device file", "device: NAME")
    problems = [*_problems(tree.data, shipped), *nulls_in(tree.data)]
    if problems:
        raise first_error(tree, problems)
    data: dict[str, Any] = tree.data
    found_by = data.get("found_by", {})
    return DeviceFile(
        name,
        data["device"],
        data["keys"],
        data["sources"],
        tuple(data.get(BY_ITSELF, ())),
        data.get("identification", {}),
        data.get("needs", {}),
        tuple(data.get("notes", ())),
        FoundBy(**{**found_by, "usb": tuple(found_by.get("usb", ()))}),
        tree,
    )


def _problems(data: Mapping[str, Any], shipped: bool) -> Iterator[Problem]:
    """Everything that is wrong in a device file, apart from the values of its keys."""
    for part in data:
        if part not in _PARTS:
            yield Problem((part,), f"the unknown key {show(part)}", one_of(_PARTS, part))
    for part in _REQUIRED:
        if part not in data:
            yield Problem((), f"no key {part!r}", f"the keys {', '.join(_REQUIRED)}")
    device = data.get("device", "")
    if "device" in data and not _is_line(device, MAX_SENTENCE):
        yield Problem(("device",), show(device), f"what it is, in one line of 1 to {MAX_SENTENCE} characters")
    for part in ("keys", "sources", "identification", "needs"):
        if part in data and not isinstance(data[part], Mapping):
            yield Problem((part,), show(data[part]), "a mapping")
    for key, what in _entries(data.get("needs", {})).items() if isinstance(data.get("needs"), Mapping) else ():
        if not isinstance(key, str) or not _is_line(what, MAX_SENTENCE):
            yield Problem(("needs", key), show(what), "what this parameter of the driver is, in one line")
    for part, most in ((BY_ITSELF, MAX_SENTENCE), ("notes", MAX_TEXT)):
        if not isinstance(value := data.get(part, []), list):
            yield Problem((part,), show(value), "a list of sentences")
        for index, item in enumerate(_entries(value)):
            if not _is_line(item, most):
                yield Problem((part, index), show(item), f"a sentence in one line of 1 to {most} characters")
    if len(_entries(data.get(BY_ITSELF))) > MAX_BY_ITSELF:
        yield Problem((BY_ITSELF,), show(data[BY_ITSELF]), f"at most {MAX_BY_ITSELF} sentences")
    yield from _source_problems(_entries(data.get("keys")), _entries(data.get("sources")), shipped)
    yield from _found_by_problems(data.get("found_by", {}))


def _source_problems(keys: Mapping[str, Any], sources: Mapping[str, Any], shipped: bool) -> Iterator[Problem]:
    """The problems of keys and their sources."""
    for key in keys:
        if key not in _KEYS:
            yield Problem(("keys", key), f"the key {show(key)}", one_of(_KEYS, key))
        elif key not in sources:
            yield Problem(("keys", key), f"{key} without a source", f"sources: {{{key}: where the number is from}}")
    for key, source in sources.items():
        if key not in keys:
            yield Problem(("sources", key), f"a source of {show(key)}, which is no key of this file", one_of(keys, key))
        elif not isinstance(source, str) or not source.strip():
            yield Problem(("sources", key), show(source), "a text: where the number is from")
        elif shipped and key == "osp" and not _CITED.search(source):
            expected = "a citation (doi: or https://) or an identification: a certificate rests on osp"
            yield Problem(("sources", key), show(source), expected)


def _found_by_problems(found_by: object) -> Iterator[Problem]:
    """The problems of what a plugged-in device is known by."""
    if not isinstance(found_by, Mapping):
        yield Problem(("found_by",), show(found_by), f"a mapping with {', '.join(_FOUND_BY)}")
        return
    for key, value in found_by.items():
        at = ("found_by", key)
        if key not in _FOUND_BY:
            yield Problem(at, f"the unknown key {show(key)}", one_of(_FOUND_BY, key))
        elif key == "usb":
            if not isinstance(value, list) or not all(isinstance(one, str) and _USB.fullmatch(one) for one in value):
                yield Problem(
                    at, show(value), 'a list of "VENDOR:PRODUCT" or "VENDOR", lowercase hexadecimal in quotes'
                )
        elif key in _FLAGS:
            if not isinstance(value, bool):
                yield Problem(at, show(value), "true or false")
        elif not isinstance(value, str):
            yield Problem(at, show(value), "a text")
    if found_by and not found_by.get("source"):
        yield Problem(("found_by",), "no source", "source: where these ids are from")


def _is_line(value: object, most: int) -> bool:
    return isinstance(value, str) and 0 < len(value) <= most and value.isprintable()


def _entries(value: object) -> Any:
    """The value where it is a mapping or a list; else nothing, for another problem says so."""
    return value if isinstance(value, dict | list) else {}


def with_from(described: JsonSchema) -> JsonSchema:
    """The JSON schema of a session's device, with ``from``: what the device needs, its file may have.

    Args:
        described: the schema of a device without it.
    """
    names = {"enum": [*catalogue()]}
    form = either({"type": "string", **names}, {"type": "string", "pattern": r"\.ya?ml$"})
    about = "a device of the catalogue, or the path of a device file: its keys are defaults of this device's"
    required = {"required": described["required"]}
    return {
        **{key: value for key, value in described.items() if key not in ("required", "allOf")},
        "properties": {FROM: {**form, "description": about}, **described["properties"]},
        "allOf": [{"if": {"required": [FROM]}, "then": True, "else": {"allOf": [required, *described["allOf"]]}}],
    }
