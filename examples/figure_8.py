"""Fig. 8 of the paper: Example 2, velocities with the coupling of greatest transparency.

    python examples/figure_8.py            # writes figure_8.png

Springs and dampers chosen for the least ||W1 E V W2|| (24), with emphasis on 0-20 Hz: above as in the paper, below with
the world's own springs counted in series. There the level falls from 12.6 to 2.9, and at this limit of stiffness
nothing of the devices' damping is left over: the hands swing for longer.
"""

import sys
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

import manyhands as mh
from manyhands.launch.recordings.run import RecordedRun


def main(target: Path) -> None:
    """Run the session for ten seconds, without and with the contacts in series, and draw it."""
    figure = Figure(figsize=(8.0, 6.0), layout="constrained", facecolor="white")
    above, below = figure.subplots(2, 1, sharex=True)
    run = drawn(False, above, "loop-shaping optimum (Fig. 8)")
    drawn(True, below, "the same, contacts in series")
    figure.savefig(target, dpi=130)
    last = round(0.2 / run.period)  # ticks
    fastest = abs(run.velocity[-last:]).max()
    print(f"{target}: greatest speed in the last 0.2 s: {fastest:.3g} m/s")


def drawn(series: bool, axes: Axes, title: str) -> RecordedRun:
    """Design, simulate and draw Example 2, with or without the contacts in series."""
    session = mh.load("example2", {"design.series": series})
    certificate = mh.certify(session)
    run = mh.simulate(session, 10.0, certificate=certificate)
    claim = certificate.transparency
    mh.plot(run, "velocity", ax=axes).set_title(title if claim is None else f"{title}: {claim.gamma:.3g}", loc="left")
    return run


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("figure_8.png"))
