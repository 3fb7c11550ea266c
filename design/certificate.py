"""The certificate: one readable JSON file that states which loop is stable with which coupling, and why.

It holds the physical data of the loop, the request for the coupling, the coupling, and the levels that each party
promises. Storage matrices prove the levels where physics does not. The margins and a SHA-256 id over all of it follow.
Every fact stands in the file once: a check rebuilds what follows from the physical data (E_hat, V_hat, the realisation
of springs and dampers). Floats are written by their shortest exact representation, so that the file round-trips bit by
bit.

A file that says more of a device than its level is of version 6. The key ``held`` of a device says how it holds its
force (docs/decisions/0050-held-torques.md), ``step`` has the steps of its encoder and ``friction`` its dry friction.
``orientation`` has the damping b and the stiffness k of a tool that its hand turns (0054-orientation.md).
``turning`` names those of its ports that turn, whose numbers are in N·m and rad; no proof depends on it.
Where a device has steps, ``encoder`` claims what they add to the forces, and whether the friction covers that
(docs/decisions/0051-encoder-steps-and-friction.md). With ``speed`` the dry friction counts as damping, and the whole
claim is about motions that are slower on every axis. Files of the other versions say nothing of these: they are about
devices that hold the force itself and measure exactly.

A file that counts a part of the world's contact springs in series with the coupling has the key ``series``, and is of
version 5. Its coupling is the one that the processes run, which contains that part; its environment is the world as the
session describes it (docs/decisions/0045-series-compliance.md).

A file whose claim covers periods longer than T has the key ``period_tolerance`` and is of version 4: a reader that does
not know the key must not take the claim for one about periods of T. Every other file is of version 3
(docs/decisions/0010-delay-inside-the-tick.md). Older versions are refused
(docs/decisions/0027-certificate-format-3.md).

Requests, couplings and aims come in several kinds; each ``describe_`` function turns one into JSON values, as an
environment does itself (:meth:`.Environment.terms`). All except requests are read back. A proof alone does not show
that a certificate is about a given loop and request: :func:`differences` compares them.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from manyhands.design.environments import environment_of
from manyhands.design.errors import CertificateError, OldCertificate
from manyhands.design.files import read_regular, replacing
from manyhands.design.levels.contract import ENERGY, ENFORCED, DeviceShare, Levels, Storage
from manyhands.design.levels.encoder import EncoderClaim, encoder_of
from manyhands.design.levels.held_torque import held_torque_of
from manyhands.design.levels.orientation import orientation_of
from manyhands.design.models.brief import brief, brief_names, brief_repr
from manyhands.design.models.coupling import CouplingBlock, Partition, SpringDamper, realisations, spring_damper_of
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import (
    LinearSystem,
    Matrix,
    StateSpace,
    matrix,
    rational_values,
    read_rational,
    read_system,
    system_values,
)
from manyhands.design.models.transfer import InDifferences
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import (
    STATED,
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    LinearWanted,
    NoCoupling,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)

if TYPE_CHECKING:
    from manyhands.design.frequency_responses import FrequencyResponses


def describe_request(wanted: CouplingRequest, names: Sequence[str]) -> dict[str, Any]:
    """The request for a coupling as JSON values, by the keys of a session's ``design:``.

    The delay, the period tolerance and a given coupling's numbers are left out, because a certificate has them
    elsewhere. Weights are in z.

    Args:
        wanted: the request.
        names: of the blocks of V, in the partition's order.
    """
    match wanted:
        case SpringDamperWanted(wish):
            return {"coupling": "spring-damper", **_describe_wish(wish)}
        case LinearWanted(orders, wish, poles):
            order = {"order": dict(zip(names, orders, strict=True))}
            fixed = [{"frequency": pole.frequency, "damping": pole.damping} for pole in poles or ()]
            return {"coupling": "linear", **_describe_wish(wish), **order} | ({"poles": fixed} if fixed else {})
        case SpringDamperGiven(_, aim) | LinearGiven(_, aim):
            return {"coupling": "given", **_describe_objective("feasible", aim)}
    return {"coupling": "none", **_describe_objective("feasible", None)}


def _describe_wish(wish: Wish) -> dict[str, Any]:
    out = {**_describe_objective(wish.objective, wish.aim), "algorithm": wish.algorithm}
    return out | ({"iterations": wish.iterations} if wish.algorithm == "complementarity" else {})


def _describe_objective(objective: str, aim: Transparency | None) -> dict[str, Any]:
    return {"objective": objective} if aim is None else {"objective": aim.objective, "weights": _weights(aim)}


def describe_coupling(names: Sequence[str], coupling: tuple[CouplingBlock, ...]) -> dict[str, Any]:
    """The blocks of V: K and B of springs and dampers, A, B, C, D of linear ones."""
    blocks: dict[str, Any] = {}
    linear = False
    for name, part in zip(names, coupling, strict=True):
        if isinstance(part, SpringDamper):
            blocks[name] = {"stiffness": part.stiffness.tolist(), "damping": part.damping.tolist()}
        else:
            linear = True
            blocks[name] = system_values(part)
    return {"class": "linear" if linear else "spring-damper", "blocks": blocks}


def coupling_of(data: Mapping[str, Any], partition: Partition) -> tuple[CouplingBlock, ...]:
    """The blocks that :func:`describe_coupling` wrote, in the partition's order.

    Raises:
        KeyError, TypeError, ValueError: a block is missing, or its size is not that of its ports.
    """
    sizes = {name: len(block) for name, block in zip(partition.names, partition.blocks, strict=True)}
    blocks = data["blocks"]
    if set(blocks) != set(sizes):
        raise ValueError(f"coupling.blocks: found {sorted(blocks)}; expected {sorted(sizes)}")
    if data["class"] == "spring-damper":
        return tuple(
            SpringDamper(matrix(blocks[name]["stiffness"], m, m), matrix(blocks[name]["damping"], m, m))
            for name, m in sizes.items()
        )
    if data["class"] != "linear":
        raise ValueError(f"coupling.class: found {data['class']!r}; expected 'spring-damper' or 'linear'")
    systems = tuple(read_system(blocks[name]) for name in sizes)
    for (name, m), system in zip(sizes.items(), systems, strict=True):
        if (system.outputs, system.inputs) != (m, m):
            raise ValueError(f"coupling.blocks.{name}: expected {m} inputs and outputs")
    return systems


def describe_storage(storage: Storage) -> Any:
    """A storage as JSON values: rows, {"differences": rows}, or the word that stands in its place."""
    if isinstance(storage, InDifferences):
        return {"differences": storage.P.tolist()}
    return storage if isinstance(storage, str) else storage.tolist()


def storage_of(value: Any, environment: Environment) -> Storage:
    """E_hat's storage: a matrix, or the word that stands in its place. Only a declared environment has none.

    Raises:
        ValueError: the word is not the one for this environment, or the value is not a matrix.
    """
    if environment.declared_level is not None:
        if value != ENFORCED:
            raise ValueError(f"storage.E_hat: expected {ENFORCED!r} for a declared environment")
        return ENFORCED
    if isinstance(value, str):
        if value != ENERGY:
            raise ValueError(f"storage.E_hat: found {value[:40]!r}; expected {ENERGY!r} or a matrix")
        return ENERGY
    return _matrix_or_differences(value)


def _matrix_or_differences(value: Any) -> Matrix | InDifferences:
    """A storage matrix that states of E belong to, in either of its forms."""
    if not isinstance(value, Mapping):
        return square(value)
    if set(value) != {"differences"}:
        raise ValueError(f"storage matrix: found the keys {sorted(value)}; expected rows or the one key differences")
    return InDifferences(square(value["differences"]))


def matrices_by_block(data: Mapping[str, Any], partition: Partition) -> tuple[Matrix, ...]:
    """One square matrix for each block, in the partition's order."""
    if set(data) != set(partition.names):
        raise ValueError(f"found matrices for {sorted(data)}; expected them for {sorted(partition.names)}")
    return tuple(
        matrix(data[name], len(block), len(block))
        for name, block in zip(partition.names, partition.blocks, strict=True)
    )


