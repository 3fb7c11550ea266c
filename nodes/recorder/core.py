"""What a recorder makes of what it is told: the bytes of an MCAP file, in the order in which they are to be written.

Without any I/O: observations go in, and what the file still lacks comes out in pieces that end at a chunk's border.
A chunk has a checksum and stands alone, so a file that ends anywhere is readable up to its last whole chunk. What
belongs to one observation is always in one chunk.
"""

from __future__ import annotations

import io
import json
from typing import Final

from mcap.writer import CompressionType, Writer

from manyhands.nodes.recorder.layout import (
    FIGURES_SCHEMA,
    METADATA,
    ROWS_SCHEMA,
    TELEMETRY,
    TRACE_CHANNELS,
    Array,
    Recorded,
    encode_figures,
    encode_rows,
)
from manyhands.protocol.channels import CHANNELS, channel_name
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Observation, Role, Stop

CHUNK_BYTES: Final = 1024 * 1024
"""After so many bytes a chunk is closed, however young it is."""

_NEVER: Final = 2**62  # of the writer's own rule when to close a chunk: it could fall between x and f_v of a device
_SEQUENCE: Final = 2**32  # an MCAP sequence number has 32 bits


class _Tape(io.BytesIO):
    """What was written and not yet taken away; positions are those in the file."""

    def __init__(self) -> None:
        super().__init__()
        self._taken = 0

    def tell(self) -> int:
        return self._taken + super().tell()

    def take(self) -> bytes:
        out = self.getvalue()
        self._taken += len(out)
        self.seek(0)
        self.truncate()
        return out


class RecorderCore:
    """Turns observations into a file.

    Attributes:
        over: becomes true when the session has said that nothing more will come.
        tick: the latest tick of any device that was taken.
        missing: ticks that were never told, by device; its observations were lost on the way.
        refused: frames that were no observation, or of nobody's, or did not fit its node's ports and ticks.
    """

    def __init__(self, recorded: Recorded) -> None:
        """Begin the file of what ``recorded`` says."""
        self._recorded = recorded
        self._tape = _Tape()
        self._writer = Writer(self._tape, chunk_size=_NEVER, compression=CompressionType.NONE)
        self._writer.start(profile="", library="manyhands")
        self._writer.add_metadata(METADATA, recorded.as_metadata())
        self._channels = self._register()
        self._next = dict.fromkeys(recorded.devices, 0)
        self._waiting = 0
        self.over = False
        self.tick = 0
        self.missing = dict.fromkeys(recorded.devices, 0)
        self.refused = 0

    def _register(self) -> dict[tuple[str, str], int]:
        """Say what the channels are; returns their numbers by node and trace, and by node and ``telemetry``."""
        rows, figures = (
            self._writer.register_schema(name, encoding, text.encode())
            for name, encoding, text in (ROWS_SCHEMA, FIGURES_SCHEMA)
        )
        out: dict[tuple[str, str], int] = {}
        for node, role in self._recorded.roles.items():
            told = {"node": node, "role": role.value}
            for trace, name in TRACE_CHANNELS.get(role, {}).items():
                channel = CHANNELS[name]
                about = {
                    "symbol": channel.symbol,
                    "unit": channel.unit,
                    "ports": json.dumps(self._recorded.ports[node]),
                }
                full = channel_name(self._recorded.session, node, name)
                out[node, trace] = self._writer.register_channel(full, "cdr", rows, {**told, **about})
            full = channel_name(self._recorded.session, node, TELEMETRY)
            out[node, TELEMETRY] = self._writer.register_channel(full, "json", figures, told)
        return out

    def take(self, frame: bytes, time: int) -> None:
        """Take in a frame that arrived at ``time``, ns since 1970. What makes no sense is counted."""
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Stop):
            self.over = True
        elif isinstance(message, Observation) and self._fits(message):
            self._write(message, time)
        else:
            self.refused += 1

    def _fits(self, told: Observation) -> bool:
        role = self._recorded.roles.get(told.node)
        if role is None:
            return False
        width, rows = len(self._recorded.ports[told.node]), {trace.shape[0] for trace in told.traces.values()}
        fitting = all(trace.shape[1] == width for trace in told.traces.values())
        known = told.traces.keys() <= TRACE_CHANNELS.get(role, {}).keys()
        if not (fitting and known and len(rows) <= 1 and max(rows, default=0) <= told.tick):
            return False
        return role is not Role.DEVICE or told.tick - max(rows, default=0) >= self._next[told.node]

    def _write(self, told: Observation, time: int) -> None:
        sequence = told.tick % _SEQUENCE
        for trace, values in told.traces.items():
            if values.size:
                data = encode_rows(told.tick - values.shape[0], values)
                self._add(self._channels[told.node, trace], time, data, sequence)
        if told.figures:
            data = encode_figures(told.tick, told.figures)
            self._add(self._channels[told.node, TELEMETRY], time, data, sequence)
        if told.node in self._next and told.traces:
            self._count(told.node, told.tick, next(iter(told.traces.values())))

    def _add(self, channel: int, time: int, data: bytes, sequence: int) -> None:
        self._writer.add_message(channel, time, data, time, sequence)
        self._waiting += len(data)

    def _count(self, device: str, tick: int, values: Array) -> None:
        self.missing[device] += tick - values.shape[0] - self._next[device]
        self._next[device] = tick
        self.tick = max(self.tick, tick)

    @property
    def full(self) -> bool:
        """Whether the chunk should be closed now, however young it is."""
        return self._waiting >= CHUNK_BYTES

    def cut(self) -> bytes:
        """Close the chunk; returns what the file lacks so far, nothing if that is nothing."""
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap annotates arguments alone
        self._waiting = 0
        return self._tape.take()

    def end(self) -> bytes:
        """Close the file; returns its rest, with the index that viewers look for at the end."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        return self._tape.take()
