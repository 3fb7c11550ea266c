"""What a node is given to start with: its own part of the session and nothing of the others'.

A bundle is one JSON file, written by the launcher from the session and its certificate, readable by its
node alone. A device's holds no block of V, a coupling's only its own, the environment's no coupling at all:
D_V reaches it at the handshake.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from manyhands.design.statespace import Matrix, StateSpace, matrix
from manyhands.protocol.messages import Role

MAX_FILE_BYTES = 256 * 2**20

SIMULATED = "simulated"
REALTIME = "realtime"
CLOCKS = (REALTIME, SIMULATED)


MAX_TELEMETRY_TICKS = 1000
"""Most ticks between two telemetry messages: a node keeps the traces of as many."""


class BundleError(Exception):
    """A bundle cannot be read; names the file and what is wrong."""


@dataclass(frozen=True)
class Peer:
    """A node at the other end of one of this node's links.

    Attributes:
        name: the peer's name.
        role: what it is.
        ports: the ports that the link carries, in order.
        binds: whether *this* node binds the link's endpoint.
        address: where it binds it (tcp), host:port; empty for any port of the loopback.
    """

    name: str
    role: Role
    ports: tuple[str, ...]
    binds: bool
    address: str = ""


@dataclass(frozen=True)
class Common:
    """What every node needs to find and recognise the others.

    Attributes:
        session: the session's name.
        name: the node's name.
        role: the node's role.
        certificate: id of the certificate (or of the uncertified session) that all nodes must share.
        period: T, s.
        tau: delay that the certificate assumes, s.
        clock: :data:`REALTIME` or :data:`SIMULATED`.
        transport: "ipc" or "tcp".
        public: the public keys of this node, its peers and the supervisor; empty for a session without keys.
        private: the file of this node's private key; empty for a session without keys, or where the user names it.
        directory: the session's directory, mode 0700; empty for a node on another machine.
        control: endpoint of the supervisor's hub.
        ports: the node's ports, in order.
        peers: its links.
        telemetry_ticks: ticks between two telemetry messages.
        traces: whether a device's telemetry carries every x and f_v.
    """

    session: str
    name: str
    role: Role
    certificate: str
    period: float
    tau: float
    clock: str
    transport: str
    public: Mapping[str, str]
    private: str
    directory: str
    control: str
    ports: tuple[str, ...]
    peers: tuple[Peer, ...]
    telemetry_ticks: int
    traces: bool


@dataclass(frozen=True, eq=False)
class SimulatedHand:
    """The physics of a simulated device and its hand, one entry an axis.

    Attributes:
        mass: kg, device and hand together.
        damping: the device's, N*s/m.
        operator: H in continuous time.
        hand_damping: N*s/m.
        hand_stiffness: N/m.
        force: intended force (N): a number, a formula in t, or {"times", "values"}.
        motion: intended motion (m), likewise.
    """

    mass: tuple[float, ...]
    damping: tuple[float, ...]
    operator: StateSpace
    hand_damping: tuple[float, ...]
    hand_stiffness: tuple[float, ...]
    force: tuple[Any, ...]
    motion: tuple[Any, ...]


@dataclass(frozen=True)
class Limits:
    """What the devices at a node's ports may exert and reach, either way; one entry for each port of the node.

    Attributes:
        force: N.
        displacement: m.
        speed: m/s.

    Raises:
        ValueError: a limit is not a finite number greater than 0.
    """

    force: tuple[float, ...]
    displacement: tuple[float, ...]
    speed: tuple[float, ...]

    def __post_init__(self) -> None:
        for limit in (*self.force, *self.displacement, *self.speed):
            if not 0.0 < limit < math.inf:
                raise ValueError(f"found the limit {limit}; expected a finite number greater than 0")


@dataclass(frozen=True, eq=False)
class DeviceBundle:
    """A device's part: the level of its G_hat (N*s/m), its K_i (m/N), its simulated hand and its limits."""

    common: Common
    level: Matrix
    K: Matrix
    hand: SimulatedHand
    limits: Limits

    def __post_init__(self) -> None:
        if self.level is None:
            raise ValueError("found no level; expected that of the device")


@dataclass(frozen=True, eq=False)
class CouplingBundle:
    """A coupling block's part: V_i, K_i (m/N), Delta_V,i (N*s/m) unless uncertified, and its devices' limits."""

    common: Common
    block: StateSpace
    K: Matrix
    level: Matrix | None
    limits: Limits


