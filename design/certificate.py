"""The certificate: one readable JSON file that says which loop is stable with which coupling, and why.

It holds the physical data of the loop, what was asked of the coupling, the coupling, the levels each party promises,
the storage matrices that prove them where physics does not, the margins, and a SHA-256 id over all of it. Every fact
stands in it once: what follows from the physical data (E_hat, V_hat, the realisation of springs and dampers) is rebuilt
by whoever checks. Floats are written by their shortest exact representation, so that the file round-trips bit by bit.

A file of version 2 lacks what was asked, and its id does not cover the order of keys. It is read, proved and written
again as what it is (docs/decisions/0027-certificate-format-3.md).
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from manyhands.design.certificate_parts import (
    aim_of,
    coupling_of,
    describe_aim,
    describe_coupling,
    describe_environment,
    environment_of,
    matrices_by_block,
    square,
    storage_of,
)
from manyhands.design.contract import DeviceShare, Levels
from manyhands.design.coupling import CouplingBlock, SpringDamper, realisations
from manyhands.design.errors import CertificateError
from manyhands.design.files import read_regular, replacing
from manyhands.design.partition import Partition
from manyhands.design.problem import DeviceLevel, HapticLoop
from manyhands.design.statespace import Matrix, StateSpace, matrix
from manyhands.design.weighted_loop import Transparency

FORMAT = "manyhands-certificate"
VERSION = 3
WITHOUT_ASKED = 2
"""The version that does not record what was asked, and whose id is over the content with its keys sorted."""
MAX_FILE_BYTES = 256 * 2**20
_KEYS = {"id", "format", "version", "session", "period", "tau", "ports", "devices", "structure", "environment"}
_ASKED = {"coupling", "objective", "weights", "algorithm", "iterations", "order", "poles"}
_KEYS |= {"coupling", "levels", "storage", "transparency", "margins", "method"}


@dataclass(frozen=True, eq=False)
class TransparencyClaim:
    """What the coupling costs in transparency, and the storage that proves it.

    Attributes:
        aim: which of (23), (24), with its weights.
        gamma: the weighted norm is below it; dimensionless for (24), N/m for (23).
        P: storage matrix of the bounded real lemma, in the realisation that
            :func:`manyhands.design.weighted_loop.weighted` builds of :meth:`manyhands.design.split.Split.environment`.
    """

    aim: Transparency
    gamma: float
    P: Matrix


@dataclass(frozen=True, eq=False)
class Certificate:
    """A claim that a loop is stable, with its proof.

    Attributes:
        loop: the physical data, period, delay and block structure.
        coupling: the blocks of V, each a spring-damper or a linear system, in the partition's order.
        levels: the promised levels and the storage matrices.
        transparency: the claim on transparency, where the session aims at one.
        margins: by condition, how far it is from failing.
        method: how the coupling was found: algorithm, iterations, solver.
        asked: what was asked of the coupling, as plain data; not a claim, and nothing proves it. None for a file of
            version 2, which does not record it.
        id: SHA-256 (hex) over the content; empty until :func:`seal`.
    """

    loop: HapticLoop
    coupling: tuple[CouplingBlock, ...]
    levels: Levels
    transparency: TransparencyClaim | None
    margins: Mapping[str, float]
    method: Mapping[str, str | int]
    asked: Mapping[str, Any] | None
    id: str = ""

    @property
    def version(self) -> int:
        """The file format's version that holds exactly this."""
        return WITHOUT_ASKED if self.asked is None else VERSION

    @property
    def tau(self) -> float:
        """Longest delay inside the tick that the proof covers, s."""
        return self.loop.tau

    @cached_property
    def blocks(self) -> tuple[StateSpace, ...]:
        """The realisation of each block of V."""
        return realisations(self.coupling, self.loop.period)

    @cached_property
    def spring_damper(self) -> SpringDamper | None:
        """K and B of the whole coupling, m x m, when it is of the spring-damper class."""
        parts = [part for part in self.coupling if isinstance(part, SpringDamper)]
        if len(parts) != len(self.coupling):
            return None
        embed = self.loop.partition.embed
        return SpringDamper(embed([p.stiffness for p in parts]), embed([p.damping for p in parts]))