def describe_aim(aim: Transparency) -> dict[str, Any]:
    """The transparency problem as JSON values, its weights in z."""
    return {"objective": aim.objective, **_weights(aim)}


def _weights(aim: Transparency) -> dict[str, Any]:
    return {name: rational_values((W.num, W.den)) for name, W in (("W1", aim.W1), ("W2", aim.W2))}


def aim_of(data: Mapping[str, Any]) -> Transparency:
    """The aim that :func:`describe_aim` wrote."""
    if data["objective"] not in ("loop-shaping", "closed-loop"):
        found = data["objective"]
        raise ValueError(f"transparency.objective: found {found!r}; expected 'loop-shaping' or 'closed-loop'")
    W1, W2 = (Filter(*read_rational(data[name])) for name in ("W1", "W2"))
    return Transparency(data["objective"], W1, W2)


def square(rows: Any) -> Matrix:
    """A square matrix; without rows, the storage matrix of a system without states."""
    return matrix(rows, len(rows), len(rows)) if rows else np.zeros((0, 0))


FORMAT = "manyhands-certificate"
VERSION = 3
WITH_TOLERANCE = 4
"""The version with a period tolerance greater than 0; otherwise it is like version 3."""
WITH_SERIES = 5
"""The version that counts compliance of the world in series, with or without a period tolerance."""
WITH_MECHANISM = 6
"""The version that says more of a device than its level, with or without the two others' keys."""
_LAST_READERS: Mapping[int, str] = {1: "0.1.0", 2: "0.6.0"}
"""The last release that reads each version that is read no more."""
MAX_FILE_BYTES = 256 * 2**20
_KEYS = {"id", "format", "version", "session", "period", "tau", "ports", "devices", "structure", "environment"}
_ASKED = {"coupling", "objective", "weights", "algorithm", "iterations", "order", "poles"}
_KEYS |= {"asked", "coupling", "levels", "storage", "transparency", "margins", "method"}
_EXTRA_KEYS: Mapping[int, set[str]] = {
    VERSION: set(),
    WITH_TOLERANCE: {"period_tolerance"},
    WITH_SERIES: {"period_tolerance", "series"},
    WITH_MECHANISM: {"period_tolerance", "series", "encoder", "speed"},
}


