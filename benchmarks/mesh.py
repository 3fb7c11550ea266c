"""The time of a step with tools on a mesh, against their number: the relief of the session ``stroke``, with friction.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/mesh.py

Each tool presses on the relief and moves over ridges and dome at up to 0.2 m/s. The step is that of the environment's
core, with its controller and ledger: what it does between receiving p and sending f_c, and what it does afterwards.
Times are processor times of the thread, as in ``benchmarks/scene.py``; ``wall_p99`` is by the clock.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np

from manyhands.launch.files import load_named
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.mesh import MeshProxies
from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.environment.proxy import ProxyLaw

T = 1e-3
TICKS = 8000
WARM = 200  # ticks before the measurement
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
    touching, react, settle, wall = [], [], [], []
    for k in range(WARM + TICKS):
        phase = 2.0 * np.pi * 1.5 * k * T + np.arange(tools)
        moves = [
            0.02 * np.sin(phase),
            np.full(tools, -DEPTH * pressed * min(1.0, k / WARM)),
            0.01 * np.cos(0.7 * phase),
        ]
        p = np.stack(moves, axis=1).ravel().tolist()
        clock, begin = time.perf_counter(), time.thread_time()
        f = core.react(p)
        sent = time.thread_time()
        core.settle()
        end, passed = time.thread_time(), time.perf_counter() - clock
        if k >= WARM:
            react.append(sent - begin)
            settle.append(end - sent)
            wall.append(passed)
            touching.append(int(np.count_nonzero(np.reshape(f, (tools, 3)).any(axis=1))))
    step = 1e6 * (np.array(react) + np.array(settle))
    return {
        "touching": round(float(np.mean(touching)), 1),
        "p50": round(float(np.median(step)), 1),
        "p99": round(float(np.percentile(step, 99)), 1),
        "wall_p99": round(1e6 * float(np.percentile(wall, 99)), 1),
        "before_sending_p50": round(1e6 * float(np.median(react)), 1),
        "before_sending_p99": round(1e6 * float(np.percentile(react, 99)), 1),
        "held": sum(law.held),
        "kept_back": core.controller.ticks if core.controller is not None else 0,
    }


def main() -> None:
    """Print a line of JSON for each number of tools; the first does not touch."""
    for tools, pressed in ((1, False), (1, True), (2, True), (4, True)):
        sys.stdout.write(json.dumps({"tools": tools, **measure(tools, pressed)}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
