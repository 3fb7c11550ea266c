"""Fig. 8 of the paper: Example 2, velocities with the coupling of greatest transparency.

    python examples/figure_8.py            # writes figure_8.png

Springs and dampers chosen for the least ||W1 E V W2|| (24), with emphasis on 0-20 Hz.
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

import manyhands as mh


def main(target: Path) -> None:
    """Run the session for ten seconds, and draw it."""
    run = mh.simulate("example2", 10.0)
    figure = Figure(figsize=(8.0, 3.2), layout="constrained", facecolor="white")
    mh.plot(run, "velocity", ax=figure.subplots()).set_title("loop-shaping optimum (Fig. 8)", loc="left")
    figure.savefig(target, dpi=130)
    last = round(0.2 / run.period)  # ticks
    fastest = abs(run.velocity[-last:]).max()
    print(f"{target}: greatest speed in the last 0.2 s: {fastest:.3g} m/s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("figure_8.png"))
