"""Any bytes as a frame: the codec returns, and what it takes for a message means the same when it is sent again.

Data that begins with the one byte that MessagePack never uses decides, besides, what is forged from there on.
"""

from __future__ import annotations

import dataclasses
import math
import resource
from collections.abc import Mapping
from typing import Final

import numpy as np
from draws import Draws
from forger import Forger

from manyhands.protocol.codec import Flaw, ForeignHello, Malformed, Received, decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Connect,
    Fault,
    Figures,
    LinkHello,
    Message,
    NodeHello,
    Refusal,
    Report,
    Role,
    Start,
    Telemetry,
    Tool,
    is_presentable,
)

FORGED: Final = b"\xc1"
MOST_FRAMES: Final = 8

RESIDENT_PER_BYTE: Final = 200
"""How much the process may grow for one byte of a frame, bytes. An empty map is one byte, and 72 in Python."""

RESIDENT_FIXED: Final = 32 * 1024 * 1024
"""The same whatever the frame's length, bytes: MessagePack's reader gives memory to a map of 2048 entries when it is
announced, 16 KiB, and up to 1024 may be announced inside each other. The allocator rounds up."""

MESSAGES: Final[dict[str, Message]] = {
    type(message).__name__: message
    for message in (
        LinkHello(PROTOCOL_VERSION, "c0ffee", "s", "cx", Role.COUPLING, ("dx", "dy"), ((0.5, 0.0), (0.0, 0.25))),
        NodeHello(PROTOCOL_VERSION, "c0ffee", "s", "dx", Role.DEVICE, 1234, {"cx": "ipc:///s/dx"}),
        Refusal("certificate", "no"),
        Connect({"dx": "ipc:///s/dx"}),
        Start(10**9, 10**4),
        Tool(1, 2, np.array([1.0, -2.0])),
        Telemetry(10, Figures({"speed": 0.5}), {"x": np.array([[1.0], [2.0]])}),
        Report(10, Figures({"peak": 0.5, "late": 2}, {"tau_us": {"p50": 128.0}})),
        Fault("boom"),
    )
}
"""What is changed here and there; messages of every kind are made from nothing."""

_GROWTH: Final = 2.0  # encoding again makes float 64 (9 bytes) of float 32 (5 bytes)
_HEAD: Final = 64  # and a head of fixed layout of a signal's short integers


def check(data: bytes) -> None:
    """Decode ``data``, and what it decides; raise if the codec breaks one of its promises."""
    _check_frame(data)
    if data.startswith(FORGED):
        play(Draws(data[len(FORGED) :]))


def play(draws: Draws) -> None:
    """Decode the frames that are decided upon."""
    forger = Forger(draws, MESSAGES)
    for _ in range(MOST_FRAMES):
        if not draws.more:
            return
        _check_frame(forger.frame())


def _check_frame(frame: bytes) -> None:
    before = _peak()
    received = decode(frame, MAX_CONTROL_BYTES)
    grown = _peak() - before
    if grown > RESIDENT_PER_BYTE * len(frame) + RESIDENT_FIXED:
        raise AssertionError(f"a frame of {len(frame)} bytes made the process grow by {grown} bytes")
    _check_received(frame, received)
    for limit in (64 * 1024, len(frame) - 1):
        if len(frame) > limit:
            beyond = decode(frame, limit)
            assert isinstance(beyond, Malformed), f"{len(frame)} bytes passed a limit of {limit}"
            assert beyond.flaw is Flaw.SIZE, beyond.reason


def _check_received(frame: bytes, received: Received) -> None:
    if isinstance(received, Malformed):
        assert received.flaw in Flaw, f"{received.flaw!r} is no flaw"
        assert 0 < len(received.reason) < 1000, f"a reason of {len(received.reason)} characters"
        assert is_presentable(received.reason), f"{received.reason!r} cannot be shown"
        assert (received.flaw is Flaw.SIZE) == (len(frame) > MAX_CONTROL_BYTES), received.reason
        return
    if isinstance(received, ForeignHello):
        assert received.version != PROTOCOL_VERSION, "a hello of the own version is no foreign one"
        return
    try:
        again = encode(received)
    except ValueError:
        if _GROWTH * len(frame) + _HEAD > MAX_CONTROL_BYTES:
            return  # what came in as float 32 may be too long as float 64
        raise
    returned = decode(again, MAX_CONTROL_BYTES)
    assert image(returned) == image(received), f"{received!r} became {returned!r}"


def image(value: Received | object) -> object:
    """``value`` in a form in which any two that mean the same are equal, bit for bit; only all NaN are one."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return (type(value).__name__, *(image(getattr(value, field.name)) for field in fields))
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, tuple(image(float(entry)) for entry in value.ravel()))
    if isinstance(value, float):
        return "nan" if math.isnan(value) else value.hex()
    if isinstance(value, Mapping):
        return tuple((key, image(item)) for key, item in value.items())
    if isinstance(value, tuple):
        return tuple(image(item) for item in value)
    return (type(value).__name__, value)


def _peak() -> int:
    """The most memory that this process ever held, bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
