"""What a node is given to start with: its own part of the session and nothing of the others'.

A bundle is one JSON file, written by the launcher from the session and its certificate, readable by its
node alone. A device's holds no block of V, a coupling's only its own, the environment's none: D_V reaches it at the
handshake, and its bundle has the D_V of the ladder's further rungs.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from manyhands.design.files import open_new, read_regular
from manyhands.design.statespace import Matrix, StateSpace
from manyhands.nodes.bundle_parts import (
    MOST_RUNGS,
    Common,
    CouplingRung,
    DeviceRung,
    Limits,
    Peer,
    require_rungs,
)
from manyhands.nodes.bundle_sources import BrowserHand, RecordedMotion, SimulatedHand, Source, plain_source, source_from
from manyhands.nodes.bundle_values import array, floats, plain, system
from manyhands.nodes.environment.energy import Budget
from manyhands.nodes.environment.model import ModelName
from manyhands.protocol.messages import Role

__all__ = [
    "CLOCKS",
    "MAX_FILE_BYTES",
    "MAX_TELEMETRY_TICKS",
    "REALTIME",
    "SIMULATED",
    "BrowserHand",
    "Bundle",
    "BundleError",
    "Common",
    "CouplingBundle",
    "CouplingRung",
    "DeviceBundle",
    "DeviceRung",
    "EnvironmentBundle",
    "Limits",
    "ObserverBundle",
    "Peer",
    "RecordedMotion",
    "SimulatedHand",
    "Source",
    "encoded",
    "load",
    "role_of",
    "save",
]

MAX_FILE_BYTES = 256 * 2**20

SIMULATED = "simulated"
REALTIME = "realtime"
CLOCKS = (REALTIME, SIMULATED)

MAX_TELEMETRY_TICKS = 1000
"""Most ticks between two telemetry messages: a node keeps the traces of as many."""


class BundleError(Exception):
    """A bundle cannot be read; names the file and what is wrong."""


@dataclass(frozen=True, eq=False)
class DeviceBundle:
    """A device's part.

    Attributes:
        common: what every node needs; its tau is that of rung 0.
        level: of its G_hat, N*s/m.
        K: K_i, m/N.
        source: what moves it.
        limits: its own.
        longer: what it promises at rungs 1, 2, ... of the ladder, for longer delays.
    """

    common: Common
    level: Matrix
    K: Matrix
    source: Source
    limits: Limits
    longer: tuple[DeviceRung, ...] = ()

    def __post_init__(self) -> None:
        if self.level is None:
            raise ValueError("found no level; expected that of the device")
        if self.source.axes != len(self.common.ports):
            raise ValueError(
                f"found a source of {self.source.axes} axes; expected {len(self.common.ports)}, one a port"
            )
        require_rungs(self.rungs)
        taus = [rung.tau for rung in self.rungs]
        if any(not a < b for a, b in pairwise(taus)):
            raise ValueError(f"found rungs for delays of {taus} s; expected them to grow")

    @property
    def rungs(self) -> tuple[DeviceRung, ...]:
        """What it promises at each rung; rung 0 is that of the session's certificate."""
        return (DeviceRung(self.common.tau, self.level, self.K), *self.longer)


@dataclass(frozen=True, eq=False)
class CouplingBundle:
    """A coupling block's part.

    Attributes:
        common: what every node needs.
        block: V_i.
        K: K_i, m/N.
        level: Delta_V,i, N*s/m; None for an uncertified session.
        limits: its devices'.
        softer: the block at rungs 1, 2, ... of the ladder.
    """

    common: Common
    block: StateSpace
    K: Matrix
    level: Matrix | None
    limits: Limits
    softer: tuple[CouplingRung, ...] = ()

    def __post_init__(self) -> None:
        require_rungs(self.rungs)

    @property
    def rungs(self) -> tuple[CouplingRung, ...]:
        """The block at each rung; rung 0 is that of the session's certificate."""
        return (CouplingRung(self.block, self.K, self.level), *self.softer)


