"""A guest's own processes made hostile: the hostilities of :mod:`tests.deterministic.blame` over real sockets.

Every Python process of the guest calls :func:`arm` before anything else. What is patched is only what this party itself
sends; its keys, sockets and handshakes are the product's.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from random import Random

from manyhands.nodes.device.wall_time import WallTimeDriver
from manyhands.nodes.link.supervisor_line import ControlLine
from manyhands.nodes.wave_link import ends, faces
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Telemetry

from .blame import ABOUT, SENSELESS, hostility

HONEST_WAVES = 500
"""So many waves are honest: the guest is in by then."""


def arm(seed: int) -> None:
    """Make this process hostile as the plan of ``seed`` says."""
    plan, random = hostility(seed), Random(f"guest {seed}")
    message, send, frame, sample = (
        faces._Face.message,
        ends.UserEnd._send_wave,
        ControlLine.frame,
        WallTimeDriver.sample,
    )
    waves, began, frozen = 0, 0.0, list[faces.Sums]()

    def begun() -> bool:
        return waves > HONEST_WAVES

    def motion() -> float:
        return math.sin(2.0 * math.pi * plan.frequency * (time.monotonic() - began))

    def hostile_message(self: faces._Face) -> faces.Sums:
        told = message(self)
        if not begun():
            return told
        if "waves" in plan.kinds:
            told = told._replace(U=(math.sqrt(5.0) * plan.amplitude * motion(),) * len(told.U))
        if "energy" in plan.kinds:
            told = told._replace(G=plan.shipped)
        if "frozen waves" in plan.kinds:
            frozen[:] = frozen or [told]
            told = frozen[0]._replace(n=told.n)
        return told

    def hostile_send(self: ends.UserEnd) -> bool:
        nonlocal waves, began
        waves += 1
        if not begun():
            began = time.monotonic()
            return send(self)
        if "silent" in plan.kinds:
            return True
        if "flood" in plan.kinds and self.link is not None:
            for _ in range(40):
                self.link.send(random.randbytes(24))
        if "late" in plan.kinds:
            time.sleep(plan.late * random.random() / 1e9)  # this party's lateness is the hostility itself
        return send(self)

    def hostile_frame(self: ControlLine, telemetry: Telemetry) -> bytes:
        if begun() and "telemetry" in plan.kinds:
            figures = dict.fromkeys((*telemetry.figures, *ABOUT), random.choice(SENSELESS))
            telemetry = replace(telemetry, figures=figures, traces={})
        return frame(self, telemetry)

    def hostile_sample(self: WallTimeDriver, tick: int, at: Instant) -> list[float]:
        x = list(sample(self, tick, at))
        if begun() and "driver" in plan.kinds:
            x = [min(plan.amplitude, 0.15) * motion()] * len(x)
        return x

    faces._Face.message = hostile_message  # type: ignore[method-assign]
    ends.UserEnd._send_wave = hostile_send  # type: ignore[method-assign]
    ControlLine.frame = hostile_frame  # type: ignore[method-assign]
    WallTimeDriver.sample = hostile_sample  # type: ignore[assignment]
