"""The observer's process: prints the observations that the supervisor sends, one line of JSON each.

An observer may join and leave at any time. The session neither waits for it nor notices that it left.
"""

from __future__ import annotations

import json
import os
import sys

from manyhands.nodes.kernel.bundle import ObserverBundle
from manyhands.nodes.kernel.json_number import json_figures, json_number
from manyhands.nodes.kernel.lifetime import Life, Stopped
from manyhands.nodes.link.process import EXIT_BAD_INPUT, EXIT_OK, EXIT_REFUSED
from manyhands.nodes.link.supervisor_line import ControlLine, Refused
from manyhands.protocol.clock import from_seconds
from manyhands.protocol.codec import decode
from manyhands.protocol.keys import KeyRing
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Observation
from manyhands.protocol.transport import TransportError
from manyhands.protocol.transport.zeromq import HUB, ZmqTransport


class ObserverCore:
    """Turns frames into lines of JSON.

    Attributes:
        malformed: number of frames that were no observation.
    """

    def __init__(self) -> None:
        self.malformed = 0

    def line(self, frame: bytes) -> str | None:
        """The line for a frame: node, latest tick, figures, traces (ticks x ports); None if it is no observation.

        A figure that is infinite or NaN becomes null.
        """
        message = decode(frame, MAX_CONTROL_BYTES)
        if not isinstance(message, Observation):
            self.malformed += 1
            return None
        plain = {
            "node": message.node,
            "tick": message.tick,
            "figures": json_figures(message.figures),
            "traces": {
                name: [[json_number(value) for value in row] for row in trace.tolist()]
                for name, trace in message.traces.items()
            },
        }
        return json.dumps(plain, allow_nan=False)


_TIMEOUT = from_seconds(0.2)


def observe(bundle: ObserverBundle, life: Life, ring: KeyRing | None) -> int:
    """Print the session's observations until the session or the observer ends; returns the exit code."""
    common, core = bundle.common, ObserverCore()
    transport = ZmqTransport.of(common.transport, common.folder, ring)
    try:
        control = ControlLine(transport, common)
        life.watch = control.connection
        control.hello({}, os.getpid())
        link = transport.connect_outlet(control.peers_endpoints(life).get(HUB, ""), HUB)
        while not life.stopping:
            frame = link.recv(_TIMEOUT)
            if frame is None:
                life.check()
            elif (line := core.line(frame)) is not None:
                print(line, flush=True)  # noqa: T201 -- the observer's output
        return EXIT_OK
    except Stopped:
        return EXIT_OK
    except Refused as error:
        print(error, file=sys.stderr)  # noqa: T201 -- the process's own error channel
        return EXIT_REFUSED
    except (TransportError, ValueError) as error:
        print(f"error: {common.name}: {error}", file=sys.stderr)  # noqa: T201
        return EXIT_BAD_INPUT
    except BrokenPipeError:  # the reader of the lines has closed its end
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 -- the interpreter flushes standard output at its end
        return EXIT_OK
    finally:
        transport.close()
