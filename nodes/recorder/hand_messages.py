"""The messages that show how a hand turns its device: Foxglove's ``PoseInFrame``, as JSON.

The pose is in the frame with the session's name, as that of the tool in ``transforms`` is, and at the same rate: where
the tool would be if it were joined to the device without a spring. In a world that its engine does not draw, it is the
displacement by the device's own axes, and the turn since the start.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterator, Mapping
from typing import Final

from manyhands.nodes.environment.drawing import Frame
from manyhands.nodes.kernel.orientation import unit
from manyhands.nodes.recorder.engine_messages import pose_of
from manyhands.nodes.recorder.scene_messages import POSE, SceneMessage, every_of, pose_shown, stamp
from manyhands.protocol.channels import DISPLACEMENT, ORIENTATION
from manyhands.protocol.messages import Values

_WHERE_IT_IS: Final = Frame(
    (0.0, 0.0, 0.0),
    (1.0, 0.0, 0.0, 0.0),
    ("x", "y", "z"),
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    pivot=(0.0, 0.0, 0.0),
)


class HandMessages:
    """Makes the messages of one device whose orientation is a port.

    Attributes:
        node: the device.
        topics: those of its messages.
    """

    topics: Final = (POSE,)

    def __init__(self, session: str, device: str, ports: tuple[str, ...], tick_ns: float, frame: Frame | None) -> None:
        """Know where it is.

        Args:
            session: the session's name, which is that of the world's frame.
            device: its name.
            ports: its axes, in the order of its traces.
            tick_ns: its period, ns.
            frame: of its tool in the drawing; None where there is none.
        """
        self.node, self._session, self._tick_ns = device, session, tick_ns
        self._frame = frame or _WHERE_IT_IS
        self._places = [0, 1, 2] if frame is None else [ports.index(port) for port in frame.ports]
        self._every = every_of(tick_ns)

    def of(
        self, tick: int, traces: Mapping[str, Values], start: int, topics: Collection[str] = (POSE,)
    ) -> Iterator[SceneMessage]:
        """The messages of one piece of telemetry, in the order of their ticks.

        Args:
            tick: the one after the last row.
            traces: of the device, with as many columns as the session has.
            start: the time of tick 0, ns since 1970.
            topics: those whose messages are wanted.
        """
        x, R = traces.get(DISPLACEMENT), traces.get(ORIENTATION)
        if x is None or R is None or POSE not in topics:
            return
        rows = len(x)
        for row in range((rows - tick) % self._every, rows, self._every):
            turn = unit(R[row].tolist())
            if turn is None:
                continue
            at, turned = pose_of(self._frame, x[row, self._places].tolist(), turn)
            if not all(map(math.isfinite, at)):
                continue
            k = tick - rows + row
            time = start + round(k * self._tick_ns)
            told = {"timestamp": stamp(time), "frame_id": self._session, "pose": pose_shown(at, turned)}
            yield SceneMessage(POSE, k, time, json.dumps(told, allow_nan=False).encode())
