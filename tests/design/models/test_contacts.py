"""Every gap against exact arithmetic: what it returns is a tangent plane of the true gap, wherever the centre is.

For a convex closed set C with the support function h, the signed distance is the supremum of n^T y - h(n) over unit
vectors n (docs/decisions/0041-scenes.md). So the plane d + n^T (y - x) is below it at *every* y exactly if |n| = 1 and
d <= n^T x - h(n). That is one inequality of rational numbers, and it is checked as such, up to rounding of a few units
in the last place of the positions.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.contacts import ContactPair, Contacts, Surface

from ...support.cases import cases

SURFACE = Surface(1000.0)
ULPS = Fraction(1, 2**49)
"""Sixteen units in the last place of 1: of the greatest length that a gap is computed from."""

LEAST = Fraction(5e-324)
"""m; no floating point number is nearer to 0."""

Exact = list[Fraction]


def exact(values: object) -> Exact:
    return [Fraction(float(value)) for value in np.ravel(values)]


def dot(a: Exact, b: Exact) -> Fraction:
    return sum((p * q for p, q in zip(a, b, strict=True)), Fraction(0))


class Hull:
    """The set c + s a + t b, -1 <= s, t <= 1, or a box around c, in rational numbers."""

    def __init__(self, kind: str, shape: np.ndarray) -> None:
        self.kind = kind
        zero = [Fraction(0)] * 3
        ends = [exact(point) for point in shape[:2]] or [zero, zero]
        self.c = [(p + q) / 2 for p, q in zip(*ends, strict=True)]
        self.a = [(q - p) / 2 for p, q in zip(*ends, strict=True)]
        self.b = exact(shape[2]) if len(shape) > 2 else zero

    def support(self, n: Exact) -> Fraction:
        """The greatest n^T x over the set."""
        if self.kind == "box":
            return dot(n, self.c) + sum(abs(p * q) for p, q in zip(n, self.a, strict=True))
        return dot(n, self.c) + abs(dot(n, self.a)) + abs(dot(n, self.b))

    def squared(self, u: Exact) -> tuple[Fraction, int]:
        """The square of the signed distance, and its sign."""
        x = [p - q for p, q in zip(u, self.c, strict=True)]
        if self.kind == "box":
            beyond = [abs(p) - h for p, h in zip(x, self.a, strict=True)]
            outside = sum(max(p, Fraction(0)) ** 2 for p in beyond)
            return (outside, 1) if outside > 0 else (max(beyond) ** 2, -1)
        places = [(Fraction(s), Fraction(t)) for s, t in product((-1, 1), repeat=2)]
        aa, ab, bb = dot(self.a, self.a), dot(self.a, self.b), dot(self.b, self.b)
        ax, bx = dot(self.a, x), dot(self.b, x)
        places += [(Fraction(s), (bx - s * ab) / bb) for s in (-1, 1) if bb]
        places += [((ax - t * ab) / aa, Fraction(t)) for t in (-1, 1) if aa]
        if aa * bb - ab * ab:
            places.append(((ax * bb - bx * ab) / (aa * bb - ab * ab), (bx * aa - ax * ab) / (aa * bb - ab * ab)))
        found = []
        for s, t in places:
            if abs(s) <= 1 and abs(t) <= 1:
                r = [p - s * q - t * w for p, q, w in zip(x, self.a, self.b, strict=True)]
                found.append(dot(r, r))
        return min(found), 1


def require_tangent(kind: str, shape: np.ndarray, z: np.ndarray) -> None:
    """The gap and its gradient at ``z`` are a tangent plane of the true gap, to rounding."""
    points = tuple(tuple(point) for point in shape.tolist())
    second = -1 if np.all(z[1] == 0.0) else 1
    (gap,), (gradient,) = Contacts([ContactPair(("a", "b"), 0, second, SURFACE, 0.0, kind, points)], 2).gaps(z)
    hull, d, n = Hull(kind, shape), Fraction(float(gap)), exact(gradient)
    u = [p - q for p, q in zip(exact(z[0]), exact(z[1]), strict=True)]
    tau = ULPS * Fraction(float(np.abs(z).max() + np.abs(shape).max(initial=0.0))) + LEAST
    assert abs(dot(n, n) - 1) <= ULPS
    assert d <= dot(n, u) - hull.support(n) + tau  # a lower bound, everywhere
    square, sign = hull.squared(u)
    for side in (-1, 1):  # which is the gap itself where it begins
        found = d + side * tau
        assert side * (found * abs(found) - sign * square) >= 0


def place_on(rng: np.random.Generator, kind: str, shape: np.ndarray) -> np.ndarray:
    """A place on a corner, an edge, an axis, a face or in the middle, as floating point numbers give it."""
    if kind == "spheres":
        return np.zeros(3)
    weights = rng.choice([-1.0, 0.0, 1.0, rng.uniform(-1.0, 1.0)], 3)
    c, a = (shape[0] + shape[1]) / 2.0, (shape[1] - shape[0]) / 2.0
    if kind == "box":
        return np.asarray(c + weights * a)
    b = shape[2] if kind == "parallelogram" else np.zeros(3)
    return np.asarray(c + weights[0] * a + weights[1] * b)


def shape_of(rng: np.random.Generator, kind: str) -> np.ndarray:
    """Corners, ends or sides of random directions; some along the axes, some nearly parallel, some without length."""
    if kind == "spheres":
        return np.zeros((0, 3))
    size = 10.0 ** rng.uniform(-3.0, 0.0)
    points = size * rng.normal(size=(3, 3)) * rng.choice([0.0, 1.0], (3, 3), p=[0.2, 0.8])
    if kind == "box":
        return np.sort(points[:2], axis=0)
    if kind == "capsule":
        return np.array([points[0], points[0] if rng.random() < 0.1 else points[1]])
    if rng.random() < 0.5:  # from parallel to just beside it
        points[2] = rng.uniform(-2.0, 2.0) * (points[1] - points[0])
        points[2] += rng.choice([0.0, 1.0]) * 10.0 ** rng.uniform(-17.0, -1.0) * size * rng.normal(size=3)
    return points


@pytest.mark.parametrize("kind", ["spheres", "capsule", "parallelogram", "box"])
@settings(max_examples=cases(150, 1000))
@given(seed=st.integers(0, 2**32 - 1))
def test_a_gap_is_a_tangent_plane_everywhere(kind: str, seed: int) -> None:
    """On axes, edges, corners and faces, at coinciding centres, beside them by 1e-330 to 1 m, and anywhere."""
    rng = np.random.default_rng(seed)
    shape = shape_of(rng, kind)
    u = place_on(rng, kind, shape)
    match rng.integers(0, 4):
        case 0:
            pass
        case 1:
            u = u + 10.0 ** rng.uniform(-330.0, -14.0) * rng.normal(size=3)
        case 2:
            u = u + 10.0 ** rng.uniform(-17.0, 0.0) * rng.normal(size=3)
        case _:  # along or across an axis of space
            u = u + 10.0 ** rng.uniform(-17.0, -1.0) * np.eye(3)[rng.integers(0, 3)]
    other = rng.choice([0.0, 1.0]) * rng.normal(size=3)
    require_tangent(kind, shape, np.array([u + other, other]))


@pytest.mark.parametrize("offset", [0.0, 5e-324, 1e-200, 1e-162, 1e-155, 1e-20])
@pytest.mark.parametrize("kind", ["spheres", "capsule", "parallelogram", "box"])
def test_a_gradient_is_a_unit_vector_at_any_distance(kind: str, offset: float) -> None:
    """Squares of such distances are 0, or have a digit or two."""
    sides = {"spheres": 0, "capsule": 2, "parallelogram": 3, "box": 2}[kind]
    shape = np.array([[-0.1, -0.2, 0.0], [0.1, 0.2, 0.0], [0.3, -0.1, 0.0]])[:sides]
    for away in product((-1.0, 0.0, 1.0), repeat=3):
        corners = [np.zeros(3), *shape[:2]]
        for corner in corners:
            require_tangent(kind, shape, np.array([corner + offset * np.array(away), np.zeros(3)]))
