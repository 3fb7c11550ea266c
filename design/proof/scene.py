"""A scene's promise: what can be checked off line of the theorem that its level is 0.

The theorem (docs/decisions/0041-scenes.md) needs masses > 0, and stiffnesses, dampings, sizes and coefficients of
friction >= 0. It needs one coordinate of a tool for each port, and convex obstacles and bodies, which these shapes are.
And it needs an energy that is bounded below. Without gravity all energies are >= 0. With gravity g, each body of mass M
must be held in one of three ways, for M g = -sum of lambda n, lambda >= 0, over faces of normals n (into the inside):

    -M g^T q + sum of k/2 max(0, -n^T q + c)^2 >= sum of (lambda c - lambda^2/(2 k)),

- by a room, whose normals are those of all axes;
- by a wall with its normal against g;
- by a spring to the ground, which bounds the energy along all directions.

All of this is decided exactly. That every tick is solved is not checked here: a controller keeps the level at run time.
"""

from __future__ import annotations

from flint import fmpq

from manyhands.design.proof.claim import GROUND, SceneData
from manyhands.design.proof.exact import exact_decimal
from manyhands.design.proof.finding import Finding

_EXACTLY = "exactly: the file's numbers"


def findings(data: SceneData, m: int) -> list[Finding]:
    """The conditions of the theorem that concern the data, for m ports."""
    least = min([*data.masses.values(), *data.amounts], default=0)
    positive = all(mass > 0 for mass in data.masses.values()) and all(amount >= 0 for amount in data.amounts)
    coordinates = {(tool, axis) for _, tool, axis in data.moved}
    moved = sorted(port for port, _, _ in data.moved) == list(range(m)) and len(coordinates) == m
    held = [name for name, mass in data.masses.items() if not _held(data, name, exact_decimal(mass))]
    solid = [name for name, thing in data.obstacles.items() if not _solid(thing.shape, thing.points)]
    return [
        _finding(
            "masses are positive, no stiffness, damping, size, friction or tank is negative", positive, float(least)
        ),
        _finding("every port moves a tool along an axis of its own", moved),
        _finding("every obstacle is convex, with an inside", not solid, because=", ".join(solid)),
        _finding("the energy is bounded below: no body falls without end", not held, because=", ".join(held)),
    ]


def argument(data: SceneData) -> str:
    """What the level 0 rests on: the theorem's part for each kind of obstacle, and the controller."""
    shapes = {thing.shape for thing in data.obstacles.values()}
    flat, curved = sorted(shapes & {"wall", "room"}), sorted(shapes - {"wall", "room"})
    parts = [f"{' and '.join(flat)} by convex potentials"] if flat else []
    parts.append(
        f"{', '.join([*curved, 'tools and bodies'])} by tangent planes; friction by the bound of the tick before"
    )
    if data.tank > 0:
        parts.append(f"driven bodies give out at most the {float(data.tank):g} J of their tank, which counts as stored")
    if data.holds:
        parts.append("what a button holds by springs that begin without energy and lose theirs")
    kept = "kept at run time by a controller, which is not proved here"
    return f"for solved ticks by a theorem, {'; '.join(parts)}; {kept}"


def _finding(condition: str, holds: bool, value: float = 0.0, because: str = "") -> Finding:
    argument = f"not so for {because}" if because else _EXACTLY
    return Finding(condition, holds, value if value or holds else -1.0, 0.0, argument=argument)


def _solid(shape: str, points: tuple[tuple[int | float, ...], ...]) -> bool:
    if shape == "wall":
        return any(points[1])
    return shape not in ("room", "box") or all(
        exact_decimal(low) < exact_decimal(high) for low, high in zip(*points, strict=True)
    )


def _held(data: SceneData, body: str, mass: fmpq) -> bool:
    """Whether gravity, the walls and the springs to the ground give the body an energy that is bounded below."""
    gravity = [exact_decimal(g) for g in data.gravity]
    if not any(gravity) or mass <= 0:
        return True
    if any(ends == {body, GROUND} and stiffness > 0 for ends, stiffness in data.links):
        return True
    for name, thing in data.obstacles.items():
        if data.touching.get(frozenset((body, name)), data.stiffness) <= 0:
            continue
        if thing.shape == "room":
            return True
        if thing.shape == "wall":
            n = [exact_decimal(x) for x in thing.points[1]]
            along = sum((a * b for a, b in zip(n, gravity, strict=True)), fmpq(0))
            across = [n[i] * gravity[j] - n[j] * gravity[i] for i, j in ((0, 1), (1, 2), (2, 0))]
            if along < 0 and not any(across):
                return True
    return False
