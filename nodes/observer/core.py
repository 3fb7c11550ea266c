"""What an observer makes of what it is told: one line of JSON for each observation, for people and programs alike."""

from __future__ import annotations

import json

from manyhands.nodes.json_number import json_number
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Observation


class ObserverCore:
    """Reads observations.

    Attributes:
        malformed: frames that were no observation.
    """

    def __init__(self) -> None:
        self.malformed = 0

    def line(self, frame: bytes) -> str | None:
        """The line for a frame: node, latest tick, figures, traces (ticks x ports); None if it is no observation.

        A figure that is infinite or not a number is null.
        """
        message = decode(frame, MAX_CONTROL_BYTES)
        if not isinstance(message, Observation):
            self.malformed += 1
            return None
        plain = {
            "node": message.node,
            "tick": message.tick,
            "figures": {name: json_number(value) for name, value in message.figures.items()},
            "traces": {
                name: [[json_number(value) for value in row] for row in trace.tolist()]
                for name, trace in message.traces.items()
            },
        }
        return json.dumps(plain, allow_nan=False)
