"""The time of a step with tools on a mesh, against their number: the relief of the session ``stroke``, with friction.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.mesh

Each tool presses on the relief and moves over ridges and dome at up to 0.2 m/s. The step is that of the environment's
core, with its controller and ledger: what it does between receiving p and sending f_c, and what it does afterwards.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.world_step import WARM, step_times
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.mesh import MeshProxies
from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.environment.proxy import ProxyLaw

T = 1e-3
TICKS = 8000
STIFFNESS, FRICTION, RADIUS = 5000.0, 0.15, 0.003  # N/m, m
DEPTH = 0.02  # m, from where a tool begins to where it is pressed without force


def measure(tools: int, pressed: bool = True) -> dict[str, float]:
    """Times in microseconds, over TICKS ticks with this number of tools on the relief, or beside it."""
    ports = tuple(f"t{i}.{axis}" for i in range(tools) for axis in "xyz")
    places = [(0.036 * np.cos(1.3 * i) - 0.004, 0.016, 0.012 * np.sin(1.3 * i)) for i in range(tools)]
    given = [
        {"ports": [*ports[3 * i : 3 * i + 3]], "axes": [0, 1, 2], "at": [*place], "radius": RADIUS}
        for i, place in enumerate(places)
    ]
    grid = load_named("stroke").environment.model
    model = MeshProxies(ports, T, {"grid": grid, "friction": FRICTION, "tools": given})
    m = 3 * tools
    blocks = [list(range(3 * i, 3 * i + 3)) for i in range(tools)]
    law = ProxyLaw(AskedModel("mesh", model, ports), STIFFNESS * np.eye(m), None, T, blocks)
    core = EnforcedCore(law, np.eye(m) / 900.0, np.zeros((m, m)), T, True, blocks)

    def place(k: int) -> list[float]:
        phase = 2.0 * np.pi * 1.5 * k * T + np.arange(tools)
        depth = np.full(tools, -DEPTH * pressed * min(1.0, k / WARM))
        moved: list[float] = (
            np.stack([0.02 * np.sin(phase), depth, 0.01 * np.cos(0.7 * phase)], axis=1).ravel().tolist()
        )
        return moved

    def touching(f: Sequence[float]) -> int:
        return int(np.count_nonzero(np.reshape(f, (tools, 3)).any(axis=1)))

    return {**step_times(core, TICKS, place, touching), "held": sum(law.held)}


def main() -> None:
    """Print a line of JSON for each number of tools; the first does not touch."""
    for tools, pressed in ((1, False), (1, True), (2, True), (4, True)):
        sys.stdout.write(json.dumps({"tools": tools, **measure(tools, pressed)}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
