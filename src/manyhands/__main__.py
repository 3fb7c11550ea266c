"""Entry point of ``manyhands`` and ``python -m manyhands``.

Ctrl-C must give exit code 130 from the first moment on, also while the heavy imports run. Until the
command line installs its own handling there is nothing to clean up, so leaving at once is safe.
"""

import os
import signal
from types import FrameType

from manyhands.launch.exits import EXIT_INTERRUPTED


def _leave(_signum: int, _frame: FrameType | None) -> None:
    os._exit(EXIT_INTERRUPTED)


def main() -> None:
    """Run the command line; never returns normally (typer raises ``SystemExit``)."""
    signal.signal(signal.SIGINT, _leave)
    from manyhands.launch.cli import app  # after the handler: this import takes a noticeable time

    app()


if __name__ == "__main__":
    main()
