"""A process of the probe: ``python -m manyhands.launch.doctor.part PARENT_PID``, its task on standard input."""

from __future__ import annotations

import sys

import zmq

from manyhands.launch.doctor.conversation import PeerGone, hear, tell
from manyhands.launch.doctor.ticking import TickTask, tick
from manyhands.launch.doctor.waking import WakeTask, wake
from manyhands.nodes.life import Life, Stopped

EXIT_OK = 0
EXIT_FAILED = 1


def main() -> int:
    """Do the one task that is told; returns the exit code."""
    try:
        life = Life(int(sys.argv[1]))
        told = hear()
        if told["kind"] == "wake":
            tell(wake(WakeTask(**told["task"]), life))
        else:
            tick(TickTask(**told["task"]), life)
    except (Stopped, PeerGone):
        return EXIT_OK  # as whoever started it wants
    except zmq.ZMQError as error:
        print(error, file=sys.stderr)  # noqa: T201 -- the process's own error channel
        return EXIT_FAILED
    return EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
