"""Fig. 5 of the paper: velocities without virtual coupling.

    python examples/figure_5.py            # writes figure_5.png

The loop is not stable for every passive hand, so nothing certifies it, and it has to be asked for.
"""

import sys
from pathlib import Path

from manyhands.launch.demo import plot_velocities
from manyhands.launch.files import load_named
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.simulation import Simulation

SECONDS = 10.0


def main(target: Path) -> None:
    """Run the session and draw it."""
    session = load_named("example1-uncoupled")
    prepared = prepare(session, uncertified=True)
    recording = Simulation(prepared).run(round(SECONDS / session.period))
    plot_velocities(recording, "without virtual coupling (Fig. 5)", target)
    last = round(0.2 / session.period)  # ticks
    fastest = abs(recording.velocity[-last:]).max()
    print(f"{target}: greatest speed in the last 0.2 s: {fastest:.3g} m/s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("figure_5.png"))
