"""Fig. 8 of the paper: Example 2, velocities with the coupling of greatest transparency.

    python examples/figure_8.py            # writes figure_8.png

Springs and dampers chosen for the least ||W1 E V W2|| (24), with emphasis on 0-20 Hz.
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
    session = load_named("example2")
    prepared = prepare(session)
    recording = Simulation(prepared).run(round(SECONDS / session.period))
    plot_velocities(recording, "loop-shaping optimum (Fig. 8)", target)
    last = round(0.2 / session.period)  # ticks
    fastest = abs(recording.velocity[-last:]).max()
    print(f"{target}: greatest speed in the last 0.2 s: {fastest:.3g} m/s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("figure_8.png"))