@dataclass(frozen=True, eq=False)
class EnvironmentBundle:
    """The environment's part: E, Phi_E (N*s/m) unless uncertified, and by what it knows its couplings.

    Attributes:
        common: what every node needs.
        E: the environment; None for a model.
        Phi_E: its level.
        tool_magnitude: the greatest |p| that honest devices and couplings can send, by port, m; None: no bound.
        tool_step: the greatest |p(k) - p(k-1)|, likewise.
        feedthrough: by coupling, the digest of the D_V that it must say
            (:func:`manyhands.nodes.feedthrough.feedthrough_digest`).
        feedthrough_rungs: by coupling, its D_V (m/N) at rungs 1, 2, ... of the ladder; the same number for each.
        independent: whether each coupling may change its rung by itself; otherwise all change in one tick.
        enforce: whether a controller keeps Phi_E.
        model: the model in place of E.
        masses: whose positions are entries of E's state, from the m-th on; none where E is no network.
        longest_tau: the longest delay that the session can cover, s: that of the ladder's last rung where a breach
            softens couplings, else the certificate's; 0 where none is covered.
        budgets: what each coupling may put into the others, in the order of the peers.
        storage: P with the energy 1/2 eta^T P eta, J, that E stores in the state eta; None where it is not known.

    Raises:
        ValueError: not one of E and a model, or a ladder that is none. A model that has promised a level is not run
            without its controller: the certificate rests on it.
    """

    common: Common
    E: StateSpace | None
    Phi_E: Matrix | None
    tool_magnitude: tuple[float | None, ...]
    tool_step: tuple[float | None, ...]
    feedthrough: Mapping[str, str]
    feedthrough_rungs: Mapping[str, tuple[Matrix, ...]] = field(default_factory=dict)
    independent: bool = True
    enforce: bool = False
    model: ModelName | None = None
    masses: tuple[str, ...] = ()
    longest_tau: float = 0.0
    budgets: tuple[Budget, ...] = ()
    storage: Matrix | None = None

    def __post_init__(self) -> None:
        if (self.E is None) == (self.model is None):
            raise ValueError("found both or neither of an environment's matrices and its model; expected one of them")
        if self.enforce != (self.Phi_E is not None) and (self.enforce or self.model is not None):
            raise ValueError(
                f"found enforce {self.enforce} {'with' if self.Phi_E is not None else 'without'} a level; expected a "
                "model's level to be enforced, and a level wherever one is"
            )
        if len(self.budgets) != len(self.feedthrough):
            raise ValueError(f"found {len(self.budgets)} budgets; expected {len(self.feedthrough)}, one a coupling")
        if self.storage is not None and (self.E is None or self.storage.shape != self.E.A.shape):
            raise ValueError(f"found a storage of shape {self.storage.shape}; expected that of E's matrix A")
        numbers = {len(matrices) for matrices in self.feedthrough_rungs.values()}
        if not self.feedthrough_rungs:
            return
        if len(numbers) != 1 or self.feedthrough_rungs.keys() != self.feedthrough.keys():
            raise ValueError("found a ladder for some couplings; expected the same rungs for each of them")
        if max(numbers) > MOST_RUNGS:
            raise ValueError(f"found {1 + max(numbers)} rungs; expected at most {1 + MOST_RUNGS}")


@dataclass(frozen=True, eq=False)
class ObserverBundle:
    """An observer's part: who it is, and nothing of the session itself."""

    common: Common


Bundle = DeviceBundle | CouplingBundle | EnvironmentBundle | ObserverBundle
_B = TypeVar("_B", DeviceBundle, CouplingBundle, EnvironmentBundle, ObserverBundle)


def save(bundle: Bundle, path: Path) -> None:
    """Write a bundle as a new file, for its owner's eyes only (mode 0600).

    Raises:
        OSError: there is something of that name, or it cannot be written.
    """
    with open_new(path, mode=0o600) as file:
        file.write(encoded(bundle))


def encoded(bundle: Bundle) -> bytes:
    """What is in a bundle's file."""
    fields = {field.name: getattr(bundle, field.name) for field in dataclasses.fields(bundle)}
    written = {name: plain_source(value) if name == "source" else plain(value) for name, value in fields.items()}
    return json.dumps(written, allow_nan=False).encode()


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
        data = json.loads(read_regular(path, MAX_FILE_BYTES))
        return kind(**{field.name: _READ[field.name](data[field.name]) for field in dataclasses.fields(kind)})
    except OSError as error:
        raise BundleError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        # not its repr, which may quote the whole file
        raise BundleError(f"{path}: not a bundle for a {kind.__name__}: {type(error).__name__}: {error}") from error


def _optional_array(data: Any) -> Matrix | None:
    return None if data is None else array(data)


def _common(data: Any) -> Common:
    peers = tuple(Peer(p["name"], Role(p["role"]), tuple(p["ports"]), p["binds"], p["address"]) for p in data["peers"])
    common = Common(**{**data, "role": Role(data["role"]), "ports": tuple(data["ports"]), "peers": peers})
    for name, fits in _FITS.items():
        if not fits(getattr(common, name)):
            raise ValueError(f"found {getattr(common, name)!r:.40} as {name}; expected it as manyhands writes it")
    return common


def _limits(data: Any) -> Limits:
    return Limits(**{name: floats(data[name]) for name in data})


def _bounds(data: Any) -> tuple[float | None, ...]:
    return tuple(None if bound is None else float(bound) for bound in data)


def _flag(data: Any) -> bool:
    if type(data) is not bool:
        raise ValueError(f"found {data!r:.40} as enforce; expected true or false")
    return data


def _tau(data: Any) -> float:
    if not _is_time(data):
        raise ValueError(f"found {data!r:.40} as a tau; expected a number of seconds")
    return float(data)


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
    "telemetry_first": lambda ticks: type(ticks) is int and 0 < ticks <= MAX_TELEMETRY_TICKS,
}
"""Of what type a node takes these to be, without looking again."""

_READ: dict[str, Any] = {
    "common": _common,
    "level": _optional_array,
    "source": source_from,
    "block": system,
    "K": array,
    "E": lambda data: None if data is None else system(data),
    "Phi_E": _optional_array,
    "enforce": _flag,
    "independent": _flag,
    "model": lambda data: None if data is None else ModelName(data["factory"], dict(data["parameters"])),
    "masses": lambda data: tuple(str(name) for name in data),
    "longest_tau": _tau,
    "budgets": lambda all_: tuple(Budget(float(b["power"]), float(b["energy"]), float(b["store"])) for b in all_),
    "storage": _optional_array,
    "limits": _limits,
    "tool_magnitude": _bounds,
    "tool_step": _bounds,
    "feedthrough": dict,
    "longer": lambda rungs: tuple(DeviceRung(_tau(r["tau"]), array(r["level"]), array(r["K"])) for r in rungs),
    "softer": lambda rungs: tuple(CouplingRung(system(r["block"]), array(r["K"]), array(r["level"])) for r in rungs),
    "feedthrough_rungs": lambda all_: {name: tuple(array(D) for D in rungs) for name, rungs in all_.items()},
}
