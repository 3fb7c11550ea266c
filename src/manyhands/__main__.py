"""Entry point of ``manyhands`` and ``python -m manyhands``.

Ctrl-C must give exit code 130 from the first moment on, also while the heavy imports run. Until the
command line installs its own handling there is nothing to clean up, so leaving at once is safe.

Linear algebra gets one thread, unless the environment says otherwise: the matrices here are of some hundred rows at
most, on which threads wait for each other more than they compute when anything else runs, and a certificate's last
digits should not depend on the number of cores.
"""

import os
import signal
from types import FrameType

from manyhands.launch import output
from manyhands.launch.files import EXIT_INTERRUPTED


def _leave(_signum: int, _frame: FrameType | None) -> None:
    os._exit(EXIT_INTERRUPTED)


def main() -> None:
    """Run the command line; never returns normally (typer raises ``SystemExit``)."""
    signal.signal(signal.SIGINT, _leave)
    output.install()
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # read when numpy is first imported
    from manyhands.launch.app.cli import app  # after the handler: this import takes a noticeable time

    app(prog_name="manyhands")  # completion goes by it, and python -m has another


if __name__ == "__main__":
    main()
