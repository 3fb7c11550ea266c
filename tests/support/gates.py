"""A gate's answer as an array, for computations in tests."""

from __future__ import annotations

import numpy as np

from manyhands.protocol.gate import Gate
from manyhands.protocol.messages import Values


def admit(gate: Gate, frame: bytes, tick: int) -> Values | None:
    """The values of the signal in ``frame`` if the gate admits it at ``tick``."""
    found = gate.admitted(frame, tick)
    return None if found is None else np.array(found)
