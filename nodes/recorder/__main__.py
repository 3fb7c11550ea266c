"""``python -m manyhands.nodes.recorder PLAN SUPERVISOR_PID``; standard output is the pipe to the supervisor."""

import sys
from pathlib import Path

from manyhands.nodes.kernel.lifetime import Life, Stopped
from manyhands.nodes.link.process import EXIT_BAD_INPUT, EXIT_OK
from manyhands.nodes.recorder.node import PlanError, RecordingPlan, record, to_pipe
from manyhands.protocol.clock import RealtimeClock


def main() -> int:
    """Run the recorder whose plan the command line names; returns the exit code."""
    if len(sys.argv) != 3 or not sys.argv[2].isdigit():
        print("usage: python -m manyhands.nodes.recorder PLAN SUPERVISOR_PID", file=sys.stderr)  # noqa: T201
        return EXIT_BAD_INPUT
    try:
        life = Life(int(sys.argv[2]))
        plan = RecordingPlan.load(Path(sys.argv[1]))
        life.enter_loop()  # from here on a request to end is only noted, so that no piece is cut in two
        life.leave_loop()  # garbage collection stays on: there is no tick that it could delay
    except Stopped:
        return EXIT_OK
    except PlanError as error:
        print(error, file=sys.stderr)  # noqa: T201 -- the pipe to the supervisor is not in use yet
        return EXIT_BAD_INPUT
    return record(plan, life, RealtimeClock(), to_pipe(sys.stdout.fileno()))


if __name__ == "__main__":
    sys.exit(main())
