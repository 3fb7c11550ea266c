"""A model whose promise is enforced: two hands push a puck that a careless simulator makes livelier than it is.

    python examples/puck.py

The puck's contacts are one-sided springs, and its motion is integrated by explicit Euler, which adds energy at every
tick in which a spring acts on it, up to the speed at which it is cut off: once touched, it rattles for ever. No
certificate could be had for it. Its session, puck.yaml beside this file, declares it passive up to a small level and
has that enforced. To run it with processes:

    manyhands launch examples/puck.yaml --duration 4
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.environment.enforced import EnforcedCore

FOLDER = Path(__file__).parent
SECONDS = 4.0


class Puck:
    """A mass on a line between two walls; tools at the ports push it, from the left or from the right."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, float]) -> None:
        """At rest between the tools; parameters: mass (kg), stiffness (N/m), room (m) and fastest (m/s)."""
        self.side = np.array([1.0 if port.startswith("left") else -1.0 for port in ports])  # the way that it pushes
        self.period, self.mass, self.stiffness = period, parameters["mass"], parameters["stiffness"]
        self.room, self.fastest = parameters["room"], parameters["fastest"]
        self.x = self.v = 0.0

    def react(self, x_e: np.ndarray, k: int) -> np.ndarray:
        """The puck pushes back every tool inside it; then it moves, by the rule that is known to add energy."""
        depth = np.maximum(self.side * (x_e - self.x), 0.0)
        f = -self.side * self.stiffness * depth  # on the hands
        beyond = np.sign(self.x) * max(abs(self.x) - self.room, 0.0)  # of a wall
        total = -float(f.sum()) - self.stiffness * beyond
        self.x, v = self.x + self.period * self.v, self.v + self.period * total / self.mass
        self.v = min(max(v, -self.fastest), self.fastest)
        return f


def main() -> None:
    """Run the session with and without its controller, and print the resulting speeds of the hands."""
    for enforce in (True, False):
        session = load_named(FOLDER / "puck.yaml", [f"environment.enforce={str(enforce).lower()}"])
        simulation = Simulation(prepare(session, uncertified=not enforce))
        recording = simulation.run(round(SECONDS / session.period))
        fastest = abs(recording.velocity[-round(0.5 / session.period) :]).max()
        core = simulation.environment
        if enforce and isinstance(core, EnforcedCore) and core.controller is not None and core.ledger is not None:
            kept = f"{core.controller.energy:.3g} J kept back in {core.controller.ticks} ticks"
            print(f"enforced: {kept}; ledger never below {core.ledger.minimum:.1g} J; hands at most {fastest:.2g} m/s")
        else:
            print(f"not enforced: hands at {fastest:.2g} m/s in the last 0.5 s")


if __name__ == "__main__":
    main()
