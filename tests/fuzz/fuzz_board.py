"""A host's end of a conversation with a board: any bytes, cut anywhere, with any clock; and its two codes.

States that were sent whole come out as they were, in their order, whatever noise stands between two of them.
"""

from __future__ import annotations

import struct
from typing import Final

from draws import Draws

from manyhands.devices.serial_board.conversation import Conversation
from manyhands.devices.serial_board.frames import MOST_AXES, MOST_FRAME, coded, decoded, opened, sealed
from manyhands.protocol.clock import Instant

MOST_STEPS: Final = 40
NONCE: Final = 0x01020304
STEPS: Final = ("state", "noise", "changed", "about", "code")


def check(data: bytes) -> None:
    """Play what ``data`` decides; raise if a promise is broken."""
    play(Draws(data))


def play(draws: Draws) -> None:
    """The same for decisions from anywhere."""
    axes = draws.integer(1, MOST_AXES)
    host, now, ours, number = Conversation(NONCE), Instant(0), draws.integer(0, 2**32 - 1), 0
    host.take(sealed(_about(axes)), now)
    assert host.about is not None
    for _ in range(MOST_STEPS):
        if not draws.more:
            return
        passed = draws.choice((1, 500, 4000, 3_000_000))
        now, ours = Instant(now + 1000 * passed), (ours + passed) % 2**32
        match draws.choice(STEPS):
            case "state":
                x = tuple(float(draws.integer(0, 255)) for _ in range(axes))
                frame = sealed(_state(number, ours, x))
                cut = draws.integer(0, len(frame))
                states = host.take(b"\0" + frame[:cut], now) + host.take(frame[cut:], now)
                assert [(state.number, state.x) for state in states][-1] == (number, x)
                assert host.newest is not None
                assert host.age(now) >= 0.0
                assert (ours - host.board_time(now)) % 2**32 < 2**31, "a force would end too late"
                number = (number + 1) % 2**16
            case "noise":
                _take(host, draws.blob(3 * MOST_FRAME), now)
            case "changed":
                frame = bytearray(sealed(_state(number, ours, (0.0,) * axes)))
                frame[draws.integer(0, len(frame) - 2)] ^= draws.integer(1, 255)
                before = host.newest
                host.take(b"\0" + bytes(frame) + b"\0", now)
                assert host.newest is before, "a frame with a changed byte counts"
            case "about":
                host.take(b"\0" + sealed(_about(draws.integer(1, MOST_AXES), NONCE + 1)), now)
                assert host.about.axes == axes, "an answer to another hello counts"
            case _:
                raw = draws.blob(600)
                assert decoded(coded(raw)) == raw
                back = decoded(raw)
                assert back is None or len(back) <= len(raw)


def _take(host: Conversation, data: bytes, now: Instant) -> None:
    """Bytes that are no frame change nothing; those that are one by a right checksum are not sent on."""
    if not any(opened(piece) for piece in data.split(b"\0")):
        before = host.newest, host.about
        assert host.take(b"\0" + data + b"\0", now) == []
        assert (host.newest, host.about) == before


def _state(number: int, at: int, x: tuple[float, ...]) -> bytes:
    head = struct.pack("<BHHIBB", 0x82, number, 0, at, 3, 0)
    return head + struct.pack(f"<{2 * len(x)}f", *x, *x)


def _about(axes: int, nonce: int = NONCE) -> bytes:
    head = struct.pack("<BBI16sBBBII", 0x81, 1, nonce, b"fuzz", axes, 0, 0, 500, 50_000)
    return head + struct.pack(f"<{5 * axes}f", *([1.0] * 5 * axes))
