"""Any frames between honest ones to a gate: the awaited signal is admitted with exactly its values, nothing else is,
and every frame is counted once.
"""

from __future__ import annotations

import math
from typing import Final

import msgpack
import numpy as np
from draws import Draws
from forger import Forger

from manyhands.protocol.codec import LAYOUTS, decode, encode
from manyhands.protocol.gate import DROP_REASONS, Bounds, Gate
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Fault,
    Force,
    LinkHello,
    Message,
    Reaction,
    Role,
    Sample,
    SignalMessage,
    Tool,
    Values,
    Welcome,
)

MOST_FRAMES: Final = 48
KINDS: Final[dict[str, type[SignalMessage]]] = {kind.__name__: kind for kind in (Sample, Tool, Reaction, Force)}
MAGNITUDE, STEP = 2.0, 1.0
BOUNDS: Final = ("none", "magnitude", "magnitude and step")
SLACK: Final = 1e-8
"""Beyond a bound by less than this, relative, a value may be admitted or not: a gate yields to rounding."""

WHO: Final = ("honest", "honest in other words", "forged", "replayed")
FIRST_TICKS: Final = (0, 1, 2**32, 2**63 - 1 - MOST_FRAMES)


def check(data: bytes) -> None:
    """Play the traffic that ``data`` decides; raise if the gate breaks one of its promises."""
    play(Draws(data))


def play(draws: Draws) -> None:
    """The same for decisions from anywhere."""
    name = draws.choice(tuple(KINDS))
    kind, width, bounded = KINDS[name], draws.integer(1, 4), draws.choice(BOUNDS)
    gate = Gate(kind, width, _bounds(bounded, width))
    tick = first = draws.choice(FIRST_TICKS)
    stamp = admitted = seen = 0
    last: Values | None = None
    history: list[bytes] = [b""]
    for _ in range(MOST_FRAMES):
        if not draws.more:
            break
        who = draws.choice(WHO)
        honest = kind(tick, draws.integer(0, 255), _values(draws, width, last))
        if who == "honest":
            frame = encode(honest)
        elif who == "honest in other words":
            frame = _in_other_words(draws, honest)
        elif who == "forged":
            frame = Forger(draws, _in_place(honest, first)).frame()
        else:
            frame = draws.choice(history)
        before = dict(gate.dropped)
        found = gate.admitted(frame, tick)
        values = None if found is None else np.array(found)
        seen += 1
        awaited = _awaited(frame, kind, tick, width)
        if who.startswith("honest"):
            assert awaited == honest, "the harness is wrong"
        if values is not None:
            assert awaited is not None, f"admitted {values} for tick {tick} from {frame.hex()}"
            assert _beyond(bounded, awaited.values, last) <= SLACK, f"admitted {values} after {last}"
            assert values.tobytes() == awaited.values.tobytes(), f"found {values}; expected {awaited.values}"
            assert gate.dropped == before
            stamp, last, admitted, tick = awaited.stamp, values, admitted + 1, tick + 1
        else:
            assert awaited is None or _beyond(bounded, awaited.values, last) > 0.0, f"dropped {awaited!r} after {last}"
            risen = [reason for reason in DROP_REASONS if gate.dropped[reason] != before[reason]]
            assert len(risen) == 1, f"counted under {risen}"
            assert gate.dropped[risen[0]] == before[risen[0]] + 1
            assert awaited is None or risen == ["out_of_range"], f"counted under {risen}"
        history.append(frame)
        assert gate.stamp == stamp
    assert admitted + sum(gate.dropped.values()) == seen
    assert tuple(gate.dropped) == DROP_REASONS


def _bounds(bounded: str, width: int) -> Bounds | None:
    if bounded == "none":
        return None
    return Bounds((MAGNITUDE,) * width, (STEP,) * width if bounded == "magnitude and step" else None)


