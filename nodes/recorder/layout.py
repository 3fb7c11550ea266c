"""What a recording holds: an MCAP file's channels, the layout of their messages, and the session it says it is of.

Rows of numbers are CDR, the layout of ROS 2 messages, with their definition in the file, so that any reader of such
files can read these: ``first_tick``, ``rows``, ``ports`` and ``rows * ports`` doubles, row by row. Figures are JSON.
docs/files.md tells it to people; writer and reader both start from here.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes import telemetry as names
from manyhands.protocol.messages import Role

Array = NDArray[np.float64]

FORMAT: Final = "manyhands-recording"
VERSION: Final = "1"
METADATA: Final = "session"
"""The name of the metadata record that says what was recorded."""

SAMPLE: Final = "sample"
FORCE: Final = "force"
TELEMETRY: Final = "telemetry"

TRACE_CHANNELS: Final[Mapping[Role, Mapping[str, str]]] = {
    Role.DEVICE: {names.DISPLACEMENT: SAMPLE, names.FORCE: FORCE},
    Role.COUPLING: {names.FREE_POSITION: "tool", names.FORCE: "reaction"},
}
"""By role: a trace of its telemetry to the channel whose signal it holds."""

ROWS_SCHEMA: Final = (
    "manyhands/msg/Rows",
    "ros2msg",
    "uint64 first_tick\nuint32 rows\nuint32 ports\nfloat64[] values\n",
)
FIGURES_SCHEMA: Final = (
    "manyhands/Figures",
    "jsonschema",
    json.dumps(
        {
            "type": "object",
            "properties": {
                "tick": {"type": "integer"},
                "figures": {"type": "object", "additionalProperties": {"type": ["number", "null"]}},
            },
            "required": ["tick", "figures"],
        }
    ),
)
"""Name, encoding and text of the schemas; a message of the first is encoded as ``cdr``, of the second as ``json``."""

_CDR_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"
_HEAD: Final = struct.Struct("<4sQIII4x")  # the doubles are aligned to eight, counted from behind the first four bytes


def encode_rows(first_tick: int, values: Array) -> bytes:
    """The message of ``values``, ticks x ports, whose first row is that of ``first_tick``."""
    rows, ports = values.shape
    head = _HEAD.pack(_CDR_LITTLE_ENDIAN, first_tick, rows, ports, rows * ports)
    return head + values.astype("<f8").tobytes()


def decode_rows(data: bytes) -> tuple[int, Array]:
    """The first tick and the rows of a message.

    Raises:
        ValueError: it is none.
    """
    if len(data) < _HEAD.size:
        raise ValueError(f"found {len(data)} bytes; expected at least {_HEAD.size}")
    order, first_tick, rows, ports, count = _HEAD.unpack_from(data)
    if order != _CDR_LITTLE_ENDIAN or count != rows * ports or len(data) != _HEAD.size + 8 * count:
        raise ValueError(f"found {len(data)} bytes for {rows} x {ports} values; expected little-endian CDR of as many")
    values = np.frombuffer(data, dtype="<f8", offset=_HEAD.size).astype(np.float64)
    return first_tick, values.reshape(rows, ports)


def encode_figures(tick: int, figures: Mapping[str, float]) -> bytes:
    """The message of figures up to ``tick``; JSON has no words for what is infinite or not a number: it is null."""
    finite = {name: value if math.isfinite(value) else None for name, value in figures.items()}
    return json.dumps({"tick": tick, "figures": finite}, allow_nan=False).encode()


@dataclass(frozen=True)
class Recorded:
    """What was recorded.

    Attributes:
        session: the session's name.
        certificate: id of the certificate (or of the uncertified session) it ran under.
        period: T, s.
        clock: "realtime" or "simulated".
        roles: every node's role.
        ports: the ports of each node, in the order of its traces' columns.
    """

    session: str
    certificate: str
    period: float
    clock: str
    roles: Mapping[str, Role]
    ports: Mapping[str, tuple[str, ...]]

    @property
    def devices(self) -> dict[str, tuple[str, ...]]:
        """The ports of each device, in the session's order."""
        return {name: self.ports[name] for name, role in self.roles.items() if role is Role.DEVICE}

    def as_metadata(self) -> dict[str, str]:
        """As the file has it: texts by name, structure as JSON."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "session": self.session,
            "certificate": self.certificate,
            "period": repr(self.period),
            "clock": self.clock,
            "roles": json.dumps(dict(self.roles)),
            "ports": json.dumps(dict(self.ports)),
        }

    @classmethod
    def from_metadata(cls, texts: Mapping[str, str]) -> Recorded:
        """From what a file has.

        Raises:
            ValueError: it is not a recording of this format, or makes no sense.
        """
        found = f"{texts.get('format', '')!r:.40} version {texts.get('version', '')!r:.40}"
        if (texts.get("format"), texts.get("version")) != (FORMAT, VERSION):
            raise ValueError(f"found {found}; expected {FORMAT!r} version {VERSION!r}")
        try:
            ports: dict[str, Any] = json.loads(texts["ports"])
            out = cls(
                texts["session"],
                texts["certificate"],
                float(texts["period"]),
                texts["clock"],
                {name: Role(role) for name, role in json.loads(texts["roles"]).items()},
                {name: tuple(own) for name, own in ports.items()},
            )
        except (KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(f"found metadata without {error}; expected that of a recording") from error
        every_port = [port for own in out.ports.values() for port in own]
        if not (0.0 < out.period < math.inf and out.roles.keys() == out.ports.keys() and out.devices):
            raise ValueError("found metadata without a period, or without the ports of every node; expected both")
        if any(type(port) is not str for port in every_port):
            raise ValueError("found a port that is no text in the metadata; expected names")
        return out
