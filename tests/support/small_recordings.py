"""Small recordings for tests, as a recorder writes them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation, Role

RECORDED = Recorded(
    session="s",
    certificate="f" * 64,
    period=0.001,
    clock="simulated",
    roles={"dx": Role.DEVICE, "c": Role.COUPLING, "environment": Role.ENVIRONMENT},
    ports={"dx": ("x",), "c": ("x",), "environment": ("x",)},
    masses=("puck",),
)
ALONE = replace(RECORDED, roles={"d": Role.DEVICE}, ports={"d": ("x",)}, masses=())
"""A session of one device that promised nothing: the smallest recording that has a record of every kind."""

ATTACHED = {"session.yaml": b"name: s\n", "certificate.json": b'{"id": "f"}'}
STARTED = 1_800_000_000 * 10**9
TRACES = {
    "d": {"x": 1, "f_v": 1},
    "dx": {"x": 1, "f_v": 1, "ledger": 1, "tau_us": 1},
    "c": {"p": 1, "f_v": 1, "ledger": 1},
    "environment": {"x_e": 1, "q": 1, "ledger": 1},
}


def observation(node: str, tick: int, rows: int, **figures: float) -> bytes:
    """A frame of a node's ticks up to ``tick``, with numbers of many digits."""
    base = np.sin(np.arange(tick - rows, tick, dtype=np.float64)[:, None] + 1.0)
    traces = {
        name: base * (place + 1) * np.ones((1, width)) for place, (name, width) in enumerate(TRACES[node].items())
    }
    return encode(Observation(node, tick, Figures(figures), traces))


def condition(phase: str = "running", elapsed: float = 0.0) -> bytes:
    """A frame of the session's condition."""
    return encode(Condition(phase, elapsed, dict.fromkeys(RECORDED.roles, "running")))


def frames(ticks: int, each: int, recorded: Recorded = RECORDED) -> Iterable[bytes]:
    """The frames of a broadcast of a session of ``ticks``, ``each`` in an observation."""
    for tick in range(each, ticks + 1, each):
        for node in recorded.roles:
            yield observation(node, tick, each, late=float(tick))


def pieces(ticks: int, each: int, chunks: int, recorded: Recorded = RECORDED) -> list[bytes]:
    """The parts of a recording as a recorder writes them: the beginning, about so many chunks, the end."""
    core = RecorderCore(recorded, ATTACHED, STARTED)
    shown = [condition(), *frames(ticks, each, recorded)]
    out = [core.cut()]
    for place, frame in enumerate(shown, 1):
        core.take(frame, STARTED)
        if place % -(-len(shown) // chunks) == 0:
            out.append(core.cut())
    return [*out, core.cut(), core.end()]


def recording(ticks: int = 10, each: int = 5, chunks: int = 2, recorded: Recorded = RECORDED) -> bytes:
    """A whole recording, in about so many chunks."""
    return b"".join(pieces(ticks, each, chunks, recorded))


def cut_recording(ticks: int, each: int) -> bytes:
    """A recording that ends within the second of three chunks."""
    beginning, first, second, *_ = pieces(ticks, each, 3)
    return beginning + first + second[: len(second) // 2]