def _beyond(bounded: str, values: Values, last: Values | None) -> float:
    """How far ``values`` are beyond what is allowed after ``last``, relative; 0 where they are not."""
    most = 0.0
    if bounded != "none":
        most = max(most, float(np.max(np.abs(values))) / MAGNITUDE - 1.0)
    if bounded == "magnitude and step" and last is not None:
        with np.errstate(over="ignore"):  # to infinity, which is beyond
            most = max(most, float(np.max(np.abs(values - last))) / STEP - 1.0)
    return most


def _awaited(frame: bytes, kind: type[SignalMessage], tick: int, width: int) -> SignalMessage | None:
    """The message in ``frame``, if it is the one to admit. That of the codec, which has a harness of its own."""
    message = decode(frame, MAX_CONTROL_BYTES)
    if not isinstance(message, kind) or message.tick != tick or message.values.size != width:
        return None
    return message if all(map(math.isfinite, message.values)) else None


def _values(draws: Draws, width: int, last: Values | None) -> Values:
    """Within every bound, exactly: multiples of 1/64."""
    drawn = np.array([draws.integer(-128, 128) / 64 for _ in range(width)])
    return drawn if last is None else np.clip(drawn, last - STEP, last + STEP)


def _in_other_words(draws: Draws, signal: SignalMessage) -> bytes:
    """The same signal as another MessagePack encoder might write it: shorter integers, or longer heads."""
    number, _ = LAYOUTS[type(signal)]
    data = signal.values.astype("<f8").tobytes()
    array = (b"\x94", b"\xdc\x00\x04", b"\xdd\x00\x00\x00\x04")[draws.integer(0, 2)]
    binary = (b"\xc4" + bytes([len(data)]), b"\xc5\x00" + bytes([len(data)]), b"\xc6\x00\x00\x00" + bytes([len(data)]))
    integers = b"".join(_integer(draws, value) for value in (number, signal.tick, signal.stamp))
    return array + integers + binary[draws.integer(0, 2)] + data


def _integer(draws: Draws, value: int) -> bytes:
    """A number as the shortest MessagePack integer, or in one of the tags that are long enough for it."""
    tags = ((0xCC, 1, False), (0xCD, 2, False), (0xCE, 4, False), (0xCF, 8, False),
            (0xD0, 1, True), (0xD1, 2, True), (0xD2, 4, True), (0xD3, 8, True))  # fmt: skip
    fitting = [(tag, size, signed) for tag, size, signed in tags if value < 2 ** (8 * size - signed)]
    chosen = draws.integer(0, len(fitting))
    if chosen == len(fitting):
        shortest: bytes = msgpack.packb(value)
        return shortest
    tag, size, signed = fitting[chosen]
    return bytes([tag]) + value.to_bytes(size, "big", signed=signed)


def _in_place(honest: SignalMessage, first: int) -> dict[str, Message]:
    """What might arrive here: signals of this and other channels and ticks, and messages of other channels."""
    tick, stamp, values = honest.tick, honest.stamp, honest.values
    kind = type(honest)
    return {
        "awaited": honest,
        **{name.lower(): other(tick, stamp, values) for name, other in KINDS.items()},
        "late": kind(max(tick - 1, 0), stamp, values),
        "first": kind(first, stamp, values),
        "early": kind(tick + 1, stamp, values),
        "narrow": kind(tick, stamp, values[:1]),
        "wide": kind(tick, stamp, np.append(values, 1.0)),
        "far": kind(tick, stamp, values + 3.0),
        "a step too far": kind(tick, stamp, np.where(values > 0.0, values - 1.5, values + 1.5)),
        "widest": kind(tick, stamp, np.ones(30)),
        "welcome": Welcome(),
        "hello": LinkHello(PROTOCOL_VERSION, "c0ffee", "example-1", "cx", Role.COUPLING, ("dx",)),
        "foreign": LinkHello(PROTOCOL_VERSION + 1, "c0ffee", "example-1", "cx", Role.COUPLING, ("dx",)),
        "fault": Fault("boom"),
    }
