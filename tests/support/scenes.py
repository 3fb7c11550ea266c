"""Random scenes, crowded rooms with every shape, springs and friction; and the session of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from manyhands.design.models.contacts import Surface
from manyhands.design.models.scene import Body, ContactScene, Obstacle, Point, SceneLink, ToolSphere
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.scene import SceneLaw

HALF = 0.08  # m, of the room's sides
OBSTACLES = (
    Obstacle("room", "room", ((-HALF, -HALF, 0.0), (HALF, HALF, 2 * HALF))),
    Obstacle("rail", "capsule", ((-0.05, 0.0, 0.02), (0.05, 0.02, 0.02)), 0.015),
    Obstacle("block", "box", ((0.02, 0.02, 0.0), (0.06, 0.06, 0.04))),
    Obstacle("stone", "sphere", ((-0.04, -0.04, 0.05),), 0.02),
    Obstacle("ramp", "wall", ((0.0, 0.0, 0.0), (0.3, 0.0, 1.0))),
)


def random_scene(rng: np.random.Generator, tools: int, bodies: int, axes: int = 3) -> ContactScene:
    """A room in which tools of ``axes`` axes, bodies of every shape and obstacles may overlap at the start."""

    def place() -> Point:
        x, y, z = rng.uniform(-0.05, 0.05, 3).tolist()
        return x, y, z + HALF

    ports = tuple(f"t{i}.{'xyz'[axis]}" for i in range(tools) for axis in range(axes))
    links = [SceneLink(("t0", "b0"), 500.0, 0.2)] if bodies else []
    if bodies > 2:
        links += [SceneLink(("b1", "b2"), 300.0, 0.1), SceneLink(("b1", "ground"), 50.0, 0.0, place())]
    return ContactScene(
        ports,
        tools=tuple(
            ToolSphere(f"t{i}", tuple(range(axes * i, axes * i + axes)), tuple(range(axes)), place(), 0.01)
            for i in range(tools)
        ),
        bodies=tuple(random_body(rng, i, place()) for i in range(bodies)),
        obstacles=OBSTACLES,
        links=tuple(links),
        surface=Surface(10.0 ** rng.uniform(2.5, 6.0), rng.uniform(0.0, 5.0), rng.choice([0.0, 0.3, 1.0])),
        surfaces=(
            (("t0", "stone"), Surface(0.0)),
            (("t0", "ramp"), Surface(800.0, 1.0, 2.0)),
            # a capsule along no axis and a box cannot touch
            *(((f"b{i}", ("rail", "block")[i % 4 == 3]), Surface(0.0)) for i in range(bodies) if i % 2),
            *(((f"b{i}", f"b{j}"), Surface(0.0)) for i in range(bodies) for j in range(i) if (i + j) % 4 == 0),
        ),
        gravity=(0.0, 0.0, rng.choice([0.0, -9.81])),
    )


def random_body(rng: np.random.Generator, i: int, at: Point) -> Body:
    """By ``i`` a sphere, a box, a capsule along an axis or one along none."""
    mass, radius = rng.uniform(0.02, 1.0), rng.uniform(0.01, 0.03)
    x, y, z = rng.uniform(0.01, 0.03, 3).tolist()
    match i % 4:
        case 1:
            return Body(f"b{i}", mass, at, 0.0, "box", (x, y, z))
        case 2:
            return Body(f"b{i}", mass, at, radius, "capsule", (0.0, y, 0.0))
        case 3:
            return Body(f"b{i}", mass, at, radius, "capsule", (x, -y, z))
        case _:
            return Body(f"b{i}", mass, at, radius)


def random_compliance(rng: np.random.Generator, m: int) -> np.ndarray:
    """D_V, m x m, m/N: any matrix whose symmetric part is positive definite."""
    A = rng.normal(size=(m, m))
    return np.asarray((np.eye(m) + 0.1 * (A - A.T) + 0.3 * A @ A.T / m) / 10.0 ** rng.uniform(2.0, 3.5))


class Stored:
    """The energy of height, motion, springs and contacts of a scene, above the scene's own lowest bound, J."""

    def __init__(self, scene: ContactScene, law: SceneLaw | None = None, T: float = 1e-3) -> None:
        """At the start of a scene.

        Args:
            scene: the scene.
            law: where it is given, what the bristles of its contacts store is counted, too.
            T: period, s.
        """
        self._scene, self._law, self._T = scene, law, T
        self._lowest = sum(scene.lowest_energy(body) for body in scene.bodies)
        self._before = scene.points

    def at(self, core: EnforcedCore) -> float:
        """What is stored after the core's last tick; it is asked once a tick."""
        scene = self._scene
        z = scene.points.copy()
        for i, tool in enumerate(scene.tools):
            for port, axis in zip(tool.ports, tool.axes, strict=True):
                z[i, axis] += core.tools[port]
        if core.masses:
            z[len(scene.tools) :] += np.reshape(core.masses, (-1, 3))
        v, self._before = (z - self._before) / self._T, z
        total = scene.contacts.energy(z) - self._lowest
        for i, body in enumerate(scene.bodies, len(scene.tools)):
            total += 0.5 * body.mass * float(v[i] @ v[i]) - body.mass * float(np.dot(scene.gravity, z[i]))
        for link in scene.links:
            strained = scene.span_of(link, z) - scene.rest_of(link)
            total += 0.5 * link.stiffness * float(strained @ strained)
        if self._law is not None:
            bristles = self._law._bristles
            total += 0.5 * float(scene.contacts.stiffness @ (bristles * bristles).sum(axis=1))
        return total


