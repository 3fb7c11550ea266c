"""The certificate: one readable JSON file that says which loop is stable with which coupling, and why.

It holds the physical data of the loop, the coupling, the levels each party promises, the storage matrices
that prove them, the margins, and a SHA-256 id over all of it. Floats are written by their shortest exact
representation, so that the file round-trips bit by bit. Reading needs numpy alone: a node can do it.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from manyhands.design.contract import Levels
from manyhands.design.coupling import SpringDamper
from manyhands.design.errors import CertificateError
from manyhands.design.network import Link, Network
from manyhands.design.partition import Partition
from manyhands.design.problem import DeviceLevel, HapticLoop
from manyhands.design.statespace import Matrix, StateSpace, matrix

FORMAT = "manyhands-certificate"
VERSION = 1
MAX_FILE_BYTES = 256 * 2**20
_KEYS = {"id", "format", "version", "session", "period", "tau", "ports", "devices", "structure", "environment"}
_KEYS |= {"coupling", "levels", "storage", "margins", "method"}


@dataclass(frozen=True, eq=False)
class Certificate:
    """A claim that a loop is stable, with its proof.

    Attributes:
        loop: the physical data, the period and the block structure.
        tau: delay inside the tick that the proof assumes, s.
        coupling: K and B when the coupling is of the spring-damper class.
        blocks: the realisation of each block of V, in the partition's order.
        levels: the promised levels and the storage matrices.
        margins: by condition, how far it is from failing.
        method: how the coupling was found: algorithm, iterations, solver.
        id: SHA-256 (hex) over the content; empty until :func:`seal`.
    """

    loop: HapticLoop
    tau: float
    coupling: SpringDamper | None
    blocks: tuple[StateSpace, ...]
    levels: Levels
    margins: Mapping[str, float]
    method: Mapping[str, str | int]
    id: str = ""


def content(certificate: Certificate) -> dict[str, Any]:
    """Everything the certificate says, as JSON values, without its id."""
    loop = certificate.loop
    ports = loop.ports
    coupling: dict[str, Any] = {"class": "linear"}
    if certificate.coupling is not None:
        coupling = {
            "class": "spring-damper",
            "stiffness": certificate.coupling.stiffness.tolist(),
            "damping": certificate.coupling.damping.tolist(),
        }
    coupling["blocks"] = {
        name: _system(block) for name, block in zip(loop.partition.names, certificate.blocks, strict=True)
    }
    return {
        "format": FORMAT,
        "version": VERSION,
        "session": loop.session,
        "period": loop.period,
        "tau": certificate.tau,
        "ports": list(ports),
        "devices": {d.name: {"ports": [ports[p] for p in d.ports], "osp": d.level.tolist()} for d in loop.devices},
        "structure": {
            name: [ports[p] for p in block]
            for name, block in zip(loop.partition.names, loop.partition.blocks, strict=True)
        },
        "environment": {
            "type": "network",
            "masses": dict(loop.network.masses),
            "links": [
                {"between": list(link.ends), "stiffness": link.stiffness, "damping": link.damping}
                for link in loop.network.links
            ],
        },
        "coupling": coupling,
        "levels": {
            "Delta_D": loop.Delta_D.tolist(),
            "Delta_V": certificate.levels.Delta_V.tolist(),
            "Phi_E": certificate.levels.Phi_E.tolist(),
        },
        "storage": {
            "E_hat": _system(loop.E_hat),
            "P_E": certificate.levels.P_E.tolist(),
            "P_V": {name: P.tolist() for name, P in zip(loop.partition.names, certificate.levels.P_V, strict=True)},
        },
        "margins": dict(certificate.margins),
        "method": dict(certificate.method),
    }


def identity(data: Mapping[str, Any]) -> str:
    """SHA-256 (hex) over the content's canonical JSON: sorted keys, no spaces, shortest exact floats."""
    canonical = json.dumps(
        {key: value for key, value in data.items() if key != "id"},
        sort_keys=True,
        separators=(",", ":"),
        allow_nan=False,
    )
    return hashlib.sha256(canonical.encode()).hexdigest()


def seal(certificate: Certificate) -> Certificate:
    """The same certificate with its id."""
    return replace(certificate, id=identity(content(certificate)))


def to_json(certificate: Certificate) -> str:
    """The file's text: the id first, matrices a row a line."""
    data = {"id": certificate.id, **content(certificate)}
    return _pretty(data) + "\n"


def save(certificate: Certificate, path: Path) -> None:
    """Write the file whole or not at all."""
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_text(to_json(certificate))
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def load(path: Path) -> tuple[Certificate, Mapping[str, Any]]:
    """Read a certificate; its id is *read*, not believed: verification recomputes it.

    Returns:
        The certificate, and the file's plain data, over which the id is computed.

    Raises:
        CertificateError: not readable, not a certificate, or not of this version; names file and key.
    """
    try:
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES + 1)
        if len(text) > MAX_FILE_BYTES:
            raise CertificateError(f"{path}: larger than {MAX_FILE_BYTES} bytes")
        data = json.loads(
            text.decode(), parse_float=_finite, parse_constant=_finite, object_pairs_hook=_without_duplicates
        )
    except json.JSONDecodeError as error:
        raise CertificateError(f"{path}:{error.lineno}: not JSON: {error.msg}") from error
    except (OSError, ValueError, RecursionError) as error:
        raise CertificateError(f"{path}: cannot be read: {error}") from error
    try:
        return from_content(data), data
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        what = f"key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise CertificateError(f"{path}: not a certificate of this version: {what}") from error