@dataclass(frozen=True, eq=False)
class EnvironmentBundle:
    """The environment's part: E, Phi_E (N*s/m) unless uncertified, and by what it knows its couplings.

    Attributes:
        common: what every node needs.
        E: the environment.
        Phi_E: its level.
        tool_magnitude: the greatest |p| that honest devices and couplings can send, by port, m; None: no bound.
        tool_step: the greatest |p(k) - p(k-1)|, likewise.
        feedthrough: by coupling, the digest of the D_V that it must say
            (:func:`manyhands.nodes.feedthrough.feedthrough_digest`).
    """

    common: Common
    E: StateSpace
    Phi_E: Matrix | None
    tool_magnitude: tuple[float | None, ...]
    tool_step: tuple[float | None, ...]
    feedthrough: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class ObserverBundle:
    """An observer's part: who it is, and nothing of the session itself."""

    common: Common


Bundle = DeviceBundle | CouplingBundle | EnvironmentBundle | ObserverBundle
_B = TypeVar("_B", DeviceBundle, CouplingBundle, EnvironmentBundle, ObserverBundle)


def save(bundle: Bundle, path: Path) -> None:
    """Write a bundle for its owner's eyes only (mode 0600)."""
    path.touch(mode=0o600, exist_ok=False)
    path.write_text(json.dumps(_plain(bundle), allow_nan=False))


def role_of(path: Path) -> Role:
    """What the node of a bundle is.

    Raises:
        BundleError: as :func:`load`.
    """
    return load(path, ObserverBundle).common.role


def load(path: Path, kind: type[_B]) -> _B:
    """Read a bundle of the wanted kind.

    Raises:
        BundleError: not readable, or not such a bundle.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise BundleError(f"{path}: larger than {MAX_FILE_BYTES} bytes")
        data = json.loads(path.read_text())
        return kind(**{field.name: _READ[field.name](data[field.name]) for field in dataclasses.fields(kind)})
    except OSError as error:
        raise BundleError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        # not its repr, which may quote the whole file
        raise BundleError(f"{path}: not a bundle for a {kind.__name__}: {type(error).__name__}: {error}") from error


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return {"shape": value.shape, "entries": value.ravel().tolist()}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return value


def _array(data: Any) -> Matrix:
    return matrix(np.array(data["entries"], dtype=np.float64).reshape(data["shape"]))


def _optional_array(data: Any) -> Matrix | None:
    return None if data is None else _array(data)


def _system(data: Any) -> StateSpace:
    return StateSpace(*(_array(data[name]) for name in "ABCD"))


def _common(data: Any) -> Common:
    peers = tuple(Peer(p["name"], Role(p["role"]), tuple(p["ports"]), p["binds"], p["address"]) for p in data["peers"])
    common = Common(**{**data, "role": Role(data["role"]), "ports": tuple(data["ports"]), "peers": peers})
    for name, fits in _FITS.items():
        if not fits(getattr(common, name)):
            raise ValueError(f"found {getattr(common, name)!r:.40} as {name}; expected it as manyhands writes it")
    return common


def _hand(data: Any) -> SimulatedHand:
    vectors = {name: _floats(data[name]) for name in ("mass", "damping", "hand_damping", "hand_stiffness")}
    intentions = {name: tuple(data[name]) for name in ("force", "motion")}
    return SimulatedHand(operator=_system(data["operator"]), **vectors, **intentions)


def _limits(data: Any) -> Limits:
    return Limits(**{name: _floats(data[name]) for name in data})


def _floats(data: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in data)


def _bounds(data: Any) -> tuple[float | None, ...]:
    return tuple(None if bound is None else float(bound) for bound in data)


def _is_time(value: Any) -> bool:
    return type(value) in (float, int) and 0.0 <= value < 1e9


def _are_texts(values: Any) -> bool:
    return all(type(value) is str for value in values)


_FITS: dict[str, Callable[[Any], bool]] = {
    **dict.fromkeys(
        ("session", "name", "certificate", "private", "directory", "control"), lambda text: _are_texts([text])
    ),
    "period": lambda period: _is_time(period) and period > 0.0,
    "tau": _is_time,
    "clock": lambda clock: clock in CLOCKS,
    "public": lambda keys: type(keys) is dict and _are_texts(keys.values()),
    "ports": _are_texts,
    "peers": lambda peers: all(_are_texts((p.name, p.address, *p.ports)) and type(p.binds) is bool for p in peers),
    "telemetry_ticks": lambda ticks: type(ticks) is int and 0 < ticks <= MAX_TELEMETRY_TICKS,
    "traces": lambda traces: type(traces) is bool,
}
"""Of what type a node takes these to be, without looking again."""

_READ: dict[str, Any] = {
    "common": _common,
    "level": _optional_array,
    "hand": _hand,
    "block": _system,
    "K": _array,
    "E": _system,
    "Phi_E": _optional_array,
    "limits": _limits,
    "tool_magnitude": _bounds,
    "tool_step": _bounds,
    "feedthrough": dict,
}