def scene_session(
    scene: ContactScene, devices: Mapping[str, Mapping[str, Any]], design: Mapping[str, Any], T: float = 1e-3
) -> dict[str, Any]:
    """The session file of a scene, as plain data.

    Args:
        scene: the scene; tools that begin inside of something do not touch it.
        devices: of each tool, what its simulated device has beside its axes.
        design: as in a session file.
        T: period, s.
    """

    def obstacle(shape: str, points: Any, radius: float) -> dict[str, Any]:
        keys = {"wall": ("at", "normal"), "sphere": ("at",), "capsule": ("ends",)}.get(shape, ("low", "high"))
        stated = {"ends": points} if shape == "capsule" else dict(zip(keys, points, strict=True))
        return {"shape": shape, **stated, **({"radius": radius} if radius else {})}

    def body(mass: float, at: Any, radius: float, shape: str = "sphere", half: Any = (0.0, 0.0, 0.0)) -> dict[str, Any]:
        low, high = (np.subtract(at, half).tolist(), np.add(at, half).tolist())
        keys: dict[str, dict[str, Any]] = {
            "sphere": {"at": at, "radius": radius},
            "capsule": {"ends": [low, high], "radius": radius},
            "box": {"low": low, "high": high},
        }
        return {"mass": mass, "shape": shape, **keys[shape]}

    terms = scene.terms()
    touching = [*terms["contacts"]]
    touching += [
        {"between": list(pair.names), "stiffness": 0}
        for pair, gap in zip(scene.contacts.pairs, scene.contacts.gaps(scene.points)[0], strict=True)
        if gap < 0.0 and pair.names[0] in terms["tools"]
    ]
    return {
        "session": "random-scene",
        "period": T,
        "devices": {
            name: {"dof": len(tool["ports"]), "axes": tool["axes"], "driver": "simulated", **devices[name]}
            for name, tool in terms["tools"].items()
        },
        "couplings": {f"to_{name}": {"devices": [name]} for name in devices},
        "environment": {
            "type": "scene",
            "gravity": terms["gravity"],
            "tools": {name: {"at": tool["at"], "radius": tool["radius"]} for name, tool in terms["tools"].items()},
            "bodies": {name: body(**thing) for name, thing in terms["bodies"].items()},
            "obstacles": {name: obstacle(**thing) for name, thing in terms["obstacles"].items()},
            "links": terms["links"],
            "contact": terms["contact"],
            "contacts": sorted(touching, key=lambda contact: contact["stiffness"]),
        },
        "design": dict(design),
    }