@dataclass(frozen=True, eq=False)
class TransparencyClaim:
    """The claim on the coupling's transparency, and the storage matrix that proves it.

    Attributes:
        aim: the problem, (23) or (24), with its weights.
        gamma: the weighted norm is below it; dimensionless for (24), N/m for (23).
        P: storage matrix of the bounded real lemma, in the realisation that
            :func:`manyhands.design.models.weights.weighted` builds of
            :meth:`manyhands.design.models.integrators.Split.environment`; of rational functions in their differences.
    """

    aim: Transparency
    gamma: float
    P: Matrix | InDifferences

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class Certificate:
    """A claim that a loop is stable, with its proof.

    Attributes:
        loop: the physical data, period, delay and block structure.
        coupling: the blocks of V, each a spring-damper or a linear system, in the partition's order. Where the loop
            counts a part of the world's links in series, they contain that part.
        levels: the promised levels and the storage matrices, of the loop as it is cut (:attr:`.HapticLoop.cut`).
        transparency: the claim on transparency; None if the session has no such aim.
        margins: for each condition, its distance to failure.
        method: how the coupling was found: algorithm, iterations, solver.
        asked: the request for the coupling, as plain data; it is not a claim and is not proved.
        encoder: the claim about the steps of the devices' encoders; None where no device has any.
        id: SHA-256 (hex) over the content; empty until :func:`seal`.
    """

    loop: HapticLoop
    coupling: tuple[CouplingBlock, ...]
    levels: Levels
    transparency: TransparencyClaim | None
    margins: Mapping[str, float]
    method: Mapping[str, str | int]
    asked: Mapping[str, Any]
    encoder: EncoderClaim | None = None
    id: str = ""

    @property
    def version(self) -> int:
        """The version of the file format that holds exactly this content."""
        if any(device.of_mechanism for device in self.loop.devices):
            return WITH_MECHANISM
        if self.loop.series:
            return WITH_SERIES
        return WITH_TOLERANCE if self.loop.period_tolerance else VERSION

    @property
    def tau(self) -> float:
        """Longest delay inside the tick that the proof covers, s."""
        return self.loop.tau

    @property
    def period_tolerance(self) -> float:
        """rho: the proof covers periods up to (1 + rho) T."""
        return self.loop.period_tolerance

    @cached_property
    def blocks(self) -> tuple[StateSpace, ...]:
        """The realisation of each block of V, as its process runs it."""
        return realisations(self.coupling, self.loop.period)

    @property
    def V(self) -> LinearSystem:
        """The coupling, discrete, from force (N) to the displacement between hand and tool (m), m x m.

        It does not contain what is counted of the world's links.
        """
        V = self._own
        return LinearSystem(V.A, V.B, V.C, V.D, self.loop.period)

    @property
    def E(self) -> LinearSystem:
        """The environment, discrete, from the tools' displacement (m) to the force on them (N), m x m.

        Raises:
            ValueError: the environment is declared by its level, and has no matrices.
        """
        environment = self.loop.environment
        if environment.declared_level is not None:
            raise ValueError("found an environment that is declared by its level; expected one with matrices")
        E = environment.environment(self.loop.period)
        return LinearSystem(E.A, E.B, E.C, E.D, self.loop.period)

    @property
    def stiffness(self) -> Matrix:
        """K of the coupling, m x m, N/m; of a linear coupling V(1)^-1, its stiffness for slow motions."""
        return self._springs.stiffness

    @property
    def damping(self) -> Matrix:
        """B of the coupling, m x m, N*s/m; of a linear coupling by :func:`.spring_damper_of`, for slow motions."""
        return self._springs.damping

    @cached_property
    def _springs(self) -> SpringDamper:
        springs = None if self.loop.series else self.spring_damper
        return springs or spring_damper_of(self._own, self.loop.period)

    @cached_property
    def _own(self) -> StateSpace:
        return self.loop.without_counted(self.loop.partition.join(self.blocks))

    def frequency_responses(self, omega: ArrayLike | None = None) -> FrequencyResponses:
        """E, V, and the impedance F(E, V) that the hands feel, over frequency.

        Args:
            omega: rad/s, at most pi/T; by default a grid that resolves every resonance.

        Raises:
            ValueError: the environment has no matrices, or a frequency is out of range.

        Example:
            >>> import manyhands as mh
            >>> found = mh.certify(mh.load("example1")).frequency_responses([1.0])
            >>> abs(found.V[0, 0, 0] * 1110.2).round(3)    # at 1 rad/s a spring of 1110.2 N/m
            np.float64(1.0)
        """
        from manyhands.design.frequency_responses import responses_of  # a reader of certificates needs none

        return responses_of(self.loop, StateSpace.of(self.E), self.blocks, omega)

    @classmethod
    def load(cls, path: Path | str) -> Certificate:
        """The certificate in a file. It is read only; :func:`manyhands.launch.app.api.verify` proves it.

        Raises:
            CertificateError: the file is not readable, not a certificate, or not of a known version.

        Example:
            >>> import manyhands as mh
            >>> mh.certify("example1").save("example1.cert.json")
            >>> mh.Certificate.load("example1.cert.json").loop.period
            0.001
        """
        return load(Path(path))[0]

    def save(self, path: Path | str) -> None:
        """Write the certificate's file, whole or not at all.

        Raises:
            OSError: nothing can be written there.
        """
        save(self, Path(path))

    def __repr__(self) -> str:
        loop, springs = self.loop, self.spring_damper
        unit = loop.units()
        K = "linear blocks" if springs is None else f"K = {brief(springs.stiffness)} {unit('N/m')}"
        gamma = "" if self.transparency is None else f", gamma {self.transparency.gamma:.4g}"
        margin = f"{self.margins['(10)']:.4g} {unit('N·s/m')}" if "(10)" in self.margins else "not stated"
        below = "" if loop.speed is None else f", below {loop.speed:g} {unit('m/s')}"
        return (
            f"Certificate({loop.session}: blocks {brief_names(loop.partition.names)}, {K}, T = {loop.period:g} s, "
            f"tau = {loop.tau:g} s{below}, margin {margin}{gamma}, id {self.id[:16] or 'none'})"
        )

    @cached_property
    def spring_damper(self) -> SpringDamper | None:
        """K and B of the whole coupling as it is run, m x m; None if a block is not of the spring-damper class."""
        parts = [part for part in self.coupling if isinstance(part, SpringDamper)]
        if len(parts) != len(self.coupling):
            return None
        embed = self.loop.partition.embed
        return SpringDamper(embed([p.stiffness for p in parts]), embed([p.damping for p in parts]))