def from_content(data: Mapping[str, Any]) -> Certificate:
    """The certificate that :func:`content` (with "id") describes.

    Raises:
        KeyError, TypeError, ValueError, AttributeError, OverflowError: something is missing, of another type, shape
            or size.
    """
    if data["format"] != FORMAT or data["version"] != VERSION:
        raise ValueError(f"expected {FORMAT} version {VERSION}, found {data['format']!r} {data['version']!r}")
    if unknown := set(data) - _KEYS:
        raise ValueError(f"found the keys {sorted(unknown)}, expected {sorted(_KEYS)}")
    if data["environment"]["type"] != "network":
        raise ValueError(f"environment.type: found {data['environment']['type']!r}, expected 'network'")
    if not isinstance(data["session"], str) or not all(isinstance(v, str | int) for v in data["method"].values()):
        raise ValueError("expected session to be a text, and every value of method a text or a whole number")
    ports = tuple(str(p) for p in data["ports"])
    index = {port: i for i, port in enumerate(ports)}
    structure = data["structure"]
    m = len(ports)
    loop = HapticLoop(
        session=str(data["session"]),
        period=float(data["period"]),
        ports=ports,
        devices=tuple(
            DeviceLevel(name, tuple(index[p] for p in device["ports"]), matrix(device["osp"]))
            for name, device in data["devices"].items()
        ),
        partition=Partition(tuple(structure), tuple(tuple(index[p] for p in block) for block in structure.values())),
        network=Network(
            ports,
            tuple((str(name), float(mass)) for name, mass in data["environment"]["masses"].items()),
            tuple(
                Link((str(a), str(b)), float(link["stiffness"]), float(link["damping"]))
                for link in data["environment"]["links"]
                for a, b in [link["between"]]
            ),
        ),
    )
    coupling, levels, storage = data["coupling"], data["levels"], data["storage"]
    blocks = tuple(read_system(coupling["blocks"][name]) for name in loop.partition.names)
    read_system(storage["E_hat"])  # what is only restated must be readable too: verification compares it
    matrix(levels["Delta_D"], m, m)
    if len(storage["P_E"]) < len(loop.network.masses):  # before anything of that size squared is built
        raise ValueError("storage.P_E: expected two rows a mass or more")
    if coupling["class"] not in ("spring-damper", "linear"):
        raise ValueError(f"coupling.class: found {coupling['class']!r}, expected 'spring-damper' or 'linear'")
    spring_damper = None
    if coupling["class"] == "spring-damper":
        spring_damper = SpringDamper(matrix(coupling["stiffness"], m, m), matrix(coupling["damping"], m, m))
    return Certificate(
        loop=loop,
        tau=float(data["tau"]),
        coupling=spring_damper,
        blocks=blocks,
        levels=Levels(
            Delta_V=matrix(levels["Delta_V"], m, m),
            Phi_E=matrix(levels["Phi_E"], m, m),
            P_E=_read_square(storage["P_E"]),
            P_V=tuple(_read_square(storage["P_V"][name]) for name in loop.partition.names),
        ),
        margins={str(k): float(v) for k, v in data["margins"].items()},
        method={str(k): v for k, v in data["method"].items()},
        id=str(data["id"]),
    )


def _system(system: StateSpace) -> dict[str, Any]:
    return {"A": system.A.tolist(), "B": system.B.tolist(), "C": system.C.tolist(), "D": system.D.tolist()}


def _read_square(rows: Any) -> Matrix:
    """A square matrix, which may have no rows: a network without springs and masses stores nothing."""
    return matrix(rows, len(rows), len(rows)) if rows else np.zeros((0, 0))


def read_system(data: Mapping[str, Any]) -> StateSpace:
    """The system whose matrices :func:`content` wrote; JSON has no shape for a matrix without rows or columns.

    Raises:
        KeyError, TypeError, ValueError: a matrix is missing, or is none of that shape.
    """
    D = matrix(data["D"])
    if not data["A"]:
        if data["B"] or any(data["C"]):
            raise ValueError("expected B and C without entries where A has none")
        return StateSpace.static(D)
    return StateSpace(matrix(data["A"]), matrix(data["B"]), matrix(data["C"]), D)


def _finite(text: str) -> float:
    """A number of the file; Python's JSON would read NaN, Infinity and 1e999 too."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"expected finite numbers, found {text[:40]}")
    return number


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; a key given twice would show a reader another file than the one that is checked."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError(f"expected every key once, found {sorted(key for key, _ in pairs)}")
    return found


def _pretty(value: Any, indent: int = 0) -> str:
    """JSON with vectors on one line, so that a matrix looks like one."""
    pad = "  " * (indent + 1)
    if isinstance(value, Mapping) and value:
        rows = [f"{pad}{json.dumps(key)}: {_pretty(item, indent + 1)}" for key, item in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + "  " * indent + "}"
    if isinstance(value, list) and any(isinstance(item, list | Mapping) for item in value):
        return "[\n" + ",\n".join(pad + _pretty(item, indent + 1) for item in value) + "\n" + "  " * indent + "]"
    return json.dumps(value, allow_nan=False)
