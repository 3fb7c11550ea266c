"""The time of a scene's step against the number of contacts: 4 tools with three axes, and up to 4 bodies, in a room.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.scene

Every sphere is pressed into a corner of the room, where it touches three faces with friction, and is moved along them.
The step is that of the environment's core, with its controller and ledger: what it does between receiving p and sending
f_c, and what it does afterwards. One core is used.

    python -m benchmarks.scene --session four.yaml
    manyhands launch four.yaml --set colocate=true --duration 10

The first command writes the same scene with eight spheres as a session: four users with three axes press into corners.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.world_step import WARM, step_times
from manyhands.design.models.contacts import Surface
from manyhands.design.models.scene import Body, ContactScene, Obstacle, SceneLink, ToolSphere
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.scene import SceneLaw
from tests.support.scenes import scene_session

T = 1e-3
TICKS = 4000
SIDE, RADIUS, DEPTH = 0.1, 0.02, 2e-3  # m: half a side of the room, the spheres, and how far they are pressed
PRESS = 0.03  # m, of the session's hands
CORNERS = [(x, y, z) for z in (-1.0, 1.0) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]


def scene_of(spheres: int) -> ContactScene:
    """Four tools, and bodies beyond four spheres; the first ``spheres`` begin in a corner."""

    def place(i: int) -> tuple[float, float, float]:
        x, y, z = CORNERS[i]
        at = SIDE - RADIUS if i < spheres else 0.5 * SIDE
        return x * at, y * at, z * at

    def beyond(i: int) -> tuple[float, float, float]:
        x, y, z = CORNERS[i]
        return x * (SIDE - RADIUS + DEPTH), y * (SIDE - RADIUS + DEPTH), z * (SIDE - RADIUS + DEPTH)

    bodies = range(4, max(4, spheres))
    return ContactScene(
        tuple(f"t{i}.{axis}" for i in range(4) for axis in "xyz"),
        tools=tuple(ToolSphere(f"t{i}", (3 * i, 3 * i + 1, 3 * i + 2), (0, 1, 2), place(i), RADIUS) for i in range(4)),
        bodies=tuple(Body(f"b{i}", 0.2, place(i), RADIUS) for i in bodies),
        obstacles=(Obstacle("room", "room", ((-SIDE,) * 3, (SIDE,) * 3)),),
        links=tuple(SceneLink((f"b{i}", "ground"), 1000.0, 1.0, beyond(i)) for i in bodies),
        surface=Surface(5000.0, 1.0, 0.5),
    )


def measure(spheres: int) -> dict[str, float]:
    """Times in microseconds, over TICKS ticks with ``spheres`` spheres in corners."""
    scene = scene_of(spheres)
    law = SceneLaw(scene, T)
    core = EnforcedCore(law, np.eye(12) / 900.0, np.zeros((12, 12)), T, True, stored=scene.energy_at_start)
    corners = np.array(CORNERS[:4]).ravel()
    pressed = np.repeat(np.arange(4) < spheres, 3) * DEPTH * corners

    def place(k: int) -> list[float]:
        moved: list[float] = (pressed + 1e-3 * np.sin(2.0 * np.pi * 2.0 * k * T + np.arange(12))).tolist()
        return moved

    found = step_times(core, TICKS, place, lambda f: law.touching)
    return {**found, "newton_steps": round(law.steps / (WARM + TICKS), 2), "unfinished": law.unfinished}


def session() -> dict[str, Any]:
    """The scene with eight spheres as a session file: each hand presses its tool into a corner and moves it there."""
    scene = scene_of(8)

    def motion(corner: tuple[float, float, float]) -> list[str]:
        x, y, z = (PRESS * axis for axis in corner)
        return [f"{x}*min(t, 1) + 0.004*sin(2*pi*0.7*t)", f"{y}*min(t, 1)", f"{z}*min(t, 1)"]

    devices = {
        tool.name: {
            "osp": 1.37,
            "mass": 0.2,
            "hand": {"stiffness": 300, "damping": 5, "motion": motion(CORNERS[i])},
        }
        for i, tool in enumerate(scene.tools)
    }
    return {**scene_session(scene, devices, {"coupling": "spring-damper", "tau": T}, T), "session": "four"}


def main() -> None:
    """Print a line of JSON for each number of spheres; or write the session."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--session", type=Path, metavar="FILE", help="write the scene as a session, and end")
    if target := options.parse_args().session:
        target.write_text(json.dumps(session(), indent=1) + "\n")
        return
    for spheres in (0, 1, 2, 4, 6, 7, 8):
        sys.stdout.write(json.dumps({"spheres": spheres, **measure(spheres)}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