def content(certificate: Certificate) -> dict[str, Any]:
    """The certificate's whole content as JSON values, without its id."""
    loop, levels = certificate.loop, certificate.levels
    ports, partition = loop.ports, loop.partition
    claim = certificate.transparency
    return {
        "format": FORMAT,
        "version": certificate.version,
        "session": loop.session,
        "period": loop.period,
        "tau": loop.tau,
        **({"period_tolerance": loop.period_tolerance} if loop.period_tolerance else {}),
        "ports": list(ports),
        "devices": {device.name: describe_device(device, ports) for device in loop.devices},
        "structure": describe_structure(ports, partition),
        "environment": loop.environment.terms(),
        **({"series": describe_series(loop)} if loop.series else {}),
        **({"speed": loop.speed} if loop.speed is not None else {}),
        **({"encoder": certificate.encoder.describe()} if certificate.encoder is not None else {}),
        "asked": dict(certificate.asked),
        "coupling": describe_coupling(partition.names, certificate.coupling),
        "levels": {
            "kappa": levels.device.kappa,
            "share": levels.device.share,
            "c": levels.device.c,
            "Delta_D": _by_block(partition, levels.Delta_D),
            "Delta_V": _by_block(partition, levels.Delta_V),
            "Phi_E": describe_level(levels.Phi_E, partition),
        },
        "storage": {
            "E_hat": describe_storage(levels.P_E),
            "V_hat": {name: P.tolist() for name, P in zip(partition.names, levels.P_V, strict=True) if P is not None},
        },
        "transparency": None
        if claim is None
        else describe_aim(claim.aim) | {"gamma": claim.gamma, "P": describe_storage(claim.P)},
        "margins": dict(certificate.margins),
        "method": dict(certificate.method),
    }


