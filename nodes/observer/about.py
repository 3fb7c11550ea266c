"""What a running session says of itself to whoever may enter its directory: who takes part, in what world, how surely.

One JSON file, written by the supervisor before its nodes are started. What changes while the session runs comes from
its gallery (:mod:`manyhands.protocol.transport.gallery`); what is here does not change. It holds no key and no block of
V.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from manyhands.design.files import read_regular, replacing
from manyhands.protocol.messages import Role

ABOUT: Final = "about.json"
"""The file's name in the session's directory."""

MAX_ABOUT_BYTES: Final = 16 * 2**20

_LATEST: Final = 2.5e11  # the end of the year 9891: what calendars can show


class AboutError(Exception):
    """A session's description cannot be read; names the file and what is wrong."""


@dataclass(frozen=True)
class NodeAbout:
    """A node: its role, its ports in the order of its traces, and the node whose process it shares, if it does."""

    role: Role
    ports: tuple[str, ...]
    process: str | None = None


@dataclass(frozen=True)
class LinkAbout:
    """A link: its two ends, the one nearer to a hand first, and its ports."""

    ends: tuple[str, str]
    ports: tuple[str, ...]


@dataclass(frozen=True)
class SpringAbout:
    """A spring and a damper of the virtual world, between two ports, masses or the ground: N/m and N*s/m."""

    ends: tuple[str, str]
    stiffness: float
    damping: float


@dataclass(frozen=True)
class CertificateAbout:
    """What the session's certificate says: delay that it covers (s), margins by condition, levels, rungs of its ladder.

    Attributes:
        tau: longest delay inside the tick, s.
        margins: by condition, N*s/m.
        gamma: proved level of the transparency objective, or None.
        delta_D: the least eigenvalue of each device's level, N*s/m.
        ladder: delays that further rungs cover, s.
        enforced: parties whose promise a controller keeps at run time, and no proof.
    """

    tau: float
    margins: Mapping[str, float]
    gamma: float | None
    delta_D: Mapping[str, float]
    ladder: tuple[float, ...]
    enforced: tuple[str, ...]


@dataclass(frozen=True)
class About:
    """A session, as it was started.

    Attributes:
        session: its name.
        id: id of its certificate, or of the uncertified session.
        pid: its supervisor's process id.
        clock: "realtime" or "simulated".
        transport: "ipc" or "tcp".
        period: T, s.
        ticks: how many it runs; 0 for no end.
        started: seconds since 1970.
        nodes: by name, devices first, then couplings, then the environment.
        links: in the session's order.
        masses: of the virtual world, kg by name; empty where it is no network.
        springs: of the virtual world; likewise.
        grips: devices that a person's browser can hold.
        reach: of each port's device, the greatest displacement, m.
        certificate: None for a session that nothing proves.
        environment: the environment's type.
        observers: by name what each may read, as in the session.
    """

    session: str
    id: str
    pid: int
    clock: str
    transport: str
    period: float
    ticks: int
    started: float
    nodes: Mapping[str, NodeAbout]
    links: tuple[LinkAbout, ...]
    masses: Mapping[str, float]
    springs: tuple[SpringAbout, ...]
    grips: tuple[str, ...]
    reach: Mapping[str, float]
    certificate: CertificateAbout | None
    environment: str
    observers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def as_plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return dataclasses.asdict(self)

    def save(self, directory: Path) -> None:
        """Write it into the session's directory, for its user alone (mode 0600), whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        with replacing(directory / ABOUT, mode=0o600) as file:
            file.write(json.dumps(self.as_plain(), allow_nan=False).encode())

    @classmethod
    def load(cls, directory: Path) -> About:
        """Read it from a session's directory.

        Raises:
            AboutError: not readable, or no such description.
        """
        path = directory / ABOUT
        try:
            return _about(json.loads(read_regular(path, MAX_ABOUT_BYTES)))
        except OSError as error:
            raise AboutError(f"{path}: cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise AboutError(
                f"{path}: found no session's description ({type(error).__name__}); expected one of this version"
            ) from error


_SCALARS: Final[Mapping[str, type | tuple[type, ...]]] = {
    "session": str,
    "id": str,
    "pid": int,
    "clock": str,
    "transport": str,
    "period": (int, float),
    "ticks": int,
    "started": (int, float),
    "environment": str,
}
"""What is neither a list nor a map, and of what type it is."""


def _about(data: Any) -> About:
    certificate = data["certificate"]
    nodes = {
        _text(name): NodeAbout(Role(node["role"]), _texts(node["ports"]), _known(node["process"], data["nodes"]))
        for name, node in data["nodes"].items()
    }
    about = About(
        **{
            **data,
            "nodes": nodes,
            "links": tuple(LinkAbout(_two(link["ends"]), _texts(link["ports"])) for link in data["links"]),
            "masses": _numbers(data["masses"]),
            "springs": tuple(
                SpringAbout(_two(spring["ends"]), _number(spring["stiffness"]), _number(spring["damping"]))
                for spring in data["springs"]
            ),
            "grips": _texts(data["grips"]),
            "reach": _numbers(data["reach"]),
            "certificate": None if certificate is None else _certificate(certificate),
            "observers": {_text(name): _texts(reads) for name, reads in data["observers"].items()},
        }
    )
    for name, kind in _SCALARS.items():
        if not isinstance(data[name], kind) or isinstance(data[name], bool):
            raise TypeError(f"{name}: found {data[name]!r}")
    if not (0.0 < about.period < math.inf and 0 <= about.started < _LATEST and about.pid > 0 and about.ticks >= 0):
        raise ValueError("found a period, an instant, a process id or a number of ticks that there cannot be")
    for link in about.links:
        for name in link.ends:
            _known(name, nodes)
    return about


def _certificate(data: Any) -> CertificateAbout:
    gamma = data["gamma"]
    return CertificateAbout(
        **{
            **data,
            "tau": _number(data["tau"]),
            "margins": _numbers(data["margins"]),
            "gamma": None if gamma is None else _number(gamma),
            "delta_D": _numbers(data["delta_D"]),
            "ladder": tuple(map(_number, data["ladder"])),
            "enforced": _texts(data["enforced"]),
        }
    )


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"found {value!r}; expected a text")
    return value


def _texts(values: Any) -> tuple[str, ...]:
    if not isinstance(values, list):
        raise TypeError(f"found {values!r}; expected a list")
    return tuple(map(_text, values))


def _number(value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise TypeError(f"found {value!r}; expected a number")
    return value


def _numbers(values: Any) -> dict[str, float]:
    return {_text(name): _number(value) for name, value in values.items()}


def _known(name: Any, nodes: Mapping[str, Any]) -> Any:
    """A node's name, or None, which is nobody's."""
    if name is not None and name not in nodes:
        raise ValueError(f"found {name!r}; expected a node")
    return name


def _two(ends: Any) -> tuple[str, str]:
    first, second = _texts(ends)
    return first, second
