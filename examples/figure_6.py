"""Fig. 6 of the paper: velocities with the decentralised coupling.

    python examples/figure_6.py            # writes figure_6.png

Each device has a coupling block of its own, designed and proved before it runs.
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
    session = load_named("example1")
    prepared = prepare(session)
    recording = Simulation(prepared).run(round(SECONDS / session.period))
    plot_velocities(recording, "decentralised coupling (Fig. 6)", target)
    last = round(0.2 / session.period)  # ticks
    fastest = abs(recording.velocity[-last:]).max()
    print(f"{target}: greatest speed in the last 0.2 s: {fastest:.3g} m/s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("figure_6.png"))