def describe_device(device: DeviceLevel, ports: Sequence[str]) -> dict[str, Any]:
    """The ports of a device, its level, and what else is stated of its mechanism."""
    out = {"ports": [ports[p] for p in device.ports], "osp": device.level.tolist()}
    if device.held is not None:
        out["held"] = device.held.describe()
    turning = None if device.turning is None else [ports[p] for p in device.turning]
    stated = {"step": device.step, "friction": device.friction, "turning": turning}
    out |= {key: list(value) for key, value in stated.items() if value is not None}
    return out if device.orientation is None else out | {"orientation": device.orientation.describe()}


def device_of(name: str, data: Mapping[str, Any], index: Mapping[str, int], mechanism: bool) -> DeviceLevel:
    """The device that :func:`describe_device` wrote.

    Raises:
        KeyError, TypeError, ValueError: a key is missing or unknown, or its value has the wrong type.
    """
    if unknown := set(data) - {"ports", "osp", *(STATED if mechanism else ())}:
        raise ValueError(f"devices.{name}: found the keys {sorted(unknown)}; expected ports and osp")
    held = held_torque_of(data["held"]) if "held" in data else None
    step, friction = (tuple(map(float, data[key])) if key in data else None for key in ("step", "friction"))
    turning = tuple(index[p] for p in data["turning"]) if "turning" in data else None
    ports = tuple(index[p] for p in data["ports"])
    orientation = orientation_of(data["orientation"], held) if "orientation" in data else None
    return DeviceLevel(name, ports, matrix(data["osp"]), held, step, friction, turning, orientation)


def describe_structure(ports: Sequence[str], partition: Partition) -> dict[str, list[str]]:
    """The ports of each block, by name."""
    return {name: [ports[p] for p in block] for name, block in zip(partition.names, partition.blocks, strict=True)}


def describe_level(Phi: Matrix, partition: Partition) -> Any:
    """A level over all ports as JSON values: by block where it joins no two blocks, otherwise as rows."""
    return _by_block(partition, partition.restrict(Phi)) if partition.admits(Phi) else Phi.tolist()


def level_of(data: Any, partition: Partition) -> Matrix:
    """The level that :func:`describe_level` wrote."""
    if isinstance(data, Mapping):
        return partition.embed(matrices_by_block(data, partition))
    return matrix(data, partition.size, partition.size)