def content(certificate: Certificate) -> dict[str, Any]:
    """Everything the certificate says, as JSON values, without its id."""
    loop, levels = certificate.loop, certificate.levels
    ports, partition = loop.ports, loop.partition
    Phi_E: Any = levels.Phi_E.tolist()
    if partition.admits(levels.Phi_E):
        Phi_E = _by_block(partition, partition.restrict(levels.Phi_E))
    claim = certificate.transparency
    return {
        "format": FORMAT,
        "version": certificate.version,
        "session": loop.session,
        "period": loop.period,
        "tau": loop.tau,
        "ports": list(ports),
        "devices": {d.name: {"ports": [ports[p] for p in d.ports], "osp": d.level.tolist()} for d in loop.devices},
        "structure": {
            name: [ports[p] for p in block] for name, block in zip(partition.names, partition.blocks, strict=True)
        },
        "environment": describe_environment(loop.environment),
        **({} if certificate.asked is None else {"asked": dict(certificate.asked)}),
        "coupling": describe_coupling(partition.names, certificate.coupling),
        "levels": {
            "kappa": levels.device.kappa,
            "share": levels.device.share,
            "c": levels.device.c,
            "Delta_D": _by_block(partition, levels.Delta_D),
            "Delta_V": _by_block(partition, levels.Delta_V),
            "Phi_E": Phi_E,
        },
        "storage": {
            "E_hat": levels.P_E if isinstance(levels.P_E, str) else levels.P_E.tolist(),
            "V_hat": {name: P.tolist() for name, P in zip(partition.names, levels.P_V, strict=True) if P is not None},
        },
        "transparency": None
        if claim is None
        else describe_aim(claim.aim) | {"gamma": claim.gamma, "P": claim.P.tolist()},
        "margins": dict(certificate.margins),
        "method": dict(certificate.method),
    }


def _by_block(partition: Partition, parts: tuple[Matrix, ...]) -> dict[str, list[list[float]]]:
    return {name: part.tolist() for name, part in zip(partition.names, parts, strict=True)}


def identity(data: Mapping[str, Any]) -> str:
    """SHA-256 (hex) over the content's canonical JSON: keys in their order, no spaces, shortest exact floats.

    The order counts: that of ``devices``, ``structure`` and the ports follows from it. In version 2 keys are sorted.
    """
    canonical = json.dumps(
        {key: value for key, value in data.items() if key != "id"},
        sort_keys=data.get("version") == WITHOUT_ASKED,
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
    with replacing(path) as file:
        file.write(to_json(certificate).encode())


def load(path: Path) -> tuple[Certificate, Mapping[str, Any]]:
    """Read a certificate; its id is *read*, not believed: verification recomputes it.

    Returns:
        The certificate, and the file's plain data, over which the id is computed.

    Raises:
        CertificateError: not readable, not a certificate, or not of this version; names file and key.
    """
    try:
        text = read_regular(path, MAX_FILE_BYTES)
        data = json.loads(
            text.decode(), parse_float=_finite, parse_constant=_finite, object_pairs_hook=_without_duplicates
        )
    except json.JSONDecodeError as error:
        raise CertificateError(f"{path}:{error.lineno}: not JSON: {error.msg}") from error
    except OSError as error:
        raise CertificateError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise CertificateError(f"{path}: cannot be read: {error}") from error
    try:
        return from_content(data), data
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        what = f"key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise CertificateError(f"{path}: not a certificate of a known version: {what}") from error


def from_content(data: Mapping[str, Any]) -> Certificate:
    """The certificate that :func:`content` (with "id") describes.

    Raises:
        KeyError, TypeError, ValueError, AttributeError, OverflowError: something is missing, of another type, shape
            or size.
    """
    form, version = data["format"], data["version"]
    if form != FORMAT or type(version) is not int or version not in (WITHOUT_ASKED, VERSION):
        expected = f"{FORMAT} version {WITHOUT_ASKED} or {VERSION}"
        raise ValueError(f"expected {expected}, found {form!r} {version!r}")
    keys = _KEYS if version == WITHOUT_ASKED else _KEYS | {"asked"}
    if unknown := set(data) - keys:
        raise ValueError(f"found the keys {sorted(unknown)}, expected {sorted(keys)}")
    asked = None if version == WITHOUT_ASKED else data["asked"]
    if version == VERSION and not isinstance(asked, Mapping):
        raise ValueError("expected asked to be an object")
    if unknown := set(asked or ()) - _ASKED:
        raise ValueError(f"asked: found the keys {sorted(unknown)}, expected some of {sorted(_ASKED)}")
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
        environment=environment_of(data["environment"], ports),
        tau=float(data["tau"]),
    )
    partition, levels, storage = loop.partition, data["levels"], data["storage"]
    Phi_E = levels["Phi_E"]
    linear = data["coupling"]["class"] == "linear"
    claim = data["transparency"]
    return Certificate(
        loop=loop,
        coupling=coupling_of(data["coupling"], partition),
        levels=Levels(
            device=DeviceShare(float(levels["kappa"]), float(levels["share"]), float(levels["c"])),
            Delta_D=matrices_by_block(levels["Delta_D"], partition),
            Delta_V=matrices_by_block(levels["Delta_V"], partition),
            Phi_E=partition.embed(matrices_by_block(Phi_E, partition))
            if isinstance(Phi_E, Mapping)
            else matrix(Phi_E, m, m),
            P_E=storage_of(storage["E_hat"], loop.environment),
            P_V=tuple(square(storage["V_hat"][name]) if linear else None for name in partition.names),
        ),
        transparency=None
        if claim is None
        else TransparencyClaim(aim_of(claim), float(claim["gamma"]), square(claim["P"])),
        margins={str(k): float(v) for k, v in data["margins"].items()},
        method={str(k): v for k, v in data["method"].items()},
        asked=asked,
        id=str(data["id"]),
    )


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