def _by_block(partition: Partition, parts: tuple[Matrix, ...]) -> dict[str, list[list[float]]]:
    return {name: part.tolist() for name, part in zip(partition.names, parts, strict=True)}


def identity(data: Mapping[str, Any]) -> str:
    """SHA-256 (hex) over the content's canonical JSON: keys in their order, no spaces, shortest exact floats.

    The order of keys counts, because it is the order of devices, blocks and ports.
    """
    own = {key: value for key, value in data.items() if key != "id"}
    canonical = json.dumps(own, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def seal(certificate: Certificate) -> Certificate:
    """The same certificate with its id."""
    return replace(certificate, id=identity(content(certificate)))


def to_json(certificate: Certificate) -> str:
    """The file's text: the id first, each row of a matrix on its own line."""
    data = {"id": certificate.id, **content(certificate)}
    return pretty(data) + "\n"


def save(certificate: Certificate, path: Path) -> None:
    """Write the file whole or not at all."""
    with replacing(path) as file:
        file.write(to_json(certificate).encode())


def load(path: Path) -> tuple[Certificate, Mapping[str, Any]]:
    """Read a certificate. Its id is only read; the proof computes it again.

    Returns:
        The certificate, and the file's plain data, over which the id is computed.

    Raises:
        CertificateError: the file is not readable, not a certificate, or not of a known version; the message names
            file and key.
        OldCertificate: its version is read no more.
    """
    data = read_plain(path)
    return certificate_of(data, path), data


def certificate_of(data: Mapping[str, Any], path: Path) -> Certificate:
    """The certificate in the plain data of a file.

    Raises:
        CertificateError: the data are no certificate of a known version; the message names file and key.
        OldCertificate: its version is read no more.
    """
    version = data.get("version")
    if data.get("format") == FORMAT and type(version) is int and version in _LAST_READERS:
        raise OldCertificate(str(path), version, _LAST_READERS[version])
    try:
        return from_content(data)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        what = f"key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise CertificateError(f"{path}: not a certificate of a known version: {what}") from error


def read_plain(path: Path) -> Mapping[str, Any]:
    """The plain data of a certificate's file, or of a world's: nothing in them is checked except that they are JSON.

    Raises:
        CertificateError: the file is not readable, or not a JSON object; the message names the file.
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
    if not isinstance(data, dict):
        raise CertificateError(f"{path}: not a certificate of a known version: found no object")
    return data


def from_content(data: Mapping[str, Any]) -> Certificate:
    """The certificate that :func:`content` (with "id") describes.

    Raises:
        KeyError, TypeError, ValueError, AttributeError, OverflowError: a key is missing, or its value has the wrong
            type, shape or size.
    """
    form, version = data["format"], data["version"]
    if form != FORMAT or type(version) is not int or version not in _EXTRA_KEYS:
        expected = f"{FORMAT} version {VERSION} to {WITH_MECHANISM}"
        raise ValueError(f"found {form!r} {version!r}; expected {expected}")
    keys = _KEYS | _EXTRA_KEYS[version]
    if unknown := set(data) - keys:
        raise ValueError(f"found the keys {sorted(unknown)}; expected {sorted(keys)}")
    asked = data["asked"]
    if not isinstance(asked, Mapping):
        raise ValueError("expected asked to be an object")
    tolerant = version == WITH_TOLERANCE or "period_tolerance" in data
    period_tolerance = float(data["period_tolerance"]) if tolerant else 0.0
    if tolerant and not period_tolerance > 0.0:
        raise ValueError(f"period_tolerance: found {period_tolerance}; expected more than 0 in version {version}")
    if version == WITH_MECHANISM and not any(set(STATED) & set(device) for device in data["devices"].values()):
        raise ValueError(f"devices: found none with {' or '.join(STATED)}; expected one in version {version}")
    if unknown := set(asked) - _ASKED:
        raise ValueError(f"asked: found the keys {sorted(unknown)}; expected some of {sorted(_ASKED)}")
    if not isinstance(data["session"], str) or not all(isinstance(v, str | int) for v in data["method"].values()):
        raise ValueError("expected session to be a text, and every value of method a text or a whole number")
    ports = tuple(str(p) for p in data["ports"])
    index = {port: i for i, port in enumerate(ports)}
    structure, environment = data["structure"], environment_of(data["environment"], ports)
    encoder = encoder_of(data["encoder"], len(ports)) if "encoder" in data else None
    speed = float(data["speed"]) if "speed" in data else None
    loop = HapticLoop(
        session=str(data["session"]),
        period=float(data["period"]),
        ports=ports,
        devices=tuple(
            device_of(name, device, index, version == WITH_MECHANISM) for name, device in data["devices"].items()
        ),
        partition=Partition(tuple(structure), tuple(tuple(index[p] for p in block) for block in structure.values())),
        environment=environment,
        tau=float(data["tau"]),
        period_tolerance=period_tolerance,
        series=_series(data["series"], ports, environment) if version == WITH_SERIES or "series" in data else (),
        speed=speed,
        kept=None if speed is None else (encoder and encoder.force) or (0.0,) * len(ports),
    )
    partition, levels, storage = loop.partition, data["levels"], data["storage"]
    linear = data["coupling"]["class"] == "linear"
    claim = data["transparency"]
    return Certificate(
        loop=loop,
        coupling=coupling_of(data["coupling"], partition),
        levels=Levels(
            device=DeviceShare(float(levels["kappa"]), float(levels["share"]), float(levels["c"])),
            Delta_D=matrices_by_block(levels["Delta_D"], partition),
            Delta_V=matrices_by_block(levels["Delta_V"], partition),
            Phi_E=level_of(levels["Phi_E"], partition),
            P_E=storage_of(storage["E_hat"], loop.environment),
            P_V=tuple(square(storage["V_hat"][name]) if linear else None for name in partition.names),
        ),
        transparency=None
        if claim is None
        else TransparencyClaim(aim_of(claim), float(claim["gamma"]), _matrix_or_differences(claim["P"])),
        margins={str(k): float(v) for k, v in data["margins"].items()},
        method={str(k): v for k, v in data["method"].items()},
        asked=asked,
        encoder=encoder,
        id=str(data["id"]),
    )


def describe_series(loop: HapticLoop) -> dict[str, Any]:
    """What is counted in series, by port: a part of a network's link, or {"compliance": m/N} of any other world."""
    of_links = loop.environment.counts == "part"
    return {port: value if of_links else {"compliance": value} for port, value in loop.parts.items()}


def _series(data: Mapping[str, Any], ports: tuple[str, ...], environment: Environment) -> tuple[float, ...]:
    """What :func:`describe_series` wrote; a port that is not named counts nothing."""
    of_links = environment.counts == "part"
    if not of_links and any(set(value) != {"compliance"} for value in data.values()):
        raise ValueError("series: expected the one key compliance for each port")
    found = {str(port): float(value if of_links else value["compliance"]) for port, value in data.items()}
    if not set(found) <= set(ports) or not all(found.values()):
        raise ValueError(f"series: found {sorted(found)}; expected ports of the loop with a number that is not 0")
    return tuple(found.get(port, 0.0) for port in ports)


def _finite(text: str) -> float:
    """A finite number of the file; Python's JSON reader would also accept NaN, Infinity and 1e999."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"found {text[:40]}; expected finite numbers")
    return number


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object with unique keys; with a key given twice, a reader could see a value that is not checked."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError(f"found {sorted(key for key, _ in pairs)}; expected every key once")
    return found


def pretty(value: Any, indent: int = 0) -> str:
    """Plain data as JSON with each vector on one line, so that a matrix looks like a matrix."""
    pad = "  " * (indent + 1)
    if isinstance(value, Mapping) and value:
        rows = [f"{pad}{json.dumps(key)}: {pretty(item, indent + 1)}" for key, item in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + "  " * indent + "}"
    if isinstance(value, list) and any(isinstance(item, list | Mapping) for item in value):
        return "[\n" + ",\n".join(pad + pretty(item, indent + 1) for item in value) + "\n" + "  " * indent + "]"
    return json.dumps(value, allow_nan=False)


_MOST_SHOWN = 200  # characters of a value; its file may come from an untrusted person


def asked_text(asked: Mapping[str, Any]) -> str:
    """The request of a certificate, on one line."""
    return ", ".join(f"{key} {_shown(value)}" for key, value in asked.items())[: 2 * _MOST_SHOWN]


def differences(certificate: Certificate, loop: HapticLoop, wanted: CouplingRequest) -> list[str]:
    """A sentence for each difference between the certificate and this loop and request; empty if it fits."""
    own = certificate.loop
    out = [
        f"the {what} differs: the certificate has {mine}, the session {theirs}"
        for what, mine, theirs in (
            ("session's name", own.session, loop.session),
            ("period", own.period, loop.period),
            ("delay inside the tick", own.tau, loop.tau),
            ("period tolerance", own.period_tolerance, loop.period_tolerance),
            ("speed below which it holds", own.speed, loop.speed),
            ("list of ports", ", ".join(own.ports), ", ".join(loop.ports)),
        )
        if mine != theirs
    ]
    out += [
        f"the {what} differs"
        for what, mine, theirs in (
            ("block structure", own.partition, loop.partition),
            ("environment", own.environment, loop.environment),
            ("compliance of the world that is counted in series", own.series, loop.series),
            ("level or order of devices", [_level(d) for d in own.devices], [_level(d) for d in loop.devices]),
            ("way in which devices hold a force", [d.held for d in own.devices], [d.held for d in loop.devices]),
            ("kind of axes, in the ports that turn", own.turning, loop.turning),
            (
                "orientation of a device",
                [d.orientation for d in own.devices],
                [d.orientation for d in loop.devices],
            ),
            (
                "encoder steps or friction",
                [(d.step, d.friction) for d in own.devices],
                [(d.step, d.friction) for d in loop.devices],
            ),
        )
        if mine != theirs
    ]
    out += _other_wishes(certificate.asked, describe_request(wanted, loop.partition.names))
    springs = all(isinstance(part, SpringDamper) for part in certificate.coupling)
    match wanted:
        case SpringDamperGiven(given, aim):
            held = certificate.spring_damper
            if held is None or np.any(held.stiffness != given.stiffness) or np.any(held.damping != given.damping):
                out.append("the coupling is not the one that the session gives")
        case LinearGiven(blocks, aim):
            if [_system(b) for b in certificate.coupling if isinstance(b, StateSpace)] != [_system(b) for b in blocks]:
                out.append("the coupling is not the one that the session gives")
        case SpringDamperWanted(wish):
            aim = wish.aim
            if not springs:
                out.append("the coupling is not of the spring-damper class that the session wants")
        case LinearWanted(_, wish):
            aim = wish.aim
            if springs:
                out.append("the coupling is of the spring-damper class, and the session wants a linear one")
        case NoCoupling():
            aim = None
            out.append("the session wants no coupling")
    claimed: Transparency | None = None if certificate.transparency is None else certificate.transparency.aim
    if claimed != aim:
        out.append("the transparency problem differs, in its objective or its weights")
    return out


_ALWAYS_ASKED = ("coupling", "objective")
"""The keys that every request has, of whatever class of coupling."""


def _other_wishes(asked: Mapping[str, Any], wish: Mapping[str, Any]) -> list[str]:
    """A sentence for each key of ``design:`` whose value differs between the certificate and the session.

    A key that only one of the two has differs, too. If both name a class of coupling and the classes differ, keys that
    only one of the classes has are left out.
    """
    compared = dict.fromkeys((*wish, *asked))
    if asked.get("coupling", wish["coupling"]) != wish["coupling"]:
        compared = dict.fromkeys(key for key in compared if key in _ALWAYS_ASKED or (key in asked and key in wish))
    return [
        f"design.{key} differs: the certificate has {_at(asked, key)}, the session asks for {_at(wish, key)}"
        for key in compared
        if (key in asked) != (key in wish) or asked.get(key) != wish.get(key)
    ]


def _at(values: Mapping[str, Any], key: str) -> str:
    return _shown(values[key]) if key in values else "nothing"


def _shown(value: object) -> str:
    """A value as a message shows it, escaped so that it contains no control sequence of a terminal."""
    text = json.dumps(value)
    text = text[1:-1] if isinstance(value, str) else text
    return text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 3]}..."


def _level(device: DeviceLevel) -> tuple[str, tuple[int, ...], list[list[float]]]:
    return device.name, device.ports, device.level.tolist()


def _system(system: StateSpace) -> list[list[list[float]]]:
    return [M.tolist() for M in (system.A, system.B, system.C, system.D)]
